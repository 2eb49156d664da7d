//! §7: the temporal offsets of cameras with clocks of their own.
//!
//! | paper | here |
//! |---|---|
//! | eq. (10), one candidate a feature | [`ThreeFrames::candidates`] |
//! | RANSAC by trying every candidate | [`ransac`] |
//! | WLS, eqs. (11) to (13) | [`weighted_least_squares`] |
//! | choosing frames with 0 ≤ t̃ ≤ Δt, averaging | [`PairEstimate`] |
//! | Zhou and Tao, beside it in Figs. 19 to 22 | [`cross_ratio_offset`] |
//! | Fig. 23 | [`plot`] |
//!
//! Beyond: a mixture fitted by information ([`Residuals`]), rough alignment of recordings started
//! by hand (`align`), lost frames (`lost`, `courses`), and all pairs together with rates and standard errors
//! ([`solve`]).
//!
//! time on the reference's clock = time on the camera's clock + offset: a camera that opens after
//! the reference, both starting at 0 on their own clocks, has a positive offset.
//!
//! Known limits: films shorter than the least overlap of the search are taken to be aligned to
//! about a frame; a frame lost where nothing moves is found at the next image that shows motion;
//! one lost right after a film's first image or before its last may not be found, and that image is
//! then a frame off; what most cameras lose at about the same time they hardly see in each other, and
//! may all be a frame off before it; one rate holds for a whole film.

mod activity;
mod align;
mod candidates;
mod consensus;
mod courses;
mod estimate;
mod features;
mod film;
mod joint;
mod lost;
mod mixture;
mod options;
mod pair;
mod pairing;
mod plot;
mod store;
mod timeline;
mod uncertainty;
mod zhou_tao;

pub use candidates::{Candidate, ThreeFrames};
pub use consensus::{ransac, weighted_least_squares};
pub use estimate::{Estimate, estimate};
pub use film::Sample;
pub use joint::{Clocks, Solved, solve};
pub use mixture::{Mixture, Observation, Residuals};
pub use options::{OffsetMethod, OffsetOptions};
pub use pair::{Blind, FrameEstimate, PairEstimate};
pub use plot::plot;
pub use store::{CameraOffset, Offsets};
pub use zhou_tao::{FourPoints, cross_ratio_offset};

use crate::capture::{Capture, CaptureError};
use crate::host::write_atomically;
use crate::progress::Reporter;
use crate::registration::FrameStore;
pub(crate) use pairing::clocks;
use pairing::spread;

/// The offsets of a capture: none to estimate if all clocks are shared or nothing can move; those
/// cached in its folder if they are of the same capture, frames and options; else estimated now, and
/// cached with their plot. Says which on the reporter.
pub fn known_or_cached_or_estimated(
    frames: &FrameStore,
    options: &OffsetOptions,
    reporter: &Reporter,
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
    let all_options = (options, frames.options());
    let hash = Offsets::hash(capture, &all_options)?;
    if let Some(cached) = Offsets::load(capture, &hash) {
        reporter.note("Offsets are those of offsets.json.");
        return Ok(cached);
    }
    let estimate = estimate(frames, options, reporter)?;
    // A capture that may only be read can be worked with all the same.
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

/// Why a static camera has no offset.
const ONE_FRAME: &str = "it has one frame, which shows no motion";

#[cfg(test)]
mod tests {
    use crate::camera::{Camera, CameraModel};
    use nalgebra::Isometry3;

    /// Of a row of cameras, the one at x metres.
    pub fn camera(x: f64) -> Camera {
        Camera {
            width: 640,
            height: 480,
            model: CameraModel::Pinhole { fx: 686.0, fy: 686.0, cx: 320.0, cy: 240.0 },
            cam_from_world: Isometry3::translation(-x, 0.0, 0.0),
        }
    }
}
