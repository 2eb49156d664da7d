//! §7: the temporal offsets of cameras with clocks of their own.
//!
//! | paper | here |
//! |---|---|
//! | eq. (10), one candidate a feature | [`ThreeFrames::candidates`] |
//! | RANSAC by trying every candidate | [`ransac`] |
//! | WLS, eqs. (11) to (13) | [`weighted_least_squares`] |
//! | choosing frames with 0 ≤ t̃ ≤ Δt, averaging | [`estimate_pair`] |
//! | beyond: all pairs together | [`solve`] |
//!
//! time on the reference's clock = time on the camera's clock + offset: a camera that opens after
//! the reference, both starting at 0 on their own clocks, has a positive offset.
//!
//! Known limits: recordings must be aligned to about a frame (rough alignment over seconds, drift
//! and lost frames are not estimated).

mod candidates;
mod consensus;
mod joint;
mod options;
mod pair;
mod store;

pub use candidates::{Candidate, ThreeFrames};
pub use consensus::{ransac, weighted_least_squares};
pub use joint::{Solved, solve};
pub use options::{OffsetOptions, OffsetRung};
pub use pair::{FrameEstimate, PairEstimate, Tracks, estimate_pair};
pub use store::{CameraOffset, Offsets};

use crate::capture::{Capture, CaptureError};
use crate::progress::Reporter;
use crate::registration::{FrameStore, RegistrationOptions, temporal_flow};
use rayon::prelude::*;
use std::sync::Arc;

/// Offsets with what they were made of.
#[derive(Clone, Debug)]
pub struct Estimate {
    pub offsets: Offsets,
    pub pairs: Vec<PairEstimate>,
}

/// The offsets of a capture: none to estimate if all clocks are shared; those kept in its folder
/// if they are of the same capture, frames and options; else estimated now, and kept. Says which.
pub fn known_or_kept_or_estimated(
    capture: &Arc<Capture>,
    options: &OffsetOptions,
    registration: &RegistrationOptions,
    reporter: &Reporter,
) -> Result<Offsets, CaptureError> {
    if clocks(capture).1 == 1 {
        reporter.note("The cameras share one clock: no offsets to estimate.");
        return Ok(Offsets::known(capture));
    }
    let all_options = (options, registration);
    let hash = Offsets::hash(capture, &all_options)?;
    if let Some(kept) = Offsets::load(capture, &hash) {
        reporter.note("Offsets are those kept in offsets.json.");
        return Ok(kept);
    }
    let offsets = estimate(capture, options, registration, reporter)?.offsets;
    // A capture that may only be read can be worked with all the same.
    match offsets.save(capture, &all_options, &hash) {
        Ok(()) => {
            reporter.note("Offsets were estimated from the images and kept in offsets.json.");
        }
        Err(error) => {
            reporter
                .note(&format!("Offsets were estimated from the images but not kept: {error}."));
        }
    }
    Ok(offsets)
}

/// Estimates all offsets of a capture from its pixels.
pub fn estimate(
    capture: &Arc<Capture>,
    options: &OffsetOptions,
    registration: &RegistrationOptions,
    reporter: &Reporter,
) -> Result<Estimate, CaptureError> {
    let mut registration = registration.clone();
    registration.corners.max_corners = registration.corners.max_corners.min(options.max_features);
    let frames = &FrameStore::new(capture.clone(), &registration);
    let (clock, clocks) = clocks(capture);
    if clocks == 1 {
        return Ok(Estimate { offsets: Offsets::known(capture), pairs: Vec::new() });
    }
    let pairs = pairs(capture, &clock, options);
    let tracks = tracks(frames, &pairs, options, reporter)?;
    let task = reporter.task("Offsets", pairs.len());
    let estimates: Vec<Option<PairEstimate>> = pairs
        .par_iter()
        .map(|&pair| {
            let estimate = estimate_pair(frames, &tracks, pair, options);
            task.advance(1);
            estimate
        })
        .collect::<Result<_, _>>()?;
    let certain_s = options.max_std_err_frames * capture.frame_s();
    let used: Vec<PairEstimate> =
        estimates.into_iter().flatten().filter(|p| p.std_err_s <= certain_s).collect();
    let solved = solve(&used, &clock, clocks);
    let cameras = capture
        .cameras
        .iter()
        .enumerate()
        .map(|(c, camera)| {
            let found = solved[clock[c]].filter(|s| s.std_err_s <= certain_s);
            CameraOffset {
                id: camera.id.clone(),
                offset_s: found.map(|s| s.offset_s),
                std_err_s: found.map(|s| s.std_err_s),
                reason: found.is_none().then(|| reason(capture, c, &pairs, &used)),
            }
        })
        .collect();
    let reference = capture.cameras[capture.reference].id.clone();
    Ok(Estimate { offsets: Offsets { reference, cameras }, pairs: used })
}

fn reason(capture: &Capture, camera: usize, pairs: &[[usize; 2]], used: &[PairEstimate]) -> String {
    let of_camera = |pair: &[usize; 2]| pair.contains(&camera);
    if used.iter().any(|p| of_camera(&p.cameras)) {
        "its pairs are not connected to the reference camera, or disagree".into()
    } else if capture.cameras[camera].frames.len() == 1 {
        "it has one frame, which shows no motion".into()
    } else if pairs.iter().any(of_camera)
        && !pairs.iter().filter(|p| of_camera(p)).any(|p| overlap(capture, p))
    {
        "its neighbours filmed at other times, by its clock and theirs".into()
    } else if pairs.iter().any(of_camera) {
        "too few features move across the epipolar lines of its neighbours".into()
    } else {
        "no other camera stands at another place".into()
    }
}

/// Whether two cameras filmed at the same time to about a frame, by their own clocks.
fn overlap(capture: &Capture, &[a, b]: &[usize; 2]) -> bool {
    let span = |c: usize| {
        let clock = &capture.cameras[c].clock;
        let slack = clock.frame_s();
        (clock.times_s[0] - slack, clock.times_s[clock.times_s.len() - 1] + slack)
    };
    let (a, b) = (span(a), span(b));
    a.0 <= b.1 && b.0 <= a.1
}

/// The clock of each camera, the reference's being 0, and how many there are. The reference's
/// clock is that of all cameras that share one, if it does.
fn clocks(capture: &Capture) -> (Vec<usize>, usize) {
    let reference_shares = capture.cameras[capture.reference].clock.shared;
    let mut next = 1;
    let mut shared = reference_shares.then_some(0);
    let mut clock = Vec::with_capacity(capture.cameras.len());
    for (c, camera) in capture.cameras.iter().enumerate() {
        let mut fresh = || {
            next += 1;
            next - 1
        };
        clock.push(if c == capture.reference {
            0
        } else if camera.clock.shared {
            *shared.get_or_insert_with(fresh)
        } else {
            fresh()
        });
    }
    (clock, next)
}

/// The pairs to estimate: every camera with its nearest ones; for the paper's rung, with the
/// reference.
fn pairs(capture: &Capture, clock: &[usize], options: &OffsetOptions) -> Vec<[usize; 2]> {
    let centers: Vec<_> = capture.cameras.iter().map(|c| c.camera.center()).collect();
    let mut pairs: Vec<[usize; 2]> = Vec::new();
    for a in 0..centers.len() {
        let mut others: Vec<usize> = (0..centers.len())
            .filter(|&b| clock[a] != clock[b] && (centers[b] - centers[a]).norm() > 0.0)
            .collect();
        if options.rung == OffsetRung::Pairwise {
            others.retain(|&b| b == capture.reference);
        }
        others.sort_by(|&x, &y| {
            let d = |b: usize| (centers[b] - centers[a]).norm();
            d(x).total_cmp(&d(y)).then(x.cmp(&y))
        });
        // Both sides of a line, and ties of a grid: as many again as lie as near.
        let reach = others
            .get(options.neighbors.saturating_sub(1).min(others.len().wrapping_sub(1)))
            .map_or(0.0, |&b| (centers[b] - centers[a]).norm());
        pairs.extend(
            others
                .into_iter()
                .filter(|&b| (centers[b] - centers[a]).norm() <= reach * (1.0 + 1e-6))
                .map(|b| [a.min(b), a.max(b)]),
        );
    }
    pairs.sort_unstable();
    pairs.dedup();
    pairs
}

/// The temporal tracks of the cameras in the pairs, at the frames that are used.
fn tracks(
    frames: &FrameStore,
    pairs: &[[usize; 2]],
    options: &OffsetOptions,
    reporter: &Reporter,
) -> Result<Tracks, CaptureError> {
    let capture = frames.capture();
    let wanted: Vec<(usize, usize)> = (0..capture.cameras.len())
        .filter(|c| pairs.iter().any(|p| p.contains(c)))
        .flat_map(|c| {
            let intervals = capture.cameras[c].frames.len().saturating_sub(1);
            spread(intervals, options.max_frames).into_iter().map(move |k| (c, k))
        })
        .collect();
    let task = reporter.task("Tracks", wanted.len());
    let found: Vec<_> = wanted
        .par_iter()
        .map(|&(c, k)| {
            let tracks = temporal_flow(frames, c, k);
            task.advance(1);
            tracks
        })
        .collect::<Result<_, _>>()?;
    let mut all: Tracks =
        capture.cameras.iter().map(|c| vec![None; c.frames.len().saturating_sub(1)]).collect();
    for ((c, k), tracks) in wanted.into_iter().zip(found) {
        all[c][k] = Some(tracks);
    }
    Ok(all)
}

/// `count` of the numbers below `n` at most, evenly spread.
fn spread(n: usize, count: usize) -> Vec<usize> {
    if n <= count {
        return (0..n).collect();
    }
    (0..count).map(|k| (2 * k + 1) * n / (2 * count)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_are_spread_evenly() {
        assert_eq!(spread(3, 5), [0, 1, 2]);
        assert_eq!(spread(10, 5), [1, 3, 5, 7, 9]);
        assert!(spread(0, 5).is_empty() && spread(5, 0).is_empty());
    }
}
