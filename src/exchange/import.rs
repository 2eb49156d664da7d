//! Import of a calibration with videos or image sequences as a capture.

use super::footage::{Footage, FootageFrames, FoundFootage, find, image_size, of_video};
use super::pairing::{all_entries, extension};
use super::request::{ImportClock, ImportRequest};
use super::{ExchangeError, NamedCamera, content};
use crate::camera::{CameraFormat, CameraModel};
use crate::capture::{
    CAPTURE_FILE, Capture, CaptureFormat, ClockFormat, Color, FilmedCameraFormat, Opening,
};
use crate::host::temporary::Temporary;
use crate::host::{open_file, write_json};
use crate::text::number;
use crate::video::{DamagedVideo, decode_intact};
use std::fs::File;
use std::path::{Path, PathBuf};

/// Name of the new capture's folder inside the temporary folder in which it is made.
const WHOLE: &str = "capture";
/// Name of the folder for temporary lists of video frames. It is beside the new capture in the temporary folder.
const SCRATCH: &str = "scratch";

/// Imports a calibration and recordings as the new capture `target`. Images are copied. Videos are hard-linked, or
/// copied where the file system can't link them. The intact frames of a damaged video become PNG images; its other
/// frames are left out. The folder `target` appears only when the capture is complete and can be opened.
///
/// The id of a camera is the first folder in the name of its images, or else this name without extension. The recording
/// of a camera is the sub-folder or video with this id in the request's folder. If no camera has a recording of its
/// name, cameras and recordings are paired by the numbers in their names. If a calibration has no names, the names of
/// the recordings become the ids, in the order of their numbers. All images in one folder belong to one camera. If the
/// calibration has a time for every image, the frames are the images that the calibration lists.
///
/// The times of the frames come from the first of these sources that exists: the given rate, the given table,
/// `timestamps.csv` beside the recordings, the calibration, the video.
///
/// A table of times has a time for each frame of a damaged video, including the frames that are left out.
///
/// Returns sentences for the user. They say which recordings were found, how they are interpreted, and how many frames
/// are damaged.
///
/// Errors: a target that is not empty, a moving camera, recordings whose pairing is ambiguous, a sequence of mixed
/// image types or with a gap, frames without times, images whose aspect ratio differs from the calibrated image, a
/// video that is interlaced or has fewer than two intact frames, a capture that can't be opened.
pub fn import(
    cameras: &[NamedCamera],
    request: &ImportRequest,
    target: &Path,
    opening: &Opening,
) -> Result<Vec<String>, ExchangeError> {
    let failed = |source| ExchangeError::Write { path: target.to_owned(), source };
    let NewCapture { temporary, whole } = NewCapture::begin(target)?;
    let scratch = temporary.path().join(SCRATCH);
    std::fs::create_dir(&scratch).map_err(failed)?;

    let FoundFootage { mut footage, mut notes, has_one_clock } =
        find(cameras, request, opening, &scratch)?;
    for one in &mut footage {
        if request.is_uncalibrated {
            guess_lens(one)?;
        }
        notes.extend(fit(one, request.is_cropped)?);
    }
    let clocks = clocks(&footage, request, has_one_clock, &mut notes)?;
    let mut filmed = Vec::new();
    for (one, clock) in footage.iter().zip(clocks) {
        let frames = match &one.frames {
            FootageFrames::Images(files) => {
                place_images(&one.id, files, copy_file, &whole, target)?
            }
            FootageFrames::Video(path, _) => place_video(&one.id, path, &whole, target)?,
            FootageFrames::Damaged(path, video) => {
                let images = intact_images(path, video, &scratch, opening)?;
                let moved = |from: &Path, to: &Path| std::fs::rename(from, to);
                place_images(&one.id, &images, moved, &whole, target)?
            }
        };
        filmed.push(described(one, frames, clock));
    }
    notes.push(summary(&filmed, &footage));
    let format = CaptureFormat {
        format: "stlfr-capture".into(),
        version: 1,
        name: name_of(target)?,
        reference: None,
        cameras: filmed,
        calibration_covariance: None,
    };
    NewCapture { temporary, whole }.finish(&format, target, opening)?;
    Ok(notes)
}

/// Returns the name of the capture in the folder `target`, which is the name of this folder.
pub(super) fn name_of(target: &Path) -> Result<String, ExchangeError> {
    let failed = |source| ExchangeError::Write { path: target.to_owned(), source };
    let absolute = std::path::absolute(target).map_err(failed)?;
    Ok(absolute.file_name().map_or("imported".into(), |n| n.to_string_lossy().into_owned()))
}

/// Returns an error if the folder of a new capture already holds files.
pub fn require_new(target: &Path) -> Result<(), ExchangeError> {
    if target.symlink_metadata().is_ok() && !all_entries(target)?.is_empty() {
        return Err(content(target, "holds files already, which are not written over"));
    }
    Ok(())
}

/// A capture that is being made in a temporary folder beside its final path.
pub(super) struct NewCapture {
    pub temporary: Temporary,
    /// The capture's folder inside the temporary folder.
    pub whole: PathBuf,
}

impl NewCapture {
    /// Begins the capture `target`, a folder that must be missing or empty.
    pub fn begin(target: &Path) -> Result<Self, ExchangeError> {
        let failed = |source| ExchangeError::Write { path: target.to_owned(), source };
        require_new(target)?;
        let absolute = std::path::absolute(target).map_err(failed)?;
        let beside = absolute.parent().ok_or_else(|| content(target, "names no folder"))?;
        let temporary = Temporary::inside(beside).map_err(failed)?;
        let whole = temporary.path().join(WHOLE);
        std::fs::create_dir(&whole).map_err(failed)?;
        Ok(Self { temporary, whole })
    }

    /// Writes the capture's description, opens the capture as a check, and moves it to `target`.
    pub fn finish(
        self,
        format: &CaptureFormat,
        target: &Path,
        opening: &Opening,
    ) -> Result<(), ExchangeError> {
        let failed = |source| ExchangeError::Write { path: target.to_owned(), source };
        write_json(&self.whole.join(CAPTURE_FILE), format).map_err(failed)?;
        // The capture is opened here, so that an invalid capture fails this command and not a later one.
        Capture::open_with(&self.whole, opening).map_err(|error| {
            let message = error.to_string();
            let path = format!("{}/", self.whole.display());
            content(target, message.strip_prefix(&path).unwrap_or(&message))
        })?;
        self.temporary.place(WHOLE, target).map_err(failed)
    }
}

/// Focal length that is assumed for a camera without a calibration, as a multiple of the longer side of its images.
const GUESSED_FOCAL: f64 = 1.2;

/// Replaces the placeholder lens of a camera without a calibration. The new lens is a pinhole with the assumed focal
/// length [`GUESSED_FOCAL`] and the size of the camera's images.
fn guess_lens(footage: &mut Footage) -> Result<(), ExchangeError> {
    let [width, height] = image_size(&footage.frames)?;
    let f = GUESSED_FOCAL * width.max(height) as f64;
    let (cx, cy) = (0.5 * width as f64, 0.5 * height as f64);
    let camera = &mut footage.camera.camera;
    camera.model = CameraModel::Pinhole { fx: f, fy: f, cx, cy };
    (camera.width, camera.height) = (width, height);
    Ok(())
}

/// Adapts a camera's calibration to the size of its images. If the aspect ratio is the same, the lens is scaled. If
/// `is_cropped`, smaller images of another aspect ratio are the top left part of the calibrated image. Other sizes are
/// an error. Returns a sentence for the user if the size was adapted, and `None` if the size is equal.
fn fit(footage: &mut Footage, is_cropped: bool) -> Result<Option<String>, ExchangeError> {
    let [width, height] = image_size(&footage.frames)?;
    let camera = &mut footage.camera.camera;
    let calibrated = [camera.width, camera.height];
    if calibrated == [width, height] {
        return Ok(None);
    }
    let id = &footage.id;
    let sizes =
        format!("{width}×{height} pixels, its calibration {}×{}", calibrated[0], calibrated[1]);
    if width * calibrated[1] == height * calibrated[0] {
        camera.model = camera.model.scaled(width as f64 / calibrated[0] as f64);
        (camera.width, camera.height) = (width, height);
        return Ok(Some(format!("{id} has images of {sizes}: its lens is scaled.")));
    }
    if is_cropped && width <= calibrated[0] && height <= calibrated[1] {
        (camera.width, camera.height) = (width, height);
        return Ok(Some(format!("{id} has images of {sizes}: they are its top left part.")));
    }
    let advice = if width <= calibrated[0] && height <= calibrated[1] {
        "; if they are its top left part, give --crop"
    } else {
        ""
    };
    Err(content(footage.frames.path(), format!("has images of {sizes}{advice}")))
}

/// Largest rounding error, in seconds, of time stamps that are whole milliseconds.
const MILLISECONDS_S: f64 = 0.51e-3;
/// Largest rounding error, in seconds, of time stamps that are not whole milliseconds. They are assumed to have a
/// resolution of a microsecond or better.
const MICROSECONDS_S: f64 = 1.1e-6;

/// Returns the constant frame rate of time stamps, in hertz. A whole number, or 1000/1001 of a whole number, is
/// preferred if it agrees with the time stamps. Returns `None` if the time stamps are uneven or fewer than two.
fn steady_rate_hz(times_s: &[f64]) -> Option<f64> {
    let (first, last) = (times_s.first()?, times_s.last()?);
    let mean = (times_s.len() - 1) as f64 / (last - first);
    let is_whole_ms = |t: &f64| (1e3 * t - (1e3 * t).round()).abs() < 1e-6;
    let rounding = if times_s.iter().all(is_whole_ms) { MILLISECONDS_S } else { MICROSECONDS_S };
    let is_steady = |rate: &f64| {
        let off = |(k, t): (usize, &f64)| (t - first - k as f64 / rate).abs();
        rate.is_finite()
            && *rate > 0.0
            && times_s.iter().enumerate().all(|e| off(e) <= 2.0 * rounding)
    };
    let ntsc = (mean * 1.001).round() / 1.001;
    [mean.round(), ntsc, mean].into_iter().find(is_steady)
}

/// Largest absolute value of the earliest frame time for which times are imported unchanged, nanoseconds. Above it, the
/// earliest frame time, rounded down to whole seconds, is subtracted from all frame times. Times are written as doubles
/// in seconds, and at this limit a double has a resolution of a tenth of a nanosecond.
const MAX_PLAIN_NS: i64 = 1_000_000_000_000_000;

/// Returns the clocks of all cameras, from the given rate, the frame times or the videos' time stamps. `notes` receives
/// sentences for the user.
fn clocks(
    footage: &[Footage],
    request: &ImportRequest,
    has_one_clock: bool,
    notes: &mut Vec<String>,
) -> Result<Vec<ClockFormat>, ExchangeError> {
    let ImportClock { rate_hz, first_s, shared, readout_s, readout_std_s } = request.clock;
    let shared = shared || has_one_clock;
    let all_ns = footage.iter().filter_map(|f| f.times_ns.as_ref()).flatten().copied();
    let from_ns = all_ns.min().filter(|first| first.saturating_abs() > MAX_PLAIN_NS);
    let from_ns = from_ns.map_or(0, |first| first.div_euclid(1_000_000_000) * 1_000_000_000);
    if from_ns != 0 {
        notes.push(format!("Times count from {} s of the file's.", from_ns / 1_000_000_000));
    }
    let clock = ClockFormat { shared, readout_s, readout_std_s, ..ClockFormat::default() };
    let steady =
        |one: &Footage, rate_hz, first_s| steady(&clock, &one.frames.indices(), rate_hz, first_s);
    let stamped = |times_s| ClockFormat { times_s: Some(times_s), ..clock.clone() };
    let mut clocks = Vec::new();
    let mut uneven = Vec::new();
    let mut rates = Vec::new();
    for one in footage {
        clocks.push(match (rate_hz, &one.times_ns, one.frames.facts()) {
            (Some(rate_hz), ..) => steady(one, rate_hz, first_s),
            (None, Some(times_ns), _) => {
                stamped(times_ns.iter().map(|t| (t - from_ns) as f64 / 1e9).collect())
            }
            (None, None, Some(facts)) => match steady_rate_hz(&facts.times_s) {
                Some(rate_hz) => {
                    rates.push(rate_hz);
                    steady(one, rate_hz, first_s + facts.times_s[0])
                }
                None => {
                    uneven.push(one.id.as_str());
                    let times_s = facts.times_s.iter().map(|t| first_s + t).collect();
                    stamped(one.frames.imported(times_s))
                }
            },
            (None, None, None) => {
                let reason = "is an image, which has no time: give --rate or --times";
                return Err(content(one.frames.path(), reason));
            }
        });
    }
    if let (Some(min), Some(max)) =
        (rates.iter().copied().reduce(f64::min), rates.iter().copied().reduce(f64::max))
    {
        let rates = if min == max { number(min) } else { format!("{min:.6} to {max:.6}") };
        notes.push(format!("By the videos' own times, they have {rates} frames a second."));
    }
    if !uneven.is_empty() {
        let ids = uneven.join(", ");
        notes.push(format!("Frames of {ids} are not evenly spaced: their times are the video's."));
    }
    Ok(clocks)
}

/// Returns a clock with the times of frames that were recorded at a constant rate, in hertz. Frame k of the recording
/// has the time `first_s` + k / `rate_hz`, in seconds. `indices` are the ascending values of k of the imported frames.
/// Everything else is as in `clock`.
fn steady(clock: &ClockFormat, indices: &[usize], rate_hz: f64, first_s: f64) -> ClockFormat {
    let time_s = |k: usize| first_s + k as f64 / rate_hz;
    if indices.windows(2).all(|pair| pair[0] + 1 == pair[1]) {
        let first_s = indices.first().map_or(first_s, |k| time_s(*k));
        return ClockFormat { rate_hz: Some(rate_hz), first_s: Some(first_s), ..clock.clone() };
    }
    let times_s = indices.iter().map(|k| time_s(*k)).collect();
    ClockFormat { times_s: Some(times_s), ..clock.clone() }
}

/// Returns a sentence for the user with the numbers of cameras and frames.
fn summary(filmed: &[FilmedCameraFormat], footage: &[Footage]) -> String {
    let frames = || footage.iter().map(|one| one.frames.len());
    let (min, max) = (frames().min().unwrap_or(0), frames().max().unwrap_or(0));
    let frames = if min == max { min.to_string() } else { format!("{min} to {max}") };
    let unshared = if filmed.iter().all(|c| c.clock.shared) {
        "on one clock"
    } else {
        "each on its own clock: stlfr offsets estimates how far they are apart"
    };
    format!("{} cameras with {frames} frames, {unshared}.", filmed.len())
}

/// Links or copies a camera's video into the temporary folder `whole` of the capture, which will be moved to `target`.
/// Returns the file name of the video.
fn place_video(
    id: &str,
    path: &Path,
    whole: &Path,
    target: &Path,
) -> Result<String, ExchangeError> {
    let name = format!("{id}.{}", extension(path).unwrap_or_default());
    let linked = link(path, &whole.join(&name));
    let (path, to) = (path.to_owned(), target.to_owned());
    linked.map_err(|source| ExchangeError::Copy { path, to, source })?;
    Ok(name)
}

/// Decodes the intact frames of a damaged video into the folder `scratch` of temporary files. Returns the image files.
fn intact_images(
    path: &Path,
    video: &DamagedVideo,
    scratch: &Path,
    opening: &Opening,
) -> Result<Vec<PathBuf>, ExchangeError> {
    let Some(ffmpeg) = opening.ffmpeg else {
        return Err(ExchangeError::NoFfmpeg { path: path.to_owned() });
    };
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    let _phase = opening.reporter.phase(&format!("decoding {name}"));
    let unread = |source| ExchangeError::Read { path: path.to_owned(), source };
    let file = open_file(path).map_err(unread)?;
    decode_intact(ffmpeg, &file, scratch, video).map_err(|error| of_video(path, error))
}

/// Creates a hard link to a file, or copies the file where the file system can't link it.
pub(super) fn link(from: &Path, to: &Path) -> std::io::Result<()> {
    let from = from.canonicalize()?;
    std::fs::hard_link(&from, to).or_else(|_| copy_file(&from, to))
}

fn copy_file(from: &Path, to: &Path) -> std::io::Result<()> {
    let mut to = File::create(to)?;
    std::io::copy(&mut open_file(from)?, &mut to)?;
    to.sync_all()
}

/// Places a camera's images in the temporary folder `whole` of the capture, which will be moved to `target`. The images
/// are numbered from 0. `place` copies or moves a file. Returns the pattern of the images' file names.
fn place_images(
    id: &str,
    files: &[PathBuf],
    place: fn(&Path, &Path) -> std::io::Result<()>,
    whole: &Path,
    target: &Path,
) -> Result<String, ExchangeError> {
    let extension = extension(&files[0]).unwrap_or_default();
    let folder = whole.join(id);
    for (k, path) in files.iter().enumerate() {
        let placed = std::fs::create_dir_all(&folder)
            .and_then(|()| place(path, &folder.join(format!("{k:04}.{extension}"))));
        let to = target.to_owned();
        placed.map_err(|source| ExchangeError::Copy { path: path.clone(), to, source })?;
    }
    Ok(format!("{id}/%04d.{extension}"))
}

fn described(footage: &Footage, frames: String, clock: ClockFormat) -> FilmedCameraFormat {
    let CameraFormat { width, height, model, params, cam_from_world } =
        (&footage.camera.camera).into();
    FilmedCameraFormat {
        id: footage.id.clone(),
        frames,
        width,
        height,
        model,
        params,
        cam_from_world,
        calibration_std: None,
        color: Color::Rgb,
        clock,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rates_of_containers_are_recognized() {
        let stamps = |rate: f64, unit: f64, n: usize| -> Vec<f64> {
            (0..n).map(|k| (k as f64 / rate / unit).round() * unit).collect()
        };
        for rate in [10.0, 25.0, 30.0, 60.0, 240.0, 30_000.0 / 1001.0, 60_000.0 / 1001.0] {
            for unit in [1e-3, 1e-6] {
                let found = steady_rate_hz(&stamps(rate, unit, 900)).unwrap();
                assert!((found / rate - 1.0).abs() < 1e-12, "{rate} {unit}: {found}");
            }
        }
        // If the rate isn't whole, the mean rate of the stamps is returned.
        let found = steady_rate_hz(&stamps(17.3, 1e-6, 900)).unwrap();
        assert!((found / 17.3 - 1.0).abs() < 1e-7, "{found}");
    }

    #[test]
    fn uneven_stamps_have_no_rate() {
        assert_eq!(steady_rate_hz(&[0.0, 0.033, 0.1, 0.133]), None);
        assert_eq!(steady_rate_hz(&[0.0, 0.0333, 0.0668, 0.1]), None);
        assert_eq!(steady_rate_hz(&[0.0]), None);
        assert_eq!(steady_rate_hz(&[0.0, 0.0]), None);
        assert_eq!(steady_rate_hz(&[]), None);
    }
}
