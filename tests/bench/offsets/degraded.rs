//! Errors on recorded frames that are degraded by noise, blur or quantization, or whose time stamps are.
//! Frames are downsampled to half size, so that pixels have more than eight bits before that.

use super::captures::{by_default, outcomes};
use super::noise::{self, noisy};
use super::{save, sweep};
use rayon::prelude::*;
use std::collections::HashMap;
use std::path::Path;
use std::sync::Arc;
use stlfr::capture::{Capture, Truth};
use stlfr::random::Random;
use stlfr::raster::Image;
use stlfr::raster::{BitDepth, write_image};

type Failure = Box<dyn std::error::Error>;

/// How frames and time stamps are degraded.
#[derive(Clone, Copy)]
struct Degradation {
    /// The standard deviation of the pixels' noise, of full scale.
    noise: f64,
    /// The standard deviation of the Gaussian blur, pixels.
    blur_px: f64,
    /// The standard deviation of the time stamps' errors, seconds.
    jitter_s: f64,
    /// Bits per pixel and channel.
    bits: u32,
}

const UNCHANGED: Degradation = Degradation { noise: 0.0, blur_px: 0.0, jitter_s: 0.0, bits: 16 };

pub fn run(folders: &[String], output: &Path) -> Result<(), Failure> {
    type Change = fn(&mut Degradation, f64);
    let sweeps: [(&str, &[f64], Change); 4] = [
        ("noise, % of full scale", &[0.0, 0.5, 1.0, 2.0, 4.0, 8.0], |w, v| w.noise = 0.01 * v),
        ("blur, pixels", &[0.0, 0.5, 1.0, 2.0, 3.0], |w, v| w.blur_px = v),
        ("jitter, hidden, ms", &[0.0, 0.5, 1.0, 2.0, 4.0], |w, v| w.jitter_s = 1e-3 * v),
        ("bits", &[4.0, 5.0, 6.0, 8.0, 16.0], |w, v| w.bits = v as u32),
    ];
    let mut charts = Vec::new();
    for (name, values, change) in sweeps {
        charts.push(sweep::chart(
            "Recorded frames",
            (name, values),
            |value| -> Result<_, Failure> {
                let mut degradation = UNCHANGED;
                change(&mut degradation, value);
                let (mut all, mut unknown) = (Vec::new(), 0);
                for folder in folders {
                    let (of_capture, of_capture_unknown) = measure(Path::new(folder), degradation)?;
                    all.extend(of_capture);
                    unknown += of_capture_unknown;
                }
                Ok((all, unknown))
            },
        )?);
    }
    save(output, "filmed-growth", &charts)
}

/// The outcomes of a capture at half size with a degradation, and the number of unknown offsets.
fn measure(
    folder: &Path,
    degradation: Degradation,
) -> Result<(Vec<super::captures::Outcome>, usize), Failure> {
    let whole = Capture::open(folder)?;
    let truth = Truth::open(folder)?.ok_or("has no truth")?;
    let copy = tempfile::tempdir()?;
    let mean_errors_s = write_description(folder, copy.path(), &whole, degradation.jitter_s)?;
    write_frames(&whole, copy.path(), degradation)?;
    let capture = Arc::new(Capture::open(copy.path())?);
    let estimate = by_default(&capture)?;
    // Time stamps that are late in the mean reduce the clock's offset by as much.
    let mean_s = |id: &str| mean_errors_s.get(id).copied().unwrap_or(0.0);
    let reference_s = mean_s(&estimate.offsets.reference);
    let truth_s = |id: &str| Some(truth.offset_s(id)? - mean_s(id) + reference_s);
    Ok(outcomes(&estimate.offsets, capture.frame_s(), truth_s))
}

/// Writes the capture.json of the copy at half size; returns the mean error of each camera's time stamps,
/// seconds.
fn write_description(
    folder: &Path,
    copy: &Path,
    whole: &Capture,
    jitter_s: f64,
) -> Result<HashMap<String, f64>, Failure> {
    let text = std::fs::read_to_string(folder.join("capture.json"))?;
    let mut description: serde_json::Value = serde_json::from_str(&text)?;
    let random = &mut Random::new(1);
    let mut mean_errors_s = HashMap::new();
    for camera in description["cameras"].as_array_mut().ok_or("has no cameras")? {
        let id = camera["id"].as_str().ok_or("has no id")?.to_owned();
        for side in ["width", "height"] {
            camera[side] = (camera[side].as_u64().ok_or("has no size")? / 2).into();
        }
        // Focal lengths and the principal point; lens distortion has no unit.
        for k in 0..4 {
            camera["params"][k] = (camera["params"][k].as_f64().ok_or("no params")? / 2.0).into();
        }
        camera["frames"] = format!("{id}/%04d.png").into();
        std::fs::create_dir_all(copy.join(&id))?;
        if jitter_s > 0.0 {
            let camera_index = whole.camera_index(&id).ok_or("has no such camera")?;
            let errors_s = (0..whole.cameras[camera_index].frames.len())
                .map(|_| jitter_s * random.gaussian())
                .collect::<Vec<f64>>();
            let stamps = camera["clock"]["times_s"].as_array_mut().ok_or("has no times")?;
            for (stamp, error_s) in stamps.iter_mut().zip(&errors_s) {
                *stamp = (stamp.as_f64().ok_or("has no times")? + error_s).into();
            }
            mean_errors_s.insert(id, errors_s.iter().sum::<f64>() / errors_s.len() as f64);
        }
    }
    std::fs::write(copy.join("capture.json"), description.to_string())?;
    Ok(mean_errors_s)
}

/// Writes all frames, degraded.
fn write_frames(whole: &Capture, copy: &Path, degradation: Degradation) -> Result<(), Failure> {
    let images: Vec<(usize, usize)> = whole
        .cameras
        .iter()
        .enumerate()
        .flat_map(|(c, camera)| (0..camera.frames.len()).map(move |k| (c, k)))
        .collect();
    images.par_iter().try_for_each(|&(c, k)| -> Result<(), String> {
        let frame = whole.read_frame(c, k).map_err(|e| e.to_string())?;
        // Blur is of the lens, before noise and quantization of the sensor.
        let blurred = blurred(&half(&frame), degradation.blur_px);
        let seed = noise::seed(c, k);
        let degraded = noisy(&blurred, degradation.noise, degradation.bits, seed);
        let path = copy.join(format!("{}/{k:04}.png", whole.cameras[c].id));
        let depth = if degradation.bits > 8 { BitDepth::Sixteen } else { BitDepth::Eight };
        write_image(&path, &degraded, None, depth).map_err(|e| e.to_string())
    })?;
    Ok(())
}

/// The image at half size: the mean of every 2 × 2 pixels.
fn half(image: &Image) -> Image {
    let channels = image.channels();
    let (w, h) = (image.width() / 2, image.height() / 2);
    let mut data = vec![0.0; w * h * channels];
    for (k, out) in data.iter_mut().enumerate() {
        let (x, y, c) = ((k / channels) % w, k / channels / w, k % channels);
        let at = |dx: usize, dy: usize| image.row(2 * y + dy)[(2 * x + dx) * channels + c];
        *out = 0.25 * (at(0, 0) + at(1, 0) + at(0, 1) + at(1, 1));
    }
    Image::from_data(w, h, channels, data)
}

/// A Gaussian blur, along the rows and then along the columns.
fn blurred(image: &Image, sigma_px: f64) -> Image {
    if sigma_px == 0.0 {
        return image.clone();
    }
    let reach = (3.0 * sigma_px).ceil() as isize;
    let weights: Vec<f64> =
        (-reach..=reach).map(|d| (-0.5 * (d as f64 / sigma_px).powi(2)).exp()).collect();
    let total: f64 = weights.iter().sum();
    let (w, h, channels) = (image.width(), image.height(), image.channels());
    let pass = |from: &[f32], across: bool| -> Vec<f32> {
        let at = |x: usize, y: usize, c: usize, d: isize| {
            let shifted =
                |v: usize, size: usize| (v as isize + d).clamp(0, size as isize - 1) as usize;
            let (x, y) = if across { (shifted(x, w), y) } else { (x, shifted(y, h)) };
            f64::from(from[(y * w + x) * channels + c])
        };
        (0..w * h * channels)
            .map(|k| {
                let (x, y, c) = ((k / channels) % w, k / channels / w, k % channels);
                let sum: f64 =
                    (-reach..=reach).zip(&weights).map(|(d, weight)| weight * at(x, y, c, d)).sum();
                (sum / total) as f32
            })
            .collect()
    };
    let rows = pass(image.data(), true);
    Image::from_data(w, h, channels, pass(&rows, false))
}
