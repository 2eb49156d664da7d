//! Grey image pyramids with their gradients: made once an image, shared by everything that tracks
//! in it.

use crate::raster::Image;

/// A pyramid of half-sized levels, the full image first.
#[derive(Clone, Debug)]
pub struct Pyramid {
    levels: Vec<Level>,
}

/// One level: values and Scharr gradients (per pixel of this level), with the border repeated
/// `pad` pixels outwards so that a window needs no bounds checks.
#[derive(Clone, Debug)]
pub struct Level {
    pub width: usize,
    pub height: usize,
    pub(super) pad: usize,
    pub(super) stride: usize,
    pub(super) value: Vec<f32>,
    pub(super) dx: Vec<f32>,
    pub(super) dy: Vec<f32>,
}

/// Levels smaller than this hold nothing to track.
const MIN_LEVEL_PX: usize = 16;

impl Pyramid {
    /// `levels` of them at most; fewer where the image gets too small. `pad` is the border that
    /// the largest window needs.
    pub fn new(image: &Image, levels: usize, pad: usize) -> Self {
        let gray = image.to_gray();
        let (mut w, mut h) = (gray.width(), gray.height());
        let mut data = gray.data().to_vec();
        let mut all = vec![Level::new(&data, w, h, pad)];
        while all.len() < levels && w.min(h) >= 2 * MIN_LEVEL_PX {
            (data, w, h) = halved(&data, w, h);
            all.push(Level::new(&data, w, h, pad));
        }
        Self { levels: all }
    }

    pub fn levels(&self) -> &[Level] {
        &self.levels
    }

    pub fn width(&self) -> usize {
        self.levels[0].width
    }

    pub fn height(&self) -> usize {
        self.levels[0].height
    }
}

impl Level {
    fn new(data: &[f32], width: usize, height: usize, pad: usize) -> Self {
        let stride = width + 2 * pad;
        let padded = |plane: &[f32]| -> Vec<f32> {
            let mut out = Vec::with_capacity(stride * (height + 2 * pad));
            for y in 0..height + 2 * pad {
                let row = &plane[y.saturating_sub(pad).min(height - 1) * width..][..width];
                out.extend(std::iter::repeat_n(row[0], pad));
                out.extend_from_slice(row);
                out.extend(std::iter::repeat_n(row[width - 1], pad));
            }
            out
        };
        let (dx, dy) = scharr(data, width, height);
        Self { width, height, pad, stride, value: padded(data), dx: padded(&dx), dy: padded(&dy) }
    }

    /// Index of a pixel in the padded planes; both may be `pad` outside the image.
    pub(super) fn index(&self, x: isize, y: isize) -> usize {
        let at = |v: isize| (v + self.pad as isize) as usize;
        at(y) * self.stride + at(x)
    }

    /// Gradient at a pixel (not padded), per pixel.
    pub fn gradient(&self, x: usize, y: usize) -> (f32, f32) {
        let at = self.index(x as isize, y as isize);
        (self.dx[at], self.dy[at])
    }
}

/// Scharr's 3×3 derivatives, normalized to value per pixel; borders repeated.
fn scharr(data: &[f32], width: usize, height: usize) -> (Vec<f32>, Vec<f32>) {
    let mut dx = vec![0.0; data.len()];
    let mut dy = vec![0.0; data.len()];
    let row = |y: usize| &data[y * width..(y + 1) * width];
    for y in 0..height {
        let (up, mid, down) = (row(y.saturating_sub(1)), row(y), row((y + 1).min(height - 1)));
        let mut set = |l: usize, x: usize, r: usize| {
            let smooth = |x: usize| 3.0 * (up[x] + down[x]) + 10.0 * mid[x];
            let differ = |x: usize| down[x] - up[x];
            dx[y * width + x] = (smooth(r) - smooth(l)) / 32.0;
            dy[y * width + x] = (3.0 * (differ(l) + differ(r)) + 10.0 * differ(x)) / 32.0;
        };
        set(0, 0, 1.min(width - 1));
        set(width.saturating_sub(2), width - 1, width - 1);
        if width < 3 {
            continue;
        }
        let inner = y * width + 1..(y + 1) * width - 1;
        let rows = up.windows(3).zip(mid.windows(3)).zip(down.windows(3));
        for (((u, m), d), (dx, dy)) in rows.zip(dx[inner.clone()].iter_mut().zip(&mut dy[inner])) {
            let smooth = |x: usize| 3.0 * (u[x] + d[x]) + 10.0 * m[x];
            let differ = |x: usize| d[x] - u[x];
            *dx = (smooth(2) - smooth(0)) / 32.0;
            *dy = (3.0 * (differ(0) + differ(2)) + 10.0 * differ(1)) / 32.0;
        }
    }
    (dx, dy)
}

/// Smoothed by [1 4 6 4 1]/16 both ways, every second pixel kept: pixel i of the half-sized image
/// has its centre at pixel 2i of the large one. Borders are mirrored, as OpenCV's are.
fn halved(data: &[f32], width: usize, height: usize) -> (Vec<f32>, usize, usize) {
    let (w2, h2) = (width.div_ceil(2), height.div_ceil(2));
    let mirror = |v: isize, size: usize| {
        let last = size as isize - 1;
        let v = v.abs();
        (if v > last { (2 * last - v).max(0) } else { v }) as usize
    };
    const TAPS: [f32; 5] = [1.0 / 16.0, 4.0 / 16.0, 6.0 / 16.0, 4.0 / 16.0, 1.0 / 16.0];
    let mut narrow = vec![0.0; w2 * height];
    for y in 0..height {
        let row = &data[y * width..(y + 1) * width];
        let out = &mut narrow[y * w2..(y + 1) * w2];
        // Where all five are inside, in one go.
        let inner = 1..((width.max(2) - 2) / 2).max(1);
        for x in (0..w2).filter(|x| !inner.contains(x)) {
            out[x] =
                (0..5).map(|k| TAPS[k] * row[mirror(2 * x as isize + k as isize - 2, width)]).sum();
        }
        for (out, five) in out[inner.clone()].iter_mut().zip(row.windows(5).step_by(2)) {
            let [a, b, c, d, e] = five else { continue };
            *out = TAPS[0] * a + TAPS[1] * b + TAPS[2] * c + TAPS[3] * d + TAPS[4] * e;
        }
    }
    let mut half = vec![0.0; w2 * h2];
    for y in 0..h2 {
        for (k, tap) in TAPS.iter().enumerate() {
            let from = mirror(2 * y as isize + k as isize - 2, height) * w2;
            for (out, v) in half[y * w2..(y + 1) * w2].iter_mut().zip(&narrow[from..from + w2]) {
                *out += tap * v;
            }
        }
    }
    (half, w2, h2)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ramp(width: usize, height: usize) -> Image {
        let data = (0..width * height)
            .map(|k| (k % width) as f32 * 0.01 + (k / width) as f32 * 0.02)
            .collect();
        Image::from_data(width, height, 1, data)
    }

    #[test]
    fn gradients_are_per_pixel() {
        let pyramid = Pyramid::new(&ramp(40, 33), 1, 4);
        let (dx, dy) = pyramid.levels()[0].gradient(7, 9);
        assert!((dx - 0.01).abs() < 1e-6 && (dy - 0.02).abs() < 1e-6);
    }

    #[test]
    fn half_sized_pixels_are_centred_on_even_ones() {
        let pyramid = Pyramid::new(&ramp(65, 64), 2, 4);
        let half = &pyramid.levels()[1];
        assert_eq!((half.width, half.height), (33, 32));
        let v = half.value[half.index(10, 12)];
        assert!((v - (20.0 * 0.01 + 24.0 * 0.02)).abs() < 1e-5);
    }

    #[test]
    fn tiny_images_have_one_level() {
        for (w, h) in [(1, 1), (1, 50), (31, 31), (3, 2)] {
            let pyramid = Pyramid::new(&ramp(w, h), 5, 9);
            assert_eq!(pyramid.levels().len(), 1);
        }
        assert_eq!(Pyramid::new(&ramp(640, 480), 9, 9).levels().len(), 5);
    }
}
