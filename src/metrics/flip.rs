//! LDR-FLIP: Andersson, Nilsson, Akenine-Möller, Oskarsson, Åström, Fairchild, "FLIP: a difference evaluator for
//! alternating images", Proc. ACM Comput. Graph. Interact. Tech. 3(2), 2020. FLIP predicts how different two images
//! look to a viewer who flips between them: 0 for equal images, at most 1.
//!
//! Implemented here, because the crate `nv-flip` (0.1) compiles NVIDIA's C++, takes 8 bits only, and filters the
//! ground-truth image again for every comparison. A test compares this code with the output of NVIDIA's
//! `flip-evaluator`.

use super::filter::{gaussian, normalized, separable, single};
use crate::raster::{Image, linear_from_encoded};
use rayon::prelude::*;

/// Default number of pixels per degree of visual angle, chosen by FLIP's authors: a 0.7 m wide 4K monitor seen from 0.7
/// m.
pub const DEFAULT_PIXELS_PER_DEGREE: f64 = 67.020_643_276_582_25;

/// Exponent of the colour difference (q_c in the FLIP paper).
const COLOR_EXPONENT: f32 = 0.7;
/// Exponent of the feature difference (q_f in the FLIP paper).
const FEATURE_EXPONENT: f32 = 0.5;
/// Colour difference, as a fraction of the largest possible difference, up to which differences are mapped linearly to
/// 0..[`PIVOT_VALUE`] (p_c in the FLIP paper).
const PIVOT: f32 = 0.4;
/// Value to which a colour difference of [`PIVOT`] times the largest possible difference is mapped (p_t in the FLIP
/// paper).
const PIVOT_VALUE: f32 = 0.95;
/// Peak-to-trough width of the edge detector (w in the FLIP paper), degrees of visual angle.
const FEATURE_WIDTH_DEG: f64 = 0.082;
/// Contrast sensitivity functions of the achromatic, red-green and blue-yellow channels. Each is the Fourier transform
/// of a sum of Gaussians `a √(π/b) exp(−π²x²/b)`, with x in degrees of visual angle. The pairs are (a, b).
const CSF: [&[(f64, f64)]; 3] =
    [&[(1.0, 0.0047)], &[(1.0, 0.0053)], &[(34.1, CSF_LARGEST_SPREAD), (13.5, 0.025)]];
const CSF_LARGEST_SPREAD: f64 = 0.04;

/// Matrix from linear RGB to CIE XYZ with white point D65.
const XYZ_FROM_RGB: [[f64; 3]; 3] = [
    [10135552.0 / 24577794.0, 8788810.0 / 24577794.0, 4435075.0 / 24577794.0],
    [2613072.0 / 12288897.0, 8788810.0 / 12288897.0, 887015.0 / 12288897.0],
    [1425312.0 / 73733382.0, 8788810.0 / 73733382.0, 70074185.0 / 73733382.0],
];
/// Matrix from CIE XYZ to linear RGB, the inverse of [`XYZ_FROM_RGB`].
const RGB_FROM_XYZ: [[f64; 3]; 3] = [
    [3.241003275, -1.537398934, -0.498615861],
    [-0.969224334, 1.875930071, 0.041554224],
    [0.055639423, -0.204011202, 1.057148933],
];
/// White point D65 in CIE XYZ.
const WHITE: [f32; 3] = [0.950_428_5, 1.0, 1.088_900_4];

/// An image with FLIP's filters applied, ready to be compared with several other images.
pub struct FlipImage {
    /// Hunt-adjusted L*a*b* colour of every pixel, after the contrast sensitivity filter.
    color: Vec<[f32; 3]>,
    /// Magnitude of FLIP's edge detector at every pixel, row-major.
    edges: Vec<f32>,
    /// Magnitude of FLIP's point detector at every pixel, row-major.
    points: Vec<f32>,
}

impl FlipImage {
    /// Filters an image of display-encoded (sRGB) values. A grey image is treated as RGB with equal channels.
    pub fn new(image: &Image, pixels_per_degree: f64) -> Self {
        let rgb = image.to_rgb();
        let opponent: Vec<[f32; 3]> = rgb
            .data()
            .par_chunks(3)
            .map(|p| ycxcz([p[0], p[1], p[2]].map(linear_from_encoded)))
            .collect();
        let luminance: Vec<f32> = opponent.iter().map(|p| (p[0] + 16.0) / 116.0).collect();
        let (edges, points) = features(&luminance, image.width(), pixels_per_degree);
        let [y, cx, cz] = [0, 1, 2].map(|c| {
            let plane: Vec<f32> = opponent.iter().map(|p| p[c]).collect();
            sensitivity(&plane, image.width(), CSF[c], pixels_per_degree)
        });
        let color = (0..y.len())
            .into_par_iter()
            .map(|k| hunt_lab(rgb_of_ycxcz([y[k], cx[k], cz[k]]).map(|v| v.clamp(0.0, 1.0))))
            .collect();
        Self { color, edges, points }
    }
}

/// Returns FLIP's difference of two images at every pixel, row-major, in 0..=1.
///
/// # Panics
/// If the images differ in size.
pub fn flip_map(reference: &FlipImage, test: &FlipImage) -> Vec<f32> {
    assert_eq!(reference.color.len(), test.color.len(), "images of one size");
    let most = hyab(hunt_lab([0.0, 1.0, 0.0]), hunt_lab([0.0, 0.0, 1.0])).powf(COLOR_EXPONENT);
    (0..reference.color.len())
        .into_par_iter()
        .map(|k| {
            let color =
                redistributed(hyab(reference.color[k], test.color[k]).powf(COLOR_EXPONENT), most);
            let edges = (reference.edges[k] - test.edges[k]).abs();
            let points = (reference.points[k] - test.points[k]).abs();
            let feature =
                (edges.max(points) * std::f32::consts::FRAC_1_SQRT_2).powf(FEATURE_EXPONENT);
            color.powf(1.0 - feature)
        })
        .collect()
}

/// Filters a channel by its contrast sensitivity function. `csf` is the function's element of [`CSF`]. The filter
/// kernel has the sum 1. `ppd` is the number of pixels per degree of visual angle.
fn sensitivity(plane: &[f32], width: usize, csf: &[(f64, f64)], ppd: f64) -> Vec<f32> {
    use std::f64::consts::PI;
    let radius = (3.0 * (CSF_LARGEST_SPREAD / (2.0 * PI * PI)).sqrt() * ppd).ceil() as usize;
    // exp(−π²x²/b) with x in degrees is a Gaussian of σ² = b/2π².
    let kernels: Vec<Vec<f64>> =
        csf.iter().map(|(_, b)| gaussian((b / (2.0 * PI * PI)).sqrt() * ppd, radius)).collect();
    let mass: Vec<f64> = csf
        .iter()
        .zip(&kernels)
        .map(|((a, b), kernel)| a * (PI / b).sqrt() * kernel.iter().sum::<f64>().powi(2))
        .collect();
    let total: f64 = mass.iter().sum();
    let mut filtered = vec![0.0; plane.len()];
    for (kernel, mass) in kernels.iter().zip(&mass) {
        let kernel = single(&normalized(kernel));
        let share = (mass / total) as f32;
        for (sum, v) in filtered.iter_mut().zip(separable(plane, width, &kernel, &kernel)) {
            *sum += share * v;
        }
    }
    filtered
}

/// Returns the magnitudes of edges and of points at every pixel: the norms of the first and of the second derivatives
/// along both axes. `ppd` is the number of pixels per degree of visual angle.
fn features(luminance: &[f32], width: usize, ppd: f64) -> (Vec<f32>, Vec<f32>) {
    let sigma = 0.5 * FEATURE_WIDTH_DEG * ppd;
    let radius = (3.0 * sigma).ceil() as usize;
    let g = gaussian(sigma, radius);
    let x = |k: usize| k as f64 - radius as f64;
    let edge: Vec<f64> = g.iter().enumerate().map(|(k, g)| -x(k) * g).collect();
    let point: Vec<f64> =
        g.iter().enumerate().map(|(k, g)| (x(k) * x(k) / (sigma * sigma) - 1.0) * g).collect();
    let smooth = single(&normalized(&g));
    let norm = |kernel: &[f64]| -> Vec<f32> {
        let kernel = single(&balanced(kernel));
        let along_x = separable(luminance, width, &kernel, &smooth);
        let along_y = separable(luminance, width, &smooth, &kernel);
        along_x.iter().zip(&along_y).map(|(x, y)| x.hypot(*y)).collect()
    };
    (norm(&edge), norm(&point))
}

/// Scales the positive weights of a kernel to the sum 1, and the negative weights to the sum −1.
fn balanced(kernel: &[f64]) -> Vec<f64> {
    let positive: f64 = kernel.iter().filter(|w| **w > 0.0).sum();
    let negative: f64 = -kernel.iter().filter(|w| **w < 0.0).sum::<f64>();
    kernel.iter().map(|w| w / if *w < 0.0 { negative } else { positive }).collect()
}

/// Returns the HyAB distance of two L*a*b* colours: city-block in lightness, Euclidean in chroma.
fn hyab(a: [f32; 3], b: [f32; 3]) -> f32 {
    (a[0] - b[0]).abs() + (a[1] - b[1]).hypot(a[2] - b[2])
}

/// Maps a colour difference to 0..=1 by a piecewise linear function. `most` is the largest possible difference between
/// two colours.
fn redistributed(difference: f32, most: f32) -> f32 {
    let pivot = PIVOT * most;
    if difference < pivot {
        PIVOT_VALUE / pivot * difference
    } else {
        PIVOT_VALUE + (difference - pivot) / (most - pivot) * (1.0 - PIVOT_VALUE)
    }
}

fn transformed(matrix: &[[f64; 3]; 3], v: [f32; 3]) -> [f32; 3] {
    matrix.map(|row| row[0] as f32 * v[0] + row[1] as f32 * v[1] + row[2] as f32 * v[2])
}

/// Converts linear RGB to CIE XYZ divided by the white point.
fn relative_xyz(rgb: [f32; 3]) -> [f32; 3] {
    let xyz = transformed(&XYZ_FROM_RGB, rgb);
    [xyz[0] / WHITE[0], xyz[1] / WHITE[1], xyz[2] / WHITE[2]]
}

/// Converts linear RGB to the opponent colour space YCxCz.
fn ycxcz(rgb: [f32; 3]) -> [f32; 3] {
    let [x, y, z] = relative_xyz(rgb);
    [116.0 * y - 16.0, 500.0 * (x - y), 200.0 * (y - z)]
}

fn rgb_of_ycxcz(c: [f32; 3]) -> [f32; 3] {
    let y = (c[0] + 16.0) / 116.0;
    let (x, z) = (y + c[1] / 500.0, y - c[2] / 200.0);
    transformed(&RGB_FROM_XYZ, [x * WHITE[0], y * WHITE[1], z * WHITE[2]])
}

/// Converts linear RGB to L*a*b* with Hunt's adjustment: a* and b* are scaled by lightness.
fn hunt_lab(rgb: [f32; 3]) -> [f32; 3] {
    const DELTA: f32 = 6.0 / 29.0;
    let f = |t: f32| {
        if t > DELTA * DELTA * DELTA { t.cbrt() } else { t / (3.0 * DELTA * DELTA) + 4.0 / 29.0 }
    };
    let [x, y, z] = relative_xyz(rgb).map(f);
    let lightness = 116.0 * y - 16.0;
    let adjust = 0.01 * lightness;
    [lightness, adjust * 500.0 * (x - y), adjust * 200.0 * (y - z)]
}

#[cfg(test)]
mod tests {
    use super::*;

    fn map(a: &Image, b: &Image) -> Vec<f32> {
        let ppd = DEFAULT_PIXELS_PER_DEGREE;
        flip_map(&FlipImage::new(a, ppd), &FlipImage::new(b, ppd))
    }

    #[test]
    fn identical_images_have_zero_everywhere() {
        let data = (0..12 * 9 * 3).map(|k| ((k * 31) % 17) as f32 / 16.0).collect();
        let image = Image::from_data(12, 9, 3, data);
        assert!(map(&image, &image).iter().all(|&v| v == 0.0));
    }

    #[test]
    fn green_against_blue_is_the_most() {
        let constant = |rgb: [f32; 3]| Image::from_data(4, 4, 3, rgb.repeat(16));
        let worst = map(&constant([0.0, 1.0, 0.0]), &constant([0.0, 0.0, 1.0]));
        assert!(worst.iter().all(|v| (v - 1.0).abs() < 1e-4), "{}", worst[0]);
    }

    #[test]
    fn black_against_white_is_the_lightness_alone() {
        // The HyAB distance of black and white is 100. The largest distance is between green and blue. Both are raised
        // to the power 0.7.
        let most = hyab(hunt_lab([0.0, 1.0, 0.0]), hunt_lab([0.0, 0.0, 1.0])).powf(0.7);
        let expected = redistributed(100f32.powf(0.7), most);
        let values = map(&Image::filled(4, 4, 1, 0.0), &Image::filled(4, 4, 1, 1.0));
        assert!(values.iter().all(|v| (v - expected).abs() < 1e-4), "{} {expected}", values[0]);
    }

    #[derive(serde::Deserialize)]
    struct Golden {
        width: usize,
        height: usize,
        pixels_per_degree: f64,
        cases: Vec<Case>,
    }

    #[derive(serde::Deserialize)]
    struct Case {
        name: String,
        reference: Vec<u8>,
        test: Vec<u8>,
        mean: f64,
        map: Vec<f32>,
    }

    /// `tests/golden/flip_reference.json` is the output of NVIDIA's `flip-evaluator`, written by
    /// `make_flip_reference.py` in the same folder. The tolerances are 2e-4 for a pixel and 2e-5 for the mean. They
    /// cover rounding to 5 decimals and single precision, and are 50 times below a visible step.
    #[test]
    fn equals_nvidias_evaluator() {
        let text = include_str!("../../tests/golden/flip_reference.json");
        let golden: Golden = serde_json::from_str(text).unwrap();
        let image = |raw: &[u8]| {
            let data = raw.iter().map(|v| f32::from(*v) / 255.0).collect();
            Image::from_data(golden.width, golden.height, 3, data)
        };
        assert!(golden.cases.len() >= 4);
        for case in &golden.cases {
            let ppd = golden.pixels_per_degree;
            let ours = flip_map(
                &FlipImage::new(&image(&case.reference), ppd),
                &FlipImage::new(&image(&case.test), ppd),
            );
            let worst = ours.iter().zip(&case.map).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
            let mean = ours.iter().map(|v| f64::from(*v)).sum::<f64>() / ours.len() as f64;
            assert_eq!(ours.len(), case.map.len());
            assert!(worst < 2e-4, "{}: a pixel differs by {worst}", case.name);
            assert!((mean - case.mean).abs() < 2e-5, "{}: {mean} {}", case.name, case.mean);
        }
    }
}
