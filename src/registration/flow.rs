//! §4.1: sparse optical flow between two frames, of one camera (temporal flow) or of two (spatial
//! flow).

use super::{Frame, KltParameters, RegistrationOptions, Tracked, Tracker};
use nalgebra::{Matrix2, Point2};
use rayon::prelude::*;

/// Number of pyramid levels for tracking back, where the initial guess is close to the result.
const BACKWARD_LEVELS: usize = 2;
/// Height of the horizontal bands in which points are tracked together, pixels. A band's windows fit the
/// processor's cache.
const BAND_PX: f64 = 24.0;
/// Minimum number of points in one task of a thread.
const CHUNK: usize = 128;

/// A correspondence between two frames.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Match {
    /// The point in the source frame, pixels.
    pub source: Point2<f64>,
    /// The point in the target frame, pixels.
    pub target: Point2<f64>,
    /// The linear part of the motion around the point; the identity where its window is only translated.
    pub deformation: Matrix2<f64>,
    /// Mean absolute difference of the two windows' values (0..=1).
    pub residual: f64,
    /// Forward–backward error: the distance in pixels from `source` to the point that `target` is
    /// tracked back to.
    pub forward_backward_error_px: f64,
}

/// A point in the source frame, and the initial guess of its position in the target frame; pixels.
pub type Start = (Point2<f64>, Point2<f64>);

/// Sparse optical flow (§4.1): tracks points from one frame to another, each from its own initial guess, and
/// back again.
///
/// The result is in the order of `starts`, independent of the number of threads. It is `None` where a point
/// is lost or exceeds a threshold of [`RegistrationOptions::consistency`].
pub fn flow(
    source: &Frame,
    target: &Frame,
    starts: &[Start],
    options: &RegistrationOptions,
) -> Vec<Option<Match>> {
    flow_over([source, target], starts, [options.levels, BACKWARD_LEVELS], options)
}

/// [`flow`] with given numbers of finest pyramid levels, forward and backward.
pub(super) fn flow_over(
    frames: [&Frame; 2],
    starts: &[Start],
    levels: [usize; 2],
    options: &RegistrationOptions,
) -> Vec<Option<Match>> {
    let [source, target] = frames.map(|frame| &frame.pyramid);
    let thresholds = options.consistency();
    let mut order: Vec<usize> = (0..starts.len()).collect();
    order.sort_by_cached_key(|&k| ((starts[k].0.y / BAND_PX) as i32, starts[k].0.x as i32));
    let track = |[there, back]: &mut [Tracker; 2], (from, guess): Start| {
        let is_alike = |tracked: &Tracked| tracked.residual <= thresholds.residual;
        let found = there.track(source, target, from, guess).filter(is_alike)?;
        let returned = back.track(target, source, found.position, from).filter(is_alike)?;
        let forward_backward_error_px = (returned.position - from).norm();
        (forward_backward_error_px <= thresholds.forward_backward_error_px).then_some(Match {
            source: from,
            target: found.position,
            deformation: Matrix2::identity(),
            residual: found.residual,
            forward_backward_error_px,
        })
    };
    let trackers = || levels.map(|levels| Tracker::new(KltParameters { levels, ..options.into() }));
    let matches: Vec<Option<Match>> = order
        .par_iter()
        .with_min_len(CHUNK)
        .map_init(trackers, |trackers, &k| track(trackers, starts[k]))
        .collect();
    let mut in_order = vec![None; starts.len()];
    for (k, matched) in order.into_iter().zip(matches) {
        in_order[k] = matched;
    }
    in_order
}
