//! The command line `stlfr`: clap, and one call per command.

mod cli;

use clap::Parser;
use std::process::ExitCode;

fn main() -> ExitCode {
    stlfr::host::reuse_freed_memory();
    // Without it, what an interrupted run leaves is removed by the next one.
    let _ = stlfr::host::remove_unfinished_on_signals();
    match cli::Cli::try_parse() {
        Ok(cli) => cli::exit(cli.run()),
        Err(error) => cli::usage(&error),
    }
}
