//! Blends the scene flow maps of several frames, splatted into a view, to the view's image.

use super::composite::{ColorCandidate, Pixel, mean_pixel, pixel_of, shows_motion};
use super::frame::FlowFrame;
use super::geometry::{Projection, undistorted};
use super::map::MappedFrame;
use super::motion::{MotionMap, QuantizedMotion, SurfaceMotion};
use super::pixels::{Pixels, Shown};
use super::robust_mean::WeightedColors;
use super::splat::{Area, QUARTERS, Splat, SplatPixel, squared_error};
use crate::camera::Camera;
use crate::lumigraph::{DepthMap, Rendered};
use crate::raster::Image;
use rayon::prelude::*;
use std::ops::Range;

/// Half-width in depth of a cluster, pixels of disparity. A cluster is a group of candidates (surface elements of
/// different scene flow maps) for the same surface at a pixel of the view.
const CLUSTER_PX: f32 = 1.5;
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

/// Number of scene flow maps from which a quick view ([`Detail::Quick`]) is blended where they agree.
const QUICK_MAPS: usize = 3;
/// Minimum number of scene flow maps that must show a pixel of a quick view for the others to be left out.
const MIN_AGREEING: usize = 2;
/// Speed for which the maps of a quick view are chosen, pixels per frame: that of a body of moderate motion.
const TYPICAL_SPEED_PX: f32 = 10.0;
/// One pixel in this many is used for the mean inverse depth of a scene flow map.
const DEPTH_SAMPLES: usize = 101;

/// How completely a view is blended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Detail {
    /// All maps at every pixel, and antialiased outlines.
    Full,
    /// Like [`Self::Full`], with the motion of the view's surfaces.
    WithMotion,
    /// Faster, for a viewpoint or an instant that changes. Where the three maps nearest in place and time agree, the
    /// others are left out. Outlines are not antialiased.
    Quick,
}

/// Rendered view with its depth map, and with the motion of its surfaces if requested.
pub struct FlowView {
    pub rendered: Rendered,
    pub depths: DepthMap,
    pub motions: Option<MotionMap>,
}

/// The scene flow map of a frame from which a view is blended, with the confidences of its pixels.
#[derive(Clone, Copy)]
struct Source<'a> {
    mapped: &'a MappedFrame<'a>,
    confidences: &'a [u8],
}

/// The sources of a view.
#[derive(Clone, Copy)]
struct Sources<'a> {
    /// The sources that are splatted at all pixels.
    first: &'a [Source<'a>],
    /// The sources that are splatted only where the first ones don't agree.
    others: &'a [Source<'a>],
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

impl<'a> Splats<'a> {
    fn new(sources: &[Source<'a>], area: &Area, time: f64) -> Self {
        let splat = |&Source { mapped, confidences }: &Source<'a>| {
            Some((mapped, Splat::new(*mapped, confidences, area, time)?))
        };
        Splats(sources.par_iter().filter_map(splat).collect())
    }

    /// Adds the surface elements that the maps show at part `k` of the area to `candidates`.
    fn collect(&self, k: usize, candidates: &mut Vec<ColorCandidate<'a>>) {
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
    let splats = Splats::new(sources.first, &Area::of_rows(view, rows.clone()), sources.time);
    let (width, reach, is_quick) = (view.width, sources.reach, !sources.others.is_empty());
    let band = rows.start * width..rows.end * width;
    let colors = pixels.colors[band.clone()].par_chunks_mut(width);
    let depths = pixels.inverse_depths[band.clone()].par_chunks_mut(width);
    let shown = pixels.shown[band.clone()].par_chunks_mut(width);
    let motions = pixels.motions.as_ref();
    let row = |(y, (color, depth, shown)): (usize, BlendedRow)| {
        let mut candidates = Vec::with_capacity(splats.0.len());
        let mut room = WeightedColors::default();
        let mut row = vec![QuantizedMotion::default(); motions.map_or(0, |_| width)];
        let mut open = Vec::new();
        for x in 0..width {
            let k = y * width + x;
            candidates.clear();
            splats.collect(k, &mut candidates);
            if is_quick && !agree(&candidates, reach) {
                // A band has less than 2³² pixels.
                open.push(k as u32);
                continue;
            }
            let found = match is_quick {
                true => mean_pixel(&candidates),
                false => pixel_of(&candidates, reach, &mut room),
            };
            if let Some(found) = found {
                (color[x], depth[x], shown[x]) =
                    (found.color, found.inverse_depth, Shown::of(&found));
                if let Some(motions) = motions {
                    let of = splats.0.iter().filter(|(_, splat)| splat.pixels[k].weight > 0.0);
                    row[x] = motions.quantized(motion_of(of, k, (found.inverse_depth, reach)));
                }
            }
        }
        (row, open)
    };
    let (motions, open): (Vec<Vec<QuantizedMotion>>, Vec<Vec<u32>>) =
        (colors, depths, shown).into_par_iter().enumerate().map(row).unzip();
    pixels.motions.iter_mut().for_each(|m| m.extend(motions.iter().flatten().copied()));
    blend_open(sources, &splats, (view, rows.clone(), &open.concat()), pixels);
    drop(splats);
    if sources.antialiases {
        antialias(sources, view, rows, pixels);
    }
}

/// Returns whether the surface elements that the first maps show at a pixel belong to one surface, and are sufficiently
/// many.
fn agree(candidates: &[ColorCandidate], reach: f32) -> bool {
    let depths = || candidates.iter().map(|c| c.inverse_depth);
    let [min, max] =
        [depths().fold(f32::INFINITY, f32::min), depths().fold(f32::NEG_INFINITY, f32::max)];
    candidates.len() >= MIN_AGREEING && max - min < reach
}

/// Blends single pixels from all maps: those at which the first maps, `splats`, don't agree. `open` are the indices of
/// these pixels in the rows `rows` of the view.
fn blend_open(
    sources: Sources,
    splats: &Splats,
    (view, rows, open): (&Camera, Range<usize>, &[u32]),
    pixels: &mut Pixels,
) {
    if open.is_empty() {
        return;
    }
    let start = rows.start * view.width;
    let others = Splats::new(sources.others, &Area::of_pixels(view, rows, open), sources.time);
    let blended = |(i, &k): (usize, &u32)| {
        let (mut candidates, mut room) = (Vec::new(), WeightedColors::default());
        splats.collect(k as usize, &mut candidates);
        others.collect(i, &mut candidates);
        pixel_of(&candidates, sources.reach, &mut room)
    };
    let blended: Vec<Option<Pixel>> = open.par_iter().enumerate().map(blended).collect();
    for (&k, found) in open.iter().zip(blended) {
        let k = start + k as usize;
        if let Some(found) = found {
            (pixels.colors[k], pixels.inverse_depths[k]) = (found.color, found.inverse_depth);
            pixels.shown[k] = Shown::of(&found);
        }
    }
}

/// Antialiases outlines in the rows `rows` of a view: blends the quarters of their pixels.
fn antialias(sources: Sources, view: &Camera, rows: Range<usize>, pixels: &mut Pixels) {
    let (width, reach) = (view.width, sources.reach);
    let band = rows.start * width..rows.end * width;
    let outline = outline(&pixels.inverse_depths[band.clone()], width, reach);
    for outline in outline.chunks(QUARTERED_PIXELS) {
        let area = Area::of_quarters(view, rows.clone(), outline);
        let splats = Splats::new(sources.first, &area, sources.time);
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
        candidates.clear();
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
/// images stay black and have no depth.
pub fn blend(
    mapped: &[MappedFrame],
    confidences: &[Vec<u8>],
    view: &Camera,
    time: f64,
    detail: Detail,
) -> FlowView {
    let (width, height) = (view.width, view.height);
    let motions = (detail == Detail::WithMotion)
        .then(|| MotionMap::empty(disparity_px(mapped), width * height));
    let mut pixels = Pixels::new(width * height, motions);
    // The pixels of a large view need much memory, so its bands are smaller.
    let band_pixels = if width * height < LARGE_PIXELS { BAND_PIXELS } else { BAND_PIXELS / 2 };
    let rows_at_once = (band_pixels / width.max(1)).max(1);
    let reach = CLUSTER_PX / disparity_px(mapped).max(f32::MIN_POSITIVE);
    let is_quick = detail == Detail::Quick;
    let antialiases = !is_quick && !mapped.iter().any(|m| is_frame(m.frame, view, time));
    let source = |(mapped, confidences)| Source { mapped, confidences };
    let mut all: Vec<Source> =
        mapped.iter().zip(confidences.iter().map(Vec::as_slice)).map(source).collect();
    let at_once = if is_quick { QUICK_MAPS.min(all.len()) } else { all.len() };
    if is_quick {
        sort_by_error(&mut all, view, time);
    }
    let (first, others) = all.split_at(at_once);
    let sources = Sources { first, others, time, reach, antialiases };
    for first in (0..height).step_by(rows_at_once) {
        let rows = first..(first + rows_at_once).min(height);
        blend_rows(sources, view, rows, &mut pixels);
    }
    if mapped.iter().any(|m| m.frame.still.is_some()) {
        pixels.close(width);
    }
    pixels.fill(width, reach);
    color_holes(mapped, view, &mut pixels);
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

/// Colours the pixels of holes, which already have the depth of the background, by [`Behind`]. Pixels outside all
/// images become black, with an unknown depth.
fn color_holes(mapped: &[MappedFrame], view: &Camera, pixels: &mut Pixels) {
    let width = view.width;
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
}

/// Sorts sources by the expected error of a surface element at a typical depth, in typical motion.
fn sort_by_error(sources: &mut [Source], view: &Camera, time: f64) {
    let error = |source: &Source| {
        let MappedFrame { frame, map } = source.mapped;
        let depths = map.pixels().iter().step_by(DEPTH_SAMPLES);
        let depths: Vec<f32> = depths.map(|pixel| map.element(pixel).inverse_depth).collect();
        let mean = depths.iter().sum::<f32>() / depths.len().max(1) as f32;
        squared_error(frame, (view, time), (mean, TYPICAL_SPEED_PX))
    };
    // Squares are not negative, so that their bits have the order of the numbers.
    sources.sort_by_cached_key(|source| error(source).to_bits());
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
