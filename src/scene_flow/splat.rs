//! Splats a scene flow map into a view: the map's surface elements are moved to an instant and projected into the view.

use super::frame::FlowFrame;
use super::geometry::{Projection, distorted};
use super::map::{FlowMap, FlowPixel, MappedFrame};
use super::motion::SurfaceMotion;
use super::timing::until;
use crate::camera::Camera;
use crate::simd::multiversion;
use std::borrow::Cow;
use std::ops::Range;

/// Half-width of a splat, pixels of the frame. Splats of neighbouring pixels overlap slightly.
const HALF_WIDTH: f32 = 0.55;
/// Half-width of a splat towards a neighbouring pixel on another surface, pixels of the frame.
const HALF_WIDTH_AT_EDGE: f32 = 0.5;
/// Minimum and maximum magnification of a splat due to the difference between its depths in the frame and in the view.
/// The splat is also magnified by the ratio of the focal lengths.
const SCALES: [f32; 2] = [0.8, 8.0];
/// Minimum difference in disparity for a nearer surface element to occlude a farther one, pixels. Elements with a
/// smaller difference count as one surface.
const HIDING_PX: f32 = 0.5;
/// Constant part of the expected error of a surface element's position, pixels.
const ERROR_PX: f32 = 0.2;
/// Expected error of a surface element's position due to the distance of the cameras, pixels, per pixel of disparity
/// between the frame's camera and the view.
const ERROR_BY_BASELINE: f32 = 0.005;
/// Expected error of a surface element's position due to the time between the frame and the view's instant. The first
/// number is in pixels per frame period of this time. The second number is a fraction of the distance that the element
/// moves in this time. The two parts are added.
const ERROR_BY_TIME: [f32; 2] = [0.03, 0.009];
/// Expected error of a surface element's position as a fraction of acceleration times squared time, since real paths
/// are not parabolas.
const ERROR_BY_CURVATURE: f32 = 0.1;
/// Expected error of a surface element's position below which the frame's weight rises steeply, pixels. Here, the error
/// consists of the parts due to the distance of the cameras and to the time between the frame and the view's instant. A
/// view at a camera's own position and a frame's own time thus shows this frame.
const EXACT_PX: f32 = 0.01;

/// Parts of a view into which scene flow maps are splatted: all pixels of some rows, some of these pixels, or the
/// quarters of some of them.
pub struct Area<'a> {
    /// Camera of the view. For quarters, it has twice the width and height.
    view: Cow<'a, Camera>,
    rows: Range<usize>,
    /// For every pixel of the rows, the index of its first part, or [`NO_PARTS`]. `None` if all pixels are splatted.
    parts: Option<Vec<u32>>,
    /// For every pixel of the rows, whether it or one of its eight neighbours has parts. Empty if all pixels are
    /// splatted.
    is_near_parts: Vec<bool>,
    /// Binary logarithm of the number of parts side by side in a pixel: 1 for quarters, else 0.
    halvings: u32,
    count: usize,
}

/// Index of a pixel that is not splatted.
const NO_PARTS: u32 = u32::MAX;
/// Maximum size of a splat, pixels of the view, for which [`Area::is_near_parts`] tells whether it may cover parts.
/// Half of it, at [`HALF_WIDTH`], is less than a pixel.
const MAX_CHECKED: f32 = 1.5;
/// Number of quarters of a pixel.
pub const QUARTERS: usize = 4;

impl<'a> Area<'a> {
    /// Returns the area of all pixels of the rows `rows` of a view.
    pub fn of_rows(view: &'a Camera, rows: Range<usize>) -> Self {
        let count = view.width * rows.len();
        let view = Cow::Borrowed(view);
        Self { view, rows, parts: None, is_near_parts: Vec::new(), halvings: 0, count }
    }

    /// Returns the area of single pixels. `pixels` are their indices in the rows `rows` of a view. The pixel
    /// `pixels[i]` has the index `i`.
    pub fn of_pixels(view: &'a Camera, rows: Range<usize>, pixels: &[u32]) -> Self {
        let (parts, is_near_parts) = parts_of(pixels, 1, [view.width, rows.len()]);
        let (view, count) = (Cow::Borrowed(view), pixels.len());
        Self { view, rows, parts: Some(parts), is_near_parts, halvings: 0, count }
    }

    /// Returns the area of the quarters of single pixels. `pixels` are their indices in the rows `rows` of a view. The
    /// quarters of the pixel `pixels[i]` have the indices from `4 i` to `4 i + 3`.
    pub fn of_quarters(view: &Camera, rows: Range<usize>, pixels: &[u32]) -> Self {
        let (parts, is_near_parts) = parts_of(pixels, QUARTERS, [view.width, rows.len()]);
        let view = Camera {
            width: 2 * view.width,
            height: 2 * view.height,
            model: view.model.scaled(2.0),
            ..view.clone()
        };
        let (rows, count) = (2 * rows.start..2 * rows.end, QUARTERS * pixels.len());
        let view = Cow::Owned(view);
        Self { view, rows, parts: Some(parts), is_near_parts, halvings: 1, count }
    }

    /// Returns whether a splat at position `[x, y]` may cover a part of the area. `scale` is its size relative to a
    /// part.
    #[inline(always)]
    fn is_near(&self, [x, y]: [f32; 2], scale: f32) -> bool {
        let (width, height) = (self.view.width, self.rows.len());
        let (first, end) = (self.rows.start as f32, self.rows.end as f32);
        let is_inside =
            x > -scale && x < width as f32 + scale && y > first - scale && y < end + scale;
        let max_checked = MAX_CHECKED * (1u32 << self.halvings) as f32;
        if !is_inside || self.is_near_parts.is_empty() || scale > max_checked {
            return is_inside;
        }
        // The casts saturate at 0.
        let column = (x as usize).min(width - 1) >> self.halvings;
        let row = ((y - first) as usize).min(height - 1) >> self.halvings;
        self.is_near_parts[row * (width >> self.halvings) + column]
    }

    /// Returns the index of the part in column `u` and row `v`, which must be one of the rows. `None` if it is not
    /// splatted.
    #[inline(always)]
    fn part(&self, u: usize, v: usize) -> Option<usize> {
        let (v, width, halvings) = (v - self.rows.start, self.view.width, self.halvings);
        let first = self.parts.as_ref()?[(v >> halvings) * (width >> halvings) + (u >> halvings)];
        let inside = (1 << halvings) - 1;
        let part = ((v & inside) << halvings) + (u & inside);
        (first != NO_PARTS).then(|| first as usize + part)
    }
}

/// Returns, for every pixel of some rows of a view, the index of its first part, and whether it or one of its eight
/// neighbours has parts. Only `pixels` have parts, `count` each.
fn parts_of(pixels: &[u32], count: usize, [width, height]: [usize; 2]) -> (Vec<u32>, Vec<bool>) {
    let mut parts = vec![NO_PARTS; width * height];
    let mut is_near = vec![false; width * height];
    for (i, &k) in pixels.iter().enumerate() {
        let k = k as usize;
        // An image has less than 2³⁰ pixels.
        parts[k] = (count * i) as u32;
        let (x, y) = (k % width, k / width);
        for y in y.saturating_sub(1)..(y + 2).min(height) {
            let row = &mut is_near[y * width..][..width];
            row[x.saturating_sub(1)..(x + 2).min(width)].fill(true);
        }
    }
    (parts, is_near)
}

/// What a scene flow map shows at a part of an [`Area`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SplatPixel {
    /// Inverse depth in the view, 1/m.
    pub inverse_depth: f32,
    /// Blending weight, from confidence and expected error; 0 where the scene flow map covers nothing.
    pub weight: f32,
    /// Position in the frame from which the colour is read, pixels.
    pub source: [f32; 2],
    /// Distance between the pixel's centre and the projection of its surface element (maximum norm), pixels.
    distance: f32,
}

impl SplatPixel {
    const NOTHING: Self = Self { inverse_depth: 0.0, weight: 0.0, source: [0.0; 2], distance: 0.0 };
}

/// Scene flow map rendered into an [`Area`] of a view.
pub struct Splat {
    /// The parts of the area.
    pub pixels: Vec<SplatPixel>,
    projection: Projection,
    /// For each row of the scene flow map, the time from the row to the view's instant, in frame periods of the
    /// reference camera.
    row_dt: Vec<f32>,
    /// Minimum difference in inverse depth for a nearer surface element to occlude a farther one, 1/m.
    hiding: f32,
}

/// Mapping from one row of a frame to a view at an instant.
#[derive(Clone, Copy)]
struct ToView {
    projection: Projection,
    /// Time from the row to the view's instant, in frame periods of the reference camera.
    dt: f32,
    /// Ratio of the view's focal length to the focal length of the frame's camera.
    zoom: f32,
    /// Expected error of the position of a point at a depth of 1 m, due to the distance between the cameras, pixels.
    place_error: f32,
}

/// Surface elements of one row of a scene flow map, projected into the view. Positions are pixels.
struct Row {
    x: Vec<f32>,
    y: Vec<f32>,
    inverse_depth: Vec<f32>,
    /// Size of each splat, relative to its size in the frame.
    scale: Vec<f32>,
    weight: Vec<f32>,
    /// Magnitude of each surface element's velocity, pixels per frame.
    speed: Vec<f32>,
    /// Magnitude of each surface element's acceleration, pixels per squared frame.
    acceleration: Vec<f32>,
}

impl Row {
    fn new(width: usize) -> Self {
        let values = || vec![0.0; width];
        Self {
            x: values(),
            y: values(),
            inverse_depth: values(),
            scale: values(),
            weight: values(),
            speed: values(),
            acceleration: values(),
        }
    }

    /// Moves the surface elements of row `y` of a scene flow map by `dt` frames. The resulting positions are in the
    /// frame's own camera, pixels.
    #[inline(always)]
    fn move_elements(&mut self, map: &FlowMap, y: usize, dt: f32) {
        let pixels = &map.pixels()[y * map.width..][..self.x.len()];
        for (x, pixel) in pixels.iter().enumerate() {
            let element = map.element(pixel);
            let [mx, my, q] = element.moved(x as f32 + 0.5, y as f32 + 0.5, dt);
            (self.x[x], self.y[x], self.inverse_depth[x]) = (mx, my, q);
            self.speed[x] = element.speed();
            let [a, b] = element.acceleration;
            self.acceleration[x] = (a * a + b * b).sqrt();
        }
    }

    /// Projects the moved surface elements into the view, and computes their scales and weights.
    #[inline(always)]
    fn project(&mut self, to: &ToView, confidences: &[u8]) {
        let n = self.x.len();
        let (x, y) = (&mut self.x[..n], &mut self.y[..n]);
        let (inverse_depth, scale) = (&mut self.inverse_depth[..n], &mut self.scale[..n]);
        let (weight, speed) = (&mut self.weight[..n], &self.speed[..n]);
        let confidences = &confidences[..n];
        for k in 0..n {
            let q = inverse_depth[k];
            let [u, v, q_there] = to.projection.project(x[k], y[k], q);
            (x[k], y[k], inverse_depth[k]) = (u, v, q_there);
            // Negative inverse depths, which the rate can cause, are behind the camera.
            let nearing = q_there / q.max(f32::MIN_POSITIVE);
            scale[k] = to.zoom * nearing.clamp(SCALES[0], SCALES[1]);
            let place = to.place_error * q_there;
            let motion = to.dt.abs() * (ERROR_BY_TIME[0] + ERROR_BY_TIME[1] * speed[k])
                + ERROR_BY_CURVATURE * to.dt * to.dt * self.acceleration[k];
            let error = (place * place + motion * motion).max(f32::EPSILON);
            let exact = 1.0 + EXACT_PX * EXACT_PX / error;
            let confidence = f32::from(confidences[k]) / 255.0;
            let value = confidence * confidence * exact / (ERROR_PX * ERROR_PX + error);
            weight[k] = if q_there > 0.0 { value } else { 0.0 };
        }
    }
}

#[inline(always)]
fn place(row: &mut Row, map: &FlowMap, confidences: &[u8], y: usize, to: &ToView) {
    row.move_elements(map, y, to.dt);
    row.project(to, &confidences[y * map.width..]);
}

multiversion! {
    fn place_row(row: &mut Row, map: &FlowMap, confidences: &[u8], y: usize, to: &ToView) = place
}

impl Splat {
    /// Splats a scene flow map into an area of a view at `time`, in frame periods of the reference camera since the
    /// capture's start. `confidences` are the confidences of the map's pixels. `None` if the intrinsic matrix of the
    /// frame's camera is singular.
    pub fn new(mapped: MappedFrame, confidences: &[u8], area: &Area, time: f64) -> Option<Self> {
        let MappedFrame { frame, map } = mapped;
        let view = &*area.view;
        let to_view = ToView {
            projection: Projection::new(&frame.view, view)?,
            dt: 0.0,
            zoom: (view.focal_px() / frame.view.focal_px()) as f32,
            place_error: place_error(frame, view),
        };
        let mut splat = Self {
            pixels: vec![SplatPixel::NOTHING; area.count],
            projection: to_view.projection,
            row_dt: (0..map.height).map(|y| until(frame, time, y as f32 + 0.5)).collect(),
            hiding: HIDING_PX / map.disparity_px,
        };
        let mut row = Row::new(map.width);
        let is_pinhole = view.model.is_pinhole();
        for y in 0..map.height {
            let to_view = ToView { dt: splat.row_dt[y], ..to_view };
            place_row(&mut row, map, confidences, y, &to_view);
            let pixels = y * map.width..(y + 1) * map.width;
            if let Some(is_filmed) = &frame.is_filmed {
                let filmed = &is_filmed[pixels.clone()];
                row.weight.iter_mut().zip(filmed).for_each(|(w, f)| *w *= f32::from(u8::from(*f)));
            }
            if !is_pinhole {
                distort(&mut row, view);
            }
            splat.add_row(&row, &map.pixels()[pixels], y, area);
        }
        Some(splat)
    }

    /// Returns the motion, in the view and at the view's instant, of the surface element at a position of the frame,
    /// pixels.
    pub fn motion(&self, map: &FlowMap, [x, y]: [f32; 2]) -> SurfaceMotion {
        let column = (x.max(0.0) as usize).min(map.width - 1);
        let row = (y.max(0.0) as usize).min(map.height - 1);
        let k = row * map.width + column;
        let [cx, cy] = map.center(k);
        let element = map.element(&map.pixels()[k]);
        let (_, there) = element.transferred(cx, cy, self.row_dt[row], &self.projection);
        SurfaceMotion { velocity: there.velocity, inverse_depth_rate: there.inverse_depth_rate }
    }

    fn add_row(&mut self, row: &Row, pixels: &[FlowPixel], y: usize, area: &Area) {
        for (x, pixel) in pixels.iter().enumerate() {
            if row.weight[x] > 0.0 && area.is_near([row.x[x], row.y[x]], row.scale[x]) {
                self.add(row, (x, y), pixel, area);
            }
        }
    }

    /// Adds the splat of surface element `x` of row `y`. Parts outside the area are clipped.
    #[inline(always)]
    fn add(&mut self, row: &Row, (x, y): (usize, usize), pixel: &FlowPixel, area: &Area) {
        let (cx, cy, scale) = (row.x[x], row.y[x], row.scale[x]);
        let half =
            |side: usize| scale * if pixel.is_edge(side) { HALF_WIDTH_AT_EDGE } else { HALF_WIDTH };
        let columns = pixels_between(cx - half(0), cx + half(1), 0..area.view.width);
        let rows = pixels_between(cy - half(2), cy + half(3), area.rows.clone());
        let (inverse_depth, weight) = (row.inverse_depth[x], row.weight[x]);
        let (inverse_scale, hiding) = (1.0 / scale, self.hiding);
        let (px, py) = (x as f32 + 0.5, y as f32 + 0.5);
        let show = |old: &mut SplatPixel, u: usize, v: usize| {
            let (dx, dy) = (u as f32 + 0.5 - cx, v as f32 + 0.5 - cy);
            let distance = dx.abs().max(dy.abs());
            let in_front = inverse_depth - old.inverse_depth;
            let is_same = in_front > -hiding && distance < old.distance;
            if old.weight == 0.0 || in_front > hiding || is_same {
                let source = [px + dx * inverse_scale, py + dy * inverse_scale];
                *old = SplatPixel { inverse_depth, weight, source, distance };
            }
        };
        for v in rows {
            if area.parts.is_none() {
                let first = (v - area.rows.start) * area.view.width;
                let row = &mut self.pixels[first + columns.start..first + columns.end];
                row.iter_mut().zip(columns.start..).for_each(|(old, u)| show(old, u, v));
                continue;
            }
            for u in columns.clone() {
                if let Some(k) = area.part(u, v) {
                    show(&mut self.pixels[k], u, v);
                }
            }
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

/// Returns the expected error of the position of a point at a depth of 1 m, due to the distance between a frame's
/// camera and a view, pixels.
fn place_error(frame: &FlowFrame, view: &Camera) -> f32 {
    let baseline_m = (frame.view.center() - view.center()).norm() as f32;
    ERROR_BY_BASELINE * view.focal_px() as f32 * baseline_m
}

/// Applies the view's lens distortion to the positions in `row`, which are those of a pinhole camera. Positions beyond
/// the range in which the lens model is monotonic get the weight 0.
fn distort(row: &mut Row, view: &Camera) {
    for x in 0..row.x.len() {
        match distorted(view, [row.x[x], row.y[x]]) {
            Some(place) => [row.x[x], row.y[x]] = place,
            None => row.weight[x] = 0.0,
        }
    }
}

/// Returns the pixels of `range` whose centres lie in `from..=to`.
#[inline(always)]
fn pixels_between(from: f32, to: f32, range: Range<usize>) -> Range<usize> {
    // Casts saturate. An image has less than 2³¹ columns and rows.
    let [first, end] = [from, to]
        .map(|at| ((at + 0.5) as i32).clamp(range.start as i32, range.end as i32) as usize);
    first..end.max(first)
}

#[cfg(test)]
mod tests {
    use super::pixels_between;

    #[test]
    fn splats_beyond_a_border_have_no_pixels_but_stay_inside_the_range() {
        assert_eq!(pixels_between(2.2, 4.6, 0..8), 2..5);
        for (from, to) in [(-3.0, -1.2), (-1e9, -9e8), (9.3, 12.0), (1e9, 2e9), (f32::NAN, 3.0)] {
            let pixels = pixels_between(from, to, 2..8);
            assert!(pixels.start >= 2 && pixels.end <= 8, "{from}, {to}: {pixels:?}");
            assert!(pixels.is_empty() || from.is_nan(), "{from}, {to}: {pixels:?}");
        }
    }
}
