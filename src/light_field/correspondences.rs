//! §6: which features of several cameras show the same point, at all instants between the same frames.

use super::points::Instant;
use super::{LightField, RenderError};
use crate::camera::{Camera, EpipolarGeometry};
use crate::lumigraph::triangulate;
use crate::registration::{Frame, Match, Trajectory, flow};
use nalgebra::{Point2, Vector2};
use std::sync::Arc;

/// The most bytes of correspondences that are cached, those of all cameras and frames together: several times all
/// cameras' around an instant. More only saves matching again; less: cameras that a view needs are matched again
/// for the next instant.
pub(super) const MAX_CACHED_BYTES: usize = 64 << 20;

/// Largest distance of a match from its epipolar line.
const MAX_EPIPOLAR_PX: f64 = 1.0;

/// A step of the interpolation towards the other frame that is longer is not believed, pixels: the
/// disparity that it is extrapolated from was wrong. Larger: matches start far off and are lost;
/// smaller: fast motion is searched for at the wrong place.
const MAX_PREDICTED_MOTION_PX: f64 = 30.0;

/// Nearer to a frame than this fraction of the interval, the motion can't be told from the
/// disparity's error, which is divided by it. Larger: no prediction for most instants; smaller:
/// the error is multiplied by more.
const MIN_PREDICTED_FRACTION: f64 = 0.25;

/// A camera's frames around an instant.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
struct Around {
    camera: usize,
    /// The frame that is nearer in time, and the other one: the same where nothing moves between them.
    near: usize,
    far: usize,
}

/// What the correspondences of a camera depend on, besides what the light field was opened with: its frames and those
/// of its partners.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(super) struct CorrespondencesKey(Vec<Around>);

/// Where a feature is in another camera's nearer and in its farther frame, pixels.
type Matched = [Point2<f64>; 2];

/// A feature of a camera's nearer frame.
#[derive(Clone, Copy, Debug)]
struct Feature {
    in_frame: Point2<f64>,
    /// `None` where nothing moves.
    trajectory: Option<Trajectory>,
}

impl Feature {
    fn at(&self, time_s: f64) -> Point2<f64> {
        self.trajectory.map_or(self.in_frame, |t| t.at(time_s))
    }
}

/// The features of a camera, and where each of its partners sees them.
pub(super) struct Correspondences {
    own: Around,
    features: Vec<Feature>,
    /// By partner, then by feature.
    partners: Vec<(Around, Vec<Option<Matched>>)>,
}

/// Two or more cameras that see a point, and where.
pub(super) type Observations<'a> = Vec<(&'a Camera, Point2<f64>)>;

/// The features of a frame, to be found in another camera.
struct Wanted<'a> {
    frame: &'a Frame,
    features: &'a [Feature],
    /// Their expected displacements between the cameras; 0 where nothing is known.
    disparities: &'a [Vector2<f64>],
    time_s: f64,
}

impl Correspondences {
    /// What sees each feature at a time; of features that no partner sees, the camera itself.
    pub fn observations<'a>(
        &self,
        field: &'a LightField,
        Instant { time_s, .. }: Instant,
    ) -> Vec<Observations<'a>> {
        let own = &field.capture().cameras[self.own.camera].camera;
        let mut seen: Vec<Observations> =
            self.features.iter().map(|f| vec![(own, f.at(time_s))]).collect();
        for (around, matched) in &self.partners {
            field.observe((*around, matched), time_s, &mut seen);
        }
        seen
    }

    fn bytes(&self) -> usize {
        let each = size_of::<Feature>() + self.partners.len() * size_of::<Option<Matched>>();
        self.features.len() * each
    }
}

impl LightField {
    /// The correspondences of a camera with its partners, at all instants between the same frames; cached.
    pub(super) fn correspondences(
        &self,
        camera: usize,
        partners: &[usize],
        instant: Instant,
    ) -> Result<Arc<Correspondences>, RenderError> {
        let cameras = std::iter::once(camera).chain(partners.iter().copied());
        let around: Vec<Around> =
            cameras.map(|c| self.around(c, instant)).collect::<Result<_, _>>()?;
        let key = CorrespondencesKey(around.clone());
        if let Some(known) = self.correspondences.get(&key) {
            return Ok(known);
        }
        // Not the instant: what is cached depends on the key alone.
        let time_s = self.middle_s(&around);
        let found = Arc::new(self.corresponding(&around, time_s)?);
        self.correspondences.insert(key, found.clone(), found.bytes());
        Ok(found)
    }

    /// The middle of the times that are between these frames, and nearer to the nearer ones. 0 if nothing moves.
    fn middle_s(&self, around: &[Around]) -> f64 {
        let moving = around.iter().filter(|a| a.near != a.far);
        let span = moving.map(|a| {
            let times = self.times(a.camera);
            let (near, middle) = (times[a.near], 0.5 * (times[a.near] + times[a.far]));
            [near.min(middle), near.max(middle)]
        });
        let both = span.reduce(|[a, b], [c, d]| [a.max(c), b.min(d)]);
        both.map_or(0.0, |[from, to]| 0.5 * (from + to))
    }

    /// Matches a camera's features, first of these, with its partners, the others, as they are at a time.
    fn corresponding(
        &self,
        around: &[Around],
        time_s: f64,
    ) -> Result<Correspondences, RenderError> {
        let cameras = &self.capture().cameras;
        let own = &cameras[around[0].camera].camera;
        let (frame, features) = self.features(around[0])?;
        let mut seen: Vec<Observations> =
            features.iter().map(|f| vec![(own, f.at(time_s))]).collect();
        let mut partners = Vec::new();
        for &partner in &around[1..] {
            let other = &cameras[partner.camera].camera;
            if EpipolarGeometry::new(own, other).is_none() {
                continue;
            }
            // Where the nearer partners put the point already, look there.
            let disparity = |seen: &Observations| -> Vector2<f64> {
                triangulate(seen)
                    .and_then(|t| Some(other.project(&t.point)? - own.project(&t.point)?))
                    .unwrap_or_else(Vector2::zeros)
            };
            let disparities: Vec<_> = seen.iter().map(disparity).collect();
            let wanted =
                Wanted { frame: &frame, features: &features, disparities: &disparities, time_s };
            let matched = self.matched(partner, &wanted)?;
            self.observe((partner, &matched), time_s, &mut seen);
            partners.push((partner, matched));
        }
        Ok(Correspondences { own: around[0], features, partners })
    }

    /// Adds where a partner sees features at a time, if they are near enough to their epipolar lines.
    fn observe<'a>(
        &'a self,
        (around, matched): (Around, &[Option<Matched>]),
        time_s: f64,
        seen: &mut [Observations<'a>],
    ) {
        let other = &self.capture().cameras[around.camera].camera;
        let Some((own, _)) = seen.first().map(|s| s[0]) else { return };
        let Some(geometry) = EpipolarGeometry::new(own, other) else { return };
        let times = self.times(around.camera);
        let fraction = if around.near == around.far {
            0.0
        } else {
            // Times ascend strictly, so the interval is not 0.
            (time_s - times[around.near]) / (times[around.far] - times[around.near])
        };
        for (seen, matched) in seen.iter_mut().zip(matched) {
            let Some([near, far]) = matched else { continue };
            let p = near + (far - near) * fraction;
            let off_line = (own.model.ideal_from_pixel(&seen[0].1))
                .and_then(|p_i| geometry.line_in_j(&p_i))
                .zip(other.model.ideal_from_pixel(&p))
                .map(|(line, p_j)| line.distance(&p_j).abs());
            if off_line.is_some_and(|d| d <= MAX_EPIPOLAR_PX) {
                seen.push((other, p));
            }
        }
    }

    /// The frame of a camera that is nearer to the instant, and the other one around it.
    fn around(&self, camera: usize, instant: Instant) -> Result<Around, RenderError> {
        let (k, later) = self.bracket(camera, instant.time_s)?;
        let (times, time_s) = (self.times(camera), instant.time_s);
        // A static light field may have no times.
        let use_later = k != later && times[later] - time_s < time_s - times[k];
        let (near, far) = if use_later { (later, k) } else { (k, later) };
        let still_change = instant.options.interpolation.still_change;
        let is_still = k == later || self.is_still(camera, k, still_change)?;
        Ok(Around { camera, near, far: if is_still { near } else { far } })
    }

    /// The features of the camera's nearer frame.
    fn features(
        &self,
        Around { camera, near, far }: Around,
    ) -> Result<(Arc<Frame>, Vec<Feature>), RenderError> {
        let frame = self.frames().get(camera, near)?;
        if near == far {
            let corners = frame.corners(self.frames.options());
            let still = |&in_frame: &Point2<f64>| Feature { in_frame, trajectory: None };
            let features = corners.iter().map(still).collect();
            return Ok((frame, features));
        }
        let (k, use_later) = (near.min(far), near > far);
        let times = self.times(camera);
        let features = self
            .tracks(camera, k)?
            .iter()
            .filter(|t| if use_later { t.in_backward_set() } else { t.in_forward_set() })
            .filter_map(|t| {
                Some(Feature {
                    in_frame: if use_later { t.later } else { t.earlier },
                    trajectory: Some(t.trajectory(times, k)?),
                })
            })
            .collect();
        Ok((frame, features))
    }

    /// Where features of another camera's frame are in this camera: matched to its nearer frame, and followed to
    /// its farther one.
    fn matched(
        &self,
        Around { camera, near, far }: Around,
        wanted: &Wanted,
    ) -> Result<Vec<Option<Matched>>, RenderError> {
        let Wanted { frame: source, features, disparities, time_s } = *wanted;
        let registration = self.frames.options();
        let near_frame = self.frames().get(camera, near)?;
        let expected: Vec<_> =
            features.iter().zip(disparities).map(|(f, d)| f.at(time_s) + d).collect();
        let starts: Vec<_> =
            features.iter().zip(&expected).map(|(f, p)| (f.in_frame, *p)).collect();
        let matches = flow(source, &near_frame, &starts, registration);
        let target = |m: &Match| m.target;
        if near == far {
            return Ok(matches.iter().map(|m| m.as_ref().map(|m| [target(m); 2])).collect());
        }
        let times = self.times(camera);
        // Times ascend strictly, so the interval is not 0.
        let interval_s = times[far] - times[near];
        let elapsed_s = time_s - times[near];
        let far_frame = self.frames().get(camera, far)?;
        let found: Vec<(usize, Point2<f64>)> = (matches.iter().enumerate())
            .filter_map(|(n, m)| Some((n, m.as_ref().map(target)?)))
            .collect();
        // The other camera's feature moves much as this one does.
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
        let followed = flow(&near_frame, &far_frame, &starts, registration);
        let mut result = vec![None; features.len()];
        for ((n, p), followed) in found.into_iter().zip(followed) {
            result[n] = followed.map(|m| [p, m.target]);
        }
        Ok(result)
    }
}
