//! Makes a capture from a calibration and a folder of image sequences.

use super::{ExchangeError, NamedCamera, content};
use crate::camera::CameraFormat;
use crate::capture::{
    CAPTURE_FILE, Capture, CaptureFormat, ClockFormat, Color, FilmedCameraFormat,
};
use crate::host::temporary::Temporary;
use crate::host::{open_file, write_json};
use crate::text::check_id;
use std::fs::{DirEntry, File};
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
/// Pose difference between two images of a camera above which it counts as moving, metres and radians.
const MAX_MOTION: f64 = 1e-6;

/// Makes the capture `target` from a calibration, and copies the sequences in `images` into it. The
/// target appears only once it is complete and can be opened.
///
/// A camera's id is the first folder of its name, or its name without extension. Its sequence is the
/// sub-folder of `images` with that id, sorted by the numbers in the file names. If no sub-folder has a
/// camera's id, sub-folders are assigned to cameras in order. All images of one folder belong to one
/// camera.
///
/// Errors: a target that is not empty, a moving camera, a sequence of mixed image types or with a gap, a
/// capture that can't be opened.
pub fn import(
    cameras: &[NamedCamera],
    images: &Path,
    clock: ImportClock,
    target: &Path,
) -> Result<(), ExchangeError> {
    let failed = |source| ExchangeError::Write { path: target.to_owned(), source };
    if target.symlink_metadata().is_ok() && !all_entries(target)?.is_empty() {
        return Err(content(target, "holds files already, which are not written over"));
    }
    let cameras = one_each(cameras).map_err(|reason| content(target, reason))?;
    let folders = sequence_folders(&cameras, images)?;
    let sequences: Vec<Vec<PathBuf>> =
        folders.iter().map(|folder| sequence(folder)).collect::<Result<_, _>>()?;

    let absolute = std::path::absolute(target).map_err(failed)?;
    let beside = absolute.parent().ok_or_else(|| content(target, "names no folder"))?;
    let temporary = Temporary::inside(beside).map_err(failed)?;
    let whole = temporary.path().join(WHOLE);
    let mut filmed = Vec::new();
    for (camera, files) in cameras.iter().zip(&sequences) {
        copy(files, &whole.join(&camera.name), target)?;
        filmed.push(described(camera, files, clock));
    }
    let format = CaptureFormat {
        format: "stlfr-capture".into(),
        version: 1,
        name: absolute.file_name().map_or("imported".into(), |n| n.to_string_lossy().into_owned()),
        reference: None,
        cameras: filmed,
    };
    write_json(&whole.join(CAPTURE_FILE), &format).map_err(failed)?;
    // Opened here, so that an invalid capture fails the import and not a later command.
    Capture::open(&whole).map_err(|error| {
        let message = error.to_string();
        let path = format!("{}/", whole.display());
        content(target, message.strip_prefix(&path).unwrap_or(&message))
    })?;
    temporary.place(WHOLE, target).map_err(failed)
}

/// Name of the capture inside its temporary folder.
const WHOLE: &str = "capture";

/// Copies the files of a sequence into a new folder, numbered from 0, for the capture `target`.
fn copy(files: &[PathBuf], folder: &Path, target: &Path) -> Result<(), ExchangeError> {
    let extension = extension(&files[0]).unwrap_or_default();
    for (k, path) in files.iter().enumerate() {
        let copied = std::fs::create_dir_all(folder).and_then(|()| {
            let mut to = File::create(folder.join(format!("{k:04}.{extension}")))?;
            std::io::copy(&mut open_file(path)?, &mut to)?;
            to.sync_all()
        });
        let to = target.to_owned();
        copied.map_err(|source| ExchangeError::Copy { path: path.clone(), to, source })?;
    }
    Ok(())
}

fn described(
    NamedCamera { name: id, camera }: &NamedCamera,
    files: &[PathBuf],
    clock: ImportClock,
) -> FilmedCameraFormat {
    let CameraFormat { width, height, model, params, cam_from_world } = camera.into();
    let extension = extension(&files[0]).unwrap_or_default();
    FilmedCameraFormat {
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
    }
}

/// Merges all images of a camera into one entry, named by the camera's id, in the order of the first images. The error
/// is a reason.
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

/// The camera id in an image name: `cam0` in `cam0/0000.png`, `images/cam0.png` and `cam0.png`.
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
    if id.starts_with('.') {
        return Err(format!("'{name}' can't name a camera: '{id}' is a hidden folder"));
    }
    check_id(id).map_err(|reason| format!("'{name}' can't name a camera: {reason}"))?;
    Ok(id.to_owned())
}

/// The folder of each camera's images.
fn sequence_folders(cameras: &[NamedCamera], images: &Path) -> Result<Vec<PathBuf>, ExchangeError> {
    let by_name: Vec<PathBuf> = cameras.iter().map(|c| images.join(&c.name)).collect();
    if let Some(present) = by_name.iter().position(|p| p.is_dir()) {
        return match by_name.iter().position(|p| !p.is_dir()) {
            None => Ok(by_name),
            Some(k) => {
                let [present, missing] = [present, k].map(|k| &cameras[k].name);
                Err(content(images, format!("has a folder {present}, and none {missing}")))
            }
        };
    }
    let mut folders: Vec<PathBuf> = entries(images)?;
    folders.retain(|p| p.is_dir());
    folders.sort();
    if folders.len() == cameras.len() {
        return Ok(folders);
    }
    let (present, wanted) = (folders.len(), cameras.len());
    Err(content(images, format!("has {present} folders for {wanted} cameras, none of their names")))
}

/// Images of a folder, sorted by the numbers in their names, which must be consecutive.
fn sequence(folder: &Path) -> Result<Vec<PathBuf>, ExchangeError> {
    let mut files = entries(folder)?;
    files.retain(|p| extension(p).is_some_and(|e| EXTENSIONS.contains(&e.as_str())));
    if let Some(other) = files.iter().find(|p| !p.is_file()) {
        return Err(content(other, "has an image's name and is no regular file"));
    }
    let mut numbered = Vec::new();
    for file in files {
        numbered.push((number(&file).map_err(|reason| content(&file, reason))?, file));
    }
    numbered.sort();
    let Some((_, first)) = numbered.first() else { return Err(content(folder, "holds no images")) };
    if let Some((_, other)) = numbered.iter().find(|(_, p)| extension(p) != extension(first)) {
        let reason = format!("holds images of two kinds, like {}", other.display());
        return Err(content(folder, reason));
    }
    if let Some(k) = numbered.windows(2).position(|w| w[0].0 + 1 != w[1].0) {
        let [a, b] = [k, k + 1].map(|k| numbered[k].1.file_name().unwrap_or_default().display());
        let rule = "must follow each other, for every frame counts";
        return Err(content(folder, format!("the numbers of {a} and {b} {rule}")));
    }
    Ok(numbered.into_iter().map(|(_, file)| file).collect())
}

/// The last number in a file's stem, 0 without one; the error is a reason.
fn number(file: &Path) -> Result<u64, String> {
    let stem = file.file_stem().unwrap_or_default().to_string_lossy();
    let is_other = |c: char| !c.is_ascii_digit();
    let digits = stem.trim_end_matches(is_other).rsplit(is_other).next().unwrap_or_default();
    if digits.is_empty() {
        return Ok(0);
    }
    let number = digits.parse().ok().filter(|n| *n < u64::MAX);
    number.ok_or_else(|| format!("the number {digits} in its name is too large to count frames"))
}

fn extension(path: &Path) -> Option<String> {
    Some(path.extension()?.to_str()?.to_ascii_lowercase())
}

/// Entries of a folder.
fn all_entries(folder: &Path) -> Result<Vec<DirEntry>, ExchangeError> {
    std::fs::read_dir(folder)
        .and_then(Iterator::collect)
        .map_err(|source| ExchangeError::Read { path: folder.to_owned(), source })
}

/// Paths of a folder's entries, without hidden files.
fn entries(folder: &Path) -> Result<Vec<PathBuf>, ExchangeError> {
    let mut entries = all_entries(folder)?;
    entries.retain(|entry| !entry.file_name().as_encoded_bytes().starts_with(b"."));
    Ok(entries.iter().map(DirEntry::path).collect())
}
