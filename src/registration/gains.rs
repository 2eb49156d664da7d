//! Photometric calibration (beyond the paper): the gain of each camera relative to the reference camera, due
//! to exposure and white balance.
//!
//! Features of each camera's frame are matched in the frames of its nearest neighbours, after a rough
//! correction by median brightness. The ratios of their linear light, channel by channel, are solved for all
//! cameras' gains by weighted least squares. Cameras whose gains do not differ significantly from 1 are not
//! corrected.
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

/// The gains of a capture's cameras, by channel: the ratio of the linear light that a camera records to the
/// linear light that the reference camera records of the same surface.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Gains {
    /// For each camera the gains of red, green and blue; three equal ones for a grey camera.
    pub factors: Vec<[f64; 3]>,
    /// The largest measured difference of a gain from 1, significant or not, and its standard error; (0, 0)
    /// if no cameras were compared.
    pub largest: (f64, f64),
}

/// Minimum difference of a gain from 1 that is corrected. Between cameras with equal gains, moving objects
/// and specular surfaces cause measured differences of up to 0.019. A difference of 0.03 changes the
/// brightest 8-bit values by 3.
const MIN_DIFFERENCE: f64 = 0.03;
/// Minimum difference of a gain from 1 that is corrected, in units of its standard error.
const MIN_STD_ERRORS: f64 = 4.0;
/// Number of nearest cameras that each camera is compared with.
const NEIGHBORS: usize = 2;
/// Maximum width of the compared images, pixels; larger images are halved repeatedly.
const WIDTH_PX: usize = 250;
/// Minimum number of matched features for comparing two cameras.
const MIN_FEATURES: usize = 12;
/// Range of gains that are accepted when they are read from disk.
const PLAUSIBLE: std::ops::RangeInclusive<f64> = 1e-6..=1e6;
/// Half-width of the windows whose mean linear light is compared, pixels.
const RADIUS_PX: isize = 2;
/// Range of encoded values (0..=1) that are used: neither clipped nor dominated by noise.
const USABLE: std::ops::RangeInclusive<f32> = 0.08..=0.96;

impl Gains {
    /// The kind of the gains' entries in the disk cache.
    pub(crate) const KIND: CacheKind = CacheKind { name: "gains", version: 1 };

    /// Gains of 1 for this many cameras.
    pub fn equal(cameras: usize) -> Self {
        Self { factors: vec![[1.0; 3]; cameras], largest: (0.0, 0.0) }
    }

    /// Whether gains that were read from a file are valid for this many cameras.
    pub(crate) fn are_plausible(&self, cameras: usize) -> bool {
        let (difference, std_err) = self.largest;
        let are_measured = [difference, std_err].iter().all(|v| v.is_finite() && *v >= 0.0);
        let are_gains = self.factors.iter().flatten().all(|g| PLAUSIBLE.contains(g));
        are_measured && are_gains && self.factors.len() == cameras
    }

    /// Whether all gains are 1, so that nothing is corrected.
    pub fn are_equal(&self) -> bool {
        self.factors.iter().all(|f| *f == [1.0; 3])
    }

    /// A camera's image (encoded values), gain-corrected to the reference camera's exposure; `None` if the
    /// camera's gains are 1. Values may leave 0..=1.
    ///
    /// # Panics
    /// If there is no such camera.
    pub fn corrected(&self, camera: usize, image: &Image) -> Option<Image> {
        let factors = self.factors[camera];
        (factors != [1.0; 3]).then(|| scaled(image, factors.map(|f| 1.0 / f)))
    }

    /// The inverse of [`Self::corrected`]: converts an image (encoded values) with the reference camera's
    /// exposure to the exposure of `camera`; `None` if the camera's gains are 1.
    ///
    /// # Panics
    /// If there is no such camera.
    pub fn as_filmed(&self, camera: usize, image: &Image) -> Option<Image> {
        let factors = self.factors[camera];
        (factors != [1.0; 3]).then(|| scaled(image, factors))
    }

    /// Estimates the gains from one frame of each camera, in the middle of its recording. A camera whose
    /// frame cannot be read is left out; the error is reported when the frame is used.
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
            // The bound is arbitrary: a black image has no features to compare.
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
        // Next to colour cameras, the solution of a grey camera differs by channel. It gets the same gain for
        // all.
        for (factors, image) in gains.factors.iter_mut().zip(&images) {
            let is_gray = image.as_ref().is_some_and(|i| i.channels() == 1);
            if is_gray && *factors != [1.0; 3] {
                *factors = luminance(*factors);
            }
        }
        gains
    }
}

/// The upper median; there is at least one value.
fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

/// The luminance of linear light, as three equal channels.
fn luminance([r, g, b]: [f64; 3]) -> [f64; 3] {
    let [x, y, z] = LUMINANCE;
    [x * r + y * g + z * b; 3]
}

/// The pairs of each camera with its nearest neighbours; every pair occurs once.
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

/// The image at half its width and height, by means of 2×2 pixels; an odd last row or column is dropped.
pub(crate) fn halved(image: &Image) -> Image {
    let (w, h, channels) = (image.width() / 2, image.height() / 2, image.channels());
    let value = |k: usize| {
        let (x, y, c) = (k / channels % w, k / channels / w, k % channels);
        let at = |dx, dy| image.pixel(2 * x + dx, 2 * y + dy)[c];
        0.25 * (at(0, 0) + at(1, 0) + at(0, 1) + at(1, 1))
    };
    Image::from_data(w, h, channels, (0..w * h * channels).map(value).collect())
}

/// The image with its linear light multiplied by a factor per channel; for a grey image, by the first factor.
fn scaled(image: &Image, factors: [f64; 3]) -> Image {
    let channels = image.channels();
    let value = |(k, v): (usize, &f32)| {
        encoded_from_linear(factors[k % channels] * linear_from_encoded(f64::from(*v))) as f32
    };
    let data = image.data().iter().enumerate().map(value).collect();
    Image::from_data(image.width(), image.height(), channels, data)
}

/// The mean linear light, by channel, of the window around a point in pixels. `None` if the window leaves the
/// image or has a value outside [`USABLE`].
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

/// Ratio of the linear light that `cameras[1]` records to the linear light that `cameras[0]` records of the
/// same surfaces. For each channel the ratio's logarithm and the variance of the logarithm.
struct Ratio {
    cameras: [usize; 2],
    log: [f64; 3],
    variance: [f64; 3],
}

impl Ratio {
    /// The median ratio over matched features, pixels of the images; `None` for fewer than [`MIN_FEATURES`].
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

/// Lower bound of the standard error of a log ratio, since specular reflection differs between two views.
const MIN_STD_ERR: f64 = 0.002;
/// Standard deviation of the prior on a camera's log gain, with mean 0. It makes the gains of cameras without
/// comparisons solvable.
const PRIOR_STD_ERR: f64 = 10.0;

/// The weighted least-squares solution for all cameras' gains. The reference camera's are 1.
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
            // A standard error close to the prior's means that the camera was not compared with any other.
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
