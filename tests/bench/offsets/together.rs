//! Cameras that lose frames at about the same time, without a trace: `rigs/lost-frames.json` with no
//! loss stamped, on many seeds.

use super::captures::by_default;
use super::scene::{self, SyntheticCapture};
use std::sync::Arc;
use stlfr::capture::Capture;
use stlfr::random::Random;

type Failure = Box<dyn std::error::Error>;

const SEEDS: u64 = 20;
/// An offset or a time that is further off is wrong, frames.
const WRONG_FRAMES: f64 = 0.1;

/// A family of recordings.
struct Case {
    name: &'static str,
    frames: usize,
    /// The frames that each camera but the reference loses, and the first ones that they are among.
    lost: [usize; 2],
    drift_ppm: f64,
    boards: fn(u64) -> Vec<scene::Board>,
}

const CASES: [Case; 7] = [
    Case {
        name: "12 frames, 2 lost",
        frames: 12,
        lost: [2, 9],
        drift_ppm: 0.0,
        boards: scene::aperiodic_boards,
    },
    Case {
        name: "12 frames, 2 lost, other scenes",
        frames: 12,
        lost: [2, 9],
        drift_ppm: 0.0,
        boards: scene::random_boards,
    },
    Case {
        name: "24 frames, 2 lost",
        frames: 24,
        lost: [2, 21],
        drift_ppm: 0.0,
        boards: scene::aperiodic_boards,
    },
    Case {
        name: "24 frames, 2 lost, drift",
        frames: 24,
        lost: [2, 21],
        drift_ppm: 300.0,
        boards: scene::aperiodic_boards,
    },
    Case {
        name: "40 frames, 3 lost",
        frames: 40,
        lost: [3, 36],
        drift_ppm: 0.0,
        boards: scene::aperiodic_boards,
    },
    Case {
        name: "12 frames, none lost",
        frames: 12,
        lost: [0, 9],
        drift_ppm: 0.0,
        boards: scene::aperiodic_boards,
    },
    Case {
        name: "40 frames, none lost, drift",
        frames: 40,
        lost: [0, 9],
        drift_ppm: 300.0,
        boards: scene::aperiodic_boards,
    },
];

#[derive(Default)]
struct Count {
    cameras: usize,
    unknown: usize,
    /// Unknown ones whose lost frames were found at their places.
    found: usize,
    /// Cameras whose offset is wrong,
    wrong_offsets: usize,
    /// or only the times of later images.
    wrong_times: usize,
}

pub fn run(arguments: &[String]) -> Result<(), Failure> {
    let seeds: u64 = arguments.get(1).map_or(Ok(SEEDS), |n| n.parse())?;
    for case in &CASES {
        if arguments.first().is_some_and(|name| !case.name.starts_with(name.as_str())) {
            continue;
        }
        println!("{}: errors in frames", case.name);
        println!("seed  worst offset  its bar  worst image  unknown");
        let mut count = Count::default();
        for seed in 0..seeds {
            measure(case, seed, &mut count)?;
        }
        println!(
            "{}: of {} cameras {} unknown ({} of them with the true losses), {} with a wrong offset, {} \
             with wrong times alone",
            case.name,
            count.cameras,
            count.unknown,
            count.found,
            count.wrong_offsets,
            count.wrong_times
        );
    }
    Ok(())
}

/// One recording.
fn synthetic(case: &Case, seed: u64) -> Result<SyntheticCapture, Failure> {
    let boards = (case.boards)(seed);
    let mut synthetic = SyntheticCapture::losing_together(boards, case.frames, case.lost, seed)?;
    let reference = (synthetic.delays_s.len() - 1) / 2;
    let random = &mut Random::new(seed);
    for (c, drift_ppm) in synthetic.drift_ppm.iter_mut().enumerate() {
        if c != reference {
            *drift_ppm = case.drift_ppm * random.signed();
        }
    }
    Ok(synthetic)
}

/// Estimates one recording, prints its line and adds it to the counts.
fn measure(case: &Case, seed: u64, count: &mut Count) -> Result<(), Failure> {
    let synthetic = synthetic(case, seed)?;
    let folder = tempfile::tempdir()?;
    let truth_s = synthetic.write(folder.path())?;
    let capture = Arc::new(Capture::open(folder.path())?);
    let offsets = by_default(&capture)?.offsets;
    let times = offsets.common_times_s(&capture);
    let (mut worst, mut worst_image_frames) = ((0.0_f64, 0.0), 0.0_f64);
    let mut unknown = Vec::new();
    for (c, camera) in offsets.cameras.iter().enumerate() {
        if c == capture.reference {
            continue;
        }
        count.cameras += 1;
        let Some((offset_s, bar_s)) = camera.offset_s.zip(camera.std_err_s) else {
            unknown.push(camera.id.as_str());
            let truth: Vec<usize> =
                synthetic.lost[c].iter().enumerate().map(|(k, n)| n - k).collect();
            count.found += usize::from(camera.lost_before.as_ref() == Some(&truth));
            continue;
        };
        let error_frames = (offset_s - truth_s[c]).abs() / capture.frame_s();
        if error_frames > worst.0 {
            worst = (error_frames, bar_s / capture.frame_s());
        }
        let image_frames =
            times[c].iter().map(|t| worst_time(&synthetic, c, t)).fold(0.0, f64::max);
        worst_image_frames = worst_image_frames.max(image_frames);
        let wrong = if error_frames > WRONG_FRAMES {
            count.wrong_offsets += 1;
            "offset"
        } else if image_frames > WRONG_FRAMES {
            count.wrong_times += 1;
            "times"
        } else {
            continue;
        };
        println!(
            "      {}: wrong {wrong}; lost frames {:?}, found before images {:?}",
            camera.id, synthetic.lost[c], camera.lost_before
        );
    }
    count.unknown += unknown.len();
    println!(
        "{seed:4}  {:12.4}  {:7.4}  {worst_image_frames:11.4}  {} {}",
        worst.0,
        worst.1,
        unknown.len(),
        unknown.join(" ")
    );
    Ok(())
}

/// The worst error of a camera's times on the reference's clock, frames.
fn worst_time(synthetic: &SyntheticCapture, camera: usize, times_s: &[f64]) -> f64 {
    let reference = (synthetic.delays_s.len() - 1) / 2;
    let slow = 1.0 + 1e-6 * synthetic.drift_ppm[camera];
    let recorded = (0_u32..).filter(|n| !synthetic.lost[camera].contains(&(*n as usize)));
    let truth_s = recorded.map(|n| {
        synthetic.delays_s[camera] - synthetic.delays_s[reference]
            + f64::from(n) / synthetic.rate_hz * slow
    });
    let errors = times_s.iter().zip(truth_s).map(|(t, truth_s)| (t - truth_s).abs());
    errors.fold(0.0, f64::max) * synthetic.rate_hz
}
