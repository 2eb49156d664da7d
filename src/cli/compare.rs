//! `stlfr compare`

use std::path::PathBuf;

/// Render what the capture has truth of, and set it beside the truth and beside traditional light
/// field rendering: pictures, metrics.json and report.html.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  \
    stlfr compare .captures/demo\n  \
    stlfr compare .captures/demo --video -o review")]
pub struct Args {
    /// The capture's folder; it must have truth.
    capture: PathBuf,
    /// Where the report goes [default: CAPTURE/review].
    #[arg(short, long, value_name = "DIR")]
    output: Option<PathBuf>,
    /// A video too: truth, traditional and space-time light field side by side.
    #[arg(long)]
    video: bool,
    /// Options of all stages, a JSON file.
    #[arg(long, value_name = "FILE")]
    options: Option<PathBuf>,
}
