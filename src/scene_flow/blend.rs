//! Blends the scene flow maps of several frames, splatted into a view, to the view's image.

use super::composite::{ColorCandidate, Pixel, pixel_of, shows_motion};
use super::frame::FlowFrame;
use super::geometry::{Projection, undistorted};
use super::grid::neighbors;
use super::map::MappedFrame;
use super::motion::{MotionMap, QuantizedMotion, SurfaceMotion};
use super::robust_mean::WeightedColors;
use super::splat::{Area, QUARTERS, Splat, SplatPixel};
use crate::camera::Camera;
use crate::lumigraph::{DepthMap, Rendered};
use crate::raster::Image;
use rayon::prelude::*;
use std::ops::Range;

/// Half-width in depth of a cluster, pixels of disparity. A cluster is a group of candidates (surface elements of
/// different scene flow maps) for the same surface at a pixel of the view.
const CLUSTER_PX: f32 = 1.5;
/// Minimum number, of a pixel's eight neighbours, that must show a nearer moving body for the pixel to count as a hole
/// in the body.
const CLOSING: usize = 5;
/// Maximum distance from the border of a hole in a moving body at which the hole's pixels are closed, pixels. Pixels
/// farther inside stay unchanged.
const CLOSED_PX: usize = 4;
/// Maximum number of a view's pixels that are blended at once. With eight scene flow maps, blending them takes about
/// 60 MB.
const BAND_PIXELS: usize = 5 << 16;
/// Minimum number of pixels of a large view. To save memory, a large view is blended in bands of half of
/// [`BAND_PIXELS`].
const LARGE_PIXELS: usize = 1 << 23;
/// Maximum number of pixels at outlines whose quarters are blended at once. With eight scene flow maps, blending them
/// takes about 50 MB.
const QUARTERED_PIXELS: usize = 1 << 16;
/// Maximum distance between a frame's camera and a view that count as being at the same place, metres.
const SAME_PLACE_M: f64 = 1e-9;
/// Maximum angle between a frame's camera and a view that count as having the same direction, radians.
const SAME_ANGLE_RAD: f64 = 1e-7;
/// Maximum time between a frame and a view that count as simultaneous, frame periods of the reference camera.
const SAME_TIME: f64 = 1e-6;

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
    /// at a time. Holes are disoccluded background. A pixel therefore gets the values of the farthest surface beside it:
    /// the mean of those neighbours, covered or already filled, whose inverse depths differ from the smallest by less
    /// than `reach`, 1/m. `width` is the width of the view, pixels.
    fn fill(&mut self, width: usize, reach: f32) {
        let count = self.shown.len();
        let around = |k: u32| neighbors(k as usize, width, count);
        // Views have less than 2³² pixels.
        let is_empty = |shown: &[Shown], k: usize| shown[k] == Shown::Nothing;
        let mut ring: Vec<u32> = (0..self.shown.len() as u32)
            .filter(|&k| {
                is_empty(&self.shown, k as usize) && around(k).any(|n| !is_empty(&self.shown, n))
            })
            .collect();
        while !ring.is_empty() {
            let fill = |&k: &u32| {
                let known = around(k).filter(|&n| !is_empty(&self.shown, n));
                self.background(&known.collect::<Vec<_>>(), reach)
            };
            let filled: Vec<Option<(usize, [f32; 3], f32)>> = ring.iter().map(fill).collect();
            for (&k, filled) in ring.iter().zip(filled) {
                let Some((farthest, color, inverse_depth)) = filled else { continue };
                let k = k as usize;
                (self.colors[k], self.inverse_depths[k]) = (color, inverse_depth);
                self.motions.iter_mut().for_each(|m| m.copy(farthest, k));
                self.shown[k] = Shown::Filled;
            }
            let next = |&k: &u32| around(k).filter(|&n| is_empty(&self.shown, n)).map(|n| n as u32);
            ring = ring.iter().flat_map(next).collect();
            ring.sort_unstable();
            ring.dedup();
        }
    }

    /// Returns the farthest of some pixels, and the mean colour and inverse depth of those whose inverse depth differs
    /// from its by less than `reach`. `None` if there are no pixels.
    fn background(&self, pixels: &[usize], reach: f32) -> Option<(usize, [f32; 3], f32)> {
        let inverse = |n: &usize| self.inverse_depths[*n];
        let farthest = *pixels.iter().min_by(|a, b| inverse(a).total_cmp(&inverse(b)))?;
        let (mut color, mut inverse_depth, mut count) = ([0.0; 3], 0.0, 0.0);
        let is_beside = |n: &&usize| **n == farthest || inverse(n) < inverse(&farthest) + reach;
        for n in pixels.iter().filter(is_beside) {
            color = [0, 1, 2].map(|c| color[c] + self.colors[*n][c]);
            inverse_depth += inverse(n);
            count += 1.0;
        }
        // The farthest pixel is one of them, so that the count is positive.
        Some((farthest, color.map(|c| c / count), inverse_depth / count))
    }
}

/// Rendered view with its depth map, and with the motion of its surfaces if requested.
pub struct FlowView {
    pub rendered: Rendered,
    pub depths: DepthMap,
    pub motions: Option<MotionMap>,
}

/// The scene flow maps of the frames from which a view is blended, with their confidences.
#[derive(Clone, Copy)]
struct Sources<'a> {
    mapped: &'a [MappedFrame<'a>],
    confidences: &'a [Vec<u8>],
    /// Instant of the view, in frame periods of the reference camera since the capture's start.
    time: f64,
    /// Half-width of a cluster in inverse depth, 1/m.
    reach: f32,
    /// Whether outlines are antialiased. They are not if the view is one of the frames, whose own outlines are kept.
    antialiases: bool,
}

/// Returns whether a view at `time` is the frame: from the same place, in the same direction, at the frame's time.
fn is_frame(frame: &FlowFrame, view: &Camera, time: f64) -> bool {
    let [own, other] = [&frame.view, view].map(|camera| camera.cam_from_world.rotation);
    (frame.view.center() - view.center()).norm() < SAME_PLACE_M
        && own.angle_to(&other) < SAME_ANGLE_RAD
        && frame.row_time == 0.0
        && (frame.time - time).abs() < SAME_TIME
}

/// The scene flow maps, splatted into one area of a view.
struct Splats<'a>(Vec<(&'a MappedFrame<'a>, Splat)>);

impl<'a> Sources<'a> {
    fn splats(&self, area: &Area) -> Splats<'a> {
        let maps = self.mapped.par_iter().zip(self.confidences);
        let splat =
            |(m, c): (&'a MappedFrame, &Vec<u8>)| Some((m, Splat::new(*m, c, area, self.time)?));
        Splats(maps.filter_map(splat).collect())
    }
}

impl<'a> Splats<'a> {
    /// Fills `candidates` with the surface elements that the maps show at pixel or quarter `k` of the area.
    fn collect(&self, k: usize, candidates: &mut Vec<ColorCandidate<'a>>) {
        candidates.clear();
        for (mapped, splat) in &self.0 {
            let SplatPixel { inverse_depth, source, weight, .. } = splat.pixels[k];
            if weight > 0.0 {
                let is_moving = shows_motion(mapped.frame, source);
                let frame = mapped.frame;
                candidates.push(ColorCandidate { frame, inverse_depth, source, weight, is_moving });
            }
        }
    }
}

/// One row of the view: colours, inverse depths, and what each pixel shows.
type BlendedRow<'a> = (&'a mut [[f32; 3]], &'a mut [f32], &'a mut [Shown]);

/// Blends the rows `rows` of a view into `pixels`, as [`blend`] describes.
fn blend_rows(sources: Sources, view: &Camera, rows: Range<usize>, pixels: &mut Pixels) {
    let splats = sources.splats(&Area::of_rows(view, rows.clone()));
    let (width, reach) = (view.width, sources.reach);
    let band = rows.start * width..rows.end * width;
    let colors = pixels.colors[band.clone()].par_chunks_mut(width);
    let depths = pixels.inverse_depths[band.clone()].par_chunks_mut(width);
    let shown = pixels.shown[band.clone()].par_chunks_mut(width);
    let motions = pixels.motions.as_ref();
    let row = |(y, (color, depth, shown)): (usize, BlendedRow)| {
        let mut candidates = Vec::with_capacity(splats.0.len());
        let mut room = WeightedColors::default();
        let mut row = vec![QuantizedMotion::default(); motions.map_or(0, |_| width)];
        for x in 0..width {
            let k = y * width + x;
            splats.collect(k, &mut candidates);
            if let Some(found) = pixel_of(&candidates, reach, &mut room) {
                (color[x], depth[x]) = (found.color, found.inverse_depth);
                shown[x] = if found.is_moving { Shown::Moving } else { Shown::Something };
                if let Some(motions) = motions {
                    let of = splats.0.iter().filter(|(_, splat)| splat.pixels[k].weight > 0.0);
                    row[x] = motions.quantized(motion_of(of, k, (found.inverse_depth, reach)));
                }
            }
        }
        row
    };
    let motions: Vec<Vec<QuantizedMotion>> =
        (colors, depths, shown).into_par_iter().enumerate().map(row).collect();
    pixels.motions.iter_mut().for_each(|m| m.extend(motions.iter().flatten().copied()));
    drop(splats);
    if !sources.antialiases {
        return;
    }
    let outline = outline(&pixels.inverse_depths[band.clone()], width, reach);
    for outline in outline.chunks(QUARTERED_PIXELS) {
        let area = Area::of_quarters(view, rows.clone(), outline);
        let splats = sources.splats(&area);
        let color = |i: usize| mean_of_quarters(&splats, i, reach);
        let colors: Vec<_> = (0..outline.len()).into_par_iter().map(color).collect();
        for (&k, color) in outline.iter().zip(colors) {
            let color_of = &mut pixels.colors[band.start + k as usize];
            *color_of = color.unwrap_or(*color_of);
        }
    }
}

/// Returns the indices of the pixels at outlines: those with another inverse depth than one of their four neighbours.
/// `inverse_depths` are those of some rows of a view, 0 where they are unknown.
fn outline(inverse_depths: &[f32], width: usize, reach: f32) -> Vec<u32> {
    let is_outline = |&k: &u32| {
        let k = k as usize;
        let own = inverse_depths[k];
        let x = k % width;
        let left = if x > 0 { inverse_depths[k - 1] } else { own };
        let right = if x + 1 < width { inverse_depths[k + 1] } else { own };
        let above = if k >= width { inverse_depths[k - width] } else { own };
        let below = inverse_depths.get(k + width).copied().unwrap_or(own);
        let differs = |other: f32| other > 0.0 && (other - own).abs() > reach;
        own > 0.0 && [left, right, above, below].into_iter().any(differs)
    };
    // A band has less than 2³² pixels.
    (0..inverse_depths.len() as u32).into_par_iter().filter(is_outline).collect()
}

/// Returns the mean colour of the quarters of the `i`-th pixel of an area. `None` if no map covers them.
fn mean_of_quarters(splats: &Splats, i: usize, reach: f32) -> Option<[f32; 3]> {
    let (mut candidates, mut room) = (Vec::new(), WeightedColors::default());
    let (mut sum, mut count) = ([0.0; 3], 0.0);
    for k in QUARTERS * i..QUARTERS * (i + 1) {
        splats.collect(k, &mut candidates);
        if let Some(found) = pixel_of(&candidates, reach, &mut room) {
            (0..3).for_each(|c| sum[c] += found.color[c]);
            count += 1.0;
        }
    }
    (count > 0.0).then(|| sum.map(|v| v / count))
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
    for (mapped, splat) in splats {
        let pixel = splat.pixels[k];
        if (pixel.inverse_depth - inverse_depth).abs() >= reach {
            continue;
        }
        let (weight, motion) = (pixel.weight, splat.motion(mapped.map, pixel.source));
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
    let reach = CLUSTER_PX / disparity_px(mapped).max(f32::MIN_POSITIVE);
    let antialiases = !mapped.iter().any(|m| is_frame(m.frame, view, time));
    let sources = Sources { mapped, confidences, time, reach, antialiases };
    for first in (0..height).step_by(rows_at_once) {
        let rows = first..(first + rows_at_once).min(height);
        blend_rows(sources, view, rows, &mut pixels);
    }
    if mapped.iter().any(|m| m.frame.still.is_some()) {
        pixels.close(width);
    }
    pixels.fill(width, reach);
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
            if !frame.films([u, v]) {
                continue;
            }
            let k = v as usize * map.width + u as usize;
            is_filmed = true;
            let in_front = map.element(&map.pixels()[k]).inverse_depth - q;
            if in_front * map.disparity_px < CLUSTER_PX {
                pixel.color = frame.color([u, v]).map(|c| c.clamp(0.0, 1.0));
                return Some(pixel);
            }
        }
        is_filmed.then_some(pixel)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_hole_gets_the_mean_of_the_background_beside_it_whatever_is_nearer() {
        // A row of pixels: wall, hole, wall of another colour, a hole of three pixels, a nearer body.
        let mut pixels = Pixels::new(7, None);
        let known = [(0, 0.2, 1.0), (2, 0.4, 1.01), (6, 0.9, 3.0)];
        for (k, value, inverse_depth) in known {
            (pixels.colors[k], pixels.inverse_depths[k]) = ([value; 3], inverse_depth);
            pixels.shown[k] = Shown::Something;
        }
        pixels.fill(7, 0.1);
        let values: Vec<f32> = pixels.colors.iter().map(|[r, _, _]| *r).collect();
        assert!((values[1] - 0.3).abs() < 1e-6, "{values:?}");
        assert!((pixels.inverse_depths[1] - 1.005).abs() < 1e-6);
        // From both sides, the fill meets in the middle, where the farther surface counts.
        assert_eq!(values[3..6], [0.4, 0.4, 0.9]);
        assert!(pixels.shown.iter().all(|shown| *shown != Shown::Nothing));
    }
}
