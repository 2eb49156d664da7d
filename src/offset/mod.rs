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
//! | the estimator of Zhou and Tao in Figs. 19 to 22 | [`cross_ratio_offset`] |
//! | Fig. 23, the distances from the epipolar lines | [`plot`] |
//!
//! Beyond the paper: an information-weighted mixture model instead of RANSAC and WLS
//! ([`ResidualModel`]), curved trajectories, rough alignment of recordings that start seconds apart,
//! lost frames, and all clocks solved together with rates and standard errors ([`solve_clocks`]).
//!
//! | file | content |
//! |---|---|
//! | `options` | [`OffsetOptions`] and the methods |
//! | `estimate` | [`estimate`]: the stages in their order, and the reasons of unknown offsets |
//! | `pairing` | the clocks of the cameras, and the pairs of cameras |
//! | `timeline` | the images' times, lost frames accounted for |
//! | `recording` | frames, tracks and the candidates of frame triples, cached |
//! | `features` | the selection of features that move |
//! | `candidates` | eq. (10) |
//! | `activity`, `align` | rough alignment by cross-correlation, verified by candidates |
//! | `lost_frames` | the observation of lost frames |
//! | `clock_models` | their joint fit: block-coordinate descent and dynamic programming |
//! | `pair`, `pair_fit` | one pair: the choice of triples; offset, rate and standard error |
//! | `rounds` | all pairs: choice and fit in turn |
//! | `time_order` | the order in which candidates are computed and frames are read |
//! | `consensus` | RANSAC and WLS |
//! | `mixture` | maximum likelihood under the mixture model |
//! | `uncertainty` | cluster-robust standard errors |
//! | `joint` | all clocks together by robust weighted least squares |
//! | `zhou_tao` | the four-point estimator |
//! | `store` | [`Offsets`], and the times that they give the images |
//! | [`mod@file`], `edited` | `offsets.json`, and the validation of one that was edited by hand |
//! | `plot` | charts of the data behind an estimate |
//!
//! # Known limits
//!
//! - Recordings shorter than the minimum overlap of the search (`min_overlap_s`) are taken to be aligned
//!   to about a frame.
//! - Motion along the epipolar lines of all pairs of a camera leaves its offset undetermined.
//! - A frame lost while nothing moves is attributed to the next image that shows motion.
//! - A frame lost right after the first image or before the last one may be missed. That image's time is
//!   then one frame off.
//! - Cameras that lose frames at about the same time hide each other's losses. Where several places fit
//!   nearly as well, their offsets are unknown.
//! - One rate holds for a whole recording.

mod activity;
mod align;
mod candidates;
mod clock_models;
mod consensus;
mod edited;
mod estimate;
mod features;
pub mod file;
mod joint;
mod lost_frames;
mod mixture;
mod options;
mod pair;
mod pair_fit;
mod pairing;
mod plot;
mod recording;
mod rounds;
mod store;
mod time_order;
mod timeline;
mod uncertainty;
mod zhou_tao;

pub use candidates::{Candidate, ThreeFrames};
pub use consensus::{ransac, weighted_least_squares};
pub use estimate::{Estimate, estimate};
pub use file::{MAX_OFFSETS_BYTES, SavedOffsets};
pub use joint::{ClockEstimate, Clocks, solve_clocks};
pub use mixture::{Mixture, Observation, ResidualModel};
pub use options::{OffsetMethod, OffsetOptions};
pub use pair::{FrameEstimate, PairEstimate, PairFailure};
pub use plot::plot;
pub use recording::Sample;
pub use store::{CameraOffset, Offsets};
pub use zhou_tao::{FourPoints, cross_ratio_offset};

use crate::capture::{Capture, CaptureError};
use crate::host::write_atomically;
use crate::progress::Reporter;
use crate::registration::FrameStore;
pub(crate) use pairing::clocks;
use pairing::spread;

/// The offsets of a capture: known, edited by hand, cached or estimated, in this order; a note on the
/// reporter says which.
///
/// They are known, all 0, if all cameras share one clock. In a static capture, of one frame per camera,
/// all but the reference's are unknown. [`mod@file`] says when those of `offsets.json` are used. Estimated
/// ones are saved there, with their plot in `offsets.svg`; a folder that cannot be written is noted and
/// no error. The error is that of a frame that cannot be read, or of an `offsets.json` that is refused.
pub fn known_or_cached_or_estimated(
    frames: &FrameStore,
    options: &OffsetOptions,
    reporter: &Reporter,
) -> Result<Offsets, CaptureError> {
    if let Some(known) = known(frames.capture(), reporter) {
        return Ok(known);
    }
    match Offsets::saved(frames.capture())? {
        SavedOffsets::Edited(offsets) => {
            reporter.note(
                "offsets.json was edited by hand: its offsets are used as given, not estimated.",
            );
            Ok(offsets)
        }
        saved => cached_or_estimated(frames, options, saved, reporter),
    }
}

/// As [`known_or_cached_or_estimated`], but what the images say: where `offsets.json` was edited by
/// hand, offsets are estimated all the same, and the file is left as it is.
pub fn known_or_estimated(
    frames: &FrameStore,
    options: &OffsetOptions,
    reporter: &Reporter,
) -> Result<Offsets, CaptureError> {
    let capture = frames.capture();
    if let Some(known) = known(capture, reporter) {
        return Ok(known);
    }
    match Offsets::saved(capture)? {
        SavedOffsets::Edited(_) => {
            let estimate = estimate(frames, options, reporter)?;
            reporter.note(
                "Offsets were estimated from the images and not saved: offsets.json was edited by \
                 hand, and is what other commands use until it is deleted.",
            );
            Ok(estimate.offsets)
        }
        saved => cached_or_estimated(frames, options, saved, reporter),
    }
}

/// The offsets of a capture that need no estimate.
fn known(capture: &Capture, reporter: &Reporter) -> Option<Offsets> {
    if clocks(capture).1 == 1 {
        reporter.note("The cameras share one clock: no offsets to estimate.");
        return Some(Offsets::known(capture));
    }
    if capture.is_static() {
        reporter.note("Every camera took one frame, the same at any time: no offsets to estimate.");
        return Some(Offsets::unknown(capture, ONE_FRAME));
    }
    None
}

fn cached_or_estimated(
    frames: &FrameStore,
    options: &OffsetOptions,
    saved: SavedOffsets,
    reporter: &Reporter,
) -> Result<Offsets, CaptureError> {
    let capture = frames.capture();
    let all_options = (options, frames.options());
    let hash = Offsets::hash(capture, &all_options)?;
    if let SavedOffsets::Estimated { offsets, hash: saved, .. } = saved {
        if saved == hash {
            reporter.note("Offsets are those of offsets.json, estimated before.");
            return Ok(offsets);
        }
        reporter.note("offsets.json is of other frames, options or another version: made anew.");
    }
    let estimate = estimate(frames, options, reporter)?;
    // A read-only capture can be used all the same.
    match save(&estimate, capture, &all_options, &hash) {
        Ok(()) => {
            reporter.note(
                "Offsets were estimated from the images and saved in offsets.json, their plot in \
                 offsets.svg.",
            );
        }
        Err(error) => {
            reporter
                .note(&format!("Offsets were estimated from the images but not saved: {error}."));
        }
    }
    Ok(estimate.offsets)
}

/// Writes `offsets.svg`, then `offsets.json`.
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

/// The reason of a camera with a single frame.
const ONE_FRAME: &str = "it has one frame, which shows no motion";

#[cfg(test)]
mod tests {
    use crate::camera::{Camera, CameraModel};
    use nalgebra::Isometry3;

    /// A camera of a row along the x axis, at x metres.
    pub fn camera(x: f64) -> Camera {
        Camera {
            width: 640,
            height: 480,
            model: CameraModel::Pinhole { fx: 686.0, fy: 686.0, cx: 320.0, cy: 240.0 },
            cam_from_world: Isometry3::translation(-x, 0.0, 0.0),
        }
    }
}
