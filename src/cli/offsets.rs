//! `stlfr offsets`

use std::path::PathBuf;

/// Estimate how far each camera's clock is off the reference's, with its standard error, from the
/// pixels alone.
///
/// Time on the reference's clock = time on the camera's clock + offset.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  \
    stlfr offsets .captures/demo\n  \
    stlfr offsets .captures/demo --json > offsets.json")]
pub struct Args {
    /// The capture's folder.
    capture: PathBuf,
    /// Print JSON and nothing else.
    #[arg(long)]
    json: bool,
    /// Options of the estimation, a JSON file.
    #[arg(long, value_name = "FILE")]
    options: Option<PathBuf>,
}
