use super::{Cli, output};
use anyhow::{Context, Result};
use clap::{Args, Command, CommandFactory};
use clap_mangen::Man;
use std::{
    fs,
    io::Write,
    path::{Path, PathBuf},
};

/// Print the manual page of tid3r, or write those of all verbs to a folder.
///
/// To read it: tid3r man | man -l -
///
/// To install all: tid3r man -o ~/.local/share/man/man1
#[derive(Debug, Args)]
pub(super) struct ManPages {
    /// The folder to write to: tid3r.1, tid3r-run.1, ..
    #[arg(short, long, value_name = "FOLDER")]
    output: Option<PathBuf>,
}

impl ManPages {
    pub(super) fn run(self) -> Result<()> {
        let mut command = Cli::command().disable_help_subcommand(true);
        command.build();
        let Some(folder) = self.output else {
            let page = page(command)?;
            std::io::stdout().lock().write_all(&page)?;
            return Ok(());
        };
        fs::create_dir_all(&folder)
            .with_context(|| format!("cannot create {}", folder.display()))?;
        let count = write_all(command, &folder)?;
        output::line(format!("{count} manual pages in {}", folder.display()))
    }
}

fn page(command: Command) -> Result<Vec<u8>> {
    let mut page = Vec::new();
    Man::new(command).render(&mut page)?;
    Ok(page)
}

/// Writes the page of a command and those of all below it, and says how many these are.
fn write_all(command: Command, folder: &Path) -> Result<usize> {
    let name = command.get_display_name().unwrap_or(command.get_name());
    let path = folder.join(format!("{name}.1"));
    let mut count = 1;
    for below in command
        .get_subcommands()
        .filter(|below| !below.is_hide_set())
    {
        count += write_all(below.clone(), folder)?;
    }
    let page = page(command)?;
    fs::write(&path, page).with_context(|| format!("cannot write {}", path.display()))?;
    Ok(count)
}
