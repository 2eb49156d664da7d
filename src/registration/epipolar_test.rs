//! §4.2 and §4.3: wrong correspondences found by the epipolar constraint, eqs. (1) to (5).

use super::{Frame, FrameStore, Guide, Match, Path, RegistrationOptions, Run, Start, Track, flow};
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
/// nearest one's, the time in frames. A grid gives two, across each other; a line one.
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
) -> Vec<Reference> {
    let here = capture.cameras[i].camera.center();
    let baselines: Vec<_> = capture.cameras.iter().map(|c| c.camera.center() - here).collect();
    let nearest =
        baselines.iter().map(|b| b.norm()).filter(|&d| d > 0.0).fold(f64::INFINITY, f64::min);
    let frame_s = t2 - t1;
    if !(nearest.is_finite() && frame_s > 0.0) {
        return Vec::new();
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
    let mut chosen: Vec<Reference> = Vec::new();
    for (_, candidate) in candidates {
        let direction = baselines[candidate.camera].normalize();
        // 45°: a row's and a column's neighbour are 90° apart, a row's two neighbours 0°.
        let across =
            chosen.iter().all(|c| baselines[c.camera].normalize().dot(&direction).abs() < 0.707);
        if across && chosen.len() < options.max_references {
            chosen.push(candidate);
        }
    }
    chosen
}

/// A track's feature and its correspondence in the reference frame.
struct Tested<'a> {
    track: &'a Track,
    path: Path,
    in_reference: Option<Point2<f64>>,
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
        let chosen: Vec<usize> =
            (0..tracks.len()).filter(|&n| (tracks[n].run == Run::Backward) == backward).collect();
        let source_frame = frames.get(i, source)?;
        for reference in select_references(frames.capture(), times_s, i, interval, t, options) {
            let target_frame = frames.get(reference.camera, reference.frame)?;
            let cameras = &frames.capture().cameras;
            let pair = Pair {
                camera_i: &cameras[i].camera,
                camera_j: &cameras[reference.camera].camera,
                time_s: reference.time_s,
                options,
            };
            let seen_s = reference.between.map_or(reference.time_s, |[first, _]| first);
            let mut found: Vec<Tested> = pair.find(
                &source_frame,
                &target_frame,
                seen_s,
                chosen.iter().filter_map(|&n| {
                    let track = &tracks[n];
                    let at = if backward { track.later } else { track.earlier };
                    Some((track, track.path(own_times, k)?, at))
                }),
            );
            if let Some(between) = reference.between {
                let next = frames.get(reference.camera, reference.frame + 1)?;
                pair.interpolate(&target_frame, &next, between, &mut found);
            }
            for (&n, verdict) in chosen.iter().zip(pair.judge(&found)) {
                verdicts[n] = match (verdicts[n], verdict) {
                    (Verdict::Rejected, _) | (_, Verdict::Rejected) => Verdict::Rejected,
                    (Verdict::Passed, _) | (_, Verdict::Passed) => Verdict::Passed,
                    _ => Verdict::Untestable,
                };
            }
        }
    }
    Ok(verdicts)
}

/// Features this near have much the same disparity, where they are on one surface.
const DISPARITY_RADIUS_PX: f64 = 40.0;

struct Pair<'a> {
    camera_i: &'a Camera,
    camera_j: &'a Camera,
    time_s: f64,
    options: &'a RegistrationOptions,
}

impl Pair<'_> {
    /// Spatial flow from where the features are in the source frame to the reference frame, which
    /// is of `seen_s`.
    fn find<'t>(
        &self,
        source: &Frame,
        target: &Frame,
        seen_s: f64,
        features: impl Iterator<Item = (&'t Track, Path, Point2<f64>)>,
    ) -> Vec<Tested<'t>> {
        let features: Vec<_> = features.collect();
        let places: Vec<_> = features.iter().map(|(_, path, _)| path.at(seen_s)).collect();
        let starts: Vec<_> =
            features.iter().zip(&places).map(|((_, _, at), place)| (*at, *place)).collect();
        let mut found = flow(source, target, &starts, self.options);
        self.find_again(source, target, &starts, &places, &mut found);
        found
            .into_iter()
            .zip(features)
            .map(|(found, (track, path, _))| Tested {
                track,
                path,
                in_reference: found.map(|m| m.target),
            })
            .collect()
    }

    /// Follows what was found in a frame of the reference camera to its next one, and puts it where
    /// it is in between, at the time of the test, on a straight line; what is lost is untestable.
    fn interpolate(
        &self,
        frame: &Frame,
        next: &Frame,
        [first_s, next_s]: [f64; 2],
        found: &mut [Tested],
    ) {
        let seen: Vec<usize> =
            (0..found.len()).filter(|&k| found[k].in_reference.is_some()).collect();
        let starts: Vec<Start> = seen
            .iter()
            .filter_map(|&k| {
                let (p, path) = (found[k].in_reference?, &found[k].path);
                Some((p, p + (path.at(next_s) - path.at(first_s))))
            })
            .collect();
        let share = (self.time_s - first_s) / (next_s - first_s);
        for (k, followed) in seen.into_iter().zip(flow(frame, next, &starts, self.options)) {
            found[k].in_reference = followed.map(|m| m.source + (m.target - m.source) * share);
        }
    }

    /// Looks once more for features that were not found, or not on their line: on it, by their
    /// neighbours' disparity. The better fit stays.
    fn find_again(
        &self,
        source: &Frame,
        target: &Frame,
        starts: &[Start],
        places: &[Point2<f64>],
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
        let trusted: Vec<_> = places
            .iter()
            .zip(found.iter())
            .filter(|(place, found)| !is_off(place, found))
            .filter_map(|(place, found)| Some((*place, found.as_ref()?.target - place)))
            .collect();
        let guide = Guide::new(&trusted);
        let again: Vec<(usize, Start)> = (0..places.len())
            .filter(|&k| is_off(&places[k], &found[k]))
            .filter_map(|k| {
                let disparity = guide.near(&places[k], DISPARITY_RADIUS_PX)?;
                Some((k, (starts[k].0, places[k] + disparity)))
            })
            .collect();
        let starts: Vec<_> = again.iter().map(|(_, start)| *start).collect();
        for ((k, _), retried) in again.iter().zip(flow(source, target, &starts, self.options)) {
            let Some(retried) = retried else { continue };
            if found[*k].as_ref().is_none_or(|first| retried.residual < first.residual) {
                found[*k] = Some(retried);
            }
        }
    }

    /// Eq. (3) for each.
    fn judge(&self, tested: &[Tested]) -> Vec<Verdict> {
        let geometry = EpipolarGeometry::new(self.camera_i, self.camera_j);
        let judge_one = |t: &Tested| -> Option<Verdict> {
            let geometry = geometry.as_ref()?;
            let ideal_i = |p: &Point2<f64>| self.camera_i.model.ideal_from_pixel(p);
            let p_j = self.camera_j.model.ideal_from_pixel(&t.in_reference?)?;
            let at = t.path.at(self.time_s);
            let line = geometry.line_in_j(&ideal_i(&at)?)?;
            // How the line moves as the feature does: what of the motion the line shows.
            let motion = t.track.motion();
            let start = geometry.line_in_j(&ideal_i(&t.track.earlier)?)?;
            let end = geometry.line_in_j(&ideal_i(&t.track.later)?)?;
            let foot = line.nearest(&p_j);
            let across = (start.distance(&foot) - end.distance(&foot)).abs();
            if motion.norm() > self.options.min_test_motion_px
                && across < self.options.min_across_share * motion.norm()
            {
                return None;
            }
            Some(if line.distance(&p_j).abs() > self.options.epsilon_px {
                Verdict::Rejected
            } else {
                Verdict::Passed
            })
        };
        tested.iter().map(|t| judge_one(t).unwrap_or(Verdict::Untestable)).collect()
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
        pair.judge(&[Tested { track: t, path, in_reference: in_reference.map(Point2::from) }])[0]
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
        let at_rest = track([100.0, 100.0], [100.0, 100.0]);
        assert_eq!(verdict(&at_rest, Some([70.0, 100.0])), Verdict::Passed);
        assert_eq!(verdict(&at_rest, Some([70.0, 107.0])), Verdict::Rejected);
    }
}
