//! Lost frames on many films in closed form: random numbers of them at random places.

use super::captures::by_default;
use super::scene::{self, Film};
use std::sync::Arc;
use stlfr::capture::Capture;
use stlfr::random::Random;

type Failure = Box<dyn std::error::Error>;

const FILMS: u64 = 60;
const CAMERAS: usize = 4;
const REFERENCE: usize = (CAMERAS - 1) / 2;

#[derive(Default)]
struct Count {
    films: usize,
    lost: usize,
    found: usize,
    /// Found, one image from where it was.
    beside: usize,
    missed: usize,
    invented: usize,
    /// Images whose time on the reference's clock is wrong by over a tenth of a frame, and all that
    /// have one.
    wrong: usize,
    images: usize,
}

impl Count {
    fn tell(&self, name: &str) {
        println!(
            "{name}: {} films, {} lost: {} found, {} one image beside, {} missed, {} invented; \
             {} of {} images over 0.1 frame off",
            self.films,
            self.lost,
            self.found,
            self.beside,
            self.missed,
            self.invented,
            self.wrong,
            self.images
        );
    }

    /// One camera's lost frames as they were, and as they were found.
    fn add(&mut self, truth: &[usize], found: &[usize]) {
        let mut rest = found.to_vec();
        self.lost += truth.len();
        let mut left = Vec::new();
        for n in truth {
            match rest.iter().position(|m| m == n) {
                Some(k) => {
                    rest.remove(k);
                    self.found += 1;
                }
                None => left.push(*n),
            }
        }
        for n in left {
            match rest.iter().position(|m| m.abs_diff(n) == 1) {
                Some(k) => {
                    rest.remove(k);
                    self.beside += 1;
                }
                None => self.missed += 1,
            }
        }
        self.invented += rest.len();
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
        for seed in 0..FILMS / 3 {
            one(1000 * frames as u64 + seed + drift as u64, frames, drift, &mut count)?;
        }
        count.tell(name);
        all.films += count.films;
        all.lost += count.lost;
        all.found += count.found;
        all.beside += count.beside;
        all.missed += count.missed;
        all.invented += count.invented;
        all.wrong += count.wrong;
        all.images += count.images;
    }
    all.tell("all");
    Ok(())
}

fn one(seed: u64, frames: usize, drift_ppm: f64, count: &mut Count) -> Result<(), Failure> {
    let random = &mut Random::new(seed);
    let delays: Vec<f64> = (0..CAMERAS).map(|_| random.signed() * 0.5).collect();
    let mut film = Film::new(scene::restless(seed), &delays, frames);
    film.size = [160, 120];
    film.seed = seed;
    film.may_lose = true;
    for c in (0..CAMERAS).filter(|c| *c != REFERENCE) {
        film.drift_ppm[c] = drift_ppm * random.signed();
        for _ in 0..(4.0 * random.unit()) as usize {
            film.lost[c].push(1 + (random.unit() * (frames - 1) as f64) as usize);
        }
        film.lost[c].sort_unstable();
        film.lost[c].dedup();
    }
    let folder = tempfile::tempdir()?;
    film.write(folder.path())?;
    let capture = Arc::new(Capture::open(folder.path())?);
    let offsets = by_default(&capture)?.offsets;
    count.films += 1;
    for (c, camera) in offsets.cameras.iter().enumerate() {
        // By the number of the image before which it is missing.
        let truth: Vec<usize> = film.lost[c].iter().enumerate().map(|(k, n)| n - k).collect();
        let seen: Vec<usize> = truth.into_iter().filter(|n| *n < frames).collect();
        let found = camera.lost_before.as_deref().unwrap_or_default();
        if found != seen {
            let known = if camera.offset_s.is_some() { "" } else { ", said to be unknown" };
            println!("  film {seed}, {}: lost {seen:?}, found {found:?}{known}", camera.id);
        }
        count.add(&seen, found);
    }
    let start_s = film.delays_s[REFERENCE];
    for (c, times) in offsets.common_times_s(&capture).into_iter().enumerate() {
        let Some(times) = times else { continue };
        let kept = (0..).filter(|n| !film.lost[c].contains(n));
        for (time_s, n) in times.into_iter().zip(kept) {
            let slow = 1.0 + 1e-6 * film.drift_ppm[c];
            let truth_s = film.delays_s[c] + f64::from(n as u32) / film.rate_hz * slow - start_s;
            count.images += 1;
            count.wrong += usize::from((time_s - truth_s).abs() > 0.1 * capture.frame_s());
        }
    }
    Ok(())
}
