//! The command line `stlfr`: clap, and one call per command.

mod cli;

use clap::Parser;
use std::process::ExitCode;

fn main() -> ExitCode {
    match cli::Cli::try_parse() {
        Ok(cli) => cli::exit(cli.run()),
        Err(error) => cli::usage(&error),
    }
}
