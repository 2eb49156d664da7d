//! Finds the intact frames of a damaged video, and decodes them.
//!
//! A decoder conceals damage: it outputs a frame whose pixels are copied from other frames, and every frame that is
//! predicted from it is wrong, too. The frames that ffmpeg outputs in spite of errors are therefore not to be trusted,
//! nor are their times a sign, because a frame is output later than it is decoded. A frame counts as intact if
//!
//! 1. a new decoder decodes it without any error from packets that begin at a keyframe. A binary search finds the first
//!    packet that causes an error. From this packet to the next keyframe, no frame is intact. Neither are frames that
//!    precede this keyframe in presentation order and follow it in decoding order.
//! 2. the decoder of the whole file outputs the same pixels at the same time, by checksum. The images of these frames
//!    are thus read as those of an undamaged video: with the container's colours and rotation.
//!
//! The packet before the one that causes an error is taken for damaged, too, because damage that ends in one packet may
//! begin in the other, and an error at a packet's end often decodes silently.
//!
//! Known limits: wrong bits that decode without an error are not found. They are common in HEVC, VP8, VP9 and AV1, less
//! so in H.264, and absent in FFV1, which has checksums. If the codec's header in the container is damaged, no frame is
//! intact. A container without a table of its packets, such as Matroska or MPEG-TS, may lose packets silently. They
//! leave a gap in the decoding times. A camera's pause looks the same: frames after it are left out, up to the next
//! keyframe.

use super::packets::{EXCERPT_FILE, Packets};
use super::reader::{
    ListedFrame, ONE_THREAD, STAMPS_FILE, STRICT, VideoSource, add_images, has_space, max_pixels,
    succeeded,
};
use super::{VideoError, VideoFacts, VideoLimits, frame_name};
use std::collections::{BTreeMap, BTreeSet};
use std::fs::File;
use std::ops::Range;
use std::path::{Path, PathBuf};

/// The frames of a damaged video.
#[derive(Clone, Debug)]
pub struct DamagedVideo {
    /// Image size, and the time stamps of all frames, intact or not.
    pub facts: VideoFacts,
    /// Indices of the intact frames in `facts.times_s`, ascending.
    pub intact: Vec<usize>,
    /// The intact frames in the output of the decoder of the whole file, in the order of `intact`.
    decoded: Vec<DecodedFrame>,
    /// Limit on the number of frames.
    max_frames: usize,
}

/// A frame in the output of the decoder of the whole file.
#[derive(Clone, Copy, Debug, PartialEq)]
struct DecodedFrame {
    /// Index in the output.
    index: usize,
    time_us: i64,
}

/// Largest difference between two time stamps of one frame, microseconds: both are rounded.
const ROUNDING_US: i64 = 2;

/// Input options with which ffmpeg decodes what it can. `-err_detect explode` is not among them: with it, H.264's
/// decoder loses the intact frame that is due when a damaged packet arrives.
const TOLERANT: [&str; 4] = [ONE_THREAD[0], ONE_THREAD[1], "-max_error_rate", "1"];

/// Input option with which images have one orientation in all runs. A copy of packets has no rotation.
const UNROTATED: &str = "-noautorotate";

/// Finds the intact frames of a file's first video stream. `folder` is for temporary files, of at most the video's
/// size. `None` if the container can't be read, or if its packets have no presentation times.
///
/// # Errors
/// If fewer than two frames are intact, if there are more than `max_frames` frames, if frames are interlaced, if the
/// disk is full, or if ffmpeg can't be started.
pub fn find_intact(
    ffmpeg: &Path,
    video: &File,
    folder: &Path,
    max_frames: usize,
) -> Result<Option<DamagedVideo>, VideoError> {
    let source = VideoSource { ffmpeg, video, folder, max_frames };
    let Some(packets) = Packets::of(&source)? else { return Ok(None) };
    let mut search = Search::new(&source, &packets);
    search.check_all()?;
    source.remove(EXCERPT_FILE)?;
    let few = |frames: usize| {
        let reason = format!("is damaged, and fewer than two of its {frames} frames are intact");
        VideoError::Damaged { reason }
    };
    let size = search.size.ok_or_else(|| few(packets.list.len()))?;
    let size = rotated(&source, size)?;
    let limits = VideoLimits { max_frames, size };
    let options = [&TOLERANT[..], &[UNROTATED]].concat();
    let ended = source.run_listing(&mut source.command(limits.max_pixels(), &options))?;
    has_space(&ended, folder)?;
    let mut frames = search.frames(&source.listing()?.frames);
    if packets.may_lack_some {
        frames = with_missing(frames, max_frames);
    }
    let times_s = frames.iter().map(|(time_us, _)| *time_us as f64 / 1e6).collect();
    let (intact, decoded): (Vec<_>, Vec<_>) =
        frames.iter().enumerate().filter_map(|(k, (_, decoded))| Some((k, (*decoded)?))).unzip();
    if intact.len() < 2 {
        return Err(few(frames.len()));
    }
    Ok(Some(DamagedVideo { facts: VideoFacts { size, times_s }, intact, decoded, max_frames }))
}

/// Decodes the intact frames of the video in which [`find_intact`] found them. Returns the image files in `folder`, in
/// the order of the frames.
///
/// # Errors
/// If the video has changed, if the disk is full, or if ffmpeg can't be started.
pub fn decode_intact(
    ffmpeg: &Path,
    video: &File,
    folder: &Path,
    found: &DamagedVideo,
) -> Result<Vec<PathBuf>, VideoError> {
    let max_frames = found.max_frames;
    let source = VideoSource { ffmpeg, video, folder, max_frames };
    let limits = VideoLimits { max_frames, size: found.facts.size };
    let mut command = source.command(limits.max_pixels(), &TOLERANT);
    add_images(&mut command, max_frames);
    let ended = source.run_listing(&mut command)?;
    has_space(&ended, folder)?;
    let listed = source.listing()?.frames;
    let is_there = |frame: &DecodedFrame| {
        listed.get(frame.index).is_some_and(|listed| listed.time_us == frame.time_us)
    };
    let file = |index: usize| folder.join(frame_name(index));
    let indices: BTreeSet<usize> = found.decoded.iter().map(|frame| frame.index).collect();
    if !found.decoded.iter().all(is_there) || !indices.iter().all(|k| file(*k).is_file()) {
        return Err(VideoError::Decode { reason: "changed while it was being used".into() });
    }
    for index in (0..listed.len()).filter(|index| !indices.contains(index)) {
        let path = file(index);
        std::fs::remove_file(&path).map_err(|source| VideoError::File { path, source })?;
    }
    Ok(found.decoded.iter().map(|frame| file(frame.index)).collect())
}

/// Returns the size of a video's images after rotation, from their size before it, pixels.
fn rotated(source: &VideoSource, [width, height]: [usize; 2]) -> Result<[usize; 2], VideoError> {
    let mut command = source.command(max_pixels(), &TOLERANT);
    command.args(["-map", "0:V:0", "-frames:v", "1", "-c:v", "rawvideo"]);
    command.args(["-f", "framecrc", STAMPS_FILE]);
    source.run(&mut command)?;
    // A damaged first frame may have any size.
    let is_turned = source.listing()?.size == Some([height, width]);
    Ok(if is_turned { [height, width] } else { [width, height] })
}

/// What is known about a packet.
#[derive(Clone, Copy, Debug, PartialEq)]
enum PacketCheck {
    /// The packet is damaged, or may depend on a damaged one.
    Damaged,
    /// The packet decodes without an error and gives no frame.
    Hidden,
    /// The packet decodes without an error. The frame's pixels have this checksum.
    Intact(u32),
}

/// The search for the packets that decode without an error.
struct Search<'a> {
    source: &'a VideoSource<'a>,
    packets: &'a Packets,
    /// Presentation times and indices of the packets, sorted.
    by_time: Vec<(i64, usize)>,
    checks: Vec<PacketCheck>,
    /// Width and height of the intact images before rotation, pixels. `None` before the first is found.
    size: Option<[usize; 2]>,
}

/// Number of packets in the first range that is decoded after damage; each range that decodes without an error doubles
/// it. If it is larger, more frames are decoded per damage; if it is smaller, ffmpeg is started more often.
const FIRST_STEP: usize = 16;

impl<'a> Search<'a> {
    fn new(source: &'a VideoSource, packets: &'a Packets) -> Self {
        let times = packets.list.iter().enumerate().map(|(k, packet)| (packet.time_us, k));
        let mut by_time: Vec<(i64, usize)> = times.collect();
        by_time.sort_unstable();
        let checks = vec![PacketCheck::Damaged; packets.list.len()];
        Self { source, packets, by_time, checks, size: None }
    }

    /// Checks all packets.
    fn check_all(&mut self) -> Result<(), VideoError> {
        let count = self.checks.len();
        let mut key = self.packets.next_key(0);
        while key < count {
            let damaged = self.first_damaged(key)?;
            if damaged < count && damaged > 0 {
                self.checks[damaged - 1] = PacketCheck::Damaged;
            }
            key = self.packets.next_key(damaged + 1);
        }
        Ok(())
    }

    /// Checks the packets from a keyframe to the first damaged packet, whose index it returns. The number of packets if
    /// none is damaged. Every packet is decoded a few times.
    fn first_damaged(&mut self, key: usize) -> Result<usize, VideoError> {
        // The packets before `done` are intact. The range from `start`, a keyframe, to `damaged` has an error.
        let (mut start, mut done) = (key, key);
        let mut damaged = self.packets.next_broken(key).unwrap_or(self.checks.len());
        let (mut step, mut is_bisecting) = (FIRST_STEP, false);
        while done < damaged {
            let rest = damaged - done;
            let length = if is_bisecting { rest.div_ceil(2) } else { step.min(rest) };
            if self.decodes(start..done + length)? {
                done += length;
                step *= 2;
                let is_start = |k: &usize| {
                    self.packets.list[*k].is_key && self.packets.leading(*k).end <= done
                };
                start = (start + 1..done).rev().find(is_start).unwrap_or(start);
            } else {
                damaged = done + length - 1;
                is_bisecting = true;
            }
        }
        Ok(damaged)
    }

    /// Returns whether a new decoder decodes a range of packets without an error, and stores the frames' checksums. The
    /// range starts with a keyframe, whose leading packets are not decoded.
    fn decodes(&mut self, range: Range<usize>) -> Result<bool, VideoError> {
        let folder = self.source.folder;
        self.packets.copy(self.source, &range)?;
        let Ok(excerpt) = File::open(folder.join(EXCERPT_FILE)) else { return Ok(false) };
        let copy = VideoSource { video: &excerpt, ..*self.source };
        let options = [&ONE_THREAD[..], &STRICT, &[UNROTATED]].concat();
        let ended = copy.run_listing(&mut copy.command(max_pixels(), &options))?;
        match succeeded(&ended, folder, None) {
            Err(error @ VideoError::File { .. }) => return Err(error),
            Err(_) => return Ok(false),
            Ok(()) => copy.require_progressive()?,
        }
        let listing = copy.listing()?;
        if listing.size.is_some() && self.size.is_some() && listing.size != self.size {
            return Ok(false);
        }
        self.size = self.size.or(listing.size);
        self.store(range, &listing.frames);
        Ok(true)
    }

    /// Stores the frames of a range of packets. Their times have an unknown origin: the first frame is the keyframe.
    fn store(&mut self, range: Range<usize>, frames: &[ListedFrame]) {
        let leading = self.packets.leading(range.start);
        let is_decoded = |k: &usize| range.contains(k) && !leading.contains(k);
        for k in range.clone().filter(|k| is_decoded(k)) {
            self.checks[k] = PacketCheck::Hidden;
        }
        let Some(first) = frames.first() else { return };
        let origin_us = first.time_us - self.packets.list[range.start].time_us;
        for frame in frames {
            let near = near(&self.by_time, frame.time_us - origin_us);
            if let Some((_, k)) = near.iter().find(|(_, k)| is_decoded(k)) {
                self.checks[*k] = PacketCheck::Intact(frame.checksum);
            }
        }
    }

    /// Returns the times of all frames, in microseconds, each with the intact frame in `whole`, the output of the
    /// decoder of the whole file. `None` if the frame is damaged.
    fn frames(&self, whole: &[ListedFrame]) -> Vec<(i64, Option<DecodedFrame>)> {
        let times = whole.iter().enumerate().map(|(index, frame)| (frame.time_us, index));
        let mut by_time: Vec<(i64, usize)> = times.collect();
        by_time.sort_unstable();
        let mut frames = BTreeMap::new();
        for (packet, check) in self.packets.list.iter().zip(&self.checks) {
            let near = near(&by_time, packet.time_us);
            let is_same =
                |(_, index): &&(i64, usize)| *check == PacketCheck::Intact(whole[*index].checksum);
            let intact = near.iter().find(is_same);
            let intact = intact.map(|&(time_us, index)| DecodedFrame { index, time_us });
            if packet.is_shown && !(near.is_empty() && *check == PacketCheck::Hidden) {
                // Of two packets with one time, at least one time is wrong.
                frames.entry(packet.time_us).and_modify(|frame| *frame = None).or_insert(intact);
            }
        }
        frames.into_iter().collect()
    }
}

/// Returns the entries of a sorted list whose times are equal to `time_us` but for rounding.
fn near(by_time: &[(i64, usize)], time_us: i64) -> &[(i64, usize)] {
    let from = by_time.partition_point(|(time, _)| *time < time_us - ROUNDING_US);
    let to = by_time.partition_point(|(time, _)| *time <= time_us + ROUNDING_US);
    &by_time[from..to]
}

/// Adds damaged frames in gaps of a whole number of frame periods, where packets are missing. If the number of frames
/// would exceed `max_frames`, none is added.
fn with_missing(
    frames: Vec<(i64, Option<DecodedFrame>)>,
    max_frames: usize,
) -> Vec<(i64, Option<DecodedFrame>)> {
    let intervals: Vec<i64> = frames.windows(2).map(|pair| pair[1].0 - pair[0].0).collect();
    let mut sorted = intervals.clone();
    sorted.sort_unstable();
    let Some(median) = sorted.get(sorted.len() / 2).map(|median| *median as f64) else {
        return frames;
    };
    // Containers may round times to milliseconds, so the mean is more exact than the median.
    let single: Vec<f64> =
        sorted.iter().map(|interval| *interval as f64).filter(|i| *i < 1.5 * median).collect();
    let period = single.iter().sum::<f64>() / single.len() as f64;
    let resolution = if frames.iter().all(|(time_us, _)| time_us % 1000 == 0) { 1e3 } else { 1.0 };
    let periods = |interval: &i64| {
        let count = (*interval as f64 / period).round();
        let is_whole = (*interval as f64 - count * period).abs() < 0.25 * period;
        if is_whole { count.max(1.0) } else { 1.0 }
    };
    if 1.0 + intervals.iter().map(periods).sum::<f64>() > max_frames as f64 {
        return frames;
    }
    let mut all = Vec::new();
    for (k, frame) in frames.iter().enumerate() {
        all.push(*frame);
        let Some(interval) = intervals.get(k) else { break };
        let count = periods(interval);
        for missing in 1..count as usize {
            let time = frame.0 as f64 + *interval as f64 * missing as f64 / count;
            all.push(((time / resolution).round() as i64 * resolution as i64, None));
        }
    }
    all
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn missing_frames_are_added_in_whole_gaps() {
        let frames = |times: &[i64]| times.iter().map(|t| (1000 * t, None)).collect::<Vec<_>>();
        let some = frames(&[0, 33, 67, 100, 233, 267, 300]);
        let all = frames(&[0, 33, 67, 100, 133, 167, 200, 233, 267, 300]);
        assert_eq!(with_missing(some.clone(), 10), all);
        assert_eq!(with_missing(some.clone(), 9), some);
        let uneven = frames(&[0, 33, 67, 100, 150, 183]);
        assert_eq!(with_missing(uneven.clone(), 10), uneven);
        assert_eq!(with_missing(Vec::new(), 10), []);
        let far = frames(&[0, 1, 2, i64::MAX / 2000]);
        assert_eq!(with_missing(far.clone(), 100), far);
    }

    #[test]
    fn times_are_found_in_spite_of_rounding() {
        let times = [(0, 3), (33_333, 1), (66_667, 2)];
        assert_eq!(near(&times, 33_334), &times[1..2]);
        assert!(near(&times, 40_000).is_empty() && near(&[], 0).is_empty());
    }
}
