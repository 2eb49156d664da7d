//! §7: the temporal offsets of cameras with clocks of their own, from their images alone.
//!
//! Time on the reference's clock = time on the camera's clock + offset, in seconds. A camera that starts
//! after the reference, both at 0 on their own clocks, has a positive offset.
//!
//! | paper | item |
//! |---|---|
//! | eq. (10), one candidate per feature | [`ThreeFrames::candidates`] |
//! | RANSAC over all candidates | [`ransac`] |
//! | WLS, eqs. (11) to (13) | [`weighted_least_squares`] |
//! | the choice of frames with 0 ≤ t̃ ≤ Δt, the mean over frames | [`PairEstimate`] |
//! | Fig. 23, the distances from the epipolar lines | [`plot`] |
//!
//! Beyond the paper: an information-weighted mixture model instead of RANSAC and WLS
//! ([`Mixture`]), curved trajectories, rough alignment of recordings that start seconds apart,
//! lost frames, and all clocks solved together with rates and standard errors.
//!
//! | file | content |
//! |---|---|
//! | `options` | [`OffsetOptions`] and the methods |
//! | `clock` | [`ClockModel`]: offset, rate and lost frames; nominal clocks |
//! | `estimate` | [`estimate`]: the steps in their order, and the reasons of unknown offsets |
//! | `recording` | frames, features and tracks, and the candidates of frame triples, eq. (10) |
//! | `alignment` | rough alignment by cross-correlation of activity, verified by candidates |
//! | `lost_frames` | lost frames: observation, and clock models by block-coordinate descent |
//! | `pair` | the pairs of cameras, and each pair's offset, by RANSAC and WLS or by the mixture |
//! | `joint` | all clocks together by robust weighted least squares |
//! | `calibration` | how the calibration's errors change candidates |
//! | `uncertainty` | cluster-robust standard errors |
//! | `offsets` | [`Offsets`], the result, and the frame times that it implies |
//! | [`mod@file`] | `offsets.json`, and the validation of an edited one |
//! | `plot` | charts of the data behind an estimate |
//!
//! # Known limits
//!
//! - Recordings of less than 2 s are taken to be aligned to about a frame.
//! - Motion along the epipolar lines of all pairs of a camera leaves its offset undetermined.
//! - A frame lost while nothing moves is attributed to the next image that shows motion.
//! - A frame lost right after the first image or before the last one may be missed. That image's time is
//!   then one frame off.
//! - Cameras that lose frames at about the same time hide each other's losses. If several places fit
//!   nearly as well, their offsets are unknown.
//! - One rate holds for a whole recording.

mod alignment;
mod calibration;
mod clock;
mod estimate;
pub mod file;
mod joint;
mod lost_frames;
mod offsets;
mod options;
mod pair;
mod plot;
mod recording;
mod uncertainty;

pub(crate) use clock::clocks;
pub use clock::{ClockModel, NominalClock};
pub use estimate::{Estimate, estimate};
pub use file::{MAX_OFFSETS_BYTES, SavedOffsets};
pub use offsets::{CameraOffset, Offsets};
pub use options::{OffsetMethod, OffsetOptions};
pub use pair::{
    FrameEstimate, Mixture, Observation, PairEstimate, consensus_value, ransac,
    weighted_least_squares,
};
pub use plot::plot;
pub use recording::{Candidate, Sample, ThreeFrames};

use crate::capture::{Capture, CaptureError};
use crate::host::write_atomically;
use crate::progress::Reporter;
use crate::registration::FrameStore;

/// The reason of an unknown offset of a camera with a single frame.
const ONE_FRAME: &str = "it has one frame, which shows no motion";

/// The offsets of a capture: known, edited by hand, stored by an earlier command, or estimated from the
/// images. The first of these sources that applies is used. A note on the reporter says which one.
///
/// They are known, all 0, if all cameras share one clock. In a static capture, with one frame per camera, all
/// but the reference's are unknown. [`mod@file`] says when the offsets in `offsets.json` are used. New
/// estimates are stored in that file, with their plot in `offsets.svg`. If the folder cannot be written,
/// there is a note and no error. The error is that of a frame that cannot be read, or of a refused
/// `offsets.json`.
pub fn resolve_offsets(
    frames: &FrameStore,
    options: &OffsetOptions,
    reporter: &Reporter,
) -> Result<Offsets, CaptureError> {
    resolve(frames, options, reporter, true)
}

/// [`resolve_offsets`], except that an edited `offsets.json` is neither used nor replaced.
pub fn offsets_from_images(
    frames: &FrameStore,
    options: &OffsetOptions,
    reporter: &Reporter,
) -> Result<Offsets, CaptureError> {
    resolve(frames, options, reporter, false)
}

fn resolve(
    frames: &FrameStore,
    options: &OffsetOptions,
    reporter: &Reporter,
    use_edited: bool,
) -> Result<Offsets, CaptureError> {
    let capture = frames.capture();
    if clocks(capture).1 == 1 {
        reporter.note("The cameras share one clock: no offsets to estimate.");
        return Ok(Offsets::known(capture));
    }
    if capture.is_static() {
        reporter.note("Every camera took one frame, the same at any time: no offsets to estimate.");
        return Ok(Offsets::unknown(capture, ONE_FRAME));
    }
    let saved = match Offsets::saved(capture)? {
        SavedOffsets::Edited(offsets) if use_edited => {
            reporter.note(
                "offsets.json was edited by hand: its offsets are used as given, not estimated.",
            );
            return Ok(offsets);
        }
        SavedOffsets::Edited(_) => {
            let estimate = estimate(frames, options, reporter)?;
            reporter.note(
                "Offsets were estimated from the images and not saved: offsets.json was edited by \
                 hand, and is what other commands use until it is deleted.",
            );
            return Ok(estimate.offsets);
        }
        SavedOffsets::Missing => None,
        SavedOffsets::Estimated { offsets, hash, .. } => Some((offsets, hash)),
    };
    let all_options = (options, frames.options());
    let hash = Offsets::hash(capture, &all_options)?;
    if let Some((offsets, saved_hash)) = saved {
        if saved_hash == hash {
            reporter.note("Offsets are those of offsets.json, estimated before.");
            return Ok(offsets);
        }
        reporter.note("offsets.json is of other frames, options or another version: made anew.");
    }
    let estimate = estimate(frames, options, reporter)?;
    let saved = save(&estimate, capture, &all_options, &hash);
    // A read-only capture is no error: the offsets are used without being saved.
    reporter.note(&match saved {
        Ok(()) => {
            "Offsets were estimated from the images and saved in offsets.json, their plot in \
                   offsets.svg."
                .into()
        }
        Err(error) => format!("Offsets were estimated from the images but not saved: {error}."),
    });
    Ok(estimate.offsets)
}

/// Writes the plot `offsets.svg`, then `offsets.json`.
fn save(
    estimate: &Estimate,
    capture: &Capture,
    options: &impl serde::Serialize,
    hash: &str,
) -> Result<(), CaptureError> {
    let path = Offsets::plot_path(capture);
    write_atomically(&path, plot(estimate, capture).as_bytes())
        .map_err(|source| CaptureError::Write { path, source })?;
    estimate.offsets.save(capture, options, hash)
}

#[cfg(test)]
mod tests;
