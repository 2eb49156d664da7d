//! Writing a video file.

use super::{VideoError, without_address};
use crate::host::process::{Ended, Process};
use crate::host::temporary::Temporary;
use crate::raster::{BitDepth, Image, Samples, quantize};
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::{ChildStdin, Command, Stdio};

/// The compression of a video, and its container.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Codec {
    /// FFV1 in Matroska: lossless, every frame on its own and with a checksum.
    Ffv1,
    /// H.264 in MP4, which browsers play: 8 bits, 4:2:0, visually lossless.
    H264,
    /// H.264 in MP4 without loss, in RGB of 8 bits, which other programs' readers of videos decode.
    H264Lossless,
}

/// The format of a video file.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct VideoFormat {
    /// Bits a channel of the encoded frames.
    pub depth: BitDepth,
    /// Frames a second, hertz.
    pub rate_hz: f64,
    /// Compression and container.
    pub codec: Codec,
}

impl Codec {
    /// H.264 if the given ffmpeg supports it, else FFV1. Starts ffmpeg, so that one that can't run is found before
    /// rendering begins.
    pub fn for_browsers(ffmpeg: &Path) -> Result<Self, VideoError> {
        let output = Command::new(ffmpeg)
            .args(["-hide_banner", "-encoders"])
            .stdin(Stdio::null())
            .output()
            .map_err(|source| VideoError::File { path: ffmpeg.to_owned(), source })?;
        let h264 = String::from_utf8_lossy(&output.stdout).contains(" libx264 ");
        Ok(if h264 { Self::H264 } else { Self::Ffv1 })
    }

    /// The suffix of the codec's files.
    pub fn suffix(self) -> &'static str {
        match self {
            Self::Ffv1 => "mkv",
            Self::H264 | Self::H264Lossless => "mp4",
        }
    }

    fn arguments(self) -> impl Iterator<Item = &'static str> {
        let arguments = match self {
            Self::Ffv1 => "-c:v ffv1 -level 3 -g 1 -slicecrc 1 -f matroska",
            Self::H264 => "-c:v libx264 -pix_fmt yuv420p -crf 16 -movflags +faststart -f mp4",
            Self::H264Lossless => "-c:v libx264rgb -qp 0 -movflags +faststart -f mp4",
        };
        arguments.split(' ')
    }
}

/// A video file that is being written. It appears at its path when it is finished; dropped before, it leaves no file.
pub struct VideoWriter {
    path: PathBuf,
    /// The pipe to ffmpeg. Declared before the process, which ends when the pipe is closed.
    stdin: Option<ChildStdin>,
    process: Option<Process>,
    size: (usize, usize, usize),
    depth: BitDepth,
    /// Declared last, so that it is removed after ffmpeg, which writes into it, has ended.
    temporary: Temporary,
}

/// The video in its temporary folder.
const FILE: &str = "video";

impl VideoWriter {
    /// Begins a video whose frames all have the size and channels (1 or 3) of `like`.
    pub fn create(
        ffmpeg: &Path,
        path: &Path,
        like: &Image,
        format: VideoFormat,
    ) -> Result<Self, VideoError> {
        let VideoFormat { depth, rate_hz, codec } = format;
        let temporary = Temporary::for_file(path)
            .map_err(|source| VideoError::File { path: path.to_owned(), source })?;
        let pixel_format = match (like.channels(), depth) {
            (1, BitDepth::Eight) => "gray",
            (1, BitDepth::Sixteen) => "gray16le",
            (_, BitDepth::Eight) => "rgb24",
            (_, BitDepth::Sixteen) => "rgb48le",
        };
        // A name may begin with `-`, or look like a protocol.
        let mut output = std::ffi::OsString::from("file:");
        output.push(temporary.path().join(FILE));
        let mut command = Command::new(ffmpeg);
        command
            .args(["-hide_banner", "-loglevel", "error", "-y", "-f", "rawvideo"])
            .args(["-pixel_format", pixel_format])
            .args(["-video_size", &format!("{}x{}", like.width(), like.height())])
            .args(["-framerate", &format!("{rate_hz}"), "-i", "pipe:0"])
            .args(codec.arguments())
            // Equal frames give equal bytes on every machine.
            .args(["-fflags", "+bitexact", "-flags:v", "+bitexact", "-threads", "1"])
            .arg(output);
        let mut process = Process::start(&mut command, Stdio::piped())
            .map_err(|source| VideoError::File { path: ffmpeg.to_owned(), source })?;
        Ok(Self {
            path: path.to_owned(),
            stdin: process.take_stdin(),
            process: Some(process),
            size: (like.width(), like.height(), like.channels()),
            depth,
            temporary,
        })
    }

    /// Appends a frame.
    ///
    /// # Panics
    /// If its size or channels differ from those of the first.
    pub fn push(&mut self, image: &Image) -> Result<(), VideoError> {
        assert_eq!(
            (image.width(), image.height(), image.channels()),
            self.size,
            "one size a video"
        );
        let bytes = match quantize(image, None, self.depth).1 {
            Samples::Eight(samples) => samples,
            Samples::Sixteen(samples) => samples.into_iter().flat_map(u16::to_le_bytes).collect(),
        };
        match self.stdin.as_mut().map(|pipe| pipe.write_all(&bytes)) {
            Some(Ok(())) => Ok(()),
            // ffmpeg has ended; its message says why.
            _ => Err(self.end().err().unwrap_or_else(|| self.broken("ffmpeg ended early"))),
        }
    }

    /// Ends the video and renames it to its path.
    pub fn finish(mut self) -> Result<(), VideoError> {
        self.end()?;
        self.temporary
            .place(FILE, &self.path)
            .map_err(|source| VideoError::File { path: self.path.clone(), source })
    }

    fn end(&mut self) -> Result<(), VideoError> {
        drop(self.stdin.take());
        let Some(process) = self.process.take() else { return Ok(()) };
        let Ended { status, stderr } = process
            .wait()
            .map_err(|source| VideoError::File { path: self.path.clone(), source })?;
        if status.success() {
            return Ok(());
        }
        let last = stderr.lines().map(without_address).rfind(|line| !line.is_empty());
        Err(self.broken(last.unwrap_or("ffmpeg failed")))
    }

    fn broken(&self, reason: &str) -> VideoError {
        VideoError::Encode { path: self.path.clone(), reason: reason.to_owned() }
    }
}
