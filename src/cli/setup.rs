//! `stlfr setup`

use super::CliError;
use super::files::CommandOutput;
use super::print::Page;
use std::path::PathBuf;
use stlfr::progress::Reporter;
use stlfr::toolchain::{build_extension, ensure_environment, project_root};

/// Set up the pinned Python environment, once; `demo`, `capture` and `check` do it by themselves.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  \
    stlfr setup\n  \
    stlfr setup --extension stlfr.zip")]
pub struct SetupArgs {
    /// Also build the Blender extension, to be installed from disk in Blender's preferences.
    #[arg(long, value_name = "FILE.zip")]
    extension: Option<PathBuf>,
}

pub fn run(args: &SetupArgs, page: &mut Page, reporter: &Reporter) -> Result<(), CliError> {
    if let Some(zip) = &args.extension {
        if zip.extension().is_none_or(|e| e != "zip") {
            return Err(CliError::BadInput("--extension: must name a .zip".into()));
        }
        CommandOutput::File(zip).check(None)?;
    }
    let environment = ensure_environment(&project_root()?, reporter)?;
    let Some(zip) = &args.extension else {
        page.line(environment.python.display());
        return Ok(());
    };
    build_extension(&environment, zip, reporter)?;
    page.line(zip.display());
    Ok(())
}
