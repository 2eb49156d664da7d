//! Writes video files.

use super::{VideoError, without_address};
use crate::host::process::{Ended, Process};
use crate::host::temporary::Temporary;
use crate::raster::{BitDepth, Image, Quantized, Samples};
use std::borrow::Cow;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::{ChildStdin, Command, Stdio};

/// Codec of a video, with its container format.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Codec {
    /// FFV1 in Matroska: lossless. Every frame is coded separately and has a checksum.
    Ffv1,
    /// H.264 in MP4, which browsers play: 8 bits, 4:2:0 chroma subsampling, visually lossless.
    H264,
    /// VP9 in WebM, which browsers play: 8 bits, 4:2:0 chroma subsampling.
    Vp9,
    /// GIF with a palette of 256 colours per frame. The animation repeats forever.
    Gif,
    /// Lossless H.264 in MP4, with 8-bit RGB, for data sets that other programs read.
    H264Lossless,
}

/// Format of a video file.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct VideoFormat {
    /// Bits per channel of the encoded frames.
    pub depth: BitDepth,
    /// Frame rate, hertz.
    pub rate_hz: f64,
    /// Codec and container.
    pub codec: Codec,
}

/// ffmpeg filter for codecs with 4:2:0 chroma subsampling. It pads the sides to even numbers, converts to BT.709, and
/// labels the colours accordingly.
const BROWSER_COLORS: &str = "pad=ceil(iw/2)*2:ceil(ih/2)*2,scale=out_color_matrix=bt709:out_range=tv,format=yuv420p,\
     setparams=range=tv:color_primaries=bt709:color_trc=iec61966-2-1:colorspace=bt709";

/// ffmpeg filter for GIF. It makes one palette per frame, so that the whole video needn't be in memory.
const FRAME_PALETTES: &str =
    "split[a][b];[a]palettegen=stats_mode=single[palette];[b][palette]paletteuse=new=1";

impl Codec {
    /// Codecs that can be chosen by a file's suffix.
    pub const ALL: [Self; 4] = [Self::H264, Self::Vp9, Self::Gif, Self::Ffv1];

    /// Returns H.264 if the given ffmpeg supports it, otherwise FFV1. The check starts ffmpeg. If ffmpeg can't run, the
    /// error thus comes before rendering begins.
    pub fn for_browsers(ffmpeg: &Path) -> Result<Self, VideoError> {
        Ok(if Self::H264.is_supported(ffmpeg)? { Self::H264 } else { Self::Ffv1 })
    }

    /// Returns the codec of video files with this suffix in lower case. `None` if the suffix is unknown.
    pub fn of_suffix(suffix: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|codec| codec.suffix() == suffix)
    }

    /// Returns the suffix of the codec's files, without a dot.
    pub fn suffix(self) -> &'static str {
        match self {
            Self::Ffv1 => "mkv",
            Self::H264 | Self::H264Lossless => "mp4",
            Self::Vp9 => "webm",
            Self::Gif => "gif",
        }
    }

    /// Returns whether the codec stores 16 bits per channel.
    pub fn is_deep(self) -> bool {
        self == Self::Ffv1
    }

    /// Returns ffmpeg's name of the encoder.
    fn encoder(self) -> &'static str {
        match self {
            Self::Ffv1 => "ffv1",
            Self::H264 => "libx264",
            Self::H264Lossless => "libx264rgb",
            Self::Vp9 => "libvpx-vp9",
            Self::Gif => "gif",
        }
    }

    /// Returns an error if ffmpeg can't run or lacks the codec's encoder.
    ///
    /// # Errors
    /// [`VideoError::NoEncoder`] if the encoder is missing, [`VideoError::File`] if ffmpeg can't run.
    pub fn require(self, ffmpeg: &Path) -> Result<(), VideoError> {
        if self.is_supported(ffmpeg)? {
            return Ok(());
        }
        let (encoder, suffix) = (self.encoder(), self.suffix());
        Err(VideoError::NoEncoder { ffmpeg: ffmpeg.to_owned(), encoder, suffix })
    }

    fn is_supported(self, ffmpeg: &Path) -> Result<bool, VideoError> {
        let output = Command::new(ffmpeg)
            .args(["-hide_banner", "-encoders"])
            .stdin(Stdio::null())
            .output()
            .map_err(|source| VideoError::File { path: ffmpeg.to_owned(), source })?;
        let listed = String::from_utf8_lossy(&output.stdout);
        Ok(listed.lines().any(|line| line.split_whitespace().nth(1) == Some(self.encoder())))
    }

    fn arguments(self) -> Vec<&'static str> {
        let (filter, rest) = match self {
            Self::Ffv1 => ("", "-level 3 -g 1 -slicecrc 1 -f matroska"),
            Self::H264 => (BROWSER_COLORS, "-crf 16 -movflags +faststart -f mp4"),
            Self::H264Lossless => ("", "-qp 0 -movflags +faststart -f mp4"),
            Self::Vp9 => {
                (BROWSER_COLORS, "-crf 20 -b:v 0 -deadline good -cpu-used 4 -row-mt 0 -f webm")
            }
            Self::Gif => (FRAME_PALETTES, "-loop 0 -f gif"),
        };
        let mut arguments = vec!["-c:v", self.encoder()];
        if !filter.is_empty() {
            arguments.extend(["-vf", filter]);
        }
        arguments.extend(rest.split(' '));
        arguments
    }
}

/// A video file that is being written. The file appears at its path when it is finished. If the writer is dropped
/// before that, no file is left.
pub struct VideoWriter {
    path: PathBuf,
    /// Pipe to ffmpeg's standard input; `None` after the end of the video. Closing the pipe makes ffmpeg end. This
    /// field is declared before `process`, so that it is dropped first.
    stdin: Option<ChildStdin>,
    process: Option<Process>,
    size: (usize, usize, usize),
    depth: BitDepth,
    /// Temporary folder into which ffmpeg writes. This field is declared last, so that the folder is removed after
    /// ffmpeg has ended.
    temporary: Temporary,
}

/// Name of the unfinished video file in its temporary folder.
const FILE: &str = "video";

impl VideoWriter {
    /// Begins to write a video to `path`. All frames have the size and the number of channels (1 or 3) of `like`.
    pub fn create(
        ffmpeg: &Path,
        path: &Path,
        like: &Image,
        format: VideoFormat,
    ) -> Result<Self, VideoError> {
        Self::sized(ffmpeg, path, (like.width(), like.height(), like.channels()), format)
    }

    /// Begins to write a video to `path`. All frames have the size (width, height, channels), in pixels and with 1 or 3
    /// channels.
    pub fn sized(
        ffmpeg: &Path,
        path: &Path,
        size: (usize, usize, usize),
        format: VideoFormat,
    ) -> Result<Self, VideoError> {
        let VideoFormat { depth, rate_hz, codec } = format;
        let temporary = Temporary::for_file(path)
            .map_err(|source| VideoError::File { path: path.to_owned(), source })?;
        let pixel_format = match (size.2, depth) {
            (1, BitDepth::Eight) => "gray",
            (1, BitDepth::Sixteen) => "gray16le",
            (_, BitDepth::Eight) => "rgb24",
            (_, BitDepth::Sixteen) => "rgb48le",
        };
        // The prefix protects names that begin with `-` or look like a protocol.
        let mut output = std::ffi::OsString::from("file:");
        output.push(temporary.path().join(FILE));
        let mut command = Command::new(ffmpeg);
        command
            .args(["-hide_banner", "-loglevel", "error", "-y", "-f", "rawvideo"])
            .args(["-pixel_format", pixel_format])
            .args(["-video_size", &format!("{}x{}", size.0, size.1)])
            .args(["-framerate", &format!("{rate_hz}"), "-i", "pipe:0"])
            .args(codec.arguments())
            // These flags make equal frames give equal bytes on every machine.
            .args(["-fflags", "+bitexact", "-flags:v", "+bitexact", "-threads", "1"])
            .arg(output);
        let mut process = Process::start(&mut command, Stdio::piped())
            .map_err(|source| VideoError::File { path: ffmpeg.to_owned(), source })?;
        Ok(Self {
            path: path.to_owned(),
            stdin: process.take_stdin(),
            process: Some(process),
            size,
            depth,
            temporary,
        })
    }

    /// Quantizes a frame to the video's bit depth and appends it.
    ///
    /// # Panics
    /// If the frame's size or number of channels differs from the video's.
    pub fn push(&mut self, image: &Image) -> Result<(), VideoError> {
        self.push_quantized(&Quantized::new(image, None, self.depth))
    }

    /// Appends a frame that already has the video's bit depth.
    ///
    /// # Panics
    /// If the frame's size or number of channels differs from the video's.
    pub fn push_quantized(&mut self, frame: &Quantized) -> Result<(), VideoError> {
        assert_eq!((frame.width, frame.height, frame.channels), self.size, "one size a video");
        let bytes = match &frame.samples {
            Samples::Eight(samples) => Cow::Borrowed(samples.as_slice()),
            Samples::Sixteen(samples) => samples.iter().flat_map(|v| v.to_le_bytes()).collect(),
        };
        match self.stdin.as_mut().map(|pipe| pipe.write_all(&bytes)) {
            Some(Ok(())) => Ok(()),
            // ffmpeg has ended early. Its message gives the reason.
            _ => Err(self.end().err().unwrap_or_else(|| self.broken("ffmpeg ended early"))),
        }
    }

    /// Finishes the video, and moves it to its path.
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
