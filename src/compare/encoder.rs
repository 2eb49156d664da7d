//! ffmpeg as a child process: spawned with arguments, never through a shell, it gets raw frames on
//! its standard input.

use super::video::{VideoError, VideoOptions};
use crate::raster::Image;
use std::io::{Read, Write};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdin, Command, Stdio};
use std::thread::JoinHandle;

/// An ffmpeg, and what it can encode.
pub struct Encoder {
    program: PathBuf,
    /// H.264 that browsers play; without it FFV1 in Matroska, which is lossless.
    h264: bool,
}

impl Encoder {
    /// Asks ffmpeg for its encoders, so that a missing one is known before anything is rendered.
    pub fn find(options: &VideoOptions) -> Result<Self, VideoError> {
        let program = options.ffmpeg.clone();
        let output = Command::new(&program)
            .args(["-hide_banner", "-encoders"])
            .stdin(Stdio::null())
            .output()
            .map_err(|source| VideoError::Start { program: program.clone(), source })?;
        let h264 = String::from_utf8_lossy(&output.stdout).contains(" libx264 ");
        Ok(Self { program, h264 })
    }

    /// The suffix of what it writes.
    pub fn suffix(&self) -> &'static str {
        if self.h264 { "mp4" } else { "mkv" }
    }

    fn command(&self, (width, height): (usize, usize), rate_hz: f64, path: &Path) -> Command {
        let mut command = Command::new(&self.program);
        command.args(["-hide_banner", "-loglevel", "error", "-nostdin", "-y"]);
        command.args(["-f", "rawvideo", "-pix_fmt", "rgb24"]);
        command.args(["-s", &format!("{width}x{height}"), "-r", &rate_hz.to_string(), "-i", "-"]);
        if self.h264 {
            // Browsers play 4:2:0 only; 16 is visually lossless.
            command.args(["-c:v", "libx264", "-pix_fmt", "yuv420p", "-crf", "16"]);
            command.args(["-movflags", "+faststart", "-f", "mp4"]);
        } else {
            command.args(["-c:v", "ffv1", "-f", "matroska"]);
        }
        command.arg(path);
        command
    }

    /// Starts encoding frames of one size into a file.
    pub(super) fn start(
        &self,
        size: (usize, usize),
        rate_hz: f64,
        path: &Path,
    ) -> Result<Encoding, VideoError> {
        let mut child = self
            .command(size, rate_hz, path)
            .stdin(Stdio::piped())
            .stdout(Stdio::null())
            .stderr(Stdio::piped())
            .spawn()
            .map_err(|source| VideoError::Start { program: self.program.clone(), source })?;
        // Read beside the writing, so that neither side waits for the other.
        let mut errors = child.stderr.take();
        let said = std::thread::spawn(move || {
            let mut text = Vec::new();
            if let Some(errors) = &mut errors {
                let _ = errors.read_to_end(&mut text);
            }
            String::from_utf8_lossy(&text).into_owned()
        });
        Ok(Encoding {
            input: child.stdin.take(),
            child,
            said: Some(said),
            stopped: false,
            program: self.program.clone(),
            path: path.to_owned(),
        })
    }
}

/// A running ffmpeg; it is ended if this is dropped before [`Self::finish`].
pub(super) struct Encoding {
    child: Child,
    input: Option<ChildStdin>,
    said: Option<JoinHandle<String>>,
    stopped: bool,
    program: PathBuf,
    path: PathBuf,
}

impl Encoding {
    /// Gives it an RGB frame; false if it takes no more, and [`Self::finish`] will say why.
    pub fn feed(&mut self, frame: &Image) -> bool {
        let raw: Vec<u8> = frame.data().iter().map(|v| (v * 255.0 + 0.5) as u8).collect();
        let fed = self.input.as_mut().is_some_and(|input| input.write_all(&raw).is_ok());
        self.stopped |= !fed;
        fed
    }

    /// Waits until the file is whole.
    pub fn finish(mut self) -> Result<(), VideoError> {
        drop(self.input.take());
        let status = self
            .child
            .wait()
            .map_err(|source| VideoError::Start { program: self.program.clone(), source })?;
        let said = self.said.take().and_then(|said| said.join().ok()).unwrap_or_default();
        if status.success() && !self.stopped {
            return Ok(());
        }
        let reason = said.lines().last().unwrap_or("it stopped early").to_owned();
        let (program, path) = (self.program.clone(), self.path.clone());
        Err(VideoError::Encode { program, path, reason })
    }
}

impl Drop for Encoding {
    fn drop(&mut self) {
        drop(self.input.take());
        if !matches!(self.child.try_wait(), Ok(Some(_))) {
            let _ = self.child.kill();
            let _ = self.child.wait();
        }
    }
}
