//! Ratios of recorded light between images, and the gains of the images that fit these ratios by least squares.

use crate::raster::Image;
use nalgebra::{DMatrix, DVector};

/// Minimum difference that is corrected: of a camera's gain from 1, or between a camera's gains at two times. Between
/// cameras with equal gains, moving objects and specular surfaces cause measured differences of up to 0.019. A
/// difference of 0.03 changes the brightest 8-bit values by 3.
pub(super) const MIN_DIFFERENCE: f64 = 0.03;
/// Minimum difference of gains that is corrected, in units of the difference's standard error.
pub(super) const MIN_STD_ERRORS: f64 = 4.0;
/// Minimum number of samples for a ratio between two images.
pub(super) const MIN_SAMPLES: usize = 12;
/// Range of gamma-encoded pixel values (0 to 1) that are used: neither clipped nor dominated by noise.
pub(super) const USABLE: std::ops::RangeInclusive<f32> = 0.08..=0.96;
/// Lower bound of the standard error of a log ratio, since specular reflection differs between two views.
const MIN_STD_ERR: f64 = 0.002;
/// Standard deviation of the prior on an image's log gain, with mean 0. It makes the gains of images without
/// comparisons solvable.
const PRIOR_STD_ERR: f64 = 10.0;

/// Ratio of the linear light of image `images[1]` to that of image `images[0]`, on the same surfaces. Stored as the
/// ratio's natural logarithm and the variance of this logarithm, for each channel.
pub(super) struct Ratio {
    /// Indices of two different images.
    pub images: [usize; 2],
    pub log: [f64; 3],
    pub variance: [f64; 3],
}

impl Ratio {
    /// Returns the median of the log ratios of single surfaces, by channel. Returns `None` for fewer than
    /// [`MIN_SAMPLES`] log ratios.
    pub fn of_samples(images: [usize; 2], logs: &[[f64; 3]]) -> Option<Self> {
        if logs.len() < MIN_SAMPLES {
            return None;
        }
        let log = [0, 1, 2].map(|c| median(logs.iter().map(|l| l[c]).collect()));
        let variance = [0, 1, 2].map(|c| {
            let deviation = median(logs.iter().map(|l| (l[c] - log[c]).abs()).collect());
            // For a normal distribution, the standard deviation is 1.4826 times the median absolute
            // deviation, and the standard error of a median is √(π/2) times that of a mean.
            let std_err = 1.2533 * 1.4826 * deviation / (logs.len() as f64).sqrt();
            std_err * std_err + MIN_STD_ERR * MIN_STD_ERR
        });
        Some(Self { images, log, variance })
    }
}

/// The natural logarithm of an image's gain relative to the reference image, with its standard error.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct LogGain {
    pub log: f64,
    pub std_err: f64,
}

impl LogGain {
    /// Returns whether any two of these gains differ significantly.
    pub fn vary(gains: &[Self]) -> bool {
        let differ = |a: &Self, b: &Self| {
            let std_err = a.std_err.hypot(b.std_err);
            (a.log - b.log).abs().exp_m1() > MIN_DIFFERENCE.max(MIN_STD_ERRORS * std_err)
        };
        gains.iter().enumerate().any(|(k, a)| gains[..k].iter().any(|b| differ(a, b)))
    }
}

/// Solves for the gains of all images by weighted least squares. Returns three gains per image, one for each channel. A
/// gain is `None` if no chain of ratios connects the image to the reference image. The reference image has gain 1.
pub(super) fn solve_log_gains(
    images: usize,
    reference: usize,
    ratios: &[Ratio],
) -> Vec<[Option<LogGain>; 3]> {
    let mut gains = vec![[None; 3]; images];
    for c in 0..3 {
        let mut normal = DMatrix::from_diagonal_element(images, images, PRIOR_STD_ERR.powi(-2));
        let mut right = DVector::zeros(images);
        normal[(reference, reference)] += MIN_STD_ERR.powi(-4);
        for ratio in ratios {
            let ([a, b], weight) = (ratio.images, 1.0 / ratio.variance[c]);
            normal[(a, a)] += weight;
            normal[(b, b)] += weight;
            normal[(a, b)] -= weight;
            normal[(b, a)] -= weight;
            right[a] -= weight * ratio.log[c];
            right[b] += weight * ratio.log[c];
        }
        // The prior makes the matrix positive definite.
        let Some(solver) = normal.cholesky() else { continue };
        let (logs, covariance) = (solver.solve(&right), solver.inverse());
        for (image, gains) in gains.iter_mut().enumerate() {
            let std_err = covariance[(image, image)].max(0.0).sqrt();
            let gain = match image == reference {
                true => LogGain { log: 0.0, std_err: 0.0 },
                false => LogGain { log: logs[image], std_err },
            };
            // A standard error above a tenth of the prior's standard deviation means that the image is not compared
            // with the reference image.
            gains[c] =
                (gain.log.exp().is_finite() && gain.std_err <= 0.1 * PRIOR_STD_ERR).then_some(gain);
        }
    }
    gains
}

/// Returns the upper median. There must be at least one value.
pub(super) fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

/// Halves the width and height of an image until it is at most `width_px` wide.
pub(super) fn shrunk(mut image: Image, width_px: usize) -> Image {
    while image.width() > width_px && image.height() > 1 {
        image = halved(&image);
    }
    image
}

/// Halves the width and height of an image by averaging 2×2 pixels. An odd last row or column is dropped.
pub(crate) fn halved(image: &Image) -> Image {
    let (w, h, channels) = (image.width() / 2, image.height() / 2, image.channels());
    let value = |k: usize| {
        let (x, y, c) = (k / channels % w, k / channels / w, k % channels);
        let at = |dx, dy| image.pixel(2 * x + dx, 2 * y + dy)[c];
        0.25 * (at(0, 0) + at(1, 0) + at(0, 1) + at(1, 1))
    };
    Image::from_data(w, h, channels, (0..w * h * channels).map(value).collect())
}
