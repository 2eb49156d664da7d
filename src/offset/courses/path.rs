//! One camera's course by what is seen of it: a line and the losses along it.

use super::{Course, ROUNDS, Told};
use crate::capture::MAX_DRIFT_PPM;
use nalgebra::{Matrix2, Vector2};

/// What a single sighting is off by, at most, frames: beyond three times of this it is wrong.
const SIGMA_FRAMES: f64 = 0.08;
pub const BOUND: f64 = 3.0 * SIGMA_FRAMES;
/// A clock that drifts does so by about this much,
const RATE: f64 = 5e-4;
/// and no more than this.
const MAX_RATE: f64 = 1e-6 * MAX_DRIFT_PPM;
/// What each more frame lost at the same place has to save, in wrong sightings.
const SUPPORT_OF_MORE: f64 = 0.3;
/// Frames that a camera is expected to lose at most.
const MAX_LOST: i32 = 40;
/// Offsets that are tried as starts, of all that were seen.
const MAX_STARTS: usize = 64;

/// The course that costs least.
pub fn fit(seen: &[Seen], told: &Told, search: Search) -> Fitted {
    let mut best: Option<Path> = None;
    for rate in rates(told, seen) {
        let Some(offset) = start(seen, rate, told.loses) else { continue };
        let path = Path::settled(seen, told, Vector2::new(offset, rate), search);
        if best.as_ref().is_none_or(|b| path.cost < b.cost) {
            best = Some(path);
        }
    }
    best.map_or_else(Fitted::default, |path| path.fitted(told))
}

/// What a loss has to save, in wrong sightings, and whether the other way is allowed too.
#[derive(Clone, Copy)]
pub struct Search {
    pub support: f64,
    pub falls: bool,
}

impl Search {
    pub fn of(support: f64) -> Self {
        Self { support, falls: false }
    }
}

/// A course, and the images before which it goes back by a frame if it may.
#[derive(Default)]
pub struct Fitted {
    pub course: Course,
    /// In wrong sightings, losses included.
    pub cost: f64,
    pub falls: Vec<usize>,
}

/// What is seen of a camera: this share of the way from an image to its next one (0: at the image)
/// it was this late.
#[derive(Clone, Copy, Debug)]
pub struct Seen {
    pub image: usize,
    pub share: f64,
    /// On the common clock, beyond its own clock's time, frames.
    pub frames: f64,
    /// Frames since its first image.
    pub since: f64,
}

impl Seen {
    /// Beyond an offset and a rate, frames.
    fn beyond(&self, line: &Vector2<f64>) -> f64 {
        self.frames - line.x - line.y * self.since
    }

    /// The same beyond the frames that are lost up to its image, and up to the next one.
    pub fn residual(&self, line: &Vector2<f64>, lost: [i32; 2]) -> f64 {
        let [before, after] = lost.map(f64::from);
        self.beyond(line) - before - self.share * (after - before)
    }
}

/// In wrong sightings.
pub fn cost(residual: f64) -> f64 {
    (residual / BOUND).powi(2).min(1.0)
}

/// Rates that may be a clock's, so close together that over the whole film one is within a bound.
fn rates(told: &Told, seen: &[Seen]) -> Vec<f64> {
    if !told.drifts {
        return vec![0.0];
    }
    let (first, last) = seen
        .iter()
        .fold((f64::INFINITY, f64::NEG_INFINITY), |(f, l), s| (f.min(s.since), l.max(s.since)));
    let steps = (MAX_RATE * (last - first) / BOUND).clamp(0.0, 1e3) as i32;
    let step = MAX_RATE / f64::from(steps.max(1));
    (-steps..=steps).map(|n| f64::from(n) * step).collect()
}

/// The offset that most sightings agree with, whole frames aside where some may be lost.
fn start(seen: &[Seen], rate: f64, loses: bool) -> Option<f64> {
    let mut values: Vec<f64> = seen.iter().map(|s| s.beyond(&Vector2::new(0.0, rate))).collect();
    values.sort_by(f64::total_cmp);
    let agreement = |start: f64| {
        let apart = |v: &f64| if loses { v - start - (v - start).round() } else { v - start };
        values.iter().map(|v| 1.0 - cost(apart(v))).sum::<f64>()
    };
    let count = values.len().min(MAX_STARTS);
    (0..count)
        .map(|k| values[(2 * k + 1) * values.len() / (2 * count)])
        .map(|value| (agreement(value), value))
        .max_by(|x, y| x.0.total_cmp(&y.0))
        .map(|(_, value)| value)
}

/// A course through what is seen of a camera.
struct Path {
    /// Offset and rate, frames and frames a frame.
    line: Vector2<f64>,
    /// The images that sightings are at, ascending, and the frames lost up to each.
    images: Vec<usize>,
    lost: Vec<i32>,
    pub cost: f64,
}

impl Path {
    /// The losses by the line and the line by the losses, until neither changes.
    fn settled(seen: &[Seen], told: &Told, line: Vector2<f64>, search: Search) -> Self {
        let mut path = Self::shortest(seen, told, line, search);
        for _ in 0..ROUNDS {
            let next = Self::shortest(seen, told, path.refined(seen, told), search);
            let rests = next.cost >= path.cost - 1e-9;
            if next.cost < path.cost {
                path = next;
            }
            if rests {
                break;
            }
        }
        path
    }

    /// The cheapest losses for a line, by dynamic programming over the images that were seen.
    fn shortest(seen: &[Seen], told: &Told, line: Vector2<f64>, search: Search) -> Self {
        let mut images: Vec<usize> =
            seen.iter().flat_map(|s| [s.image, s.image + usize::from(s.share != 0.0)]).collect();
        images.sort_unstable();
        images.dedup();
        let mut at = vec![Vec::new(); images.len()];
        for s in seen {
            at[images.partition_point(|n| *n < s.image)].push(*s);
        }
        let levels = levels(seen, told, &line);
        let first = levels.first().copied().unwrap_or(0);
        let rate = if told.drifts { line.y / RATE } else { 0.0 };
        let mut costs = vec![rate * rate / 9.0; levels.len()];
        let mut came_from: Vec<Vec<usize>> = Vec::with_capacity(images.len());
        for (n, of_image) in at.iter().enumerate() {
            let last = n + 1 == images.len();
            let (own, way): (Vec<Seen>, Vec<Seen>) = of_image.iter().partition(|s| s.share == 0.0);
            for (total, level) in costs.iter_mut().zip(&levels) {
                *total += own.iter().map(|s| cost(s.residual(&line, [*level; 2]))).sum::<f64>();
            }
            if last {
                break;
            }
            let (mut next, mut from) = (Vec::new(), Vec::new());
            for (j, to) in levels.iter().enumerate() {
                // Frames are lost and not found: no level is lower than the one before it.
                let befores = if search.falls { 0..levels.len() } else { 0..j + 1 };
                let steps = befores.map(|i| {
                    let way = way.iter().map(|s| cost(s.residual(&line, [levels[i], *to])));
                    let jump = match (to - levels[i]).abs() {
                        0 => 0.0,
                        frames => search.support + SUPPORT_OF_MORE * f64::from(frames - 1),
                    };
                    (costs[i] + way.sum::<f64>() + jump, i)
                });
                let best = steps.min_by(|x, y| x.0.total_cmp(&y.0)).unwrap_or((0.0, j));
                next.push(best.0);
                from.push(best.1);
            }
            costs = next;
            came_from.push(from);
        }
        let ends = costs.iter().copied().enumerate().min_by(|x, y| x.1.total_cmp(&y.1));
        let (mut level, cost) = ends.unwrap_or((0, 0.0));
        let mut lost = vec![first + level as i32];
        for from in came_from.iter().rev() {
            level = from[level];
            lost.push(first + level as i32);
        }
        lost.reverse();
        Self { line, images, lost, cost }
    }

    /// The frames lost up to an image that was seen, and up to the next one.
    fn lost_at(&self, seen: &Seen) -> [i32; 2] {
        let n = self.images.partition_point(|n| *n < seen.image);
        let next = if seen.share == 0.0 { n } else { n + 1 };
        [self.lost[n], self.lost[next]]
    }

    /// The line of least squares of the sightings that are right.
    fn refined(&self, seen: &[Seen], told: &Told) -> Vector2<f64> {
        // Without drift the rate is held at 0.
        let rate = if told.drifts { RATE } else { 1e-9 };
        // A thousandth of a sighting holds the line where none is right.
        let mut normal = Matrix2::from_diagonal(&Vector2::new(1e-3, rate.powi(-2)));
        let mut right = Vector2::new(1e-3 * self.line.x, 0.0);
        for s in seen {
            let residual = s.residual(&self.line, self.lost_at(s));
            if residual.abs() < BOUND {
                let row = Vector2::new(1.0, s.since) / SIGMA_FRAMES;
                let value = (residual + self.line.x + self.line.y * s.since) / SIGMA_FRAMES;
                normal += row * row.transpose();
                right += row * value;
            }
        }
        // Positive definite: its diagonal was.
        normal.cholesky().map_or(self.line, |c| c.solve(&right))
    }

    fn fitted(self, told: &Told) -> Fitted {
        let Some(&first) = self.lost.first() else { return Fitted::default() };
        let (mut lost_before, mut falls) = (Vec::new(), Vec::new());
        for (pair, image) in self.lost.windows(2).zip(&self.images[1..]) {
            let jump = pair[1] - pair[0];
            let images = std::iter::repeat_n(*image, jump.unsigned_abs() as usize);
            if jump > 0 { lost_before.extend(images) } else { falls.extend(images) }
        }
        let offset_s = told.frame_s * (self.line.x + f64::from(first));
        let course = Course { offset_s, rate: self.line.y, lost_before, ..Course::default() };
        Fitted { course, cost: self.cost, falls }
    }
}

/// Numbers of lost frames that sightings are near to, relative to the line.
fn levels(seen: &[Seen], told: &Told, line: &Vector2<f64>) -> Vec<i32> {
    if !told.loses {
        return vec![0];
    }
    let (least, most) = seen
        .iter()
        .map(|s| s.beyond(line).round().clamp(f64::from(-MAX_LOST), f64::from(MAX_LOST)) as i32)
        .fold((0, 0), |(l, m), level| (l.min(level), m.max(level)));
    (least..=most).collect()
}
