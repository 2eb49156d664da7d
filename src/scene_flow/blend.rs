//! Blends the scene flow maps of several frames, splatted into a view, to the view's image.

use super::agreed::blend_agreed;
use super::area::{Area, QUARTERS, doubled};
use super::composite::{Pixel, pixel_of};
use super::frame::FlowFrame;
use super::geometry::{Projection, undistorted};
use super::map::MappedFrame;
use super::motion::{MotionMap, QuantizedMotion, SurfaceMotion};
use super::pixels::{Band, Pixels, Shown};
use super::placement::{Placement, fading_of, squared_error};
use super::robust_mean::WeightedColors;
use super::splat::Splats;
use crate::camera::Camera;
use crate::lumigraph::{DepthMap, Rendered};
use crate::raster::Image;
use rayon::prelude::*;
use std::ops::Range;

/// Half-width in depth of a cluster, pixels of disparity. A cluster is a group of candidates (surface elements of
/// different scene flow maps) for the same surface at a pixel of the view.
const CLUSTER_PX: f32 = 1.5;
/// Maximum number of pixels of a band, the rows of a view that a thread blends at once; but at least one row. Each eight scene
/// flow maps take about 6 MB a thread, and antialiasing takes up to four times as much if all pixels are at outlines. A view has
/// up to two maps of a camera.
const BAND_PIXELS: usize = 1 << 15;
/// Minimum number of bands of a view, for as many threads.
const MIN_BANDS: usize = 8;
/// Maximum distance between a frame's camera and a view that count as being at the same place, metres.
const SAME_PLACE_M: f64 = 1e-9;
/// Maximum angle between a frame's camera and a view that count as having the same direction, radians.
const SAME_ANGLE_RAD: f64 = 1e-7;
/// Maximum time between a frame and a view that count as simultaneous, frame periods of the reference camera.
const SAME_TIME: f64 = 1e-6;

/// Number of scene flow maps from which a quick view ([`Detail::Quick`]) is blended where they agree.
const QUICK_MAPS: usize = 3;
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

/// The placed scene flow maps from which a view is blended.
#[derive(Clone, Copy)]
struct Sources<'a> {
    /// The maps that are splatted at all pixels.
    first: &'a [Placement<'a>],
    /// The maps that are splatted only where the first ones don't agree.
    others: &'a [Placement<'a>],
    /// Half-width of a cluster in inverse depth, 1/m.
    reach: f32,
}

/// Returns whether a view at `time` is the frame: from the same place, in the same direction, at the frame's time.
fn is_frame(frame: &FlowFrame, view: &Camera, time: f64) -> bool {
    let [own, other] = [&frame.view, view].map(|camera| camera.cam_from_world.rotation);
    (frame.view.center() - view.center()).norm() < SAME_PLACE_M
        && own.angle_to(&other) < SAME_ANGLE_RAD
        && frame.row_time == 0.0
        && (frame.time - time).abs() < SAME_TIME
}

/// Blends a band of a view, as [`blend`] describes. Outlines are not antialiased.
fn blend_band(sources: Sources, view: &Camera, mut band: Band) {
    let splats = Splats::new(sources.first, &Area::of_rows(view, band.rows.clone()));
    if sources.others.is_empty() {
        blend_all(&mut band, &splats, sources.reach);
    } else {
        let open = blend_agreed(&mut band, &splats, view.width, sources.reach);
        blend_open(sources, (&splats, &open), view, &mut band);
    }
}

/// Blends all pixels of a band from all maps.
fn blend_all(band: &mut Band, splats: &Splats, reach: f32) {
    let (mut candidates, mut room) = (Vec::new(), WeightedColors::default());
    for k in 0..band.colors.len() {
        candidates.clear();
        splats.collect(k, &mut candidates);
        let Some(found) = pixel_of(&candidates, reach, &mut room) else { continue };
        band.set(k, &found);
        if let Some((motions, disparity_px)) = &mut band.motions {
            let motion = motion_of(splats, k, (found.inverse_depth, reach));
            motions[k] = QuantizedMotion::new(motion, *disparity_px);
        }
    }
}

/// Blends single pixels from all maps: those at which the first maps don't agree. `splats` are the first maps, and
/// `open` are the indices of these pixels in the band.
fn blend_open(sources: Sources, (splats, open): (&Splats, &[u32]), view: &Camera, band: &mut Band) {
    if open.is_empty() {
        return;
    }
    let area = Area::of_pixels(view, band.rows.clone(), open);
    let others = Splats::new(sources.others, &area);
    let (mut candidates, mut room) = (Vec::new(), WeightedColors::default());
    for (i, &k) in open.iter().enumerate() {
        let k = k as usize;
        candidates.clear();
        splats.collect(k, &mut candidates);
        others.collect(i, &mut candidates);
        if let Some(found) = pixel_of(&candidates, sources.reach, &mut room) {
            band.set(k, &found);
        }
    }
}

/// Antialiases the outlines of a view: blends the quarters of their pixels. `placements` are those in the view with twice
/// the width and height, `doubled`. `rows_at_once` is the number of rows of a band.
fn antialias(
    placements: &[Placement],
    doubled: &Camera,
    (reach, rows_at_once): (f32, usize),
    pixels: &mut Pixels,
) {
    let width = doubled.width / 2;
    let Pixels { colors, inverse_depths, .. } = pixels;
    let bands = colors.par_chunks_mut((rows_at_once * width).max(1)).enumerate();
    bands.for_each(|(band, colors)| {
        let first = band * rows_at_once;
        let rows = first..first + colors.len() / width;
        let outline = outline(inverse_depths, rows.clone(), width, reach);
        if outline.is_empty() {
            return;
        }
        let splats = Splats::new(placements, &Area::of_quarters(doubled, rows, &outline));
        let (mut candidates, mut room) = (Vec::new(), WeightedColors::default());
        for (i, &k) in outline.iter().enumerate() {
            let (mut sum, mut count) = ([0.0; 3], 0.0);
            for quarter in QUARTERS * i..QUARTERS * (i + 1) {
                candidates.clear();
                splats.collect(quarter, &mut candidates);
                if let Some(found) = pixel_of(&candidates, reach, &mut room) {
                    (0..3).for_each(|c| sum[c] += found.color[c]);
                    count += 1.0;
                }
            }
            if count > 0.0 {
                colors[k as usize] = sum.map(|v| v / count);
            }
        }
    });
}

/// Returns the pixels at outlines in some rows of a view: those with another inverse depth than one of their four
/// neighbours. They are indices in these rows. `inverse_depths` are those of the view, 0 where they are unknown.
fn outline(inverse_depths: &[f32], rows: Range<usize>, width: usize, reach: f32) -> Vec<u32> {
    let first = rows.start * width;
    let is_outline = |&k: &usize| {
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
    (first..rows.end * width).filter(is_outline).map(|k| (k - first) as u32).collect()
}

/// Returns the disparity of a point at a depth of 1 m, pixels, at the maps' baseline of twice the distance between
/// neighbouring cameras. If it differs between the scene flow maps, returns the largest.
fn disparity_px(mapped: &[MappedFrame]) -> f32 {
    mapped.iter().map(|m| m.map.disparity_px).fold(0.0, f32::max)
}

/// Returns the weighted mean motion of the surface that pixel `k` of the blended rows shows. It is the mean over
/// surface elements whose inverse depth differs from `inverse_depth` by less than `reach`, both in 1/m.
fn motion_of(splats: &Splats, k: usize, (inverse_depth, reach): (f32, f32)) -> SurfaceMotion {
    let (mut sum, mut weights) = (SurfaceMotion::default(), 0.0);
    for (placement, splat) in &splats.0 {
        let pixel = splat.pixels[k];
        let weight = pixel.weight;
        if weight <= 0.0 || (pixel.inverse_depth - inverse_depth).abs() >= reach {
            continue;
        }
        let motion = placement.motion(pixel.source);
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
/// the confidences of the scene flow maps, as [`confidences`](super::confidences) returns them. A quick view needs only those
/// of [`quick_maps`]; the others may be [`uncompared`](super::uncompared).
///
/// A hole that lies inside at least one camera's image is filled with the background beside it. Pixels outside all
/// images stay black and have no depth.
pub fn blend<C: AsRef<[u8]> + Sync>(
    mapped: &[MappedFrame],
    confidences: &[C],
    view: &Camera,
    time: f64,
    detail: Detail,
) -> FlowView {
    let (width, height) = (view.width, view.height);
    let motions = (detail == Detail::WithMotion)
        .then(|| MotionMap::still(disparity_px(mapped), width * height));
    let mut pixels = Pixels::new(width * height, motions);
    let rows_at_once = (BAND_PIXELS / width.max(1)).min(height.div_ceil(MIN_BANDS)).max(1);
    let reach = CLUSTER_PX / disparity_px(mapped).max(f32::MIN_POSITIVE);
    let is_quick = detail == Detail::Quick;
    // A view that is one of the frames keeps the frame's outlines.
    let antialiases = !is_quick && !mapped.iter().any(|m| is_frame(m.frame, view, time));
    let all: Vec<usize> = (0..mapped.len()).collect();
    let at_once = if is_quick { quick_maps(mapped, view, time) } else { all.clone() };
    let later: Vec<usize> = all.iter().copied().filter(|k| !at_once.contains(k)).collect();
    let placed = |camera: &Camera, maps: &[usize]| -> Vec<Placement> {
        let place = |&k: &usize| Placement::new(mapped[k], confidences[k].as_ref(), (camera, time));
        maps.par_iter().filter_map(place).collect()
    };
    let (first, others) = (placed(view, &at_once), placed(view, &later));
    let sources = Sources { first: &first, others: &others, reach };
    let bands = pixels.bands(width, rows_at_once);
    bands.into_par_iter().for_each(|band| blend_band(sources, view, band));
    if antialiases {
        let doubled = doubled(view);
        antialias(&placed(&doubled, &all), &doubled, (reach, rows_at_once), &mut pixels);
    }
    if mapped.iter().any(|m| m.frame.still.is_some()) {
        pixels.close(width);
    }
    pixels.fill(width, reach);
    color_holes(mapped, (view, time), &mut pixels);
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
fn color_holes(mapped: &[MappedFrame], (view, time): (&Camera, f64), pixels: &mut Pixels) {
    let width = view.width;
    let behind = Behind::new(mapped, (view, time));
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

/// Returns the indices of the maps from which a quick view at `time` is blended where they agree: those with the smallest
/// expected error of a surface element at a typical depth, in typical motion. Frames that have faded count less.
pub fn quick_maps(mapped: &[MappedFrame], view: &Camera, time: f64) -> Vec<usize> {
    let error = |&k: &usize| {
        let MappedFrame { frame, map } = mapped[k];
        let sampled = (0..map.pixels().len()).step_by(DEPTH_SAMPLES);
        let is_filmed = |&pixel: &usize| frame.is_filmed.as_ref().is_none_or(|mask| mask[pixel]);
        let filmed = sampled.filter(is_filmed);
        let depths: Vec<f32> =
            filmed.map(|pixel| map.element(&map.pixels()[pixel]).inverse_depth).collect();
        let mean = depths.iter().sum::<f32>() / depths.len().max(1) as f32;
        // Weights are inversely proportional to squared errors, and proportional to fading, which is positive.
        squared_error(frame, (view, time), (mean, TYPICAL_SPEED_PX)) / fading_of(frame, time)
    };
    let mut maps: Vec<usize> = (0..mapped.len()).collect();
    // Squares are not negative, so that their bits have the order of the numbers.
    maps.sort_by_cached_key(|k| error(k).to_bits());
    maps.truncate(QUICK_MAPS);
    maps
}

/// Frames that give the background colours with which holes of the view are filled.
struct Behind<'a> {
    /// The frames, each with the projection from the view, in order of distance between the frame's camera and the
    /// view, and those of a camera in order of distance in time.
    frames: Vec<(MappedFrame<'a>, Projection)>,
}

impl<'a> Behind<'a> {
    fn new(mapped: &[MappedFrame<'a>], (view, time): (&Camera, f64)) -> Self {
        let mut frames: Vec<_> = mapped
            .iter()
            .filter_map(|m| Some((*m, Projection::new(view, &m.frame.view)?)))
            .collect();
        let distance = |m: &MappedFrame| (m.frame.view.center() - view.center()).norm();
        let dt = |m: &MappedFrame| (m.frame.time - time).abs();
        frames.sort_by(|(a, _), (b, _)| {
            distance(a).total_cmp(&distance(b)).then(dt(a).total_cmp(&dt(b)))
        });
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
