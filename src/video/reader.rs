//! Decodes a video into numbered images.
//!
//! ffmpeg converts colours to full-range grey or RGB: with 8 bits if the video has 8 bits, otherwise with 16. A
//! rotation in the file's metadata is applied, as players do. Interlaced video is refused, because the two fields of a
//! frame were filmed at two instants.

use super::{VideoError, without_address};
use crate::host::ignore_absent;
use crate::host::process::{Ended, Process};
use crate::raster::MAX_PIXELS;
use std::fs::File;
use std::io;
use std::path::Path;
use std::process::{Command, Stdio};

/// Container formats that are read. Other formats, such as playlists, could make ffmpeg open other files.
const CONTAINERS: &str =
    "matroska,webm,mov,mp4,m4a,3gp,3g2,mj2,avi,mpegts,mpeg,mxf,nut,yuv4mpegpipe,ogg,asf,flv,ivf";

/// Name of the temporary file to which ffmpeg writes the size of the images, and the time stamps of the frames in
/// microseconds.
pub(super) const STAMPS_FILE: &str = "stamps.txt";

/// Input options with which ffmpeg stops at the first error.
pub(super) const STRICT: [&str; 3] = ["-xerror", "-err_detect", "explode"];

/// Input options that make the decoder use one thread. With more threads, an H.264 frame may be output before the
/// decoder finds that it must conceal an error in the frame, and the error is lost.
pub(super) const ONE_THREAD: [&str; 2] = ["-threads", "1"];

/// Name of the temporary file in which ffmpeg lists the first interlaced frame, if there is one.
const FIELDS_FILE: &str = "fields.txt";

/// Returns the file name of the decoded frame with the given index, counted from 0.
pub(crate) fn frame_name(index: usize) -> String {
    format!("{index:06}.png")
}

/// Maximum side of the blocks in which codecs store images, pixels. Limits on the image size are rounded up to
/// multiples of it.
const BLOCK_PX: usize = 128;

/// Limits on the number of a video's frames and on their size. A video that exceeds them is refused.
#[derive(Clone, Copy, Debug)]
pub struct VideoLimits {
    pub max_frames: usize,
    /// Expected width and height of the images, pixels. The maximum number of pixels of an image is their product,
    /// after both are rounded up to multiples of 128.
    pub size: [usize; 2],
}

impl VideoLimits {
    pub(super) fn max_pixels(self) -> usize {
        self.size.iter().map(|side| side.next_multiple_of(BLOCK_PX)).product()
    }
}

/// Path under which ffmpeg reads the open file on its standard input. ffmpeg reads this file even if another file is
/// moved to the video's path meanwhile.
const INPUT: &str = "file:/proc/self/fd/0";

/// Size of a video's images after decoding and rotation, and the time stamps of its frames.
#[derive(Clone, Debug, PartialEq)]
pub struct VideoFacts {
    /// Width and height of the images, pixels.
    pub size: [usize; 2],
    /// Time stamp of every frame, seconds from the file's start.
    pub times_s: Vec<f64>,
}

/// Decodes a file's first video stream into image files in `folder`: 000000.png, 000001.png and so on. The memory use
/// doesn't depend on the video's length. Returns the time stamp of every frame, seconds.
///
/// # Errors
/// If there are more frames or larger images than `limits` allow, if frames are interlaced, and for any error in the
/// file, because ffmpeg would conceal damaged frames.
pub fn decode(
    ffmpeg: &Path,
    video: &File,
    folder: &Path,
    limits: VideoLimits,
) -> Result<Vec<f64>, VideoError> {
    let source = VideoSource { ffmpeg, video, folder, max_frames: limits.max_frames };
    let mut command = source.command(limits.max_pixels(), &STRICT);
    add_images(&mut command, limits.max_frames);
    Ok(facts(&source, &mut command, Some(limits.size))?.times_s)
}

/// Decodes a file's first video stream without writing its images. Returns the images' size and the frames' time
/// stamps. `folder` is for temporary files. The errors are those of [`decode`].
pub fn inspect(
    ffmpeg: &Path,
    video: &File,
    folder: &Path,
    max_frames: usize,
) -> Result<VideoFacts, VideoError> {
    let source = VideoSource { ffmpeg, video, folder, max_frames };
    let mut command = source.command(max_pixels(), &[&ONE_THREAD[..], &STRICT].concat());
    facts(&source, &mut command, None)
}

/// Returns the largest number of pixels of an image in any video.
pub(super) fn max_pixels() -> usize {
    usize::try_from(MAX_PIXELS).unwrap_or(usize::MAX)
}

/// A video that ffmpeg reads from its standard input, with a folder for the files that ffmpeg writes.
#[derive(Clone, Copy)]
pub(super) struct VideoSource<'a> {
    pub ffmpeg: &'a Path,
    pub video: &'a File,
    pub folder: &'a Path,
    pub max_frames: usize,
}

impl VideoSource<'_> {
    /// Returns the ffmpeg command that reads its standard input with these input options. Output files with relative
    /// names are written into the folder. An image of more than `max_pixels` pixels is an error.
    pub fn command(&self, max_pixels: usize, input_options: &[&str]) -> Command {
        let mut command = Command::new(self.ffmpeg);
        command
            // Names of outputs are relative to the folder, because ffmpeg would take a `%` in the folder's name for a
            // pattern.
            .current_dir(self.folder)
            .env_remove("FFREPORT")
            .args(["-hide_banner", "-loglevel", "error", "-nostdin", "-y"])
            .args(["-protocol_whitelist", "file", "-format_whitelist", CONTAINERS])
            .args(["-max_pixels", &max_pixels.to_string()])
            .args(input_options)
            .args(["-i", INPUT]);
        command
    }

    /// Runs an ffmpeg command to its end. The listings of an earlier run are removed first.
    pub fn run(&self, command: &mut Command) -> Result<Ended, VideoError> {
        self.remove(STAMPS_FILE)?;
        self.remove(FIELDS_FILE)?;
        let file = self.video.try_clone();
        let started = file.and_then(|file| Process::start(command, Stdio::from(file)));
        started
            .and_then(Process::wait)
            .map_err(|source| VideoError::File { path: self.ffmpeg.to_owned(), source })
    }

    /// Runs an ffmpeg command to its end, after adding two listings to its outputs: all frames, and the first
    /// interlaced frame.
    pub fn run_listing(&self, command: &mut Command) -> Result<Ended, VideoError> {
        command
            .args(["-map", "0:V:0", "-fps_mode", "passthrough", "-enc_time_base", "1/1000000"])
            .args(["-frames:v", &(self.max_frames + 1).to_string()])
            .args(["-c:v", "rawvideo", "-f", "framecrc", STAMPS_FILE])
            .args(["-map", "0:V:0", "-fps_mode", "passthrough"])
            .args(["-vf", r"select=gt(interlace_type\,0)"])
            .args(["-frames:v", "1", "-c:v", "rawvideo", "-f", "framecrc", FIELDS_FILE]);
        self.run(command)
    }

    /// Returns an error if [`Self::run_listing`] found an interlaced frame.
    pub fn require_progressive(&self) -> Result<(), VideoError> {
        if frames(&self.text(FIELDS_FILE)?)?.is_empty() {
            return Ok(());
        }
        Err(wrong(
            "is interlaced, and the two fields of a frame are of two instants: deinterlace it first".into(),
        ))
    }

    /// Reads the listing of all frames that [`Self::run_listing`] wrote. An error if there are too many.
    pub fn listing(&self) -> Result<Listing, VideoError> {
        let text = self.text(STAMPS_FILE)?;
        let frames = frames(&text)?;
        if frames.len() > self.max_frames {
            return Err(wrong(format!("has more than {} frames", self.max_frames)));
        }
        Ok(Listing { size: dimensions(&text), frames })
    }

    /// Removes a file that ffmpeg may have written into the folder.
    pub fn remove(&self, name: &str) -> Result<(), VideoError> {
        let path = self.folder.join(name);
        ignore_absent(std::fs::remove_file(&path))
            .map_err(|source| VideoError::File { path, source })
    }

    /// Reads a text file that ffmpeg wrote into the folder. The text is empty if ffmpeg wrote no such file.
    pub fn text(&self, name: &str) -> Result<String, VideoError> {
        let path = self.folder.join(name);
        match std::fs::read_to_string(&path) {
            Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(String::new()),
            text => text.map_err(|source| VideoError::File { path, source }),
        }
    }
}

/// Adds an output of numbered images to an ffmpeg command.
pub(super) fn add_images(command: &mut Command, max_frames: usize) {
    command
        .args(["-map", "0:V:0", "-fps_mode", "passthrough", "-noautoscale"])
        .args(["-frames:v", &(max_frames + 1).to_string()])
        .args(["-sws_flags", "accurate_rnd+full_chroma_int+bitexact"])
        // The images are for a cache, so fast compression is better than small files.
        .args(["-c:v", "png", "-compression_level", "1"])
        .args(["-start_number", "0", "-f", "image2", "%06d.png"]);
}

/// Runs a command and returns image size and time stamps. An error if ffmpeg failed, or if the video is interlaced or
/// too long. `size`, if known, is used only in the error message about too large images.
fn facts(
    source: &VideoSource,
    command: &mut Command,
    size: Option<[usize; 2]>,
) -> Result<VideoFacts, VideoError> {
    let ended = source.run_listing(command)?;
    succeeded(&ended, source.folder, size)?;
    source.require_progressive()?;
    let Listing { size, frames } = source.listing()?;
    let size = size.ok_or_else(|| wrong("has no frames".into()))?;
    Ok(VideoFacts { size, times_s: frames.iter().map(|frame| frame.time_s()).collect() })
}

/// The frames that ffmpeg listed.
pub(super) struct Listing {
    /// Width and height of the first image, pixels. `None` without frames.
    pub size: Option<[usize; 2]>,
    pub frames: Vec<ListedFrame>,
}

/// A frame in a framecrc listing.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct ListedFrame {
    /// Time stamp, microseconds.
    pub time_us: i64,
    /// Checksum of the decoded image.
    pub checksum: u32,
}

impl ListedFrame {
    fn time_s(&self) -> f64 {
        self.time_us as f64 / 1e6
    }
}

/// Reads the image size, width and height in pixels, from the header of a framecrc listing. `None` without such a
/// header.
fn dimensions(listing: &str) -> Option<[usize; 2]> {
    let line = listing.lines().find_map(|line| line.strip_prefix("#dimensions 0: "))?;
    let (width, height) = line.trim().split_once('x')?;
    Some([width.parse().ok()?, height.parse().ok()?])
}

/// Returns an error if ffmpeg failed or reported any error. `size`, the expected image size in pixels if known, is used
/// only in the message about too large images.
pub(super) fn succeeded(
    ended: &Ended,
    folder: &Path,
    size: Option<[usize; 2]>,
) -> Result<(), VideoError> {
    if let Some(found) = too_large(&ended.stderr) {
        let allowed = match size {
            Some([width, height]) => format!("its camera {width}x{height}"),
            None => format!("at most {MAX_PIXELS} in all are read"),
        };
        return Err(wrong(format!("has images of {found} pixels, {allowed}")));
    }
    let message = ended.stderr.lines().map(without_address).find(|line| !line.is_empty());
    has_space(ended, folder)?;
    if !ended.status.success() || message.is_some() {
        let message = message.unwrap_or("it was stopped").trim_end_matches('.');
        let reason = format!("is not a whole video that ffmpeg can read ({message})");
        return Err(VideoError::Damaged { reason });
    }
    Ok(())
}

/// Returns an error if ffmpeg reported a full or read-only disk.
pub(super) fn has_space(ended: &Ended, folder: &Path) -> Result<(), VideoError> {
    let failed = |source| VideoError::File { path: folder.to_owned(), source };
    full_disk(&ended.stderr).map_or(Ok(()), |source| Err(failed(source)))
}

/// Returns the size of a video's images, such as "70000x70000", if ffmpeg's messages report that the images are larger
/// than allowed. Otherwise returns `None`.
fn too_large(messages: &str) -> Option<&str> {
    let before = &messages[..messages.find(" exceeds specified max pixel count")?];
    Some(before.rsplit_once("Picture size ")?.1)
}

/// Returns the error of a full or read-only disk if ffmpeg's messages report it, otherwise `None`.
fn full_disk(messages: &str) -> Option<io::Error> {
    [libc::ENOSPC, libc::EDQUOT, libc::EFBIG, libc::EROFS].into_iter().find_map(|number| {
        let error = io::Error::from_raw_os_error(number);
        let sentence = error.to_string();
        let words = sentence.split(" (os error").next().filter(|w| !w.is_empty())?;
        messages.contains(words).then_some(error)
    })
}

pub(super) fn wrong(reason: String) -> VideoError {
    VideoError::Decode { reason }
}

/// Parses a framecrc listing of frames. Their time stamps are in the third column, in microseconds, and the checksums
/// in the sixth.
fn frames(listing: &str) -> Result<Vec<ListedFrame>, VideoError> {
    let frame = |line: &str| {
        let columns: Vec<&str> = line.split(',').map(str::trim).collect();
        let time_us = columns.get(2)?.parse().ok()?;
        let checksum = u32::from_str_radix(columns.get(5)?.strip_prefix("0x")?, 16).ok()?;
        Some(ListedFrame { time_us, checksum })
    };
    rows(listing)
        .map(|line| frame(line).ok_or_else(|| wrong("has frames without time stamps".into())))
        .collect()
}

/// Returns the lines of a framecrc listing that are neither empty nor part of its header.
pub(super) fn rows(listing: &str) -> impl Iterator<Item = &str> {
    listing.lines().filter(|line| !line.starts_with('#') && !line.trim().is_empty())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_full_disk_is_no_broken_video() {
        let said = "[vost#0:0/png @ 0x5] Error submitting a packet to the muxer: No space left on device\n";
        assert_eq!(full_disk(said).unwrap().kind(), io::ErrorKind::StorageFull);
        assert!(full_disk("Invalid data found when processing input").is_none());
    }

    #[test]
    fn the_size_of_images_that_are_too_large_is_told() {
        let said = "[ffv1 @ 0x5] [IMGUTILS @ 0x7] Picture size 8192x4096 exceeds specified max pixel count 16384, see the documentation\n";
        assert_eq!(too_large(said), Some("8192x4096"));
        assert_eq!(too_large("Picture size 0x0 is invalid"), None);
    }

    #[test]
    fn listings_of_time_stamps() {
        let text = "#tb 0: 1/1000000\n#dimensions 0: 64x48\n0, 0, 0, 33000, 9, 0xe6\n0,  -5,   67000,    33000,   9, 0x59\n";
        let [a, b] =
            [(0, 0xe6), (67000, 0x59)].map(|(time_us, checksum)| ListedFrame { time_us, checksum });
        assert_eq!(frames(text).unwrap(), [a, b]);
        assert_eq!(b.time_s(), 0.067);
        assert_eq!(dimensions(text), Some([64, 48]));
        assert!(frames("0, 0, NOPTS, 1, 1, 0x0\n").is_err());
    }
}
