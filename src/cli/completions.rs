use super::Cli;
use anyhow::Result;
use clap::{Args, CommandFactory};
use clap_complete::Shell;
use std::io::Write;

/// Print a completion script for your shell.
///
/// For bash: tid3r completions bash > ~/.local/share/bash-completion/completions/tid3r
///
/// For fish: tid3r completions fish > ~/.config/fish/completions/tid3r.fish
///
/// For zsh: tid3r completions zsh > DIR/_tid3r, where DIR is a folder of $fpath
///
/// For PowerShell: tid3r completions powershell >> $PROFILE
///
/// For elvish: tid3r completions elvish >> ~/.config/elvish/rc.elv
///
/// Folders that are not there have to be made first.
#[derive(Debug, Args)]
pub(super) struct Completions {
    /// The shell
    #[arg(value_enum)]
    shell: Shell,
}

impl Completions {
    pub(super) fn run(self) -> Result<()> {
        let mut script = Vec::new();
        clap_complete::generate(self.shell, &mut Cli::command(), "tid3r", &mut script);
        std::io::stdout().lock().write_all(&script)?;
        Ok(())
    }
}
