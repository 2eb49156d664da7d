//! Photometric calibration (beyond the paper): estimates the gain of each camera relative to the reference camera.
//! Gains differ because of exposure and white balance, and may change over the recording ([`GainCurve`]).
//!
//! Features of one frame of each camera are matched in the frames of the nearest cameras, after a rough correction
//! by median brightness. The ratios of the matched features' linear light determine all cameras' gains by weighted
//! least squares, separately for each channel. Gains that do not differ significantly from 1 are not corrected.
//!
//! Known limits: there is one gain for the whole image (no vignetting). Cameras whose frames have no features in common
//! are assumed to have the same gains. Hardly any features are matched between cameras that stand around the scene;
//! the light field compares these by scene flow.

use super::gain_changes::{MAX_KNOTS, gain_curves};
use super::gain_curve::{GainCurve, GainKnot};
use super::gain_ratios::{
    LogGain, MIN_DIFFERENCE, MIN_STD_ERRORS, Ratio, USABLE, median, shrunk, solve_log_gains,
};
use super::{Frame, Match, RegistrationOptions, flow};
use crate::capture::Capture;
use crate::host::CacheKind;
use crate::raster::{Image, LUMINANCE, encoded_from_linear, linear_from_encoded};
use nalgebra::Point2;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// The gains of a capture's cameras, by colour channel. A gain is the ratio of the linear light that a camera
/// records of a surface to the linear light that the reference camera records of the same surface in its middle frame.
/// The exposure of that frame is the common exposure.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Gains {
    /// The gains of red, green and blue of each camera in its middle frame. For a grey camera, the three gains are
    /// equal.
    pub factors: Vec<[f64; 3]>,
    /// The change of each camera's gains over its recording.
    pub curves: Vec<GainCurve>,
    /// The largest measured difference of a gain from 1, and the standard error of this gain. The difference may be
    /// insignificant. (0, 0) if no cameras were compared.
    pub largest: (f64, f64),
}

/// Comparison of the light that two cameras record of the same surfaces.
pub(crate) struct GainSamples {
    /// Indices of two different cameras.
    pub cameras: [usize; 2],
    /// For each surface, the natural logarithm of the ratio of the second camera's linear light to the first's, by
    /// channel.
    pub log_ratios: Vec<[f64; 3]>,
}

/// Number of nearest cameras with which each camera is compared.
const NEIGHBORS: usize = 2;
/// Maximum width of the images whose features are compared, in pixels. The size of a larger image is halved repeatedly.
const WIDTH_PX: usize = 250;
/// Range of gains that are accepted when gains are read from disk. Stored gains outside of this range are estimated
/// again.
const PLAUSIBLE: std::ops::RangeInclusive<f64> = 1e-6..=1e6;
/// Half-width, in pixels, of the windows around matched features whose mean linear light is compared.
const RADIUS_PX: isize = 2;

impl Gains {
    /// Kind of the disk-cache entries that hold gains.
    pub(crate) const KIND: CacheKind = CacheKind { name: "gains", version: 2 };

    /// Returns gains of 1 for this number of cameras.
    pub fn equal(cameras: usize) -> Self {
        let curves = vec![GainCurve::default(); cameras];
        Self { factors: vec![[1.0; 3]; cameras], curves, largest: (0.0, 0.0) }
    }

    /// Returns whether gains that were read from a file are valid for this number of cameras.
    pub(crate) fn are_plausible(&self, cameras: usize) -> bool {
        let (difference, std_err) = self.largest;
        let are_measured = [difference, std_err].iter().all(|v| v.is_finite() && *v >= 0.0);
        let are_gains = self.factors.iter().flatten().all(|g| PLAUSIBLE.contains(g));
        let are_all = self.factors.len() == cameras && self.curves.len() == cameras;
        are_measured && are_gains && are_all && self.curves.iter().all(GainCurve::is_plausible)
    }

    /// Returns an upper bound on the size on disk of the gains of this number of cameras, bytes.
    pub(crate) fn max_stored_bytes(cameras: usize) -> usize {
        cameras * (size_of::<[f64; 3]>() + MAX_KNOTS * size_of::<GainKnot>() + size_of::<usize>())
    }

    /// Returns the size of the gains in memory, bytes.
    pub(crate) fn bytes(&self) -> usize {
        let curves = self.curves.iter().map(|curve| size_of::<GainCurve>() + curve.bytes());
        size_of_val(&self.factors[..]) + curves.sum::<usize>()
    }

    /// Returns whether all gains are always 1, so that no image is corrected.
    pub fn are_equal(&self) -> bool {
        self.factors.iter().all(|f| *f == [1.0; 3])
            && self.curves.iter().all(GainCurve::is_constant)
    }

    /// Returns the gains of red, green and blue of a camera at `time_s`, seconds on the camera's own clock.
    ///
    /// # Panics
    /// If there is no such camera.
    pub fn at(&self, camera: usize, time_s: f64) -> [f64; 3] {
        let (factors, curve) = (self.factors[camera], &self.curves[camera]);
        if curve.is_constant() {
            return factors;
        }
        let log = curve.log_at(time_s);
        [0, 1, 2].map(|c| factors[c] * log[c].exp())
    }

    /// Converts a camera's image (gamma-encoded values) to the common exposure, which is that of the reference camera's
    /// middle frame. The camera exposed the image at `time_s`, seconds on its own clock. Returns `None` if its gains
    /// are 1 at this time. Values of the result may be outside 0..=1.
    ///
    /// # Panics
    /// If there is no such camera.
    pub fn corrected(&self, camera: usize, time_s: f64, image: &Image) -> Option<Image> {
        let factors = self.at(camera, time_s);
        (factors != [1.0; 3]).then(|| scaled(image, factors.map(|f| 1.0 / f)))
    }

    /// Converts an image (gamma-encoded values) from the common exposure, which is that of the reference camera's
    /// middle frame, to the exposure of `camera` at `time_s`, seconds on the camera's own clock. This is the inverse of
    /// [`Self::corrected`]. Returns `None` if the camera's gains are 1 at this time.
    ///
    /// # Panics
    /// If there is no such camera.
    pub fn as_filmed(&self, camera: usize, time_s: f64, image: &Image) -> Option<Image> {
        let factors = self.at(camera, time_s);
        (factors != [1.0; 3]).then(|| scaled(image, factors))
    }

    /// Converts a camera's image (gamma-encoded values) from the camera's exposure at time `from_s` to its exposure at
    /// time `to_s`, both in seconds on the camera's own clock. Returns `None` if both exposures are equal. Values of
    /// the result may exceed 1.
    ///
    /// # Panics
    /// If there is no such camera.
    pub fn exposed_at(
        &self,
        camera: usize,
        [from_s, to_s]: [f64; 2],
        image: &Image,
    ) -> Option<Image> {
        let curve = &self.curves[camera];
        let [from, to] = [from_s, to_s].map(|time_s| curve.log_at(time_s));
        (from != to).then(|| scaled(image, [0, 1, 2].map(|c| (to[c] - from[c]).exp())))
    }

    /// Estimates the gains from the middle frame of each camera's recording, and their changes from more frames. A
    /// camera whose middle frame cannot be read is left out. The read error is reported later, when the frame is used.
    pub(super) fn estimate(capture: &Capture, options: &RegistrationOptions) -> Self {
        let count = capture.cameras.len();
        let small_image = |c: usize| {
            let middle = capture.cameras[c].frames.len() / 2;
            Some(shrunk(capture.read_frame(c, middle).ok()?, WIDTH_PX))
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
            ratio_between(cameras, [a, b], &flow(from, to, &starts, options))
        };
        let ratios: Vec<Ratio> = neighbors(capture).into_iter().filter_map(ratio).collect();
        let is_gray = |image: &Option<Image>| image.as_ref().is_some_and(|i| i.channels() == 1);
        let are_gray: Vec<bool> = images.iter().map(is_gray).collect();
        Self { curves: gain_curves(capture), ..solve_gains(capture.reference, &are_gray, &ratios) }
    }

    /// Returns these gains with other factors, which are estimated from surfaces that pairs of cameras see. `are_gray`
    /// states for each camera whether it is grey. `None` if no pair has enough samples.
    pub(crate) fn with_samples(
        &self,
        reference: usize,
        are_gray: &[bool],
        samples: &[GainSamples],
    ) -> Option<Self> {
        let ratio = |pair: &GainSamples| Ratio::of_samples(pair.cameras, &pair.log_ratios);
        let ratios: Vec<Ratio> = samples.iter().filter_map(ratio).collect();
        let solve = || solve_gains(reference, are_gray, &ratios);
        (!ratios.is_empty()).then(|| Self { curves: self.curves.clone(), ..solve() })
    }
}

/// Returns the luminance of linear light, repeated for all three channels.
pub(super) fn luminance([r, g, b]: [f64; 3]) -> [f64; 3] {
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

/// Returns the median ratio of the light of `cameras[1]` to that of `cameras[0]` over matched features. `matches` are
/// from pixels of `images[0]` to pixels of `images[1]`. Returns `None` if too few features are usable.
fn ratio_between(
    cameras: [usize; 2],
    images: [&Image; 2],
    matches: &[Option<Match>],
) -> Option<Ratio> {
    let is_gray = images.iter().any(|i| i.channels() == 1);
    let log = |m: &Match| {
        let both = [light(images[0], &m.source)?, light(images[1], &m.target)?];
        let [a, b] = if is_gray { both.map(luminance) } else { both };
        // The light is positive, since it is in the usable range.
        Some([0, 1, 2].map(|c| (b[c] / a[c]).ln()))
    };
    Ratio::of_samples(cameras, &matches.iter().flatten().filter_map(log).collect::<Vec<_>>())
}

/// Solves for the gains of all cameras, from ratios between pairs of cameras, by weighted least squares. Gains that
/// don't differ significantly from 1, and those of the reference camera, are 1. `are_gray` states for each camera
/// whether it is grey.
fn solve_gains(reference: usize, are_gray: &[bool], ratios: &[Ratio]) -> Gains {
    let mut gains = Gains::equal(are_gray.len());
    let logs = solve_log_gains(are_gray.len(), reference, ratios);
    for c in 0..3 {
        for (camera, factors) in gains.factors.iter_mut().enumerate() {
            let Some(LogGain { log, std_err }) = logs[camera][c] else { continue };
            let difference = log.exp() - 1.0;
            if camera == reference {
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
    // The comparison of a grey camera with colour cameras gives a different gain for each channel. The luminance of the
    // three gains replaces all of them.
    for (factors, is_gray) in gains.factors.iter_mut().zip(are_gray) {
        if *is_gray && *factors != [1.0; 3] {
            *factors = luminance(*factors);
        }
    }
    gains
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ratio(cameras: [usize; 2], log: f64) -> Ratio {
        Ratio { images: cameras, log: [log, 0.0, 0.5 * log], variance: [1e-5; 3] }
    }

    #[test]
    fn gains_are_recovered_along_a_chain_and_around_a_loop() {
        let logs = [0.3, -0.1, 0.0, 0.45];
        let between = |a: usize, b: usize| ratio([a, b], logs[b] - logs[a]);
        let gains = solve_gains(
            2,
            &[false; 4],
            &[between(0, 1), between(1, 2), between(2, 3), between(0, 3)],
        );
        for (camera, log) in logs.iter().enumerate() {
            let [r, g, b] = gains.factors[camera];
            assert!((r - log.exp()).abs() < 1e-4 && g == 1.0, "{camera}: {r} {g}");
            assert!((b - (0.5 * log).exp()).abs() < 1e-4, "{camera}: {b}");
        }
        assert!(!gains.are_equal());
    }

    #[test]
    fn small_differences_and_unknown_cameras_are_not_corrected() {
        let gains = solve_gains(0, &[false; 4], &[ratio([0, 1], 0.01)]);
        assert!(gains.are_equal());
        let (largest, std_err) = gains.largest;
        assert!((largest - 0.01).abs() < 2e-3 && std_err < 0.01, "{largest} {std_err}");
        assert!(solve_gains(0, &[false], &[]).are_equal());
        let few = GainSamples { cameras: [0, 1], log_ratios: vec![[0.4; 3]; 3] };
        assert_eq!(Gains::equal(2).with_samples(0, &[false; 2], &[few]), None);
    }

    #[test]
    fn corrected_light_is_the_reference_s() {
        let image = Image::from_data(2, 1, 3, vec![0.1, 0.5, 0.9, 0.3, 0.0, 0.7]);
        let brighter = scaled(&image, [1.5, 1.0, 0.7]);
        let mut gains = Gains::equal(2);
        assert_eq!(gains.corrected(1, 0.0, &image), None);
        gains.factors[1] = [1.5, 1.0, 0.7];
        let back = gains.corrected(1, 0.0, &brighter).expect("it differs");
        for (a, b) in back.data().iter().zip(image.data()) {
            assert!((a - b).abs() < 1e-6, "{a} {b}");
        }
    }
}
