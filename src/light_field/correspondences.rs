//! Spatial correspondences (§6): features of several cameras that show the same point. They are computed from each
//! camera's two frames around an instant, the nearer and the farther in time. The result is reused at all instants with
//! the same nearer and farther frames.

use super::RenderError;
use super::frame_pair::is_still;
use super::graph::{LightField, Stage};
use super::stages::{Correspondences, FramesAround, Instant, PairTracks};
use crate::camera::{Camera, EpipolarGeometry};
use crate::lumigraph::triangulate;
use crate::registration::{Frame, Match, Trajectory, flow};
use nalgebra::{Point2, Vector2};
use std::sync::Arc;

/// Maximum length of a feature's predicted motion between another camera's two frames around an instant, pixels. The
/// motion is extrapolated from two positions of the feature in that camera: the match in the nearer frame, and the
/// position at the instant that is expected from the feature's disparity. A longer predicted motion is due to a wrong
/// disparity, and is not used.
const MAX_PREDICTED_MOTION_PX: f64 = 30.0;

/// Minimum time between an instant and the nearer of a camera's two frames around it, as a fraction of the time between
/// the two frames, for predicting a feature's motion by extrapolation. For shorter times, the extrapolation would
/// amplify the error of the feature's disparity too much.
const MIN_PREDICTED_FRACTION: f64 = 0.25;

/// Maximum distance between a feature's match in another camera and the feature's epipolar line at the rendered
/// instant, pixels.
const MAX_EPIPOLAR_PX: f64 = 1.0;

/// Positions of a feature in another camera's two frames around an instant, pixels: in the frame nearer in time, and in
/// the farther frame.
type Matched = [Point2<f64>; 2];

/// A feature of a camera, found in the nearer of the two frames around an instant, with its trajectory.
#[derive(Clone, Copy, Debug)]
struct Feature {
    in_frame: Point2<f64>,
    /// Motion of the feature through the two frames around the instant. `None` if nothing moves between these frames.
    trajectory: Option<Trajectory>,
}

impl Feature {
    fn at(&self, time_s: f64) -> Point2<f64> {
        self.trajectory.map_or(self.in_frame, |t| t.at(time_s))
    }
}

/// The features of a camera, and their matches in its partner cameras. The features are found in the camera's frame
/// that is nearer in time to the instant.
pub(super) struct MatchedFeatures {
    own: FramesAround,
    features: Vec<Feature>,
    /// For each partner camera, its frames around the instant, and the match of each feature in them; `None` if a
    /// feature isn't found.
    partners: Vec<(FramesAround, Vec<Option<Matched>>)>,
}

/// Cameras that see a point, each with the point's position in the camera's image, pixels.
pub(super) type Observations<'a> = Vec<(&'a Camera, Point2<f64>)>;

/// Features of one camera's frame that are searched in another camera's frames.
struct Query<'a> {
    frame: &'a Frame,
    features: &'a [Feature],
    /// Expected displacement of each feature from the image of its own camera to the image of the other camera, pixels;
    /// 0 where unknown.
    disparities: &'a [Vector2<f64>],
    time_s: f64,
}

impl Stage for Correspondences<'_> {
    type Output = MatchedFeatures;
    const NAME: &'static str = "correspondences";

    fn bytes(matched: &MatchedFeatures) -> usize {
        let each = size_of::<Feature>() + matched.partners.len() * size_of::<Option<Matched>>();
        matched.features.len() * each
    }
}

impl Correspondences<'_> {
    pub fn get(&self, field: &LightField) -> Result<Arc<MatchedFeatures>, RenderError> {
        if let Some(cached) = field.cached(self) {
            return Ok(cached);
        }
        let time_s = middle_s(field, &self.around);
        let cameras = &field.capture().cameras;
        let own = &cameras[self.around[0].camera].camera;
        let (frame, features) = self.features(field)?;
        let mut seen: Vec<Observations> =
            features.iter().map(|f| vec![(own, f.at(time_s))]).collect();
        let mut partners = Vec::new();
        for &partner in &self.around[1..] {
            let other = &cameras[partner.camera].camera;
            if EpipolarGeometry::new(own, other).is_none() {
                continue;
            }
            // The search starts at the projection of the point that is triangulated from nearer partners.
            let disparity = |seen: &Observations| -> Vector2<f64> {
                triangulate(seen)
                    .and_then(|t| Some(other.project(&t.point)? - own.project(&t.point)?))
                    .unwrap_or_else(Vector2::zeros)
            };
            let disparities: Vec<_> = seen.iter().map(disparity).collect();
            let query =
                Query { frame: &frame, features: &features, disparities: &disparities, time_s };
            let matched = self.matched(field, partner, &query)?;
            observe(field, partner, &matched, time_s, &mut seen);
            partners.push((partner, matched));
        }
        Ok(field.insert(self, MatchedFeatures { own: self.around[0], features, partners }))
    }
}

/// Returns the observations of each feature at `time_s`, seconds from the capture's start: the cameras that see the
/// feature, with its position in each. The feature's own camera comes first, and partner cameras follow.
pub(super) fn observations<'a>(
    field: &'a LightField,
    matched: &MatchedFeatures,
    time_s: f64,
) -> Vec<Observations<'a>> {
    let own = &field.capture().cameras[matched.own.camera].camera;
    let mut seen: Vec<Observations> =
        matched.features.iter().map(|f| vec![(own, f.at(time_s))]).collect();
    for (around, positions) in &matched.partners {
        observe(field, *around, positions, time_s, &mut seen);
    }
    seen
}

/// Adds the observations of one partner camera at `time_s`, seconds from the capture's start, to `seen`. Observations
/// farther than [`MAX_EPIPOLAR_PX`] from their epipolar lines are skipped.
fn observe<'a>(
    field: &'a LightField,
    around: FramesAround,
    matched: &[Option<Matched>],
    time_s: f64,
    seen: &mut [Observations<'a>],
) {
    let other = &field.capture().cameras[around.camera].camera;
    let Some((own, _)) = seen.first().map(|s| s[0]) else { return };
    let Some(geometry) = EpipolarGeometry::new(own, other) else { return };
    let times = field.frame_times(around.camera);
    let fraction = |near: &Point2<f64>, far: &Point2<f64>| {
        if around.near == around.far {
            return 0.0;
        }
        let near_s = times.at(around.near, near);
        // The divisor is 0 only if a rolling shutter exposes the point in both frames at the same time, so that the
        // point crosses the whole image between them. The position is then infinitely far from the epipolar line.
        (time_s - near_s) / (times.at(around.far, far) - near_s)
    };
    for (seen, matched) in seen.iter_mut().zip(matched) {
        let Some([near, far]) = matched else { continue };
        let p = near + (far - near) * fraction(near, far);
        let off_line = (own.model.ideal_from_pixel(&seen[0].1))
            .and_then(|p_i| geometry.line_in_j(&p_i))
            .zip(other.model.ideal_from_pixel(&p))
            .map(|(line, p_j)| line.distance(&p_j).abs());
        if off_line.is_some_and(|d| d <= MAX_EPIPOLAR_PX) {
            seen.push((other, p));
        }
    }
}

/// Returns the instant for which the correspondences between the frames `around` are computed, seconds from the
/// capture's start. It is the middle of the time interval in which every camera's frame `near` is nearer than its frame
/// `far`. Cameras with `near` equal to `far`, whose images don't change, are ignored. Returns 0 if all cameras are
/// ignored.
fn middle_s(field: &LightField, around: &[FramesAround]) -> f64 {
    let moving = around.iter().filter(|a| a.near != a.far);
    let span = moving.map(|a| {
        let times = field.times_s(a.camera);
        let (near, middle) = (times[a.near], 0.5 * (times[a.near] + times[a.far]));
        [near.min(middle), near.max(middle)]
    });
    let both = span.reduce(|[a, b], [c, d]| [a.max(c), b.min(d)]);
    both.map_or(0.0, |[from, to]| 0.5 * (from + to))
}

/// Returns the two frames of a camera around an instant, the nearer and the farther in time. If nothing moves between
/// them, `near` and `far` are both the nearer frame.
pub(super) fn frames_around(
    field: &LightField,
    camera: usize,
    Instant { time_s, registration, still_change }: Instant,
) -> Result<FramesAround, RenderError> {
    let (frame, later) = field.bracket(camera, time_s)?;
    let times = field.times_s(camera);
    // A static light field may have no times.
    let use_later = frame != later && times[later] - time_s < time_s - times[frame];
    let (near, far) = if use_later { (later, frame) } else { (frame, later) };
    let pair = PairTracks { camera, frame, registration };
    let is_still = frame == later || is_still(field, pair, still_change)?;
    Ok(FramesAround { camera, near, far: if is_still { near } else { far } })
}

impl Correspondences<'_> {
    /// Returns the frame `near` of the first camera in `self.around`, and the features of that frame. If something
    /// moves between the frames `near` and `far`, the features are those that are tracked between them.
    fn features(&self, field: &LightField) -> Result<(Arc<Frame>, Vec<Feature>), RenderError> {
        let FramesAround { camera, near, far } = self.around[0];
        let frame = field.frames(self.registration).get(camera, near)?;
        if near == far {
            let corners = frame.corners(self.registration);
            let still = |&in_frame: &Point2<f64>| Feature { in_frame, trajectory: None };
            let features = corners.iter().map(still).collect();
            return Ok((frame, features));
        }
        let (earlier, use_later) = (near.min(far), near > far);
        let times = field.frame_times(camera);
        let pair = PairTracks { camera, frame: earlier, registration: self.registration };
        let features = pair
            .get(field)?
            .iter()
            .filter(|t| if use_later { t.in_backward_set() } else { t.in_forward_set() })
            .filter_map(|t| {
                Some(Feature {
                    in_frame: if use_later { t.later } else { t.earlier },
                    trajectory: Some(t.trajectory(times, earlier)?),
                })
            })
            .collect();
        Ok((frame, features))
    }

    /// Finds the query's features in another camera's frame `near`, and tracks them from there to that camera's frame
    /// `far`. Returns each feature's positions in both frames; `None` if a feature isn't found.
    fn matched(
        &self,
        field: &LightField,
        FramesAround { camera, near, far }: FramesAround,
        query: &Query,
    ) -> Result<Vec<Option<Matched>>, RenderError> {
        let Query { frame: source, features, disparities, time_s } = *query;
        let frames = field.frames(self.registration);
        let near_frame = frames.get(camera, near)?;
        let expected: Vec<_> =
            features.iter().zip(disparities).map(|(f, d)| f.at(time_s) + d).collect();
        let starts: Vec<_> =
            features.iter().zip(&expected).map(|(f, p)| (f.in_frame, *p)).collect();
        let matches = flow(source, &near_frame, &starts, self.registration);
        let target = |m: &Match| m.target;
        if near == far {
            return Ok(matches.iter().map(|m| m.as_ref().map(|m| [target(m); 2])).collect());
        }
        let times = field.times_s(camera);
        // Times ascend strictly, so the interval is not 0.
        let interval_s = times[far] - times[near];
        let elapsed_s = time_s - times[near];
        let far_frame = frames.get(camera, far)?;
        let found: Vec<(usize, Point2<f64>)> = (matches.iter().enumerate())
            .filter_map(|(n, m)| Some((n, m.as_ref().map(target)?)))
            .collect();
        // The motion to the farther frame is extrapolated from the feature's motion between the nearer frame and its
        // expected position at the instant.
        let starts: Vec<_> = found
            .iter()
            .map(|&(n, p)| {
                let is_near = elapsed_s.abs() <= MIN_PREDICTED_FRACTION * interval_s.abs();
                let predicted =
                    (expected[n] - p) * if is_near { 0.0 } else { interval_s / elapsed_s };
                let is_believed =
                    disparities[n].norm() > 0.0 && predicted.norm() < MAX_PREDICTED_MOTION_PX;
                (p, if is_believed { p + predicted } else { p })
            })
            .collect();
        let followed = flow(&near_frame, &far_frame, &starts, self.registration);
        let mut result = vec![None; features.len()];
        for ((n, p), followed) in found.into_iter().zip(followed) {
            result[n] = followed.map(|m| [p, m.target]);
        }
        Ok(result)
    }
}
