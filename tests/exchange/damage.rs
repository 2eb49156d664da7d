//! Videos with broken packets: the intact frames are imported, the others are left out.

use crate::common::{assert_refused, ffmpeg, stderr, text};
use crate::{array, clocks, encode, import, open};
use std::ops::Range;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use stlfr::random::Random;
use tempfile::TempDir;

/// Noise makes packets so large that damage inside of one is found.
const NOISE: &str = "-f lavfi -i testsrc2=size=320x240:rate=30 -frames:v 40 \
                     -vf noise=alls=12:allf=t:all_seed=1";
const H264: &str =
    "-c:v libx264 -preset veryfast -threads 1 -pix_fmt yuv420p -g 8 -bf 2 -sc_threshold 0";

/// A packet: its bytes in the file, the index of its frame in presentation order, and whether it is a keyframe.
struct CodedFrame {
    bytes: Range<usize>,
    frame: usize,
    is_key: bool,
}

/// The packets of an MP4 or MOV file without sound, which holds them one after another.
fn coded_frames(path: &Path) -> Vec<CodedFrame> {
    let output = Command::new(ffmpeg())
        .args(["-v", "error", "-i", text(path), "-c", "copy", "-f", "framecrc", "-"])
        .output()
        .unwrap();
    let listing = String::from_utf8(output.stdout).unwrap();
    let rows: Vec<Vec<&str>> = listing
        .lines()
        .filter(|line| !line.starts_with('#'))
        .map(|line| line.split(',').map(str::trim).collect())
        .collect();
    let time = |row: &Vec<&str>| row[2].parse::<i64>().unwrap();
    let bytes = std::fs::read(path).unwrap();
    let mut start = bytes.windows(4).position(|w| w == b"mdat").unwrap() + 4;
    rows.iter()
        .map(|row| {
            let size: usize = row[4].parse().unwrap();
            start += size;
            CodedFrame {
                bytes: start - size..start,
                frame: rows.iter().filter(|other| time(other) < time(row)).count(),
                is_key: row.len() == 6,
            }
        })
        .collect()
}

/// The frames of the packets from the one before `damaged` to the next keyframe, sorted.
fn lost(packets: &[CodedFrame], damaged: usize) -> Vec<usize> {
    let is_key = |k: &usize| packets[*k].is_key;
    let end = (damaged + 1..packets.len()).find(is_key).unwrap_or(packets.len());
    let mut lost: Vec<usize> =
        packets[damaged.saturating_sub(1)..end].iter().map(|p| p.frame).collect();
    lost.sort_unstable();
    lost
}

/// An undamaged video, imported as the capture `capture` of a folder.
struct UndamagedVideo {
    folder: TempDir,
    video: PathBuf,
}

impl UndamagedVideo {
    /// Encodes a video with ffmpeg's own arguments and imports it.
    fn encode(arguments: &str, name: &str) -> Self {
        let folder = array(&["a"]);
        let video = folder.path().join("film").join(name);
        encode(arguments, &video);
        let output = import(folder.path(), &[]);
        assert!(output.status.success(), "{}", stderr(&output));
        assert!(!stderr(&output).contains("damaged"), "{}", stderr(&output));
        let linked = folder.path().join("capture").join(name);
        assert_eq!(linked.metadata().unwrap().ino(), video.metadata().unwrap().ino(), "a link");
        Self { folder, video }
    }

    /// Imports the video with other bytes from a new folder.
    fn damaged(&self, bytes: &[u8], more: &[&str]) -> (TempDir, Output) {
        let folder = array(&["a"]);
        let video = folder.path().join("film").join(self.video.file_name().unwrap());
        std::fs::write(&video, bytes).unwrap();
        let output = import(folder.path(), more);
        assert!(std::fs::read(&video).unwrap() == bytes, "the user's file is as it was");
        (folder, output)
    }

    /// The imported frames, by their times at 30 Hz. Each must have the pixels and the time of the undamaged video.
    #[track_caller]
    fn imported(&self, folder: &Path) -> Vec<usize> {
        let [whole, damaged] = [self.folder.path(), folder].map(|f| open(&f.join("capture")));
        let clock = &clocks(&folder.join("capture"))[0];
        let times_s: Vec<f64> = match clock["times_s"].as_array() {
            Some(times) => times.iter().map(|t| t.as_f64().unwrap()).collect(),
            None => {
                let [rate_hz, first_s] = ["rate_hz", "first_s"].map(|k| clock[k].as_f64().unwrap());
                let count = damaged.cameras[0].frames.len();
                (0..count).map(|k| first_s + k as f64 / rate_hz).collect()
            }
        };
        assert_eq!(times_s.len(), damaged.cameras[0].frames.len());
        let frame = |(k, time_s): (usize, &f64)| {
            let frame = (time_s * 30.0).round();
            assert!((time_s - frame / 30.0).abs() < 1e-9, "{time_s}");
            let (a, b) = (whole.read_frame(0, frame as usize), damaged.read_frame(0, k));
            assert!(a.unwrap() == b.unwrap(), "frame {frame} has other pixels");
            frame as usize
        };
        times_s.iter().enumerate().map(frame).collect()
    }
}

/// Overwrites bytes with random ones.
fn overwrite(bytes: &mut [u8], seed: u64) {
    let mut random = Random::new(seed);
    bytes.fill_with(|| (256.0 * random.unit()) as u8);
}

#[test]
fn frames_that_depend_on_a_broken_packet_are_left_out() {
    let whole = UndamagedVideo::encode(&format!("{NOISE} {H264}"), "a.mp4");
    let bytes = std::fs::read(&whole.video).unwrap();
    let packets = coded_frames(&whole.video);
    assert_eq!((packets.len(), packets.iter().filter(|p| p.is_key).count()), (40, 5));
    // A keyframe, frames of all types, and the last packets of a group and of the film.
    let mut silent = 0;
    for (seed, (k, size)) in
        [(8, 300), (0, 2000), (9, 200), (3, 100), (22, 64), (31, 40), (39, 30), (12, 4)]
            .into_iter()
            .enumerate()
    {
        let Range { start, end } = packets[k].bytes;
        let size = size.min((end - start) / 2);
        // The last one is the length of the first unit of data in the packet.
        let at = if size == 4 { start } else { (start + end - size) / 2 };
        let mut damaged = bytes.clone();
        overwrite(&mut damaged[at..at + size], seed as u64);
        let (folder, output) = whole.damaged(&damaged, &[]);
        assert!(output.status.success(), "{}", stderr(&output));
        if !stderr(&output).contains("left out") {
            silent += 1; // wrong bits that are valid
            continue;
        }
        let lost = lost(&packets, k);
        let note = format!("a.mp4: {} of 40 frames are damaged and left out.", lost.len());
        assert!(stderr(&output).contains(&note), "{k}: {}", stderr(&output));
        let expected: Vec<usize> = (0..40).filter(|frame| !lost.contains(frame)).collect();
        assert_eq!(whole.imported(folder.path()), expected, "{k}");
        let names = folder.path().join("capture").read_dir().unwrap();
        let names = names.map(|entry| entry.unwrap().file_name().into_string().unwrap());
        assert!(!names.into_iter().any(|name| name.ends_with("mp4")), "no damaged video");
        assert_eq!(folder.path().read_dir().unwrap().count(), 3, "nothing is left");
    }
    assert!(silent <= 2, "{silent} were not found");
}

/// Frames before a keyframe in presentation order and after it in decoding order depend on the group before.
#[test]
fn leading_frames_of_the_next_keyframe_are_left_out() {
    let open = "-x264-params open-gop=1:scenecut=0:b-adapt=0:bframes=3:keyint=8";
    let whole = UndamagedVideo::encode(&format!("{NOISE} {H264} {open}"), "a.mp4");
    let mut bytes = std::fs::read(&whole.video).unwrap();
    let packets = coded_frames(&whole.video);
    let key = (12..40).find(|k| packets[*k].is_key).unwrap();
    assert!(packets[key + 1].frame < packets[key].frame, "the group is open");
    bytes[packets[key - 4].bytes.start] = 0xff;
    let (folder, output) = whole.damaged(&bytes, &[]);
    assert!(output.status.success(), "{}", stderr(&output));
    let mut lost = lost(&packets, key - 4);
    let leading = packets[key + 1..].iter().map(|p| p.frame);
    lost.extend(leading.take_while(|frame| *frame < packets[key].frame));
    let expected: Vec<usize> = (0..40).filter(|frame| !lost.contains(frame)).collect();
    assert_eq!(whole.imported(folder.path()), expected);
}

#[test]
fn a_film_that_breaks_off_ends_there() {
    for (name, codec) in [("a.ts", H264), ("a.mkv", H264), ("a.mkv", "-c:v ffv1 -g 4")] {
        let whole = UndamagedVideo::encode(&format!("{NOISE} {codec}"), name);
        let bytes = std::fs::read(&whole.video).unwrap();
        let (folder, output) = whole.damaged(&bytes[..bytes.len() * 3 / 5 + 77], &[]);
        assert!(output.status.success(), "{name}: {}", stderr(&output));
        let words = ["left out.", "the file is damaged, but none of its"];
        assert!(words.iter().any(|words| stderr(&output).contains(words)), "{}", stderr(&output));
        let frames = whole.imported(folder.path());
        assert!(frames.len() > 12 && frames.len() < 30, "{frames:?}");
        assert!(frames.iter().take(12).copied().eq(0..12), "{frames:?}");
    }
}

/// A container without a table loses packets.
#[test]
fn lost_packets_count_as_damaged_frames() {
    let whole = UndamagedVideo::encode(&format!("{NOISE} {H264}"), "a.ts");
    let mut bytes = std::fs::read(&whole.video).unwrap();
    // A transport stream consists of packets of 188 bytes, with a counter of four bits.
    let from = bytes.len() / 2 / 188 * 188;
    bytes.drain(from..from + 188 * 16 * 4 + 188 * 3);
    let (folder, output) = whole.damaged(&bytes, &[]);
    assert!(output.status.success(), "{}", stderr(&output));
    let frames = whole.imported(folder.path());
    assert!(frames.len() >= 16 && *frames.last().unwrap() == 39, "{frames:?}");
    let note = format!("a.ts: {} of 40 frames are damaged and left out.", 40 - frames.len());
    assert!(stderr(&output).contains(&note), "{}", stderr(&output));
}

#[test]
fn rates_and_tables_count_the_damaged_frames() {
    let whole = UndamagedVideo::encode(&format!("{NOISE} -c:v ffv1 -g 1"), "a.mkv");
    let mut bytes = std::fs::read(&whole.video).unwrap();
    let middle = bytes.len() / 2;
    bytes[middle..middle + 64].fill(0x55);
    let (folder, output) = whole.damaged(&bytes, &[]);
    let note = "a.mkv: 2 of 40 frames are damaged and left out.";
    assert!(stderr(&output).contains(note), "{}", stderr(&output));
    let frames = whole.imported(folder.path());
    let times_s = |folder: &Path| -> Vec<f64> {
        let times = clocks(&folder.join("capture"))[0]["times_s"].clone();
        times.as_array().unwrap().iter().map(|t| t.as_f64().unwrap()).collect()
    };
    let (folder, output) = whole.damaged(&bytes, &["--rate", "240", "--first", "2"]);
    assert!(output.status.success(), "{}", stderr(&output));
    let expected: Vec<f64> = frames.iter().map(|k| 2.0 + *k as f64 / 240.0).collect();
    assert_eq!(times_s(folder.path()), expected);

    let table = whole.folder.path().join("times.csv");
    let rows: String = (0..40).map(|k| format!("a,{}\n", 3 * k + k % 2)).collect();
    std::fs::write(&table, format!("camera,time_s\n{rows}")).unwrap();
    let (folder, output) = whole.damaged(&bytes, &["--times", text(&table)]);
    assert!(output.status.success(), "{}", stderr(&output));
    let expected: Vec<f64> = frames.iter().map(|k| (3 * k + k % 2) as f64).collect();
    assert_eq!(times_s(folder.path()), expected);
}

#[test]
fn the_rotation_of_a_damaged_film_is_applied() {
    let flat = tempfile::tempdir().unwrap();
    let flat = flat.path().join("flat.mp4");
    let upright = NOISE.replace("320x240", "240x320");
    encode(&format!("{upright} {H264}"), &flat);
    let rotate = format!("-display_rotation 90 -i {} -c copy", flat.display());
    let whole = UndamagedVideo::encode(&rotate, "a.mp4");
    let mut bytes = std::fs::read(&whole.video).unwrap();
    let packets = coded_frames(&whole.video);
    bytes[packets[19].bytes.start] = 0xff;
    let (folder, output) = whole.damaged(&bytes, &[]);
    assert!(output.status.success(), "{}", stderr(&output));
    let lost = lost(&packets, 19);
    let expected: Vec<usize> = (0..40).filter(|frame| !lost.contains(frame)).collect();
    assert_eq!(whole.imported(folder.path()), expected);
    let image = open(&folder.path().join("capture")).read_frame(0, 0).unwrap();
    assert_eq!((image.width(), image.height()), (320, 240));
}

#[test]
fn a_video_without_intact_frames_is_refused() {
    let whole = UndamagedVideo::encode(&format!("{NOISE} {H264} -g 40"), "a.mp4");
    let bytes = std::fs::read(&whole.video).unwrap();
    let packets = coded_frames(&whole.video);
    for k in [0, 2] {
        let mut damaged = bytes.clone();
        damaged[packets[k].bytes.start] = 0xff;
        let (folder, output) = whole.damaged(&damaged, &[]);
        let words = "a.mp4: is damaged, and fewer than two of its 40 frames are intact";
        assert_refused(&output, 2, words);
        assert_eq!(folder.path().read_dir().unwrap().count(), 2, "nothing is left");
    }
    // The end of the file holds its table of packets.
    let (_, output) = whole.damaged(&bytes[..bytes.len() / 2], &[]);
    assert_refused(&output, 2, "a.mp4: is not a whole video that ffmpeg can read");
}
