//! Backward warps: for every pixel of the image to make, where in a frame it comes from; and the
//! cross dissolve of two of them, eq. (9).

use crate::raster::Image;
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

/// Eq. (9): `share` is (t' − t)/Δt, 0 at the earlier frame. Frames have the warps' size and the
/// same channels.
pub fn cross_dissolve(
    [earlier, later]: [&Image; 2],
    [from_earlier, from_later]: [&Warp; 2],
    share: f32,
) -> Image {
    let (w, h, channels) = (earlier.width(), earlier.height(), earlier.channels());
    let mut data = vec![0.0; w * h * channels];
    data.par_chunks_mut(w * channels).enumerate().for_each(|(y, row)| {
        let (mut a, mut b) = ([0.0; 3], [0.0; 3]);
        for (x, out) in row.chunks_exact_mut(channels).enumerate() {
            let k = y * w + x;
            let [ax, ay] = from_earlier.source[k];
            let [bx, by] = from_later.source[k];
            earlier.sample_cubic(ax, ay, &mut a[..channels]);
            later.sample_cubic(bx, by, &mut b[..channels]);
            for (out, (a, b)) in out.iter_mut().zip(a.iter().zip(&b)) {
                *out = (a * (1.0 - share) + b * share).clamp(0.0, 1.0);
            }
        }
    });
    Image::from_data(w, h, channels, data)
}
