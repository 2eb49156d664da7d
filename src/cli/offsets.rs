//! The command `stlfr offsets`, which estimates the temporal offsets of the cameras.

use super::CliError;
use super::files::{OptionsArgs, open_capture};
use super::print::{Page, decimals};
use crate::offset::{CameraOffset, Offsets, offsets_from_images};
use crate::progress::Reporter;
use crate::registration::FrameStore;
use std::path::PathBuf;

/// Estimate the offset of each camera's clock from the reference camera's clock, with its standard error, from the
/// images alone.
///
/// Time on the reference camera's clock = time on the camera's clock + offset. If capture.json declares that a clock
/// drifts, its rate is estimated too. If it declares that the readout time of a rolling shutter has a standard error,
/// the readout time is estimated too. If capture.json declares that a camera may lose frames, its lost frames are
/// estimated too. The result is saved in the capture's folder as offsets.json, and a plot of the data behind it as
/// offsets.svg.
///
/// offsets.json may be edited: render, compare and plan then use the edited offsets. This command still estimates the
/// offsets, but leaves the edited file unchanged.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  \
    stlfr offsets .captures/demo\n  \
    stlfr offsets .captures/demo --json > offsets.json")]
pub struct OffsetsArgs {
    /// The capture's folder.
    capture: PathBuf,
    /// Print JSON and nothing else.
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    options: OptionsArgs,
}

pub fn run(args: &OffsetsArgs, page: &mut Page, reporter: &Reporter) -> Result<(), CliError> {
    let options = args.options.read()?;
    let capture = open_capture(&args.capture, None, reporter)?;
    capture.require_two_cameras()?;
    let frames = FrameStore::new(capture.clone(), &options.registration);
    let offsets = offsets_from_images(&frames, &options.offset, reporter)?;
    if args.json {
        page.json(&offsets)?;
    } else {
        print_table(&offsets, capture.frame_s(), page);
    }
    Ok(())
}

fn print_table(offsets: &Offsets, frame_s: f64, page: &mut Page) {
    let drifts = offsets.cameras.iter().any(|c| c.rate_ppm.is_some());
    let readouts = offsets.cameras.iter().filter(|c| c.readout_s.is_some()).count();
    let has_readouts = readouts > 0;
    let loses = offsets.cameras.iter().any(|c| c.lost_before.is_some());
    let mut header =
        format!("{:<12} {:>12} {:>12} {:>10}", "camera", "offset", "std. error", "frames");
    if drifts {
        header += &format!(" {:>20}", "rate");
    }
    if has_readouts {
        header += &format!(" {:>20}", "readout");
    }
    if loses {
        header += "  lost before";
    }
    page.line(header);
    for camera in &offsets.cameras {
        let Some(offset_s) = camera.offset_s else {
            let reason = camera.reason.as_deref().unwrap_or("-");
            page.line(format_args!("{:<12} unknown: {reason}", camera.id));
            continue;
        };
        let digits = decimals(camera.std_err_s.map(|s| 1e3 * s));
        let in_frames = |s: f64| if frame_s > 0.0 { s / frame_s } else { 0.0 };
        let frame_digits = decimals(camera.std_err_s.map(in_frames));
        let mut line = format!(
            "{:<12} {:>9.digits$} ms {:>9.digits$} ms {:>10.frame_digits$}",
            camera.id,
            1e3 * offset_s,
            1e3 * camera.std_err_s.unwrap_or(f64::NAN),
            in_frames(offset_s),
        );
        if drifts {
            let rate = camera.rate_ppm.zip(camera.rate_std_err_ppm);
            let text = rate.map(|(rate, error)| format!("{rate:.1} ± {error:.1} ppm"));
            line += &format!(" {:>20}", text.unwrap_or_default());
        }
        if has_readouts {
            line += &format!(" {:>20}", readout(camera));
        }
        if loses {
            let lost = camera.lost_before.as_deref().unwrap_or_default();
            let images: Vec<String> = lost.iter().map(usize::to_string).collect();
            line += &format!("  {}", images.join(", "));
        }
        page.line(line.trim_end());
    }
    let reference = &offsets.reference;
    page.line(format_args!("Time on {reference}'s clock = time on the camera's clock + offset."));
    if drifts {
        page.line("Offsets are those at each camera's first frame.");
    }
    if readouts > 1 {
        page.line(
            "The error of a readout includes what all readouts have in common; \
             their differences may be better known.",
        );
    }
}

/// Returns a camera's estimated readout time with its standard error, as text; empty if it was not estimated.
fn readout(camera: &CameraOffset) -> String {
    let Some((s, error_s)) = camera.readout_s.zip(camera.readout_std_err_s) else {
        return String::new();
    };
    let digits = decimals(Some(1e3 * error_s));
    format!("{:.digits$} ± {:.digits$} ms", 1e3 * s, 1e3 * error_s)
}
