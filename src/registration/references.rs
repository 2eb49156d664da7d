//! §4.3 of the paper: selects the frames of other cameras for the epipolar test of a camera's tracks, by eqs. (4) and
//! (5).

use crate::capture::Capture;

/// A frame of another camera, for the epipolar test of a camera's tracks (§4.2): the match of a tracked feature in this
/// frame must lie on the feature's epipolar line. Eqs. (4) and (5) choose the frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Reference {
    /// Index of the reference camera in the capture.
    pub camera: usize,
    /// Index of the reference camera's frame. If `between` is `None`, it is the frame of eq. (5): of the frames in
    /// [`ReferenceQuery::interval_s`], the nearest to [`ReferenceQuery::time_s`]. Otherwise, it is the last frame
    /// before this interval.
    pub frame: usize,
    /// Instant at which the epipolar constraint is tested, in seconds on the common clock. It is the time of the
    /// reference camera's frame or, if `between` is set, [`ReferenceQuery::time_s`].
    pub time_s: f64,
    /// Times of two frames of the reference camera, in seconds on the common clock: the last frame before
    /// [`ReferenceQuery::interval_s`], which is `frame`, and the first frame after this interval. Set if the reference
    /// camera has no frame within the interval, for example because its frame rate is lower. Features are tracked
    /// between the two frames, and their positions are interpolated at `time_s`.
    pub between: Option<[f64; 2]>,
}

/// The frames of other cameras that test a camera's tracks between two of its frames by the epipolar constraint.
/// `first` and `further` are sorted by the paper's eq. (4): a weighted distance in space and time, nearest first.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct References {
    /// At most two references. The directions of their baselines to the tested camera differ by at least 45°. Each
    /// of them tests every track.
    pub first: Vec<Reference>,
    /// At most one further reference. It tests only the tracks that the references in `first` cannot test.
    pub further: Vec<Reference>,
}

/// The input of [`select_references`]: the camera whose tracks are tested, and the frame interval and flow direction of
/// the tracks.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ReferenceQuery {
    /// Index of the camera whose tracks are tested: i of eq. (4).
    pub camera: usize,
    /// Times t and t + Δt of the tracks' two frames, in seconds on the common clock.
    pub interval_s: [f64; 2],
    /// The time to which eq. (5) selects the nearest frame of each other camera, in seconds on the common clock: t + Δt
    /// for the forward flow, t for the backward flow.
    pub time_s: f64,
}

/// σ of eq. (4): the weight of a reference's time difference, in frame intervals. The weight of its distance, in units
/// of the distance to the nearest camera, is 1. Larger: near times count more than near cameras.
const TIME_WEIGHT: f64 = 1.0;
/// Maximum number of references in [`References::first`]. On a grid of cameras, one of them is in the same row as
/// the tested camera and one in the same column.
const MAX_FIRST: usize = 2;
/// Maximum number of references in [`References::further`].
const MAX_FURTHER: usize = 1;
/// Maximum time between the two frames of [`Reference::between`], in frame intervals of the tested camera. A camera
/// with a longer gap between these frames is no reference.
const MAX_GAP_FRAMES: f64 = 4.0;

/// Maximum absolute cosine of the angle between the baselines of two references in [`References::first`]: 45°.
const MAX_BASELINE_COSINE: f64 = 0.707;

impl Reference {
    /// Selects a camera's frame by eq. (5): the frame within the queried interval that is nearest to the queried time.
    /// If no frame is within the interval, selects the frames before and after the interval.
    ///
    /// Returns two values: the time in seconds between the queried time and the nearest selected frame, and the
    /// reference. Returns `None` if there is neither a frame within the interval nor one on each side of it, or if the
    /// frames on both sides are more than [`MAX_GAP_FRAMES`] apart.
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

/// Selects the references for testing a camera's tracks (§4.3): the frames of other cameras with the smallest weights
/// `w_j = D(j) + σ|t_j − t|`, eq. (4). D(j) is the distance from camera j to the tested camera, divided by the distance
/// from the nearest camera to the tested camera. t_j is the time of camera j's frame, and t is
/// [`ReferenceQuery::time_s`], both in frame intervals of the tested camera.
///
/// In a grid of cameras there are two first references, whose baselines differ in direction by at least 45°. In a line
/// of cameras there is one first reference. The further reference is the frame of the remaining camera with the
/// smallest weight. If a camera has no frame in the interval, the frames before and after the interval are used, and
/// the nearer frame determines the weight.
///
/// `times_s[j]` holds camera j's frame times in seconds on the common clock. It is `None` if the camera's clock is
/// unknown; such a camera is not selected. Returns no references if the interval is empty, or if all cameras have the
/// same centre.
///
/// # Panics
/// If the capture has no camera `query.camera`.
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
