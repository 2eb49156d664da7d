//! Pairs the cameras of a calibration with the folders of their images: by name, else by the numbers in the names.

use super::{ExchangeError, NamedCamera, content};
use crate::text::check_id;
use std::fs::DirEntry;
use std::path::{Path, PathBuf};

/// Pose difference between two images of a camera above which it counts as moving, metres and radians.
const MAX_MOTION: f64 = 1e-6;

/// Cameras, named by their ids, with the folder of each camera's images.
pub(super) struct Pairs {
    pub cameras: Vec<NamedCamera>,
    pub folders: Vec<PathBuf>,
    /// A sentence that says how they were paired, unless by name.
    pub note: Option<String>,
}

/// Pairs the cameras of a calibration with the sub-folders of `images`. If the calibration has mere row numbers, the
/// folders' names become the ids.
///
/// # Errors
/// A moving camera, a name that can't be an id. If some cameras have a folder of their name and others have none.
/// Without any, if the numbers in the names leave the order open.
pub(super) fn pair(cameras: &[NamedCamera], images: &Path) -> Result<Pairs, ExchangeError> {
    let is_nameless = cameras.iter().enumerate().all(|(row, c)| c.name == row.to_string());
    let cameras = one_each(cameras).map_err(|reason| content(images, reason))?;
    let by_name: Vec<PathBuf> = cameras.iter().map(|camera| images.join(&camera.name)).collect();
    let present = by_name.iter().position(|folder| folder.is_dir()).filter(|_| !is_nameless);
    let Some(present) = present else { return pair_by_number(cameras, is_nameless, images) };
    match by_name.iter().position(|folder| !folder.is_dir()) {
        None => Ok(Pairs { cameras, folders: by_name, note: None }),
        Some(missing) => {
            let [present, missing] = [present, missing].map(|k| &cameras[k].name);
            Err(content(images, format!("has a folder {present}, and none {missing}")))
        }
    }
}

fn pair_by_number(
    mut cameras: Vec<NamedCamera>,
    is_nameless: bool,
    images: &Path,
) -> Result<Pairs, ExchangeError> {
    let mut folders = entries(images)?;
    folders.retain(|path| path.is_dir());
    let (found, wanted) = (folders.len(), cameras.len());
    if found != wanted {
        let names = if is_nameless { "" } else { ", none of their names" };
        return Err(content(images, format!("has {found} folders for {wanted} cameras{names}")));
    }
    let mut names: Vec<String> = folders.iter().map(|folder| file_name(folder)).collect();
    let Some(order) = numbered_order(&names) else {
        let reason =
            "has folders whose names leave their order open: they must differ in numbers alone";
        return Err(content(images, reason));
    };
    (folders, names) = order.iter().map(|&k| (folders[k].clone(), names[k].clone())).unzip();
    let (first, last) = (&names[0], &names[wanted - 1]);
    let note = if is_nameless {
        for (camera, name) in cameras.iter_mut().zip(&names) {
            check_id(name)
                .map_err(|reason| content(images, format!("a folder's name {reason}")))?;
            camera.name.clone_from(name);
        }
        format!(
            "The calibration has no names; its rows are the folders by number, {first} to {last}."
        )
    } else {
        let ids: Vec<String> = cameras.iter().map(|camera| camera.name.clone()).collect();
        let order = numbered_order(&ids).unwrap_or_default();
        if !order.iter().map(|&k| numbers(&ids[k])).eq(names.iter().map(|name| numbers(name))) {
            return Err(content(images, format!("has folders like {first}, and none {}", ids[0])));
        }
        cameras = order.iter().map(|&k| cameras[k].clone()).collect();
        format!("Cameras and folders are paired by number: {} is {first}.", ids[order[0]])
    };
    Ok(Pairs { cameras, folders, note: Some(note) })
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

fn file_name(path: &Path) -> String {
    path.file_name().unwrap_or_default().to_string_lossy().into_owned()
}

/// The order of names by their numbers, `cam2` before `cam10`. `None` if two names differ in more than numbers, or have
/// the same numbers.
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

/// The numbers in a name, each as its digits and, ahead of them, their count: of any length, in ascending order.
fn numbers(name: &str) -> Vec<(usize, &str)> {
    let digits = name.split(|c: char| !c.is_ascii_digit()).filter(|digits| !digits.is_empty());
    digits.map(|digits| digits.trim_start_matches('0')).map(|d| (d.len(), d)).collect()
}

/// Entries of a folder.
pub(super) fn all_entries(folder: &Path) -> Result<Vec<DirEntry>, ExchangeError> {
    std::fs::read_dir(folder)
        .and_then(Iterator::collect)
        .map_err(|source| ExchangeError::Read { path: folder.to_owned(), source })
}

/// Paths of a folder's entries, without hidden files.
pub(super) fn entries(folder: &Path) -> Result<Vec<PathBuf>, ExchangeError> {
    let mut entries = all_entries(folder)?;
    entries.retain(|entry| !entry.file_name().as_encoded_bytes().starts_with(b"."));
    Ok(entries.iter().map(DirEntry::path).collect())
}
