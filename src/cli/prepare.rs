//! The command `stlfr prepare`, which registers all frame pairs of a capture before rendering.

use super::CliError;
use super::error::of_io;
use super::files::{OptionsArgs, must_be_a_file, open_capture};
use super::print::Page;
use crate::capture::CAPTURE_FILE;
use crate::host::DiskCache;
use crate::light_field::PREPARED;
use crate::pipeline;
use crate::progress::Reporter;
use std::path::{Path, PathBuf};
use std::time::Instant;

/// Register all frame pairs of a capture beforehand, so that rendering is faster. With --set proxy.method=scene-flow,
/// also estimate depth and motion of all frames.
///
/// The results are stored in the capture's folder, under .stlfr/cache, where render, view and compare find them.
/// Rendered images stay the same to the byte. After an interruption, the same command continues. If frames, offsets or
/// registration options change, other frame pairs must be registered. All presets use the same frame pairs.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  \
    stlfr prepare .captures/demo\n  \
    stlfr prepare .captures/demo --options mine.json\n  \
    stlfr prepare .captures/demo --delete")]
pub struct PrepareArgs {
    /// The capture's folder.
    capture: PathBuf,
    /// Delete all stored results of earlier runs, whatever their options, and do nothing else.
    #[arg(long, conflicts_with_all = ["preset", "options", "set"])]
    delete: bool,
    #[command(flatten)]
    options: OptionsArgs,
}

/// Deletes the stored results of `stlfr prepare`. This also works if the capture can't be opened.
fn delete(capture: &Path, page: &mut Page) -> Result<(), CliError> {
    must_be_a_file(&capture.join(CAPTURE_FILE))?;
    let cache = DiskCache::new(capture, |_| ());
    let mut entries = 0;
    for kind in PREPARED {
        let folder = capture.join(".stlfr/cache").join(kind);
        entries += of_io(&folder, "can't be deleted", cache.delete(Some(kind)))?.entries;
    }
    page.line(if entries > 0 { "Deleted." } else { "Nothing was prepared." });
    Ok(())
}

/// Number of bytes in a megabyte.
const MB: f64 = 1e6;

pub fn run(args: &PrepareArgs, page: &mut Page, reporter: &Reporter) -> Result<(), CliError> {
    if args.delete {
        return delete(&args.capture, page);
    }
    let options = args.options.read()?;
    let capture = open_capture(&args.capture, None, reporter)?;
    let field = pipeline::open_field(capture, &options, reporter)?;
    let options = pipeline::resolved(&field, &options, reporter)?;
    let (steps, bytes) = field.preparation_size(&options);
    reporter.note(&format!("What is prepared takes at most {:.0} MB of disk.", bytes as f64 / MB));
    let task = reporter.task("Preparing frames", steps);
    let start = Instant::now();
    let prepared = field.prepare(&options, |done| task.set(done))?;
    let seconds = start.elapsed().as_secs_f64();
    drop(task);
    if prepared.maps > 0 {
        page.line(format_args!(
            "Depth and motion of {} frames are stored; those of {} were before.",
            prepared.maps, prepared.maps_found,
        ));
    }
    page.line(format_args!(
        "{} frame pairs with motion are registered; {} of them were before. {:.1} MB, {seconds:.1} s.",
        prepared.pairs,
        prepared.found,
        prepared.bytes as f64 / MB,
    ));
    Ok(())
}
