//! Barrel distortion: resamples a camera's frames to those of a camera with another lens at the same place. Or with the same
//! lens and longer focal lengths, which shows what the resampling alone costs.
//!
//! Known limit: rows of a rolling shutter keep their times, although resampling moves what they show.

use nalgebra::Point2;
use rayon::prelude::*;
use stlfr::camera::{Camera, CameraModel};
use stlfr::raster::Image;

/// Distortion coefficients k1, k2, p1 and p2 of COLMAP's model `OPENCV`: those of `rigs/distorted.json`, 5 % at the
/// corners of its images.
const COEFFICIENTS: [f64; 4] = [-0.18, 0.06, 1e-3, -5e-4];

fn opencv([fx, fy, cx, cy]: [f64; 4]) -> CameraModel {
    let [k1, k2, p1, p2] = COEFFICIENTS;
    CameraModel::OpenCv { fx, fy, cx, cy, k1, k2, p1, p2 }
}

/// The resampling map from a camera's image to that of the same camera with barrel distortion.
pub struct Barrel {
    /// The camera with distortion. It has the image size and the pose of the original.
    pub camera: Camera,
    /// For each pixel of the distorted image, row by row: its position in the original image, pixels.
    sources: Vec<Point2<f64>>,
}

impl Barrel {
    /// The focal lengths are the shortest ones with which every pixel lies inside of the original image. What the
    /// original shows at the middle of its sides is lost.
    ///
    /// `None` if a lens can't be inverted inside of its image.
    pub fn new(original: &Camera) -> Option<Self> {
        Self::to_model(original, opencv(enlarged(original)?))
    }

    /// The resampling map to a camera with the same focal lengths, without distortion.
    pub fn enlarging(original: &Camera) -> Option<Self> {
        let [fx, fy, cx, cy] = enlarged(original)?;
        Self::to_model(original, CameraModel::Pinhole { fx, fy, cx, cy })
    }

    fn to_model(original: &Camera, model: CameraModel) -> Option<Self> {
        let camera = Camera { model, ..original.clone() };
        let source = |k: usize| {
            let (x, y) = (k % original.width, k / original.width);
            let ray = camera.ray(&Point2::new(x as f64 + 0.5, y as f64 + 0.5))?;
            original.project_cam(&ray.into())
        };
        let pixels = original.width * original.height;
        let sources = (0..pixels).into_par_iter().map(source).collect::<Option<_>>()?;
        Some(Self { camera, sources })
    }

    /// Resamples an image by bicubic interpolation of its encoded values.
    pub fn apply(&self, image: &Image) -> Image {
        let mut out = image.clone();
        let pixels = out.data_mut().chunks_exact_mut(image.channels());
        for (pixel, source) in pixels.zip(&self.sources) {
            image.sample_cubic(source.x as f32, source.y as f32, pixel);
            pixel.iter_mut().for_each(|v| *v = v.clamp(0.0, 1.0));
        }
        out
    }
}

/// The intrinsics of the camera with barrel distortion: focal lengths and principal point.
fn enlarged(original: &Camera) -> Option<[f64; 4]> {
    let (fx, fy, cx, cy) = original.model.intrinsics();
    let zoom = zoom(original)?;
    Some([zoom * fx, zoom * fy, cx, cy])
}

/// The factor of the focal lengths with which no point of the original's border lies inside of the distorted image.
fn zoom(original: &Camera) -> Option<f64> {
    let (fx, fy, cx, cy) = original.model.intrinsics();
    let [w, h] = [original.width, original.height];
    let across = (0..=w).flat_map(|x| [[x, 0], [x, h]]);
    let down = (0..=h).flat_map(|y| [[0, y], [w, y]]);
    let unit = opencv([1.0, 1.0, 0.0, 0.0]);
    let mut zoom: f64 = 1.0;
    for [x, y] in across.chain(down) {
        let n = original.model.normalized_from_pixel(&Point2::new(x as f64, y as f64))?;
        if !unit.is_short_of_fold(&n) {
            return None;
        }
        let d = unit.pixel_from_normalized(&n);
        // How far the point is from the principal point, where the border on the same side is at 1.
        let part =
            |v: f64, c: f64, size: usize| if v < 0.0 { -v / c } else { v / (size as f64 - c) };
        let distance = part(fx * d.x, cx, w).max(part(fy * d.y, cy, h));
        zoom = zoom.max(1.0 / distance);
    }
    Some(zoom)
}
