//! Photometric calibration (beyond the paper): estimates the gain of each camera relative to the reference camera.
//! Gains differ because of exposure and white balance.
//!
//! Features of one frame of each camera are matched in the frames of the nearest cameras, after a rough correction
//! by median brightness. The ratios of the matched features' linear light determine all cameras' gains by weighted
//! least squares, separately for each channel. Gains that do not differ significantly from 1 are not corrected.
//!
//! Known limits: there is one gain per channel and camera for the whole recording (no automatic exposure, no
//! vignetting). Cameras whose frames have no features in common are assumed to have the same gains.

use super::{Frame, Match, RegistrationOptions, flow};
use crate::capture::Capture;
use crate::host::CacheKind;
use crate::raster::{Image, LUMINANCE, encoded_from_linear, linear_from_encoded};
use nalgebra::{DMatrix, DVector, Point2};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// The gains of a capture's cameras, by colour channel. A gain is the ratio of the linear light that a camera
/// records of a surface to the linear light that the reference camera records of the same surface.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Gains {
    /// The gains of red, green and blue of each camera. For a grey camera, the three gains are equal.
    pub factors: Vec<[f64; 3]>,
    /// The largest measured difference of a gain from 1, and the standard error of this gain. The difference may be
    /// insignificant. (0, 0) if no cameras were compared.
    pub largest: (f64, f64),
}

/// Minimum difference of a gain from 1 that is corrected. Between cameras with equal gains, moving objects and
/// specular surfaces cause measured differences of up to 0.019. A gain that differs by 0.03 changes the brightest
/// 8-bit values by 3.
const MIN_DIFFERENCE: f64 = 0.03;
/// Minimum difference of a gain from 1 that is corrected, in units of its standard error.
const MIN_STD_ERRORS: f64 = 4.0;
/// Number of nearest cameras with which each camera is compared.
const NEIGHBORS: usize = 2;
/// Maximum width of the compared images, in pixels. The size of a larger image is halved repeatedly.
const WIDTH_PX: usize = 250;
/// Minimum number of matched features for comparing two cameras.
const MIN_FEATURES: usize = 12;
/// Range of gains that are accepted when gains are read from disk.
const PLAUSIBLE: std::ops::RangeInclusive<f64> = 1e-6..=1e6;
/// Half-width of the windows whose mean linear light is compared, pixels.
const RADIUS_PX: isize = 2;
/// Range of gamma-encoded pixel values (0 to 1) that are compared. Lower values are dominated by noise, and higher
/// values may be clipped.
const USABLE: std::ops::RangeInclusive<f32> = 0.08..=0.96;

impl Gains {
    /// Kind of the disk-cache entries that hold gains.
    pub(crate) const KIND: CacheKind = CacheKind { name: "gains", version: 1 };

    /// Returns gains of 1 for this number of cameras.
    pub fn equal(cameras: usize) -> Self {
        Self { factors: vec![[1.0; 3]; cameras], largest: (0.0, 0.0) }
    }

    /// Returns whether gains that were read from a file are valid for this number of cameras.
    pub(crate) fn are_plausible(&self, cameras: usize) -> bool {
        let (difference, std_err) = self.largest;
        let are_measured = [difference, std_err].iter().all(|v| v.is_finite() && *v >= 0.0);
        let are_gains = self.factors.iter().flatten().all(|g| PLAUSIBLE.contains(g));
        are_measured && are_gains && self.factors.len() == cameras
    }

    /// Returns whether all gains are 1, so that no image is corrected.
    pub fn are_equal(&self) -> bool {
        self.factors.iter().all(|f| *f == [1.0; 3])
    }

    /// Converts a camera's image (gamma-encoded values) to the exposure of the reference camera. Returns `None` if
    /// the camera's gains are 1. Values of the result may be outside 0..=1.
    ///
    /// # Panics
    /// If there is no such camera.
    pub fn corrected(&self, camera: usize, image: &Image) -> Option<Image> {
        let factors = self.factors[camera];
        (factors != [1.0; 3]).then(|| scaled(image, factors.map(|f| 1.0 / f)))
    }

    /// Converts an image (gamma-encoded values) from the exposure of the reference camera to the exposure of
    /// `camera`. This is the inverse of [`Self::corrected`]. Returns `None` if the camera's gains are 1.
    ///
    /// # Panics
    /// If there is no such camera.
    pub fn as_filmed(&self, camera: usize, image: &Image) -> Option<Image> {
        let factors = self.factors[camera];
        (factors != [1.0; 3]).then(|| scaled(image, factors))
    }

    /// Estimates the gains from the middle frame of each camera's recording. A camera whose middle frame cannot be
    /// read is left out. The read error is reported later, when the frame is used.
    pub(super) fn estimate(capture: &Capture, options: &RegistrationOptions) -> Self {
        let count = capture.cameras.len();
        let small_image = |c: usize| {
            let middle = capture.cameras[c].frames.len() / 2;
            let mut image = capture.read_frame(c, middle).ok()?;
            while image.width() > WIDTH_PX && image.height() > 1 {
                image = halved(&image);
            }
            Some(image)
        };
        let images: Vec<Option<Image>> = (0..count).into_par_iter().map(small_image).collect();
        let level = |image: &Image| {
            let levels = image.to_gray().data().iter().map(|v| f64::from(*v)).collect();
            // The lower bound avoids a division by 0. Its value is arbitrary, since a black image has no
            // features to compare.
            linear_from_encoded(median(levels)).max(1e-4)
        };
        let reference = images[capture.reference].as_ref().map_or(1.0, level);
        let frame = |image: &Option<Image>| {
            let image = image.as_ref()?;
            Some(Frame::new(scaled(image, [reference / level(image); 3]), options))
        };
        let frames: Vec<Option<Frame>> = images.par_iter().map(frame).collect();
        let ratio = |cameras: [usize; 2]| {
            let [Some(from), Some(to)] = cameras.map(|c| frames[c].as_ref()) else { return None };
            let [Some(a), Some(b)] = cameras.map(|c| images[c].as_ref()) else { return None };
            let starts: Vec<_> = from.corners(options).iter().map(|&p| (p, p)).collect();
            Ratio::between(cameras, [a, b], &flow(from, to, &starts, options))
        };
        let ratios: Vec<Ratio> = neighbors(capture).into_iter().filter_map(ratio).collect();
        let mut gains = solve_gains(count, capture.reference, &ratios);
        // The comparison of a grey camera with colour cameras gives a different gain for each channel. The
        // luminance of the three gains replaces all of them.
        for (factors, image) in gains.factors.iter_mut().zip(&images) {
            let is_gray = image.as_ref().is_some_and(|i| i.channels() == 1);
            if is_gray && *factors != [1.0; 3] {
                *factors = luminance(*factors);
            }
        }
        gains
    }
}

/// Returns the upper median. There must be at least one value.
fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

/// Returns the luminance of linear light, repeated for all three channels.
fn luminance([r, g, b]: [f64; 3]) -> [f64; 3] {
    let [x, y, z] = LUMINANCE;
    [x * r + y * g + z * b; 3]
}

/// Returns the pairs of each camera with its [`NEIGHBORS`] nearest cameras, as camera indices. Every pair occurs
/// once.
fn neighbors(capture: &Capture) -> Vec<[usize; 2]> {
    let centers: Vec<_> = capture.cameras.iter().map(|c| c.camera.center()).collect();
    let mut pairs = Vec::new();
    for a in 0..centers.len() {
        let mut others: Vec<usize> = (0..centers.len()).filter(|&b| b != a).collect();
        let distance = |b: usize| (centers[b] - centers[a]).norm();
        others.sort_by(|&b, &c| distance(b).total_cmp(&distance(c)).then(b.cmp(&c)));
        pairs.extend(others.into_iter().take(NEIGHBORS).map(|b| [a.min(b), a.max(b)]));
    }
    pairs.sort_unstable();
    pairs.dedup();
    pairs
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

/// Multiplies the linear light of a gamma-encoded image by one factor per channel. For a grey image, the first
/// factor is used.
fn scaled(image: &Image, factors: [f64; 3]) -> Image {
    let channels = image.channels();
    let value = |(k, v): (usize, &f32)| {
        encoded_from_linear(factors[k % channels] * linear_from_encoded(f64::from(*v))) as f32
    };
    let data = image.data().iter().enumerate().map(value).collect();
    Image::from_data(image.width(), image.height(), channels, data)
}

/// Returns the mean linear light, by channel, of the window around a point in pixels. Returns `None` if the window
/// leaves the image or has a value outside [`USABLE`].
fn light(image: &Image, at: &Point2<f64>) -> Option<[f64; 3]> {
    let (cx, cy) = (at.x.floor() as isize, at.y.floor() as isize);
    let (w, h) = (image.width() as isize, image.height() as isize);
    let fits = |c: isize, n: isize| c >= RADIUS_PX && c + RADIUS_PX < n;
    if !(fits(cx, w) && fits(cy, h)) {
        return None;
    }
    let mut sums = [0.0; 3];
    for y in cy - RADIUS_PX..=cy + RADIUS_PX {
        for x in cx - RADIUS_PX..=cx + RADIUS_PX {
            let pixel = image.pixel(x as usize, y as usize);
            if pixel.iter().any(|v| !USABLE.contains(v)) {
                return None;
            }
            for (c, sum) in sums.iter_mut().enumerate() {
                *sum += linear_from_encoded(f64::from(pixel[c % pixel.len()]));
            }
        }
    }
    let area = ((2 * RADIUS_PX + 1) * (2 * RADIUS_PX + 1)) as f64;
    Some(sums.map(|sum| sum / area))
}

/// Ratio of the linear light that camera `cameras[1]` records to the linear light that camera `cameras[0]` records
/// of the same surfaces. `log` holds the natural logarithm of the ratio for each channel, and `variance` the
/// variance of this logarithm.
struct Ratio {
    cameras: [usize; 2],
    log: [f64; 3],
    variance: [f64; 3],
}

impl Ratio {
    /// Returns the median ratio over matched features. `matches` are from pixels of `images[0]` to pixels of
    /// `images[1]`. Returns `None` if fewer than [`MIN_FEATURES`] features are usable.
    fn between(
        cameras: [usize; 2],
        images: [&Image; 2],
        matches: &[Option<Match>],
    ) -> Option<Self> {
        let is_gray = images.iter().any(|i| i.channels() == 1);
        let log = |m: &Match| {
            let both = [light(images[0], &m.source)?, light(images[1], &m.target)?];
            let [a, b] = if is_gray { both.map(luminance) } else { both };
            // The light is positive, since it is in the usable range.
            Some([0, 1, 2].map(|c| (b[c] / a[c]).ln()))
        };
        let logs: Vec<[f64; 3]> = matches.iter().flatten().filter_map(log).collect();
        if logs.len() < MIN_FEATURES {
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
        Some(Self { cameras, log, variance })
    }
}

/// Lower bound of the standard error of a log ratio. It accounts for specular reflection, which differs between two
/// views.
const MIN_STD_ERR: f64 = 0.002;
/// Standard deviation of the prior on a camera's log gain. The mean of the prior is 0. The prior makes the
/// equations solvable for cameras without comparisons.
const PRIOR_STD_ERR: f64 = 10.0;

/// Solves for the gains of all cameras by weighted least squares. The gains of the reference camera are 1.
fn solve_gains(cameras: usize, reference: usize, ratios: &[Ratio]) -> Gains {
    let mut gains = Gains::equal(cameras);
    for c in 0..3 {
        let mut normal = DMatrix::from_diagonal_element(cameras, cameras, PRIOR_STD_ERR.powi(-2));
        let mut right = DVector::zeros(cameras);
        normal[(reference, reference)] += MIN_STD_ERR.powi(-4);
        for ratio in ratios {
            let ([a, b], weight) = (ratio.cameras, 1.0 / ratio.variance[c]);
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
        for (camera, factors) in gains.factors.iter_mut().enumerate() {
            let std_err = covariance[(camera, camera)].max(0.0).sqrt();
            let difference = logs[camera].exp() - 1.0;
            // A standard error above a tenth of the prior's standard deviation means that the camera was not
            // compared with any other camera.
            if camera == reference || !difference.is_finite() || std_err > 0.1 * PRIOR_STD_ERR {
                continue;
            }
            if difference.abs() > gains.largest.0 {
                gains.largest = (difference.abs(), std_err);
            }
            if difference.abs() > MIN_DIFFERENCE.max(MIN_STD_ERRORS * std_err) {
                factors[c] = 1.0 + difference;
            }
        }
    }
    gains
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ratio(cameras: [usize; 2], log: f64) -> Ratio {
        Ratio { cameras, log: [log, 0.0, 0.5 * log], variance: [1e-5; 3] }
    }

    #[test]
    fn gains_are_recovered_along_a_chain_and_around_a_loop() {
        let logs = [0.3, -0.1, 0.0, 0.45];
        let between = |a: usize, b: usize| ratio([a, b], logs[b] - logs[a]);
        let gains =
            solve_gains(4, 2, &[between(0, 1), between(1, 2), between(2, 3), between(0, 3)]);
        for (camera, log) in logs.iter().enumerate() {
            let [r, g, b] = gains.factors[camera];
            assert!((r - log.exp()).abs() < 1e-4 && g == 1.0, "{camera}: {r} {g}");
            assert!((b - (0.5 * log).exp()).abs() < 1e-4, "{camera}: {b}");
        }
        assert!(!gains.are_equal());
    }

    #[test]
    fn small_differences_and_unknown_cameras_are_not_corrected() {
        let gains = solve_gains(4, 0, &[ratio([0, 1], 0.01)]);
        assert!(gains.are_equal());
        let (largest, std_err) = gains.largest;
        assert!((largest - 0.01).abs() < 2e-3 && std_err < 0.01, "{largest} {std_err}");
        assert!(solve_gains(1, 0, &[]).are_equal());
    }

    #[test]
    fn corrected_light_is_the_reference_s() {
        let image = Image::from_data(2, 1, 3, vec![0.1, 0.5, 0.9, 0.3, 0.0, 0.7]);
        let brighter = scaled(&image, [1.5, 1.0, 0.7]);
        let mut gains = Gains::equal(2);
        assert_eq!(gains.corrected(1, &image), None);
        gains.factors[1] = [1.5, 1.0, 0.7];
        let back = gains.corrected(1, &brighter).expect("it differs");
        for (a, b) in back.data().iter().zip(image.data()) {
            assert!((a - b).abs() < 1e-6, "{a} {b}");
        }
    }
}
