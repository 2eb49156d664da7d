//! Descriptors of pixels, eight bytes each: the census transform (Zabih and Woodfill 1994), and the range of
//! grey values within half a pixel (Birchfield and Tomasi 1998).

use super::StereoImage;
use crate::camera::Camera;
use crate::raster::Image;

/// Half-width of the census window, pixels.
const RADIUS: isize = 2;
/// Minimum difference of grey values, 0..=1, that sets a census bit: half a step of 8 bits.
const MIN_DIFFERENCE: f32 = 0.5 / 255.0;
/// Maximum cost of a difference of grey values, in 8-bit steps.
const MAX_GRAY_COST: i32 = 24;
/// Cost of one differing census bit, in 8-bit steps of grey values.
const BIT_COST: u32 = 2;

/// A pixel's descriptor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Descriptor {
    /// Census code, 24 bits.
    code: u32,
    /// Four bytes: the pixel's grey value, the minimum and maximum within half a pixel around it, and 0 (255 outside
    /// the image).
    grays: u32,
}

impl Descriptor {
    /// Descriptor of pixels outside the image; its cost is 255.
    pub const OUTSIDE: Self = Self { code: 0, grays: u32::MAX };

    fn new(code: u32, [value, min, max]: [u8; 3]) -> Self {
        Self { code, grays: u32::from_le_bytes([value, min, max, 0]) }
    }

    /// Matching cost: [`BIT_COST`] for every differing census bit, plus the distance of the grey value from
    /// the other pixel's range, at most [`MAX_GRAY_COST`].
    ///
    /// It uses only 32-bit integers and no branches, so that eight pixels are compared at a time.
    #[inline(always)]
    pub fn cost(&self, Self { code, grays }: Self) -> u8 {
        let [min, max] = [8, 16].map(|shift| (grays >> shift & 255) as i32);
        let value = (self.grays & 255) as i32;
        let beyond = (value - max).max(min - value).clamp(0, MAX_GRAY_COST);
        let cost = BIT_COST * (self.code ^ code).count_ones() + beyond as u32;
        (cost | grays >> 24) as u8
    }
}

/// A grey image and the descriptors of its pixels.
#[derive(Clone, Debug)]
pub(super) struct CensusImage {
    pub camera: Camera,
    pub gray: Image,
    pub descriptors: Vec<Descriptor>,
}

impl CensusImage {
    pub fn new(camera: Camera, gray: Image) -> Self {
        let descriptors = descriptors(&gray);
        Self { camera, gray, descriptors }
    }

    /// The image at half its width and height; an odd last row or column is dropped. `None` if it would be
    /// too small.
    fn halved(&self) -> Option<Self> {
        Some(Self::new(halved(&self.camera)?, crate::registration::halved(&self.gray)))
    }
}

/// The camera at half its resolution. `None` if less than 2×2 pixels remain.
pub(super) fn halved(camera: &Camera) -> Option<Camera> {
    camera.halved().filter(|c| c.width > 1 && c.height > 1)
}

/// The pyramid of an image with descriptors, from fine to coarse. The image is halved `halvings` times, or
/// until it is too small; there is at least one level.
pub(super) fn census_pyramid(view: &StereoImage, halvings: usize) -> Vec<CensusImage> {
    let full = CensusImage::new(view.camera.clone(), view.image.to_gray());
    std::iter::successors(Some(full), CensusImage::halved).take(halvings + 1).collect()
}

/// Descriptors of all pixels, row by row; the border is repeated outwards.
fn descriptors(gray: &Image) -> Vec<Descriptor> {
    let (w, h) = (gray.width() as isize, gray.height() as isize);
    let bytes: Vec<u8> =
        gray.data().iter().map(|v| (255.0 * v.clamp(0.0, 1.0)).round() as u8).collect();
    let at = |x: isize, y: isize| (y.clamp(0, h - 1) * w + x.clamp(0, w - 1)) as usize;
    let mut descriptors = Vec::with_capacity(bytes.len());
    for y in 0..h {
        for x in 0..w {
            let value = bytes[at(x, y)];
            let center = gray.data()[at(x, y)] - MIN_DIFFERENCE;
            let mut code = 0;
            for dy in -RADIUS..=RADIUS {
                for dx in -RADIUS..=RADIUS {
                    if (dx, dy) != (0, 0) {
                        code = code << 1 | u32::from(gray.data()[at(x + dx, y + dy)] < center);
                    }
                }
            }
            let (mut min, mut max) = (value, value);
            for near in [at(x - 1, y), at(x + 1, y), at(x, y - 1), at(x, y + 1)] {
                let half = value.midpoint(bytes[near]);
                (min, max) = (min.min(half), max.max(half));
            }
            descriptors.push(Descriptor::new(code, [value, min, max]));
        }
    }
    descriptors
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn costs_are_bits_and_grey_values() {
        let own = Descriptor::new(0b1011, [100, 90, 110]);
        for (code, min, max, expected) in
            [(0b1011, 95, 105, 0), (0b0010, 95, 105, 4), (0, 107, 120, 13), (0b1011, 0, 10, 24)]
        {
            assert_eq!(own.cost(Descriptor::new(code, [min, min, max])), expected);
        }
        assert_eq!(own.cost(Descriptor::OUTSIDE), 255);
    }

    /// In a constant image, interpolation leaves differences by rounding, which must not set census bits.
    #[test]
    fn rounding_is_no_texture() {
        let filmed = Image::filled(9, 7, 1, 0.8);
        let data = (0..9 * 7).map(|k| 0.8 + 1e-6 * (k as f32).sin()).collect();
        let interpolated = Image::from_data(9, 7, 1, data);
        assert_eq!(descriptors(&filmed), descriptors(&interpolated));
    }
}
