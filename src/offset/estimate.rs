//! From a film to offsets: the stages in their order.

use super::film::{Film, TrackCache};
use super::pair::{Blind, Guess, MIN_AGREEMENT, PairEstimate, estimate_pair, triples};
use super::pairing::{clocks, pairs};
use super::timeline::Timelines;
use super::{CameraOffset, Clocks, ONE_FRAME, OffsetOptions, Offsets, align, lost, solve};
use crate::capture::{Capture, CaptureError};
use crate::progress::Reporter;
use crate::registration::FrameStore;
use rayon::prelude::*;
use std::collections::BTreeSet;

/// Offsets with what they were made of.
#[derive(Clone, Debug)]
pub struct Estimate {
    pub offsets: Offsets,
    pub pairs: Vec<PairEstimate>,
}

/// Estimates all offsets of the store's capture from its pixels.
pub fn estimate(
    frames: &FrameStore,
    options: &OffsetOptions,
    reporter: &Reporter,
) -> Result<Estimate, CaptureError> {
    let capture = frames.capture();
    let (clock, count) = clocks(capture);
    if count == 1 {
        return Ok(Estimate { offsets: Offsets::known(capture), pairs: Vec::new() });
    }
    let pairs = pairs(capture, &clock, options);
    let tracks = TrackCache::default();
    let mut film = Film::new(frames, Timelines::nominal(capture), &tracks, options);
    let mut starts = aligned(&film, &pairs, reporter)?;
    let mut doubtful = vec![false; capture.cameras.len()];
    if capture.cameras.iter().any(|c| c.clock.lost) {
        let timelines;
        (timelines, doubtful) = lost::accounted_for(&film, &pairs, &mut starts, reporter)?;
        film = Film::new(frames, timelines, &tracks, options);
    }
    let drifts = drifts(capture, &clock, count);
    let found = pairwise(&film, &pairs, &starts, |c| drifts[clock[c]], reporter)?;
    let certain_s = options.max_std_err_frames * capture.frame_s();
    let used: Vec<PairEstimate> = found
        .iter()
        .flatten()
        .filter(|p| p.std_err_s <= certain_s && !contradicted(p, &pairs, &found))
        .filter(|p| p.cameras.iter().all(|&c| !doubtful[c]))
        .cloned()
        .collect();
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
                reason: found_one.is_none().then(|| {
                    let own = |p: &&PairEstimate| p.cameras.contains(&c);
                    match found.iter().flatten().any(|p| own(&p)) {
                        true if doubtful[c] => LOSSES_IN_DOUBT.into(),
                        true if doubtful[capture.reference] => REFERENCE_IN_DOUBT.into(),
                        _ => reason(capture, c, &pairs, &found, &used),
                    }
                }),
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
    let activities = align::Activities::new(film, pairs)?;
    let task = reporter.task("Rough alignment", pairs.len());
    pairs
        .par_iter()
        .enumerate()
        .map(|(n, pair)| {
            let has_motion = pair.iter().all(|&c| film.timelines.times_s[c].len() > 1);
            let guess = if has_motion {
                align::rough(film, pairs, n, &activities)
            } else {
                Ok(Err(Blind::Still))
            };
            task.advance(1);
            guess
        })
        .collect()
}

fn pairwise(
    film: &Film,
    pairs: &[[usize; 2]],
    starts: &[Result<Guess, Blind>],
    drifts: impl Fn(usize) -> bool + Sync,
    reporter: &Reporter,
) -> Result<Vec<Result<PairEstimate, Blind>>, CaptureError> {
    track(film, pairs, starts, reporter)?;
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

/// Whether less than half of what moves agrees with a pair, and another pair of one of its cameras
/// points to a time that the clocks don't say: what repeats itself agrees with both.
fn contradicted(
    pair: &PairEstimate,
    pairs: &[[usize; 2]],
    found: &[Result<PairEstimate, Blind>],
) -> bool {
    let shares_camera = |other: &[usize; 2]| other.iter().any(|c| pair.cameras.contains(c));
    let mut others = pairs.iter().zip(found).filter(|(other, _)| shares_camera(other));
    pair.agreement < MIN_AGREEMENT
        && others.any(|(_, found)| matches!(found, Err(Blind::Elsewhere)))
}

/// Finds the tracks that the pairs will ask for, each once.
fn track(
    film: &Film,
    pairs: &[[usize; 2]],
    starts: &[Result<Guess, Blind>],
    reporter: &Reporter,
) -> Result<(), CaptureError> {
    let wanted: BTreeSet<(usize, usize)> = pairs
        .iter()
        .zip(starts)
        .filter_map(|(&pair, start)| Some(triples(film, pair, start.as_ref().ok()?)))
        .flatten()
        .map(|([a, _], [k, _])| (a, k))
        .collect();
    let task = reporter.task("Tracks", wanted.len());
    wanted.into_par_iter().try_for_each(|(camera, k)| {
        film.track(camera, k)?;
        task.advance(1);
        Ok(())
    })
}

/// Whether each clock's rate may be off; the reference's defines what a second is.
fn drifts(capture: &Capture, clock: &[usize], count: usize) -> Vec<bool> {
    let mut drifts = vec![false; count];
    for (c, camera) in capture.cameras.iter().enumerate() {
        drifts[clock[c]] |= camera.clock.drift && clock[c] != 0;
    }
    drifts
}

const LOSSES_IN_DOUBT: &str = "frames may be missing, and too few of its images show where";
const REFERENCE_IN_DOUBT: &str =
    "the reference camera may miss frames, and too few of its images show where";

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
        Some(Blind::Discordant | Blind::Elsewhere) => "too few features agree on one offset",
        Some(Blind::Repeating) => {
            "several offsets, frames apart, fit the motion equally well: it repeats itself"
        }
    }
    .into()
}
