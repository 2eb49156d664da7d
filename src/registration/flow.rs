//! §4.1: sparse optical flow between two frames. The frames are from one camera (temporal flow) or from two cameras
//! (spatial flow).

use super::{Frame, KltParameters, RegistrationOptions, Tracked, Tracker};
use nalgebra::{Matrix2, Point2};
use rayon::prelude::*;

/// Number of pyramid levels for tracking backward. The initial guess is close to the result, so that two levels are
/// sufficient.
const BACKWARD_LEVELS: usize = 2;
/// Height, in pixels, of horizontal bands of the image. Points are tracked band by band. The windows of one band fit
/// into the processor's cache.
const BAND_PX: f64 = 24.0;
/// Minimum number of points in one parallel task.
const CHUNK: usize = 128;

/// A correspondence between two frames.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Match {
    /// Position in the source frame, pixels.
    pub source: Point2<f64>,
    /// Position in the target frame, pixels.
    pub target: Point2<f64>,
    /// Linear part (2×2 matrix) of the affine motion around the point. It is the identity if the window was tracked
    /// by translation only.
    pub deformation: Matrix2<f64>,
    /// Mean absolute difference between the grey values (0 to 1) of the windows in the source and the target frame.
    pub residual: f64,
    /// Forward–backward error: the distance, in pixels, from `source` to the position to which `target` is tracked
    /// back.
    pub forward_backward_error_px: f64,
}

/// A point in the source frame, and the initial guess of its position in the target frame. Both are in pixels.
pub type Start = (Point2<f64>, Point2<f64>);

/// Computes sparse optical flow (§4.1): tracks points from one frame to another, each from its own initial guess,
/// and back again.
///
/// Returns one entry per start, in order. The result does not depend on the number of threads. An entry is `None`
/// if the point is lost, or if its residual or its forward–backward error exceeds the threshold of
/// [`RegistrationOptions::consistency`].
pub fn flow(
    source: &Frame,
    target: &Frame,
    starts: &[Start],
    options: &RegistrationOptions,
) -> Vec<Option<Match>> {
    flow_over([source, target], starts, [options.levels, BACKWARD_LEVELS], options)
}

/// Computes [`flow`] with given numbers of pyramid levels for tracking forward and backward. The finest levels are
/// used.
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
