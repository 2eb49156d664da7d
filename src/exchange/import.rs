//! A capture from a calibration and a folder of image sequences.

use super::{ExchangeError, NamedCamera, content};
use crate::camera::CameraFormat;
use crate::capture::{CAPTURE_FILE, CaptureFormat, ClockFormat, Color, FilmedCameraFormat};
use std::path::{Path, PathBuf};

/// The clock of every imported camera, which no calibration contains.
#[derive(Clone, Copy, Debug)]
pub struct ImportClock {
    /// Frame rate, hertz.
    pub rate_hz: f64,
    /// Time of the first frame, seconds.
    pub first_s: f64,
    /// Whether all cameras share one clock.
    pub shared: bool,
}

/// File extensions of images.
const EXTENSIONS: [&str; 7] = ["png", "jpg", "jpeg", "pgm", "ppm", "pnm", "pbm"];
/// Largest motion of a camera between two of its images, metres and radians. Larger: moving cameras are
/// imported as fixed. Smaller: rounding is taken for motion.
const MAX_MOTION: f64 = 1e-6;

/// Writes the capture `target` from a calibration and from the sequences in `images`, which are
/// copied.
///
/// A camera's id is the first folder of its name, or its name without extension. Its sequence is the
/// sub-folder of `images` with that name, in the order of the numbers in the files' names. Where no
/// sub-folder has a camera's name, the sub-folders are assigned in order. Images of one folder are
/// one camera.
///
/// A target that is a capture already, a camera that moves, and a missing or mixed sequence are
/// errors.
pub fn import(
    cameras: &[NamedCamera],
    images: &Path,
    clock: ImportClock,
    target: &Path,
) -> Result<(), ExchangeError> {
    if target.join(CAPTURE_FILE).exists() {
        return Err(content(target, "is a capture already, which is not written over"));
    }
    let cameras = one_each(cameras).map_err(|reason| content(target, reason))?;
    let folders = sequence_folders(&cameras, images)?;
    let mut filmed = Vec::new();
    for (NamedCamera { name: id, camera }, folder) in cameras.iter().zip(folders) {
        let files = sequence(&folder)?;
        let extension = extension(&files[0]).unwrap_or_default();
        for (k, file) in files.iter().enumerate() {
            let to = target.join(id).join(format!("{k:04}.{extension}"));
            let bytes = super::read_bytes(file)?;
            super::write(&to, &bytes)?;
        }
        let CameraFormat { width, height, model, params, cam_from_world } = camera.into();
        filmed.push(FilmedCameraFormat {
            id: id.clone(),
            frames: format!("{id}/%04d.{extension}"),
            width,
            height,
            model,
            params,
            cam_from_world,
            color: Color::Rgb,
            clock: ClockFormat {
                rate_hz: Some(clock.rate_hz),
                first_s: Some(clock.first_s),
                shared: clock.shared,
                ..ClockFormat::default()
            },
        });
    }
    let format = CaptureFormat {
        format: "stlfr-capture".into(),
        version: 1,
        name: target.file_name().map_or("imported".into(), |n| n.to_string_lossy().into_owned()),
        reference: None,
        cameras: filmed,
    };
    let path = target.join(CAPTURE_FILE);
    let mut text = serde_json::to_string_pretty(&format).map_err(|e| content(&path, e))?;
    text.push('\n');
    super::write(&path, text.as_bytes())
}

/// The cameras by id, in the order of their first image; the error is a reason.
fn one_each(cameras: &[NamedCamera]) -> Result<Vec<NamedCamera>, String> {
    let mut distinct: Vec<NamedCamera> = Vec::new();
    for NamedCamera { name, camera } in cameras {
        let id = id_of(name)?;
        let Some(known) = distinct.iter().find(|c| c.name == id) else {
            distinct.push(NamedCamera { name: id, camera: camera.clone() });
            continue;
        };
        let (a, b) = (&known.camera.cam_from_world, &camera.cam_from_world);
        let moved = (a.translation.vector - b.translation.vector).norm();
        let turned = a.rotation.angle_to(&b.rotation);
        if !(moved.max(turned) <= MAX_MOTION) || known.camera.model != camera.model {
            return Err(format!("{id} is not the same camera in all its images: it must not move"));
        }
    }
    Ok(distinct)
}

/// `cam0` of `cam0/0000.png` and of `images/cam0.png` and `cam0.png`; the error is a reason.
fn id_of(name: &str) -> Result<String, String> {
    let mut parts: Vec<&str> = name.split('/').filter(|p| !matches!(*p, "" | ".")).collect();
    if parts.len() > 1 && parts[0] == "images" {
        parts.remove(0);
    }
    let id = match parts.as_slice() {
        [file] => Path::new(file).file_stem().and_then(|s| s.to_str()).unwrap_or_default(),
        [folder, ..] => folder,
        [] => "",
    };
    let is_plain =
        !id.is_empty() && id != ".." && !id.contains(['\\', '%']) && !id.starts_with('.');
    if is_plain { Ok(id.to_owned()) } else { Err(format!("'{name}' can't name a camera")) }
}

/// The folder of each camera's images.
fn sequence_folders(cameras: &[NamedCamera], images: &Path) -> Result<Vec<PathBuf>, ExchangeError> {
    let by_name: Vec<PathBuf> = cameras.iter().map(|c| images.join(&c.name)).collect();
    if let Some(present) = by_name.iter().position(|p| p.is_dir()) {
        return match by_name.iter().position(|p| !p.is_dir()) {
            None => Ok(by_name),
            Some(k) => Err(content(
                images,
                format!("has a folder {}, and none {}", cameras[present].name, cameras[k].name),
            )),
        };
    }
    let mut folders: Vec<PathBuf> = entries(images)?.into_iter().filter(|p| p.is_dir()).collect();
    folders.sort();
    if folders.len() == cameras.len() {
        return Ok(folders);
    }
    let (present, wanted) = (folders.len(), cameras.len());
    Err(content(images, format!("has {present} folders for {wanted} cameras, none of their names")))
}

/// A folder's images, in the order of the numbers in their names.
fn sequence(folder: &Path) -> Result<Vec<PathBuf>, ExchangeError> {
    let mut files: Vec<PathBuf> = entries(folder)?
        .into_iter()
        .filter(|p| p.is_file() && extension(p).is_some_and(|e| EXTENSIONS.contains(&e.as_str())))
        .collect();
    let number = |path: &PathBuf| -> (u128, PathBuf) {
        let name = path.file_stem().map(|s| s.to_string_lossy().into_owned()).unwrap_or_default();
        let digits: String = name
            .chars()
            .rev()
            .skip_while(|c| !c.is_ascii_digit())
            .take_while(char::is_ascii_digit)
            .collect();
        let digits: String = digits.chars().rev().collect();
        (digits.parse().unwrap_or(0), path.clone())
    };
    files.sort_by_cached_key(number);
    let Some(first) = files.first() else { return Err(content(folder, "holds no images")) };
    if let Some(other) = files.iter().find(|p| extension(p) != extension(first)) {
        return Err(content(
            folder,
            format!("holds images of two kinds, like {}", other.display()),
        ));
    }
    Ok(files)
}

fn extension(path: &Path) -> Option<String> {
    Some(path.extension()?.to_str()?.to_ascii_lowercase())
}

fn entries(folder: &Path) -> Result<Vec<PathBuf>, ExchangeError> {
    let wrong = |source| ExchangeError::Read { path: folder.to_owned(), source };
    std::fs::read_dir(folder)
        .map_err(wrong)?
        .map(|entry| Ok(entry.map_err(wrong)?.path()))
        .collect()
}
