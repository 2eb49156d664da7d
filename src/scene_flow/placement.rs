//! Placement of surface elements in a view: they are moved to the view's instant and projected.

use super::area::Area;
use super::element_lanes::{COLUMNS, ElementLanes, eight};
use super::flow_pixel::FlowPixel;
use super::frame::FlowFrame;
use super::geometry::{Projection, distorted, stretch};
use super::map::MappedFrame;
use super::motion::SurfaceMotion;
use super::tile_bounds::{Bounds, ROUNDING_PX, TILE_PX, TileBounds, columns_of};
use super::timing::until;
use crate::camera::Camera;
use crate::simd::{F32x8, LANES, multiversion};
use std::ops::Range;

/// Half-width of a splat, pixels of the frame. Splats of neighbouring pixels overlap slightly.
const HALF_WIDTH: f32 = 0.55;
/// Half-width of a splat towards a neighbouring pixel on another surface, pixels of the frame.
const HALF_WIDTH_AT_EDGE: f32 = 0.5;
/// Minimum and maximum magnification of a splat due to the difference between its depths in the frame and in the view.
/// The splat is also magnified by the ratio of the focal lengths.
const SCALES: [f32; 2] = [0.8, 8.0];
/// Constant part of the expected error of a surface element's position, pixels.
const ERROR_PX: f32 = 0.2;
/// Expected error of a surface element's position due to the distance of the cameras, pixels, per pixel of disparity
/// between the frame's camera and the view.
const ERROR_BY_BASELINE: f32 = 0.005;
/// Expected error of a surface element's position due to the time between the frame and the view's instant. The first
/// number is in pixels per frame period of this time. The second number is a fraction of the distance that the element
/// moves in this time. The two parts are added.
const ERROR_BY_TIME: [f32; 2] = [0.03, 0.009];
/// Expected error of a surface element's position below which the frame's weight rises steeply, pixels. Here, the error
/// consists of the parts due to the distance of the cameras and to the time between the frame and the view's instant. A
/// view at a camera's own position and a frame's own time thus shows this frame.
const EXACT_PX: f32 = 0.01;
/// Part of the time between two frames of a camera over which the weight of one goes over to the other. In the middle of
/// this time both have half of their weights. Larger: more frames make a view. Smaller: textures jump where one frame takes
/// over from another.
const FADING: f64 = 0.2;
/// Factor of the weights of a frame that has faded. It is positive, so that what this frame alone shows is shown.
const FADED: f64 = 1e-3;

/// Placement of a frame's surface elements in a view at an instant.
pub struct Placement<'a> {
    pub mapped: MappedFrame<'a>,
    /// The confidences of the map's pixels.
    confidences: &'a [u8],
    projection: Projection,
    /// For each row of the scene flow map, the time from the row to the view's instant, in frame periods of the
    /// reference camera.
    row_dt: Vec<f32>,
    /// Ratio of the view's focal length to the focal length of the frame's camera.
    zoom: f32,
    /// Expected error of the position of a point at a depth of 1 m, due to the distance between the cameras, pixels.
    place_error: f32,
    /// Factor of all weights, by the time until the camera's next frame takes over.
    fading: f32,
    /// For each tile of the map, row by row, bounds that contain the splats of its surface elements in a view without
    /// lens distortion.
    tiles: Vec<Bounds>,
}

/// Successive surface elements of one row of a scene flow map, placed in the view. Positions are pixels.
#[derive(Default)]
pub struct PlacedRow {
    pub x: Vec<f32>,
    pub y: Vec<f32>,
    pub inverse_depth: Vec<f32>,
    /// Size of each splat, relative to its size in the frame.
    pub scale: Vec<f32>,
    /// Blending weight of each element; 0 if it is behind the view, or wasn't filmed.
    pub weight: Vec<f32>,
    /// The pixels that each splat covers: its first column, the column after the last one, its first row, and the row
    /// after the last one.
    pub covered: Vec<[i32; 4]>,
}

impl PlacedRow {
    /// All but `covered` are padded to whole SIMD vectors.
    fn resize(&mut self, count: usize) {
        let Self { x, y, inverse_depth, scale, weight, covered } = self;
        for values in [x, y, inverse_depth, scale, weight] {
            values.resize(count.next_multiple_of(LANES), 0.0);
        }
        covered.resize(count, [0; 4]);
    }
}

impl<'a> Placement<'a> {
    /// `time` is that of the view, in frame periods of the reference camera since the capture's start. `confidences` are
    /// the confidences of the map's pixels. `None` if the intrinsic matrix of the frame's camera is singular.
    pub fn new(
        mapped: MappedFrame<'a>,
        confidences: &'a [u8],
        (view, time): (&Camera, f64),
    ) -> Option<Self> {
        let MappedFrame { frame, map } = mapped;
        let mut placement = Self {
            mapped,
            confidences,
            projection: Projection::new(&frame.view, view)?,
            row_dt: (0..map.height).map(|y| until(frame, time, y as f32 + 0.5)).collect(),
            zoom: (view.focal_px() / frame.view.focal_px()) as f32,
            place_error: place_error(frame, view),
            fading: fading_of(frame, time),
            tiles: Vec::new(),
        };
        let stretch = stretch(view);
        let [_, rows] = map.tiles();
        placement.tiles = (0..rows).flat_map(|row| placement.tile_bounds(row, stretch)).collect();
        Some(placement)
    }

    /// Returns, for each tile of a row of tiles, bounds that contain its splats. `stretch` is that of the view ([`stretch`]).
    fn tile_bounds(&self, row: usize, stretch: f32) -> Vec<Bounds> {
        let map = self.mapped.map;
        let top = row * TILE_PX[1];
        let last = (top + TILE_PX[1]).min(map.height) - 1;
        let [a, b] = [self.row_dt[top], self.row_dt[last]];
        let tiles = map.tile_row(row, [a.min(b), a.max(b)]).bounds(&self.projection);
        let of_splats = |tile: TileBounds| {
            // A splat covers pixels whose centres are at most half its width away.
            let margin = stretch * (HALF_WIDTH * self.scale(tile.nearing) + 0.5) + ROUNDING_PX;
            tile.place.map(|[min, max]| [min - margin, max + margin])
        };
        tiles.into_iter().map(of_splats).collect()
    }

    /// Returns the columns of the map whose surface elements may cover parts of the area, for a row of tiles.
    pub fn columns(&self, tile_row: usize, area: &Area) -> Vec<Range<usize>> {
        let map = self.mapped.map;
        let [count, _] = map.tiles();
        let tiles = &self.tiles[tile_row * count..][..count];
        columns_of(map.width, |tile| area.may_overlap(&tiles[tile]))
    }

    /// Places the surface elements of row `y` and of these columns of the map.
    pub fn place(&self, row: &mut PlacedRow, (columns, y): (Range<usize>, usize), area: &Area) {
        let MappedFrame { frame, map } = self.mapped;
        row.resize(columns.len());
        place_row(row, self, &columns, y);
        let pixels = y * map.width + columns.start..y * map.width + columns.end;
        if let Some(is_filmed) = &frame.is_filmed {
            let filmed = &is_filmed[pixels.clone()];
            row.weight.iter_mut().zip(filmed).for_each(|(w, f)| *w *= f32::from(u8::from(*f)));
        }
        if !area.view.model.is_pinhole() {
            distort(row, area.view);
        }
        cover_row(row, &map.pixels()[pixels], area);
    }

    /// Returns the motion, in the view and at the view's instant, of the surface element at a position of the frame,
    /// pixels.
    pub fn motion(&self, [x, y]: [f32; 2]) -> SurfaceMotion {
        let map = self.mapped.map;
        let column = (x.max(0.0) as usize).min(map.width - 1);
        let row = (y.max(0.0) as usize).min(map.height - 1);
        let k = row * map.width + column;
        let [cx, cy] = map.center(k);
        let element = map.element(&map.pixels()[k]);
        let (_, there) = element.transferred(cx, cy, self.row_dt[row], &self.projection);
        SurfaceMotion { velocity: there.velocity, inverse_depth_rate: there.inverse_depth_rate }
    }

    /// Returns the size of a splat relative to its size in the frame. `nearing` is the ratio of the element's inverse
    /// depth in the view to that in the frame.
    #[inline(always)]
    fn scale(&self, nearing: f32) -> f32 {
        self.zoom * nearing.clamp(SCALES[0], SCALES[1])
    }

    /// Returns the blending weights of eight surface elements. `inverse_depth` is that in the view.
    #[inline(always)]
    fn weights<V: F32x8>(
        &self,
        elements: &ElementLanes<V>,
        inverse_depth: V,
        dt: f32,
        confidence: V,
    ) -> V {
        let place = V::splat(self.place_error) * inverse_depth;
        let [constant, by_speed] = V::splats(ERROR_BY_TIME);
        let motion = V::splat(dt) * (constant + by_speed * elements.speed());
        let error = (place * place + motion * motion).simd_max(V::splat(f32::EPSILON));
        let exact = V::splat(1.0) + V::splat(EXACT_PX * EXACT_PX) / error;
        let confidence = confidence / V::splat(255.0);
        let confident = V::splat(self.fading) * confidence * confidence;
        let weight = confident * exact / (V::splat(ERROR_PX * ERROR_PX) + error);
        // Negative inverse depths, which the rate can cause, are behind the camera.
        V::zero().if_below(inverse_depth, weight, V::zero())
    }
}

#[inline(always)]
fn place<V: F32x8>(row: &mut PlacedRow, placement: &Placement, columns: &Range<usize>, y: usize) {
    let map = placement.mapped.map;
    let pixels = &map.pixels()[y * map.width..][columns.clone()];
    let confidences = &placement.confidences[y * map.width..][columns.clone()];
    let (scales, dt) = (map.scales(), placement.row_dt[y]);
    let ([least, most], zoom) = (V::splats(SCALES), V::splat(placement.zoom));
    let mut x = V::from_array(&COLUMNS) + V::splat(columns.start as f32);
    for first in (0..pixels.len()).step_by(LANES) {
        let elements = ElementLanes::<V>::new(&eight(pixels, first), &scales);
        let mut confidence = [0.0; LANES];
        for (lane, code) in confidence.iter_mut().zip(eight(confidences, first)) {
            *lane = f32::from(code);
        }
        let moved = elements.moved([x, V::splat(y as f32 + 0.5)], V::splat(dt));
        let [u, v, inverse_depth, nearing] = placement.projection.project_lanes(moved);
        u.store(&mut row.x, first);
        v.store(&mut row.y, first);
        inverse_depth.store(&mut row.inverse_depth, first);
        (zoom * nearing.simd_max(least).simd_min(most)).store(&mut row.scale, first);
        let weights = placement.weights(&elements, inverse_depth, dt, V::from_array(&confidence));
        weights.store(&mut row.weight, first);
        x = x + V::splat(LANES as f32);
    }
}

multiversion! {
    fn place_row(row: &mut PlacedRow, placement: &Placement, columns: &Range<usize>, y: usize) = place::<V>
}

/// For each combination of edges ([`FlowPixel::edges`]), the positions of a splat's left, right, upper and lower borders
/// relative to its centre, pixels of the frame.
const BORDERS: [[f32; 4]; 16] = {
    let mut borders = [[0.0; 4]; 16];
    let mut k = 0;
    while k < 4 * borders.len() {
        let (edges, side) = (k / 4, k % 4);
        let half = if edges >> side & 1 == 1 { HALF_WIDTH_AT_EDGE } else { HALF_WIDTH };
        borders[edges][side] = if side % 2 == 0 { -half } else { half };
        k += 1;
    }
    borders
};

/// Computes which pixels of the area the splats cover: those whose centres they contain.
#[inline(always)]
fn cover(row: &mut PlacedRow, pixels: &[FlowPixel], area: &Area) {
    let n = pixels.len();
    let (x, y, scale, weight) = (&row.x[..n], &row.y[..n], &row.scale[..n], &row.weight[..n]);
    let covered = &mut row.covered[..n];
    let [width, top, bottom] =
        [area.view.width, area.rows.start, area.rows.end].map(|at| at as f32);
    let (first, end) = ([0.0, 0.0, top, top], [width, width, bottom, bottom]);
    for k in 0..n {
        let borders = &BORDERS[usize::from(pixels[k].edges()) % BORDERS.len()];
        let center = [x[k], x[k], y[k], y[k]];
        for side in 0..4 {
            let at = center[side] + scale[k] * borders[side];
            covered[k][side] = first_pixel(at, first[side], end[side]);
        }
        if !(weight[k] > 0.0) {
            covered[k][1] = covered[k][0];
        }
    }
}

multiversion! {
    fn cover_row(row: &mut PlacedRow, pixels: &[FlowPixel], area: &Area) = cover
}

/// Returns the first pixel whose centre isn't before a position, inside a range of pixels or at its end. It is the nearest
/// integer. Halfway between two, it is the even one, and the same for all splats that end or begin there.
#[inline(always)]
fn first_pixel(at: f32, first: f32, end: f32) -> i32 {
    // The sum's last bits are the integer, as for all below 2²². Unlike a cast, this is fast in SIMD. The maximum of NaN
    // and a number is the number.
    const SHIFT: f32 = 12_582_912.0; // 1.5 · 2²³
    (at.max(first).min(end) + SHIFT).to_bits() as i32 - SHIFT.to_bits() as i32
}

/// Applies the view's lens distortion to the positions in `row`, which are those of a pinhole camera. Positions beyond
/// the range in which the lens model is monotonic get the weight 0.
fn distort(row: &mut PlacedRow, view: &Camera) {
    for x in 0..row.covered.len() {
        match distorted(view, [row.x[x], row.y[x]]) {
            Some(place) => [row.x[x], row.y[x]] = place,
            None => row.weight[x] = 0.0,
        }
    }
}

/// Returns the square of the expected error of the positions, in a view at `time`, of a frame's surface elements with
/// the inverse depth `inverse_depth`, 1/m, that move by `speed` pixels per frame; squared pixels.
pub fn squared_error(
    frame: &FlowFrame,
    (view, time): (&Camera, f64),
    (inverse_depth, speed): (f32, f32),
) -> f32 {
    let place = place_error(frame, view) * inverse_depth;
    let dt = (time - frame.time) as f32;
    let motion = dt * (ERROR_BY_TIME[0] + ERROR_BY_TIME[1] * speed);
    place * place + motion * motion
}

/// Returns the factor of a frame's weights in a view at `time`; positive, at most 1.
pub fn fading_of(frame: &FlowFrame, time: f64) -> f32 {
    let dt = time - frame.time;
    fading(dt, frame.neighbors[usize::from(dt >= 0.0)] - frame.time) as f32
}

/// Returns the factor of a frame's weights in a view that is `dt` after it; `interval` is the time from the frame to the
/// camera's frame on the other side of the view, infinite if there is none. The factor is 1 near the frame, and falls to
/// nearly 0 around the middle, where that of the other frame rises.
pub fn fading(dt: f64, interval: f64) -> f64 {
    if interval == 0.0 {
        return 1.0; // frames of one time, as those of a static light field, have no middle
    }
    ((0.5 + 0.5 * FADING - (dt / interval).abs()) / FADING).clamp(FADED, 1.0)
}

/// Returns the expected error of the position of a point at a depth of 1 m, due to the distance between a frame's
/// camera and a view, pixels.
fn place_error(frame: &FlowFrame, view: &Camera) -> f32 {
    let baseline_m = (frame.view.center() - view.center()).norm() as f32;
    ERROR_BY_BASELINE * view.focal_px() as f32 * baseline_m
}

#[cfg(test)]
mod tests {
    use super::{FADED, FlowFrame, fading_of, first_pixel};
    use crate::camera::{Camera, CameraModel};
    use crate::raster::Image;
    use nalgebra::Isometry3;

    #[test]
    fn a_frame_fades_around_the_middle_while_its_neighbour_appears() {
        let camera = Camera {
            width: 8,
            height: 8,
            model: CameraModel::Pinhole { fx: 8.0, fy: 8.0, cx: 4.0, cy: 4.0 },
            cam_from_world: Isometry3::identity(),
        };
        let at = |time: f64| FlowFrame::new(&camera, &Image::filled(8, 8, 3, 0.5), time);
        let (frame, next) =
            (at(5.0).with_neighbors([4.0, 7.0]), at(7.0).with_neighbors([5.0, 8.0]));
        for (time, expected) in [
            (5.0, 1.0),
            (4.7, 1.0),
            (4.5, 0.5),
            (4.45, 0.25),
            (4.0, FADED),
            (5.7, 1.0),
            (6.0, 0.5),
            (6.1, 0.25),
            (6.3, FADED),
        ] {
            assert!((fading_of(&frame, time) - expected as f32).abs() < 1e-6, "{time}");
        }
        for time in [5.82, 5.9, 6.0, 6.1, 6.18] {
            assert!(
                (fading_of(&frame, time) + fading_of(&next, time) - 1.0).abs() < 1e-6,
                "{time}"
            );
        }
        assert_eq!(fading_of(&at(5.0), 90.0), 1.0);
        assert_eq!(fading_of(&at(5.0).with_neighbors([5.0, 5.0]), 5.0), 1.0);
    }

    #[test]
    fn splats_beyond_a_border_have_no_pixels_but_stay_inside_the_range() {
        let covered = |from: f32, to: f32, [first, end]: [f32; 2]| {
            first_pixel(from, first, end)..first_pixel(to, first, end)
        };
        assert_eq!(covered(2.2, 4.6, [0.0, 8.0]), 2..5);
        assert_eq!(covered(4_000_001.3, 4_000_003.7, [0.0, 4_100_000.0]), 4_000_001..4_000_004);
        for (from, to) in [(-3.0, -1.2), (-1e9, -9e8), (9.3, 12.0), (1e9, 2e9), (f32::NAN, 1.3)] {
            let pixels = covered(from, to, [2.0, 8.0]);
            assert!(pixels.start >= 2 && pixels.end <= 8, "{from}, {to}: {pixels:?}");
            assert!(pixels.is_empty(), "{from}, {to}: {pixels:?}");
        }
    }
}
