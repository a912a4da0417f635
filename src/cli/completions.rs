use super::Cli;
use anyhow::Result;
use clap::{Args, CommandFactory};
use clap_complete::Shell;
use std::io::Write;

/// Print a completion script for your shell.
///
/// For bash: tid3r completions bash > ~/.local/share/bash-completion/completions/tid3r
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
