//! Finds the frames of each camera: a folder of images, a video, or images that a calibration lists with their times.

use super::pairing::{
    Pairs, entries, extension, id_of, is_image, is_same, numbers, one_each, pair, pair_by_table,
};
use super::request::ImportRequest;
use super::times::{RecordingTimes, TIMES_FILE, read_times, times_of};
use super::{ExchangeError, NamedCamera, content};
use crate::capture::{MAX_FRAMES, Opening};
use crate::host::open_file;
use crate::raster::read_header;
use crate::video::{DamagedVideo, VideoError, VideoFacts, find_intact, inspect};
use std::path::{Path, PathBuf};

/// A camera with its frames: the image files or the video, and the times.
pub(super) struct Footage {
    pub id: String,
    pub camera: NamedCamera,
    pub frames: FootageFrames,
    /// Times of the frames, in nanoseconds; `None` if the times are unknown.
    pub times_ns: Option<Vec<i64>>,
}

/// The files that hold a camera's frames.
pub(super) enum FootageFrames {
    /// Image files, in the order of the frames.
    Images(Vec<PathBuf>),
    Video(PathBuf, VideoFacts),
    /// A video of which only the intact frames are imported.
    Damaged(PathBuf, DamagedVideo),
}

impl FootageFrames {
    /// Returns the number of imported frames.
    pub fn len(&self) -> usize {
        match self {
            Self::Damaged(_, video) => video.intact.len(),
            _ => self.recorded(),
        }
    }

    /// Returns the number of recorded frames, with the damaged ones.
    fn recorded(&self) -> usize {
        match self {
            Self::Images(files) => files.len(),
            Self::Video(_, facts) | Self::Damaged(_, DamagedVideo { facts, .. }) => {
                facts.times_s.len()
            }
        }
    }

    /// Returns the values of the imported frames, from the values of all recorded frames.
    pub fn imported<T: Copy>(&self, recorded: Vec<T>) -> Vec<T> {
        match self {
            Self::Damaged(_, video) => video.intact.iter().map(|k| recorded[*k]).collect(),
            _ => recorded,
        }
    }

    /// Returns the indices of the imported frames among the recorded ones.
    pub fn indices(&self) -> Vec<usize> {
        self.imported((0..self.recorded()).collect())
    }

    /// Returns the image size and the time stamps of all recorded frames. `None` for images.
    pub fn facts(&self) -> Option<&VideoFacts> {
        match self {
            Self::Images(_) => None,
            Self::Video(_, facts) | Self::Damaged(_, DamagedVideo { facts, .. }) => Some(facts),
        }
    }

    /// Returns the path of the first image, or of the video.
    pub fn path(&self) -> &Path {
        match self {
            Self::Images(files) => &files[0],
            Self::Video(path, _) | Self::Damaged(path, _) => path,
        }
    }
}

/// The frames of all cameras, sentences for the user about these frames, and a flag that is true if all frame times are
/// on one clock.
pub(super) struct FoundFootage {
    pub footage: Vec<Footage>,
    pub notes: Vec<String>,
    pub has_one_clock: bool,
}

/// Finds the frames of all cameras. If the calibration has a time for every image, and the request has neither a table
/// nor a frame rate, the frames are the images that the calibration lists. Otherwise the request's table or [`pair`]
/// assigns a recording to each camera. `scratch` is a folder for temporary files.
pub(super) fn find(
    cameras: &[NamedCamera],
    request: &ImportRequest,
    opening: &Opening,
    scratch: &Path,
) -> Result<FoundFootage, ExchangeError> {
    let has_times = !cameras.is_empty() && cameras.iter().all(|c| c.time_ns.is_some());
    if has_times && request.table.is_none() && request.clock.rate_hz.is_none() {
        return listed(cameras, request.images);
    }
    let Pairs { cameras, recordings, mut notes } = match request.table {
        Some(table) => pair_by_table(cameras, request.images, table)?,
        None => pair(cameras, request.images)?,
    };
    let times = frame_times(request, &mut notes)?;
    let mut footage = Vec::new();
    for (camera, path) in cameras.into_iter().zip(recordings) {
        let frames = if path.is_dir() {
            FootageFrames::Images(sequence(&path)?)
        } else {
            let (frames, note) = video(&path, opening, scratch)?;
            notes.extend(note);
            frames
        };
        let times_ns = match &times {
            Some((file, times)) => {
                let times_ns = checked_times(file, times, &camera.name, frames.recorded())?;
                Some(frames.imported(times_ns))
            }
            None => None,
        };
        footage.push(Footage { id: camera.name.clone(), camera, frames, times_ns });
    }
    Ok(FoundFootage { footage, notes, has_one_clock: false })
}

/// Reads the frame times from the table that the request names, or else from `timestamps.csv` beside the images.
/// Returns the path of the file and the times. Returns `None` if neither file is given, or if the request's frame rate
/// replaces `timestamps.csv`. `notes` receives sentences for the user.
fn frame_times(
    request: &ImportRequest,
    notes: &mut Vec<String>,
) -> Result<Option<(PathBuf, RecordingTimes)>, ExchangeError> {
    let beside = request.images.join(TIMES_FILE);
    let file = match request.times {
        Some(file) => file.to_owned(),
        None if beside.is_file() && request.clock.rate_hz.is_some() => {
            notes.push(format!("{TIMES_FILE} is not used, for a rate is given."));
            return Ok(None);
        }
        None if beside.is_file() => {
            notes.push(format!("The frames' times are those of {TIMES_FILE}."));
            beside
        }
        None => return Ok(None),
    };
    let times = read_times(&file)?;
    Ok(Some((file, times)))
}

fn checked_times(
    file: &Path,
    times: &RecordingTimes,
    id: &str,
    frames: usize,
) -> Result<Vec<i64>, ExchangeError> {
    let times = times_of(times, id).map_err(|reason| content(file, reason))?;
    if times.len() == frames {
        return Ok(times.to_vec());
    }
    Err(content(file, format!("has {} times of {id} for {frames} frames", times.len())))
}

/// Reads the image size and the time stamps of a video with ffmpeg. If the video is damaged, finds the intact frames,
/// and returns a sentence for the user about them. `scratch` is a folder for temporary files.
fn video(
    path: &Path,
    opening: &Opening,
    scratch: &Path,
) -> Result<(FootageFrames, Option<String>), ExchangeError> {
    let unread = |source| ExchangeError::Read { path: path.to_owned(), source };
    let Some(ffmpeg) = opening.ffmpeg else {
        return Err(ExchangeError::NoFfmpeg { path: path.to_owned() });
    };
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    let _phase = opening.reporter.phase(&format!("reading {name}"));
    let file = open_file(path).map_err(unread)?;
    let reason = match inspect(ffmpeg, &file, scratch, MAX_FRAMES) {
        Ok(facts) => return Ok((FootageFrames::Video(path.to_owned(), facts), None)),
        Err(VideoError::Damaged { reason }) => reason,
        Err(error) => return Err(of_video(path, error)),
    };
    let found = find_intact(ffmpeg, &file, scratch, MAX_FRAMES);
    let video =
        found.map_err(|error| of_video(path, error))?.ok_or_else(|| content(path, reason))?;
    let frames = video.facts.times_s.len();
    let note = match frames - video.intact.len() {
        0 => format!("{name}: the file is damaged, but none of its {frames} frames is."),
        1 => format!("{name}: 1 of {frames} frames is damaged and left out."),
        damaged => format!("{name}: {damaged} of {frames} frames are damaged and left out."),
    };
    Ok((FootageFrames::Damaged(path.to_owned(), video), Some(note)))
}

/// Converts an error about the video at `path`.
pub(super) fn of_video(path: &Path, error: VideoError) -> ExchangeError {
    match error {
        VideoError::File { path, source } => ExchangeError::Write { path, source },
        error => content(path, error),
    }
}

/// Returns the width and the height of a camera's images, in pixels.
pub(super) fn image_size(frames: &FootageFrames) -> Result<[usize; 2], ExchangeError> {
    if let Some(facts) = frames.facts() {
        return Ok(facts.size);
    }
    let path = frames.path();
    let header = read_header(path).map_err(|error| {
        let message = error.to_string();
        let prefix = format!("{}: ", path.display());
        content(path, message.strip_prefix(&prefix).unwrap_or(&message))
    })?;
    Ok([header.width as usize, header.height as usize])
}

/// Returns the image files of a folder, sorted by the last number in each name. Numbers that are not consecutive are an
/// error.
fn sequence(folder: &Path) -> Result<Vec<PathBuf>, ExchangeError> {
    let mut files = entries(folder)?;
    files.retain(|path| is_image(path));
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

/// Returns the last number in a file's name without extension; 0 if this name has no digits. The caller adds the file's
/// name to the error message.
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

/// Groups the images of a calibration by their cameras, and sorts the images of each camera by time.
fn listed(images: &[NamedCamera], folder: &Path) -> Result<FoundFootage, ExchangeError> {
    let wrong = |reason: String| content(folder, reason);
    let mut notes = vec!["The frames' times are those of the calibration, as of one clock.".into()];
    let groups = grouped(images, &mut notes).map_err(wrong)?;
    let mut footage = Vec::new();
    for (id, mut members) in groups {
        members.sort_by_key(|image| image.time_ns);
        let files = members.iter().map(|image| listed_file(folder, &image.name));
        let files = files.collect::<Result<Vec<_>, _>>().map_err(wrong)?;
        if let Some(other) = files.iter().find(|file| extension(file) != extension(&files[0])) {
            return Err(wrong(format!("holds images of two kinds, like {}", other.display())));
        }
        let times_ns = members.iter().filter_map(|image| image.time_ns).collect();
        footage.push(Footage {
            id,
            camera: members[0].clone(),
            frames: FootageFrames::Images(files),
            times_ns: Some(times_ns),
        });
    }
    Ok(FoundFootage { footage, notes, has_one_clock: true })
}

/// Returns the path of an image that a calibration lists as `name`. Names in NeRF's `transforms.json` may lack the
/// extension `.png`, which is then added.
fn listed_file(folder: &Path, name: &str) -> Result<PathBuf, String> {
    let path = folder.join(name);
    let with_png = folder.join(format!("{name}.png"));
    let found = [path, with_png].into_iter().find(|path| path.is_file() && is_image(path));
    found.ok_or_else(|| format!("has no image '{}'", crate::text::short(name)))
}

/// Groups the images of a calibration by camera. Returns each camera's id with its images. Images with the same camera
/// id in their names are one group. If no two images have the same id, images with the same pose and lens are one
/// group. The caller adds the folder's name to the error message.
fn grouped(
    images: &[NamedCamera],
    notes: &mut Vec<String>,
) -> Result<Vec<(String, Vec<NamedCamera>)>, String> {
    let cameras = one_each(images)?;
    let mut groups: Vec<(String, Vec<NamedCamera>)> = Vec::new();
    if cameras.len() < images.len() {
        for camera in cameras {
            let is_its = |image: &&NamedCamera| id_of(&image.name).as_ref() == Ok(&camera.name);
            let members = images.iter().filter(is_its).cloned().collect();
            groups.push((camera.name, members));
        }
        return Ok(groups);
    }
    for image in images {
        match groups.iter_mut().find(|(_, group)| is_same(&group[0].camera, &image.camera)) {
            Some((_, group)) => group.push(image.clone()),
            None => groups.push((String::new(), vec![image.clone()])),
        }
    }
    let is_at_one_time = images.iter().all(|image| image.time_ns == images[0].time_ns);
    if groups.len() == images.len() && !is_at_one_time {
        return Err("has no camera with two frames: cameras must not move".into());
    }
    let ids: Vec<String> = groups.iter().map(|(_, group)| common_name(group)).collect();
    let are_ids = ids.iter().enumerate().all(|(k, id)| !id.is_empty() && !ids[..k].contains(id));
    for (k, (id, _)) in groups.iter_mut().enumerate() {
        *id = if are_ids { ids[k].clone() } else { format!("cam{k}") };
    }
    let (first, count) = (&groups[0].0, groups.len());
    notes.push(format!(
        "Images of one pose and lens are one camera: {count} cameras, from {first} on."
    ));
    Ok(groups)
}

/// Returns the common prefix of the names of a camera's images, without the frame number at its end.
fn common_name(group: &[NamedCamera]) -> String {
    let stem = |image: &NamedCamera| id_of(&image.name).unwrap_or_default();
    let mut common = stem(&group[0]);
    for image in group {
        let stem = stem(image);
        while !stem.starts_with(&common) {
            common.pop();
        }
    }
    // Digits at the end belong to the number of the frame, and are removed.
    if group.len() > 1 || numbers(&common).len() > 1 {
        common.truncate(common.trim_end_matches(|c: char| c.is_ascii_digit()).len());
    }
    common.trim_end_matches(|c: char| !c.is_alphanumeric()).to_owned()
}
