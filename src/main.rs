//! The command `tid3r`.

mod cli;

use clap::Parser;
use std::process::ExitCode;
use tid3r_models::nn::cpu::keep_freed_memory;

fn main() -> ExitCode {
    keep_freed_memory();
    match cli::Cli::parse().run() {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) if cli::is_broken_pipe(&error) => ExitCode::SUCCESS,
        Err(error) => {
            cli::terminal::complain(&error);
            ExitCode::FAILURE
        }
    }
}
