//! Frames for scene flow: without lens distortion, with those that they are matched with, and with the range of depths and
//! motion that is searched.

use super::RenderError;
use super::depth::{range, scene_points};
use super::graph::{LightField, Stage};
use super::points::nearest;
use super::slots::FrameId;
use super::stages::{FlowOptions, Instant, StillContent, Undistorted};
use super::wide::union;
use crate::scene_flow::{FlowFrame, Limits, MAX_OBSERVATIONS, SIMULTANEOUS};
use std::collections::BTreeSet;
use std::sync::Arc;

/// Maximum number of other cameras whose frames are matched with a frame to estimate its depth and motion.
const MAX_PARTNERS: usize = 7;
/// Maximum time to the frame of another camera that is preferred to frames of farther cameras, in frame periods of the reference
/// camera. Larger: cameras that don't film at the time take the places of others that do. Smaller: neighbours of which
/// frames are lost are left out.
const NEAR_IN_TIME: f64 = 2.0;
/// Minimum number of other cameras whose nearest frame is of another time. If there are fewer, more frames of these cameras
/// are matched.
const MIN_OTHER_TIMES: usize = 3;
/// Maximum motion that scene flow searches for, per frame interval, as a fraction of the image's longer side.
const MAX_SPEED: f64 = 0.125;
/// Factor by which the searched range of inverse depths is widened at both ends: the minimum is divided by it, and the
/// maximum is multiplied by it.
const DEPTH_MARGIN: f64 = 1.5;

impl Stage for Undistorted<'_> {
    type Output = FlowFrame;
    const NAME: &'static str = "undistorted frame";

    fn bytes(frame: &FlowFrame) -> usize {
        frame.bytes()
    }
}

impl Undistorted<'_> {
    pub(super) fn get(&self, field: &LightField) -> Result<Arc<FlowFrame>, RenderError> {
        if let Some(cached) = field.cached(self) {
            return Ok(cached);
        }
        let &Self { camera, frame, registration } = self;
        let image = field.capture().read_frame(camera, frame)?;
        let gains = field.gains(registration);
        let filmed = &field.capture().cameras[camera];
        let own_s = filmed.clock.times_s[frame];
        let image = gains.corrected(camera, own_s, &image).unwrap_or(image);
        let times_s = field.times_s(camera);
        let time = |k: usize| field.in_frames(times_s[k]);
        let row_time = field.in_frames(filmed.row_times().s_per_px());
        let flow_frame =
            FlowFrame::new(&filmed.camera, &image, time(frame)).with_row_time(row_time);
        if field.common_place().is_none() {
            let before = frame.checked_sub(1).map_or(f64::NEG_INFINITY, time);
            let after = if frame + 1 < times_s.len() { time(frame + 1) } else { f64::INFINITY };
            return Ok(field.insert(self, flow_frame.with_neighbors([before, after])));
        }
        // Frames of a wide array don't fade: hardly any other camera shows what one of them shows.
        let still = StillContent { camera, registration }.get(field)?;
        Ok(field.insert(self, flow_frame.with_still(&still)))
    }
}

/// Computes the search range of depth and motion for frames. The range of depths comes from triangulated feature
/// points, at the time of the frame in the middle of the list. If the cameras stand around the scene, the range comes
/// instead from the volume that at least half of the cameras see. `None` if the range of depths is unknown, because no
/// points are found or because all cameras stand at one place.
pub(super) fn limits(
    field: &LightField,
    frames: &[FrameId],
    options: FlowOptions,
) -> Result<Option<Limits>, RenderError> {
    let Some(&(camera, frame)) = frames.get(frames.len() / 2) else { return Ok(None) };
    let filmed = &field.capture().cameras;
    let cameras: BTreeSet<usize> = frames.iter().map(|id| id.0).collect();
    let sizes = cameras.iter().map(|&c| [filmed[c].camera.width, filmed[c].camera.height]);
    let side = sizes.flatten().max().unwrap_or(0);
    if let Some(place) = field.common_place() {
        let range = field.common_range(place, cameras.into_iter());
        return Ok(range.map(|range| search_range(field, range, side)));
    }
    let time_s = field.while_all_film(field.times_s(camera)[frame]);
    if field.spacing_m() == 0.0 {
        return Ok(None);
    }
    let FlowOptions { registration, still_change, proxy } = options;
    let instant = Instant { time_s, registration, still_change };
    let points = scene_points(field, &filmed[camera].camera, instant, proxy)?;
    let Some(points) = points else { return Ok(None) };
    let ranges = cameras.iter().filter_map(|&c| range(&points, &filmed[c].camera));
    let wider = |[min, max]: [f64; 2]| [min / DEPTH_MARGIN, max * DEPTH_MARGIN];
    Ok(ranges.reduce(union).map(|range| search_range(field, wider(range), side)))
}

/// Returns the search range of depth and motion for a range of inverse depths, 1/m, and images whose longer side has
/// `side` pixels. In a static light field nothing moves.
pub(super) fn search_range(field: &LightField, inverse_depth: [f64; 2], side: usize) -> Limits {
    let is_static = field.capture().is_static();
    let max_speed = if is_static { 0.0 } else { (MAX_SPEED * side as f64) as f32 };
    Limits { inverse_depth: inverse_depth.map(|q| q as f32), max_speed }
}

/// Returns the frames with which a given frame is matched: the previous and the next frame of its own camera, and of
/// each of the nearest other cameras, the frame nearest in time to the given frame. Cameras that film within [`NEAR_IN_TIME`]
/// come before all others. If nearly all of their frames are of the same time, since the cameras are synchronized, also the
/// frames before and after them are matched, of the nearest cameras first.
pub(super) fn matched_with(field: &LightField, (camera, frame): FrameId) -> Vec<FrameId> {
    let beside = |(camera, frame): FrameId| {
        let count = field.times_s(camera).len();
        let two = [frame.checked_sub(1), Some(frame + 1).filter(|&k| k < count)];
        two.into_iter().flatten().map(move |k| (camera, k))
    };
    let time_s = field.times_s(camera)[frame];
    let dt = |&(c, k): &FrameId| field.in_frames((field.times_s(c)[k] - time_s).abs());
    let others = others_by_distance(field, camera).into_iter();
    let nearest = others.filter_map(|c| field.nearest_frame(c, time_s).map(|k| (c, k)));
    let [nearest, far] = chosen(nearest, dt);
    let is_other_time = |id: &&FrameId| dt(id) >= SIMULTANEOUS;
    let are_synchronized =
        nearest.iter().filter(is_other_time).count() < MIN_OTHER_TIMES.min(nearest.len());
    let mut matched: Vec<FrameId> =
        beside((camera, frame)).chain(nearest.iter().copied()).chain(far).collect();
    if are_synchronized {
        matched.extend(nearest.into_iter().flat_map(beside));
        matched.truncate(MAX_OBSERVATIONS);
    }
    matched
}

/// Returns which frames of other cameras are matched: those near in time, and those far away in time, together at most
/// [`MAX_PARTNERS`]. Those near in time come first. Of each kind, the first of `frames` are taken. `dt` returns the time to a
/// frame, in frame periods of the reference camera.
fn chosen<T>(frames: impl Iterator<Item = T>, dt: impl Fn(&T) -> f64) -> [Vec<T>; 2] {
    let (mut near, mut far): (Vec<T>, Vec<T>) = frames.partition(|frame| dt(frame) <= NEAR_IN_TIME);
    near.truncate(MAX_PARTNERS);
    far.truncate(MAX_PARTNERS - near.len());
    [near, far]
}

/// Returns the other cameras with whose images those of a camera are matched where times don't matter: the nearest of them.
pub(super) fn partners(field: &LightField, camera: usize) -> Vec<usize> {
    let mut partners = others_by_distance(field, camera);
    partners.truncate(MAX_PARTNERS);
    partners
}

/// Returns the other cameras that have frames, the nearest first.
fn others_by_distance(field: &LightField, camera: usize) -> Vec<usize> {
    let filmed = &field.capture().cameras;
    let others: Vec<usize> =
        (0..filmed.len()).filter(|&c| c != camera && !field.times_s(c).is_empty()).collect();
    nearest(field.capture(), &others, filmed[camera].camera.center())
}

#[cfg(test)]
mod tests {
    use super::chosen;

    #[test]
    fn cameras_that_do_not_film_at_the_time_take_no_places_of_others() {
        let times = |dt: &[f64]| chosen(dt.iter().copied(), |dt| *dt);
        let [near, far] = times(&[0.3, 90.0, 0.1, 0.2, 5.0, 0.4, 0.0, 0.5, 0.25, 0.45]);
        assert_eq!(near, [0.3, 0.1, 0.2, 0.4, 0.0, 0.5, 0.25]);
        assert!(far.is_empty());
        let [near, far] = times(&[90.0, 0.3, 70.0, 80.0]);
        assert_eq!((near, far), (vec![0.3], vec![90.0, 70.0, 80.0]));
    }
}
