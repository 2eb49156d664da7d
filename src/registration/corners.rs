//! §4.1: corner detection by the smaller eigenvalue of the structure tensor (Shi and Tomasi), with a minimum
//! distance between corners.

use super::gradient::{SCHARR_SCALE, scharr};
use super::pyramid::PyramidLevel;
use crate::raster::padded;
use crate::simd::{F32x8, LANES, multiversion};
use nalgebra::Point2;

/// Minimum distance between two corners, pixels.
pub(super) const MIN_DISTANCE_PX: f64 = 4.0;
/// Minimum strength of a corner, as a fraction of the largest strength in the image. The strength is the smaller
/// eigenvalue of the structure tensor.
const MIN_QUALITY: f32 = 1e-3;
/// Half-width of the box filter, pixels. The filter is applied twice to the structure tensor.
const RADIUS_PX: usize = 1;
/// Minimum strength of a corner in any image. The strength is the smaller eigenvalue of the structure tensor: a squared
/// gradient, in grey values (0 to 1) per pixel. The minimum corresponds to a gradient of 0.05 8-bit steps per pixel,
/// which is above the rounding noise of constant images.
const MIN_EIGENVALUE: f32 = 4e-8;

/// Detects the corners of a pyramid level (§4.1). Returns at most `max_corners` sub-pixel positions, strongest
/// corner first. Positions are in pixels of the level, with the centre of the top-left pixel at (0.5, 0.5). A
/// constant image has no corners.
pub fn corners(level: &PyramidLevel, max_corners: usize) -> Vec<Point2<f64>> {
    let (w, h) = (level.width, level.height);
    let strength = min_eigenvalues(level, RADIUS_PX);
    let mut peaks = peaks(&strength, w, h, MIN_QUALITY);
    peaks.sort_unstable_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));

    // The selected corners, sorted into square cells as wide as the minimum distance. Two corners within the
    // minimum distance are in the same cell or in adjacent cells.
    let [columns, rows] = [w, h].map(|size| (size as f64 / MIN_DISTANCE_PX) as usize + 1);
    let mut cells: Vec<Vec<Point2<f64>>> = vec![Vec::new(); columns * rows];
    let mut selected = Vec::new();
    for (_, at) in peaks {
        if selected.len() >= max_corners {
            break;
        }
        let p = refined(&strength, w, h, at % w, at / w);
        let [cx, cy] = [p.x, p.y].map(|v| (v / MIN_DISTANCE_PX) as usize);
        let around = |c: usize, n: usize| c.saturating_sub(1)..=(c + 1).min(n - 1);
        let is_free = |cell: usize| cells[cell].iter().all(|q| (q - p).norm() >= MIN_DISTANCE_PX);
        if around(cy, rows).all(|y| around(cx, columns).all(|x| is_free(y * columns + x))) {
            cells[cy * columns + cx].push(p);
            selected.push(p);
        }
    }
    selected
}

/// Finds the local maxima of `strength`, which holds the smaller eigenvalue of each pixel, row by row. Returns
/// pairs of strength and pixel index. Maxima below [`MIN_EIGENVALUE`], or below `min_quality` times the largest
/// value, are left out. Of equal neighbouring pixels, only the first in row-major order is a maximum.
fn peaks(strength: &[f32], w: usize, h: usize, min_quality: f32) -> Vec<(f32, usize)> {
    let largest = strength.iter().copied().fold(0.0, f32::max);
    let floor = (largest * min_quality).max(MIN_EIGENVALUE);
    // The eigenvalues with a border of −∞, one pixel wide.
    let wide = w + 2;
    let mut bordered = vec![f32::NEG_INFINITY; wide];
    bordered.extend(padded(strength, w, 1, f32::NEG_INFINITY));
    bordered.extend(vec![f32::NEG_INFINITY; wide]);
    let mut peaks = Vec::new();
    for y in 0..h {
        let [above, row, below] = [y, y + 1, y + 2].map(|y| &bordered[y * wide..][..wide]);
        for x in 0..w {
            let s = row[x + 1];
            // A peak is larger than its neighbours that precede it in row-major order, and at least as large as the
            // neighbours that follow.
            let before = above[x].max(above[x + 1]).max(above[x + 2]).max(row[x]);
            let after = below[x].max(below[x + 1]).max(below[x + 2]).max(row[x + 2]);
            if (s >= floor) & (s > before) & (s >= after) {
                peaks.push((s, y * w + x));
            }
        }
    }
    peaks
}

/// Returns the sub-pixel position of the peak at pixel (`x`, `y`). Along each axis, this is the vertex of the
/// parabola through the peak and its two neighbours.
fn refined(strength: &[f32], w: usize, h: usize, x: usize, y: usize) -> Point2<f64> {
    let vertex = |before: f32, here: f32, after: f32| {
        let curvature = f64::from(before) - 2.0 * f64::from(here) + f64::from(after);
        // A flat top has no vertex. Otherwise the vertex is at most half a pixel from the peak.
        if curvature < 0.0 {
            (0.5 * (f64::from(before) - f64::from(after)) / curvature).clamp(-0.5, 0.5)
        } else {
            0.0
        }
    };
    let s = |x: usize, y: usize| strength[y * w + x];
    let dx = if x > 0 && x + 1 < w { vertex(s(x - 1, y), s(x, y), s(x + 1, y)) } else { 0.0 };
    let dy = if y > 0 && y + 1 < h { vertex(s(x, y - 1), s(x, y), s(x, y + 1)) } else { 0.0 };
    Point2::new(x as f64 + 0.5 + dx, y as f64 + 0.5 + dy)
}

multiversion! {
    fn min_eigenvalues(level: &PyramidLevel, radius: usize) -> Vec<f32> = min_eigenvalues_by::<V>
}

/// Returns, for each pixel, the smaller eigenvalue of the structure tensor averaged over a triangular window (a box
/// filter applied twice). With this window, a corner is a single maximum; with a box filter, a corner would be a
/// plateau. Outside the image, the nearest border pixel is used.
#[inline(always)]
fn min_eigenvalues_by<V: F32x8>(level: &PyramidLevel, radius: usize) -> Vec<f32> {
    let (w, h) = (level.width, level.height);
    let side = 2 * radius + 1;
    let taps: Vec<f32> = (1..=side)
        .chain((1..side).rev())
        .map(|k| k as f32 / (side * side) as f32 / SCHARR_SCALE)
        .collect();
    let mut products = Tensor::zeros(w + 4 * radius);
    let mut rows = Vec::with_capacity(h);
    for y in 0..h {
        products.load::<V>(level, y, 2 * radius);
        let mut row = Tensor::zeros(w);
        for (k, &tap) in taps.iter().enumerate() {
            row.add(&products, k, tap);
        }
        rows.push(row);
    }
    let mut out = Vec::with_capacity(w * h);
    for y in 0..h {
        let mut sums = Tensor::zeros(w);
        for (k, &tap) in taps.iter().enumerate() {
            sums.add(&rows[(y + k).saturating_sub(2 * radius).min(h - 1)], 0, tap);
        }
        let [xx, xy, yy] = &sums.planes;
        out.extend(xx.iter().zip(xy).zip(yy).map(|((a, b), c)| {
            // λ_min of [a b; b c]. The square root's argument is a sum of squares, so it is not negative. Rounding
            // can make λ_min slightly negative.
            0.5 * ((a + c) - ((a - c) * (a - c) + 4.0 * b * b).sqrt())
        }));
    }
    out
}

/// The structure tensors of a row of pixels. `planes` holds one array each for the entries xx, xy and yy.
struct Tensor {
    planes: [Vec<f32>; 3],
}

impl Tensor {
    fn zeros(width: usize) -> Self {
        Self { planes: std::array::from_fn(|_| vec![0.0; width]) }
    }

    /// Adds the tensors of another row, multiplied by `factor`. The other row's tensor at index k + `shift` is added to
    /// the tensor at index k.
    #[inline(always)]
    fn add(&mut self, other: &Self, shift: usize, factor: f32) {
        for (plane, other) in self.planes.iter_mut().zip(&other.planes) {
            for (sum, v) in plane.iter_mut().zip(&other[shift..]) {
                *sum += factor * v;
            }
        }
    }

    /// Computes the tensors of row `y` of the level: the products of the derivatives at each pixel. The products are
    /// scaled by [`SCHARR_SCALE`] squared. The tensors at both ends of the row are repeated `margin` times.
    #[inline(always)]
    fn load<V: F32x8>(&mut self, level: &PyramidLevel, y: usize, margin: usize) {
        let [xx, xy, yy] = &mut self.planes;
        for x in (0..level.width).step_by(LANES) {
            let at = level.index(x as isize, y as isize);
            let [dx, dy] = scharr::<V>(&level.value, at, level.stride).map(F32x8::to_array);
            let columns = x + margin..(x + LANES).min(level.width) + margin;
            for (k, (dx, dy)) in columns.zip(dx.iter().zip(dy)) {
                (xx[k], xy[k], yy[k]) = (dx * dx, dx * dy, dy * dy);
            }
        }
        for plane in &mut self.planes {
            let last = level.width + margin - 1;
            let ends = [plane[margin], plane[last]];
            plane[..margin].fill(ends[0]);
            plane[last..].fill(ends[1]);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::pyramid::Pyramid;
    use super::*;
    use crate::random::Random;
    use crate::raster::Image;

    fn detected(image: &Image, max_corners: usize) -> Vec<Point2<f64>> {
        corners(&Pyramid::new(image, 1, 8).levels[0], max_corners)
    }

    #[test]
    fn a_square_has_four_corners() {
        let mut image = Image::filled(60, 50, 1, 0.2);
        for y in 15..35 {
            for x in 20..40 {
                image.data_mut()[y * 60 + x] = 0.9;
            }
        }
        let mut points = detected(&image, 4);
        points.sort_by(|a, b| (a.y > 25.0, a.x).partial_cmp(&(b.y > 25.0, b.x)).unwrap());
        let expected = [(20.0, 15.0), (40.0, 15.0), (20.0, 35.0), (40.0, 35.0)];
        assert_eq!(points.len(), 4);
        for (p, (x, y)) in points.iter().zip(expected) {
            assert!((p - Point2::new(x, y)).norm() < 2.0, "{p} {x} {y}");
        }
    }

    #[test]
    fn constant_images_have_none() {
        for (w, h) in [(1, 1), (2, 7), (64, 48)] {
            assert!(detected(&Image::filled(w, h, 1, 0.5), 100).is_empty());
        }
    }

    #[test]
    fn the_minimum_distance_holds_and_the_count_is_bounded() {
        let mut random = Random::new(1);
        let data = (0..90 * 70).map(|_| random.unit() as f32).collect();
        let image = Image::from_data(90, 70, 1, data);
        let points = detected(&image, 4000);
        assert!(points.len() > 50);
        for (k, a) in points.iter().enumerate() {
            for b in &points[..k] {
                assert!((a - b).norm() >= MIN_DISTANCE_PX);
            }
        }
        let few = detected(&image, 7);
        assert_eq!(few[..], points[..7]);
    }

    /// The strengths have few distinct values, so that many neighbours are equal.
    #[test]
    fn peaks_agree_with_a_naive_reference() {
        let mut random = Random::new(2);
        for (w, h) in [(1, 1), (1, 9), (9, 1), (2, 2), (3, 5), (17, 12), (40, 31)] {
            for values in [3.0, 40.0] {
                let strength: Vec<f32> =
                    (0..w * h).map(|_| (values * random.unit()).floor() as f32).collect();
                let largest = strength.iter().fold(0.0_f32, |a, &b| a.max(b));
                let expected: Vec<(f32, usize)> = (0..w * h)
                    .filter(|&k| strength[k] > 0.0 && strength[k] >= 0.4 * largest)
                    .filter(|&k| is_peak(&strength, w, h, k % w, k / w))
                    .map(|k| (strength[k], k))
                    .collect();
                assert_eq!(peaks(&strength, w, h, 0.4), expected, "{w}×{h}");
            }
        }
    }

    /// Reference implementation: returns whether a pixel is a local maximum. Of equal neighbouring pixels, only the
    /// first in row-major order is a local maximum.
    fn is_peak(strength: &[f32], w: usize, h: usize, x: usize, y: usize) -> bool {
        let s = strength[y * w + x];
        for ny in y.saturating_sub(1)..=(y + 1).min(h - 1) {
            for nx in x.saturating_sub(1)..=(x + 1).min(w - 1) {
                let other = strength[ny * w + nx];
                let earlier = (ny, nx) < (y, x);
                if other > s || (other == s && earlier) {
                    return false;
                }
            }
        }
        true
    }

    /// Compares the strengths with those of a simple implementation in f64.
    #[test]
    fn strengths_agree_with_a_naive_reference() {
        let sizes = [(1, 1), (1, 7), (8, 1), (2, 2), (3, 5), (9, 8), (17, 12), (24, 31)];
        for (case, (w, h)) in sizes.into_iter().cycle().take(48).enumerate() {
            let steps = if case % 2 == 0 { 255.0 } else { 65535.0 };
            let channels = if case % 3 == 0 { 3 } else { 1 };
            let value = |k: usize| {
                let v = 0.5 + 0.5 * ((k + case) as f64 * 12.9898 + (k * k % 97) as f64).sin();
                ((v * steps).round() / steps) as f32
            };
            let image =
                Image::from_data(w, h, channels, (0..w * h * channels).map(value).collect());
            let radius = case % 3;
            let strengths = min_eigenvalues(&Pyramid::new(&image, 1, 4).levels[0], radius);
            for (k, strength) in strengths.iter().enumerate() {
                let expected = naive_strength(&image.to_gray(), k % w, k / w, radius as i64);
                let error = (f64::from(*strength) - expected).abs();
                assert!(error < 1e-6 + 1e-5 * expected, "{w}×{h}, {k}: {strength} {expected}");
            }
        }
    }

    fn naive_strength(gray: &Image, x: usize, y: usize, radius: i64) -> f64 {
        let (w, h) = (gray.width() as i64, gray.height() as i64);
        let at = |x: i64, y: i64| {
            f64::from(gray.pixel(x.clamp(0, w - 1) as usize, y.clamp(0, h - 1) as usize)[0])
        };
        let mut tensor = [0.0; 3];
        for j in -2 * radius..=2 * radius {
            for i in -2 * radius..=2 * radius {
                let (px, py) = ((x as i64 + i).clamp(0, w - 1), (y as i64 + j).clamp(0, h - 1));
                let (mut gx, mut gy) = (0.0, 0.0);
                for (k, weight) in [(-1, 3.0), (0, 10.0), (1, 3.0)] {
                    gx += weight * (at(px + 1, py + k) - at(px - 1, py + k)) / 32.0;
                    gy += weight * (at(px + k, py + 1) - at(px + k, py - 1)) / 32.0;
                }
                let side = (2 * radius + 1) as f64;
                let along = |v: i64| (side - v.abs() as f64) / (side * side);
                let weight = along(i) * along(j);
                for (sum, v) in tensor.iter_mut().zip([gx * gx, gx * gy, gy * gy]) {
                    *sum += weight * v;
                }
            }
        }
        let [a, b, c] = tensor;
        0.5 * (a + c - ((a - c).powi(2) + 4.0 * b * b).sqrt())
    }
}
