//! §4.2 and §4.3: wrong correspondences found by the epipolar constraint, eqs. (1) to (5).

use super::flow::{flow_over, is_new};
use super::{
    Frame, FrameStore, Guide, Match, RegistrationOptions, Run, Start, Track, Trajectory, flow,
};
use crate::camera::{Camera, EpipolarGeometry};
use crate::capture::{Capture, CaptureError};
use nalgebra::Point2;

/// What the test says of a track.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Verdict {
    /// Its spatial correspondence lies on the epipolar line.
    Passed,
    /// It does not: the temporal or the spatial correspondence is wrong, and neither is used.
    Rejected,
    /// The reference can't tell: it does not see the feature, or the feature moves along its
    /// epipolar line there.
    Untestable,
}

/// A reference camera and its frame, chosen by (4) and (5).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Reference {
    pub camera: usize,
    pub frame: usize,
    /// When the test is made: the frame's time, unless `between`.
    pub time_s: f64,
    /// Where the camera has no frame in the interval (a slower one): the times of `frame` and of
    /// the frame after, around it; its own track between the two is interpolated.
    pub between: Option<[f64; 2]>,
}

/// The references of a camera's two frames, by ascending weight (4).
#[derive(Clone, Debug, Default, PartialEq)]
pub struct References {
    /// Every track is tested against these.
    pub first: Vec<Reference>,
    /// And against these in turn while it is untestable: another camera may see what one does not.
    pub further: Vec<Reference>,
}

/// Frames further apart than this many of the tested camera's don't show what is between them.
const MAX_GAP: f64 = 4.0;

impl Reference {
    /// The frame within `[t1, t2]` nearest to `t`, or those around it; and its distance in time
    /// to `t`, seconds.
    fn nearest(camera: usize, times: &[f64], [t1, t2]: [f64; 2], t: f64) -> Option<(f64, Self)> {
        let within = times.iter().enumerate().filter(|&(_, &tj)| tj >= t1 && tj <= t2);
        let nearest = within.min_by(|a, b| (a.1 - t).abs().total_cmp(&(b.1 - t).abs()));
        if let Some((frame, &time_s)) = nearest {
            return Some(((time_s - t).abs(), Self { camera, frame, time_s, between: None }));
        }
        let frame = times.partition_point(|&tj| tj < t1).checked_sub(1)?;
        let (a, b) = (times[frame], *times.get(frame + 1)?);
        let distance_s = (t - a).min(b - t);
        (b - a <= MAX_GAP * (t2 - t1))
            .then_some((distance_s, Self { camera, frame, time_s: t, between: Some([a, b]) }))
    }
}

/// Chooses references for camera `i` and its frames at `t1` and `t2` (seconds, common time),
/// nearest in time to `t`: `w_j = D(j) + σ|t_j − t|`, D the distance of the centres over the
/// nearest one's, the time in frames. A grid gives two, across each other; a line one. Behind
/// these come the next nearest, for what these can't tell.
///
/// `times_s[j]` are camera j's frames in common time, `None` if its clock is unknown. Only frames
/// within `[t1, t2]` can test eq. (2); a camera that has none there, but around, is weighed by
/// the nearer one.
pub fn select_references(
    capture: &Capture,
    times_s: &[Option<Vec<f64>>],
    i: usize,
    [t1, t2]: [f64; 2],
    t: f64,
    options: &RegistrationOptions,
) -> References {
    let here = capture.cameras[i].camera.center();
    let baselines: Vec<_> = capture.cameras.iter().map(|c| c.camera.center() - here).collect();
    let nearest =
        baselines.iter().map(|b| b.norm()).filter(|&d| d > 0.0).fold(f64::INFINITY, f64::min);
    let frame_s = t2 - t1;
    if !(nearest.is_finite() && frame_s > 0.0) {
        return References::default();
    }
    let mut candidates: Vec<(f64, Reference)> = Vec::new();
    for (j, times) in times_s.iter().enumerate() {
        let Some(times) = times.as_ref().filter(|_| j != i && baselines[j].norm() > 0.0) else {
            continue;
        };
        let Some((distance_s, reference)) = Reference::nearest(j, times, [t1, t2], t) else {
            continue;
        };
        let w = baselines[j].norm() / nearest + options.time_weight * distance_s / frame_s;
        candidates.push((w, reference));
    }
    candidates.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.camera.cmp(&b.1.camera)));
    let mut references = References::default();
    for (_, candidate) in candidates {
        let direction = baselines[candidate.camera].normalize();
        // 45°: a row's and a column's neighbour are 90° apart, a row's two neighbours 0°.
        let across = references
            .first
            .iter()
            .all(|c| baselines[c.camera].normalize().dot(&direction).abs() < 0.707);
        if across && references.first.len() < options.max_references {
            references.first.push(candidate);
        } else if references.further.len() < options.further_references {
            references.further.push(candidate);
        }
    }
    references
}

/// A track to be tested: its number, and where its run of the flow started, pixels.
struct Feature<'a> {
    n: usize,
    track: &'a Track,
    path: Trajectory,
    at: Point2<f64>,
}

/// Tests the tracks of camera `i` between its frames `k` and `k + 1`. A track is rejected if a
/// reference rejects it, passed if one passes it and none rejects it.
pub fn epipolar_test(
    frames: &FrameStore,
    times_s: &[Option<Vec<f64>>],
    i: usize,
    k: usize,
    tracks: &[Track],
) -> Result<Vec<Verdict>, CaptureError> {
    let options = frames.options();
    let mut verdicts = vec![Verdict::Untestable; tracks.len()];
    let Some(own_times) = &times_s[i] else { return Ok(verdicts) };
    let interval = [own_times[k], own_times[k + 1]];
    // The forward flow's errors show at its far end, t + Δt; the backward flow's at t.
    for (backward, source, t) in [(false, k, interval[1]), (true, k + 1, interval[0])] {
        let source_frame = frames.get(i, source)?;
        let features: Vec<Feature> = tracks
            .iter()
            .enumerate()
            .filter(|(_, track)| (track.run == Run::Backward) == backward)
            .filter_map(|(n, track)| {
                let at = if backward { track.later } else { track.earlier };
                Some(Feature { n, track, path: track.path(own_times, k)?, at })
            })
            .collect();
        let References { first, further } =
            select_references(frames.capture(), times_s, i, interval, t, options);
        for reference in &first {
            let asked: Vec<&Feature> = features.iter().collect();
            for (n, verdict) in test_by(frames, i, &source_frame, reference, &asked)? {
                verdicts[n] = match (verdicts[n], verdict) {
                    (Verdict::Rejected, _) | (_, Verdict::Rejected) => Verdict::Rejected,
                    (Verdict::Passed, _) | (_, Verdict::Passed) => Verdict::Passed,
                    _ => Verdict::Untestable,
                };
            }
        }
        for reference in &further {
            let asked: Vec<&Feature> =
                features.iter().filter(|f| verdicts[f.n] == Verdict::Untestable).collect();
            for (n, verdict) in test_by(frames, i, &source_frame, reference, &asked)? {
                verdicts[n] = verdict;
            }
        }
    }
    Ok(verdicts)
}

/// What one reference says of tracks of camera `i` that start in `source`.
fn test_by(
    frames: &FrameStore,
    i: usize,
    source: &Frame,
    reference: &Reference,
    features: &[&Feature],
) -> Result<Vec<(usize, Verdict)>, CaptureError> {
    if features.is_empty() {
        return Ok(Vec::new());
    }
    let target = frames.get(reference.camera, reference.frame)?;
    let cameras = &frames.capture().cameras;
    let pair = Pair {
        camera_i: &cameras[i].camera,
        camera_j: &cameras[reference.camera].camera,
        time_s: reference.time_s,
        options: frames.options(),
    };
    let seen_s = reference.between.map_or(reference.time_s, |[first, _]| first);
    let mut found = pair.find(source, &target, seen_s, features);
    if let Some(between) = reference.between {
        let next = frames.get(reference.camera, reference.frame + 1)?;
        pair.interpolate(&target, &next, between, features, &mut found);
    }
    let verdicts = features.iter().zip(&found).map(|(feature, p_j)| {
        (feature.n, pair.judge(feature, p_j.as_ref()).unwrap_or(Verdict::Untestable))
    });
    Ok(verdicts.collect())
}

/// Pyramid levels where neighbours tell where to look. More: a coarse window is pulled away by
/// what is behind it.
const AGAIN_LEVELS: usize = 1;

struct Pair<'a> {
    camera_i: &'a Camera,
    camera_j: &'a Camera,
    time_s: f64,
    options: &'a RegistrationOptions,
}

impl Pair<'_> {
    /// Spatial flow from where the features are in the source frame to the reference frame, which
    /// is of `seen_s`.
    fn find(
        &self,
        source: &Frame,
        target: &Frame,
        seen_s: f64,
        features: &[&Feature],
    ) -> Vec<Option<Point2<f64>>> {
        let starts: Vec<Start> = features.iter().map(|f| (f.at, f.path.at(seen_s))).collect();
        let mut found = flow(source, target, &starts, self.options);
        self.find_again(source, target, &starts, &mut found);
        found.into_iter().map(|found| found.map(|m| m.target)).collect()
    }

    /// Follows what was found in a frame of the reference camera to its next one, and puts it where
    /// it is in between, at the time of the test, on a straight line; what is lost is untestable.
    fn interpolate(
        &self,
        frame: &Frame,
        next: &Frame,
        [first_s, next_s]: [f64; 2],
        features: &[&Feature],
        found: &mut [Option<Point2<f64>>],
    ) {
        let (seen, starts): (Vec<usize>, Vec<Start>) = found
            .iter()
            .zip(features)
            .enumerate()
            .filter_map(|(k, (p, feature))| {
                let (p, path) = ((*p)?, &feature.path);
                Some((k, (p, p + (path.at(next_s) - path.at(first_s)))))
            })
            .unzip();
        let share = (self.time_s - first_s) / (next_s - first_s);
        for (k, followed) in seen.into_iter().zip(flow(frame, next, &starts, self.options)) {
            found[k] = followed.map(|m| m.source + (m.target - m.source) * share);
        }
    }

    /// Looks once more for features that were not found, or not on their line: where their place
    /// has the disparity of its neighbours; and if the place itself is wrong, where the feature's
    /// neighbours went. The better fit stays.
    fn find_again(
        &self,
        source: &Frame,
        target: &Frame,
        starts: &[Start],
        found: &mut [Option<Match>],
    ) {
        let Some(geometry) = EpipolarGeometry::new(self.camera_i, self.camera_j) else { return };
        let off_line = |place: &Point2<f64>, p_j: &Point2<f64>| {
            let line = geometry.line_in_j(&self.camera_i.model.ideal_from_pixel(place)?)?;
            Some(line.distance(&self.camera_j.model.ideal_from_pixel(p_j)?).abs())
        };
        let is_off = |place: &Point2<f64>, found: &Option<Match>| {
            found.as_ref().is_none_or(|m| {
                off_line(place, &m.target).is_none_or(|d| d > self.options.epsilon_px)
            })
        };
        let mut tried = vec![None; starts.len()];
        for from_place in [true, false] {
            let base = |(at, place): &Start| if from_place { *place } else { *at };
            let trusted: Vec<_> = starts
                .iter()
                .zip(found.iter())
                .filter(|((_, place), found)| !is_off(place, found))
                .filter_map(|(start, found)| {
                    let base = base(start);
                    Some((base, found.as_ref()?.target - base))
                })
                .collect();
            let guide = Guide::new(&trusted);
            let again: Vec<(usize, Start)> = (0..starts.len())
                .filter(|&k| is_off(&starts[k].1, &found[k]))
                .filter_map(|k| {
                    let base = base(&starts[k]);
                    let displacement = guide.near(&base, Guide::RADIUS_PX)?;
                    let guess = base + displacement;
                    is_new(&mut tried[k], guess).then_some((k, (starts[k].0, guess)))
                })
                .collect();
            let sought: Vec<_> = again.iter().map(|(_, start)| *start).collect();
            let levels = [AGAIN_LEVELS, 1];
            let retried = flow_over(source, target, &sought, levels, self.options);
            for ((k, _), retried) in again.iter().zip(retried) {
                let Some(retried) = retried else { continue };
                if found[*k].as_ref().is_none_or(|first| retried.residual < first.residual) {
                    found[*k] = Some(retried);
                }
            }
        }
    }

    /// Eq. (3), of a feature and where it is in the reference; `None` where that can't tell.
    fn judge(&self, feature: &Feature, in_reference: Option<&Point2<f64>>) -> Option<Verdict> {
        let geometry = EpipolarGeometry::new(self.camera_i, self.camera_j)?;
        let ideal_i = |p: &Point2<f64>| self.camera_i.model.ideal_from_pixel(p);
        let p_j = self.camera_j.model.ideal_from_pixel(in_reference?)?;
        let at = feature.path.at(self.time_s);
        let line = geometry.line_in_j(&ideal_i(&at)?)?;
        if line.distance(&p_j).abs() > self.options.epsilon_px {
            return Some(Verdict::Rejected);
        }
        // On the line, a motion along it is right and wrong alike: how the line moves as the
        // feature does is what it shows of the motion.
        let motion = feature.track.motion();
        let start = geometry.line_in_j(&ideal_i(&feature.track.earlier)?)?;
        let end = geometry.line_in_j(&ideal_i(&feature.track.later)?)?;
        let foot = line.nearest(&p_j);
        let across = (start.distance(&foot) - end.distance(&foot)).abs();
        let shown = motion.norm() <= self.options.min_test_motion_px
            || across >= self.options.min_across_share * motion.norm();
        shown.then_some(Verdict::Passed)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::CameraModel;
    use nalgebra::Isometry3;

    fn camera(x: f64) -> Camera {
        Camera {
            width: 320,
            height: 240,
            model: CameraModel::Pinhole { fx: 343.0, fy: 343.0, cx: 160.0, cy: 120.0 },
            cam_from_world: Isometry3::translation(-x, 0.0, 0.0),
        }
    }

    fn track(earlier: [f64; 2], later: [f64; 2]) -> Track {
        Track {
            run: Run::Forward,
            before: None,
            earlier: earlier.into(),
            later: later.into(),
            after: None,
            residual: 0.0,
            back_error_px: 0.0,
        }
    }

    fn verdict(t: &Track, in_reference: Option<[f64; 2]>) -> Verdict {
        let options = RegistrationOptions::default();
        let (a, b) = (camera(0.0), camera(0.06));
        let pair = Pair { camera_i: &a, camera_j: &b, time_s: 0.5, options: &options };
        let path = t.path(&[0.0, 1.0], 0).unwrap();
        let feature = Feature { n: 0, track: t, path, at: t.earlier };
        let verdict = pair.judge(&feature, in_reference.map(Point2::from).as_ref());
        verdict.unwrap_or(Verdict::Untestable)
    }

    #[test]
    fn on_the_line_passes_and_off_it_is_rejected() {
        let t = track([100.0, 100.0], [104.0, 110.0]);
        assert_eq!(verdict(&t, Some([70.0, 105.2])), Verdict::Passed);
        assert_eq!(verdict(&t, Some([70.0, 111.0])), Verdict::Rejected);
        assert_eq!(verdict(&t, None), Verdict::Untestable);
    }

    #[test]
    fn motion_along_the_line_is_untestable_and_rest_is_not() {
        let along = track([100.0, 100.0], [120.0, 100.2]);
        assert_eq!(verdict(&along, Some([70.0, 100.0])), Verdict::Untestable);
        // Off the line is wrong, whatever the motion.
        assert_eq!(verdict(&along, Some([70.0, 107.0])), Verdict::Rejected);
        let at_rest = track([100.0, 100.0], [100.0, 100.0]);
        assert_eq!(verdict(&at_rest, Some([70.0, 100.0])), Verdict::Passed);
        assert_eq!(verdict(&at_rest, Some([70.0, 107.0])), Verdict::Rejected);
    }
}
