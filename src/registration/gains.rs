//! How much brighter one camera records the same light than another: exposure and white balance.
//!
//! Features of each camera's frame are found in its nearest neighbours', the neighbours made about as
//! bright first; the ratios of their light, channel by channel, and one least-squares estimate over
//! all pairs give the gains. Cameras whose gains don't differ beyond the error stay as they are.
//!
//! Known limits: one gain a channel and camera for the whole recording (no automatic exposure, no
//! vignetting); a rig whose frames have nothing in common is taken as equal.

use super::{Frame, RegistrationOptions, flow};
use crate::capture::Capture;
use crate::raster::{Image, LUMINANCE, encoded_from_linear, linear_from_encoded};
use nalgebra::{DMatrix, DVector, Point2};
use serde::{Deserialize, Serialize};

/// Whether cameras' gains are told from the images.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum GainMethod {
    /// All cameras are taken to record alike.
    Equal,
    /// Estimated, and corrected where they differ.
    #[default]
    Estimated,
}

/// The light that each camera records, by channel, over what the reference records.
#[derive(Clone, Debug, PartialEq)]
pub struct Gains {
    factors: Vec<[f64; 3]>,
    /// The largest difference of any factor from 1, and its standard error, as shares.
    largest: (f64, f64),
}

/// Differences below this share of the light are none: moving things and shine make up to 0.019 between
/// equal cameras (`stlfr plan` on the project's films); it is 3 of 255 where it is brightest.
const LEAST_DIFFERENCE: f64 = 0.03;
/// Differences below this many of their standard errors are none.
const LEAST_ERRORS: f64 = 4.0;
/// Neighbours that each camera is compared with.
const NEIGHBORS: usize = 2;
/// Images are halved down to this width, pixels: enough features, in little time.
const WIDTH_PX: usize = 250;
/// Fewer features than this tell nothing.
const LEAST_FEATURES: usize = 12;
/// Half the side of the windows whose light is compared, pixels.
const RADIUS_PX: isize = 2;
/// Values outside may be clipped, or be mostly noise.
const USABLE: std::ops::RangeInclusive<f32> = 0.08..=0.96;

impl Gains {
    /// Of so many cameras that record alike.
    pub fn equal(cameras: usize) -> Self {
        Self { factors: vec![[1.0; 3]; cameras], largest: (0.0, 0.0) }
    }

    pub fn are_equal(&self) -> bool {
        self.factors.iter().all(|f| *f == [1.0; 3])
    }

    /// A camera's factors: red, green, blue; three times the same for a grey camera.
    pub fn of(&self, camera: usize) -> [f64; 3] {
        self.factors[camera]
    }

    /// The largest difference that was measured, equal or not, and its standard error; shares.
    pub fn largest_difference(&self) -> (f64, f64) {
        self.largest
    }

    /// The camera's image as the reference would have recorded it; `None` where it is the same.
    /// Values may leave 0..=1.
    pub fn corrected(&self, camera: usize, image: &Image) -> Option<Image> {
        let factors = self.factors[camera];
        (factors != [1.0; 3]).then(|| scaled(image, factors.map(|f| 1.0 / f)))
    }

    /// Told from one frame of each camera, in the middle of the recording. A frame that can't be read
    /// is not compared; whoever needs it says so.
    pub(super) fn survey(capture: &Capture, options: &RegistrationOptions) -> Self {
        let images: Vec<Option<Image>> = (0..capture.cameras.len())
            .map(|c| capture.read_frame(c, capture.cameras[c].frames.len() / 2).ok())
            .map(|image| image.as_ref().map(small))
            .collect();
        let level = |image: &Image| {
            let mut values = image.to_gray().data().to_vec();
            values.sort_by(f32::total_cmp);
            // Of a black image nothing is asked.
            linear_from_encoded(f64::from(values[values.len() / 2])).max(1e-4)
        };
        let reference = images[capture.reference].as_ref().map_or(1.0, level);
        let frames: Vec<Option<Frame>> = images
            .iter()
            .map(|image| {
                let image = image.as_ref()?;
                Some(Frame::new(scaled(image, [reference / level(image); 3]), options))
            })
            .collect();
        let mut ratios = Vec::new();
        for (a, b) in neighbors(capture) {
            let (Some(of_a), Some(of_b)) = (&frames[a], &frames[b]) else { continue };
            let starts: Vec<_> = of_a.corners(options).iter().map(|&p| (p, p)).collect();
            let matches: Vec<(Point2<f64>, Point2<f64>)> = flow(of_a, of_b, &starts, options)
                .into_iter()
                .flatten()
                .map(|m| (m.source, m.target))
                .collect();
            if let (Some(a_image), Some(b_image)) = (&images[a], &images[b]) {
                ratios.extend(Ratio::between([a, b], [a_image, b_image], &matches));
            }
        }
        let mut gains = solved(capture.cameras.len(), capture.reference, &ratios);
        // Along colour cameras of another white, a grey camera's channels differ; it has one.
        for (factors, image) in gains.factors.iter_mut().zip(&images) {
            let is_gray = image.as_ref().is_some_and(|i| i.channels() == 1);
            if is_gray && *factors != [1.0; 3] {
                let [r, g, b] = LUMINANCE;
                *factors = [r * factors[0] + g * factors[1] + b * factors[2]; 3];
            }
        }
        gains
    }
}

/// Each camera with its nearest neighbours, every pair once.
fn neighbors(capture: &Capture) -> Vec<(usize, usize)> {
    let centers: Vec<_> = capture.cameras.iter().map(|c| c.camera.center()).collect();
    let mut pairs = Vec::new();
    for a in 0..centers.len() {
        let mut others: Vec<usize> = (0..centers.len()).filter(|&b| b != a).collect();
        let distance = |b: usize| (centers[b] - centers[a]).norm();
        others.sort_by(|&b, &c| distance(b).total_cmp(&distance(c)).then(b.cmp(&c)));
        pairs.extend(others.into_iter().take(NEIGHBORS).map(|b| (a.min(b), a.max(b))));
    }
    pairs.sort_unstable();
    pairs.dedup();
    pairs
}

/// Halved until it is small.
fn small(image: &Image) -> Image {
    let mut image = image.clone();
    while image.width() > WIDTH_PX && image.height() > 1 {
        let (w, h, channels) = (image.width() / 2, image.height() / 2, image.channels());
        let value = |k: usize| {
            let (x, y, c) = (k / channels % w, k / channels / w, k % channels);
            let at = |dx, dy| image.pixel(2 * x + dx, 2 * y + dy)[c];
            0.25 * (at(0, 0) + at(1, 0) + at(0, 1) + at(1, 1))
        };
        image = Image::from_data(w, h, channels, (0..w * h * channels).map(value).collect());
    }
    image
}

/// Light multiplied by channel; a grey image's by the first.
fn scaled(image: &Image, factors: [f64; 3]) -> Image {
    let channels = image.channels();
    let value = |(k, v): (usize, &f32)| {
        encoded_from_linear(factors[k % channels] * linear_from_encoded(f64::from(*v))) as f32
    };
    let data = image.data().iter().enumerate().map(value).collect();
    Image::from_data(image.width(), image.height(), channels, data)
}

/// The mean light of a window, linear; `None` if it leaves the image, or may be clipped.
fn light(image: &Image, at: &Point2<f64>) -> Option<[f64; 3]> {
    let (cx, cy) = (at.x.floor() as isize, at.y.floor() as isize);
    let (w, h) = (image.width() as isize, image.height() as isize);
    let reaches = |c: isize, n: isize| c >= RADIUS_PX && c + RADIUS_PX < n;
    if !(reaches(cx, w) && reaches(cy, h)) {
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

/// How much more light camera `b` records than `a`, by channel: the logarithm, and its variance.
struct Ratio {
    cameras: [usize; 2],
    log: [f64; 3],
    variance: [f64; 3],
}

impl Ratio {
    /// The medians over matched features; `None` of too few.
    fn between(
        cameras: [usize; 2],
        images: [&Image; 2],
        matches: &[(Point2<f64>, Point2<f64>)],
    ) -> Option<Self> {
        let gray = images.iter().any(|i| i.channels() == 1);
        let luminance = |[r, g, b]: [f64; 3]| {
            let [x, y, z] = LUMINANCE;
            [x * r + y * g + z * b; 3]
        };
        let logs: Vec<[f64; 3]> = matches
            .iter()
            .filter_map(|(p, q)| {
                let both = [light(images[0], p)?, light(images[1], q)?];
                let [a, b] = if gray { both.map(luminance) } else { both };
                // Usable light is positive.
                Some([0, 1, 2].map(|c| (b[c] / a[c]).ln()))
            })
            .collect();
        if logs.len() < LEAST_FEATURES {
            return None;
        }
        let median = |mut values: Vec<f64>| {
            values.sort_by(f64::total_cmp);
            values[values.len() / 2]
        };
        let log = [0, 1, 2].map(|c| median(logs.iter().map(|l| l[c]).collect()));
        let variance = [0, 1, 2].map(|c| {
            let deviation = median(logs.iter().map(|l| (l[c] - log[c]).abs()).collect());
            // Of a median: that of a mean times π/2; a normal's deviation is 1.4826 times the median.
            let std_err = 1.2533 * 1.4826 * deviation / (logs.len() as f64).sqrt();
            std_err * std_err + LEAST_STD_ERR * LEAST_STD_ERR
        });
        Some(Self { cameras, log, variance })
    }
}

/// What two views of one surface differ by anyhow, as a share: no pair is trusted beyond this.
const LEAST_STD_ERR: f64 = 0.002;
/// What is known of a camera that was not compared with any: that it records about alike.
const PRIOR_STD_ERR: f64 = 10.0;

/// All cameras' gains at once.
fn solved(cameras: usize, reference: usize, ratios: &[Ratio]) -> Gains {
    let mut gains = Gains::equal(cameras);
    for c in 0..3 {
        let mut normal = DMatrix::from_diagonal_element(cameras, cameras, PRIOR_STD_ERR.powi(-2));
        let mut right = DVector::zeros(cameras);
        normal[(reference, reference)] += LEAST_STD_ERR.powi(-4);
        for ratio in ratios {
            let ([a, b], weight) = (ratio.cameras, 1.0 / ratio.variance[c]);
            normal[(a, a)] += weight;
            normal[(b, b)] += weight;
            normal[(a, b)] -= weight;
            normal[(b, a)] -= weight;
            right[a] -= weight * ratio.log[c];
            right[b] += weight * ratio.log[c];
        }
        // Positive definite by the prior.
        let Some(solver) = normal.cholesky() else { continue };
        let (logs, covariance) = (solver.solve(&right), solver.inverse());
        for (camera, factors) in gains.factors.iter_mut().enumerate() {
            let std_err = covariance[(camera, camera)].max(0.0).sqrt();
            let difference = logs[camera].exp() - 1.0;
            // An error as large as that says that nothing was compared.
            if camera == reference || !difference.is_finite() || std_err > 0.1 * PRIOR_STD_ERR {
                continue;
            }
            if difference.abs() > gains.largest.0 {
                gains.largest = (difference.abs(), std_err);
            }
            if difference.abs() > LEAST_DIFFERENCE.max(LEAST_ERRORS * std_err) {
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
    fn gains_are_told_along_a_chain_and_around_a_loop() {
        let logs = [0.3, -0.1, 0.0, 0.45];
        let between = |a: usize, b: usize| ratio([a, b], logs[b] - logs[a]);
        let gains = solved(4, 2, &[between(0, 1), between(1, 2), between(2, 3), between(0, 3)]);
        for (camera, log) in logs.iter().enumerate() {
            let [r, g, b] = gains.of(camera);
            assert!((r - log.exp()).abs() < 1e-4 && g == 1.0, "{camera}: {r} {g}");
            assert!((b - (0.5 * log).exp()).abs() < 1e-4, "{camera}: {b}");
        }
        assert!(!gains.are_equal());
    }

    #[test]
    fn small_differences_and_unknown_cameras_are_left_alone() {
        let gains = solved(4, 0, &[ratio([0, 1], 0.01)]);
        assert!(gains.are_equal());
        let (largest, std_err) = gains.largest_difference();
        assert!((largest - 0.01).abs() < 2e-3 && std_err < 0.01, "{largest} {std_err}");
        assert!(solved(1, 0, &[]).are_equal());
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
