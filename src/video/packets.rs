//! Packets of a video stream: the coded frames as the container holds them, in the order in which they are decoded.

use super::VideoError;
use super::reader::{VideoSource, has_space, max_pixels, rows, wrong};
use std::fs::File;
use std::ops::Range;
use std::os::unix::fs::FileExt;

/// Name of the temporary file in which ffmpeg lists the packets.
const PACKETS_FILE: &str = "packets.txt";
/// Name of the temporary file for some of a video's packets.
pub(super) const EXCERPT_FILE: &str = "excerpt.nut";

/// A packet of a video stream.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Packet {
    /// Presentation time, microseconds from the file's start.
    pub time_us: i64,
    /// Decoding time, microseconds; `None` if it is unknown.
    decoding_us: Option<i64>,
    pub is_key: bool,
    /// True if the container says that the packet is damaged, or if a packet before it may be missing.
    pub is_broken: bool,
    /// False if the frame is decoded, but is outside of the part of the video that is shown.
    pub is_shown: bool,
}

/// The packets of a video stream, in decoding order.
pub(super) struct Packets {
    pub list: Vec<Packet>,
    /// True if the container has no table of all packets, so that damage can remove packets from the list.
    pub may_lack_some: bool,
}

/// Flags of a packet in a framecrc listing.
const KEY: u32 = 1;
const BROKEN: u32 = 2;
const DISCARDED: u32 = 4;

/// Number of packets before a gap in the decoding times that are taken for broken. The missing packet precedes the gap
/// by the depth of the decoder's reordering buffer, because Matroska stores no decoding times, and ffmpeg derives them.
/// If the number is smaller than the depth, 16 frames in H.264 and HEVC, frames that depend on the missing packet are
/// taken for intact. If it is larger, intact frames are lost.
const REORDERED: usize = 16;

/// Ratio of the interval between two decoding times to the median interval, above which packets may be missing.
const GAP: f64 = 1.5;

impl Packets {
    /// Lists the packets of a file's first video stream. `None` if the container can't be read, or if it has packets
    /// without presentation times.
    ///
    /// # Errors
    /// If there are more packets than the source's `max_frames`, if the disk is full, or if ffmpeg can't be started.
    pub fn of(source: &VideoSource) -> Result<Option<Self>, VideoError> {
        let mut command = source.command(max_pixels(), &[]);
        command
            // Without this option, packets before the first keyframe are not copied.
            .args(["-map", "0:V:0", "-c", "copy", "-copyinkf"])
            .args(["-frames:v", &(source.max_frames + 1).to_string()])
            .args(["-f", "framecrc", PACKETS_FILE]);
        source.remove(PACKETS_FILE)?;
        let ended = source.run(&mut command)?;
        has_space(&ended, source.folder)?;
        let listing = source.text(PACKETS_FILE)?;
        let Some(mut list) = parsed(&listing).filter(|list| !list.is_empty()) else {
            return Ok(None);
        };
        if list.len() > source.max_frames {
            return Err(wrong(format!("has more than {} frames", source.max_frames)));
        }
        let may_lack_some = !has_table(source.video);
        if may_lack_some {
            break_at_gaps(&mut list);
        }
        Ok(Some(Self { list, may_lack_some }))
    }

    /// Returns the index of the first keyframe from `index` on.
    pub fn next_key(&self, index: usize) -> usize {
        let found = self.list.iter().skip(index).position(|packet| packet.is_key);
        found.map_or(self.list.len(), |k| index + k)
    }

    /// Returns the index of the first broken packet from `index` on. `None` if there is none.
    pub fn next_broken(&self, index: usize) -> Option<usize> {
        let found = self.list.iter().skip(index).position(|packet| packet.is_broken);
        found.map(|k| index + k)
    }

    /// Returns the leading packets of a keyframe. They follow it in decoding order and precede it in presentation
    /// order, and may depend on packets before the keyframe.
    pub fn leading(&self, key: usize) -> Range<usize> {
        let is_leading =
            |packet: &&Packet| !packet.is_key && packet.time_us < self.list[key].time_us;
        let count = self.list[key + 1..].iter().take_while(is_leading).count();
        key + 1..key + 1 + count
    }

    /// Copies packets into [`EXCERPT_FILE`]. The first one must be a keyframe; its leading packets are skipped.
    pub fn copy(&self, source: &VideoSource, range: &Range<usize>) -> Result<(), VideoError> {
        let Range { start, end } = range;
        let leading = self.leading(*start);
        let (first, last) = (leading.start, leading.end as i64 - 1);
        // ffmpeg's packet filter `noise` drops the packets for which the expression is positive. It counts them from 0.
        let drop = format!(r"noise=drop=lt(n\,{start})+between(n\,{first}\,{last})+gte(n\,{end})");
        let mut command = source.command(max_pixels(), &[]);
        command
            .args(["-map", "0:V:0", "-c", "copy", "-copyinkf", "-bsf:v", &drop])
            // ffmpeg needn't read further.
            .args(["-frames:v", &end.to_string(), "-f", "nut", EXCERPT_FILE]);
        source.remove(EXCERPT_FILE)?;
        let ended = source.run(&mut command)?;
        has_space(&ended, source.folder)
    }
}

/// Parses a framecrc listing of packets: decoding time, presentation time, and the flags unless the packet is an intact
/// keyframe. Times are multiples of the time base in the header. `None` if it isn't such a listing, or if a packet has
/// no presentation time.
fn parsed(listing: &str) -> Option<Vec<Packet>> {
    let base = listing.lines().find_map(|line| line.strip_prefix("#tb 0: "))?;
    let (numerator, denominator) = base.trim().split_once('/')?;
    let [numerator, denominator]: [i128; 2] =
        [numerator.parse().ok()?, denominator.parse().ok().filter(|d| *d > 0)?];
    let time_us = |column: &str| {
        let time = column.parse::<i64>().ok().filter(|time| *time != i64::MIN)?;
        let scaled = i128::from(time) * numerator * 2_000_000 + denominator;
        i64::try_from(scaled.div_euclid(2 * denominator)).ok()
    };
    let packet = |line| {
        let columns: Vec<&str> = str::split(line, ',').map(str::trim).collect();
        let flags = columns.iter().find_map(|column| column.strip_prefix("F=0x"));
        let flags = flags.map_or(Some(KEY), |flags| u32::from_str_radix(flags, 16).ok())?;
        Some(Packet {
            time_us: time_us(columns.get(2)?)?,
            decoding_us: time_us(columns.get(1)?),
            is_key: flags & KEY != 0,
            is_broken: flags & BROKEN != 0,
            is_shown: flags & DISCARDED == 0,
        })
    };
    rows(listing).map(packet).collect()
}

/// Returns whether a file begins like QuickTime or MP4, whose tables list all packets.
fn has_table(video: &File) -> bool {
    let mut head = [0; 8];
    let atoms = [b"ftyp", b"moov", b"mdat", b"wide", b"free", b"skip"];
    video.read_exact_at(&mut head, 0).is_ok() && atoms.iter().any(|atom| head[4..] == atom[..])
}

/// Marks the packets around gaps in the decoding times as broken. A keyframe after a gap stays as it is.
fn break_at_gaps(list: &mut [Packet]) {
    let interval =
        |pair: &[Packet]| Some(pair[1].decoding_us?.saturating_sub(pair[0].decoding_us?));
    let intervals: Vec<Option<i64>> = list.windows(2).map(interval).collect();
    let mut sorted: Vec<i64> = intervals.iter().flatten().copied().collect();
    sorted.sort_unstable();
    let Some(median) = sorted.get(sorted.len() / 2) else { return };
    for (k, interval) in intervals.iter().enumerate() {
        if interval.is_some_and(|interval| interval as f64 > GAP * *median as f64) {
            let end = if list[k + 1].is_key { k + 1 } else { k + 2 };
            let from = (k + 1).saturating_sub(REORDERED);
            list[from..end].iter_mut().for_each(|packet| packet.is_broken = true);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const LISTING: &str = "#software: Lavf\n#tb 0: 1/15360\n\
        0,      -1024,          0,      512,     1552, 0x62519bdc\n\
        0,       -512,       1536,      512,       46, 0x85d113d0, F=0x0\n\
        0,          0,        512,      512,       13, 0x159f04c5, F=0x2, S=1, Stream ID, 1, 0xe0\n\
        0,        512,       1024,      512,       13, 0x134f0455, F=0x5\n";

    #[test]
    fn packets_are_read_with_their_flags() {
        let list = parsed(LISTING).unwrap();
        assert_eq!(
            list.iter().map(|p| p.time_us).collect::<Vec<_>>(),
            [0, 100_000, 33_333, 66_667]
        );
        assert_eq!(list[0].decoding_us, Some(-66_667));
        assert_eq!(list.iter().map(|p| p.is_key).collect::<Vec<_>>(), [true, false, false, true]);
        assert_eq!(list.iter().position(|p| p.is_broken), Some(2));
        assert_eq!(list.iter().position(|p| !p.is_shown), Some(3));
        let untimed = LISTING.replace("1536", "-9223372036854775808");
        assert!(parsed(&untimed).is_none() && parsed("").is_none());
    }

    /// Packets of 25 Hz in presentation order. `keys` are the indices of the keyframes.
    fn packets(times: &[i64], keys: &[usize]) -> Vec<Packet> {
        let packet = |(k, time): (usize, &i64)| Packet {
            time_us: 40_000 * time,
            decoding_us: Some(40_000 * time),
            is_key: keys.contains(&k),
            is_broken: false,
            is_shown: true,
        };
        times.iter().enumerate().map(packet).collect()
    }

    #[test]
    fn leading_packets_follow_their_keyframe() {
        let list = packets(&[0, 2, 1, 5, 3, 4, 6], &[0, 3]);
        let packets = Packets { list, may_lack_some: false };
        assert_eq!([packets.leading(0), packets.leading(3)], [1..1, 4..6]);
        assert_eq!([0, 1, 4].map(|k| packets.next_key(k)), [0, 3, 7]);
    }

    #[test]
    fn packets_before_a_gap_are_broken() {
        let times: Vec<i64> = (0..30).chain(33..40).collect();
        for (keys, expected) in [([0, 20], 14..31), ([0, 30], 14..30)] {
            let mut list = packets(&times, &keys);
            break_at_gaps(&mut list);
            let broken: Vec<usize> = (0..list.len()).filter(|k| list[*k].is_broken).collect();
            assert_eq!(broken, expected.collect::<Vec<_>>());
        }
        let mut even = packets(&[0, 1, 2, 3], &[0]);
        break_at_gaps(&mut even);
        assert!(!even.iter().any(|packet| packet.is_broken));
    }
}
