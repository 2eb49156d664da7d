//! Descriptors of pixels, eight bytes each: the census transform (Zabih and Woodfill 1994), and the range of
//! grey values within half a pixel (Birchfield and Tomasi 1998).

use super::StereoImage;
use crate::camera::Camera;
use crate::raster::Image;

/// Half-width of the census window, pixels.
const RADIUS: isize = 2;
/// Minimum difference of two grey values, 0 to 1, that sets a census bit: half a step of an 8-bit image.
const MIN_DIFFERENCE: f32 = 0.5 / 255.0;
/// Maximum matching cost due to the difference of grey values, in steps of 8-bit grey values.
const MAX_GRAY_COST: i32 = 24;
/// Matching cost of one differing census bit, in steps of 8-bit grey values.
const BIT_COST: u32 = 2;

/// Descriptor of a pixel for stereo matching.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Descriptor {
    /// Census code of the pixel, 24 bits.
    code: u32,
    /// Four bytes: the pixel's grey value, the minimum and the maximum grey value within half a pixel around it, and 0.
    /// All bytes are 255 outside the image.
    grays: u32,
}

impl Descriptor {
    /// Descriptor of a position outside the image. Its matching cost is 255.
    pub const OUTSIDE: Self = Self { code: 0, grays: u32::MAX };

    fn new(code: u32, [value, min, max]: [u8; 3]) -> Self {
        Self { code, grays: u32::from_le_bytes([value, min, max, 0]) }
    }

    /// Returns the matching cost of this pixel and a pixel of another image: [`BIT_COST`] for every differing census
    /// bit, plus a cost for grey values. The cost for grey values is the distance of this pixel's grey value from the
    /// other pixel's range of grey values, at most [`MAX_GRAY_COST`].
    ///
    /// The function uses only 32-bit integers and no branches, so that eight pixels are compared at a time.
    #[inline(always)]
    pub fn cost(&self, Self { code, grays }: Self) -> u8 {
        let [min, max] = [8, 16].map(|shift| (grays >> shift & 255) as i32);
        let value = (self.grays & 255) as i32;
        let beyond = (value - max).max(min - value).clamp(0, MAX_GRAY_COST);
        let cost = BIT_COST * (self.code ^ code).count_ones() + beyond as u32;
        (cost | grays >> 24) as u8
    }
}

/// A camera's grey image, and the descriptors of its pixels.
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

    /// Returns the image at half its width and height. An odd last row or column is dropped. `None` if the result would
    /// have less than 2×2 pixels.
    fn halved(&self) -> Option<Self> {
        Some(Self::new(halved(&self.camera)?, crate::registration::halved(&self.gray)))
    }
}

/// Returns the camera at half its resolution. `None` if the result would have less than 2×2 pixels.
pub(super) fn halved(camera: &Camera) -> Option<Camera> {
    camera.halved().filter(|c| c.width > 1 && c.height > 1)
}

/// Returns the image pyramid of a camera, with descriptors, from fine to coarse. The image is halved `halvings` times,
/// or until it is too small. There is at least one level.
pub(super) fn census_pyramid(view: &StereoImage, halvings: usize) -> Vec<CensusImage> {
    let full = CensusImage::new(view.camera.clone(), view.image.to_gray());
    std::iter::successors(Some(full), CensusImage::halved).take(halvings + 1).collect()
}

/// Computes the descriptors of all pixels, row by row. For positions outside the image, the nearest border pixel is
/// used.
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

    /// Checks that no census bits are set by the rounding differences that interpolation leaves in a constant image.
    #[test]
    fn rounding_is_no_texture() {
        let filmed = Image::filled(9, 7, 1, 0.8);
        let data = (0..9 * 7).map(|k| 0.8 + 1e-6 * (k as f32).sin()).collect();
        let interpolated = Image::from_data(9, 7, 1, data);
        assert_eq!(descriptors(&filmed), descriptors(&interpolated));
    }
}
