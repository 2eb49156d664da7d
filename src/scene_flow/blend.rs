//! Blends the scene flow maps of several frames, splatted into a view, to the view's image.

use super::frame::FlowFrame;
use super::geometry::{Projection, undistorted};
use super::map::MappedFrame;
use super::motion::{MotionMap, QuantizedMotion, SurfaceMotion};
use super::splat::Splat;
use crate::camera::Camera;
use crate::lumigraph::{DepthMap, Rendered};
use crate::raster::{Image, Sampling, sample};
use rayon::prelude::*;
use std::ops::Range;

/// Half-width in depth of a cluster, pixels of disparity. A cluster is a group of candidates (surface elements of
/// different scene flow maps) for the same surface at a pixel of the view.
const CLUSTER_PX: f32 = 1.5;
/// Weight above which a cluster occludes a cluster of larger weight behind it, as a fraction of the weight of all
/// surface elements at the pixel.
const FRONT: f32 = 0.12;
/// Weight from which a cluster is opaque, as a fraction of the weight of all surface elements at the pixel. The
/// opacity rises linearly with the weight, from 0 at [`FRONT`] to 1 at this weight.
const OPAQUE: f32 = 0.25;
/// Factor on the thresholds [`FRONT`] and [`OPAQUE`] for a cluster that is known to move. A smaller weight suffices for
/// such a cluster, since its source pixels are known not to show static background.
const MOVING: f32 = 0.25;
/// Minimum number, of a pixel's eight neighbours, that must show a nearer moving body for the pixel to count as a hole
/// in the body.
const CLOSING: usize = 5;
/// Maximum distance from the border of a hole in a moving body at which the hole's pixels are closed, pixels. Pixels
/// farther inside stay unchanged.
const CLOSED_PX: usize = 4;
/// Weight above which a cluster is visible through a transparent cluster in front of it, as a fraction of the weight
/// of all surface elements at the pixel.
const BEHIND: f32 = 0.05;
/// Minimum weight of a candidate (surface element of one scene flow map) in the mean of its cluster, as a fraction of
/// the largest weight in the cluster.
const MIN_FRACTION: f32 = 0.02;
/// Distance of a colour from the mean colour of its cluster at which the colour's weight falls to a quarter. Colours
/// are RGB from 0 to 1.
const COLOR: f32 = 0.06;

/// Maximum number of a view's pixels that are blended at once. With eight scene flow maps, blending them takes about
/// 60 MB.
const BAND_PIXELS: usize = 5 << 16;
/// Minimum number of pixels of a large view. To save memory, a large view is blended in bands of half of
/// [`BAND_PIXELS`].
const LARGE_PIXELS: usize = 1 << 23;

/// Colour and depth of the surface that a pixel of the view shows.
#[derive(Clone, Copy)]
struct Pixel {
    color: [f32; 3],
    /// Inverse depth of the surface, 1/m.
    inverse_depth: f32,
    /// Whether the surface is known to move.
    is_moving: bool,
}

/// Kind of content that the scene flow maps show at a pixel of the view.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Shown {
    /// No splat covers the pixel.
    Nothing,
    /// No splat covers the pixel. It has been filled with the values of a neighbouring pixel.
    Filled,
    Something,
    /// A surface that is known to move.
    Moving,
}

/// Colours and depths of all pixels of a view, row by row.
struct Pixels {
    colors: Vec<[f32; 3]>,
    /// Inverse depth of each pixel, 1/m; 0 where the depth is unknown.
    inverse_depths: Vec<f32>,
    shown: Vec<Shown>,
    /// Motion of the surface at each pixel; `None` if the motion isn't requested.
    motions: Option<MotionMap>,
}

impl Pixels {
    fn new(count: usize, motions: Option<MotionMap>) -> Self {
        Self {
            motions,
            colors: vec![[0.0; 3]; count],
            inverse_depths: vec![0.0; count],
            shown: vec![Shown::Nothing; count],
        }
    }

    /// Closes holes in moving bodies: pixels that show a farther surface, although most of their neighbours show the
    /// body. Holes are closed from the border inwards, one ring of pixels at a time. A closed pixel gets the mean
    /// colour and inverse depth of its neighbours that show the body, and the motion of one of them. `width` is the
    /// width of the view, pixels.
    fn close(&mut self, width: usize) {
        let height = self.shown.len() / width;
        let is_body = |shown: &[Shown], n: usize| shown[n] == Shown::Moving;
        for _ in 0..CLOSED_PX {
            let closed = |k: usize| {
                let (x, y) = (k % width, k / width);
                if is_body(&self.shown, k) || x == 0 || y == 0 || x + 1 == width || y + 1 == height
                {
                    return None;
                }
                let around = (0..9).map(|n| k + (n / 3) * width + n % 3 - width - 1);
                let body: Vec<usize> = around.filter(|&n| is_body(&self.shown, n)).collect();
                if body.len() < CLOSING {
                    return None;
                }
                let mean = |value: &dyn Fn(usize) -> f32| {
                    body.iter().map(|&n| value(n)).sum::<f32>() / body.len() as f32
                };
                let color = [0, 1, 2].map(|c| mean(&|n| self.colors[n][c]));
                let inverse_depth = mean(&|n| self.inverse_depths[n]);
                let is_hole = inverse_depth > self.inverse_depths[k];
                is_hole.then(|| (k, body[0], color, inverse_depth))
            };
            let found: Vec<_> = (0..self.shown.len()).into_par_iter().filter_map(closed).collect();
            if found.is_empty() {
                return;
            }
            for (k, neighbor, color, inverse_depth) in found {
                (self.colors[k], self.inverse_depths[k]) = (color, inverse_depth);
                self.shown[k] = Shown::Moving;
                self.motions.iter_mut().for_each(|m| m.copy(neighbor, k));
            }
        }
    }

    /// Fills the holes of the view (pixels that no scene flow map covers) from the border inwards, one ring of pixels
    /// at a time. Holes are disoccluded background. A pixel therefore copies the values of the neighbour with the
    /// largest depth, among those that are covered or already filled. `width` is the width of the view, pixels.
    fn fill(&mut self, width: usize) {
        let height = self.shown.len() / width;
        let around = |k: u32| {
            let k = k as usize;
            let (x, y) = (k % width, k / width);
            let around = [
                (x > 0).then(|| k - 1),
                (x + 1 < width).then_some(k + 1),
                (y > 0).then(|| k - width),
                (y + 1 < height).then_some(k + width),
            ];
            around.into_iter().flatten()
        };
        // Views have less than 2³² pixels.
        let is_empty = |shown: &[Shown], k: usize| shown[k] == Shown::Nothing;
        let mut ring: Vec<u32> = (0..self.shown.len() as u32)
            .filter(|&k| {
                is_empty(&self.shown, k as usize) && around(k).any(|n| !is_empty(&self.shown, n))
            })
            .collect();
        while !ring.is_empty() {
            let depth = |n: &usize| self.inverse_depths[*n];
            let farthest = |&k: &u32| {
                let neighbors = around(k).filter(|&n| !is_empty(&self.shown, n));
                neighbors.min_by(|a, b| depth(a).total_cmp(&depth(b))).unwrap_or(k as usize) as u32
            };
            let sources: Vec<u32> = ring.iter().map(farthest).collect();
            for (&k, &n) in ring.iter().zip(&sources) {
                self.colors[k as usize] = self.colors[n as usize];
                self.inverse_depths[k as usize] = self.inverse_depths[n as usize];
                self.motions.iter_mut().for_each(|m| m.copy(n as usize, k as usize));
                self.shown[k as usize] = Shown::Filled;
            }
            let next = |&k: &u32| around(k).filter(|&n| is_empty(&self.shown, n)).map(|n| n as u32);
            ring = ring.iter().flat_map(next).collect();
            ring.sort_unstable();
            ring.dedup();
        }
    }
}

/// Surface element that one scene flow map shows at a pixel of the view, with the source of its colour.
struct ColorCandidate<'a> {
    frame: &'a FlowFrame,
    inverse_depth: f32,
    source: [f32; 2],
    weight: f32,
    /// Whether the source pixel is known to show a moving body.
    is_moving: bool,
}

impl ColorCandidate<'_> {
    /// Returns the factor on the weight threshold [`FRONT`] for this candidate: [`MOVING`] if it shows a moving body,
    /// else 1.
    fn front_factor(&self) -> f32 {
        if self.is_moving { MOVING } else { 1.0 }
    }
}

/// Rendered view with its depth map, and with the motion of its surfaces if requested.
pub struct FlowView {
    pub rendered: Rendered,
    pub depths: DepthMap,
    pub motions: Option<MotionMap>,
}

/// One row of the view: colours, inverse depths, and what each pixel shows.
type BlendedRow<'a> = (&'a mut [[f32; 3]], &'a mut [f32], &'a mut [Shown]);

/// Blends the rows `rows` of a view at `time` into `pixels`, as [`blend`] describes.
fn blend_rows(
    mapped: &[MappedFrame],
    confidences: &[Vec<u8>],
    (view, rows): (&Camera, Range<usize>),
    time: f64,
    pixels: &mut Pixels,
) {
    let splats: Vec<(&MappedFrame, Splat)> = mapped
        .par_iter()
        .zip(confidences)
        .filter_map(|(m, c)| Some((m, Splat::new(*m, c, (view, rows.clone()), time)?)))
        .collect();
    let reach = CLUSTER_PX / disparity_px(mapped).max(f32::MIN_POSITIVE);
    let width = view.width;
    let band = rows.start * width..rows.end * width;
    let colors = pixels.colors[band.clone()].par_chunks_mut(width);
    let depths = pixels.inverse_depths[band.clone()].par_chunks_mut(width);
    let shown = pixels.shown[band].par_chunks_mut(width);
    let motions = pixels.motions.as_ref();
    let row = |(y, (color, depth, shown)): (usize, BlendedRow)| {
        let mut candidates = Vec::with_capacity(splats.len());
        let mut room = Vec::with_capacity(splats.len());
        let mut row = vec![QuantizedMotion::default(); motions.map_or(0, |_| width)];
        for x in 0..width {
            candidates.clear();
            let k = y * width + x;
            for (mapped, splat) in splats.iter().filter(|(_, splat)| splat.weights[k] > 0.0) {
                let source = splat.sources[k];
                candidates.push(ColorCandidate {
                    frame: mapped.frame,
                    inverse_depth: splat.inverse_depths[k],
                    source,
                    weight: splat.weights[k],
                    is_moving: shows_motion(mapped.frame, source),
                });
            }
            if let Some(found) = pixel_of(&candidates, reach, &mut room) {
                (color[x], depth[x]) = (found.color, found.inverse_depth);
                shown[x] = if found.is_moving { Shown::Moving } else { Shown::Something };
                if let Some(motions) = motions {
                    let of = splats.iter().filter(|(_, splat)| splat.weights[k] > 0.0);
                    row[x] = motions.quantized(motion_of(of, k, (found.inverse_depth, reach)));
                }
            }
        }
        row
    };
    let rows: Vec<Vec<QuantizedMotion>> =
        (colors, depths, shown).into_par_iter().enumerate().map(row).collect();
    pixels.motions.iter_mut().for_each(|motions| motions.extend(rows.iter().flatten().copied()));
}

/// Returns the disparity of a point at a depth of 1 m, pixels, at the maps' baseline of twice the distance between
/// neighbouring cameras. If it differs between the scene flow maps, returns the largest.
fn disparity_px(mapped: &[MappedFrame]) -> f32 {
    mapped.iter().map(|m| m.map.disparity_px).fold(0.0, f32::max)
}

/// Returns the weighted mean motion of the surface that pixel `k` of the blended rows shows. It is the mean over
/// surface elements whose inverse depth differs from `inverse_depth` by less than `reach`, both in 1/m.
fn motion_of<'a>(
    splats: impl Iterator<Item = &'a (&'a MappedFrame<'a>, Splat)>,
    k: usize,
    (inverse_depth, reach): (f32, f32),
) -> SurfaceMotion {
    let (mut sum, mut weights) = (SurfaceMotion::default(), 0.0);
    for (mapped, splat) in
        splats.filter(|(_, s)| (s.inverse_depths[k] - inverse_depth).abs() < reach)
    {
        let (weight, motion) = (splat.weights[k], splat.motion(mapped.map, splat.sources[k]));
        (0..2).for_each(|c| sum.velocity[c] += weight * motion.velocity[c]);
        sum.inverse_depth_rate += weight * motion.inverse_depth_rate;
        weights += weight;
    }
    let inverse = if weights > 0.0 { 1.0 / weights } else { 0.0 };
    SurfaceMotion {
        velocity: sum.velocity.map(|v| v * inverse),
        inverse_depth_rate: sum.inverse_depth_rate * inverse,
    }
}

/// Returns whether a position in a frame, pixels, is known to show a moving body.
fn shows_motion(frame: &FlowFrame, [x, y]: [f32; 2]) -> bool {
    let (width, height) = (frame.view.width, frame.view.height);
    let inside = |at: f32, size: usize| (at as usize).min(size - 1); // saturates at 0
    frame.is_moving(inside(y, height) * width + inside(x, width))
}

/// Renders the view at `time`, in frame periods of the reference camera since the capture's start. `confidences` are
/// the confidences of the scene flow maps, as [`confidences`](super::confidences) returns them.
///
/// A hole that lies inside at least one camera's image is filled with the background beside it. Pixels outside all
/// images stay black and have no depth. If `with_motion` is true, the result has the motion of the surfaces too.
pub fn blend(
    mapped: &[MappedFrame],
    confidences: &[Vec<u8>],
    view: &Camera,
    time: f64,
    with_motion: bool,
) -> FlowView {
    let (width, height) = (view.width, view.height);
    let motions = with_motion.then(|| MotionMap::empty(disparity_px(mapped), width * height));
    let mut pixels = Pixels::new(width * height, motions);
    // The pixels of a large view need much memory, so its bands are smaller.
    let band_pixels = if width * height < LARGE_PIXELS { BAND_PIXELS } else { BAND_PIXELS / 2 };
    let rows_at_once = (band_pixels / width.max(1)).max(1);
    for first in (0..height).step_by(rows_at_once) {
        let rows = first..(first + rows_at_once).min(height);
        blend_rows(mapped, confidences, (view, rows), time, &mut pixels);
    }
    if mapped.iter().any(|m| m.frame.still.is_some()) {
        pixels.close(width);
    }
    pixels.fill(width);
    let behind = Behind::new(mapped, view);
    let colors = pixels.colors.par_iter_mut().zip(&mut pixels.inverse_depths);
    let holes = colors.zip(&pixels.shown).enumerate();
    let unmapped = holes.filter(|(_, (_, shown))| matches!(shown, Shown::Nothing | Shown::Filled));
    unmapped.for_each(|(k, ((color, inverse_depth), _))| {
        let place = [(k % width) as f32 + 0.5, (k / width) as f32 + 0.5];
        let pixel = Pixel { color: *color, inverse_depth: *inverse_depth, is_moving: false };
        let filled = undistorted(view, place).and_then(|place| behind.fill(pixel, place));
        let nothing = Pixel { color: [0.0; 3], inverse_depth: 0.0, is_moving: false };
        let filled = filled.unwrap_or(nothing);
        (*color, *inverse_depth) = (filled.color, filled.inverse_depth);
    });
    let Pixels { colors, inverse_depths: mut depths, motions, .. } = pixels;
    let coverage = depths.iter().map(|q| *q > 0.0).collect();
    // An unknown depth is an inverse depth of 0. Its reciprocal is infinite, which the depth map turns into NaN.
    depths.iter_mut().for_each(|q| *q = 1.0 / *q);
    let is_gray = mapped.iter().all(|m| !m.frame.is_color);
    let image = if is_gray {
        Image::from_data(width, height, 1, colors.iter().map(|[c, _, _]| *c).collect())
    } else {
        Image::from_data(width, height, 3, colors.into_flattened())
    };
    FlowView {
        rendered: Rendered { image, coverage },
        depths: DepthMap::from_data(width, height, depths),
        motions,
    }
}

/// Frames that give the background colours with which holes of the view are filled.
struct Behind<'a> {
    /// The frames, each with the projection from the view, in order of distance between the frame's camera and the
    /// view.
    frames: Vec<(MappedFrame<'a>, Projection)>,
}

impl<'a> Behind<'a> {
    fn new(mapped: &[MappedFrame<'a>], view: &Camera) -> Self {
        let mut frames: Vec<_> = mapped
            .iter()
            .filter_map(|m| Some((*m, Projection::new(view, &m.frame.view)?)))
            .collect();
        let distance = |m: &MappedFrame| (m.frame.view.center() - view.center()).norm();
        frames.sort_by(|a, b| distance(&a.0).total_cmp(&distance(&b.0)));
        Self { frames }
    }

    /// Colours a pixel of a hole. `pixel` already has the depth of the background, and `[x, y]` is its position in the
    /// view without lens distortion. The colour is taken from the frame that shows the point at this depth unoccluded.
    /// If there are several such frames, the one whose camera is nearest to the view is taken. Motion is neglected. If
    /// the point is occluded in all frames, the pixel keeps its colour. `None` if the point is outside all images.
    fn fill(&self, mut pixel: Pixel, [x, y]: [f32; 2]) -> Option<Pixel> {
        let mut is_filmed = false;
        for (MappedFrame { frame, map }, projection) in &self.frames {
            let [u, v, q] = projection.project(x, y, pixel.inverse_depth);
            let (width, height) = (map.width, map.height);
            if !(u >= 0.0 && v >= 0.0 && u < width as f32 && v < height as f32) {
                continue;
            }
            let k = v as usize * width + u as usize;
            if frame.is_filmed.as_ref().is_some_and(|is_filmed| !is_filmed[k]) {
                continue;
            }
            is_filmed = true;
            let in_front = map.element(&map.pixels()[k]).inverse_depth - q;
            if in_front * map.disparity_px < CLUSTER_PX {
                pixel.color = sample(&frame.image, u, v, Sampling::Cubic);
                pixel.color = pixel.color.map(|c| c.clamp(0.0, 1.0));
                return Some(pixel);
            }
        }
        is_filmed.then_some(pixel)
    }
}

/// Colours of a cluster's candidates, RGB from 0 to 1, with their weights.
type WeightedColors = Vec<([f32; 3], f32)>;

/// Returns colour and depth of a pixel: the means of the frontmost cluster of candidates with a sufficient weight
/// ([`FRONT`]), or else of the cluster with the largest weight. If this cluster isn't opaque ([`OPAQUE`]), its colour
/// is composited over the colour of the cluster behind it. `reach` is the half-width of a cluster in inverse depth,
/// 1/m. `colors` is a reusable buffer. `None` without candidates.
fn pixel_of(
    candidates: &[ColorCandidate],
    reach: f32,
    colors: &mut WeightedColors,
) -> Option<Pixel> {
    let depths = || candidates.iter().map(|c| c.inverse_depth);
    let nearest = depths().fold(f32::NEG_INFINITY, f32::max);
    if nearest - depths().fold(f32::INFINITY, f32::min) < reach {
        return mean_of(candidates, nearest, reach, colors);
    }
    let total: f32 = candidates.iter().map(|c| c.weight).sum();
    let support = |q: f32| -> f32 {
        let near = candidates.iter().filter(|c| (c.inverse_depth - q).abs() < reach);
        near.map(|c| c.weight).sum()
    };
    let heaviest = |min: f32, max: f32| {
        let supports = depths().filter(|q| *q > min && *q < max).map(|q| (q, support(q)));
        supports.fold((0.0, 0.0), |best, new| if new.1 > best.1 { new } else { best })
    };
    let (mut q, mut weight) = heaviest(f32::NEG_INFINITY, f32::INFINITY);
    let is_front = |c: &&ColorCandidate| {
        c.inverse_depth > q && support(c.inverse_depth) > c.front_factor() * FRONT * total
    };
    let front = candidates.iter().filter(is_front).map(|c| c.inverse_depth).fold(q, f32::max);
    if front > q {
        (q, weight) = heaviest(front - reach, front + reach);
    }
    let mut pixel = mean_of(candidates, q, reach, colors)?;
    let (behind, weight_behind) = heaviest(f32::NEG_INFINITY, q - 2.0 * reach);
    if weight_behind > BEHIND * total {
        let factor = if pixel.is_moving { MOVING } else { 1.0 };
        let [transparent, opaque] = [factor * FRONT, factor * OPAQUE];
        let opacity = ((weight / total - transparent) / (opaque - transparent)).clamp(0.0, 1.0);
        if opacity < 1.0
            && let Some(back) = mean_of(candidates, behind, reach, colors)
        {
            for (color, back) in pixel.color.iter_mut().zip(back.color) {
                *color = opacity * *color + (1.0 - opacity) * back;
            }
        }
    }
    Some(pixel)
}

/// Returns the mean colour and inverse depth of the candidates whose inverse depths differ from `q` by less than
/// `reach`, both in 1/m. Two reweighting steps reduce the weight of outlying colours. `colors` is a reusable buffer.
/// `None` if there are no such candidates.
fn mean_of(
    candidates: &[ColorCandidate],
    q: f32,
    reach: f32,
    colors: &mut WeightedColors,
) -> Option<Pixel> {
    let cluster = || candidates.iter().filter(|c| (c.inverse_depth - q).abs() < reach);
    // Grey cameras are left out if a colour camera contributes.
    let has_color = cluster().any(|c| c.frame.is_color);
    let cluster = || cluster().filter(|c| c.frame.is_color == has_color);
    let most = cluster().map(|c| c.weight).fold(0.0, f32::max);
    let (mut depths, mut weights, mut moving) = (0.0, 0.0, 0.0);
    colors.clear();
    for c in cluster().filter(|c| c.weight >= MIN_FRACTION * most) {
        let [x, y] = c.source;
        colors.push((sample(&c.frame.image, x, y, Sampling::Cubic), c.weight));
        depths += c.weight * c.inverse_depth;
        weights += c.weight;
        moving += if c.is_moving { c.weight } else { 0.0 };
    }
    if colors.is_empty() {
        return None;
    }
    let mut color = weighted_mean(colors, |_| 1.0);
    for _ in 0..2 {
        color = weighted_mean(colors, |c| {
            let difference: f32 = (0..3).map(|k| (c[k] - color[k]) * (c[k] - color[k])).sum();
            let kept = 1.0 / (1.0 + difference / (COLOR * COLOR));
            kept * kept
        });
    }
    let color = color.map(|c| c.clamp(0.0, 1.0));
    Some(Pixel { color, inverse_depth: depths / weights, is_moving: 2.0 * moving > weights })
}

/// Returns the weighted mean of the colours. The weight of a colour is its own weight times `factor(colour)`. Both the
/// weight and the factor must be positive.
#[inline(always)]
fn weighted_mean(colors: &WeightedColors, factor: impl Fn(&[f32; 3]) -> f32) -> [f32; 3] {
    let (mut sum, mut weights) = ([0.0f32; 3], 0.0f32);
    for (color, weight) in colors {
        let weight = weight * factor(color);
        (0..3).for_each(|c| sum[c] += weight * color[c]);
        weights += weight;
    }
    let inverse = 1.0 / weights;
    sum.map(|v| v * inverse)
}
