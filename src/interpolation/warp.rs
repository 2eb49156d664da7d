//! Backward warps: for every pixel of the image to make, where in a frame it comes from; and the
//! cross dissolve of two of them, eq. (9).

use super::windows::mixed;
use crate::raster::{Image, sample_all};
use rayon::prelude::*;

/// Positions in the source frame, pixels, one a pixel of the image to make, row by row.
#[derive(Clone, Debug, PartialEq)]
pub struct Warp {
    pub width: usize,
    pub height: usize,
    pub source: Vec<[f32; 2]>,
}

impl Warp {
    /// Every pixel comes from where it is.
    pub fn identity(width: usize, height: usize) -> Self {
        let source = (0..width * height)
            .map(|k| [(k % width) as f32 + 0.5, (k / width) as f32 + 0.5])
            .collect();
        Self { width, height, source }
    }
}

/// The frame as the warp moves it. The cubic's lobes may leave 0..=1.
pub(super) fn warped(image: &Image, warp: &Warp) -> Image {
    let channels = image.channels();
    let mut data = vec![0.0; warp.source.len() * channels];
    data.par_chunks_mut(warp.width * channels).enumerate().for_each(|(y, row)| {
        let positions = &warp.source[y * warp.width..][..warp.width];
        sample_all(image, positions.iter().copied(), row);
    });
    Image::from_data(warp.width, warp.height, channels, data)
}

/// Eq. (9): `share` is (t' − t)/Δt, 0 at the earlier frame. Frames have the warps' size and the
/// same channels.
pub fn cross_dissolve(
    [earlier, later]: [&Image; 2],
    [from_earlier, from_later]: [&Warp; 2],
    share: f32,
) -> Image {
    let mut image = mixed(&warped(earlier, from_earlier), &warped(later, from_later), share);
    image.data_mut().iter_mut().for_each(|v| *v = v.clamp(0.0, 1.0));
    image
}
