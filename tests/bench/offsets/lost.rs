//! Lost frames on many synthetic captures: random numbers of them at random places.

use super::captures::by_default;
use super::scene::{self, SyntheticCapture};
use std::sync::Arc;
use stlfr::capture::Capture;
use stlfr::random::Random;

type Failure = Box<dyn std::error::Error>;

/// The number of captures.
const CAPTURES: u64 = 60;
const CAMERAS: usize = 4;
const REFERENCE: usize = (CAMERAS - 1) / 2;

#[derive(Default)]
struct Count {
    captures: usize,
    lost: usize,
    /// Lost frames that were detected at the right image,
    detected: usize,
    /// at the image before or after it,
    neighbouring: usize,
    /// or not at all.
    missed: usize,
    /// Detections that correspond to no lost frame.
    invented: usize,
    /// Images whose time on the reference's clock is off by more than a tenth of a frame.
    wrong: usize,
    /// Images with a time on the reference's clock.
    images: usize,
}

impl Count {
    fn print(&self, name: &str) {
        println!(
            "{name}: {} captures, {} lost: {} detected, {} one image off, {} missed, {} invented; \
             {} of {} images over 0.1 frame off",
            self.captures,
            self.lost,
            self.detected,
            self.neighbouring,
            self.missed,
            self.invented,
            self.wrong,
            self.images
        );
    }

    /// Adds one camera's true and detected lost frames.
    fn add(&mut self, truth: &[usize], detected: &[usize]) {
        let mut unmatched = detected.to_vec();
        self.lost += truth.len();
        let mut undetected = Vec::new();
        for n in truth {
            match unmatched.iter().position(|m| m == n) {
                Some(k) => {
                    unmatched.remove(k);
                    self.detected += 1;
                }
                None => undetected.push(*n),
            }
        }
        for n in undetected {
            match unmatched.iter().position(|m| m.abs_diff(n) == 1) {
                Some(k) => {
                    unmatched.remove(k);
                    self.neighbouring += 1;
                }
                None => self.missed += 1,
            }
        }
        self.invented += unmatched.len();
    }
}

pub fn run() -> Result<(), Failure> {
    let mut all = Count::default();
    for (name, frames, drift) in [
        ("40 frames", 40, 0.0),
        ("75 frames", 75, 0.0),
        ("75 frames, clocks that drift", 75, 300.0),
    ] {
        let mut count = Count::default();
        for seed in 0..CAPTURES / 3 {
            measure(1000 * frames as u64 + seed + drift as u64, frames, drift, &mut count)?;
        }
        count.print(name);
        all.captures += count.captures;
        all.lost += count.lost;
        all.detected += count.detected;
        all.neighbouring += count.neighbouring;
        all.missed += count.missed;
        all.invented += count.invented;
        all.wrong += count.wrong;
        all.images += count.images;
    }
    all.print("all");
    Ok(())
}

/// Estimates one capture and adds it to the counts.
fn measure(seed: u64, frames: usize, drift_ppm: f64, count: &mut Count) -> Result<(), Failure> {
    let random = &mut Random::new(seed);
    let delays: Vec<f64> = (0..CAMERAS).map(|_| random.signed() * 0.5).collect();
    let mut synthetic = SyntheticCapture::new(scene::aperiodic_boards(seed), &delays, frames);
    synthetic.size = [160, 120];
    synthetic.seed = seed;
    synthetic.may_lose = true;
    for c in (0..CAMERAS).filter(|c| *c != REFERENCE) {
        synthetic.drift_ppm[c] = drift_ppm * random.signed();
        for _ in 0..(4.0 * random.unit()) as usize {
            synthetic.lost[c].push(1 + (random.unit() * (frames - 1) as f64) as usize);
        }
        synthetic.lost[c].sort_unstable();
        synthetic.lost[c].dedup();
    }
    let folder = tempfile::tempdir()?;
    synthetic.write(folder.path())?;
    let capture = Arc::new(Capture::open(folder.path())?);
    let offsets = by_default(&capture)?.offsets;
    count.captures += 1;
    for (c, camera) in offsets.cameras.iter().enumerate() {
        // Numbered by the image before which each is missing.
        let truth: Vec<usize> = synthetic.lost[c].iter().enumerate().map(|(k, n)| n - k).collect();
        let observable: Vec<usize> = truth.into_iter().filter(|n| *n < frames).collect();
        let detected = camera.lost_before.as_deref().unwrap_or_default();
        if detected != observable {
            let known = if camera.offset_s.is_some() { "" } else { ", offset unknown" };
            println!(
                "  capture {seed}, {}: lost {observable:?}, detected {detected:?}{known}",
                camera.id
            );
        }
        count.add(&observable, detected);
    }
    let start_s = synthetic.delays_s[REFERENCE];
    for (c, times) in offsets.common_times_s(&capture).into_iter().enumerate() {
        let Some(times) = times else { continue };
        let recorded = (0..).filter(|n| !synthetic.lost[c].contains(n));
        for (time_s, n) in times.into_iter().zip(recorded) {
            let slow = 1.0 + 1e-6 * synthetic.drift_ppm[c];
            let truth_s =
                synthetic.delays_s[c] + f64::from(n as u32) / synthetic.rate_hz * slow - start_s;
            count.images += 1;
            count.wrong += usize::from((time_s - truth_s).abs() > 0.1 * capture.frame_s());
        }
    }
    Ok(())
}
