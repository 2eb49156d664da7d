//! True images, and the errors of others beside them.

use super::Error;
use nalgebra::Point2;
use stlfr::camera::Camera;
use stlfr::capture::{Truth, TruthView, read_array};
use stlfr::lumigraph::DepthMap;
use stlfr::metrics::flip::{DEFAULT_PIXELS_PER_DEGREE, FlipImage, flip_map};
use stlfr::metrics::moving_part;
use stlfr::raster::{Image, read_image};

/// Distance of two cameras, metres, whose disparity depth errors are stated in.
const BASELINE_M: f32 = 0.06;
/// A jump of disparity over this is a depth edge, pixels; what is within [`EDGE_PX`] of it is at the edge.
const JUMP_PX: f32 = 2.0;
const EDGE_PX: usize = 4;

/// One true image, with its depths and its moving part.
pub struct True {
    pub id: String,
    pub camera: Camera,
    pub image: Image,
    pub depth: DepthMap,
    /// Pixels that each surface point moves within a frame.
    pub motion_px: Vec<f32>,
    pub moving: Vec<bool>,
}

/// Errors over two sets of pixels: all that count, and those of them that move.
#[derive(Clone, Copy)]
pub struct Scores {
    pub db: [f64; 2],
    pub flip: [f64; 2],
}

impl True {
    pub fn read(truth: &Truth, view: &TruthView) -> Result<Self, Error> {
        let (width, height, depths) = read_array(&truth.file(&view.depth)?)?;
        let (w, _, motion_px) = read_array(&truth.file(&view.motion)?)?;
        Ok(Self {
            id: view.id.clone(),
            camera: view.camera.camera()?,
            image: read_image(&truth.file(&view.image)?)?.0,
            depth: DepthMap::from_data(width, height, depths),
            moving: moving_part(&motion_px, w, 0.5, 2),
            motion_px,
        })
    }

    /// The view's name, without its instant.
    pub fn name(&self) -> &str {
        self.id.split_once('-').map_or(&self.id, |(_, name)| name)
    }

    /// The pixels whose point is visible in the image of some camera.
    pub fn seen(&self, cameras: &[Self]) -> Vec<bool> {
        let own: Vec<Camera> = cameras.iter().map(|c| c.camera.clone()).collect();
        self.seen_through(&own, cameras)
    }

    /// The pixels whose point is visible in the image of some camera whose lens may be another than its true image's.
    /// `cameras` are those with the lens of the true images, in the same order.
    pub fn seen_through(&self, lenses: &[Camera], cameras: &[Self]) -> Vec<bool> {
        let w = self.camera.width;
        let is_seen = |(k, z): (usize, &f32)| {
            let pixel = Point2::new((k % w) as f64 + 0.5, (k / w) as f64 + 0.5);
            let Some(ray) = self.camera.ray_world(&pixel) else { return false };
            let point = self.camera.center() + ray * f64::from(*z);
            lenses.iter().zip(cameras).any(|(lens, c)| {
                let is_inside = lens.project(&point).is_some_and(|p| lens.contains(&p));
                let Some(p) = c.camera.project(&point).filter(|_| is_inside) else { return false };
                let z = (c.camera.cam_from_world * point).z;
                let surface = |p: Point2<f64>| c.depth.row(p.y as usize)[p.x as usize];
                c.camera.contains(&p) && z < 1.03 * f64::from(surface(p))
            })
        };
        self.depth.data().iter().enumerate().map(is_seen).collect()
    }

    /// Those of a set of pixels that move.
    pub fn moving_of(&self, counts: &[bool]) -> Vec<bool> {
        self.moving.iter().zip(counts).map(|(m, c)| *m && *c).collect()
    }
}

/// Judges images of one true view over the pixels that count.
pub struct Judge<'a> {
    truth: &'a True,
    flip: FlipImage,
    masks: [Vec<bool>; 2],
}

impl<'a> Judge<'a> {
    pub fn new(truth: &'a True, counts: Vec<bool>) -> Self {
        let flip = FlipImage::new(&truth.image, DEFAULT_PIXELS_PER_DEGREE);
        Self { truth, flip, masks: [truth.moving_of(&counts), counts] }
    }

    pub fn scores(&self, image: &Image) -> Scores {
        let map = flip_map(&self.flip, &FlipImage::new(image, DEFAULT_PIXELS_PER_DEGREE));
        let [moving, all] = &self.masks;
        let masks = [all, moving];
        Scores {
            db: masks.map(|m| psnr_db(image, &self.truth.image, m)),
            flip: masks.map(|m| mean_over(&map, m)),
        }
    }
}

/// NaN over no pixels.
pub fn psnr_db(a: &Image, b: &Image, mask: &[bool]) -> f64 {
    let pixels = a.data().chunks(3).zip(b.data().chunks(3));
    let squared: Vec<f32> = pixels
        .map(|(a, b)| a.iter().zip(b).map(|(a, b)| (a - b).powi(2)).sum::<f32>() / 3.0)
        .collect();
    -10.0 * mean_over(&squared, mask).log10()
}

fn mean_over(values: &[f32], mask: &[bool]) -> f64 {
    let counted = values.iter().zip(mask).filter(|(_, counts)| **counts);
    let (sum, n) = counted.fold((0.0, 0.0), |(sum, n), (v, _)| (sum + f64::from(*v), n + 1.0));
    sum / n
}

/// Median error and share over 1 px, away from depth edges and at them.
pub fn depth_errors(found: &DepthMap, truth: &True) -> String {
    let px = truth.camera.focal_px() as f32 * BASELINE_M;
    let (w, h) = (found.width(), found.height());
    let disparity = |map: &DepthMap, x: usize, y: usize| px / map.row(y)[x];
    let (mut edge, mut away) = (Vec::new(), Vec::new());
    for y in 0..h {
        for x in 0..w {
            let own = disparity(&truth.depth, x, y);
            let mut jump: f32 = 0.0;
            for v in y.saturating_sub(EDGE_PX)..(y + EDGE_PX + 1).min(h) {
                for u in x.saturating_sub(EDGE_PX)..(x + EDGE_PX + 1).min(w) {
                    jump = jump.max((disparity(&truth.depth, u, v) - own).abs());
                }
            }
            let error = (disparity(found, x, y) - own).abs();
            // A pixel without depth is wrong by any measure.
            let error = if error.is_nan() { f32::INFINITY } else { error };
            if jump > JUMP_PX { &mut edge } else { &mut away }.push(error);
        }
    }
    format!("away from edges {}; at edges {}", figures(away), figures(edge))
}

/// Median of the errors, and share over 1 px.
fn figures(mut errors: Vec<f32>) -> String {
    if errors.is_empty() {
        return "none".to_owned();
    }
    errors.sort_by(f32::total_cmp);
    let over = errors.iter().filter(|e| **e > 1.0).count() as f64 / errors.len() as f64;
    format!("{:5.3} px, {:4.1} %", errors[errors.len() / 2], 100.0 * over)
}
