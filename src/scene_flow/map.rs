//! Maps of a frame's depth and motion: [`ElementMap`] during estimation, and [`FlowMap`] for rendering and storage.

use super::element::{Element, ElementErrors};
use super::flow_pixel::{FlowPixel, Scales};
use super::frame::FlowFrame;
use super::tile_bounds::{Bounds, TILE_PX, TileRow};

/// Surface elements of a frame during estimation, one for each pixel of a pyramid level.
#[derive(Clone)]
pub struct ElementMap {
    pub width: usize,
    pub height: usize,
    /// Side of a pixel of the map, in pixels of the full-resolution image.
    pub scale: f32,
    pub elements: Vec<Element>,
    /// Matching cost of each surface element, without the smoothness and consistency costs.
    pub costs: Vec<f32>,
    /// For each pixel, whether its surface element is given: that of the static background. Empty if no background is known.
    pub given: Vec<bool>,
}

impl ElementMap {
    /// Returns whether the surface element of pixel `k` is given, and isn't estimated.
    #[inline(always)]
    pub fn is_given(&self, k: usize) -> bool {
        self.given.get(k).copied().unwrap_or(false)
    }

    /// Returns whether any surface element is given.
    pub fn has_given(&self) -> bool {
        self.given.contains(&true)
    }

    /// Returns the centre of the map's pixel `k`, in pixels of the full-resolution image.
    pub fn center(&self, k: usize) -> [f32; 2] {
        [k % self.width, k / self.width].map(|v| (v as f32 + 0.5) * self.scale)
    }

    /// Returns the index of the map's pixel that contains a position of the full-resolution image. `None` outside the
    /// map.
    pub fn index(&self, [x, y]: [f32; 2]) -> Option<usize> {
        let (u, v) = (x / self.scale, y / self.scale);
        let is_inside = u >= 0.0 && v >= 0.0 && u < self.width as f32 && v < self.height as f32;
        is_inside.then(|| v as usize * self.width + u as usize)
    }

    /// Returns the surface element of pixel `k`, extrapolated to a nearby position of the full-resolution image,
    /// pixels.
    pub fn element_at(&self, k: usize, [x, y]: [f32; 2]) -> Element {
        let [cx, cy] = self.center(k);
        self.elements[k].at(x - cx, y - cy)
    }
}

/// Maximum difference between two neighbouring surface elements that belong to the same surface, pixels. The difference
/// is that of the disparities, plus that of the velocities times [`JUMP_FRAMES`].
const MAX_JUMP_PX: f32 = 1.0;
/// Time by which the difference in velocity of two neighbouring surface elements is multiplied, frames. The product is
/// compared with [`MAX_JUMP_PX`].
const JUMP_FRAMES: f32 = 0.5;

/// Depth and motion of a frame with their standard errors, quantized for rendering and storage. A pixel takes 16
/// bytes in memory, tiles aside, and about a third of that on disk.
///
/// Velocities, accelerations and rates of disparity are rounded to 1/64 pixel, inverse depths to 1/65535 of the
/// search range, and standard errors to a power of √2.
#[derive(Clone, Debug, PartialEq)]
pub struct FlowMap {
    pub width: usize,
    pub height: usize,
    /// Disparity of a point at a depth of 1 m, pixels, at a baseline of twice the distance between neighbouring
    /// cameras. It is the factor from an inverse depth, 1/m, to a disparity.
    pub disparity_px: f32,
    /// Range of inverse depths that can be stored: minimum and maximum, 1/m. It is that of the search, with that of the static
    /// background. Depths beyond it are stored as its ends.
    pub(super) inverse_depth: [f32; 2],
    pub(super) pixels: Vec<FlowPixel>,
    /// For each tile, row by row, the smallest and the largest values of its surface elements.
    tiles: Vec<[FlowPixel; 2]>,
}

impl FlowMap {
    /// Quantizes an estimated map of the finest pyramid level. `inverse_depth` and `disparity_px` are the fields of
    /// these names. All standard errors are set to the smallest one that can be stored.
    pub fn new(map: &ElementMap, inverse_depth: [f32; 2], disparity_px: f32) -> Self {
        let scales = Scales::new(inverse_depth, disparity_px);
        let pixel = |(k, e): (usize, &Element)| {
            let (x, y) = (k % map.width, k / map.width);
            let mut edges = 0;
            for (side, (dx, dy)) in [(-1, 0), (1, 0), (0, -1), (0, 1)].into_iter().enumerate() {
                let (u, v) = (x.wrapping_add_signed(dx), y.wrapping_add_signed(dy));
                if u < map.width && v < map.height {
                    let neighbor = map.elements[v * map.width + u].at(-dx as f32, -dy as f32);
                    edges |= u8::from(is_jump(e, &neighbor, disparity_px)) << side;
                }
            }
            FlowPixel::quantized(e, edges, &scales)
        };
        let pixels = map.elements.iter().enumerate().map(pixel).collect();
        Self::of_pixels([map.width, map.height], disparity_px, inverse_depth, pixels)
    }

    /// Creates a map from its width and height, pixels, and its pixels, row by row. The other arguments are the fields of these
    /// names.
    pub(super) fn of_pixels(
        [width, height]: [usize; 2],
        disparity_px: f32,
        inverse_depth: [f32; 2],
        pixels: Vec<FlowPixel>,
    ) -> Self {
        let [tile_width, tile_height] = TILE_PX;
        let (columns, rows) = (width.div_ceil(tile_width), height.div_ceil(tile_height));
        let range = |tile: usize| {
            let (left, top) = (tile % columns * tile_width, tile / columns * tile_height);
            let right = (left + tile_width).min(width);
            let rows =
                (top..(top + tile_height).min(height)).map(|y| &pixels[y * width..][left..right]);
            FlowPixel::range(rows.flatten())
        };
        let tiles = (0..columns * rows).filter_map(range).collect();
        Self { width, height, disparity_px, inverse_depth, pixels, tiles }
    }

    /// Returns the map with the given standard errors of its surface elements, one for each pixel, row by row.
    pub(super) fn with_errors(mut self, errors: &[ElementErrors]) -> Self {
        for (pixel, errors) in self.pixels.iter_mut().zip(errors) {
            *pixel = pixel.with_errors(errors);
        }
        self
    }

    /// Returns the map with the surface elements of some pixels marked as unknown: those for whose indices `is_known` is
    /// false.
    pub fn known_where(mut self, is_known: impl Fn(usize) -> bool) -> Self {
        let pixels = self.pixels.iter_mut().enumerate();
        pixels.filter(|(k, _)| !is_known(*k)).for_each(|(_, pixel)| *pixel = pixel.unknown());
        self
    }

    pub fn pixels(&self) -> &[FlowPixel] {
        &self.pixels
    }

    /// Returns the numbers of tiles in a row, and in a column.
    pub fn tiles(&self) -> [usize; 2] {
        [self.width.div_ceil(TILE_PX[0]), self.height.div_ceil(TILE_PX[1])]
    }

    /// Returns a row of tiles. `dt` is that of [`TileRow`].
    pub(super) fn tile_row(&self, row: usize, dt: [f32; 2]) -> TileRow<'_> {
        let [columns, _] = self.tiles();
        let ranges = &self.tiles[row * columns..][..columns];
        TileRow { ranges, scales: self.scales(), top: row * TILE_PX[1], dt }
    }

    /// Returns whether all surface elements of a tile are slow ([`FlowPixel::is_slow`]).
    fn is_slow(&self, tile: usize) -> bool {
        self.tiles[tile].iter().all(FlowPixel::is_slow)
    }

    /// Returns the smallest and the largest inverse depth, 1/m, of the tiles in a box of the map, pixels. `None` if the box
    /// isn't inside of the map, or one of these tiles has an element that isn't slow.
    pub(super) fn slow_depths(&self, [columns, rows]: Bounds) -> Option<[f32; 2]> {
        let is_inside = |[min, max]: [f32; 2], size: usize| {
            // An empty box isn't inside.
            min >= 0.0 && min <= max && max < size as f32
        };
        if !is_inside(columns, self.width) || !is_inside(rows, self.height) {
            return None;
        }
        let tiles = |range: [f32; 2], side: usize| {
            let [first, last] = range.map(|at| at as usize / side);
            first..=last
        };
        let [width, _] = self.tiles();
        let mut depths = [f32::INFINITY, f32::NEG_INFINITY];
        for row in tiles(rows, TILE_PX[1]) {
            for tile in tiles(columns, TILE_PX[0]).map(|column| row * width + column) {
                if !self.is_slow(tile) {
                    return None;
                }
                let [min, max] = self.tiles[tile].map(|pixel| self.element(&pixel).inverse_depth);
                depths = [depths[0].min(min), depths[1].max(max)];
            }
        }
        Some(depths)
    }

    /// Returns the centre of pixel `k`, pixels.
    pub fn center(&self, k: usize) -> [f32; 2] {
        [(k % self.width) as f32 + 0.5, (k / self.width) as f32 + 0.5]
    }

    #[inline(always)]
    pub fn element(&self, pixel: &FlowPixel) -> Element {
        pixel.element(&self.scales())
    }

    /// Returns what turns pixels of the map into surface elements.
    #[inline(always)]
    pub(super) fn scales(&self) -> Scales {
        Scales::new(self.inverse_depth, self.disparity_px)
    }

    /// Returns the size in memory, bytes.
    pub fn bytes(&self) -> usize {
        size_of_val(self.pixels.as_slice()) + size_of_val(self.tiles.as_slice())
    }
}

fn is_jump(a: &Element, b: &Element, disparity_px: f32) -> bool {
    let motion = (a.velocity[0] - b.velocity[0]).abs() + (a.velocity[1] - b.velocity[1]).abs();
    let disparity = (a.inverse_depth - b.inverse_depth).abs() * disparity_px;
    disparity + JUMP_FRAMES * motion > MAX_JUMP_PX
}

/// A frame and its scene flow map, which holds its depth and motion.
#[derive(Clone, Copy)]
pub struct MappedFrame<'a> {
    pub frame: &'a FlowFrame,
    pub map: &'a FlowMap,
}
