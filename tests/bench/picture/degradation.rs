//! Copies of a recording as worse cameras would have filmed it.

use super::Error;
use super::barrel::Barrel;
use super::noise::{self, noisy};
use rayon::prelude::*;
use std::path::Path;
use stlfr::camera::CameraFormat;
use stlfr::capture::{
    CAPTURE_FILE, Capture, CaptureFormat, ClockFormat, Color, FilmedCameraFormat,
};
use stlfr::host::write_json;
use stlfr::json;
use stlfr::random::Random;
use stlfr::raster::{
    BitDepth, Image, encoded_from_linear, gray_from_rgb, linear_from_encoded, write_image,
};

/// Standard deviation of the noise, a fraction of full scale.
const NOISE: f64 = 0.02;
/// Largest difference of a gain from 1.
const GAIN: f64 = 0.1;
/// Fraction of a camera's frames that are lost.
const LOST: f64 = 0.1;

/// What is worse about a copy.
#[derive(Clone, Copy, PartialEq)]
pub enum Degradation {
    /// The same pixels and clocks.
    None,
    /// Gaussian noise on the encoded values.
    Noise,
    /// Each channel of each camera but the reference records another multiple of the light. The reference has no
    /// gains, because views have its exposure.
    Gains,
    /// Every lens has barrel distortion ([`Barrel`]).
    Distortion,
    /// Every image is resampled as for barrel distortion, without any.
    Enlarged,
    /// Every second camera has every second frame only. The reference has all.
    MixedRates,
    /// Frames of every camera are missing at random. The times of the others stay true.
    LostFrames,
    /// Every second camera is grey. The reference has colours.
    Grey,
}

impl Degradation {
    pub const ALL: [Self; 8] = [
        Self::None,
        Self::Noise,
        Self::Gains,
        Self::Distortion,
        Self::Enlarged,
        Self::MixedRates,
        Self::LostFrames,
        Self::Grey,
    ];

    pub fn name(self) -> &'static str {
        match self {
            Self::None => "as filmed",
            Self::Noise => "noise of 2 %",
            Self::Gains => "gains of ±10 %",
            Self::Distortion => "lens distortion",
            Self::Enlarged => "resampled as for that",
            Self::MixedRates => "mixed rates",
            Self::LostFrames => "10 % of frames lost",
            Self::Grey => "every second camera grey",
        }
    }

    /// Writes the degraded copy of a recording to a folder, without its truth.
    pub fn write(self, whole: &Capture, to: &Path) -> Result<(), Error> {
        let mut format: CaptureFormat = json::read(&whole.folder.join(CAPTURE_FILE))?;
        for (index, described) in format.cameras.iter_mut().enumerate() {
            let camera = DegradedCamera::new(self, whole, index)?;
            camera.describe(described);
            camera.write_frames(to)?;
        }
        if matches!(self, Self::Distortion | Self::Enlarged) {
            // It may be of lens parameters that the copy's cameras don't have.
            format.calibration_covariance = None;
        }
        Ok(write_json(&to.join(CAPTURE_FILE), &format)?)
    }
}

/// One camera of a copy.
struct DegradedCamera<'a> {
    whole: &'a Capture,
    index: usize,
    /// The recording's frames that the copy has.
    frames: Vec<usize>,
    lens: Option<Barrel>,
    gains: Option<[f64; 3]>,
    is_noisy: bool,
    is_grey: bool,
}

impl<'a> DegradedCamera<'a> {
    fn new(degradation: Degradation, whole: &'a Capture, index: usize) -> Result<Self, Error> {
        let all = whole.cameras[index].frames.len();
        let is_second = index % 2 != whole.reference % 2;
        let frames = match degradation {
            Degradation::MixedRates if is_second => (0..all).step_by(2).collect(),
            Degradation::LostFrames => remaining(all, index),
            _ => (0..all).collect(),
        };
        let original = &whole.cameras[index].camera;
        let lens = match degradation {
            Degradation::Distortion => Some(Barrel::new(original)),
            Degradation::Enlarged => Some(Barrel::enlarging(original)),
            _ => None,
        };
        let lens = lens.map(|lens| lens.ok_or("a lens can't be inverted")).transpose()?;
        let gains =
            (degradation == Degradation::Gains && index != whole.reference).then(|| gains(index));
        let is_noisy = degradation == Degradation::Noise;
        let is_grey = degradation == Degradation::Grey && is_second;
        Ok(Self { whole, index, frames, lens, gains, is_noisy, is_grey })
    }

    /// Changes the camera's entry of `capture.json`.
    fn describe(&self, described: &mut FilmedCameraFormat) {
        described.frames = format!("{}/%04d.png", described.id);
        if let Some(lens) = &self.lens {
            let CameraFormat { model, params, .. } = CameraFormat::from(&lens.camera);
            (described.model, described.params) = (model, params);
        }
        if self.is_grey {
            described.color = Color::Gray;
        }
        let times_s = self.whole.times_in_file_s(self.index);
        if self.frames.len() < times_s.len() {
            let times_s = Some(self.frames.iter().map(|k| times_s[*k]).collect());
            let clock = described.clock.clone();
            described.clock = ClockFormat { rate_hz: None, first_s: None, times_s, ..clock };
        }
    }

    fn write_frames(&self, to: &Path) -> Result<(), Error> {
        let filmed = &self.whole.cameras[self.index];
        let write = |(k, frame): (usize, &usize)| -> Result<(), String> {
            let image = self.whole.read_frame(self.index, *frame).map_err(|e| e.to_string())?;
            let path = to.join(format!("{}/{k:04}.png", filmed.id));
            write_image(&path, &self.degraded(image, *frame), None, filmed.bit_depth)
                .map_err(|e| e.to_string())
        };
        Ok(self.frames.par_iter().enumerate().try_for_each(write)?)
    }

    fn degraded(&self, image: Image, frame: usize) -> Image {
        if let Some(lens) = &self.lens {
            return lens.apply(&image);
        }
        if let Some(gains) = self.gains {
            return amplified(&image, gains);
        }
        if self.is_noisy {
            let bits = match self.whole.cameras[self.index].bit_depth {
                BitDepth::Eight => 8,
                BitDepth::Sixteen => 16,
            };
            return noisy(&image, NOISE, bits, noise::seed(self.index, frame));
        }
        if self.is_grey { grey(&image) } else { image }
    }
}

/// The frames of a camera that are not lost: at least one is lost, if there are two.
fn remaining(all: usize, camera: usize) -> Vec<usize> {
    let random = &mut Random::stream(camera as u64, "lost frames");
    let lost = ((LOST * all as f64).round() as usize).max(1);
    let mut frames: Vec<usize> = (0..all).collect();
    for _ in 0..lost {
        if frames.len() > 1 {
            frames.remove((random.unit() * frames.len() as f64) as usize);
        }
    }
    frames
}

/// The gains of a camera's red, green and blue.
fn gains(camera: usize) -> [f64; 3] {
    let random = &mut Random::stream(camera as u64, "gains");
    [(); 3].map(|()| 1.0 + GAIN * random.signed())
}

/// The image with other gains of its linear light, clipped to 0..=1. A grey image has the gain of green.
fn amplified(image: &Image, gains: [f64; 3]) -> Image {
    let channels = image.channels();
    let gain = |k: usize| if channels == 1 { gains[1] } else { gains[k % channels] };
    let value = |(k, v): (usize, &f32)| {
        encoded_from_linear(gain(k) * linear_from_encoded(f64::from(*v))).clamp(0.0, 1.0) as f32
    };
    let data = image.data().iter().enumerate().map(value).collect();
    Image::from_data(image.width(), image.height(), channels, data)
}

/// The image of a grey camera: the encoded luminance of the light.
fn grey(image: &Image) -> Image {
    if image.channels() == 1 {
        return image.clone();
    }
    let data = image.data().chunks_exact(3).map(|p| gray_from_rgb([p[0], p[1], p[2]])).collect();
    Image::from_data(image.width(), image.height(), 1, data)
}
