//! §6: points of the scene at one instant, from spatial correspondences that are "interpolated to
//! the same instant" and triangulated.

use super::{LightField, RenderError};
use crate::camera::Camera;
use crate::capture::FilmedCamera;
use crate::lumigraph::triangulate;
use crate::options::ViewOptions;
use nalgebra::Point3;
use rayon::prelude::*;
use std::collections::BTreeSet;
use std::sync::Arc;

/// How many triangulated points are cached, those of all cameras together: 12 MB of them. More only
/// saves triangulating again for another view of an earlier instant.
pub(super) const MAX_CACHED_POINTS: usize = 1 << 19;

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

/// The instant, and what of a view's options points depend on.
#[derive(Clone, Copy)]
pub(super) struct Instant<'a> {
    pub time_s: f64,
    pub options: &'a ViewOptions,
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
        let key =
            |(camera, partners): &(usize, Vec<usize>)| PointsKey::new(*camera, partners, instant);
        let cameras = self.with_partners(target, instant);
        let cached: Vec<_> = cameras.iter().map(|c| self.points.get(&key(c))).collect();
        if cached.contains(&None) {
            self.load_frames(&cameras, instant)?;
        }
        let of = |(of, cached): (&(usize, Vec<usize>), Option<_>)| -> Result<_, RenderError> {
            if let Some(cached) = cached {
                return Ok(cached);
            }
            let of_camera = Arc::new(self.points_of(of.0, &of.1, instant)?);
            self.points.insert(key(of), of_camera.clone(), of_camera.len());
            Ok(of_camera)
        };
        let of_cameras: Vec<_> =
            cameras.par_iter().zip(cached).map(of).collect::<Result<_, _>>()?;
        Ok(of_cameras.iter().flat_map(|points| points.iter().copied()).collect())
    }

    /// The same without cached points: but for correspondences that are known, it takes as long as for the first view
    /// of an instant.
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

    /// Decodes the frames around an instant that are not cached, of all these cameras and partners: side by side, and
    /// each once. None if the cache doesn't hold all of them.
    fn load_frames(
        &self,
        cameras: &[(usize, Vec<usize>)],
        instant: Instant,
    ) -> Result<(), RenderError> {
        let all: BTreeSet<usize> =
            cameras.iter().flat_map(|(c, partners)| partners.iter().chain([c])).copied().collect();
        if !self.frames.fits(all.iter().copied(), 2) {
            return Ok(());
        }
        all.into_par_iter().try_for_each(|camera| {
            let (k, later) = self.bracket(camera, instant.time_s)?;
            [k, later].into_par_iter().try_for_each(|frame| {
                self.frames().get(camera, frame)?;
                Ok(())
            })
        })
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
        let seen = self.correspondences(camera, partners, instant)?.observations(self, instant);
        Ok(seen
            .iter()
            .filter(|observations| observations.len() > 1)
            .filter_map(|observations| triangulate(observations))
            .filter(|t| t.rms_px <= options.max_error_px)
            .map(|t| t.point)
            .collect())
    }
}

/// Cameras by the distance of their centres from a view's; ties by index.
pub(super) fn nearest(cameras: &[FilmedCamera], usable: &[usize], target: &Camera) -> Vec<usize> {
    let mut order = usable.to_vec();
    let distance = |c: usize| (cameras[c].camera.center() - target.center()).norm();
    order.sort_by(|&a, &b| distance(a).total_cmp(&distance(b)).then(a.cmp(&b)));
    order
}
