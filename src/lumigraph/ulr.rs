//! Unstructured lumigraph rendering (Buehler, Bosse, McMillan, Gortler, Cohen, SIGGRAPH 2001):
//! every pixel of the view is a weighted mean of the cameras' images of its point of the proxy.
//!
//! The penalty of camera i at the pixel's point X, seen from the view's centre C:
//!
//! `p_i = 2 tan(θ_i / 2) · (1 + β · coarseness_i) / (border_i · visible_i)`
//!
//! with θ_i the angle at X between C and C_i. Buehler adds the three parts; multiplied, the
//! penalty is exactly 0 where the view's centre is the camera's, so that camera alone answers,
//! up to its border; and infinite outside its image, so that ranks change smoothly there.
//! [`super::weights`] turns penalties into weights.
//!
//! A grey camera among coloured ones gives its luma: luma is blended from all cameras, and the
//! difference between colour and luma from the coloured ones alone (with weights of their own),
//! fading to grey where none of them sees the point.
//!
//! Known limit: where a point of the proxy is hidden from a camera by another part of it, the
//! camera still answers unless its own [`Source::depth`] is given.

use super::DepthMap;
use super::rays::{RayRow, ViewBounds};
use super::weights::{BlendRung, lumigraph_weights, uniform_weights};
use crate::camera::{Camera, CameraModel};
use crate::raster::Image;
use nalgebra::{Matrix3, Point2, Vector3};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// One camera with its image at the instant that is rendered.
#[derive(Clone, Copy, Debug)]
pub struct Source<'a> {
    pub camera: &'a Camera,
    pub image: &'a Image,
    /// The proxy as this camera sees it; what lies behind it is hidden. `None`: nothing is.
    pub depth: Option<&'a DepthMap>,
}

impl<'a> Source<'a> {
    /// A source from which nothing is hidden.
    pub fn new(camera: &'a Camera, image: &'a Image) -> Self {
        Self { camera, image, depth: None }
    }
}

/// How images are read between pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Sampling {
    Bilinear,
    Cubic,
}

/// How the view is blended.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct BlendOptions {
    pub rung: BlendRung,
    /// Cameras that a pixel is blended from. Larger averages the noise of more images and blurs
    /// by the proxy's error; smaller shows every camera's own errors. At least 1.
    pub cameras: usize,
    /// Width over which a camera fades out towards its image's border, px. Larger wastes the
    /// image's outer part; smaller makes the border of an image visible.
    pub feather_px: f64,
    /// β: weight of coarser resolution. Larger avoids cameras that are farther away or have a
    /// shorter lens than the view even if they see it from the right angle; at 0 their blur shows.
    pub resolution: f64,
    pub sampling: Sampling,
    /// How much deeper than [`Source::depth`] a point must be to count as hidden, as a share.
    /// Larger shows the foreground's edge twice; smaller hides slanted surfaces from themselves.
    pub hidden_share: f64,
}

impl Default for BlendOptions {
    fn default() -> Self {
        Self {
            rung: BlendRung::Lumigraph,
            cameras: 4,
            feather_px: 12.0,
            resolution: 1.0,
            sampling: Sampling::Cubic,
            hidden_share: 0.03,
        }
    }
}

/// A view, and which of its pixels any camera sees (row by row). The others are 0.
#[derive(Clone, Debug, PartialEq)]
pub struct Rendered {
    pub image: Image,
    pub coverage: Vec<bool>,
}

/// Nothing is farther than this, 1/m: at 1e8 m, the images in two cameras a kilometre apart
/// differ by a hundredth of a pixel. It keeps the angles of the sky's points apart from 0.
const MIN_INVERSE_DEPTH: f64 = 1e-8;
/// A camera whose centre is this close to the view's, as a share of the farthest camera's
/// distance from it, stands at the view's centre.
const SAME_CENTER_SHARE: f64 = 1e-6;
/// What a hidden camera's trust is multiplied by. It answers only where all are hidden. Larger
/// lets foreground shine through; 0 would leave holes.
const HIDDEN_TRUST: f64 = 1e-3;
/// Points this far (as a share) outside the cone of a camera's border rays have no image: there
/// a lens polynomial may fold back into the image.
const CONE_MARGIN: f64 = 0.02;

/// Renders the view from its depths (of the proxy, [`super::Proxy::depth_map`]).
///
/// Pixels without depth are answered only by cameras that stand at the view's centre. No sources
/// give no coverage. The image has 3 channels if any source has, else 1.
///
/// # Panics
/// If the size of the depth map is not the view's, or that of an image or of a source's depth
/// map not its camera's.
pub fn blend(
    sources: &[Source],
    depth: &DepthMap,
    target: &Camera,
    options: &BlendOptions,
) -> Rendered {
    let (w, h) = (target.width, target.height);
    assert_eq!((depth.width(), depth.height()), (w, h), "size of the view's depths");
    let terms = Terms::of_all(sources, target, options);
    let colored = sources.iter().filter(|s| s.image.channels() == 3).count();
    let channels = if colored > 0 { 3 } else { 1 };
    let mut image = Image::filled(w, h, channels, 0.0);
    let mut coverage = vec![false; w * h];
    image
        .data_mut()
        .par_chunks_exact_mut(w * channels)
        .zip(coverage.par_chunks_exact_mut(w))
        .enumerate()
        .for_each_init(
            || Row::new(sources, &terms, target, options),
            |row, (y, (pixels, covered))| {
                row.measure(y, depth.row(y));
                match (channels, colored == sources.len()) {
                    (1, _) => row.blend::<1>(pixels, covered),
                    (_, true) => row.blend::<3>(pixels, covered),
                    (_, false) => row.blend_mixed(pixels, covered),
                }
            },
        );
    Rendered { image, coverage }
}

/// What a source contributes to every pixel's geometry, computed once.
struct Terms {
    /// Source axes from the view's.
    rotation: Matrix3<f64>,
    /// The view's centre minus the source's: in the source's axes, and in the view's.
    shift: Vector3<f64>,
    shift_target: Vector3<f64>,
    model: CameraModel,
    width: f64,
    height: f64,
    /// Focal length of the view over the source's.
    focal_ratio: f64,
    max_radius2: f64,
}

impl Terms {
    fn of_all(sources: &[Source], target: &Camera, options: &BlendOptions) -> Vec<Self> {
        let center = target.center();
        let extent =
            sources.iter().map(|s| (s.camera.center() - center).norm()).fold(0.0, f64::max);
        sources.iter().map(|s| Self::new(s, target, extent, options)).collect()
    }

    fn new(source: &Source, target: &Camera, extent: f64, _options: &BlendOptions) -> Self {
        let camera = source.camera;
        let size = (camera.width, camera.height);
        assert_eq!((source.image.width(), source.image.height()), size, "size of an image");
        if let Some(d) = source.depth {
            assert_eq!((d.width(), d.height()), size, "size of a source's depths");
        }
        let mut shift_world = target.center() - camera.center();
        if shift_world.norm() <= SAME_CENTER_SHARE * extent {
            shift_world = Vector3::zeros();
        }
        let target_axes = target.cam_from_world.rotation;
        let rotation = camera.cam_from_world.rotation * target_axes.inverse();
        let widen = (1.0 + CONE_MARGIN).powi(2);
        Self {
            rotation: rotation.to_rotation_matrix().into_inner(),
            shift: camera.cam_from_world.rotation * shift_world,
            shift_target: target_axes * shift_world,
            model: camera.model,
            width: camera.width as f64,
            height: camera.height as f64,
            focal_ratio: target.focal_px() / camera.focal_px(),
            max_radius2: ViewBounds::of(camera).map_or(0.0, |b| b.max_radius2() * widen),
        }
    }

    /// Position in the source's image, penalty, trust, and 1/depth in the source, of the point
    /// at an inverse depth along the view's ray (x, y, 1) of length `ray_norm`.
    #[inline(always)]
    fn at(&self, x: f64, y: f64, ray_norm: f64, inverse_depth: f64, o: &Scales) -> Hit {
        let (m, s) = (&self.rotation, &self.shift);
        let q = Vector3::new(
            m[(0, 0)] * x + m[(0, 1)] * y + m[(0, 2)] + inverse_depth * s.x,
            m[(1, 0)] * x + m[(1, 1)] * y + m[(1, 2)] + inverse_depth * s.y,
            m[(2, 0)] * x + m[(2, 1)] * y + m[(2, 2)] + inverse_depth * s.z,
        );
        // Behind the source q.z is not positive, and what comes of it is thrown away below.
        let inverse_z = 1.0 / q.z;
        let (nx, ny) = (q.x * inverse_z, q.y * inverse_z);
        let pixel = self.model.pixel_from_normalized(&Point2::new(nx, ny));
        let inside = pixel.x.min(self.width - pixel.x).min(pixel.y.min(self.height - pixel.y));
        let sees = q.z > 0.0 && nx * nx + ny * ny <= self.max_radius2 && inside > 0.0;

        // tan(θ/2) = |a × b| / (|a||b| + a · b) of the directions a and b from the view's and
        // the source's centre; b = a + shift, so that a × b = a × shift has no cancellation.
        let d = &self.shift_target;
        let cross = Vector3::new(y * d.z - d.y, d.x - x * d.z, x * d.y - y * d.x);
        let dot = ray_norm * ray_norm + inverse_depth * (x * d.x + y * d.y + d.z);
        let q_norm = (q.x * q.x + q.y * q.y + q.z * q.z).sqrt();
        // The sum is 0 only where θ is 180° or the point is the source's centre: then ∞ or NaN,
        // and the camera doesn't count.
        let angle = 2.0 * inverse_depth * cross.norm() / (ray_norm * q_norm + dot);
        let coarseness = (q_norm * self.focal_ratio / ray_norm - 1.0).max(0.0);

        let t = (inside * o.inverse_feather).min(1.0);
        let border = t * t * (3.0 - 2.0 * t);
        let trust = if sees && angle < f64::INFINITY { border } else { 0.0 };
        Hit {
            x: pixel.x as f32,
            y: pixel.y as f32,
            depth: (q.z / inverse_depth) as f32,
            angle: (angle * (1.0 + o.resolution * coarseness)) as f32,
            trust: trust as f32,
        }
    }
}

#[derive(Clone, Copy, Default)]
struct Hit {
    x: f32,
    y: f32,
    /// In the source, metres.
    depth: f32,
    angle: f32,
    trust: f32,
}

struct Scales {
    inverse_feather: f64,
    resolution: f64,
}

/// One row's geometry in all sources, and scratch space.
struct Row<'a> {
    sources: &'a [Source<'a>],
    terms: &'a [Terms],
    target: &'a Camera,
    options: &'a BlendOptions,
    rays: RayRow,
    /// Pixel by pixel, source by source.
    hits: Vec<Hit>,
    penalties: Vec<f32>,
    trust: Vec<f32>,
    weights: Vec<f32>,
    nearest: Vec<f32>,
}

impl<'a> Row<'a> {
    fn new(
        sources: &'a [Source],
        terms: &'a [Terms],
        target: &'a Camera,
        options: &'a BlendOptions,
    ) -> Self {
        let n = sources.len();
        Self {
            sources,
            terms,
            target,
            options,
            rays: RayRow::new(target),
            hits: vec![Hit::default(); n * target.width],
            penalties: vec![0.0; n],
            trust: vec![0.0; n],
            weights: vec![0.0; n],
            nearest: Vec::with_capacity(n + 1),
        }
    }

    /// Computes the row's hits.
    fn measure(&mut self, y: usize, depths: &[f32]) {
        self.rays.set(self.target, y);
        let scales = Scales {
            // Narrower than a hundredth of a pixel is no feather.
            inverse_feather: 1.0 / self.options.feather_px.max(0.01),
            resolution: self.options.resolution.max(0.0),
        };
        let n = self.sources.len();
        for (i, (source, terms)) in self.sources.iter().zip(self.terms).enumerate() {
            let at_center = terms.shift_target == Vector3::zeros();
            let rays = self.rays.x.iter().zip(&self.rays.y);
            for (x, ((&rx, &ry), &depth)) in rays.zip(depths).enumerate() {
                let known = !depth.is_nan();
                let inverse =
                    if known { (1.0 / f64::from(depth)).max(MIN_INVERSE_DEPTH) } else { 1.0 };
                let norm = (rx * rx + ry * ry + 1.0).sqrt();
                let mut hit = terms.at(rx, ry, norm, inverse, &scales);
                if !(known || at_center) {
                    hit.trust = 0.0;
                }
                if let Some(map) = source.depth
                    && hit.trust > 0.0
                {
                    hit.trust *= self.visible(map, &hit);
                }
                self.hits[x * n + i] = hit;
            }
        }
    }

    /// 1 where the point is on the surface that the source sees, falling to [`HIDDEN_TRUST`]
    /// over once more the tolerance behind it.
    fn visible(&self, map: &DepthMap, hit: &Hit) -> f32 {
        let surface = map.farthest_around(hit.x, hit.y);
        let tolerance = self.options.hidden_share.max(1e-6) as f32;
        let behind = (hit.depth / surface - 1.0) / tolerance - 1.0;
        // NaN, where the source sees nothing, hides nothing.
        if behind > 0.0 { (1.0 - behind).max(HIDDEN_TRUST as f32) } else { 1.0 }
    }

    /// Weights of one pixel; `counts` says which sources take part. False if none sees it.
    fn weigh(&mut self, x: usize, counts: impl Fn(usize) -> bool) -> bool {
        let n = self.sources.len();
        for (i, hit) in self.hits[x * n..(x + 1) * n].iter().enumerate() {
            let trust = if counts(i) { hit.trust } else { 0.0 };
            self.trust[i] = trust;
            self.penalties[i] = if trust > 0.0 { hit.angle / trust } else { f32::INFINITY };
        }
        match self.options.rung {
            BlendRung::Uniform => uniform_weights(&self.trust, &mut self.weights),
            BlendRung::Lumigraph => lumigraph_weights(
                &self.penalties,
                &self.trust,
                self.options.cameras,
                &mut self.nearest,
                &mut self.weights,
            ),
        }
    }

    fn sample(&self, x: usize, source: usize, out: &mut [f32]) {
        let hit = &self.hits[x * self.sources.len() + source];
        let image = self.sources[source].image;
        match self.options.sampling {
            Sampling::Bilinear => image.sample_bilinear(hit.x, hit.y, out),
            Sampling::Cubic => image.sample_cubic(hit.x, hit.y, out),
        }
    }

    /// All sources have C channels.
    fn blend<const C: usize>(&mut self, pixels: &mut [f32], covered: &mut [bool]) {
        for (x, (pixel, covered)) in pixels.chunks_exact_mut(C).zip(covered).enumerate() {
            *covered = self.weigh(x, |_| true);
            let (mut sum, mut value) = ([0.0; C], [0.0; C]);
            for (i, &weight) in self.weights.iter().enumerate() {
                if weight > 0.0 {
                    self.sample(x, i, &mut value);
                    for (sum, v) in sum.iter_mut().zip(value) {
                        *sum += weight * v;
                    }
                }
            }
            for (out, sum) in pixel.iter_mut().zip(sum) {
                *out = sum.clamp(0.0, 1.0);
            }
        }
    }

    /// Some sources are grey: luma from all, colour from the others.
    fn blend_mixed(&mut self, pixels: &mut [f32], covered: &mut [bool]) {
        let sources = self.sources;
        let is_colored = |i: usize| sources[i].image.channels() == 3;
        for (x, (pixel, covered)) in pixels.chunks_exact_mut(3).zip(covered).enumerate() {
            *covered = self.weigh(x, |_| true);
            let seen = self.trust.iter().copied().fold(0.0, f32::max);
            let (mut sum, mut colored_share) = (0.0, 0.0);
            for i in 0..sources.len() {
                let weight = self.weights[i];
                if weight > 0.0 {
                    let value = self.sample_rgb(x, i);
                    sum += weight * luma(value);
                    colored_share += if is_colored(i) { weight } else { 0.0 };
                }
            }
            let mut rgb = [sum; 3];
            if self.weigh(x, is_colored) {
                // Colour fades as the last coloured camera loses the point that others see,
                // unless the luma is that camera's too.
                let seen_colored = self.trust.iter().copied().fold(0.0, f32::max);
                let fade = colored_share.max(seen_colored / seen);
                for i in 0..sources.len() {
                    let weight = self.weights[i] * fade;
                    if weight > 0.0 {
                        let value = self.sample_rgb(x, i);
                        let gray = luma(value);
                        for (out, v) in rgb.iter_mut().zip(value) {
                            *out += weight * (v - gray);
                        }
                    }
                }
            }
            for (out, v) in pixel.iter_mut().zip(rgb) {
                *out = v.clamp(0.0, 1.0);
            }
        }
    }

    fn sample_rgb(&self, x: usize, source: usize) -> [f32; 3] {
        let mut value = [0.0; 3];
        if self.sources[source].image.channels() == 3 {
            self.sample(x, source, &mut value);
        } else {
            self.sample(x, source, &mut value[..1]);
            value = [value[0]; 3];
        }
        value
    }
}

/// Rec. 709's luma of encoded values, as [`Image::to_gray`].
fn luma(rgb: [f32; 3]) -> f32 {
    0.2126 * rgb[0] + 0.7152 * rgb[1] + 0.0722 * rgb[2]
}
