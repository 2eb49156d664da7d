//! §4.1: sparse optical flow between two frames, of one camera (temporal flow) or of two (spatial
//! flow).

use super::{Frame, RegistrationOptions, Tracker};
use nalgebra::{Matrix2, Point2};
use rayon::prelude::*;

/// Pyramid levels of the backward tracking, whose result is near its start.
const BACKWARD_LEVELS: usize = 2;
/// Two initial guesses nearer than this, pixels, lead to the same result.
const SAME_GUESS_PX: f64 = 1.0;
/// Points are tracked in horizontal bands of this height, pixels, whose windows fit the processor's cache.
const BAND_PX: f64 = 24.0;
/// Points that a thread tracks at a time.
const CHUNK: usize = 128;

/// A correspondence between two frames.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Match {
    /// The point in the source frame, pixels.
    pub source: Point2<f64>,
    /// The point in the target frame, pixels.
    pub target: Point2<f64>,
    /// The linear part of the motion around the point: the identity where its window only translated.
    pub deformation: Matrix2<f64>,
    /// Mean absolute difference of the two windows' values (0..=1).
    pub residual: f64,
    /// Forward–backward error: the distance in pixels from `source` to the point that `target` is
    /// tracked back to.
    pub forward_backward_error_px: f64,
}

/// A point in the source frame, and the initial guess of it in the target frame; pixels.
pub type Start = (Point2<f64>, Point2<f64>);

/// Sparse optical flow (§4.1): tracks points from one frame to another, each from its own initial
/// guess, and back again.
///
/// The result is in the order of `starts`, whatever the number of threads. It is `None` where a point
/// is lost or exceeds a threshold of [`RegistrationOptions::consistency`].
pub fn flow(
    source: &Frame,
    target: &Frame,
    starts: &[Start],
    options: &RegistrationOptions,
) -> Vec<Option<Match>> {
    flow_over(source, target, starts, [options.levels, BACKWARD_LEVELS], options)
}

/// As [`flow`], on the given numbers of finest levels, forward and backward.
pub(super) fn flow_over(
    source: &Frame,
    target: &Frame,
    starts: &[Start],
    [levels, backward_levels]: [usize; 2],
    options: &RegistrationOptions,
) -> Vec<Option<Match>> {
    let thresholds = options.consistency();
    let mut order: Vec<u32> = (0..starts.len() as u32).collect();
    order.sort_by_cached_key(|&k| {
        let p = starts[k as usize].0;
        ((p.y / BAND_PX) as i32, p.x as i32)
    });
    let matches: Vec<Option<Match>> = order
        .par_chunks(CHUNK)
        .flat_map_iter(|chunk| {
            let mut tracker = Tracker::new(options);
            chunk
                .iter()
                .map(|&k| {
                    let (from, guess) = starts[k as usize];
                    let [source, target] = [&source.pyramid, &target.pyramid];
                    let tracked = tracker
                        .track_over(source, target, from, guess, levels)
                        .filter(|t| t.residual <= thresholds.residual)?;
                    let to = tracked.position;
                    let back = tracker
                        .track_over(target, source, to, from, backward_levels)
                        .filter(|t| t.residual <= thresholds.residual)?;
                    let forward_backward_error_px = (back.position - from).norm();
                    (forward_backward_error_px <= thresholds.forward_backward_error_px).then_some(
                        Match {
                            source: from,
                            target: to,
                            deformation: Matrix2::identity(),
                            residual: tracked.residual,
                            forward_backward_error_px,
                        },
                    )
                })
                .collect::<Vec<_>>()
        })
        .collect();
    let mut in_order = vec![None; starts.len()];
    for (k, matched) in order.into_iter().zip(matches) {
        in_order[k as usize] = matched;
    }
    in_order
}

/// Whether a guess differs from the last one tried, which would give the same result; records it.
pub(super) fn is_new(tried: &mut Option<Point2<f64>>, guess: Point2<f64>) -> bool {
    let before = tried.replace(guess);
    before.is_none_or(|before| (guess - before).norm() > SAME_GUESS_PX)
}
