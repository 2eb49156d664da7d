//! Maps of a frame's depth and motion: [`ElementMap`] during estimation, and [`FlowMap`] for rendering and storage.

use super::element::{Element, ElementErrors};
use super::frame::FlowFrame;

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
    /// For each pixel, whether its surface element is given: that of the static background. Empty if none is.
    pub given: Vec<bool>,
}

impl ElementMap {
    /// Returns whether the surface element of pixel `k` is given, and isn't estimated.
    #[inline(always)]
    pub fn is_given(&self, k: usize) -> bool {
        self.given.get(k).copied().unwrap_or(false)
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

/// Quantization steps per pixel of a velocity, of an acceleration, and of a disparity's rate of change.
const STEPS: f32 = 64.0;
/// Maximum of what counts as slow, quantization steps: half a pixel. Two slow elements have about the same motion in frames
/// of similar focal lengths.
const SLOW_STEPS: u16 = 32;
/// Number of quantization steps from the minimum to the maximum of the search range of inverse depths.
const DEPTH_STEPS: f32 = u16::MAX as f32;
/// Maximum difference between two neighbouring surface elements that belong to the same surface, pixels. The difference
/// is that of the disparities, plus that of the velocities times [`JUMP_FRAMES`].
const MAX_JUMP_PX: f32 = 1.0;
/// Time by which the difference in velocity of two neighbouring surface elements is multiplied, frames. The product is
/// compared with [`MAX_JUMP_PX`].
const JUMP_FRAMES: f32 = 0.5;

/// Number of quantization steps per doubling of a standard error.
const STEPS_PER_OCTAVE: f32 = 2.0;
/// Code of the standard errors of a surface element that isn't known. It is larger than that of any error.
const UNKNOWN: u8 = u8::MAX;
/// Smallest standard error that can be stored, pixels.
const MIN_ERROR_PX: f32 = 1.0 / 256.0;

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
    /// Search range of inverse depths: minimum and maximum, 1/m.
    pub(super) inverse_depth: [f32; 2],
    pub(super) pixels: Vec<FlowPixel>,
    /// For each tile, row by row, the smallest and the largest values of its surface elements.
    tiles: Vec<[FlowPixel; 2]>,
}

/// Width and height of a map's tiles, pixels. Tiles at the right and lower borders may be smaller.
pub const TILE_PX: [usize; 2] = [16, 4];

/// Quantized surface element of one pixel.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct FlowPixel {
    inverse_depth: u16,
    velocity: [i16; 2],
    acceleration: [i16; 2],
    rate: i16,
    /// The bit mask that [`Self::edges`] returns.
    edges: u8,
    /// Standard errors of the disparity and of the velocity, as codes on a logarithmic scale.
    errors: [u8; 2],
}

impl FlowPixel {
    /// Number of 16-bit channels of a pixel.
    pub(super) const CHANNELS: usize = 6;
    /// Number of 8-bit channels of a pixel.
    pub(super) const BYTE_CHANNELS: usize = 3;
    /// Size of a pixel on disk before compression, bytes.
    pub(super) const BYTES: usize = 2 * Self::CHANNELS + Self::BYTE_CHANNELS;

    pub(super) fn new(
        channels: [u16; Self::CHANNELS],
        [edges, disparity, velocity]: [u8; Self::BYTE_CHANNELS],
    ) -> Self {
        let [inverse_depth, u, v, a, b, rate] = channels;
        let signed = |v: u16| v as i16;
        Self {
            inverse_depth,
            velocity: [signed(u), signed(v)],
            acceleration: [signed(a), signed(b)],
            rate: signed(rate),
            edges,
            errors: [disparity, velocity],
        }
    }

    /// Returns whether velocity, acceleration and the disparity's rate are each at most half a pixel ([`SLOW_STEPS`]).
    #[inline(always)]
    pub(super) fn is_slow(&self) -> bool {
        let [[u, v], [a, b]] = [self.velocity, self.acceleration];
        let is_small = |value: i16| value.unsigned_abs() <= SLOW_STEPS;
        is_small(u) & is_small(v) & is_small(a) & is_small(b) & is_small(self.rate)
    }

    pub(super) fn channels(&self) -> [u16; Self::CHANNELS] {
        let [[u, v], [a, b]] = [self.velocity, self.acceleration].map(|p| p.map(|v| v as u16));
        [self.inverse_depth, u, v, a, b, self.rate as u16]
    }

    pub(super) fn byte_channels(&self) -> [u8; Self::BYTE_CHANNELS] {
        [self.edges, self.errors[0], self.errors[1]]
    }

    /// Returns the standard errors of the pixel's surface element at the time of the map's frame.
    #[inline(always)]
    pub fn errors(&self) -> ElementErrors {
        let [disparity_px, velocity_px] = self.errors.map(error_from_code);
        ElementErrors { disparity_px, velocity_px }
    }

    /// Extends a range of depth and motion, whose two pixels hold the smallest and the largest values, by this pixel.
    #[inline(always)]
    fn extend(&self, [min, max]: &mut [Self; 2]) {
        min.inverse_depth = min.inverse_depth.min(self.inverse_depth);
        max.inverse_depth = max.inverse_depth.max(self.inverse_depth);
        for c in 0..2 {
            min.velocity[c] = min.velocity[c].min(self.velocity[c]);
            max.velocity[c] = max.velocity[c].max(self.velocity[c]);
            min.acceleration[c] = min.acceleration[c].min(self.acceleration[c]);
            max.acceleration[c] = max.acceleration[c].max(self.acceleration[c]);
        }
        min.rate = min.rate.min(self.rate);
        max.rate = max.rate.max(self.rate);
    }

    /// Returns whether the pixel's surface element is known.
    pub fn is_known(&self) -> bool {
        self.errors != [UNKNOWN; 2]
    }

    /// Returns a bit mask of the sides on which the neighbouring pixel belongs to another surface: bit 0 for left, 1 for
    /// right, 2 for above, 3 for below.
    #[inline(always)]
    pub fn edges(&self) -> u8 {
        self.edges
    }
}

impl FlowMap {
    /// Quantizes an estimated map of the finest pyramid level. `inverse_depth` is the minimum and maximum of the search
    /// range, 1/m, which contains all inverse depths of the map. `disparity_px` is [`Self::disparity_px`]. All standard
    /// errors are set to the smallest one that can be stored.
    pub fn new(map: &ElementMap, inverse_depth: [f32; 2], disparity_px: f32) -> Self {
        let rounded = |v: f32| (v * STEPS).round() as i16; // saturates
        let [min, max] = inverse_depth;
        // If minimum and maximum are equal, all inverse depths equal the minimum.
        let per_step = (max - min).max(f32::MIN_POSITIVE) / DEPTH_STEPS;
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
            FlowPixel {
                inverse_depth: ((e.inverse_depth - min) / per_step).round() as u16, // saturates
                velocity: e.velocity.map(rounded),
                acceleration: e.acceleration.map(rounded),
                rate: rounded(e.inverse_depth_rate * disparity_px),
                edges,
                errors: [0; 2],
            }
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
        let mut tiles = Vec::with_capacity(columns * rows);
        for tile in 0..columns * rows {
            let (left, top) = (tile % columns * tile_width, tile / columns * tile_height);
            let first = pixels[top * width + left];
            let mut range = [FlowPixel { edges: 0, errors: [0; 2], ..first }; 2];
            for y in top..(top + tile_height).min(height) {
                let row = &pixels[y * width..][left..(left + tile_width).min(width)];
                row.iter().for_each(|pixel| pixel.extend(&mut range));
            }
            tiles.push(range);
        }
        Self { width, height, disparity_px, inverse_depth, pixels, tiles }
    }

    /// Returns the map with the given standard errors of its surface elements, one for each pixel, row by row.
    pub(super) fn with_errors(mut self, errors: &[ElementErrors]) -> Self {
        for (pixel, errors) in self.pixels.iter_mut().zip(errors) {
            pixel.errors = [errors.disparity_px, errors.velocity_px].map(code_from_error);
        }
        self
    }

    /// Returns the map with the surface elements of some pixels marked as unknown: those for whose indices `is_known` is
    /// false.
    pub fn known_where(mut self, is_known: impl Fn(usize) -> bool) -> Self {
        let pixels = self.pixels.iter_mut().enumerate();
        pixels.filter(|(k, _)| !is_known(*k)).for_each(|(_, pixel)| pixel.errors = [UNKNOWN; 2]);
        self
    }

    pub fn pixels(&self) -> &[FlowPixel] {
        &self.pixels
    }

    /// Returns the numbers of tiles in a row, and in a column.
    pub fn tiles(&self) -> [usize; 2] {
        [self.width.div_ceil(TILE_PX[0]), self.height.div_ceil(TILE_PX[1])]
    }

    /// Returns two elements between which all surface elements of a tile lie, value by value: one has the smallest
    /// values, the other the largest. `tile` is the index of the tile, row by row.
    pub fn range(&self, tile: usize) -> [Element; 2] {
        self.tiles[tile].each_ref().map(|pixel| self.element(pixel))
    }

    /// Returns the centre of pixel `k`, pixels.
    pub fn center(&self, k: usize) -> [f32; 2] {
        [(k % self.width) as f32 + 0.5, (k / self.width) as f32 + 0.5]
    }

    pub fn element(&self, pixel: &FlowPixel) -> Element {
        let value = |v: i16| f32::from(v) * (1.0 / STEPS); // a power of two
        let [min, max] = self.inverse_depth;
        Element {
            inverse_depth: min + f32::from(pixel.inverse_depth) * ((max - min) / DEPTH_STEPS),
            velocity: pixel.velocity.map(value),
            acceleration: pixel.acceleration.map(value),
            inverse_depth_rate: value(pixel.rate) / self.disparity_px,
            ..Element::default()
        }
    }

    /// Returns the size in memory, bytes.
    pub fn bytes(&self) -> usize {
        size_of_val(self.pixels.as_slice()) + size_of_val(self.tiles.as_slice())
    }
}

fn code_from_error(error_px: f32) -> u8 {
    // Casts saturate, and turn NaN into 0. The lower bound of 1 keeps the logarithm finite.
    (STEPS_PER_OCTAVE * (error_px / MIN_ERROR_PX).max(1.0).log2()).round() as u8
}

#[inline(always)]
fn error_from_code(code: u8) -> f32 {
    MIN_ERROR_PX * (f32::from(code) / STEPS_PER_OCTAVE).exp2()
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
