use super::{SceneArgument, output, terminal::Terminal};
use anyhow::Result;
use clap::Args;
use std::{
    net::IpAddr,
    path::PathBuf,
    process::{Command, Stdio},
};
use tid3r::{
    progress::Progress,
    viewer::{self, Address, Options},
};

/// Look at a scene in a browser, edit it and render pictures.
///
/// Serves a page on this machine, from this program alone, until it is ended with Ctrl-C. What is edited
/// there is the same list as `tid3r edit` has, saved at once; pictures go into the scene's gallery/.
#[derive(Debug, Args)]
pub(super) struct View {
    #[command(flatten)]
    scene: SceneArgument,
    /// The port; 0 for any that is free
    #[arg(long, value_name = "N", default_value_t = 8338)]
    port: u16,
    /// Serve other machines too, at this address of this one (0.0.0.0 for all it has). The printed address then has a
    /// token, without which nothing is answered; it is not encrypted
    #[arg(long, value_name = "ADDRESS")]
    host: Option<IpAddr>,
    /// Open the page in the browser
    #[arg(long)]
    open: bool,
    /// Folder of See3D's weights, a folder in it for each network, instead of where `tid3r weights path`
    /// finds them; or `synthetic-tiny`
    #[arg(long, value_name = "FOLDER")]
    weights: Option<PathBuf>,
}

impl View {
    pub(super) fn run(self, terminal: &Terminal) -> Result<()> {
        let options = Options {
            see3d_weights: self.weights,
        };
        let address = Address {
            host: self.host,
            port: self.port,
        };
        let mut said = Ok(());
        viewer::serve(&self.scene.scene, options, &address, |url| {
            said = output::line(url);
            terminal.note("press Ctrl-C to end");
            if self.open && !open(url) {
                terminal.note("no browser could be started; open the address in one");
            }
        })?;
        said
    }
}

/// Opens an address in the system's browser; whether that could be tried.
fn open(url: &str) -> bool {
    let program = if cfg!(target_os = "macos") {
        "open"
    } else if cfg!(windows) {
        "explorer"
    } else {
        "xdg-open"
    };
    let quiet = || Stdio::null();
    let mut command = Command::new(program);
    let command = command.arg(url).stdin(quiet()).stdout(quiet());
    command.stderr(quiet()).spawn().is_ok()
}
