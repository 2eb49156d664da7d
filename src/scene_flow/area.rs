//! Parts of a view into which scene flow maps are splatted.

use super::geometry::{samples, stretch, undistorted};
use super::tile_bounds::{Bounds, EVERYWHERE};
use crate::camera::Camera;
use std::ops::Range;

/// Number of quarters of a pixel.
pub const QUARTERS: usize = 4;
/// Index of a pixel that is not splatted.
const NO_PARTS: u32 = u32::MAX;
/// Binary logarithm of the side of a cell ([`Parts::has_parts`]), pixels.
const CELL_LOG2: u32 = 3;
/// Margin of bounds for what lies between the positions at which lens distortion is computed, pixels of the view.
const LENS_MARGIN_PX: f32 = 2.0;

/// Parts of a view into which scene flow maps are splatted: all pixels of some rows, some of these pixels, or the
/// quarters of some of them.
pub struct Area<'a> {
    /// Camera of the view. For quarters, it has twice the width and height.
    pub view: &'a Camera,
    pub rows: Range<usize>,
    /// Number of parts.
    pub count: usize,
    /// The parts. `None` if all pixels of the rows are splatted, row by row.
    pub parts: Option<Parts>,
    /// Bounds of the rows in a view without lens distortion.
    bounds: Bounds,
}

/// Single pixels with parts.
pub struct Parts {
    /// For every pixel of the rows, the index of its first part, or [`NO_PARTS`].
    first: Vec<u32>,
    /// Binary logarithm of the number of parts side by side in a pixel: 1 for quarters, else 0.
    halvings: u32,
    /// For square cells of the rows, row by row, whether they have parts. Cells of quarters have as many quarters as other
    /// cells have pixels.
    has_parts: Vec<bool>,
    /// Numbers of cells in a row, and in a column.
    cells: [usize; 2],
}

impl<'a> Area<'a> {
    /// Returns the area of all pixels of the rows `rows` of a view.
    pub fn of_rows(view: &'a Camera, rows: Range<usize>) -> Self {
        let (count, bounds) = (view.width * rows.len(), bounds(view, &rows));
        Self { view, rows, parts: None, count, bounds }
    }

    /// Returns the area of single pixels. `pixels` are their indices in the rows `rows` of a view. The pixel
    /// `pixels[i]` has the index `i`.
    pub fn of_pixels(view: &'a Camera, rows: Range<usize>, pixels: &[u32]) -> Self {
        let parts = Some(Parts::new(pixels, 0, [view.width, rows.len()]));
        Self { parts, count: pixels.len(), ..Self::of_rows(view, rows) }
    }

    /// Returns the area of the quarters of single pixels. `pixels` are their indices in the rows `rows` of a view, and
    /// `doubled` is this view with twice the width and height ([`doubled`]). The quarters of the pixel `pixels[i]` have the
    /// indices from `4 i` to `4 i + 3`.
    pub fn of_quarters(doubled: &'a Camera, rows: Range<usize>, pixels: &[u32]) -> Self {
        let parts = Some(Parts::new(pixels, 1, [doubled.width / 2, rows.len()]));
        let count = QUARTERS * pixels.len();
        Self { parts, count, ..Self::of_rows(doubled, 2 * rows.start..2 * rows.end) }
    }

    /// Returns whether the area may have parts inside the bounds, which are those of a view without lens distortion.
    pub fn may_overlap(&self, bounds: &Bounds) -> bool {
        let overlaps = |a: [f32; 2], b: [f32; 2]| a[0] <= b[1] && b[0] <= a[1];
        if !overlaps(self.bounds[0], bounds[0]) || !overlaps(self.bounds[1], bounds[1]) {
            return false;
        }
        let Some(parts) = self.parts.as_ref().filter(|_| self.view.model.is_pinhole()) else {
            return true;
        };
        let first_row = self.rows.start as f32;
        let [columns, rows] = [bounds[0], bounds[1].map(|y| y - first_row)];
        // Casts saturate at 0.
        let cell = |at: f32| at as usize >> CELL_LOG2;
        let cells = |[min, max]: [f32; 2], count: usize| cell(min)..(cell(max) + 1).min(count);
        let [width, height] = parts.cells;
        let row_has_parts = |row: usize| {
            parts.has_parts[row * width..][..width][cells(columns, width)].contains(&true)
        };
        cells(rows, height).any(row_has_parts)
    }
}

/// Returns a camera with the view's place, direction and field of view, and twice its width and height, pixels.
pub fn doubled(view: &Camera) -> Camera {
    Camera {
        width: 2 * view.width,
        height: 2 * view.height,
        model: view.model.scaled(2.0),
        ..view.clone()
    }
}

impl Parts {
    /// `pixels` are indices of pixels in some rows of a view, and `size` is its width and the number of these rows.
    fn new(pixels: &[u32], halvings: u32, size: [usize; 2]) -> Self {
        let [width, height] = size;
        let cells = size.map(|side| ((side << halvings) >> CELL_LOG2) + 1);
        let mut first = vec![NO_PARTS; width * height];
        let mut has_parts = vec![false; cells[0] * cells[1]];
        for (i, &k) in pixels.iter().enumerate() {
            let k = k as usize;
            // A band of rows has less than 2³⁰ pixels.
            first[k] = (i << (2 * halvings)) as u32;
            let [x, y] = [k % width, k / width].map(|at| (at << halvings) >> CELL_LOG2);
            has_parts[y * cells[0] + x] = true;
        }
        Self { first, halvings, has_parts, cells }
    }

    /// Returns the index of the part in column `u`, and in row `v` of the area's rows. `width` is the number of columns.
    /// `None` if it is not splatted.
    #[inline(always)]
    pub fn part(&self, u: usize, v: usize, width: usize) -> Option<usize> {
        let halvings = self.halvings;
        let first = self.first[(v >> halvings) * (width >> halvings) + (u >> halvings)];
        let inside = (1 << halvings) - 1;
        let part = ((v & inside) << halvings) + (u & inside);
        (first != NO_PARTS).then(|| first as usize + part)
    }
}

/// Returns the bounds of some rows of a view, without its lens distortion.
fn bounds(view: &Camera, rows: &Range<usize>) -> Bounds {
    let [right, top, bottom] = [view.width, rows.start, rows.end].map(|at| at as f32);
    if view.model.is_pinhole() {
        return [[0.0, right], [top, bottom]];
    }
    // The border of the rows is the border of what they see.
    let across = samples(0..view.width).flat_map(|x| [[x, top], [x, bottom]]);
    let down = samples(rows.clone()).flat_map(|y| [[0.0, y], [right, y]]);
    let mut bounds = [[f32::INFINITY, f32::NEG_INFINITY]; 2];
    for place in across.chain(down) {
        let Some(place) = undistorted(view, place) else { return EVERYWHERE };
        for ([min, max], at) in bounds.iter_mut().zip(place) {
            (*min, *max) = (min.min(at), max.max(at));
        }
    }
    let margin = LENS_MARGIN_PX * stretch(view);
    bounds.map(|[min, max]| [min - margin, max + margin])
}
