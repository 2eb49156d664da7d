//! `stlfr check`

use super::CliError;
use super::files::{must_be_writable, open_capture};
use std::path::PathBuf;
use stlfr::progress::Reporter;
use stlfr::toolchain::{check, ensure_environment, project_root};

/// Check a capture's calibration against COLMAP: projections, and a reconstruction from the pixels
/// of one instant.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  \
    stlfr check .captures/demo\n  \
    stlfr check .captures/demo --json check.json")]
pub struct Args {
    /// The capture's folder.
    capture: PathBuf,
    /// File for the measured values.
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
}

pub fn run(args: &Args, reporter: &Reporter) -> Result<(), CliError> {
    open_capture(&args.capture, reporter)?; // an error before a set-up that may take minutes
    args.json.as_deref().map_or(Ok(()), must_be_writable)?;
    let environment = ensure_environment(&project_root()?, reporter)?;
    let check = check(&environment, &args.capture, args.json.as_deref(), reporter)?;
    for line in &check.table {
        println!("{line}");
    }
    match (check.values.ok, check.values.reason) {
        (true, _) => Ok(()),
        (false, reason) => Err(CliError::Failure(format!(
            "the calibration is off: {}",
            reason.unwrap_or_default()
        ))),
    }
}
