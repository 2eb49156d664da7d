//! What a pixel descriptors like, in eight bytes: which pixels around it are darker (the census transform, Zabih
//! and Woodfill 1994), and between which grey values the image lies within half a pixel of it (Birchfield and
//! Tomasi 1998).

use crate::raster::Image;

/// Half the side of the census window, pixels. Larger: foreground swells over its outline; smaller: codes of
/// different places are alike.
const RADIUS: isize = 2;

/// The least difference of two values that counts as one: half a step of 8 bits. Larger: faint texture is lost;
/// smaller: on plain surfaces, the rounding of an interpolated image is taken for texture.
const MIN_DIFFERENCE: f32 = 0.5 / 255.0;

/// A pixel's descriptor, in two words that are loaded together.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Descriptor {
    /// The census code, 24 bits.
    code: u32,
    /// Grey values, 0 to 255: the pixel's, the least and the most around it, and 0.
    grays: u32,
}

impl Descriptor {
    /// What is outside the image.
    pub const NOWHERE: Self = Self { code: 0, grays: u32::MAX };

    fn new(code: u32, [value, least, most]: [u8; 3]) -> Self {
        Self { code, grays: u32::from_le_bytes([value, least, most, 0]) }
    }

    /// How far this pixel is from another: `bit` for every differing bit of the census codes, and how far its
    /// grey value is from those of the other, at most `max_gray`. 255 from [`Self::NOWHERE`].
    ///
    /// All of it is in 32 bits and without branches, for eight pixels at a time.
    #[inline(always)]
    pub fn cost(&self, Self { code, grays }: Self, bit: u32, max_gray: i32) -> u8 {
        let [least, most] = [8, 16].map(|shift| (grays >> shift & 255) as i32);
        let value = (self.grays & 255) as i32;
        let beyond = (value - most).max(least - value).max(0).min(max_gray);
        let cost = bit * (self.code ^ code).count_ones() + beyond as u32;
        (cost | grays >> 24) as u8
    }
}

/// The descriptors of all pixels of a grey image, row by row; the border is repeated outwards.
pub(super) fn descriptors(gray: &Image) -> Vec<Descriptor> {
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
            let (mut least, mut most) = (value, value);
            for near in [at(x - 1, y), at(x + 1, y), at(x, y - 1), at(x, y + 1)] {
                let half = value.midpoint(bytes[near]);
                (least, most) = (least.min(half), most.max(half));
            }
            descriptors.push(Descriptor::new(code, [value, least, most]));
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
        for (code, least, most, expected) in
            [(0b1011, 95, 105, 0), (0b0010, 95, 105, 4), (0, 107, 120, 13), (0b1011, 0, 10, 24)]
        {
            assert_eq!(own.cost(Descriptor::new(code, [least, least, most]), 2, 24), expected);
        }
        assert_eq!(own.cost(Descriptor::NOWHERE, 2, 24), 255);
    }

    /// An interpolated image is plain but for rounding where the filmed one is plain.
    #[test]
    fn rounding_is_no_texture() {
        let filmed = Image::filled(9, 7, 1, 0.8);
        let data = (0..9 * 7).map(|k| 0.8 + 1e-6 * (k as f32).sin()).collect();
        let interpolated = Image::from_data(9, 7, 1, data);
        assert_eq!(descriptors(&filmed), descriptors(&interpolated));
    }
}
