//! §6: points of the scene at one instant, from spatial correspondences that are "interpolated to
//! the same instant" and triangulated.

use super::{LightField, RenderError};
use crate::camera::{Camera, EpipolarGeometry};
use crate::lumigraph::triangulate;
use crate::registration::flow;
use nalgebra::{Point2, Point3, Vector2};

/// A feature of a frame, and where it is at the instant, pixels.
#[derive(Clone, Copy, Debug)]
struct Feature {
    in_frame: Point2<f64>,
    at_instant: Point2<f64>,
}

impl LightField {
    /// Points of the scene at a time, as the cameras nearest to the view see them; metres, world.
    pub(super) fn triangulated(
        &self,
        target: &Camera,
        time_s: f64,
    ) -> Result<Vec<Point3<f64>>, RenderError> {
        let options = &self.options().proxy;
        let usable = self.usable(time_s);
        let mut points = Vec::new();
        for &camera in
            nearest(&self.capture().cameras, &usable, target).iter().take(options.cameras)
        {
            let own = &self.capture().cameras[camera].camera;
            let mut partners = nearest(&self.capture().cameras, &usable, own);
            partners.retain(|&j| j != camera);
            partners.truncate(options.partners);
            points.extend(self.points_of(camera, &partners, time_s)?);
        }
        Ok(points)
    }

    fn points_of(
        &self,
        camera: usize,
        partners: &[usize],
        time_s: f64,
    ) -> Result<Vec<Point3<f64>>, RenderError> {
        let options = &self.options().proxy;
        let cameras = &self.capture().cameras;
        let own = &cameras[camera].camera;
        let (frame, features) = self.features(camera, time_s)?;
        let mut seen: Vec<Vec<(&Camera, Point2<f64>)>> =
            features.iter().map(|f| vec![(own, f.at_instant)]).collect();
        for &partner in partners {
            let other = &cameras[partner].camera;
            let Some(geometry) = EpipolarGeometry::new(own, other) else { continue };
            // Where the nearer partners put the point already, look there.
            let guess = |k: usize| -> Vector2<f64> {
                triangulate(&seen[k])
                    .and_then(|t| Some(other.project(&t.point)? - own.project(&t.point)?))
                    .unwrap_or_else(Vector2::zeros)
            };
            let guesses: Vec<_> = (0..features.len()).map(guess).collect();
            let found = self.at_instant_in(partner, &frame, &features, &guesses, time_s)?;
            for ((feature, p), observations) in features.iter().zip(found).zip(&mut seen) {
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

    /// The features of the camera's frame nearest to the instant.
    fn features(
        &self,
        camera: usize,
        time_s: f64,
    ) -> Result<(std::sync::Arc<crate::registration::Frame>, Vec<Feature>), RenderError> {
        let (k, later) = self.bracket(camera, time_s)?;
        let registration = &self.options().registration;
        let times = self.times(camera);
        // A static light field may have no times.
        let use_later = k != later && times[later] - time_s < time_s - times[k];
        if k == later || self.skips(camera, k)? {
            let frame = self.frames().get(camera, if use_later { later } else { k })?;
            let corners = frame.corners(registration);
            let features =
                corners.iter().map(|&p| Feature { in_frame: p, at_instant: p }).collect();
            return Ok((frame, features));
        }
        let frame = self.frames().get(camera, if use_later { later } else { k })?;
        let features = self
            .tracks(camera, k)?
            .iter()
            .filter(|t| if use_later { t.in_backward_set() } else { t.in_forward_set() })
            .filter_map(|t| {
                Some(Feature {
                    in_frame: if use_later { t.later } else { t.earlier },
                    at_instant: t.path(times, k)?.at(time_s),
                })
            })
            .collect();
        Ok((frame, features))
    }

    /// Where features of another camera's frame are in this camera at the instant: matched to
    /// this camera's nearer frame, followed to its other one, and interpolated between the two.
    fn at_instant_in(
        &self,
        camera: usize,
        source: &crate::registration::Frame,
        features: &[Feature],
        disparities: &[Vector2<f64>],
        time_s: f64,
    ) -> Result<Vec<Option<Point2<f64>>>, RenderError> {
        let registration = &self.options().registration;
        let (k, later) = self.bracket(camera, time_s)?;
        let times = self.times(camera);
        // A static light field may have no times.
        let use_later = k != later && times[later] - time_s < time_s - times[k];
        let (near, mut far) = if use_later { (later, k) } else { (k, later) };
        if k != later && self.skips(camera, k)? {
            far = near;
        }
        let near_frame = self.frames().get(camera, near)?;
        let starts: Vec<_> = features
            .iter()
            .zip(disparities)
            .map(|(f, disparity)| (f.in_frame, f.at_instant + disparity))
            .collect();
        let matched = flow(source, &near_frame, &starts, registration);
        if near == far {
            return Ok(matched.into_iter().map(|m| m.map(|m| m.target)).collect());
        }
        let far_frame = self.frames().get(camera, far)?;
        let found: Vec<(usize, Point2<f64>)> =
            matched.iter().enumerate().filter_map(|(n, m)| Some((n, m.as_ref()?.target))).collect();
        // The other camera's feature moves much as this one does.
        let frames_apart = times[far] - times[near];
        let starts: Vec<_> = found
            .iter()
            .map(|&(n, p)| {
                let elapsed = time_s - times[near];
                let f = &features[n];
                let moved = f.at_instant + disparities[n] - p;
                // Near the frame itself the motion can't be told from the disparity's error.
                let share = if elapsed.abs() > 0.25 * frames_apart.abs() {
                    frames_apart / elapsed
                } else {
                    0.0
                };
                let limited = moved * share;
                (
                    p,
                    if disparities[n].norm() > 0.0 && limited.norm() < 30.0 {
                        p + limited
                    } else {
                        p
                    },
                )
            })
            .collect();
        let followed = flow(&near_frame, &far_frame, &starts, registration);
        let mut result = vec![None; features.len()];
        // Times ascend strictly, so the interval is not 0.
        let share = (time_s - times[near]) / frames_apart;
        for ((n, p), followed) in found.into_iter().zip(followed) {
            result[n] = followed.map(|m| p + (m.target - p) * share);
        }
        Ok(result)
    }
}

/// Cameras by the distance of their centres from a view's; ties by index.
fn nearest(
    cameras: &[crate::capture::FilmedCamera],
    usable: &[usize],
    target: &Camera,
) -> Vec<usize> {
    let mut order = usable.to_vec();
    let distance = |c: usize| (cameras[c].camera.center() - target.center()).norm();
    order.sort_by(|&a, &b| distance(a).total_cmp(&distance(b)).then(a.cmp(&b)));
    order
}
