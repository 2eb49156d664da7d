//! `stlfr check`

use super::CliError;
use super::error::written;
use super::files::{CommandOutput, open_capture};
use super::print::Page;
use std::path::PathBuf;
use stlfr::host::write_json;
use stlfr::progress::Reporter;
use stlfr::toolchain::{Check, check, ensure_environment, project_root};

/// Check a capture's calibration against COLMAP: projections, and a reconstruction from the pixels
/// of one instant.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  \
    stlfr check .captures/demo\n  \
    stlfr check .captures/demo --json check.json")]
pub struct CheckArgs {
    /// The capture's folder.
    capture: PathBuf,
    /// File for the measured values.
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
}

pub fn run(args: &CheckArgs, page: &mut Page, reporter: &Reporter) -> Result<(), CliError> {
    // An error before a set-up that may take minutes.
    open_capture(&args.capture, args.json.as_deref().map(CommandOutput::File), reporter)?;
    let environment = ensure_environment(&project_root()?, reporter)?;
    let check = check(&environment, &args.capture, reporter)?;
    if let Some(json) = &args.json {
        written(json, write_json(json, &check.values))?;
    }
    for line in &check.table {
        page.line(line);
    }
    verdict(check)
}

/// An error if the calibration is off.
pub fn verdict(check: Check) -> Result<(), CliError> {
    match check.failure {
        Some(reason) => Err(CliError::Failure(format!("the calibration is off: {reason}"))),
        None => Ok(()),
    }
}
