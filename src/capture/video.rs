//! Video file of a camera. It is decoded into the capture's cache, and read from there as an image sequence.
//!
//! The cache entry holds the hashes of the decoded frames. The entry is saved after the last frame, so an entry implies
//! that all frames were written. If frames don't match their hashes when the capture is opened, the video is decoded
//! again. While one process decodes a video, other processes wait.
//!
//! The installed ffmpeg, 5.1 or newer, must be able to read the video. The frames' times come from `capture.json`,
//! because containers round time stamps (Matroska to 1 ms). A `rate_hz` that contradicts the video's time stamps is an
//! error. The error message names a file in the cache that lists the time stamps, so that the user can copy them into
//! `capture.json` as `times_s`.

use super::{CaptureError, CaptureSource};
use crate::host::temporary::Temporary;
use crate::host::{CacheKind, DiskCache, HeldFile, file_hashes, remove_special, write_json};
use crate::text::number;
use crate::video::{self, VideoError, VideoLimits, frame_name};
use serde::{Deserialize, Serialize};
use std::fs::File;
use std::io;
use std::os::unix::fs::OpenOptionsExt;
use std::path::{Path, PathBuf};

/// Largest number of frames of one camera, filmed by a simulated rig or decoded from a video. It is more than an hour
/// at 24 Hz.
pub const MAX_FRAMES: usize = 100_000;

const DECODED_VIDEOS: CacheKind = CacheKind { name: "video", version: 1 };

/// Name of the JSON file, in the folder of decoded frames, with the time stamps that the video file contains. The user
/// can copy them into `capture.json`.
const STAMPS_FILE: &str = "frames.json";

/// Largest rounding error of the time between two time stamps, seconds. Matroska rounds time stamps to whole
/// milliseconds.
const ROUNDING_S: f64 = 2e-3;

/// A camera's video file whose frames are decoded.
#[derive(Clone, Debug, PartialEq)]
pub struct VideoFile {
    /// Path of the video, with symbolic links resolved.
    pub path: PathBuf,
    /// Hash of the video file's bytes.
    pub(super) hash: blake3::Hash,
    /// Folder of the decoded frames, inside the capture's cache.
    folder: PathBuf,
    /// Hashes of the decoded frames' files, in order.
    pub(super) frames: Vec<blake3::Hash>,
    /// The time stamp of each frame in the video file, seconds.
    stamps_s: Vec<f64>,
}

/// Cache entry of a decoded video: the time stamps and the hashes of its frames.
#[derive(Serialize, Deserialize)]
struct DecodedVideo {
    /// The time stamp of each frame in the video file, seconds.
    times_s: Vec<f64>,
    /// Hash of every decoded frame's file, in hexadecimal digits.
    frames: Vec<String>,
}

fn hash(cache: &DiskCache, path: &Path) -> Result<blake3::Hash, CaptureError> {
    let found = file_hashes(cache, &[path])
        .map_err(|(_, source)| CaptureError::Read { path: path.to_owned(), source })?;
    Ok(found[0].hash)
}

impl VideoFile {
    /// Opens a video whose images must have the given size, `[width, height]` in pixels. The video is decoded unless
    /// its frames are cached. `wrong` converts the reason why the video is refused into an error that names the camera.
    pub(super) fn open(
        source: &CaptureSource,
        path: PathBuf,
        size: [usize; 2],
        wrong: impl Fn(String) -> CaptureError,
    ) -> Result<Self, CaptureError> {
        let cache = source.cache;
        if let Some(link) = cache.link(DECODED_VIDEOS) {
            let reason = "is a link, and the cache of a capture must lie inside of it";
            return Err(CaptureError::content(&link, reason));
        }
        let hash = hash(cache, &path)?;
        let folder = match cache.files(DECODED_VIDEOS, hash.as_bytes()) {
            Ok(folder) => folder,
            Err(source) => return Err(CaptureError::Write { path, source }),
        };
        let mut video = Self { path, hash, folder, frames: Vec::new(), stamps_s: Vec::new() };
        cache.pin(&video.entry());
        if !video.load(cache) {
            video.decode(source, size, &wrong)?;
        }
        Ok(video)
    }

    /// Returns the path of the video's cache entry.
    fn entry(&self) -> PathBuf {
        self.folder.with_extension("")
    }

    /// Returns the paths of the decoded frames' files.
    pub(super) fn files(&self) -> Vec<PathBuf> {
        (0..self.frames.len()).map(|k| self.folder.join(frame_name(k))).collect()
    }

    /// Loads the hashes and the time stamps of the decoded frames from the video's cache entry. Returns `false` if
    /// there is no entry, if decoded frames are missing, or if they don't match their hashes.
    fn load(&mut self, cache: &DiskCache) -> bool {
        let entry = cache.load_json::<DecodedVideo>(DECODED_VIDEOS, self.hash.as_bytes());
        let Some(entry) = entry else { return false };
        let Some(frames) = matching_hashes(cache, &self.folder, &entry) else {
            cache.note_damage(&self.entry());
            return false;
        };
        (self.frames, self.stamps_s) = (frames, entry.times_s);
        true
    }

    fn decode(
        &mut self,
        source: &CaptureSource,
        size: [usize; 2],
        wrong: &impl Fn(String) -> CaptureError,
    ) -> Result<(), CaptureError> {
        let (cache, folder) = (source.cache, self.folder.clone());
        let failed = |source| CaptureError::Write { path: folder.clone(), source };
        let name = self.path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        let Some(ffmpeg) = source.opening.ffmpeg else {
            return Err(CaptureError::NoFfmpeg { path: self.path.clone() });
        };
        let parent = folder.parent().unwrap_or(&folder);
        std::fs::create_dir_all(parent).map_err(failed)?;
        let lock = lock_file(&folder).map_err(failed)?;
        let _phase = source.opening.reporter.phase(&format!("decoding {name}"));
        lock.lock().map_err(failed)?;
        if self.load(cache) {
            return Ok(()); // another process has decoded the video while this one waited for the lock
        }
        // Other processes wait for the lock, so no other process uses the folder now.
        cache.remove(DECODED_VIDEOS, self.hash.as_bytes()).map_err(failed)?;
        let temporary = Temporary::inside(parent).map_err(failed)?;
        let partial = temporary.path().join(FRAMES);
        std::fs::create_dir(&partial).map_err(failed)?;
        let changed = || CaptureError::Changed { path: self.path.clone() };
        let unread = |source| CaptureError::Read { path: self.path.clone(), source };
        let held = HeldFile::open(&self.path, self.hash).map_err(unread)?.ok_or_else(changed)?;
        let limits = VideoLimits { max_frames: MAX_FRAMES, size };
        let decoded = video::decode(ffmpeg, &held.file, &partial, limits);
        if !held.is_unchanged().map_err(unread)? {
            return Err(changed());
        }
        let times_s = decoded.map_err(|error| match error {
            // The error names the cache's folder. The temporary folder is removed before the user reads the message.
            VideoError::File { path, source } if path.starts_with(&partial) => failed(source),
            VideoError::File { path, source } => CaptureError::Write { path, source },
            error => wrong(format!("'{name}' {error}")),
        })?;
        let frames = (0..).take_while(|k| partial.join(frame_name(*k)).exists()).count();
        if frames == 0 || frames != times_s.len() {
            return Err(wrong(format!("'{name}' has no frames, or some without a time stamp")));
        }
        self.frames = hash_frames(cache, &partial, frames).map_err(failed)?;
        let stamps = serde_json::json!({ "times_s": times_s });
        write_json(&partial.join(STAMPS_FILE), &stamps).map_err(failed)?;
        temporary.place(FRAMES, &folder).map_err(failed)?;
        let frames = self.frames.iter().map(|hash| hash.to_string()).collect();
        let entry = DecodedVideo { times_s, frames };
        cache.save_json(DECODED_VIDEOS, self.hash.as_bytes(), &entry).map_err(failed)?;
        self.stamps_s = entry.times_s;
        Ok(())
    }

    /// Returns an error if a constant frame rate contradicts the video's own time stamps. Each interval between two
    /// frames may differ by 50 % from 1 / `rate_hz`. The duration from the first to the last frame may differ by 1 %
    /// from its expected value. [`ROUNDING_S`] is added to both tolerances. The caller adds the name of `capture.json`
    /// to the error message.
    pub(super) fn agrees_with_rate(&self, rate_hz: f64) -> Result<(), String> {
        let frame_s = 1.0 / rate_hz;
        let gaps = self.stamps_s.windows(2).map(|w| w[1] - w[0]);
        let uneven =
            gaps.clone().position(|gap| !((gap - frame_s).abs() <= 0.5 * frame_s + ROUNDING_S));
        let all_s = gaps.clone().sum::<f64>();
        let expected_s = gaps.count() as f64 * frame_s;
        let contradiction = if let Some(k) = uneven {
            let gap_s = self.stamps_s[k + 1] - self.stamps_s[k];
            format!("of frames {k} and {} are {gap_s:.4} s apart", k + 1)
        } else if !((all_s - expected_s).abs() <= 0.01 * expected_s + ROUNDING_S) {
            format!("say {:.4}", (self.stamps_s.len() - 1) as f64 / all_s)
        } else {
            return Ok(());
        };
        let offer = self.offer();
        Err(format!(
            "rate_hz is {}, but the video's own time stamps {contradiction}; {offer}",
            number(rate_hz)
        ))
    }

    /// Returns advice for the end of an error message about frame times that are missing or wrong in `capture.json`.
    /// The advice is to give `times_s`, and names the file that lists the video's own time stamps.
    pub(super) fn offer(&self) -> String {
        let stamps = self.folder.join(STAMPS_FILE);
        format!("give times_s (the video's own are in {})", stamps.display())
    }
}

/// Returns the hashes of the decoded frames in a folder. `None` if they don't match the hashes in the cache entry, or
/// if frames are missing. An attacker may have written the entry, because its checksum uses no secret. The number of
/// frames in the entry is therefore checked before any frame is read.
fn matching_hashes(
    cache: &DiskCache,
    folder: &Path,
    entry: &DecodedVideo,
) -> Option<Vec<blake3::Hash>> {
    let frames = entry.frames.len();
    // A symbolic link could lead to files outside of the capture.
    let is_file =
        |k| folder.join(frame_name(k)).symlink_metadata().is_ok_and(|found| found.is_file());
    let is_plausible = (1..=MAX_FRAMES).contains(&frames)
        && entry.times_s.len() == frames
        && (0..frames).all(is_file);
    let hashes = is_plausible.then(|| hash_frames(cache, folder, frames).ok()).flatten()?;
    let is_same = hashes.iter().zip(&entry.frames).all(|(a, b)| a.to_hex().as_str() == b);
    is_same.then_some(hashes)
}

/// Returns the hashes of the first `frames` frames in a folder.
fn hash_frames(cache: &DiskCache, folder: &Path, frames: usize) -> io::Result<Vec<blake3::Hash>> {
    let files: Vec<PathBuf> = (0..frames).map(|k| folder.join(frame_name(k))).collect();
    let files: Vec<&Path> = files.iter().map(PathBuf::as_path).collect();
    let found = file_hashes(cache, &files).map_err(|(_, error)| error)?;
    Ok(found.iter().map(|read| read.hash).collect())
}

/// Opens the lock file beside `folder`. A process locks this file while it decodes a video into `folder`. A pipe or a
/// symbolic link at the lock file's path is removed first.
fn lock_file(folder: &Path) -> io::Result<File> {
    let path = folder.with_extension("lock");
    remove_special(&path)?;
    // Another process may put a pipe or a symbolic link there before the file is opened.
    let flags = libc::O_NOFOLLOW | libc::O_NONBLOCK;
    File::options().write(true).create(true).truncate(false).custom_flags(flags).open(path)
}

/// Name of the folder, inside a temporary folder, into which a video is decoded. It is moved into the cache when all
/// frames are decoded.
const FRAMES: &str = "frames";

#[cfg(test)]
mod tests {
    use super::*;

    fn stamped(stamps_s: &[f64]) -> VideoFile {
        VideoFile {
            path: "a.mkv".into(),
            hash: blake3::hash(b""),
            frames: Vec::new(),
            stamps_s: stamps_s.to_vec(),
            folder: PathBuf::new(),
        }
    }

    #[test]
    fn an_entry_that_decoding_can_not_have_saved_does_not_hold() {
        let capture = tempfile::tempdir().unwrap();
        let folder = capture.path().join("0");
        std::fs::create_dir(&folder).unwrap();
        let cache = DiskCache::new(capture.path(), |_| ());
        let holds = |times_s: &[f64], frames: &[String]| {
            let entry = DecodedVideo { times_s: times_s.to_vec(), frames: frames.to_vec() };
            matching_hashes(&cache, &folder, &entry).is_some()
        };
        let frame = folder.join(frame_name(0));
        std::fs::write(&frame, "pixels").unwrap();
        let hash = [blake3::hash(b"pixels").to_hex().to_string()];
        assert!(holds(&[0.0], &hash));
        assert!(!holds(&[0.0], &[blake3::hash(b"others").to_hex().to_string()]));
        assert!(!holds(&[], &[]), "no frames");
        assert!(!holds(&[0.0, 1.0], &hash) && !holds(&[], &hash), "other stamps than frames");
        let many = MAX_FRAMES + 1;
        assert!(!holds(&vec![0.0; many], &vec![String::new(); many]), "too many frames");

        let elsewhere = tempfile::tempdir().unwrap();
        std::fs::rename(&frame, elsewhere.path().join("0")).unwrap();
        std::os::unix::fs::symlink(elsewhere.path().join("0"), &frame).unwrap();
        assert_eq!(hash_frames(&cache, &folder, 1).unwrap()[0].to_hex().as_str(), hash[0]);
        assert!(!holds(&[0.0], &hash), "a link");
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
