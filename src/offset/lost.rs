//! Lost frames, found: a camera that drops one without a trace is a frame later from there on.
//!
//! Three frames show an offset; followed along the film, the offset of a pair jumps up by a whole
//! frame where the camera that gives the single frame lost one, and down where the other one did.
//! Jumps are bracketed by halving, so that images on both sides of each are seen; what all pairs saw
//! then says together which frames are missing ([`courses`](super::courses)).

use super::courses::{Course, Sighting, Told, courses};
use super::film::Film;
use super::mixture::Observation;
use super::pair::{Blind, Guess, MIN_AGREEMENT, residuals};
use super::timeline::Timelines;
use crate::capture::CaptureError;
use crate::progress::Reporter;
use rayon::prelude::*;

/// What one triple of frames says.
#[derive(Clone, Copy, Debug)]
struct Seen {
    /// The earlier of camera a's frames, and camera b's.
    k: usize,
    m: usize,
    offset_s: f64,
    /// How many features agree,
    score: f64,
    /// and what share of those that move across their epipolar lines.
    agreement: f64,
}

/// Where an offset is looked for, in frames from where it was seen last,
const STEPS: [f64; 6] = [0.0, 1.0, -1.0, 2.0, -2.0, 3.0];
/// and at first.
const FIRST_STEPS: [f64; 7] = [0.0, -1.0, 1.0, -2.0, 2.0, -3.0, 3.0];
/// A single triple of frames needs this share of the inliers that a pair does: a wrong one is
/// outvoted by the other triples and pairs,
const OF_A_TRIPLE: f64 = 0.5;
/// but this share of its candidates.
const MIN_SHARE: f64 = 0.3;
/// What slides over something else, or is lost behind it, agrees on the time of a frame, at any image:
/// this near to one, as shares of the way to the next, most features have to agree.
const AT_A_FRAME: f64 = 0.2;
/// Jumps of a fraction of a frame beyond this are whole ones.
const MIN_JUMP: f64 = 0.6;
/// Images to both sides of a lost frame that are looked at again.
const AROUND: usize = 2;

/// How often cameras are looked at again by what they seem to have lost.
const LOOKS: usize = 3;

/// The times with the frames that were lost, the pairs' guesses by them, and whether each camera's
/// losses are in doubt.
pub fn accounted_for(
    film: &Film,
    pairs: &[[usize; 2]],
    starts: &mut [Result<Guess, Blind>],
    reporter: &Reporter,
) -> Result<(Timelines, Vec<bool>), CaptureError> {
    let told = told(film);
    let courses = seen_together(film, pairs, starts, &told, reporter)?;
    for (pair, start) in pairs.iter().zip(starts) {
        let [Some(i), Some(j)] = pair.map(|c| courses[c].as_ref()) else { continue };
        if start.is_ok() && i.group == j.group {
            *start = Ok(Guess {
                value_s: j.offset_s - i.offset_s,
                rate: j.rate - i.rate,
                center_s: told[pair[0]].times_s[0],
            });
        }
    }
    let in_doubt = |(course, told): (&Option<Course>, &Told)| match course {
        Some(course) => course.doubtful,
        None => told.loses,
    };
    let doubtful = courses.iter().zip(&told).map(in_doubt).collect();
    let lost = courses.into_iter().map(|c| c.map_or_else(Vec::new, |c| c.lost_before)).collect();
    Ok((Timelines::with_lost(film.frames.capture(), lost), doubtful))
}

fn told<'a>(film: &'a Film) -> Vec<Told<'a>> {
    let capture = film.frames.capture();
    let told = |(c, times_s): (usize, &'a Vec<f64>)| {
        let clock = &capture.cameras[c].clock;
        Told {
            times_s,
            frame_s: film.timelines.frame_s(c),
            loses: clock.lost,
            drifts: clock.drift && c != capture.reference,
        }
    };
    film.timelines.times_s.iter().enumerate().map(told).collect()
}

/// All cameras' courses, from every pair's sightings in both directions.
fn seen_together(
    film: &Film,
    pairs: &[[usize; 2]],
    starts: &[Result<Guess, Blind>],
    told: &[Told],
    reporter: &Reporter,
) -> Result<Vec<Option<Course>>, CaptureError> {
    let directions: Vec<([usize; 2], Guess)> = pairs
        .iter()
        .zip(starts)
        .filter_map(|(pair, guess)| Some((pair, (*guess).ok()?)))
        .flat_map(|(&[i, j], guess)| [([i, j], guess), ([j, i], Guess::constant(-guess.value_s))])
        .collect();
    let task = reporter.task("Lost frames", directions.len());
    let mut seen = directions
        .par_iter()
        .map(|&(pair, guess)| {
            let seen = follow(film, pair, guess);
            task.advance(1);
            seen
        })
        .collect::<Result<Vec<_>, _>>()?;
    let fitted = |seen: &[Vec<Seen>]| {
        let sightings: Vec<Sighting> = directions
            .iter()
            .zip(seen)
            .flat_map(|((pair, _), seen)| sightings(film, *pair, seen))
            .collect();
        courses(told, film.frames.capture().reference, &sightings)
    };
    let mut courses = fitted(&seen);
    for _ in 0..LOOKS {
        let changed = directions
            .par_iter()
            .zip(&mut seen)
            .map(|((pair, _), seen)| look_again(film, *pair, told, &courses, seen))
            .collect::<Result<Vec<bool>, _>>()?;
        if !changed.contains(&true) {
            break;
        }
        courses = fitted(&seen);
    }
    Ok(courses)
}

/// Follows the offset of the pair (a, b) along the film, from a guess at its main part: what its
/// triples of frames say.
fn follow(film: &Film, cameras: [usize; 2], guess: Guess) -> Result<Vec<Seen>, CaptureError> {
    let walk = Walk::new(film, cameras);
    let mut seen: Vec<Seen> = Vec::new();
    let mut offset_s = guess.value_s;
    for k in walk.intervals() {
        // The guess is the main part's; the film's start may be a few lost frames before it.
        let steps: &[f64] = if seen.is_empty() { &FIRST_STEPS } else { &STEPS };
        if let Some(found) = walk.look(k, offset_s, steps)? {
            // What few agree with is seen, but does not say where to look next.
            if seen.is_empty() || found.agreement >= MIN_AGREEMENT {
                offset_s = found.offset_s;
            }
            seen.push(found);
        }
    }
    let mut between = Vec::new();
    for pair in seen.windows(2) {
        walk.bracket(pair[0], pair[1], &mut between)?;
    }
    seen.extend(between);
    Ok(seen)
}

/// Looks again where by their courses the two cameras should see each other, and on both sides of
/// lost frames: of what was seen from one place that stays with which most features agree. Says
/// whether anything changed.
fn look_again(
    film: &Film,
    cameras: [usize; 2],
    told: &[Told],
    courses: &[Option<Course>],
    seen: &mut Vec<Seen>,
) -> Result<bool, CaptureError> {
    let [Some(of_a), Some(of_b)] = cameras.map(|c| courses[c].as_ref()) else { return Ok(false) };
    let walk = Walk::new(film, cameras);
    let times_a = of_a.times_s(&told[cameras[0]]);
    let times_b = of_b.times_s(&told[cameras[1]]);
    let late: Vec<f64> = [(of_a, &times_a), (of_b, &times_b)]
        .into_iter()
        .flat_map(|(course, times)| course.lost_before.iter().map(|n| times[*n]))
        .collect();
    let reach_s = (AROUND as f64 + 0.5) * walk.frame_s;
    let is_near = |k: usize| late.iter().any(|t| (times_a[k] - t).abs() < reach_s);
    let mut changed = false;
    let sampled = walk.intervals();
    for k in 0..times_a.len() - 1 {
        let near = is_near(k);
        if !near && sampled.binary_search(&k).is_err() {
            continue;
        }
        let middle_s = 0.5 * (times_a[k] + times_a[k + 1]);
        let m = times_b.partition_point(|t| *t < middle_s - 0.5 * walk.frame_s);
        let images = if near { m.saturating_sub(1)..m + 2 } else { m..m + 1 };
        for m in images.filter(|m| *m < times_b.len()) {
            let before = seen.iter().position(|s| s.k == k);
            let Some(found) = walk.at(k, m)? else { continue };
            match before {
                Some(n) if seen[n].score < found.score => seen[n] = found,
                Some(_) => continue,
                None => seen.push(found),
            }
            changed = true;
        }
    }
    Ok(changed)
}

/// The same as shares of the way between frames.
fn sightings(film: &Film, cameras: [usize; 2], seen: &[Seen]) -> Vec<Sighting> {
    let [a, b] = cameras.map(|c| &film.timelines.times_s[c]);
    let share = |s: &Seen| {
        let (start_s, end_s) = (a[s.k], a[s.k + 1]);
        // Ascending times: the frames are apart.
        (b[s.m] + s.offset_s - start_s) / (end_s - start_s)
    };
    seen.iter().map(|s| Sighting { cameras, images: [s.k, s.m], share: share(s) }).collect()
}

struct Walk<'a, 'b> {
    film: &'a Film<'b>,
    cameras: [usize; 2],
    /// Camera b's, the one whose frames may be missing.
    frame_s: f64,
}

impl<'a, 'b> Walk<'a, 'b> {
    fn new(film: &'a Film<'b>, cameras: [usize; 2]) -> Self {
        Self { film, cameras, frame_s: film.timelines.frame_s(cameras[1]) }
    }

    /// The frames of camera a that are looked at.
    fn intervals(&self) -> Vec<usize> {
        let count = self.film.timelines.times_s[self.cameras[0]].len() - 1;
        super::spread(count, self.film.options.max_frames)
    }

    /// What frame k of camera a sees, near the expected offset or `steps` frames from it: what most
    /// features agree with. `None` where too few do.
    fn look(&self, k: usize, expected_s: f64, steps: &[f64]) -> Result<Option<Seen>, CaptureError> {
        let mut best: Option<Seen> = None;
        for &frames in steps {
            // What most agree with where it was expected needs no rival.
            let as_expected = |s: &Seen| {
                s.agreement >= MIN_AGREEMENT && (s.offset_s - expected_s).abs() < 0.4 * self.frame_s
            };
            if frames != 0.0 && best.as_ref().is_some_and(as_expected) {
                break;
            }
            best = better(best, self.near(k, expected_s + frames * self.frame_s)?);
        }
        Ok(best)
    }

    /// What frame k of camera a and the image of b's that is between sees, if the offset is about
    /// the guess.
    fn near(&self, k: usize, guess_s: f64) -> Result<Option<Seen>, CaptureError> {
        match self.film.between(self.cameras, k, guess_s) {
            Some(m) => self.at(k, m),
            None => Ok(None),
        }
    }

    /// What frames k and k + 1 of a and m of b see.
    fn at(&self, k: usize, m: usize) -> Result<Option<Seen>, CaptureError> {
        let options = self.film.options;
        let times = &self.film.timelines.times_s[self.cameras[0]];
        let triple = self.film.triple(self.cameras, [k, m])?;
        // Beyond camera a's two frames the path is a guess: another image of b's answers there.
        let (start, end) = (times[k], times[k + 1]);
        let slack = 0.25 * (end - start);
        let observations: Vec<Observation> = triple
            .samples
            .iter()
            .map(|s| Observation { value_s: s.offset_s(), at_s: 0.0, across_px_s: s.across_px_s })
            .collect();
        let Some((offset_s, score)) = residuals(end - start, options).start(&observations) else {
            return Ok(None);
        };
        let time_s = self.film.timelines.times_s[self.cameras[1]][m] + offset_s;
        let inside = time_s >= start - slack && time_s <= end + slack;
        let enough = score >= OF_A_TRIPLE * options.min_inliers as f64
            && score >= MIN_SHARE * observations.len() as f64;
        let agreement = score / triple.across.max(1) as f64;
        let share = (time_s - start) / (end - start);
        let certain = agreement >= MIN_AGREEMENT || (share - share.round()).abs() > AT_A_FRAME;
        let found = inside && enough && certain;
        Ok(found.then_some(Seen { k, m, offset_s, score, agreement }))
    }

    /// Looks between two sightings that are a jump apart, until those on both sides of it are
    /// neighbours.
    fn bracket(
        &self,
        from: Seen,
        to: Seen,
        on_the_way: &mut Vec<Seen>,
    ) -> Result<(), CaptureError> {
        let jump = (to.offset_s - from.offset_s) / self.frame_s;
        if jump.abs() < MIN_JUMP || to.m <= from.m {
            return Ok(());
        }
        let Some(between) = self.between(from, to)? else { return Ok(()) };
        on_the_way.push(between);
        self.bracket(from, between, on_the_way)?;
        self.bracket(between, to, on_the_way)
    }

    /// A sighting between two others: in the middle, or where there is none, near to it.
    fn between(&self, from: Seen, to: Seen) -> Result<Option<Seen>, CaptureError> {
        let middle = usize::midpoint(from.k, to.k);
        for away in 0..(to.k - from.k) {
            let candidates = [middle.checked_sub(away), Some(middle + away)];
            for k in candidates.into_iter().flatten().filter(|k| (from.k + 1..to.k).contains(k)) {
                let mut found = None;
                for guess_s in [from.offset_s, to.offset_s, from.offset_s + self.frame_s] {
                    found = better(found, self.near(k, guess_s)?);
                }
                if let Some(found) = found.filter(|s: &Seen| s.m > from.m && s.m < to.m) {
                    return Ok(Some(found));
                }
            }
        }
        Ok(None)
    }
}

/// What more features agree with.
fn better(one: Option<Seen>, other: Option<Seen>) -> Option<Seen> {
    match (one, other) {
        (Some(x), Some(y)) if y.score > x.score => Some(y),
        (Some(x), _) => Some(x),
        (None, y) => y,
    }
}
