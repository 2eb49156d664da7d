//! Whether the scene flow maps of two frames agree on the depth and motion of surface elements.

use super::element_lanes::{COLUMNS, ElementLanes, eight, length};
use super::flow_pixel::FlowPixel;
use super::geometry::Projection;
use super::map::{FlowMap, MappedFrame};
use super::tile_bounds::{ROUNDING_PX, TILE_PX, TileBounds, columns_of};
use super::timing::TimeBetween;
use crate::simd::{F32x8, LANES, multiversion};
use std::ops::Range;

/// Maximum time between two frames whose scene flow maps are compared, in frame periods of the reference camera.
pub(super) const MAX_CONFIRMING_DT: f32 = 0.8;
/// Maximum difference in disparity between a surface element and an element of another scene flow map that confirms
/// it, pixels.
pub(super) const MAX_DISPARITY_ERROR_PX: f32 = 1.5;
/// Constant part of the maximum difference in velocity between a surface element and an element of another scene flow
/// map that confirms it, pixels per frame.
const MAX_MOTION_ERROR_PX: f32 = 2.0;
/// Proportional part of the maximum difference in velocity between a surface element and an element of another scene
/// flow map that confirms it, as a fraction of the element's speed.
const MAX_MOTION_ERROR: f32 = 0.15;

/// Code of a surface element that projects outside the other frame. Codes are whole numbers; SIMD selects between floats.
const OUTSIDE: f32 = 0.0;
/// Code of a surface element with which the other map agrees.
const CONFIRMED: f32 = 1.0;
/// Code of a surface element with which the other map disagrees.
const CONTRADICTED: f32 = 2.0;
/// Code of a surface element that is occluded in the other map.
const HIDDEN: f32 = 3.0;

/// How another scene flow map agrees with each pixel of a map, row by row. Four pixels of a row take a byte.
///
/// A pixel's code is 0 if its surface element projects outside the other frame, 1 if it is confirmed, 2 if it is contradicted,
/// and 3 if it is occluded in the other map.
#[derive(Debug, PartialEq)]
pub struct Agreements(pub(super) Vec<u8>);

/// A byte of [`Agreements`] whose four pixels are confirmed.
const ALL_CONFIRMED: u8 = 0b01_01_01_01;

impl Agreements {
    /// Returns the number of bytes of a row of `width` pixels.
    pub(super) fn row_bytes(width: usize) -> usize {
        width.div_ceil(4)
    }

    /// Returns the size in memory, bytes.
    pub fn bytes(&self) -> usize {
        self.0.len()
    }
}

/// Returns how the scene flow map `by` agrees with each pixel of `of`. `None` if the frames are too far apart
/// in time, or the intrinsic matrix of `of` is singular.
pub fn agreements(of: &MappedFrame, by: &MappedFrame) -> Option<Agreements> {
    let comparison = Comparison::new(of, by)?;
    let map = of.map;
    let [_, tile_rows] = map.tiles();
    let row_bytes = Agreements::row_bytes(map.width);
    let mut all = vec![ALL_CONFIRMED; row_bytes * map.height];
    let mut row = ComparedRow::default();
    for tile_row in 0..tile_rows {
        let undecided = comparison.undecided_columns(tile_row);
        let first = tile_row * TILE_PX[1];
        for y in first..(first + TILE_PX[1]).min(map.height) {
            for columns in &undecided {
                row.compare(&comparison, (columns, y));
                // Tiles begin at whole bytes.
                let bytes = &mut all[y * row_bytes + columns.start / 4..];
                let count = Agreements::row_bytes(columns.len());
                let (fours, _) = row.agreements.as_chunks();
                for (byte, [a, b, c, d]) in bytes[..count].iter_mut().zip(fours) {
                    *byte = a | b << 2 | c << 4 | d << 6;
                }
            }
        }
    }
    Some(Agreements(all))
}

/// Returns the pixels of `of` that the scene flow map `by` confirms: for each one, its index and the position in the
/// other frame where the same surface is seen, pixels. The result is empty if the frames aren't compared
/// ([`agreements`]).
pub fn confirmed_by(of: &MappedFrame, by: &MappedFrame) -> Vec<(usize, [f32; 2])> {
    let Some(comparison) = Comparison::new(of, by) else { return Vec::new() };
    let width = of.map.width;
    let (mut row, mut all) = (ComparedRow::default(), Vec::new());
    for y in 0..of.map.height {
        row.compare(&comparison, (&(0..width), y));
        let is_confirmed = |x: &usize| row.agreements[*x] == CONFIRMED as u8;
        let confirmed = (0..width).filter(is_confirmed);
        all.extend(confirmed.map(|x| (y * width + x, [row.x[x], row.y[x]])));
    }
    all
}

/// Comparison of a frame's scene flow map with that of another frame.
struct Comparison<'a> {
    own: &'a FlowMap,
    other: MappedFrame<'a>,
    time: TimeBetween,
    projection: Projection,
}

impl<'a> Comparison<'a> {
    /// `None` if the frames are too far apart in time, or the intrinsic matrix of `of` is singular.
    fn new(of: &MappedFrame<'a>, by: &MappedFrame<'a>) -> Option<Self> {
        let time = TimeBetween::new(of.frame, by.frame);
        let is_near = time.frames().abs() <= MAX_CONFIRMING_DT;
        let projection = Projection::new(&of.frame.view, &by.frame.view).filter(|_| is_near)?;
        Some(Self { own: of.map, other: *by, time, projection })
    }

    /// Returns the columns of a row of tiles without those of tiles that the other map confirms as a whole.
    fn undecided_columns(&self, tile_row: usize) -> Vec<Range<usize>> {
        let confirmed = self.confirmed_tiles(tile_row);
        columns_of(self.own.width, |tile| !confirmed[tile])
    }

    /// Returns, for each tile of a row of tiles, whether the other map certainly confirms all its surface elements, by the
    /// ranges of their depths and motions. Only slow elements are considered.
    fn confirmed_tiles(&self, tile_row: usize) -> Vec<bool> {
        let MappedFrame { frame, map: other } = self.other;
        let [columns, _] = self.own.tiles();
        // The time would depend on the row; and which pixels were filmed isn't known for whole tiles.
        if !self.time.is_global() || frame.is_filmed.is_some() {
            return vec![false; columns];
        }
        let tiles = self.own.tile_row(tile_row, [self.time.frames(); 2]);
        // The margin is for rounding: only what is certain is decided.
        let max = (MAX_DISPARITY_ERROR_PX - ROUNDING_PX) / self.own.disparity_px;
        let is_confirmed = |(range, tile): (&[FlowPixel; 2], TileBounds)| {
            let place = tile.place.map(|[a, b]| [a - ROUNDING_PX, b + ROUNDING_PX]);
            range.iter().all(FlowPixel::is_slow)
                && other.slow_depths(place).is_some_and(|[farthest_there, nearest_there]| {
                    let [farthest, nearest] = tile.inverse_depth;
                    farthest_there - nearest > -max && nearest_there - farthest < max
                })
        };
        tiles.ranges.iter().zip(tiles.bounds(&self.projection)).map(is_confirmed).collect()
    }

    /// Returns the times from the exposures of eight surface elements to their exposures in the other frame. `x` is the
    /// column of the first.
    #[inline(always)]
    fn times(&self, pixels: &[FlowPixel; LANES], (x, y): (usize, usize)) -> [f32; LANES] {
        let mut times = [self.time.frames(); LANES];
        if !self.time.is_global() {
            for (l, (time, pixel)) in times.iter_mut().zip(pixels).enumerate() {
                let place = ((x + l) as f32 + 0.5, y as f32 + 0.5);
                *time = self.time.of_element(&self.own.element(pixel), place, &self.projection);
            }
        }
        times
    }
}

/// Successive surface elements of one row, compared with another frame's map, and padded to whole SIMD vectors.
#[derive(Default)]
struct ComparedRow {
    /// Positions in the other frame, pixels.
    x: Vec<f32>,
    y: Vec<f32>,
    /// Codes, as in [`Agreements`].
    agreements: Vec<u8>,
}

impl ComparedRow {
    /// Compares the surface elements of row `y` and of these columns.
    fn compare(&mut self, comparison: &Comparison, (columns, y): (&Range<usize>, usize)) {
        let count = columns.len().next_multiple_of(LANES);
        [&mut self.x, &mut self.y].into_iter().for_each(|values| values.resize(count, 0.0));
        self.agreements.resize(count, 0);
        compare_row(self, comparison, (columns, y));
    }
}

/// Eight surface elements, moved into the other frame.
struct Moved<V: F32x8> {
    /// Position, pixels, and inverse depth, 1/m.
    place: [V; 3],
    /// Motion within the next frame period, pixels.
    velocity: [V; 2],
}

impl<V: F32x8> Moved<V> {
    /// Like [`Element::transferred`](super::element::Element::transferred).
    #[inline(always)]
    fn new(elements: &ElementLanes<V>, place: [V; 2], dt: V, projection: &Projection) -> Self {
        let [x, y, q] = elements.moved(place, dt);
        let [u, v, inverse_depth, _] = projection.project_lanes([x, y, q]);
        let ([vx, vy], [ax, ay]) = (elements.velocity, elements.acceleration);
        let next = [x + vx + dt * ax, y + vy + dt * ay, q + elements.inverse_depth_rate];
        let [u1, v1, ..] = projection.project_lanes(next);
        Self { place: [u, v, inverse_depth], velocity: [u1 - u, v1 - v] }
    }
}

#[inline(always)]
fn compared<V: F32x8>(
    row: &mut ComparedRow,
    comparison: &Comparison,
    (columns, y): (&Range<usize>, usize),
) {
    let &Comparison { own, other: MappedFrame { frame, map: other }, .. } = comparison;
    let pixels = &own.pixels()[y * own.width..][columns.clone()];
    let (scales, other_scales) = (own.scales(), other.scales());
    let [width, height] = [other.width, other.height].map(|side| side as f32);
    for first in (0..pixels.len()).step_by(LANES) {
        let eight_pixels = eight(pixels, first);
        let elements = ElementLanes::<V>::new(&eight_pixels, &scales);
        let x = columns.start + first;
        let dt = V::from_array(&comparison.times(&eight_pixels, (x, y)));
        let from = [V::from_array(&COLUMNS) + V::splat(x as f32), V::splat(y as f32 + 0.5)];
        let moved = Moved::new(&elements, from, dt, &comparison.projection);
        let [u, v, inverse_depth] = moved.place;
        u.store(&mut row.x, first);
        v.store(&mut row.y, first);
        // Elements outside of the other frame are compared with its border, and the result isn't used.
        let (zero, last) = (V::zero(), [width, height].map(|side| side - 1.0));
        let (seen_x, _) = u.simd_max(zero).simd_min(V::splat(last[0])).floor_and_fraction();
        let (seen_y, _) = v.simd_max(zero).simd_min(V::splat(last[1])).floor_and_fraction();
        let mut there = [FlowPixel::default(); LANES];
        for l in 0..LANES {
            there[l] = other.pixels()[seen_y[l] as usize * other.width + seen_x[l] as usize];
        }
        let there = ElementLanes::<V>::new(&there, &other_scales);
        let disparity = (there.inverse_depth - inverse_depth) * V::splat(own.disparity_px);
        let code = agreement(&elements, &moved, &there, disparity);
        let outside = V::splat(OUTSIDE);
        let code = u.if_below(zero, outside, u.if_below(V::splat(width), code, outside));
        let code = v.if_below(zero, outside, v.if_below(V::splat(height), code, outside));
        let (code, _) = code.floor_and_fraction();
        let codes = &mut row.agreements[first..first + LANES];
        for l in 0..LANES {
            codes[l] = code[l] as u8;
        }
        if let Some(is_filmed) = &frame.is_filmed {
            for l in 0..LANES {
                let k = seen_y[l] as usize * other.width + seen_x[l] as usize;
                codes[l] = if is_filmed[k] { codes[l] } else { OUTSIDE as u8 };
            }
        }
    }
}

/// Returns the codes of how the elements of another map, `there`, agree with eight elements that are moved to them. `disparity`
/// is how much nearer the other map's elements are, pixels.
#[inline(always)]
fn agreement<V: F32x8>(
    elements: &ElementLanes<V>,
    moved: &Moved<V>,
    there: &ElementLanes<V>,
    disparity: V,
) -> V {
    let (confirmed, contradicted) = (V::splat(CONFIRMED), V::splat(CONTRADICTED));
    let [[u, v], [u1, v1]] = [moved.velocity, there.velocity];
    let most = V::splat(MAX_MOTION_ERROR_PX) + V::splat(MAX_MOTION_ERROR) * length(moved.velocity);
    let by_motion = length([u1 - u, v1 - v]).if_below(most, confirmed, contradicted);
    // Two slow elements have about the same motion.
    let fastest = elements.fastest_px.simd_max(there.fastest_px);
    let by_motion = V::splat(FlowPixel::SLOW_PX).if_below(fastest, by_motion, confirmed);
    let max = MAX_DISPARITY_ERROR_PX;
    let at_depth = V::splat(-max).if_below(disparity, by_motion, contradicted);
    disparity.if_below(V::splat(max), at_depth, V::splat(HIDDEN))
}

multiversion! {
    fn compare_row(row: &mut ComparedRow, comparison: &Comparison, pixels: (&Range<usize>, usize)) = compared::<V>
}

#[cfg(test)]
mod tests {
    use super::super::map::ElementMap;
    use super::*;
    use crate::camera::{Camera, CameraModel};
    use crate::random::Random;
    use crate::raster::Image;
    use crate::scene_flow::{Element, FlowFrame};
    use nalgebra::{Isometry3, Vector3};

    /// Disparity of a point at a depth of 1 m, pixels.
    const DISPARITY_PX: f32 = 8.0;

    /// Returns the frame of a camera `x` metres to the right, with a disparity of 8 pixels a metre at a depth of 1 m.
    fn frame([width, height]: [usize; 2], x: f64, time: f64) -> FlowFrame {
        let (cx, cy) = (0.5 * width as f64, 0.5 * height as f64);
        let view = Camera {
            width,
            height,
            model: CameraModel::Pinhole { fx: 8.0, fy: 8.0, cx, cy },
            cam_from_world: Isometry3::translation(-x, 0.0, 0.0),
        };
        FlowFrame::new(&view, &Image::filled(width, height, 3, 0.5), time)
    }

    fn map([width, height]: [usize; 2], element: impl FnMut(usize) -> Element) -> FlowMap {
        let elements: Vec<Element> = (0..width * height).map(element).collect();
        let costs = vec![0.0; elements.len()];
        let all = ElementMap { width, height, scale: 1.0, elements, costs, given: Vec::new() };
        FlowMap::new(&all, [0.0, 2.0], DISPARITY_PX)
    }

    /// Returns the code of pixel `k`.
    fn code(agreements: &Agreements, k: usize, width: usize) -> f32 {
        let byte = agreements.0[k / width * Agreements::row_bytes(width) + k % width / 4];
        f32::from(byte >> (2 * (k % width % 4)) & 3)
    }

    #[test]
    fn maps_agree_on_depth_and_motion_where_both_frames_see() {
        let size = [8, 8];
        let frames = [frame(size, 0.0, 0.0), frame(size, 0.25, 0.5)];
        let map = |inverse_depth: f32, velocity: f32| {
            let velocity = [velocity, 0.0];
            map(size, |_| Element { inverse_depth, velocity, ..Element::default() })
        };
        let agreement = |own: &FlowMap, by: &FlowMap, pixel: usize| {
            let of = MappedFrame { frame: &frames[0], map: own };
            let all = agreements(&of, &MappedFrame { frame: &frames[1], map: by }).unwrap();
            code(&all, pixel, size[0])
        };
        // At a depth of 1 m, the second camera sees the point two pixels to the left.
        let (left, middle) = (size[0] * 4, size[0] * 4 + 4);
        let still = map(1.0, 0.0);
        assert_eq!(agreement(&still, &map(1.0, 0.0), middle), CONFIRMED);
        assert_eq!(agreement(&still, &map(1.1, 1.0), middle), CONFIRMED);
        assert_eq!(agreement(&still, &map(1.0, 3.0), middle), CONTRADICTED);
        assert_eq!(agreement(&still, &map(0.7, 0.0), middle), CONTRADICTED);
        assert_eq!(agreement(&still, &map(1.3, 0.0), middle), HIDDEN);
        assert_eq!(agreement(&still, &map(1.0, 0.0), left), OUTSIDE);
        // Half a frame later, a point that moves by eight pixels a frame is four pixels to the right of where it was.
        assert_eq!(agreement(&map(1.0, 8.0), &map(1.0, 8.0), left), CONFIRMED);
    }

    /// Computes the code of each pixel on its own.
    fn one_by_one(of: &MappedFrame, by: &MappedFrame) -> Vec<f32> {
        let comparison = Comparison::new(of, by).unwrap();
        let Comparison { own, other, time, projection } = &comparison;
        let pixel = |(k, pixel): (usize, &FlowPixel)| {
            let [x, y] = own.center(k);
            let element = own.element(pixel);
            let dt = time.of_element(&element, (x, y), projection);
            let [mx, my, q] = element.moved(x, y, dt);
            let [u, v, inverse_depth] = projection.project(mx, my, q);
            if !other.frame.films([u, v]) {
                return OUTSIDE;
            }
            let there = &other.map.pixels()[v as usize * other.map.width + u as usize];
            let seen = other.map.element(there);
            let disparity = (seen.inverse_depth - inverse_depth) * own.disparity_px;
            let (_, here) = element.transferred(x, y, dt, projection);
            let [du, dv] = [0, 1].map(|c| seen.velocity[c] - here.velocity[c]);
            let same_motion =
                (du * du + dv * dv).sqrt() < MAX_MOTION_ERROR_PX + MAX_MOTION_ERROR * here.speed();
            if disparity >= MAX_DISPARITY_ERROR_PX {
                HIDDEN
            } else if disparity > -MAX_DISPARITY_ERROR_PX
                && (pixel.is_slow() && there.is_slow() || same_motion)
            {
                CONFIRMED
            } else {
                CONTRADICTED
            }
        };
        own.pixels().iter().enumerate().map(pixel).collect()
    }

    #[test]
    fn tiles_and_vectors_agree_as_pixels_one_by_one() {
        let size = [101, 43];
        let mut random = Random::new(3);
        let mut counts = [0; 4];
        let mut whole_tiles = 0;
        for case in 0..12 {
            let (is_rolling, is_masked) = (case % 3 == 1, case % 3 == 2);
            let frames = [0.0, 0.3].map(|time| {
                let mut frame = frame(size, 0.2 * random.signed(), time);
                let turn = Vector3::new(random.signed(), random.signed(), random.signed());
                let turn = Isometry3::rotation(0.05 * turn);
                frame.view.cam_from_world = turn * frame.view.cam_from_world;
                if is_masked {
                    frame.is_filmed =
                        Some((0..size[0] * size[1]).map(|_| random.unit() < 0.7).collect());
                }
                frame.with_row_time(if is_rolling { 0.01 } else { 0.0 })
            });
            // A slanted surface at rest; parts of it are in disorder.
            let mut moved = |k: usize| {
                let [x, y] = [k % size[0], k / size[0]];
                let disorder = if x > 75 || y > 34 { random.signed() as f32 } else { 0.0 };
                let mut any = |most: f32| disorder * most * random.signed() as f32;
                Element {
                    inverse_depth: (1.0 + 0.003 * x as f32 - 0.002 * y as f32 + any(0.5)).max(0.0),
                    velocity: [any(9.0), any(9.0)],
                    acceleration: [any(3.0), any(3.0)],
                    inverse_depth_rate: any(0.1),
                    ..Element::default()
                }
            };
            let maps = [map(size, &mut moved), map(size, &mut moved)];
            let [of, by] = [0, 1].map(|k| MappedFrame { frame: &frames[k], map: &maps[k] });
            let comparison = Comparison::new(&of, &by).unwrap();
            let [_, rows] = of.map.tiles();
            let confirmed = (0..rows).flat_map(|row| comparison.confirmed_tiles(row));
            whole_tiles += confirmed.filter(|confirmed| *confirmed).count();
            let (found, expected) = (agreements(&of, &by).unwrap(), one_by_one(&of, &by));
            for (k, expected) in expected.into_iter().enumerate() {
                counts[expected as usize] += 1;
                assert_eq!(code(&found, k, size[0]), expected, "case {case}, pixel {k}");
            }
            let confirmed = confirmed_by(&of, &by);
            let all = one_by_one(&of, &by).into_iter().filter(|code| *code == CONFIRMED);
            assert_eq!(confirmed.len(), all.count());
        }
        assert!(counts.iter().all(|count| *count > 200), "{counts:?}");
        assert!(whole_tiles > 20, "{whole_tiles}");
    }

    #[test]
    fn frames_far_apart_in_time_are_not_compared() {
        let size = [8, 8];
        let frames = [frame(size, 0.0, 0.0), frame(size, 0.25, 1.0)];
        let map = map(size, |_| Element { inverse_depth: 1.0, ..Element::default() });
        let [of, by] = frames.each_ref().map(|frame| MappedFrame { frame, map: &map });
        assert!(agreements(&of, &by).is_none());
    }
}
