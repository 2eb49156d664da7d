//! Which jumps of an offset are real: those that its course before and after them can't do without.
//!
//! A course is a level, a slope where clocks drift, and a whole frame for each jump passed. Its
//! cost is the sum of truncated squares, so that what was seen wrongly costs its bound on any
//! course, and a jump is kept only if it saves the cost of several sightings. What goes up by
//! mistake and comes down again costs as much with one of the two jumps as with none.

use nalgebra::{Matrix2, Vector2};

/// An offset as it was seen once, in frames.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Level {
    /// The image of each of the two cameras: the earlier one, of the camera with two.
    pub images: [usize; 2],
    pub time_s: f64,
    pub frames: f64,
}

/// A lost frame of one camera: from this image of its on, the offset is off by `frames`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Jump {
    /// 0: the one with two frames, 1: the one with a single one.
    pub camera: usize,
    pub image: usize,
    /// 1 or −1.
    pub frames: f64,
}

/// The jumps that are needed, and the course with them.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Steps {
    pub jumps: Vec<Jump>,
    /// The offset at the first sighting, frames.
    pub first: f64,
}

/// What a single triple of frames is off by, at most, frames: beyond three times of this it is wrong.
const SIGMA_FRAMES: f64 = 0.08;
/// A clock that drifts does so by about this much.
const RATE: f64 = 5e-4;
/// Sightings that are wrong without a jump and right with it, for it to be believed by one pair of
/// several. Larger leaves frames that were lost near a film's ends unfound; smaller makes some up
/// where motion repeats.
const MIN_SUPPORT: f64 = 1.8;
const ITERATIONS: usize = 30;

impl Steps {
    /// Of the proposed jumps, in the order of time, those that are needed: the least needed one, or
    /// one and its reversal right after it, is given up first.
    pub fn supported(levels: &[Level], proposed: &[Jump], drifts: bool) -> Self {
        let mut jumps = proposed.to_vec();
        loop {
            let with_all = Course::fit(levels, &jumps, drifts);
            let without = |n: usize, count: usize| {
                let mut others = jumps.clone();
                others.drain(n..n + count);
                let saved = Course::fit(levels, &others, drifts).cost - with_all.cost;
                (others, saved / count as f64)
            };
            let singles = (0..jumps.len()).map(|n| without(n, 1));
            let reversed = (1..jumps.len())
                .filter(|&n| jumps[n].frames != jumps[n - 1].frames)
                .map(|n| without(n - 1, 2));
            let least = singles.chain(reversed).min_by(|x, y| x.1.total_cmp(&y.1));
            match least {
                Some((others, saved)) if saved < MIN_SUPPORT => jumps = others,
                _ => return Self { first: with_all.first(levels, &jumps), jumps },
            }
        }
    }
}

/// A fitted course.
struct Course {
    line: Vector2<f64>,
    center_s: f64,
    /// In wrong sightings.
    cost: f64,
}

impl Course {
    /// From the start that most sightings agree with.
    fn fit(levels: &[Level], jumps: &[Jump], drifts: bool) -> Self {
        let values: Vec<f64> = levels.iter().map(|l| l.frames - passed(l, jumps)).collect();
        let center_s = levels.iter().map(|l| l.time_s).sum::<f64>() / levels.len().max(1) as f64;
        let fits = values.iter().map(|start| {
            let mut course = Self { line: Vector2::new(*start, 0.0), center_s, cost: 0.0 };
            course.refine(levels, &values, drifts);
            course
        });
        let nothing = Self { line: Vector2::zeros(), center_s, cost: 0.0 };
        fits.min_by(|x, y| x.cost.total_cmp(&y.cost)).unwrap_or(nothing)
    }

    /// Least squares of the sightings that are right, again and again; then its cost.
    fn refine(&mut self, levels: &[Level], values: &[f64], drifts: bool) {
        let frame_s = mean_frame_s(levels);
        // Without drift the slope is held at 0.
        let slope = if drifts { RATE / frame_s } else { 1e-9 };
        for _ in 0..ITERATIONS {
            let mut normal = Matrix2::from_diagonal(&Vector2::new(1e-9, slope.powi(-2)));
            let mut right = Vector2::zeros();
            for (level, value) in levels.iter().zip(values) {
                let row = Vector2::new(1.0, level.time_s - self.center_s);
                if (value - row.dot(&self.line)).abs() < 3.0 * SIGMA_FRAMES {
                    normal += row * row.transpose() / (SIGMA_FRAMES * SIGMA_FRAMES);
                    right += row * (value / (SIGMA_FRAMES * SIGMA_FRAMES));
                }
            }
            // Positive definite: its diagonal was.
            let Some(cholesky) = normal.cholesky() else { break };
            let next = cholesky.solve(&right);
            let rests = (next - self.line).amax() < 1e-9;
            self.line = next;
            if rests {
                break;
            }
        }
        let bound = 3.0 * SIGMA_FRAMES;
        let cost = |(level, value): (&Level, &f64)| {
            let r = value - self.line.x - self.line.y * (level.time_s - self.center_s);
            (r / bound).powi(2).min(1.0)
        };
        self.cost =
            levels.iter().zip(values).map(cost).sum::<f64>() + (self.line.y / slope).powi(2) / 9.0;
    }

    fn first(&self, levels: &[Level], jumps: &[Jump]) -> f64 {
        let Some(first) = levels.iter().min_by_key(|l| l.images[1]) else { return 0.0 };
        self.line.x + self.line.y * (first.time_s - self.center_s) + passed(first, jumps)
    }
}

/// What a sighting is off by, frames, for the jumps before it.
fn passed(level: &Level, jumps: &[Jump]) -> f64 {
    jumps.iter().filter(|j| level.images[j.camera] >= j.image).map(|j| j.frames).sum()
}

/// Camera b's time from image to image.
fn mean_frame_s(levels: &[Level]) -> f64 {
    let first = levels.iter().min_by_key(|l| l.images[1]);
    let last = levels.iter().max_by_key(|l| l.images[1]);
    match first.zip(last) {
        Some((f, l)) if l.images[1] > f.images[1] => {
            (l.time_s - f.time_s) / (l.images[1] - f.images[1]) as f64
        }
        _ => 1.0,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::Random;

    const FRAME_S: f64 = 1.0 / 30.0;

    /// `count` images, a frame lost before each of `lost`, a share of wrong sightings.
    fn course(
        random: &mut Random,
        count: usize,
        lost: &[usize],
        rate: f64,
        wrong: f64,
    ) -> Vec<Level> {
        (0..count)
            .map(|m| {
                let time_s = m as f64 * FRAME_S;
                let passed = lost.iter().filter(|&&n| n <= m).count() as f64;
                let mistake =
                    if random.unit() < wrong { (4.0 * random.unit()).floor() - 2.0 } else { 0.0 };
                let frames =
                    0.3 + passed + rate * time_s / FRAME_S + mistake + 0.02 * random.gaussian();
                Level { images: [m, m], time_s, frames }
            })
            .collect()
    }

    /// Every step between neighbours, as halving proposes them.
    fn proposed(levels: &[Level]) -> Vec<Jump> {
        let mut jumps = Vec::new();
        for pair in levels.windows(2) {
            let step = (pair[1].frames - pair[0].frames).round();
            let camera = usize::from(step > 0.0);
            let one = Jump { camera, image: pair[1].images[camera], frames: step.signum() };
            jumps.extend(std::iter::repeat_n(one, step.abs() as usize));
        }
        jumps
    }

    fn found(levels: &[Level], drifts: bool) -> Vec<usize> {
        let jumps = Steps::supported(levels, &proposed(levels), drifts).jumps;
        assert!(jumps.iter().all(|j| j.frames > 0.0), "{jumps:?}");
        jumps.iter().map(|j| j.image).collect()
    }

    #[test]
    fn hundreds_of_courses_with_mistakes_make_up_no_jump() {
        let random = &mut Random::new(8);
        for n in 0..300 {
            let count = 8 + n % 40;
            let rate = 5e-4 * random.gaussian();
            let levels = course(random, count, &[], rate, 0.03);
            let first = Steps::supported(&levels, &proposed(&levels), true).first;
            assert!((first - 0.3).abs() < 0.1, "{n}: {first}");
            assert!(found(&levels, true).is_empty(), "{n}: {levels:?}");
        }
    }

    #[test]
    fn hundreds_of_lost_frames_are_found() {
        let random = &mut Random::new(9);
        for n in 0..300 {
            let count = 16 + n % 30;
            let at = 5 + (random.unit() * (count - 10) as f64) as usize;
            let rate = 3e-4 * random.gaussian();
            let levels = course(random, count, &[at], rate, 0.0);
            assert_eq!(found(&levels, true), [at], "{n}");
            let twice = course(random, count, &[at, at], 0.0, 0.0);
            assert_eq!(found(&twice, false), [at, at], "{n}");
        }
    }

    #[test]
    fn nothing_seen_has_no_jump() {
        assert_eq!(Steps::supported(&[], &[], true), Steps::default());
    }
}
