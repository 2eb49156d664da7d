//! Checks of output paths, so that no output overwrites a part of a capture.
//!
//! These parts are protected: `capture.json`, the frames, all names that match a camera's frame pattern, `truth/`,
//! `colmap/`, the estimated offsets and the cache. Paths that lead to protected files through symbolic links are
//! refused too. Other files in the capture's folder, and its folder `review/`, may be overwritten. While a simulated
//! capture is being filmed, its whole folder is protected.

use super::{CAPTURE_FILE, CaptureError, frames};
use crate::host::obstacle;
use crate::json;
use serde_json::Value;
use std::collections::{HashMap, HashSet};
use std::path::{Path, PathBuf};

/// Protected paths in a capture's folder, in addition to `capture.json` and the frames.
const PARTS: [&str; 6] = ["truth", "colmap", ".stlfr", FILM, "offsets.json", "offsets.svg"];

/// Name of the hidden folder, in a capture's folder, in which the filming script stores its state. If this folder
/// exists and `capture.json` doesn't, filming is unfinished.
pub(super) const FILM: &str = ".film";

/// Checks output paths before a computation begins. An output file may overwrite a regular file, but no output may
/// overwrite a part of a capture.
pub struct OutputGuard {
    /// Folder of the capture that the command reads. `None` if the command reads no capture.
    own: Option<PathBuf>,
    /// Protected paths of each folder that was checked so far. `None` for a folder that isn't a capture.
    known: HashMap<PathBuf, Option<ProtectedPaths>>,
}

/// Paths of one capture that outputs must not overwrite. All paths are canonical.
struct ProtectedPaths {
    root: PathBuf,
    is_filming: bool,
    description: PathBuf,
    parts: Vec<PathBuf>,
    patterns: Vec<FramePattern>,
    frames: HashSet<PathBuf>,
}

/// The file names that a camera's frames may have.
struct FramePattern {
    folder: PathBuf,
    /// File name with an integer field, such as `%04d.png`, or the file name of a video.
    name: String,
}

impl OutputGuard {
    /// Makes a guard that protects the capture in the folder `own`, and every other capture whose folder contains an
    /// output path.
    pub fn new(own: Option<&Path>) -> Self {
        Self { own: own.map(Path::to_owned), known: HashMap::new() }
    }

    /// Returns an error if `path` can't be an output file: something other than a regular file has this path, or the
    /// path is a protected part of a capture.
    pub fn check_file(&mut self, path: &Path) -> Result<(), CaptureError> {
        let name = path.as_os_str().as_encoded_bytes();
        if path.file_name().is_none() || name.ends_with(b"/") || name.ends_with(b"/.") {
            return Err(CaptureError::content(path, "names no file"));
        }
        if let Some(obstacle) = obstacle(path) {
            return Err(CaptureError::content(path, obstacle));
        }
        self.check(path, false, ProtectedPaths::against_file)
    }

    /// Returns an error if `path` can't be an output folder: it is a capture's folder, a folder of frames, or a
    /// protected part of a capture. `names` lists what will be written into the folder: files, and sub-folders with a
    /// final `/`. Files and sub-folders with these names may exist already. Files must not be protected, and
    /// sub-folders must not be symbolic links.
    pub fn check_folder(&mut self, path: &Path, names: &[&str]) -> Result<(), CaptureError> {
        must_be_a_folder(path)?;
        self.check(path, true, ProtectedPaths::against_capture)?;
        self.check(path, true, ProtectedPaths::against_folder)?;
        names.iter().try_for_each(|name| match name.strip_suffix('/') {
            Some(folder) => must_be_no_link(&path.join(folder)),
            None => self.check_file(&path.join(name)),
        })
    }

    /// Returns an error if `path` can't be the folder of a new or unfinished capture, because it is no folder or a
    /// protected part of another capture. An unfinished capture must not contain symbolic links to folders, because
    /// filming would write through them.
    pub fn check_capture(&mut self, path: &Path) -> Result<(), CaptureError> {
        must_be_a_folder(path)?;
        if !path.join(CAPTURE_FILE).exists() {
            let children = std::fs::read_dir(path).into_iter().flatten().flatten();
            let truth = std::fs::read_dir(path.join("truth")).into_iter().flatten().flatten();
            children.chain(truth).try_for_each(|child| must_be_no_link(&child.path()))?;
        }
        self.check(path, true, ProtectedPaths::against_capture)
    }

    /// Returns an error if a path is protected. The path is checked against the protected paths of the command's own
    /// capture, and of all captures in folders above the path. Symbolic links in parent folders are resolved. If
    /// `is_folder` is true, a symbolic link at the path itself is resolved too. `against` returns the reason why a path
    /// is protected, or `None` if the path isn't protected.
    fn check(
        &mut self,
        path: &Path,
        is_folder: bool,
        against: fn(&ProtectedPaths, &Path) -> Option<&'static str>,
    ) -> Result<(), CaptureError> {
        let Ok(absolute) = std::path::absolute(path) else { return Ok(()) };
        let real = if is_folder { followed(real(&absolute)) } else { real(&absolute) };
        let around = absolute.ancestors().chain(real.ancestors()).map(Path::to_owned);
        for folder in around.chain(self.own.clone()) {
            let known = self.known.entry(folder);
            let known = known.or_insert_with_key(|folder| ProtectedPaths::of(folder));
            if let Some(reason) = known.as_ref().and_then(|protected| against(protected, &real)) {
                return Err(CaptureError::content(path, reason));
            }
        }
        Ok(())
    }
}

fn must_be_a_folder(path: &Path) -> Result<(), CaptureError> {
    if path.symlink_metadata().is_err() || path.is_dir() {
        return Ok(());
    }
    Err(CaptureError::content(path, "is no folder"))
}

/// Returns an error if the path is a symbolic link to a folder, because outputs would be written to the link's target.
fn must_be_no_link(path: &Path) -> Result<(), CaptureError> {
    if path.is_dir() && path.symlink_metadata().is_ok_and(|found| found.is_symlink()) {
        return Err(CaptureError::content(path, "is a link, which is not written through"));
    }
    Ok(())
}

/// Resolves the symbolic links in the parent folders of a path, but not a link at the path itself.
fn real(absolute: &Path) -> PathBuf {
    let found = absolute.ancestors().skip(1).find_map(|folder| {
        let rest = absolute.strip_prefix(folder).ok()?;
        Some(folder.canonicalize().ok()?.join(rest))
    });
    found.unwrap_or_else(|| absolute.to_owned())
}

/// Returns the canonical path. If the path doesn't exist, it is returned unchanged.
fn followed(path: PathBuf) -> PathBuf {
    path.canonicalize().unwrap_or(path)
}

impl ProtectedPaths {
    /// Finds the protected paths of a capture's folder. `None` for a folder that isn't a capture.
    fn of(folder: &Path) -> Option<Self> {
        let description = folder.join(CAPTURE_FILE);
        let is_described = description.is_file();
        if !is_described && !folder.join(FILM).is_dir() {
            return None;
        }
        // If `capture.json` can't be read, only the parts with fixed names are protected.
        let read: Value = json::read(&description).unwrap_or_default();
        if read["format"].as_str().is_some_and(|format| format != "stlfr-capture") {
            return None;
        }
        let cameras = read["cameras"].as_array().into_iter().flatten();
        let names: Vec<&str> = cameras.filter_map(|camera| camera["frames"].as_str()).collect();
        let root = folder.canonicalize().ok()?;
        let pattern = |frames: &&str| {
            let (folder, name) = frames.rsplit_once('/').unwrap_or((".", frames));
            FramePattern { folder: followed(root.join(folder)), name: name.to_owned() }
        };
        Some(Self {
            is_filming: !is_described,
            description: followed(root.join(CAPTURE_FILE)),
            parts: PARTS.map(|name| followed(root.join(name))).to_vec(),
            patterns: names.iter().map(pattern).collect(),
            frames: names.iter().flat_map(|name| frames::find(&root, name)).flatten().collect(),
            root,
        })
    }

    fn against_capture(&self, real: &Path) -> Option<&'static str> {
        let is_in_parts = self.parts.iter().any(|part| real.starts_with(part));
        is_in_parts.then_some("belongs to the capture, and is not written over")
    }

    fn against_folder(&self, real: &Path) -> Option<&'static str> {
        if self.root == *real {
            Some("is a capture, and results need a folder of their own")
        } else if self.patterns.iter().any(|pattern| pattern.folder == *real) {
            Some("is a folder of the capture's frames, and results need a folder of their own")
        } else {
            None
        }
    }

    fn against_file(&self, real: &Path) -> Option<&'static str> {
        if self.is_filming && real.starts_with(&self.root) {
            Some("is in a capture that is not filmed to its end")
        } else if self.description == *real || self.root.join(CAPTURE_FILE) == *real {
            Some("describes the capture, and is not written over")
        } else if self.frames.contains(real) || self.patterns.iter().any(|p| p.names(real)) {
            Some("is a frame of the capture, which is not written over")
        } else {
            self.against_capture(real)
        }
    }
}

impl FramePattern {
    fn names(&self, real: &Path) -> bool {
        let name = real.file_name().and_then(|name| name.to_str());
        real.parent() == Some(&self.folder)
            && name.is_some_and(|name| frames::is_named(&self.name, name))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::host::write_atomically;
    use std::os::unix::fs::symlink;

    /// Makes the folder of a capture with two image sequences and one video. One frame is a symbolic link into
    /// `store/`.
    fn capture() -> tempfile::TempDir {
        let folder = tempfile::tempdir().unwrap();
        let text = r#"{"format": "stlfr-capture", "cameras": [
            {"frames": "cam0/%04d.png"}, {"frames": "cam1.mkv"}, {"frames": "%d.png"}]}"#;
        for (name, bytes) in [
            (CAPTURE_FILE, text),
            ("cam0/0000.png", ""),
            ("cam1.mkv", ""),
            ("store/a.png", ""),
            ("truth/truth.json", "{}"),
        ] {
            write_atomically(&folder.path().join(name), bytes.as_bytes()).unwrap();
        }
        symlink("../store/a.png", folder.path().join("cam0/0001.png")).unwrap();
        folder
    }

    #[test]
    fn what_belongs_to_a_capture_is_refused_by_any_path() {
        let folder = capture();
        let elsewhere = tempfile::tempdir().unwrap();
        symlink(folder.path(), elsewhere.path().join("capture")).unwrap();
        for root in [folder.path().to_owned(), elsewhere.path().join("capture")] {
            let mut guard = OutputGuard::new(None);
            for (name, words) in [
                ("capture.json", "describes the capture"),
                ("cam0/0000.png", "is a frame"),
                ("cam0/../cam0/0000.png", "is a frame"),
                ("cam0/0007.png", "is a frame"),
                ("12.png", "is a frame"),
                ("cam1.mkv", "is a frame"),
                ("store/a.png", "is a frame"),
                ("cam0/0001.png", "is a link"),
                ("truth/truth.json", "belongs to the capture"),
                ("truth/views/new/0.png", "belongs to the capture"),
                ("colmap/cameras.txt", "belongs to the capture"),
                (".stlfr/cache/video/0", "belongs to the capture"),
                ("offsets.json", "belongs to the capture"),
                ("truth", "is a folder"),
                ("new/", "names no file"),
                ("new/.", "names no file"),
                ("..", "names no file"),
            ] {
                let message = guard.check_file(&root.join(name)).unwrap_err().to_string();
                assert!(message.contains(words), "{name}: {message}");
            }
            for name in ["out.png", "options.json", "review/0.png", "cam0/a.png", "new/0.png"] {
                guard.check_file(&root.join(name)).unwrap();
            }
        }
    }

    #[test]
    fn folders_of_a_capture_are_refused() {
        let folder = capture();
        let mut guard = OutputGuard::new(None);
        for (name, words) in [
            ("", "is a capture"),
            ("truth", "belongs to the capture"),
            ("truth/new", "belongs to the capture"),
            ("colmap", "belongs to the capture"),
            ("cam0", "frames"),
            ("cam1.mkv", "is no folder"),
        ] {
            let path = folder.path().join(name);
            let message = guard.check_folder(&path, &[]).unwrap_err().to_string();
            assert!(message.contains(words), "{name}: {message}");
        }
        guard.check_folder(&folder.path().join("review"), &["report.html"]).unwrap();
        guard.check_capture(folder.path()).unwrap();
        assert!(guard.check_capture(&folder.path().join("truth/new")).is_err());
        symlink("/dev/null", folder.path().join("report.html")).unwrap();
        let out = folder.path().join("store");
        symlink("a.png", out.join("report.html")).unwrap();
        let message = guard.check_folder(&out, &["report.html"]).unwrap_err().to_string();
        assert!(message.contains("report.html: is a link"), "{message}");
    }

    #[test]
    fn linked_parts_and_damaged_descriptions_are_protected() {
        let folder = capture();
        let elsewhere = tempfile::tempdir().unwrap();
        let [description, truth] = ["description.json", "truth"].map(|n| elsewhere.path().join(n));
        std::fs::rename(folder.path().join("truth"), &truth).unwrap();
        symlink(&truth, folder.path().join("truth")).unwrap();
        std::fs::rename(folder.path().join(CAPTURE_FILE), &description).unwrap();
        symlink(&description, folder.path().join(CAPTURE_FILE)).unwrap();
        let mut guard = OutputGuard::new(Some(folder.path()));
        assert!(guard.check_file(&truth.join("truth.json")).is_err());
        assert!(guard.check_file(&folder.path().join("truth/truth.json")).is_err());
        assert!(guard.check_file(&description).is_err());

        std::fs::write(&description, "[").unwrap();
        let mut guard = OutputGuard::new(None);
        assert!(guard.check_file(&folder.path().join("truth/truth.json")).is_err());
        // A file named `capture.json` that another program wrote doesn't make the folder a capture.
        std::fs::write(&description, r#"{"format": "stlfr-rig"}"#).unwrap();
        let mut guard = OutputGuard::new(None);
        guard.check_file(&folder.path().join("colmap/cameras.txt")).unwrap();
    }

    #[test]
    fn a_film_that_was_interrupted_is_protected() {
        let folder = tempfile::tempdir().unwrap();
        std::fs::create_dir(folder.path().join(FILM)).unwrap();
        let mut guard = OutputGuard::new(None);
        let message = guard.check_file(&folder.path().join("cam0/0000.png")).unwrap_err();
        assert!(message.to_string().contains("not filmed to its end"), "{message}");
        guard.check_capture(folder.path()).unwrap();
    }
}
