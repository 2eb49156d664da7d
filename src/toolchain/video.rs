//! Writing a video file, lossless (FFV1), through an ffmpeg.

use super::process::{Ended, Process};
use crate::capture::BitDepth;
use crate::raster::Image;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::{ChildStdin, Command, Stdio};

/// Why there is no video.
#[derive(Debug, thiserror::Error)]
pub enum VideoError {
    #[error("{path}: can't be written ({reason})")]
    Ffmpeg { path: PathBuf, reason: String },
    #[error("{path}: {source}")]
    Write { path: PathBuf, source: std::io::Error },
}

/// A video file in the making. It has its name only once it is finished.
pub struct VideoWriter {
    path: PathBuf,
    temporary: PathBuf,
    process: Option<Process>,
    stdin: Option<ChildStdin>,
    size: (usize, usize, usize),
    depth: BitDepth,
}

/// An ffmpeg to run: the system's, else the one that comes with the project's environment.
pub fn find_ffmpeg(project_root: &Path) -> Option<PathBuf> {
    let on_path = std::env::var_os("PATH").and_then(|paths| {
        std::env::split_paths(&paths).map(|p| p.join("ffmpeg")).find(|p| p.is_file())
    });
    on_path.or_else(|| {
        let lib = project_root.join(".venv/lib/python3.11/site-packages/imageio_ffmpeg/binaries");
        std::fs::read_dir(lib).ok()?.filter_map(|entry| Some(entry.ok()?.path())).find(|path| {
            path.file_name().is_some_and(|name| name.to_string_lossy().starts_with("ffmpeg-"))
        })
    })
}

impl VideoWriter {
    /// Begins a video whose frames all have the size and channels (1 or 3) of `like`.
    pub fn create(
        ffmpeg: &Path,
        path: &Path,
        like: &Image,
        depth: BitDepth,
        rate_hz: f64,
    ) -> Result<Self, VideoError> {
        let wrong = |source| VideoError::Write { path: path.to_owned(), source };
        let folder = path.parent().filter(|p| !p.as_os_str().is_empty());
        if let Some(folder) = folder {
            std::fs::create_dir_all(folder).map_err(wrong)?;
        }
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        let temporary = path.with_file_name(format!(".{name}.{}.tmp.mkv", std::process::id()));
        let format = match (like.channels(), depth) {
            (1, BitDepth::Eight) => "gray",
            (1, BitDepth::Sixteen) => "gray16le",
            (_, BitDepth::Eight) => "rgb24",
            (_, BitDepth::Sixteen) => "rgb48le",
        };
        let mut command = Command::new(ffmpeg);
        command
            .args(["-hide_banner", "-loglevel", "error", "-y", "-f", "rawvideo"])
            .args(["-pixel_format", format])
            .args(["-video_size", &format!("{}x{}", like.width(), like.height())])
            .args(["-framerate", &format!("{rate_hz}"), "-i", "pipe:0", "-c:v", "ffv1"])
            // The same frames give the same bytes, whatever the machine.
            .args(["-fflags", "+bitexact", "-flags:v", "+bitexact", "-threads", "1"])
            .arg(&temporary);
        let mut process = Process::start(&mut command, Stdio::piped())
            .map_err(|source| VideoError::Write { path: ffmpeg.to_owned(), source })?;
        Ok(Self {
            path: path.to_owned(),
            temporary,
            stdin: process.take_stdin(),
            process: Some(process),
            size: (like.width(), like.height(), like.channels()),
            depth,
        })
    }

    /// Adds a frame.
    ///
    /// # Panics
    /// If its size or channels are others than the first's.
    pub fn push(&mut self, image: &Image) -> Result<(), VideoError> {
        assert_eq!(
            (image.width(), image.height(), image.channels()),
            self.size,
            "one size a video"
        );
        let bytes: Vec<u8> = match self.depth {
            BitDepth::Eight => image.data().iter().map(|v| (v * 255.0 + 0.5) as u8).collect(),
            BitDepth::Sixteen => image
                .data()
                .iter()
                .flat_map(|v| ((v * 65535.0 + 0.5) as u16).to_le_bytes())
                .collect(),
        };
        match self.stdin.as_mut().map(|pipe| pipe.write_all(&bytes)) {
            Some(Ok(())) => Ok(()),
            // It has ended; its own words say why.
            _ => Err(self.end().err().unwrap_or_else(|| self.broken("ffmpeg ended early"))),
        }
    }

    /// Ends the video and gives it its name.
    pub fn finish(mut self) -> Result<(), VideoError> {
        self.end()?;
        std::fs::rename(&self.temporary, &self.path)
            .map_err(|source| VideoError::Write { path: self.path.clone(), source })
    }

    fn end(&mut self) -> Result<(), VideoError> {
        drop(self.stdin.take());
        let Some(process) = self.process.take() else { return Ok(()) };
        let Ended { status, stderr } = process
            .wait()
            .map_err(|source| VideoError::Write { path: self.path.clone(), source })?;
        if status.success() {
            return Ok(());
        }
        Err(self
            .broken(stderr.lines().rev().find(|l| !l.trim().is_empty()).unwrap_or("ffmpeg failed")))
    }

    fn broken(&self, reason: &str) -> VideoError {
        VideoError::Ffmpeg { path: self.path.clone(), reason: reason.to_owned() }
    }
}

impl Drop for VideoWriter {
    fn drop(&mut self) {
        drop(self.stdin.take());
        drop(self.process.take());
        // There is none after `finish`.
        let _ = std::fs::remove_file(&self.temporary);
    }
}
