//! The scene's shape at an instant as a view needs it: its own depths, and what hides what in the
//! cameras that it is blended from.

use super::points::nearest;
use super::{LightField, RenderError};
use crate::camera::Camera;
use crate::interpolation::Synchronized;
use crate::lumigraph::{BlendMethod, DepthMap, Proxy};
use crate::options::{ProxyMethod, ViewOptions};
use crate::stereo::{CameraImage, FURTHER_CAMERAS, InverseDepths, Matcher, Surface, fuse};
use nalgebra::{Point2, Point3};
use rayon::prelude::*;
use std::sync::Arc;

/// Share of the range of inverse depths that is added at both ends. Larger: time; smaller: what has no
/// feature and is nearer or farther than all features gets a wrong depth.
const RANGE_MARGIN: f64 = 0.1;
/// Distance between the samples of the proxy that give the range, pixels. Larger: thin things nearer than all
/// else are missed; smaller: time.
const RANGE_STEP_PX: usize = 8;
/// Smallest inverse depth, 1/m: a hundred kilometres. Larger: mountains come nearer; smaller: levels are
/// spent on what looks alike.
const MIN_INVERSE_DEPTH: f64 = 1e-5;

/// The depths of a view, and of the cameras that it is blended from.
#[derive(Clone, Debug)]
pub struct Geometry {
    /// Of the view.
    pub view: DepthMap,
    /// Of every camera, in the capture's order. `None`: nothing is hidden from it.
    pub sources: Vec<Option<Arc<DepthMap>>>,
}

impl LightField {
    /// The cameras whose whole images at the instant decide the view, nearest first: those that depths are
    /// estimated from, and those whose pixels' times are weighed. None, if the proxy is built from
    /// features and time has no weight.
    pub(crate) fn geometry_cameras(
        &self,
        target: &Camera,
        time_s: f64,
        options: &ViewOptions,
    ) -> Vec<usize> {
        if options.proxy.method != ProxyMethod::Depth
            && options.blend.method != BlendMethod::SpaceTime
        {
            return Vec::new();
        }
        let mut cameras = nearest(&self.capture().cameras, &self.usable(time_s), target);
        cameras.truncate(options.proxy.depth.cameras + FURTHER_CAMERAS);
        cameras
    }

    /// Takes away the images that a view is not blended from. Where time has weight, the interpolation errors must be
    /// known: those of [`Self::geometry_cameras`] alone.
    pub(crate) fn keep_candidates(
        &self,
        images: &mut [Option<Synchronized>],
        target: &Camera,
        time_s: f64,
        options: &ViewOptions,
    ) {
        if options.blend.method == BlendMethod::SpaceTime {
            let kept = self.geometry_cameras(target, time_s, options);
            let others = images.iter_mut().enumerate().filter(|(c, _)| !kept.contains(c));
            others.for_each(|(_, image)| *image = None);
        }
    }

    /// The geometry of a view at a time. With [`ProxyMethod::Depth`] it is estimated from `images`, in the
    /// capture's order, of the cameras nearest to the view that have one.
    ///
    /// # Errors
    /// Those of [`Self::proxy`].
    pub fn geometry(
        &self,
        images: &[Option<Synchronized>],
        target: &Camera,
        time_s: f64,
        options: &ViewOptions,
    ) -> Result<Geometry, RenderError> {
        let proxy = self.proxy(target, time_s, options)?;
        Ok(self.geometry_over(&proxy, images, target, time_s, options))
    }

    /// The same over a proxy that is built already.
    pub(crate) fn geometry_over(
        &self,
        proxy: &Proxy,
        images: &[Option<Synchronized>],
        target: &Camera,
        time_s: f64,
        options: &ViewOptions,
    ) -> Geometry {
        let blind = Geometry { view: proxy.depth_map(target), sources: vec![None; images.len()] };
        if options.proxy.method != ProxyMethod::Depth {
            return blind;
        }
        let mut cameras = self.geometry_cameras(target, time_s, options);
        cameras.retain(|&c| images[c].is_some());
        if cameras.len() < 2 {
            return blind;
        }
        self.by_stereo(&self.corrected(images), &cameras, &blind, target, options)
    }

    /// The depths that the images of these cameras agree on, nearest first.
    fn by_stereo(
        &self,
        images: &[Option<Synchronized>],
        cameras: &[usize],
        blind: &Geometry,
        target: &Camera,
        options: &ViewOptions,
    ) -> Geometry {
        let points = sampled(&blind.view, target);
        let own = options.proxy.depth.cameras;
        let estimated = self.estimated(images, (cameras, own), &points, options);
        estimated.and_then(|e| self.seen_from(target, &e)).unwrap_or_else(|| blind.clone())
    }

    /// The depths of the first `own` of these cameras, in a range that `points` give. `None` without points
    /// in front of them.
    pub(super) fn estimated(
        &self,
        images: &[Option<Synchronized>],
        (cameras, own): (&[usize], usize),
        points: &[Point3<f64>],
        options: &ViewOptions,
    ) -> Option<CameraDepths> {
        let filmed = &self.capture().cameras;
        let views: Vec<CameraImage> = cameras
            .iter()
            .filter_map(|&c| Some((c, images[c].as_ref()?)))
            .map(|(c, s)| CameraImage { camera: &filmed[c].camera, image: &s.image })
            .collect();
        let own = views.iter().take(own.max(1));
        let ranges: Vec<Option<[f64; 2]>> = own.map(|v| range(points, v.camera)).collect();
        let of_all = ranges.iter().flatten().fold([f64::INFINITY, 0.0], |[low, high], r| {
            [f64::min(low, r[0]), f64::max(high, r[1])]
        });
        if of_all[1] <= 0.0 {
            return None;
        }
        let matcher = Matcher::new(&views, of_all, &options.proxy.depth);
        let of = |(k, range): (usize, &Option<[f64; 2]>)| {
            matcher.depths(k, (*range)?, &options.proxy.depth)
        };
        let mut depths: Vec<Option<InverseDepths>> =
            ranges.par_iter().enumerate().map(of).collect();
        depths.resize(cameras.len(), None);
        Some(CameraDepths { cameras: cameras.to_vec(), depths })
    }

    /// The geometry that estimated depths give a view, and all their cameras. `None` without any.
    pub(super) fn seen_from(&self, target: &Camera, estimated: &CameraDepths) -> Option<Geometry> {
        let surfaces = self.surfaces(estimated, |_| true);
        let sources = self.in_cameras(estimated, &surfaces);
        (!surfaces.is_empty()).then(|| Geometry { view: fuse(target, &surfaces), sources })
    }

    /// The estimated surfaces of the wanted cameras.
    pub(super) fn surfaces<'a>(
        &'a self,
        CameraDepths { cameras, depths }: &'a CameraDepths,
        is_wanted: impl Fn(usize) -> bool,
    ) -> Vec<Surface<'a>> {
        let filmed = &self.capture().cameras;
        let wanted = cameras.iter().zip(depths).filter(|(c, _)| is_wanted(**c));
        let surface = |(&c, depths): (&usize, &'a Option<InverseDepths>)| {
            Some(Surface { camera: &filmed[c].camera, depths: depths.as_ref()? })
        };
        wanted.filter_map(surface).collect()
    }

    /// What hides what in the cameras, in the capture's order: their own depths, or those of the surfaces.
    pub(super) fn in_cameras(
        &self,
        CameraDepths { cameras, depths }: &CameraDepths,
        surfaces: &[Surface],
    ) -> Vec<Option<Arc<DepthMap>>> {
        let filmed = &self.capture().cameras;
        let mut sources = vec![None; filmed.len()];
        for (&c, depths) in cameras.iter().zip(depths) {
            let camera = &filmed[c].camera;
            let own = depths.as_ref().map(|d| d.depth_map(camera));
            sources[c] = Some(Arc::new(own.unwrap_or_else(|| fuse(camera, surfaces))));
        }
        sources
    }
}

/// The depths of cameras at an instant.
#[derive(Debug)]
pub(super) struct CameraDepths {
    /// Indices of the cameras.
    cameras: Vec<usize>,
    /// Theirs, where they were estimated.
    depths: Vec<Option<InverseDepths>>,
}

/// Points of the proxy, world, metres.
pub(super) fn sampled(depths: &DepthMap, target: &Camera) -> Vec<Point3<f64>> {
    let mut points = Vec::new();
    for y in (0..target.height).step_by(RANGE_STEP_PX) {
        for x in (0..target.width).step_by(RANGE_STEP_PX) {
            let depth = f64::from(depths.row(y)[x]);
            let ray = target.ray_world(&Point2::new(x as f64 + 0.5, y as f64 + 0.5));
            if let Some(ray) = ray.filter(|_| depth.is_finite()) {
                points.push(target.center() + ray * depth);
            }
        }
    }
    points
}

/// The range of the points' inverse depths in a camera, 1/m, with a margin. `None` if none is in front.
fn range(points: &[Point3<f64>], camera: &Camera) -> Option<[f64; 2]> {
    let depths = points.iter().map(|p| (camera.cam_from_world * p).z).filter(|z| *z > 0.0);
    let [low, high] = depths
        .fold([f64::INFINITY, 0.0_f64], |[low, high], z| [low.min(1.0 / z), high.max(1.0 / z)]);
    let margin = RANGE_MARGIN * (high - low);
    (low < f64::INFINITY).then(|| [(low - margin).max(MIN_INVERSE_DEPTH), high + margin])
}
