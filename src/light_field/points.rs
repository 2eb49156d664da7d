//! §6: points of the scene at one instant, from spatial correspondences that are "interpolated to
//! the same instant" and triangulated.

use super::{LightField, RenderError};
use crate::camera::{Camera, EpipolarGeometry};
use crate::capture::FilmedCamera;
use crate::lumigraph::triangulate;
use crate::options::ViewOptions;
use crate::registration::{Frame, Match, flow};
use nalgebra::{Point2, Point3, Vector2};
use std::sync::Arc;

/// How many triangulated points are cached, those of all cameras together: 12 MB of them. More only
/// saves triangulating again for another view of an earlier instant.
pub(super) const MAX_CACHED_POINTS: usize = 1 << 19;

/// A step of the interpolation towards the other frame that is longer is not believed, pixels: the
/// disparity that it is extrapolated from was wrong. Larger: matches start far off and are lost;
/// smaller: fast motion is searched for at the wrong place.
const MAX_PREDICTED_MOTION_PX: f64 = 30.0;

/// Nearer to a frame than this fraction of the interval, the motion can't be told from the
/// disparity's error, which is divided by it. Larger: no prediction for most instants; smaller:
/// the error is multiplied by more.
const MIN_PREDICTED_FRACTION: f64 = 0.25;

/// All that the points of a camera depend on, besides what the light field was opened with.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(super) struct PointsKey {
    camera: usize,
    partners: Vec<usize>,
    /// The time and the options, bit by bit.
    numbers: [u64; 4],
}

impl PointsKey {
    fn new(camera: usize, partners: &[usize], Instant { time_s, options }: Instant) -> Self {
        let (epipolar, error) = (options.proxy.max_epipolar_px, options.proxy.max_error_px);
        let still_change = f64::from(options.interpolation.still_change);
        let numbers = [time_s, epipolar, error, still_change].map(f64::to_bits);
        Self { camera, partners: partners.to_vec(), numbers }
    }
}

/// A feature of a frame, and where it is at the instant, pixels.
#[derive(Clone, Copy, Debug)]
struct Feature {
    in_frame: Point2<f64>,
    at_instant: Point2<f64>,
}

/// The features of a frame, to be found in another camera.
struct Features<'a> {
    frame: &'a Frame,
    features: &'a [Feature],
    /// Their expected displacements between the cameras at the instant; 0 where nothing is known.
    disparities: &'a [Vector2<f64>],
}

/// A camera's frames around an instant.
struct Around {
    /// The frame that is nearer in time, and the other one: the same where nothing moves between them.
    near: usize,
    far: usize,
}

/// The instant, and what of a view's options points depend on.
#[derive(Clone, Copy)]
struct Instant<'a> {
    time_s: f64,
    options: &'a ViewOptions,
}

impl LightField {
    /// Points of the scene at a time, as the cameras nearest to the view see them; metres, world.
    /// Those of each camera are cached: other views of the same instant start from the same points.
    pub(crate) fn points(
        &self,
        target: &Camera,
        time_s: f64,
        options: &ViewOptions,
    ) -> Result<Vec<Point3<f64>>, RenderError> {
        let instant = Instant { time_s, options };
        let mut points = Vec::new();
        for (camera, partners) in self.with_partners(target, instant) {
            let key = PointsKey::new(camera, &partners, instant);
            let of_camera = match self.points.get(&key) {
                Some(cached) => cached,
                None => {
                    let of_camera = Arc::new(self.points_of(camera, &partners, instant)?);
                    self.points.insert(key, of_camera.clone(), of_camera.len());
                    of_camera
                }
            };
            points.extend_from_slice(&of_camera);
        }
        Ok(points)
    }

    /// The same without the cache: it takes as long as for the first view of an instant.
    pub(super) fn uncached_points(
        &self,
        target: &Camera,
        time_s: f64,
        options: &ViewOptions,
    ) -> Result<Vec<Point3<f64>>, RenderError> {
        let instant = Instant { time_s, options };
        let mut points = Vec::new();
        for (camera, partners) in self.with_partners(target, instant) {
            points.extend(self.points_of(camera, &partners, instant)?);
        }
        Ok(points)
    }

    /// The cameras nearest to a view, each with those that its features are matched with.
    fn with_partners(
        &self,
        target: &Camera,
        Instant { time_s, options }: Instant,
    ) -> Vec<(usize, Vec<usize>)> {
        let usable = self.usable(time_s);
        let cameras = &self.capture().cameras;
        let with = |camera: usize| {
            let mut partners = nearest(cameras, &usable, &cameras[camera].camera);
            partners.retain(|&j| j != camera);
            partners.truncate(options.proxy.partners);
            (camera, partners)
        };
        let near = nearest(cameras, &usable, target);
        near.into_iter().take(options.proxy.cameras).map(with).collect()
    }

    fn points_of(
        &self,
        camera: usize,
        partners: &[usize],
        instant: Instant,
    ) -> Result<Vec<Point3<f64>>, RenderError> {
        let options = &instant.options.proxy;
        let cameras = &self.capture().cameras;
        let own = &cameras[camera].camera;
        let (frame, features) = self.features(camera, instant)?;
        let mut seen: Vec<Vec<(&Camera, Point2<f64>)>> =
            features.iter().map(|f| vec![(own, f.at_instant)]).collect();
        for &partner in partners {
            let other = &cameras[partner].camera;
            let Some(geometry) = EpipolarGeometry::new(own, other) else { continue };
            // Where the nearer partners put the point already, look there.
            let disparity = |k: usize| -> Vector2<f64> {
                triangulate(&seen[k])
                    .and_then(|t| Some(other.project(&t.point)? - own.project(&t.point)?))
                    .unwrap_or_else(Vector2::zeros)
            };
            let disparities: Vec<_> = (0..features.len()).map(disparity).collect();
            let wanted = Features { frame: &frame, features: &features, disparities: &disparities };
            let matched = self.matched(partner, &wanted, instant)?;
            for ((feature, p), observations) in features.iter().zip(matched).zip(&mut seen) {
                let Some(p) = p else { continue };
                let off_line = own
                    .model
                    .ideal_from_pixel(&feature.at_instant)
                    .and_then(|p_i| geometry.line_in_j(&p_i))
                    .zip(other.model.ideal_from_pixel(&p))
                    .map(|(line, p_j)| line.distance(&p_j).abs());
                if off_line.is_some_and(|d| d <= options.max_epipolar_px) {
                    observations.push((other, p));
                }
            }
        }
        Ok(seen
            .iter()
            .filter(|observations| observations.len() > 1)
            .filter_map(|observations| triangulate(observations))
            .filter(|t| t.rms_px <= options.max_error_px)
            .map(|t| t.point)
            .collect())
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
        Ok(Around { near, far: if is_still { near } else { far } })
    }

    /// The features of the camera's frame nearest to the instant.
    fn features(
        &self,
        camera: usize,
        instant: Instant,
    ) -> Result<(Arc<Frame>, Vec<Feature>), RenderError> {
        let Around { near, far } = self.around(camera, instant)?;
        let frame = self.frames.get(camera, near)?;
        if near == far {
            let corners = frame.corners(self.frames.options());
            let features =
                corners.iter().map(|&p| Feature { in_frame: p, at_instant: p }).collect();
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
                    at_instant: t.trajectory(times, k)?.at(instant.time_s),
                })
            })
            .collect();
        Ok((frame, features))
    }

    /// Where features of another camera's frame are in this camera at the instant, pixels: matched
    /// to this camera's nearer frame, followed to its other one, and interpolated between the two.
    fn matched(
        &self,
        camera: usize,
        wanted: &Features,
        instant: Instant,
    ) -> Result<Vec<Option<Point2<f64>>>, RenderError> {
        let Features { frame: source, features, disparities } = *wanted;
        let registration = self.frames.options();
        let Around { near, far } = self.around(camera, instant)?;
        let near_frame = self.frames.get(camera, near)?;
        let starts: Vec<_> = features
            .iter()
            .zip(disparities)
            .map(|(f, disparity)| (f.in_frame, f.at_instant + disparity))
            .collect();
        let matches = flow(source, &near_frame, &starts, registration);
        let target = |m: &Option<Match>| m.as_ref().map(|m| m.target);
        if near == far {
            return Ok(matches.iter().map(target).collect());
        }
        let times = self.times(camera);
        // Times ascend strictly, so the interval is not 0.
        let interval_s = times[far] - times[near];
        let elapsed_s = instant.time_s - times[near];
        let far_frame = self.frames.get(camera, far)?;
        let found: Vec<(usize, Point2<f64>)> =
            matches.iter().enumerate().filter_map(|(n, m)| Some((n, target(m)?))).collect();
        // The other camera's feature moves much as this one does.
        let starts: Vec<_> = found
            .iter()
            .map(|&(n, p)| {
                let moved = features[n].at_instant + disparities[n] - p;
                let is_near = elapsed_s.abs() <= MIN_PREDICTED_FRACTION * interval_s.abs();
                let predicted = moved * if is_near { 0.0 } else { interval_s / elapsed_s };
                let is_believed =
                    disparities[n].norm() > 0.0 && predicted.norm() < MAX_PREDICTED_MOTION_PX;
                (p, if is_believed { p + predicted } else { p })
            })
            .collect();
        let followed = flow(&near_frame, &far_frame, &starts, registration);
        let mut result = vec![None; features.len()];
        let fraction = elapsed_s / interval_s;
        for ((n, p), followed) in found.into_iter().zip(followed) {
            result[n] = followed.map(|m| p + (m.target - p) * fraction);
        }
        Ok(result)
    }
}

/// Cameras by the distance of their centres from a view's; ties by index.
pub(super) fn nearest(cameras: &[FilmedCamera], usable: &[usize], target: &Camera) -> Vec<usize> {
    let mut order = usable.to_vec();
    let distance = |c: usize| (cameras[c].camera.center() - target.center()).norm();
    order.sort_by(|&a, &b| distance(a).total_cmp(&distance(b)).then(a.cmp(&b)));
    order
}
