//! A camera's video, decoded into `CAPTURE/.stlfr/video/` and read from there as an image sequence.
//!
//! A folder there is named after its video's content and appears when it is complete. It may be
//! deleted at any time: the video is then decoded anew. So it is, with a note, where a frame is not what
//! was decoded: `frames.json`, a cache file with a checksum of its own, has every frame's hash, and all are compared when
//! the capture is opened, if any file has changed since the last time. One process decodes a video, and others wait.
//!
//! Any kind of video that ffmpeg 5.1 or newer reads may be a camera's `frames`. The clock stays in
//! `capture.json`, because containers round their time stamps (Matroska to 1 ms). A `rate_hz` that the
//! file contradicts is refused; the message names the file that lists the video's own `times_s`.
//!
//! Known limits: folders of deleted videos stay.

use super::{CaptureError, Opening};
use crate::host::temporary::Temporary;
use crate::host::{cache_file, hash_file, link_within, open_file, remembered, remove_special};
use crate::video::{self, VideoError, frame_name};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::fs::File;
use std::io;
use std::os::unix::fs::OpenOptionsExt;
use std::path::{Path, PathBuf};

/// Frames of one camera that a simulated rig films, and that a video is decoded to. Larger: a crafted
/// video or a typing error fills the disk. Smaller: an hour at 24 Hz is refused.
pub const MAX_FRAMES: usize = 100_000;

/// Part of the cache's key: changed whenever the same video is decoded to other pixels.
const DECODING: &[u8] = b"stlfr-video-1";

/// The folder of all decoded videos inside a capture.
const CACHE: &str = ".stlfr/video";

/// Lists a folder's frames. It is written last.
const INDEX_FILE: &str = "frames.json";
/// Extension of the file beside a folder that remembers the hashes of its frames. Inside, it would be written while
/// another process replaces the folder.
const HASHES_EXTENSION: &str = "hashes.json";
/// Part of its key: changed whenever the same frame has another hash.
const HASHES: &str = "hashes-1";

/// Rounding of time stamps, seconds: Matroska's are whole milliseconds. Larger: dropped frames of fast
/// cameras pass. Smaller: rounded stamps are taken for dropped frames.
const ROUNDING_S: f64 = 2e-3;

/// A camera's video file.
#[derive(Clone, Debug, PartialEq)]
pub struct VideoFile {
    /// The video, links followed.
    pub path: PathBuf,
    /// Hash of its bytes.
    pub(super) hash: String,
    /// The file's own time stamps, seconds.
    pub(super) stamps_s: Vec<f64>,
    /// The file that lists them.
    pub(super) index: PathBuf,
}

/// The list of a folder's decoded frames.
#[derive(Serialize, Deserialize)]
struct Index {
    /// The video's own time stamps.
    times_s: Vec<f64>,
    /// The hash of every image file, in their order.
    frames: Vec<String>,
}

/// A video and its frames inside the capture's folder `root`, decoded if they aren't yet. `wrong`
/// makes an error of a reason.
pub(super) fn open(
    root: &Path,
    path: &Path,
    wrong: impl Fn(String) -> CaptureError,
    opening: &Opening,
) -> Result<(VideoFile, Vec<PathBuf>), CaptureError> {
    let hash = hash(path).map_err(|source| CaptureError::Read { path: path.to_owned(), source })?;
    let cache = root.join(CACHE);
    let folder = cache.join(&hash[..32]);
    // Through a link, the cache would be written, and what is old in it deleted, elsewhere.
    if let Some(path) = link_within(root, &folder) {
        return Err(CaptureError::CacheLink { path });
    }
    let note = |sentence: &str| opening.reporter.note(sentence);
    let index = match whole(&folder, &hash, note) {
        Some(index) => index,
        None => decode(&Cache { all: &cache, folder: &folder, key: &hash }, path, &wrong, opening)?,
    };
    let frames = (0..index.frames.len()).map(|k| folder.join(frame_name(k))).collect();
    let video = VideoFile {
        path: path.to_owned(),
        hash,
        stamps_s: index.times_s,
        index: folder.join(INDEX_FILE),
    };
    Ok((video, frames))
}

fn hash(path: &Path) -> io::Result<String> {
    let mut hasher = blake3::Hasher::new();
    hasher.update(DECODING);
    hasher.update_reader(open_file(path)?)?;
    Ok(hasher.finalize().to_hex().to_string())
}

/// The index of a folder whose frames are all what was decoded from the video with this hash; `note` is
/// told where they were and are no more.
fn whole(folder: &Path, key: &str, note: impl Fn(&str)) -> Option<Index> {
    let index: Index = cache_file::load(&folder.join(INDEX_FILE), key, &note)?;
    if holds(folder, &index) {
        return Some(index);
    }
    note(&cache_file::damaged(folder));
    None
}

/// Whether a folder has the frames of an index that decoding can have made: a checksum has no secret, so
/// that anybody can write one for any index.
fn holds(folder: &Path, index: &Index) -> bool {
    let frames = index.frames.len();
    // Through a link, files outside of the capture would be read.
    let is_file =
        |k| folder.join(frame_name(k)).symlink_metadata().is_ok_and(|found| found.is_file());
    (1..=MAX_FRAMES).contains(&frames)
        && index.times_s.len() == frames
        && (0..frames).all(is_file)
        && hashes(folder, frames).is_ok_and(|found| found == index.frames)
}

/// The hashes of a folder's first frames, which are read if any has changed.
fn hashes(folder: &Path, frames: usize) -> io::Result<Vec<String>> {
    let files: Vec<PathBuf> = (0..frames).map(|k| folder.join(frame_name(k))).collect();
    let memory = folder.with_extension(HASHES_EXTENSION);
    remembered(&memory, HASHES, files.iter().map(PathBuf::as_path), || hash_all(folder, frames))
}

fn hash_all(folder: &Path, frames: usize) -> io::Result<Vec<String>> {
    let of = |k| {
        let mut hasher = blake3::Hasher::new();
        hash_file(&mut hasher, &folder.join(frame_name(k)))?;
        Ok(hasher.finalize().to_hex().to_string())
    };
    (0..frames).into_par_iter().map(of).collect()
}

/// Where a video's frames are cached, and the key that they are cached by.
struct Cache<'a> {
    all: &'a Path,
    folder: &'a Path,
    key: &'a str,
}

fn decode(
    cache: &Cache,
    path: &Path,
    wrong: &impl Fn(String) -> CaptureError,
    opening: &Opening,
) -> Result<Index, CaptureError> {
    let folder = cache.folder;
    let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
    let failed = |source| CaptureError::Write { path: folder.to_owned(), source };
    let Some(ffmpeg) = opening.ffmpeg else {
        return Err(CaptureError::NoFfmpeg { path: path.to_owned() });
    };
    std::fs::create_dir_all(cache.all).map_err(failed)?;
    let lock = lock_file(folder).map_err(failed)?;
    let _phase = opening.reporter.phase(&format!("decoding {name}"));
    lock.lock().map_err(failed)?;
    if let Some(index) = whole(folder, cache.key, |_| ()) {
        return Ok(index); // the process that held the lock has decoded it
    }
    // Under the lock: no other process touches the folder.
    remove(folder).map_err(failed)?;
    let temporary = Temporary::inside(cache.all).map_err(failed)?;
    let partial = temporary.path().join(FRAMES);
    std::fs::create_dir(&partial).map_err(failed)?;
    let decoded = Cache { folder: &partial, ..*cache };
    let index = decode_into(ffmpeg, &decoded, path, &name, wrong).map_err(|error| match error {
        // The temporary folder is gone by then.
        CaptureError::Write { path, source } if path.starts_with(&partial) => failed(source),
        error => error,
    })?;
    temporary.place(FRAMES, folder).map_err(failed)?;
    Ok(index)
}

/// The file that is locked while a folder is made. What is no file and has its name is removed: opening
/// a pipe would wait, and a link lead elsewhere.
fn lock_file(folder: &Path) -> io::Result<File> {
    let path = folder.with_extension("lock");
    remove_special(&path)?;
    // Between the two it may become one again.
    let flags = libc::O_NOFOLLOW | libc::O_NONBLOCK;
    File::options().write(true).create(true).truncate(false).custom_flags(flags).open(path)
}

/// The frames in a temporary folder.
const FRAMES: &str = "frames";

fn remove(folder: &Path) -> io::Result<()> {
    let removed = match folder.symlink_metadata() {
        Ok(found) if !found.is_dir() => std::fs::remove_file(folder),
        _ => std::fs::remove_dir_all(folder),
    };
    match removed {
        Err(error) if error.kind() != io::ErrorKind::NotFound => Err(error),
        _ => Ok(()),
    }
}

fn decode_into(
    ffmpeg: &Path,
    cache: &Cache,
    path: &Path,
    name: &str,
    wrong: &impl Fn(String) -> CaptureError,
) -> Result<Index, CaptureError> {
    let folder = cache.folder;
    let decoded = video::decode(ffmpeg, path, folder, MAX_FRAMES).map_err(|error| match error {
        VideoError::File { path, source } => CaptureError::Write { path, source },
        error => wrong(format!("'{name}' {error}")),
    })?;
    let frames = (0..).take_while(|k| folder.join(frame_name(*k)).exists()).count();
    if frames == 0 || frames != decoded.times_s.len() {
        return Err(wrong(format!("'{name}' has no frames, or some without a time stamp")));
    }
    let failed = |source| CaptureError::Write { path: folder.join(INDEX_FILE), source };
    let frames = hash_all(folder, frames).map_err(failed)?;
    let index = Index { times_s: decoded.times_s, frames };
    cache_file::save(&folder.join(INDEX_FILE), cache.key, &index).map_err(failed)?;
    Ok(index)
}

impl VideoFile {
    /// An error for a constant rate that the file's own time stamps contradict: frames were dropped,
    /// or the rate is another. The error is a reason.
    ///
    /// Stamps may be rounded by [`ROUNDING_S`] and may drift: two frames contradict by half a frame,
    /// and all of them by 1 %.
    pub(super) fn agrees_with_rate(&self, rate_hz: f64) -> Result<(), String> {
        let frame_s = 1.0 / rate_hz;
        let gaps = self.stamps_s.windows(2).map(|w| w[1] - w[0]);
        let uneven =
            gaps.clone().position(|gap| !((gap - frame_s).abs() <= 0.5 * frame_s + ROUNDING_S));
        let all_s = gaps.clone().sum::<f64>();
        let expected_s = gaps.count() as f64 * frame_s;
        let off = !((all_s - expected_s).abs() <= 0.01 * expected_s + ROUNDING_S);
        match (uneven, off) {
            (None, false) => Ok(()),
            (Some(k), _) => Err(format!(
                "rate_hz is {rate_hz}, but the video's own time stamps of frames {k} and {} are {:.4} s apart; {}",
                k + 1,
                self.stamps_s[k + 1] - self.stamps_s[k],
                self.offer()
            )),
            (None, true) => Err(format!(
                "rate_hz is {rate_hz}, but the video's own time stamps say {:.4}; {}",
                (self.stamps_s.len() - 1) as f64 / all_s,
                self.offer()
            )),
        }
    }

    /// Advice where the clock and the file contradict each other.
    pub(super) fn offer(&self) -> String {
        format!("give times_s (the video's own are in {})", self.index.display())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn stamped(stamps_s: &[f64]) -> VideoFile {
        VideoFile {
            path: "a.mkv".into(),
            hash: String::new(),
            stamps_s: stamps_s.to_vec(),
            index: "frames.json".into(),
        }
    }

    #[test]
    fn an_index_that_decoding_can_not_have_made_does_not_hold() {
        let cache = tempfile::tempdir().unwrap();
        let folder = cache.path().join("0");
        std::fs::create_dir(&folder).unwrap();
        let whole = |times_s: &[f64], frames: &[String]| {
            let index = Index { times_s: times_s.to_vec(), frames: frames.to_vec() };
            cache_file::save(&folder.join(INDEX_FILE), "k", &index).unwrap();
            let notes = std::cell::Cell::new(0);
            let found = whole(&folder, "k", |_| notes.set(notes.get() + 1));
            assert_eq!(notes.get(), usize::from(found.is_none()));
            found.is_some()
        };
        let frame = folder.join(frame_name(0));
        std::fs::write(&frame, "pixels").unwrap();
        let hash = hashes(&folder, 1).unwrap();
        assert!(whole(&[0.0], &hash));
        assert!(!whole(&[], &[]), "no frames");
        assert!(!whole(&[0.0, 1.0], &hash) && !whole(&[], &hash), "other stamps than frames");
        let many = MAX_FRAMES + 1;
        assert!(!whole(&vec![0.0; many], &vec![String::new(); many]), "too many frames");

        let elsewhere = tempfile::tempdir().unwrap();
        std::fs::rename(&frame, elsewhere.path().join("0")).unwrap();
        std::os::unix::fs::symlink(elsewhere.path().join("0"), &frame).unwrap();
        assert_eq!(hashes(&folder, 1).unwrap(), hash);
        assert!(!whole(&[0.0], &hash), "a link");
    }

    /// Who holds the lock may remove the folder meanwhile.
    #[test]
    fn a_folder_whose_frames_are_checked_is_not_written_to() {
        let cache = tempfile::tempdir().unwrap();
        let folder = cache.path().join("0");
        std::fs::create_dir(&folder).unwrap();
        std::fs::write(folder.join(frame_name(0)), "pixels").unwrap();
        let memory = folder.with_extension(HASHES_EXTENSION);
        for _ in 0..100 {
            hashes(&folder, 1).unwrap();
            if memory.exists() {
                break; // the frame has settled
            }
            std::thread::sleep(std::time::Duration::from_millis(100));
        }
        assert!(memory.exists());
        assert_eq!(folder.read_dir().unwrap().count(), 1);
    }

    #[test]
    fn what_is_no_file_is_no_lock() {
        let folder = tempfile::tempdir().unwrap();
        let (video, elsewhere) = (folder.path().join("0"), tempfile::tempdir().unwrap());
        let lock = video.with_extension("lock");
        std::os::unix::fs::symlink(elsewhere.path(), &lock).unwrap();
        lock_file(&video).unwrap().lock().unwrap();
        assert!(lock.symlink_metadata().unwrap().is_file());
    }

    #[test]
    fn rounded_time_stamps_agree_with_the_rate() {
        stamped(&[0.0, 0.033, 0.067, 0.1]).agrees_with_rate(30.0).unwrap();
        stamped(&[0.5]).agrees_with_rate(30.0).unwrap();
        let fast: Vec<f64> = (0..600).map(|k| (k as f64 / 0.24).round() / 1e3).collect();
        stamped(&fast).agrees_with_rate(240.0).unwrap();
    }

    #[test]
    fn a_gap_and_another_rate_are_errors() {
        let gap = stamped(&[0.0, 0.033, 0.1, 0.133]).agrees_with_rate(30.0).unwrap_err();
        assert!(gap.contains("frames 1 and 2") && gap.contains("frames.json"), "{gap}");
        let rate: Vec<f64> = (0..30).map(|k| k as f64 / 25.0).collect();
        let rate = stamped(&rate).agrees_with_rate(30.0).unwrap_err();
        assert!(rate.contains("say 25.0000"), "{rate}");
        assert!(stamped(&[0.0, 0.0]).agrees_with_rate(30.0).is_err());
    }
}
