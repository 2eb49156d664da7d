//! Estimates the temporal offsets of unsynchronized cameras from their images alone (§7 of the paper).
//!
//! A time on the reference camera's clock is the time on the camera's own clock plus the camera's offset, in seconds.
//! If both clocks read 0 at their first frames, a camera that starts after the reference camera has a positive
//! offset.
//!
//! | paper | item |
//! |---|---|
//! | eq. (10), the offset that one feature implies (its offset candidate) | [`ThreeFrames::candidates`] |
//! | RANSAC over the offset candidates of all features | [`ransac`] |
//! | weighted least squares (WLS), eqs. (11) to (13) | [`weighted_least_squares`] |
//! | the choice of a frame of j between two frames of i (0 ≤ t̃ ≤ Δt), the mean over frames | [`PairEstimate`] |
//! | Fig. 23, the distances of features from their epipolar lines | [`plot`] |
//!
//! Beyond the paper: an information-weighted mixture model instead of RANSAC and WLS ([`Mixture`]), curved
//! trajectories, rough alignment of recordings that start seconds apart, detection of lost frames, and a joint
//! solution for all clocks with rates and standard errors.
//!
//! | file | content |
//! |---|---|
//! | `options` | [`OffsetOptions`] and the methods |
//! | `clock` | [`ClockModel`]: offset, rate and lost frames; nominal clocks |
//! | `estimate` | [`estimate`]: the stages in their order, and the reasons of unknown offsets |
//! | `recording` | frames, features and tracks, and the features' offset candidates, eq. (10) |
//! | `alignment` | rough alignment: cross-correlation of the images' changes, verified by offset candidates |
//! | `lost_frames` | detection of lost frames: clock models of all cameras, fitted by block-coordinate descent |
//! | `pair` | the pairs of cameras, and each pair's offset, by RANSAC and WLS or by the mixture model |
//! | `joint` | joint solution for all clocks, by robust weighted least squares |
//! | `calibration` | effect of calibration errors on the offsets |
//! | `uncertainty` | cluster-robust standard errors |
//! | `offsets` | [`Offsets`], the result, and the frame times that follow from it |
//! | [`mod@file`] | `offsets.json`, and the validation of an edited file |
//! | `plot` | charts of an estimate and of the data behind it |
//!
//! # Known limits
//!
//! - Recordings shorter than 2 s are assumed to be aligned to about one frame.
//! - If all motion runs along the epipolar lines of every pair that contains a camera, the camera's offset cannot be
//!   determined.
//! - A frame lost while nothing moves is attributed to the next image that shows motion.
//! - The loss of a frame directly after the first image or directly before the last image of a recording may be
//!   missed. The time of that first or last image is then wrong by one frame.
//! - If several cameras lose frames at about the same time, several sets of lost frames may explain the images nearly
//!   equally well. The offsets of these cameras are then unknown.
//! - Each clock has one constant rate over the whole recording.

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

/// The reason given for the unknown offset of a camera with a single frame.
const ONE_FRAME: &str = "it has one frame, which shows no motion";

/// Returns the temporal offsets of a capture's cameras. `reporter` tells the user from which source they come.
///
/// The first of these sources that applies is used:
///
/// - If all cameras share one clock, all offsets are 0.
/// - If the capture is static (one frame per camera), all offsets except the reference camera's are unknown.
/// - If `offsets.json` was edited by hand, its offsets are used as given.
/// - If `offsets.json` holds an estimate for the same frames and options ([`mod@file`]), this estimate is used.
/// - Otherwise the offsets are estimated from the images. The estimate is stored in `offsets.json`, and its plot in
///   `offsets.svg`. If the folder cannot be written, the estimate is returned without being stored.
///
/// Returns an error if a frame cannot be read, or if `offsets.json` is invalid.
pub fn resolve_offsets(
    frames: &FrameStore,
    options: &OffsetOptions,
    reporter: &Reporter,
) -> Result<Offsets, CaptureError> {
    resolve(frames, options, reporter, true)
}

/// Returns the offsets as [`resolve_offsets`] does, but neither uses nor replaces an `offsets.json` that was edited
/// by hand.
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
    let is_guessed = capture.cameras.iter().any(|c| c.clock.readout_std_s > 0.0);
    if is_guessed && (clocks(capture).1 == 1 || options.method == OffsetMethod::Pairwise) {
        reporter.note(
            "Readout times are used as given: they are estimated only together with the offsets.",
        );
    }
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
    // A folder that cannot be written is no error: the offsets are used without being saved.
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

/// Writes the plot of an estimate to `offsets.svg`, then its offsets to `offsets.json`, in the capture's folder.
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
