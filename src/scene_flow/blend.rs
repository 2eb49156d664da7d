//! The view that maps of several frames give together.

use super::frame::FlowFrame;
use super::geometry::Projection;
use super::map::MappedFrame;
use super::splat::Splat;
use crate::camera::Camera;
use crate::lumigraph::{DepthMap, Rendered};
use crate::raster::{Image, Sampling, sample};
use nalgebra::Point2;
use rayon::prelude::*;

/// Half-width of a cluster of candidates, pixels of disparity.
const CLUSTER_PX: f32 = 1.5;
/// Fraction of all weights that a cluster in front of the heaviest needs to hide it.
const FRONT: f32 = 0.12;
/// Fraction of all weights from which a cluster hides all that is behind it.
const OPAQUE: f32 = 0.25;
/// Fraction of all weights that a cluster behind needs to show through.
const BEHIND: f32 = 0.05;
/// Fraction of the largest weight of a cluster below which a frame counts nothing.
const MIN_SHARE: f32 = 0.02;
/// Difference of a colour from the mean at which it counts a quarter.
const COLOR: f32 = 0.06;

/// The surface that a pixel of the view shows.
#[derive(Clone, Copy, Default)]
struct Pixel {
    color: [f32; 3],
    /// 1/m; 0 where nothing is known.
    inverse_depth: f32,
    /// Whether some map has it.
    is_mapped: bool,
}

/// What one map has at a pixel of the view.
struct Candidate<'a> {
    frame: &'a FlowFrame,
    inverse_depth: f32,
    source: [f32; 2],
    weight: f32,
}

/// A view, and its depths.
pub struct FlowView {
    pub rendered: Rendered,
    pub depths: DepthMap,
}

/// The view at an instant, frames of the reference since the capture's start, from frames with their maps and these maps'
/// confidences ([`confidences`](super::confidences)).
///
/// Pixels that no map has, but some camera filmed, get the colour of what is behind; others are not covered.
pub fn blend(
    mapped: &[MappedFrame],
    confidences: &[Vec<u8>],
    view: &Camera,
    time: f64,
) -> FlowView {
    let splats: Vec<(&FlowFrame, Splat)> = mapped
        .par_iter()
        .zip(confidences)
        .filter_map(|(m, c)| Some((m.frame, Splat::new(*m, c, view, time)?)))
        .collect();
    let (width, height) = (view.width, view.height);
    let disparity_px = mapped.iter().map(|m| m.map.disparity_px).fold(0.0, f32::max);
    let reach = CLUSTER_PX / disparity_px.max(f32::MIN_POSITIVE);
    let mut pixels = vec![Pixel::default(); width * height];
    pixels.par_chunks_mut(width).enumerate().for_each(|(y, row)| {
        let mut candidates = Vec::with_capacity(splats.len());
        let mut colors = Vec::with_capacity(splats.len());
        for (x, pixel) in row.iter_mut().enumerate() {
            candidates.clear();
            let k = y * width + x;
            for (frame, splat) in splats.iter().filter(|(_, splat)| splat.weights[k] > 0.0) {
                candidates.push(Candidate {
                    frame,
                    inverse_depth: splat.inverse_depths[k],
                    source: splat.sources[k],
                    weight: splat.weights[k],
                });
            }
            if let Some(found) = pixel_of(&candidates, reach, &mut colors) {
                *pixel = found;
            }
        }
    });
    fill(&mut pixels, width);
    let behind = Behind::new(mapped, view);
    pixels.par_iter_mut().enumerate().filter(|(_, p)| !p.is_mapped).for_each(|(k, pixel)| {
        let place = [(k % width) as f32 + 0.5, (k / width) as f32 + 0.5];
        match undistorted(view, place) {
            Some(place) => behind.fill(pixel, place),
            None => *pixel = Pixel::default(),
        }
    });
    let depths = pixels.iter().map(|p| 1.0 / p.inverse_depth).collect();
    let coverage = pixels.iter().map(|p| p.inverse_depth > 0.0).collect();
    let is_gray = mapped.iter().all(|m| !m.frame.is_color);
    let channels = if is_gray { 1 } else { 3 };
    let data = pixels.iter().flat_map(|p| p.color.into_iter().take(channels)).collect();
    FlowView {
        rendered: Rendered { image: Image::from_data(width, height, channels, data), coverage },
        depths: DepthMap::from_data(width, height, depths),
    }
}

/// A pixel of the view as a pinhole camera of the same intrinsics has it. `None` where the lens model can't be inverted.
fn undistorted(view: &Camera, [x, y]: [f32; 2]) -> Option<[f32; 2]> {
    if view.model.is_pinhole() {
        return Some([x, y]);
    }
    let (fx, fy, cx, cy) = view.model.intrinsics();
    let ray = view.ray(&Point2::new(f64::from(x), f64::from(y)))?;
    Some([(cx + fx * ray.x) as f32, (cy + fy * ray.y) as f32])
}

/// Frames that may show what no map has in the view.
struct Behind<'a> {
    /// Nearest first.
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

    /// Gives a pixel at `place` the colour of the nearest frame that shows its depth, at rest. Keeps its colour if
    /// something is in front in all of them, and removes its depth if it is outside of all.
    fn fill(&self, pixel: &mut Pixel, [x, y]: [f32; 2]) {
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
                return;
            }
        }
        if !is_filmed {
            *pixel = Pixel::default();
        }
    }
}

/// Colours of a cluster, with their weights.
type WeightedColors = Vec<([f32; 3], f32)>;

/// The pixel of the nearest cluster with enough weight, and what shows through it. `None` without candidates. `colors` is
/// room for the colours.
fn pixel_of(candidates: &[Candidate], reach: f32, colors: &mut WeightedColors) -> Option<Pixel> {
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
    let front = depths().filter(|f| *f > q && support(*f) > FRONT * total).fold(q, f32::max);
    if front > q {
        (q, weight) = heaviest(front - reach, front + reach);
    }
    let mut pixel = mean_of(candidates, q, reach, colors)?;
    let (behind, weight_behind) = heaviest(f32::NEG_INFINITY, q - 2.0 * reach);
    if weight_behind > BEHIND * total {
        let opacity = ((weight / total - FRONT) / (OPAQUE - FRONT)).clamp(0.0, 1.0);
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

/// The mean of a cluster; colours that differ count less.
fn mean_of(
    candidates: &[Candidate],
    q: f32,
    reach: f32,
    colors: &mut WeightedColors,
) -> Option<Pixel> {
    let cluster = || candidates.iter().filter(|c| (c.inverse_depth - q).abs() < reach);
    // Grey cameras say nothing of colour.
    let has_color = cluster().any(|c| c.frame.is_color);
    let cluster = || cluster().filter(|c| c.frame.is_color == has_color);
    let most = cluster().map(|c| c.weight).fold(0.0, f32::max);
    let (mut depths, mut weights) = (0.0, 0.0);
    colors.clear();
    for c in cluster().filter(|c| c.weight >= MIN_SHARE * most) {
        let [x, y] = c.source;
        colors.push((sample(&c.frame.image, x, y, Sampling::Cubic), c.weight));
        depths += c.weight * c.inverse_depth;
        weights += c.weight;
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
    Some(Pixel { color, inverse_depth: depths / weights, is_mapped: true })
}

/// The mean by weight and factor, both positive.
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

/// Fills what no map has from what is behind it, ring by ring.
fn fill(pixels: &mut [Pixel], width: usize) {
    let height = pixels.len() / width;
    let mut open: Vec<usize> = (0..pixels.len()).filter(|&k| !pixels[k].is_mapped).collect();
    if open.is_empty() {
        return;
    }
    let mut filled: Vec<bool> = pixels.iter().map(|p| p.is_mapped).collect();
    loop {
        let mut ring = Vec::new();
        for &k in &open {
            let (x, y) = (k % width, k / width);
            let around = [
                (x > 0).then(|| k - 1),
                (x + 1 < width).then_some(k + 1),
                (y > 0).then(|| k - width),
                (y + 1 < height).then_some(k + width),
            ];
            let neighbors = around.into_iter().flatten().filter(|&n| filled[n]);
            let depth = |n: &usize| pixels[*n].inverse_depth;
            if let Some(n) = neighbors.min_by(|a, b| depth(a).total_cmp(&depth(b))) {
                ring.push((k, n));
            }
        }
        if ring.is_empty() {
            return;
        }
        for &(k, n) in &ring {
            pixels[k] = Pixel { is_mapped: false, ..pixels[n] };
        }
        ring.iter().for_each(|(k, _)| filled[*k] = true);
        open.retain(|k| !filled[*k]);
    }
}
