//! §4.3: selects the reference cameras for the epipolar test of a camera's tracks, eqs. (4) and (5).

use crate::capture::Capture;

/// A frame of another camera with which a camera's tracks are tested (§4.2), chosen by eqs. (4) and (5).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Reference {
    /// Index of the camera.
    pub camera: usize,
    /// Index of the camera's frame: that of eq. (5); if `between` is set, the last frame before the interval.
    pub frame: usize,
    /// Instant at which the epipolar constraint is tested, seconds on the common clock: the time of the frame
    /// or, if `between` is set, [`ReferenceQuery::time_s`].
    pub time_s: f64,
    /// Set for a camera of a lower frame rate without a frame in the interval: the times, seconds, of the
    /// last frame before the interval (`frame`) and of the first after it. Features are tracked between these
    /// two, and their positions are interpolated at `time_s`.
    pub between: Option<[f64; 2]>,
}

/// The references for a camera's flow between two frames, by ascending weight of eq. (4).
#[derive(Clone, Debug, Default, PartialEq)]
pub struct References {
    /// At most two references, with baselines at least 45° apart. Each of them tests every track.
    pub first: Vec<Reference>,
    /// At most one further reference. It tests the tracks that the first references cannot test.
    pub further: Vec<Reference>,
}

/// A flow between two frames of a camera, for which references are to be selected.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ReferenceQuery {
    /// Index of the camera whose tracks are tested: i of eq. (4).
    pub camera: usize,
    /// Times of its two frames, t and t + Δt, seconds on the common clock.
    pub interval_s: [f64; 2],
    /// The time to which eq. (5) seeks the nearest frame: t + Δt for the forward flow, t for the backward
    /// flow.
    pub time_s: f64,
}

/// σ of eq. (4): the weight of a time difference of one frame interval, relative to the weight of the nearest
/// camera's distance.
const TIME_WEIGHT: f64 = 1.0;
/// Maximum number of first references: on a grid, one along the row and one along the column.
const MAX_FIRST: usize = 2;
/// Maximum number of further references. They test only tracks that the first references neither accept nor reject.
const MAX_FURTHER: usize = 1;
/// Maximum time between the two frames of [`Reference::between`], in frame intervals of the tested camera.
const MAX_GAP_FRAMES: f64 = 4.0;

/// Maximum cosine of the angle between the baselines of two first references: 45°.
const MAX_BASELINE_COSINE: f64 = 0.707;

impl Reference {
    /// Eq. (5): the frame within the interval that is nearest to the queried time, else the two frames around
    /// the interval. The first result is the distance in time of the nearest frame, seconds. `None` if the
    /// camera has neither, or if the two are farther apart than [`MAX_GAP_FRAMES`].
    fn nearest(camera: usize, times: &[f64], query: &ReferenceQuery) -> Option<(f64, Self)> {
        let ([t1, t2], t) = (query.interval_s, query.time_s);
        let within = times.iter().enumerate().filter(|&(_, &tj)| tj >= t1 && tj <= t2);
        let nearest = within.min_by(|a, b| (a.1 - t).abs().total_cmp(&(b.1 - t).abs()));
        if let Some((frame, &time_s)) = nearest {
            return Some(((time_s - t).abs(), Self { camera, frame, time_s, between: None }));
        }
        let frame = times.partition_point(|&tj| tj < t1).checked_sub(1)?;
        let (a, b) = (times[frame], *times.get(frame + 1)?);
        let distance_s = (t - a).min(b - t);
        (b - a <= MAX_GAP_FRAMES * (t2 - t1))
            .then_some((distance_s, Self { camera, frame, time_s: t, between: Some([a, b]) }))
    }
}

/// Selects the references for a flow (§4.3): the frames of the smallest weight `w_j = D(j) + σ|t_j − t|`, eq.
/// (4). D is the distance of the cameras' centres, divided by that of the nearest camera; times are in frame
/// intervals.
///
/// In a grid of cameras there are two first references, with baselines at least 45° apart; in a line of
/// cameras there is one. The further reference is the remaining camera of the smallest weight. With a camera
/// that has no frame in the interval, tracks are tested between the frames before and after it, and the
/// nearer one determines the weight.
///
/// `times_s[j]` are camera j's frame times in seconds on the common clock, `None` if its clock is unknown;
/// such a camera is no reference. There are no references if the interval is empty, or if all cameras have
/// the same centre.
///
/// # Panics
/// If the capture has no such camera.
pub fn select_references(
    capture: &Capture,
    times_s: &[Option<Vec<f64>>],
    query: &ReferenceQuery,
) -> References {
    let i = query.camera;
    let here = capture.cameras[i].camera.center();
    let baselines: Vec<_> = capture.cameras.iter().map(|c| c.camera.center() - here).collect();
    let nearest =
        baselines.iter().map(|b| b.norm()).filter(|&d| d > 0.0).fold(f64::INFINITY, f64::min);
    let frame_s = query.interval_s[1] - query.interval_s[0];
    if !(nearest.is_finite() && frame_s > 0.0) {
        return References::default();
    }
    let candidate = |(j, times): (usize, &Option<Vec<f64>>)| {
        let times = times.as_ref().filter(|_| j != i && baselines[j].norm() > 0.0)?;
        let (distance_s, reference) = Reference::nearest(j, times, query)?;
        let w = baselines[j].norm() / nearest + TIME_WEIGHT * distance_s / frame_s;
        Some((w, reference))
    };
    let mut candidates: Vec<(f64, Reference)> =
        times_s.iter().enumerate().filter_map(candidate).collect();
    candidates.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.camera.cmp(&b.1.camera)));
    let mut references = References::default();
    for (_, candidate) in candidates {
        let direction = baselines[candidate.camera].normalize();
        let is_across = references
            .first
            .iter()
            .all(|c| baselines[c.camera].normalize().dot(&direction).abs() < MAX_BASELINE_COSINE);
        if is_across && references.first.len() < MAX_FIRST {
            references.first.push(candidate);
        } else if references.further.len() < MAX_FURTHER {
            references.further.push(candidate);
        }
    }
    references
}
