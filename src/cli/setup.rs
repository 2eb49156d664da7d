//! `stlfr setup`

use super::CliError;
use stlfr::progress::Reporter;
use stlfr::toolchain::{ensure_environment, project_root};

/// Set up the pinned Python environment, once; `demo`, `capture` and `check` do it by themselves.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  stlfr setup")]
pub struct Args {}

pub fn run(_: &Args, reporter: &Reporter) -> Result<(), CliError> {
    let environment = ensure_environment(&project_root()?, reporter)?;
    println!("{}", environment.python.display());
    Ok(())
}
