//! §7: the temporal offsets of cameras with clocks of their own.
//!
//! | paper | here |
//! |---|---|
//! | eq. (10), one candidate a feature | [`ThreeFrames::candidates`] |
//! | RANSAC by trying every candidate | [`ransac`] |
//! | WLS, eqs. (11) to (13) | [`weighted_least_squares`] |
//! | choosing frames with 0 ≤ t̃ ≤ Δt, averaging | [`PairEstimate`] |
//! | Zhou and Tao, beside it in Figs. 19 to 22 | [`cross_ratio_offset`] |
//! | Fig. 23 | [`plot`] |
//!
//! Beyond: a mixture fitted by information ([`Residuals`]), rough alignment of recordings started
//! by hand (`align`), lost frames (`lost`), and all pairs together with rates and standard errors
//! ([`solve`]).
//!
//! time on the reference's clock = time on the camera's clock + offset: a camera that opens after
//! the reference, both starting at 0 on their own clocks, has a positive offset.
//!
//! Known limits: films shorter than the least overlap of the search are taken to be aligned to
//! about a frame; a frame lost where nothing moves is found at the next image that shows motion;
//! one rate holds for a whole film.

mod activity;
mod align;
mod candidates;
pub mod chart;
mod consensus;
mod film;
mod joint;
mod lost;
mod mixture;
mod options;
mod pair;
mod plot;
mod store;
mod timeline;
mod uncertainty;
mod zhou_tao;

pub use candidates::{Candidate, ThreeFrames};
pub use consensus::{ransac, weighted_least_squares};
pub use film::Sample;
pub use joint::{Clocks, Solved, solve};
pub use mixture::{Mixture, Observation, Residuals};
pub use options::{OffsetOptions, OffsetRung};
pub use pair::{Blind, FrameEstimate, PairEstimate};
pub use plot::plot;
pub use store::{CameraOffset, Offsets};
pub use zhou_tao::{FourPoints, cross_ratio_offset};

use crate::capture::{Capture, CaptureError, write_atomically};
use crate::progress::Reporter;
use crate::registration::{FrameStore, RegistrationOptions};
use film::{Film, TrackCache};
use pair::{Guess, estimate_pair};
use rayon::prelude::*;
use std::sync::Arc;
use timeline::Timelines;

/// Offsets with what they were made of.
#[derive(Clone, Debug)]
pub struct Estimate {
    pub offsets: Offsets,
    pub pairs: Vec<PairEstimate>,
}

/// The offsets of a capture: none to estimate if all clocks are shared or nothing can move; those
/// kept in its folder if they are of the same capture, frames and options; else estimated now, and
/// kept with their plot. Says which.
pub fn known_or_kept_or_estimated(
    capture: &Arc<Capture>,
    options: &OffsetOptions,
    registration: &RegistrationOptions,
    reporter: &Reporter,
) -> Result<Offsets, CaptureError> {
    if clocks(capture).1 == 1 {
        reporter.note("The cameras share one clock: no offsets to estimate.");
        return Ok(Offsets::known(capture));
    }
    if capture.is_static() {
        reporter.note("Every camera took one frame, the same at any time: no offsets to estimate.");
        return Ok(Offsets::unknown(capture, ONE_FRAME));
    }
    let all_options = (options, registration);
    let hash = Offsets::hash(capture, &all_options)?;
    if let Some(kept) = Offsets::load(capture, &hash) {
        reporter.note("Offsets are those kept in offsets.json.");
        return Ok(kept);
    }
    let estimate = estimate(capture, options, registration, reporter)?;
    // A capture that may only be read can be worked with all the same.
    match keep(&estimate, capture, &all_options, &hash) {
        Ok(()) => {
            reporter.note(
                "Offsets were estimated from the images and kept in offsets.json, their plot in \
                 offsets.svg.",
            );
        }
        Err(error) => {
            reporter
                .note(&format!("Offsets were estimated from the images but not kept: {error}."));
        }
    }
    Ok(estimate.offsets)
}

fn keep(
    estimate: &Estimate,
    capture: &Capture,
    options: &impl serde::Serialize,
    hash: &str,
) -> Result<(), CaptureError> {
    let path = Offsets::plot_path(capture);
    write_atomically(&path, plot(estimate, capture).as_bytes())
        .map_err(|source| CaptureError::Write { path, source })?;
    estimate.offsets.save(capture, options, hash)
}

const ONE_FRAME: &str = "it has one frame, which shows no motion";

/// Estimates all offsets of a capture from its pixels.
pub fn estimate(
    capture: &Arc<Capture>,
    options: &OffsetOptions,
    registration: &RegistrationOptions,
    reporter: &Reporter,
) -> Result<Estimate, CaptureError> {
    let mut registration = registration.clone();
    registration.corners.max_corners = registration.corners.max_corners.min(options.max_features);
    let frames = &FrameStore::new(capture.clone(), &registration);
    let (clock, count) = clocks(capture);
    if count == 1 {
        return Ok(Estimate { offsets: Offsets::known(capture), pairs: Vec::new() });
    }
    let pairs = pairs(capture, &clock, options);
    let tracks = TrackCache::default();
    let mut film = Film::new(frames, Timelines::nominal(capture), &tracks, options);
    let mut starts = aligned(&film, &pairs, reporter)?;
    if capture.cameras.iter().any(|c| c.clock.lost) {
        let timelines = without_losses(&film, &pairs, &mut starts, reporter)?;
        film = Film::new(frames, timelines, &tracks, options);
    }
    let drifts = drifts(capture, &clock, count);
    let found = pairwise(&film, &pairs, &starts, |c| drifts[clock[c]], reporter)?;
    let certain_s = options.max_std_err_frames * capture.frame_s();
    let used: Vec<PairEstimate> =
        found.iter().flatten().filter(|p| p.std_err_s <= certain_s).cloned().collect();
    let first_s = film.timelines.times_s.iter().map(|t| t[0]).collect();
    let frame_s = capture.frame_s();
    let solved = solve(&used, &Clocks { of_camera: clock.clone(), first_s, drifts, frame_s });
    let cameras = capture
        .cameras
        .iter()
        .enumerate()
        .map(|(c, camera)| {
            let found_one = solved[clock[c]].filter(|s| s.std_err_s <= certain_s);
            let drifts = camera.clock.drift && c != capture.reference;
            CameraOffset {
                id: camera.id.clone(),
                offset_s: found_one.map(|s| s.offset_s),
                std_err_s: found_one.map(|s| s.std_err_s),
                rate_ppm: found_one.filter(|_| drifts).map(|s| 1e6 * s.rate),
                rate_std_err_ppm: found_one.filter(|_| drifts).map(|s| 1e6 * s.rate_std_err),
                lost_before: camera.clock.lost.then(|| film.timelines.lost_before[c].clone()),
                reason: found_one.is_none().then(|| reason(capture, c, &pairs, &found, &used)),
            }
        })
        .collect();
    let reference = capture.cameras[capture.reference].id.clone();
    Ok(Estimate { offsets: Offsets { reference, cameras }, pairs: used })
}

/// Each pair's offset to about a frame.
fn aligned(
    film: &Film,
    pairs: &[[usize; 2]],
    reporter: &Reporter,
) -> Result<Vec<Result<Guess, Blind>>, CaptureError> {
    let activities = align::activities(film, pairs)?;
    let task = reporter.task("Rough alignment", pairs.len());
    pairs
        .par_iter()
        .map(|&pair| {
            let has_motion = pair.iter().all(|&c| film.timelines.times_s[c].len() > 1);
            let guess = if has_motion {
                align::rough(film, pair, &activities)
            } else {
                Ok(Err(Blind::Still))
            };
            task.advance(1);
            guess
        })
        .collect()
}

/// The times with the frames that were lost, and the pairs' guesses at the film's start.
fn without_losses(
    film: &Film,
    pairs: &[[usize; 2]],
    starts: &mut [Result<Guess, Blind>],
    reporter: &Reporter,
) -> Result<Timelines, CaptureError> {
    let capture = film.frames.capture();
    let task = reporter.task("Lost frames", 2 * pairs.len());
    let directions: Vec<(usize, [usize; 2], Guess)> = pairs
        .iter()
        .zip(starts.iter())
        .enumerate()
        .filter_map(|(n, (pair, guess))| Some((n, pair, (*guess).ok()?)))
        .flat_map(|(n, &[i, j], guess)| {
            [(n, [i, j], guess), (n, [j, i], Guess::constant(-guess.value_s))]
        })
        .collect();
    let witnesses = directions
        .par_iter()
        .map(|&(_, pair, guess)| {
            let witness = lost::follow(film, pair, guess);
            task.advance(1);
            witness
        })
        .collect::<Result<Vec<_>, _>>()?;
    let lost =
        (0..capture.cameras.len())
            .map(|c| {
                if capture.cameras[c].clock.lost { lost::agreed(c, &witnesses) } else { Vec::new() }
            })
            .collect();
    for (&(n, pair, _), witness) in directions.iter().zip(&witnesses) {
        if pair == pairs[n] && witness.seen.is_some() {
            starts[n] = Ok(Guess::constant(witness.first_offset_s));
        }
    }
    Ok(Timelines::with_lost(capture, lost))
}

fn pairwise(
    film: &Film,
    pairs: &[[usize; 2]],
    starts: &[Result<Guess, Blind>],
    drifts: impl Fn(usize) -> bool + Sync,
    reporter: &Reporter,
) -> Result<Vec<Result<PairEstimate, Blind>>, CaptureError> {
    let task = reporter.task("Offsets", pairs.len());
    pairs
        .par_iter()
        .zip(starts)
        .map(|(&pair, &start)| {
            let with_rate = pair.iter().any(|&c| drifts(c));
            let estimate = match start {
                Ok(guess) => estimate_pair(film, pair, guess, with_rate),
                Err(blind) => Ok(Err(blind)),
            };
            task.advance(1);
            estimate
        })
        .collect()
}

/// Whether each clock's rate may be off; the reference's defines what a second is.
fn drifts(capture: &Capture, clock: &[usize], count: usize) -> Vec<bool> {
    let mut drifts = vec![false; count];
    for (c, camera) in capture.cameras.iter().enumerate() {
        drifts[clock[c]] |= camera.clock.drift && clock[c] != 0;
    }
    drifts
}

fn reason(
    capture: &Capture,
    camera: usize,
    pairs: &[[usize; 2]],
    found: &[Result<PairEstimate, Blind>],
    used: &[PairEstimate],
) -> String {
    if capture.cameras[camera].frames.len() == 1 {
        return ONE_FRAME.into();
    }
    if used.iter().any(|p| p.cameras.contains(&camera)) {
        return "its pairs are not connected to the reference camera, or disagree".into();
    }
    let own = pairs.iter().zip(found).filter(|(pair, _)| pair.contains(&camera));
    // What the pair that came furthest failed at.
    let furthest = own.map(|(_, found)| found.as_ref().err().copied().unwrap_or(Blind::Discordant));
    match furthest.max() {
        None => "no other camera stands at another place",
        Some(Blind::Apart) => "its neighbours filmed at other times, by its clock and theirs",
        Some(Blind::Featureless) => "too few features can be followed from frame to frame",
        Some(Blind::Still) => "too few features move",
        Some(Blind::Along) => {
            "too few features move across the epipolar lines of its neighbours: the motion runs along them"
        }
        Some(Blind::Discordant) => "too few features agree on one offset",
        Some(Blind::Repeating) => {
            "several offsets, frames apart, fit the motion equally well: it repeats itself"
        }
    }
    .into()
}

/// The clock of each camera, the reference's being 0, and how many there are. The reference's
/// clock is that of all cameras that share one, if it does.
fn clocks(capture: &Capture) -> (Vec<usize>, usize) {
    let reference_shares = capture.cameras[capture.reference].clock.shared;
    let mut next = 1;
    let mut shared = reference_shares.then_some(0);
    let mut clock = Vec::with_capacity(capture.cameras.len());
    for (c, camera) in capture.cameras.iter().enumerate() {
        let mut fresh = || {
            next += 1;
            next - 1
        };
        clock.push(if c == capture.reference {
            0
        } else if camera.clock.shared {
            *shared.get_or_insert_with(fresh)
        } else {
            fresh()
        });
    }
    (clock, next)
}

/// The pairs to estimate: every camera with its nearest ones, and with the nearest that stands in
/// another direction: motion along the epipolar lines of a grid's row runs across its columns'. For
/// the paper's rung, with the reference.
fn pairs(capture: &Capture, clock: &[usize], options: &OffsetOptions) -> Vec<[usize; 2]> {
    let centers: Vec<_> = capture.cameras.iter().map(|c| c.camera.center()).collect();
    let mut pairs: Vec<[usize; 2]> = Vec::new();
    for a in 0..centers.len() {
        let to = |b: usize| centers[b] - centers[a];
        let mut others: Vec<usize> =
            (0..centers.len()).filter(|&b| clock[a] != clock[b] && to(b).norm() > 0.0).collect();
        if options.rung == OffsetRung::Pairwise {
            others.retain(|&b| b == capture.reference);
        }
        others.sort_by(|&x, &y| to(x).norm().total_cmp(&to(y).norm()).then(x.cmp(&y)));
        // Both sides of a line, and ties of a grid: as many again as lie as near.
        let reach = others
            .get(options.neighbors.saturating_sub(1).min(others.len().wrapping_sub(1)))
            .map_or(0.0, |&b| to(b).norm());
        let near = others.partition_point(|&b| to(b).norm() <= reach * (1.0 + 1e-6));
        let aside = |b: usize| {
            others[..near].iter().all(|&n| {
                let (x, y) = (to(b).normalize(), to(n).normalize());
                x.dot(&y).abs() < MAX_ALIGNMENT
            })
        };
        let across = others[near..].iter().copied().find(|&b| aside(b));
        pairs.extend(others[..near].iter().copied().chain(across).map(|b| [a.min(b), a.max(b)]));
    }
    pairs.sort_unstable();
    pairs.dedup();
    pairs
}

/// The cosine between two baselines beyond which one shows hardly more than the other.
const MAX_ALIGNMENT: f64 = 0.8;

/// `count` of the numbers below `n` at most, evenly spread.
fn spread(n: usize, count: usize) -> Vec<usize> {
    if n <= count {
        return (0..n).collect();
    }
    (0..count).map(|k| (2 * k + 1) * n / (2 * count)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Numbers that look random, the same in every run (splitmix64).
    pub struct Random(u64);

    impl Random {
        pub fn new(seed: u64) -> Self {
            Self(seed)
        }

        /// From 0 to 1.
        pub fn uniform(&mut self) -> f64 {
            self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
            let mut z = self.0;
            z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
            z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
            ((z ^ (z >> 31)) >> 11) as f64 / (1_u64 << 53) as f64
        }

        /// Of mean 0 and standard deviation 1 (Box and Muller).
        pub fn gaussian(&mut self) -> f64 {
            let radius = (-2.0 * (1.0 - self.uniform()).ln()).sqrt();
            radius * (std::f64::consts::TAU * self.uniform()).cos()
        }
    }

    #[test]
    fn frames_are_spread_evenly() {
        assert_eq!(spread(3, 5), [0, 1, 2]);
        assert_eq!(spread(10, 5), [1, 3, 5, 7, 9]);
        assert!(spread(0, 5).is_empty() && spread(5, 0).is_empty());
    }
}
