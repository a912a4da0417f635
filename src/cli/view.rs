use super::{output, terminal::Terminal};
use anyhow::Result;
use clap::Args;
use std::{
    net::IpAddr,
    path::{Path, PathBuf},
    process::{Command, Stdio},
};
use tid3r::{
    progress::Progress,
    viewer::{self, Address, Options},
};

/// Make a scene in a browser, look at it, edit it and render pictures.
///
/// Serves a page on this machine, from this program alone, until it is ended with Ctrl-C. Where there is no scene yet,
/// photos, ZIP files and videos are dropped on the page, which does with them what `reconstruct`, `clean` and `segment`
/// do. What is edited there is the same list as `tid3r edit` has, saved at once; pictures go into the scene's gallery/.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  \
    tid3r view --open                      # drop photos, and they become the scene room\n  \
    tid3r view kitchen --open              # the scene there, or one to be made there\n\n\
    Weights are found as `tid3r weights list` says.")]
pub(super) struct View {
    /// The scene's folder, or a new one [default: where tid3r runs, if that is a scene, or else a new folder `room`]
    #[arg(value_name = "SCENE")]
    scene: Option<PathBuf>,
    /// The port; 0 for any that is free
    #[arg(long, value_name = "N", default_value_t = 8338)]
    port: u16,
    /// Serve other machines too, at this address of this one, or 0.0.0.0 for all it has: other machines then put its IP
    /// address in place of `localhost`. The printed address has a token, without which nothing is answered; nothing is
    /// encrypted
    #[arg(long, value_name = "ADDRESS")]
    host: Option<IpAddr>,
    /// Open the page in the browser
    #[arg(long)]
    open: bool,
    /// Folder of all weights, with one for each network, instead of that which TID3R_MODELS names; or
    /// `synthetic-tiny`, for a small made-up See3D
    #[arg(long, value_name = "FOLDER")]
    weights: Option<PathBuf>,
}

impl View {
    pub(super) fn run(self, terminal: &Terminal) -> Result<()> {
        let tiny = |name: &PathBuf| name.as_os_str() == "synthetic-tiny";
        let options = Options {
            tiny_see3d: self.weights.as_ref().is_some_and(tiny),
            weights: self.weights.filter(|name| !tiny(name)),
        };
        let folder = match self.scene {
            Some(folder) => folder,
            None => viewer::usual_folder(Path::new(".")),
        };
        let address = Address {
            host: self.host,
            port: self.port,
        };
        let mut said = Ok(());
        let is_new = viewer::is_free(&folder);
        viewer::serve(&folder, options, &address, |url| {
            said = output::line(url);
            if is_new {
                let folder = folder.display();
                terminal.note(&format!(
                    "photos that are dropped on the page become the scene {folder}"
                ));
            }
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
