//! Eq. (10): one candidate a feature, from three frames.

use crate::camera::{Camera, EpipolarGeometry, Line};
use crate::registration::{Track, Trajectory};
use nalgebra::Point2;

/// The time that one feature gives.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Candidate {
    /// `t̃`: from camera i's earlier frame to camera j's frame, seconds.
    pub time_s: f64,
    /// How fast the feature crosses the epipolar line there, pixels a second: the inverse of what
    /// a pixel of error costs in time. Negative on the way to the line's negative side.
    pub across_px_s: f64,
    /// How far its path may be off across the line, because motion is no polynomial, pixels.
    pub path_error_px: f64,
}

impl Candidate {
    /// Its speed, less where the path itself is uncertain: squared, its information.
    pub fn certain_px_s(&self) -> f64 {
        self.across_px_s / 1.0_f64.hypot(self.path_error_px / PATH_SCALE_PX)
    }
}

/// A path error of this much halves a candidate's information: what good features are off by.
/// Larger lets the film's ends, where paths are quadratic, bias all; smaller leaves curved motion out.
const PATH_SCALE_PX: f64 = 0.03;
/// How far a path is off, as a share of what its last order changes: motion at film rates adds
/// about this much of each order to the next.
const NEXT_ORDER: f64 = 0.2;
/// A sample may be this far from where the others put it, pixels,
const MAX_SURPRISE_PX: f64 = 1.0;
/// and this share of its path's largest step. Larger keeps features that sit on what rests and are
/// lost behind what moves: their candidates agree, on the time of the frame they were last seen in.
/// Smaller drops what swings fast.
const MAX_SURPRISE_SHARE: f64 = 0.3;

/// Camera i's frames and camera j's.
pub struct ThreeFrames<'a> {
    pub camera_i: &'a Camera,
    pub camera_j: &'a Camera,
    /// Frame times of camera i on its own clock, and the index of the earlier of its two frames.
    pub times_i: &'a [f64],
    pub index_i: usize,
    /// Whether paths may be curved.
    pub curved: bool,
    /// Least motion across the line between the two frames, pixels.
    pub min_across_px: f64,
}

impl ThreeFrames<'_> {
    /// The crossings of the features' paths with the epipolar lines of their images in camera j.
    ///
    /// Features without a correspondence, at the epipole, or with too little motion across the
    /// line have none.
    pub fn candidates(&self, tracks: &[&Track], in_j: &[Option<Point2<f64>>]) -> Vec<Candidate> {
        self.crossings(tracks, in_j).into_iter().filter_map(|(_, c)| c).collect()
    }

    /// Of every feature that moves enough across its line, its index and its candidate: none where
    /// it crosses the line at no time near to the two frames, or was not found in camera j.
    pub fn crossings(
        &self,
        tracks: &[&Track],
        in_j: &[Option<Point2<f64>>],
    ) -> Vec<(usize, Option<Candidate>)> {
        let i_from_j = EpipolarGeometry::new(self.camera_j, self.camera_i);
        let j_from_i = EpipolarGeometry::new(self.camera_i, self.camera_j);
        let Some((i_from_j, j_from_i)) = i_from_j.zip(j_from_i) else { return Vec::new() };
        let line = |track: &Track, p_j: Option<Point2<f64>>| match p_j {
            Some(p_j) => i_from_j.line_in_j(&self.camera_j.model.ideal_from_pixel(&p_j)?),
            // As good as any point of the line that it is on.
            None => {
                let p_i = self.camera_i.model.ideal_from_pixel(&track.earlier)?;
                i_from_j.line_in_j(&j_from_i.line_in_j(&p_i)?.nearest(&p_i))
            }
        };
        let crossing = |(k, (track, p_j)): (usize, (&&Track, &Option<Point2<f64>>))| {
            let candidate = self.crossing(&line(track, *p_j)?, track)?;
            Some((k, candidate.filter(|_| p_j.is_some())))
        };
        tracks.iter().zip(in_j).enumerate().filter_map(crossing).collect()
    }

    /// Whether a feature's path is known well enough to have a candidate, wherever it leads.
    pub fn follows(&self, track: &Track) -> bool {
        self.samples(track).is_some()
    }

    /// `None` for too little motion across the line; then the candidate, if there is one.
    fn crossing(&self, line: &Line, track: &Track) -> Option<Option<Candidate>> {
        let samples = self.samples(track)?;
        let path = Trajectory::new(samples.iter().copied())?;
        let start = self.times_i[self.index_i];
        let interval = self.times_i[self.index_i + 1] - start;
        let [near, far] = [0.0, interval].map(|t| line.distance(&path.at(start + t)));
        if (far - near).abs() < self.min_across_px {
            return None;
        }
        // The chord's crossing; its slope is bounded from below by the check above.
        let guess_s = interval * near / (near - far);
        Some(self.candidate(line, &path, &samples, guess_s))
    }

    fn candidate(
        &self,
        line: &Line,
        path: &Trajectory,
        samples: &[(f64, Point2<f64>)],
        guess_s: f64,
    ) -> Option<Candidate> {
        let start = self.times_i[self.index_i];
        let interval = self.times_i[self.index_i + 1] - start;
        // A path through four frames says nothing beyond them.
        let known = -interval..=2.0 * interval;
        let mut time_s = guess_s;
        if !known.contains(&time_s) {
            return None;
        }
        for _ in 0..4 {
            let slope = line.normal.dot(&path.velocity(start + time_s));
            // Where the path turns back along the line there is no crossing to follow.
            if slope.abs() * interval < 0.5 * self.min_across_px {
                return None;
            }
            let step = line.distance(&path.at(start + time_s)) / slope;
            time_s -= step;
            if step.abs() < 1e-9 * interval {
                break;
            }
        }
        if !known.contains(&time_s) {
            return None;
        }
        let across_px_s = line.normal.dot(&path.velocity(start + time_s));
        let lower = without_farthest(samples, start + time_s).filter(|_| self.curved);
        let path_error_px = lower.map_or(0.0, |lower| {
            let change = path.at(start + time_s) - lower.at(start + time_s);
            NEXT_ORDER * line.normal.dot(&change).abs()
        });
        Some(Candidate { time_s, across_px_s, path_error_px })
    }

    /// The path's samples in distortion-free pixels. `None` for a feature that could not be
    /// followed to the frames around, if there are any, or that moves there like no body.
    fn samples(&self, track: &Track) -> Option<Vec<(f64, Point2<f64>)>> {
        let k = self.index_i;
        let last = self.times_i.len() - 1;
        let mut at = vec![(k, track.earlier), (k + 1, track.later)];
        if self.curved {
            at.extend(track.before.filter(|_| k > 0).map(|p| (k.wrapping_sub(1), p)));
            at.extend(track.after.filter(|_| k + 1 < last).map(|p| (k + 2, p)));
            at.sort_by_key(|(k, _)| *k);
        }
        let samples = at
            .into_iter()
            .map(|(k, p)| Some((self.times_i[k], self.camera_i.model.ideal_from_pixel(&p)?)))
            .collect::<Option<Vec<_>>>()?;
        let alone = last == 1 || !self.curved;
        (alone || (samples.len() > 2 && is_smooth(&samples))).then_some(samples)
    }
}

/// The path through all samples but the one furthest from a time; `None` for two samples.
fn without_farthest(samples: &[(f64, Point2<f64>)], time_s: f64) -> Option<Trajectory> {
    let away = |s: &(f64, Point2<f64>)| (s.0 - time_s).abs();
    let (first, last) = (samples.first()?, samples.last()?);
    Trajectory::new(if away(first) > away(last) {
        samples[1..].iter().copied()
    } else {
        samples[..samples.len() - 1].iter().copied()
    })
}

/// Whether the last of three or four samples is near to where the others lead.
fn is_smooth(samples: &[(f64, Point2<f64>)]) -> bool {
    let Some(((time_s, position), others)) = samples.split_last() else { return false };
    let Some(path) = Trajectory::new(others.iter().copied()) else { return false };
    let step = samples.windows(2).map(|w| (w[1].1 - w[0].1).norm()).fold(0.0, f64::max);
    (position - path.at(*time_s)).norm() <= MAX_SURPRISE_PX + MAX_SURPRISE_SHARE * step
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::offset::tests::camera;
    use crate::registration::FlowDirection;
    use nalgebra::Point3;

    fn track(at: impl Fn(f64) -> Point2<f64>) -> Track {
        Track {
            direction: FlowDirection::Forward,
            before: Some(at(-1.0)),
            earlier: at(0.0),
            later: at(1.0),
            after: Some(at(2.0)),
            residual: 0.0,
            forward_backward_error_px: 0.0,
        }
    }

    #[test]
    fn true_times_come_back_straight_and_curved() {
        let (i, j) = (camera(0.0), camera(0.06));
        for (curve, curved, tolerance) in [(0.0, false, 1e-12), (0.02, true, 1e-9)] {
            for k in 0..20 {
                let k = f64::from(k);
                let at = move |t: f64| {
                    Point3::new(0.1 * (k * 0.7).sin() + 0.01 * t, 0.03 * t + curve * t * t, 1.8)
                };
                let t = 0.05 * k;
                let frames = ThreeFrames {
                    camera_i: &i,
                    camera_j: &j,
                    times_i: &[-1.0, 0.0, 1.0, 2.0],
                    index_i: 1,
                    curved,
                    min_across_px: 1.0,
                };
                let track = track(|t| i.project(&at(t)).unwrap());
                let found = frames.candidates(&[&track], &[j.project(&at(t))])[0];
                assert!((found.time_s - t).abs() < tolerance, "{} {t}", found.time_s);
            }
        }
    }

    #[test]
    fn motion_along_the_line_gives_no_time() {
        let (i, j) = (camera(0.0), camera(0.06));
        let frames = ThreeFrames {
            camera_i: &i,
            camera_j: &j,
            times_i: &[-1.0, 0.0, 1.0, 2.0],
            index_i: 1,
            curved: true,
            min_across_px: 1.0,
        };
        let along = track(|t| Point2::new(100.0 + 20.0 * t, 100.0));
        assert!(frames.candidates(&[&along], &[Some(Point2::new(90.0, 100.0))]).is_empty());
        assert!(frames.candidates(&[&along], &[None]).is_empty());
    }
}
