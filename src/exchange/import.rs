//! Makes a capture from a calibration and a folder of image sequences.

use super::pairing::{Pairs, all_entries, entries, pair};
use super::{ExchangeError, NamedCamera, content};
use crate::camera::CameraFormat;
use crate::capture::{
    CAPTURE_FILE, Capture, CaptureFormat, ClockFormat, Color, FilmedCameraFormat,
};
use crate::host::temporary::Temporary;
use crate::host::{open_file, write_json};
use std::fs::File;
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

/// Makes the capture `target` from a calibration, and copies the sequences in `images` into it. The
/// target appears only once it is complete and can be opened.
///
/// A camera's id is the first folder of its name, or its name without extension. Its sequence is the
/// sub-folder of `images` with that id, sorted by the numbers in the file names. If no sub-folder has a
/// camera's id, the numbers in the names pair cameras and folders. A calibration without names has the
/// folders' names as ids, in the order of their numbers. All images of one folder belong to one camera.
///
/// Returns a sentence that says how cameras were paired, unless by name.
///
/// Errors: a target that is not empty, a moving camera, folders whose pairing is ambiguous, a sequence of mixed
/// image types or with a gap, a capture that can't be opened.
pub fn import(
    cameras: &[NamedCamera],
    images: &Path,
    clock: ImportClock,
    target: &Path,
) -> Result<Option<String>, ExchangeError> {
    let failed = |source| ExchangeError::Write { path: target.to_owned(), source };
    if target.symlink_metadata().is_ok() && !all_entries(target)?.is_empty() {
        return Err(content(target, "holds files already, which are not written over"));
    }
    let Pairs { cameras, folders, note } = pair(cameras, images)?;
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
    temporary.place(WHOLE, target).map_err(failed)?;
    Ok(note)
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
