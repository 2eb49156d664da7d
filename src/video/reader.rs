//! Decodes a video into numbered images.
//!
//! ffmpeg converts colours to full-range grey or RGB: with 8 bits if the video has 8 bits, otherwise with 16. A
//! rotation in the file's metadata is applied, as players do. Interlaced video is refused, because the two fields of a
//! frame were filmed at two instants.

use super::{VideoError, without_address};
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
const STAMPS_FILE: &str = "stamps.txt";

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
    let max_pixels: usize =
        limits.size.iter().map(|side| side.next_multiple_of(BLOCK_PX)).product();
    let mut command = command(ffmpeg, folder, max_pixels);
    command
        .args(["-map", "0:V:0", "-fps_mode", "passthrough", "-noautoscale"])
        .args(["-frames:v", &(limits.max_frames + 1).to_string()])
        .args(["-sws_flags", "accurate_rnd+full_chroma_int+bitexact"])
        // The images are for a cache, so fast compression is better than small files.
        .args(["-c:v", "png", "-compression_level", "1"])
        .args(["-start_number", "0", "-f", "image2", "%06d.png"]);
    let ended = run(&mut command, ffmpeg, video, limits.max_frames)?;
    Ok(facts(&ended, folder, limits.max_frames, Some(limits.size))?.times_s)
}

/// Decodes a file's first video stream without writing its images. Returns the images' size and the frames' time
/// stamps. `folder` is for temporary files. The errors are those of [`decode`].
pub fn inspect(
    ffmpeg: &Path,
    video: &File,
    folder: &Path,
    max_frames: usize,
) -> Result<VideoFacts, VideoError> {
    let max_pixels = usize::try_from(MAX_PIXELS).unwrap_or(usize::MAX);
    let mut command = command(ffmpeg, folder, max_pixels);
    let ended = run(&mut command, ffmpeg, video, max_frames)?;
    facts(&ended, folder, max_frames, None)
}

/// Returns the ffmpeg command that decodes its standard input and stops at the first error. Output files with relative
/// names are written into `folder`. An image of more than `max_pixels` pixels is an error.
fn command(ffmpeg: &Path, folder: &Path, max_pixels: usize) -> Command {
    let mut command = Command::new(ffmpeg);
    command
        // Names of outputs are relative to the folder, because ffmpeg would take a `%` in the folder's name for a
        // pattern.
        .current_dir(folder)
        .env_remove("FFREPORT")
        .args(["-hide_banner", "-loglevel", "error", "-nostdin", "-y", "-xerror"])
        .args(["-protocol_whitelist", "file", "-format_whitelist", CONTAINERS])
        .args(["-max_pixels", &max_pixels.to_string()])
        .args(["-err_detect", "explode", "-i", INPUT]);
    command
}

/// Runs an ffmpeg command to its end, after adding two listings to its outputs: the time stamps of all frames, and the
/// first interlaced frame.
fn run(
    command: &mut Command,
    ffmpeg: &Path,
    video: &File,
    max_frames: usize,
) -> Result<Ended, VideoError> {
    command
        .args(["-map", "0:V:0", "-fps_mode", "passthrough", "-enc_time_base", "1/1000000"])
        .args(["-frames:v", &(max_frames + 1).to_string()])
        .args(["-c:v", "rawvideo", "-f", "framecrc", STAMPS_FILE])
        .args(["-map", "0:V:0", "-fps_mode", "passthrough", "-vf", r"select=gt(interlace_type\,0)"])
        .args(["-frames:v", "1", "-c:v", "rawvideo", "-f", "framecrc", FIELDS_FILE]);
    let started = video.try_clone().and_then(|file| Process::start(command, Stdio::from(file)));
    started
        .and_then(Process::wait)
        .map_err(|source| VideoError::File { path: ffmpeg.to_owned(), source })
}

/// Reads image size and time stamps from ffmpeg's listings in `folder`. An error if ffmpeg failed, or if the video is
/// interlaced or too long. `size`, if known, is used only in the error message about too large images.
fn facts(
    ended: &Ended,
    folder: &Path,
    max_frames: usize,
    size: Option<[usize; 2]>,
) -> Result<VideoFacts, VideoError> {
    succeeded(ended, folder, size)?;
    let text = |name: &str| {
        let path = folder.join(name);
        std::fs::read_to_string(&path).map_err(|source| VideoError::File { path, source })
    };
    if !times_s(&text(FIELDS_FILE)?)?.is_empty() {
        return Err(wrong(
            "is interlaced, and the two fields of a frame are of two instants: deinterlace it first".into(),
        ));
    }
    let listing = text(STAMPS_FILE)?;
    let times_s = times_s(&listing)?;
    if times_s.len() > max_frames {
        return Err(wrong(format!("has more than {max_frames} frames")));
    }
    let size = dimensions(&listing).ok_or_else(|| wrong("has no frames".into()))?;
    Ok(VideoFacts { size, times_s })
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
fn succeeded(ended: &Ended, folder: &Path, size: Option<[usize; 2]>) -> Result<(), VideoError> {
    if let Some(found) = too_large(&ended.stderr) {
        let allowed = match size {
            Some([width, height]) => format!("its camera {width}x{height}"),
            None => format!("at most {MAX_PIXELS} in all are read"),
        };
        return Err(wrong(format!("has images of {found} pixels, {allowed}")));
    }
    let message = ended.stderr.lines().map(without_address).find(|line| !line.is_empty());
    if let Some(source) = full_disk(&ended.stderr) {
        return Err(VideoError::File { path: folder.to_owned(), source });
    }
    if !ended.status.success() || message.is_some() {
        let message = message.unwrap_or("it was stopped").trim_end_matches('.');
        return Err(wrong(format!("is not a whole video that ffmpeg can read ({message})")));
    }
    Ok(())
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

fn wrong(reason: String) -> VideoError {
    VideoError::Decode { reason }
}

/// Parses the time stamps of a framecrc listing, seconds. They are in the third column, in microseconds.
fn times_s(listing: &str) -> Result<Vec<f64>, VideoError> {
    let stamp = |line: &str| line.split(',').nth(2)?.trim().parse::<i64>().ok();
    listing
        .lines()
        .filter(|line| !line.starts_with('#') && !line.trim().is_empty())
        .map(|line| {
            let time = stamp(line).ok_or_else(|| wrong("has frames without time stamps".into()))?;
            Ok(time as f64 / 1e6)
        })
        .collect()
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
        assert_eq!(times_s(text).unwrap(), [0.0, 0.067]);
        assert_eq!(dimensions(text), Some([64, 48]));
        assert!(times_s("0, 0, NOPTS, 1, 1, 0x0\n").is_err());
    }
}
