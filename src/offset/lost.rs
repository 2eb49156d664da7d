//! Lost frames, found: a camera that drops one without a trace is a frame later from there on.
//!
//! Three frames show an offset; followed along the film, the offset of a pair jumps up by a whole
//! frame where the camera that gives the single frame lost one, and down where the other one did.
//! Jumps are bracketed by halving; those stay that what was seen before and after them needs
//! ([`Steps`]), and a lost frame is reported if most of the camera's pairs see it at the same
//! image. (A camera's own tracks across its gap are two frames long and say nothing; the pair's
//! other direction sees that one.)

use super::film::Film;
use super::mixture::Observation;
use super::pair::{Guess, residuals};
use super::steps::{Jump, Level, Steps};
use crate::capture::CaptureError;

/// What one direction of one pair says about the camera that gives the single frames.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Witness {
    /// The camera whose lost frames it sees.
    pub camera: usize,
    /// The images before which one is missing, one entry for each.
    pub lost_before: Vec<usize>,
    /// The first and the last image that it saw.
    pub seen: Option<(usize, usize)>,
    /// Its offset at the first of them, `offset_b − offset_a`.
    pub first_offset_s: f64,
}

/// What one triple of frames says.
#[derive(Clone, Copy, Debug)]
struct Seen {
    /// The earlier of camera a's frames, and camera b's.
    k: usize,
    m: usize,
    offset_s: f64,
}

/// Where an offset is looked for, in frames from where it was seen last,
const STEPS: [f64; 4] = [0.0, 1.0, -1.0, 2.0];
/// and at first.
const FIRST_STEPS: [f64; 7] = [0.0, -1.0, 1.0, -2.0, 2.0, -3.0, 3.0];
/// A single triple of frames needs this share of the inliers that a pair does: a wrong one is
/// outvoted by the other triples and pairs,
const OF_A_TRIPLE: f64 = 0.5;
/// but this share of its candidates.
const MIN_SHARE: f64 = 0.3;
/// Jumps of a fraction of a frame beyond this are whole ones.
const MIN_JUMP: f64 = 0.6;

/// Follows the offset of the pair (a, b) along the film, from a guess at its main part; `drifts`
/// says whether the offset may change between the jumps.
pub fn follow(
    film: &Film,
    [a, b]: [usize; 2],
    guess: Guess,
    drifts: bool,
) -> Result<Witness, CaptureError> {
    let intervals = film.timelines.times_s[a].len() - 1;
    let walk = Walk { film, cameras: [a, b], frame_s: film.timelines.frame_s(b) };
    let mut seen: Vec<Seen> = Vec::new();
    let mut offset_s = guess.value_s;
    for k in super::spread(intervals, film.options.max_frames) {
        // The guess is the main part's; the film's start may be a few lost frames before it.
        let steps: &[f64] = if seen.is_empty() { &FIRST_STEPS } else { &STEPS };
        if let Some(found) = walk.look(k, offset_s, steps)? {
            offset_s = found.offset_s;
            seen.push(found);
        }
    }
    let mut witness = Witness { camera: b, ..Witness::default() };
    let (Some(first), Some(last)) = (seen.first(), seen.last()) else { return Ok(witness) };
    witness.seen = Some((first.m, last.m));
    let (mut jumps, mut between) = (Vec::new(), Vec::new());
    for pair in seen.windows(2) {
        walk.bracket(pair[0], pair[1], &mut jumps, &mut between)?;
    }
    seen.extend(between);
    let levels: Vec<Level> = seen.iter().map(|s| walk.level(s)).collect();
    let steps = Steps::supported(&levels, &jumps, drifts);
    witness.first_offset_s = walk.frame_s * steps.first;
    witness.lost_before = steps.jumps.iter().filter(|j| j.frames > 0.0).map(|j| j.image).collect();
    Ok(witness)
}

struct Walk<'a, 'b> {
    film: &'a Film<'b>,
    cameras: [usize; 2],
    /// Camera b's, the one whose frames may be missing.
    frame_s: f64,
}

impl Walk<'_, '_> {
    /// The offset that frame k of camera a sees, near the expected one or `steps` frames from it:
    /// the one that most features agree with. `None` where too few do.
    fn look(&self, k: usize, expected_s: f64, steps: &[f64]) -> Result<Option<Seen>, CaptureError> {
        let mut best: Option<(f64, Seen)> = None;
        for &frames in steps {
            // A frame that agrees where it was expected needs no rival.
            if frames != 0.0
                && best.is_some_and(|(score, _)| score > 0.0)
                && self.sure(&best, expected_s)
            {
                break;
            }
            let guess_s = expected_s + frames * self.frame_s;
            let Some(m) = self.film.between(self.cameras, k, guess_s) else { continue };
            let Some((score, offset_s)) = self.at(k, m)? else { continue };
            if best.is_none_or(|(most, _)| score > most) {
                best = Some((score, Seen { k, m, offset_s }));
            }
        }
        Ok(best.map(|(_, seen)| seen))
    }

    fn sure(&self, best: &Option<(f64, Seen)>, expected_s: f64) -> bool {
        best.is_some_and(|(_, s)| (s.offset_s - expected_s).abs() < 0.4 * self.frame_s)
    }

    /// The score and the offset of frames k of a and m of b.
    fn at(&self, k: usize, m: usize) -> Result<Option<(f64, f64)>, CaptureError> {
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
        Ok((inside && enough).then_some((score, offset_s)))
    }

    fn level(&self, seen: &Seen) -> Level {
        Level {
            images: [seen.k, seen.m],
            time_s: self.film.timelines.times_s[self.cameras[1]][seen.m],
            frames: seen.offset_s / self.frame_s,
        }
    }

    /// Finds the images between two sightings before which the offset jumps, and what else it sees
    /// on the way.
    fn bracket(
        &self,
        from: Seen,
        to: Seen,
        jumps: &mut Vec<Jump>,
        on_the_way: &mut Vec<Seen>,
    ) -> Result<(), CaptureError> {
        let jump = (to.offset_s - from.offset_s) / self.frame_s;
        if jump.abs() < MIN_JUMP || to.m <= from.m {
            return Ok(());
        }
        match self.between(from, to)? {
            Some(between) => {
                on_the_way.push(between);
                self.bracket(from, between, jumps, on_the_way)?;
                self.bracket(between, to, jumps, on_the_way)
            }
            None => {
                // Nothing in between shows which image it was before: the first that is late.
                let one = if jump > 0.0 {
                    Jump { camera: 1, image: to.m, frames: 1.0 }
                } else {
                    Jump { camera: 0, image: to.k, frames: -1.0 }
                };
                jumps.extend(std::iter::repeat_n(one, jump.abs().round() as usize));
                Ok(())
            }
        }
    }

    /// A sighting between two others: in the middle, or where there is none, near to it.
    fn between(&self, from: Seen, to: Seen) -> Result<Option<Seen>, CaptureError> {
        let middle = usize::midpoint(from.k, to.k);
        for away in 0..(to.k - from.k) {
            let candidates = [middle.checked_sub(away), Some(middle + away)];
            for k in candidates.into_iter().flatten().filter(|k| (from.k + 1..to.k).contains(k)) {
                let found = self.look_for_either(k, from.offset_s, to.offset_s)?;
                if let Some(found) = found.filter(|s| s.m > from.m && s.m < to.m) {
                    return Ok(Some(found));
                }
            }
        }
        Ok(None)
    }

    fn look_for_either(
        &self,
        k: usize,
        old_s: f64,
        new_s: f64,
    ) -> Result<Option<Seen>, CaptureError> {
        let mut best: Option<(f64, Seen)> = None;
        for guess_s in [old_s, new_s, old_s + self.frame_s] {
            let Some(m) = self.film.between(self.cameras, k, guess_s) else { continue };
            if let Some((score, offset_s)) = self.at(k, m)?
                && best.is_none_or(|(most, _)| score > most)
            {
                best = Some((score, Seen { k, m, offset_s }));
            }
        }
        Ok(best.map(|(_, seen)| seen))
    }
}

/// The lost frames of one camera that most of its witnesses saw, of those that looked there.
pub fn agreed(camera: usize, witnesses: &[Witness]) -> Vec<usize> {
    let own: Vec<&Witness> = witnesses.iter().filter(|w| w.camera == camera).collect();
    let mut images: Vec<usize> = own.iter().flat_map(|w| w.lost_before.iter().copied()).collect();
    images.sort_unstable();
    images.dedup();
    let mut lost: Vec<usize> = Vec::new();
    for image in images {
        let times = |w: &&&Witness| w.lost_before.iter().filter(|&&n| n == image).count();
        let looked =
            |w: &&&Witness| w.seen.is_some_and(|(first, last)| first < image && image <= last);
        let mut counts: Vec<usize> = own.iter().filter(looked).map(|w| times(&w)).collect();
        counts.sort_unstable();
        // The lower median: of two that looked, both must have seen it. A frame that is missed
        // leaves a pair that disagrees; one that is made up moves all that follows.
        let count = counts.get(counts.len().saturating_sub(1) / 2).copied().unwrap_or(0);
        lost.extend(std::iter::repeat_n(image, count));
    }
    lost
}

#[cfg(test)]
mod tests {
    use super::*;

    fn witness(camera: usize, lost_before: &[usize], seen: (usize, usize)) -> Witness {
        Witness { camera, lost_before: lost_before.into(), seen: Some(seen), first_offset_s: 0.0 }
    }

    #[test]
    fn what_most_witnesses_saw_is_agreed() {
        let witnesses = [
            witness(1, &[6], (0, 9)),
            witness(1, &[6], (1, 8)),
            witness(1, &[5], (0, 9)),
            witness(2, &[3], (0, 9)),
            // Did not look there.
            witness(1, &[], (7, 9)),
        ];
        assert_eq!(agreed(1, &witnesses), [6]);
        assert_eq!(agreed(2, &witnesses), [3]);
        assert!(agreed(3, &witnesses).is_empty());
    }

    #[test]
    fn two_missing_before_one_image_are_two() {
        let witnesses = [witness(1, &[4, 4], (0, 9)), witness(1, &[4, 4], (0, 9))];
        assert_eq!(agreed(1, &witnesses), [4, 4]);
    }
}
