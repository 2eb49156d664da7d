//! Separable filters of one plane of samples. Border pixels are replicated.

use nalgebra::RealField;
use rayon::prelude::*;

/// Correlates a row-major plane with the kernel `horizontal` along the rows and the kernel `vertical` along the
/// columns. Both kernels have odd lengths. Border pixels are replicated. Callers use `f64` for `T` if they subtract
/// nearly equal results from each other, else `f32`.
pub(super) fn separable<T: RealField + Copy>(
    plane: &[T],
    width: usize,
    horizontal: &[T],
    vertical: &[T],
) -> Vec<T> {
    let mut rows = vec![T::zero(); plane.len()];
    let radius = horizontal.len() / 2;
    rows.par_chunks_mut(width).zip(plane.par_chunks(width)).for_each(|(out, row)| {
        let padded = padded(row, radius);
        for (k, weight) in horizontal.iter().enumerate() {
            for (out, v) in out.iter_mut().zip(&padded[k..]) {
                *out += *weight * *v;
            }
        }
    });
    let mut filtered = vec![T::zero(); plane.len()];
    let (radius, last) = ((vertical.len() / 2) as isize, (plane.len() / width) as isize - 1);
    filtered.par_chunks_mut(width).enumerate().for_each(|(y, out)| {
        for (k, weight) in vertical.iter().enumerate() {
            let from = (y as isize + k as isize - radius).clamp(0, last) as usize;
            for (out, v) in out.iter_mut().zip(&rows[from * width..]) {
                *out += *weight * *v;
            }
        }
    });
    filtered
}

fn padded<T: Copy>(row: &[T], radius: usize) -> Vec<T> {
    let mut padded = Vec::with_capacity(row.len() + 2 * radius);
    padded.resize(radius, row[0]);
    padded.extend_from_slice(row);
    padded.resize(row.len() + 2 * radius, row[row.len() - 1]);
    padded
}

/// Returns the Gaussian `exp(−x²/2σ²)` at the integers −radius..=radius, not normalized.
pub(super) fn gaussian(sigma_px: f64, radius: usize) -> Vec<f64> {
    let r = radius as isize;
    (-r..=r).map(|x| (-((x * x) as f64) / (2.0 * sigma_px * sigma_px)).exp()).collect()
}

/// Returns the kernel scaled so that its weights sum to 1.
pub(super) fn normalized(kernel: &[f64]) -> Vec<f64> {
    let sum: f64 = kernel.iter().sum();
    kernel.iter().map(|w| w / sum).collect()
}

/// Converts a kernel to single precision.
pub(super) fn single(kernel: &[f64]) -> Vec<f32> {
    kernel.iter().map(|w| *w as f32).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Filters a plane directly by the definition, for comparison.
    fn naive(plane: &[f32], width: usize, h: &[f32], v: &[f32]) -> Vec<f32> {
        let height = plane.len() / width;
        let at = |x: isize, y: isize| {
            let x = x.clamp(0, width as isize - 1) as usize;
            let y = y.clamp(0, height as isize - 1) as usize;
            plane[y * width + x]
        };
        let mut out = Vec::new();
        for y in 0..height as isize {
            for x in 0..width as isize {
                let mut sum = 0.0;
                for (j, b) in v.iter().enumerate() {
                    for (i, a) in h.iter().enumerate() {
                        let dx = i as isize - (h.len() / 2) as isize;
                        let dy = j as isize - (v.len() / 2) as isize;
                        sum += a * b * at(x + dx, y + dy);
                    }
                }
                out.push(sum);
            }
        }
        out
    }

    #[test]
    fn equals_the_definition_even_where_the_kernel_is_larger_than_the_image() {
        for (width, height) in [(9, 7), (1, 1), (3, 2)] {
            let plane: Vec<f32> =
                (0..width * height).map(|k| ((k * 37) % 11) as f32 / 11.0).collect();
            let (h, v) = ([0.1, -0.4, 0.2, 0.7, 0.3], [0.5, 0.2, 0.1, 0.1, 0.0, -0.3, 0.4]);
            let fast = separable(&plane, width, &h, &v);
            for (a, b) in fast.iter().zip(naive(&plane, width, &h, &v)) {
                assert!((a - b).abs() < 1e-5, "{width}×{height}: {a} {b}");
            }
        }
    }

    #[test]
    fn a_normalized_kernel_keeps_a_constant() {
        let kernel = single(&normalized(&gaussian(1.5, 5)));
        let out = separable(&[0.25; 60], 10, &kernel, &kernel);
        assert!(out.iter().all(|v| (v - 0.25).abs() < 1e-6));
    }
}
