//! The command line `stlfr`: clap, and one call per command.

mod cli;

use clap::Parser;
use std::process::ExitCode;

fn main() -> ExitCode {
    stlfr::host::reuse_freed_memory();
    // If this fails, the next run removes the files that an interrupted run leaves.
    let _ = stlfr::host::remove_unfinished_on_signals();
    match cli::Cli::try_parse() {
        Ok(cli) => cli::exit(cli.run()),
        Err(error) => cli::usage(&error),
    }
}
