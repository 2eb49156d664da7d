//! Pairing of the cameras of a calibration with recordings (videos or folders of images): by a table, by name, or by
//! the numbers in the names.

use super::csv::read_columns;
use super::{ExchangeError, NamedCamera, checked, content};
use crate::camera::{Camera, CameraModel};
use crate::text::{check_id, short};
use nalgebra::Isometry3;
use std::fs::DirEntry;
use std::path::{Path, PathBuf};

/// Largest difference between the poses of a static camera's images: the distance in metres, and the rotation angle in
/// radians. Above this difference, the camera counts as moving.
const MAX_MOTION: f64 = 1e-6;

/// File extensions of videos.
const VIDEOS: [&str; 20] = [
    "mkv", "mp4", "mov", "avi", "webm", "m4v", "mts", "m2ts", "ts", "mpg", "mpeg", "mxf", "3gp",
    "3g2", "ogv", "wmv", "flv", "y4m", "nut", "ivf",
];

/// Result of pairing: the cameras, named by their ids, and for each camera the folder or the video of its frames.
pub(super) struct Pairs {
    pub cameras: Vec<NamedCamera>,
    pub recordings: Vec<PathBuf>,
    /// Sentences for the user. They say how cameras and recordings were paired by number, and which cameras or
    /// recordings have no partner and are therefore not imported.
    pub notes: Vec<String>,
}

/// A recording, which is a folder of images or a video. Its name has no extension.
struct NamedRecording {
    name: String,
    path: PathBuf,
}

/// Pairs the cameras of a calibration with the recordings in the folder `images`: its videos and its sub-folders of
/// images. A camera is paired with the recording of the same name. If no camera has such a recording, cameras and
/// recordings are paired by the numbers in their names. If the calibration has only row numbers, the names of the
/// recordings become the ids.
///
/// # Errors
/// A camera that moves; a name that can't be an id; a camera with two recordings; some cameras with a recording of
/// their name, and some without. For pairing by number: unequal numbers of cameras and recordings, or names that differ
/// in more than numbers.
pub(super) fn pair(cameras: &[NamedCamera], images: &Path) -> Result<Pairs, ExchangeError> {
    let is_nameless = is_nameless(cameras);
    let cameras = one_each(cameras).map_err(|reason| content(images, reason))?;
    let recordings = recordings(images)?;
    let is_present = |camera: &NamedCamera| recordings.iter().any(|r| r.name == camera.name);
    let present = cameras.iter().position(is_present).filter(|_| !is_nameless);
    let Some(present) = present else {
        return pair_by_number(cameras, recordings, is_nameless, images);
    };
    let mut paths = Vec::new();
    for camera in &cameras {
        let mut found = recordings.iter().filter(|r| r.name == camera.name);
        let Some(first) = found.next() else {
            let [present, missing] = [&cameras[present].name, &camera.name];
            let reason = format!("has a recording {present}, and none {missing}");
            return Err(content(images, reason));
        };
        if let Some(second) = found.next() {
            let [a, b] = [first, second].map(|r| file_name(&r.path));
            return Err(content(images, format!("has two recordings of one camera, {a} and {b}")));
        }
        paths.push(first.path.clone());
    }
    let left = recordings.iter().filter(|r| !paths.contains(&r.path) && is_footage(&r.path));
    let left: Vec<String> = left.map(|r| file_name(&r.path)).collect();
    let notes = if left.is_empty() {
        Vec::new()
    } else {
        vec![format!("The calibration has no camera for {}; not imported.", left.join(", "))]
    };
    Ok(Pairs { cameras, recordings: paths, notes })
}

/// Returns an uncalibrated camera for each recording in the folder `images`. A camera has the name of its recording,
/// and placeholders for lens and pose. Cameras are sorted by the numbers in their names. If this order is ambiguous,
/// they are sorted by name.
///
/// # Errors
/// Fewer than two recordings, a name that can't be an id, or two recordings with the same name.
pub(super) fn uncalibrated(images: &Path) -> Result<Vec<NamedCamera>, ExchangeError> {
    let recordings = recordings(images)?.into_iter().filter(|r| is_footage(&r.path));
    let mut names: Vec<String> = recordings.map(|r| r.name).collect();
    if names.len() < 2 {
        let found = names.len();
        let reason =
            format!("holds {found} videos and folders of images; a camera array has two or more");
        return Err(content(images, reason));
    }
    if let Some(order) = numbered_order(&names) {
        names = order.into_iter().map(|k| names[k].clone()).collect();
    }
    let named = |(k, name): (usize, &String)| {
        check_id(name).map_err(|reason| content(images, format!("a recording's name {reason}")))?;
        if names[..k].contains(name) {
            return Err(content(images, format!("has two recordings of one camera, {name}")));
        }
        let model = CameraModel::Pinhole { fx: 1.0, fy: 1.0, cx: 0.5, cy: 0.5 };
        let camera = checked((1, 1), &model, &Isometry3::identity());
        let camera = camera.map_err(|reason| content(images, reason))?;
        Ok(NamedCamera { name: name.clone(), time_ns: None, camera })
    };
    names.iter().enumerate().map(named).collect()
}

/// Pairs cameras with recordings by a CSV table with the columns `camera` and `frames`. `camera` is the name of a
/// camera. If the calibration has no names, `camera` is a row number from 0, and the name of the recording becomes the
/// id. `frames` is a folder or a video in `images`.
///
/// # Errors
/// A camera that is unknown or listed twice, or a recording that is missing.
pub(super) fn pair_by_table(
    cameras: &[NamedCamera],
    images: &Path,
    table: &Path,
) -> Result<Pairs, ExchangeError> {
    let is_nameless = is_nameless(cameras);
    let known = one_each(cameras).map_err(|reason| content(images, reason))?;
    let mut pairs = Pairs { cameras: Vec::new(), recordings: Vec::new(), notes: Vec::new() };
    let mut listed: Vec<String> = Vec::new();
    read_columns(table, [&["camera"], &["frames", "video", "images"]], |_, [name, frames]| {
        let camera = known.iter().find(|c| c.name == name);
        let mut camera =
            camera.ok_or_else(|| format!("there is no camera '{}'", short(name)))?.clone();
        if listed.iter().any(|other| other == name) {
            return Err(format!("there is a camera '{}' already", short(name)));
        }
        let path = images.join(frames);
        if !path.is_dir() && !path.is_file() {
            return Err(format!("there is no '{}' in {}", short(frames), images.display()));
        }
        if is_nameless {
            camera.name = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
            check_id(&camera.name).map_err(|reason| format!("the recording's name {reason}"))?;
        }
        listed.push(name.to_owned());
        pairs.cameras.push(camera);
        pairs.recordings.push(path);
        Ok(())
    })?;
    if pairs.cameras.is_empty() {
        return Err(content(table, "lists no camera"));
    }
    let left = known.iter().filter(|c| !listed.contains(&c.name)).map(|c| c.name.clone());
    let left: Vec<String> = left.collect();
    if !left.is_empty() {
        pairs.notes.push(format!("The table has no camera {}; not imported.", left.join(", ")));
    }
    Ok(pairs)
}

/// Returns whether the calibration has no names, so that cameras are named by their row numbers.
fn is_nameless(cameras: &[NamedCamera]) -> bool {
    cameras.iter().enumerate().all(|(row, c)| c.name == row.to_string())
}

/// Returns the sub-folders and videos of a folder, sorted by name.
fn recordings(images: &Path) -> Result<Vec<NamedRecording>, ExchangeError> {
    let mut paths = entries(images)?;
    paths.sort();
    let recording = |path: PathBuf| {
        let name = if path.is_dir() {
            file_name(&path)
        } else if is_video(&path) {
            path.file_stem()?.to_string_lossy().into_owned()
        } else {
            return None;
        };
        Some(NamedRecording { name, path })
    };
    Ok(paths.into_iter().filter_map(recording).collect())
}

/// Returns whether a path is a file with the extension of a video.
fn is_video(path: &Path) -> bool {
    extension(path).is_some_and(|e| VIDEOS.contains(&e.as_str())) && path.is_file()
}

/// Returns whether a path is a recording: a video, or a folder that contains images.
fn is_footage(path: &Path) -> bool {
    is_video(path) || entries(path).is_ok_and(|files| files.iter().any(|file| is_image(file)))
}

fn pair_by_number(
    mut cameras: Vec<NamedCamera>,
    recordings: Vec<NamedRecording>,
    is_nameless: bool,
    images: &Path,
) -> Result<Pairs, ExchangeError> {
    let (found, wanted) = (recordings.len(), cameras.len());
    if found != wanted {
        let names = if is_nameless { "" } else { ", none of their names" };
        return Err(content(
            images,
            format!("has {found} folders and videos for {wanted} cameras{names}"),
        ));
    }
    let names: Vec<String> = recordings.iter().map(|r| r.name.clone()).collect();
    let Some(order) = numbered_order(&names) else {
        let reason = "has folders or videos whose names leave their order open: they must differ in numbers alone";
        return Err(content(images, reason));
    };
    let (names, recordings): (Vec<String>, Vec<PathBuf>) =
        order.iter().map(|&k| (names[k].clone(), recordings[k].path.clone())).unzip();
    let (first, last) = (&names[0], &names[wanted - 1]);
    let note = if is_nameless {
        for (camera, name) in cameras.iter_mut().zip(&names) {
            check_id(name)
                .map_err(|reason| content(images, format!("a recording's name {reason}")))?;
            camera.name.clone_from(name);
        }
        format!(
            "The calibration has no names; its rows are the recordings by number, {first} to {last}."
        )
    } else {
        let ids: Vec<String> = cameras.iter().map(|camera| camera.name.clone()).collect();
        let order = numbered_order(&ids).unwrap_or_default();
        if !order.iter().map(|&k| numbers(&ids[k])).eq(names.iter().map(|name| numbers(name))) {
            return Err(content(
                images,
                format!("has recordings like {first}, and none {}", ids[0]),
            ));
        }
        cameras = order.iter().map(|&k| cameras[k].clone()).collect();
        format!("Cameras and recordings are paired by number: {} is {first}.", ids[order[0]])
    };
    Ok(Pairs { cameras, recordings, notes: vec![note] })
}

/// Merges all entries of a calibration that are images of the same camera into one entry, named by the camera's id. The
/// cameras have the order of their first images. A camera that moves is an error. The caller adds the file's name to
/// the error message.
pub(super) fn one_each(cameras: &[NamedCamera]) -> Result<Vec<NamedCamera>, String> {
    let mut distinct: Vec<NamedCamera> = Vec::new();
    for NamedCamera { name, camera, .. } in cameras {
        let id = id_of(name)?;
        let Some(known) = distinct.iter().find(|c| c.name == id) else {
            distinct.push(NamedCamera { name: id, time_ns: None, camera: camera.clone() });
            continue;
        };
        if !is_same(&known.camera, camera) {
            return Err(format!("{id} is not the same camera in all its images: it must not move"));
        }
    }
    Ok(distinct)
}

/// Returns whether two images are from the same static camera, that is, whether poses, sizes and lenses are equal.
pub(super) fn is_same(a: &Camera, b: &Camera) -> bool {
    let (from, to) = (&a.cam_from_world, &b.cam_from_world);
    let moved = (from.translation.vector - to.translation.vector).norm();
    let turned = from.rotation.angle_to(&to.rotation);
    moved.max(turned) <= MAX_MOTION
        && a.model == b.model
        && [a.width, a.height] == [b.width, b.height]
}

/// Returns the camera id in an image name: `cam0` for `cam0/0000.png`, `images/cam0.png` and `cam0.png`.
pub(super) fn id_of(name: &str) -> Result<String, String> {
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

fn file_name(path: &Path) -> String {
    path.file_name().unwrap_or_default().to_string_lossy().into_owned()
}

/// Returns the indices that sort names by their numbers, so that `cam2` is before `cam10`. Returns `None` if two names
/// differ in more than their numbers, or have the same numbers.
pub(super) fn numbered_order(names: &[String]) -> Option<Vec<usize>> {
    let text = |name: &str| {
        let mark = |c: char| if c.is_ascii_digit() { '0' } else { c };
        let mut text: Vec<char> = name.chars().map(mark).collect();
        text.dedup_by(|a, b| (*a, *b) == ('0', '0'));
        text
    };
    let first = names.first().map(|name| text(name));
    let mut order: Vec<usize> = (0..names.len()).collect();
    order.sort_by_cached_key(|&k| numbers(&names[k]));
    let is_same = |pair: &[usize]| numbers(&names[pair[0]]) == numbers(&names[pair[1]]);
    let is_open =
        names.iter().any(|name| Some(text(name)) != first) || order.windows(2).any(is_same);
    (!is_open).then_some(order)
}

/// Returns all runs of digits in a name as numbers. Each number is a pair: how many digits it has, and the digits
/// themselves, without leading zeros. In this form, numbers of any length sort by their values.
pub(super) fn numbers(name: &str) -> Vec<(usize, &str)> {
    let digits = name.split(|c: char| !c.is_ascii_digit()).filter(|digits| !digits.is_empty());
    digits.map(|digits| digits.trim_start_matches('0')).map(|d| (d.len(), d)).collect()
}

/// Returns all entries of a folder, including hidden ones.
pub(super) fn all_entries(folder: &Path) -> Result<Vec<DirEntry>, ExchangeError> {
    std::fs::read_dir(folder)
        .and_then(Iterator::collect)
        .map_err(|source| ExchangeError::Read { path: folder.to_owned(), source })
}

/// Returns the paths of a folder's entries, except hidden ones.
pub(super) fn entries(folder: &Path) -> Result<Vec<PathBuf>, ExchangeError> {
    let mut entries = all_entries(folder)?;
    entries.retain(|entry| !entry.file_name().as_encoded_bytes().starts_with(b"."));
    Ok(entries.iter().map(DirEntry::path).collect())
}

/// File extensions of images.
const IMAGES: [&str; 7] = ["png", "jpg", "jpeg", "pgm", "ppm", "pnm", "pbm"];

/// Returns whether a path has the extension of an image.
pub(super) fn is_image(path: &Path) -> bool {
    extension(path).is_some_and(|e| IMAGES.contains(&e.as_str()))
}

/// Returns the extension of a path in lower case; `None` if the path has no extension.
pub(super) fn extension(path: &Path) -> Option<String> {
    Some(path.extension()?.to_str()?.to_ascii_lowercase())
}
