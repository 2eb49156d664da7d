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

/// Largest reprojection error of a point (root mean square).
const MAX_REPROJECTION_ERROR_PX: f64 = 0.7;

/// All that the points of a camera depend on, besides what the light field was opened with.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(super) struct PointsKey {
    camera: usize,
    partners: Vec<usize>,
    /// The time and the options, bit by bit.
    numbers: [u64; 2],
}

impl PointsKey {
    fn new(camera: usize, partners: &[usize], Instant { time_s, options }: Instant) -> Self {
        let still_change = f64::from(options.interpolation.still_change);
        let numbers = [time_s, still_change].map(f64::to_bits);
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
        self.points_by(target, Instant { time_s, options }, true)
    }

    /// The same without cached points: but for correspondences that are known, it takes as long as for the first view
    /// of an instant.
    pub(super) fn uncached_points(
        &self,
        target: &Camera,
        time_s: f64,
        options: &ViewOptions,
    ) -> Result<Vec<Point3<f64>>, RenderError> {
        self.points_by(target, Instant { time_s, options }, false)
    }

    fn points_by(
        &self,
        target: &Camera,
        instant: Instant,
        cached: bool,
    ) -> Result<Vec<Point3<f64>>, RenderError> {
        // Once: threads that need them at the same time would all estimate them.
        self.gains();
        let cameras = self.with_partners(target, instant);
        let key = |of: &(usize, Vec<usize>)| PointsKey::new(of.0, &of.1, instant);
        let known: Vec<Option<Arc<Vec<Point3<f64>>>>> =
            cameras.iter().map(|c| self.points.get(&key(c)).filter(|_| cached)).collect();
        let unknown = cameras.iter().zip(&known).filter(|(_, known)| known.is_none());
        self.load_frames(unknown.map(|(camera, _)| camera), instant)?;
        let of = |(of, known): (&(usize, Vec<usize>), _)| -> Result<_, RenderError> {
            if let Some(known) = known {
                return Ok(known);
            }
            let found = Arc::new(self.points_of(of.0, &of.1, instant)?);
            if cached {
                self.points.insert(key(of), found.clone(), found.len());
            }
            Ok(found)
        };
        let all: Vec<_> = cameras.par_iter().zip(known).map(of).collect::<Result<_, _>>()?;
        Ok(all.iter().flat_map(|points| points.iter().copied()).collect())
    }

    /// Decodes the frames around an instant that are not cached, of all these cameras and partners: side by side, and
    /// each once. Decodes nothing if the cache doesn't hold all of them.
    fn load_frames<'a>(
        &self,
        cameras: impl Iterator<Item = &'a (usize, Vec<usize>)>,
        instant: Instant,
    ) -> Result<(), RenderError> {
        let all: BTreeSet<usize> =
            cameras.flat_map(|(c, partners)| partners.iter().chain([c])).copied().collect();
        if !self.frames().fits(all.iter().copied(), 2) {
            return Ok(());
        }
        let mut frames = Vec::new();
        for camera in all {
            let (k, later) = self.bracket(camera, instant.time_s)?;
            frames.push((camera, k));
            frames.extend((later != k).then_some((camera, later)));
        }
        frames.into_par_iter().try_for_each(|(camera, frame)| {
            self.frames().get(camera, frame)?;
            Ok(())
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
        let seen = self.correspondences(camera, partners, instant)?.observations(self, instant);
        Ok(seen
            .iter()
            .filter(|observations| observations.len() > 1)
            .filter_map(|observations| triangulate(observations))
            .filter(|t| t.rms_px <= MAX_REPROJECTION_ERROR_PX)
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
