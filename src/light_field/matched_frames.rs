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
        return Ok(range.map(|range| search_range(range, side)));
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
    Ok(ranges.reduce(union).map(|range| search_range(wider(range), side)))
}

/// Returns the search range of depth and motion for a range of inverse depths, 1/m, and images whose longer side has
/// `side` pixels.
pub(super) fn search_range(inverse_depth: [f64; 2], side: usize) -> Limits {
    let max_speed = (MAX_SPEED * side as f64) as f32;
    Limits { inverse_depth: inverse_depth.map(|q| q as f32), max_speed }
}

/// Returns the frames with which a given frame is matched: the previous and the next frame of its own camera, and of
/// each of the nearest other cameras, the frame nearest in time to the given frame. If nearly all of these are of the same
/// time, since the cameras are synchronized, also the frames before and after them, of the nearest cameras first.
pub(super) fn matched_with(field: &LightField, (camera, frame): FrameId) -> Vec<FrameId> {
    let beside = |(camera, frame): FrameId| {
        let count = field.times_s(camera).len();
        let two = [frame.checked_sub(1), Some(frame + 1).filter(|&k| k < count)];
        two.into_iter().flatten().map(move |k| (camera, k))
    };
    let time_s = field.times_s(camera)[frame];
    let partners = partners(field, camera).into_iter();
    let nearest = partners.filter_map(|c| field.nearest_frame(c, time_s).map(|k| (c, k)));
    let nearest: Vec<FrameId> = nearest.collect();
    let is_other_time =
        |&&(c, k): &&FrameId| field.in_frames((field.times_s(c)[k] - time_s).abs()) >= SIMULTANEOUS;
    let mut matched: Vec<FrameId> =
        beside((camera, frame)).chain(nearest.iter().copied()).collect();
    if nearest.iter().filter(is_other_time).count() < MIN_OTHER_TIMES.min(nearest.len()) {
        matched.extend(nearest.into_iter().flat_map(beside));
        matched.truncate(MAX_OBSERVATIONS);
    }
    matched
}

/// Returns the other cameras with whose frames those of a camera are matched: the nearest of them.
pub(super) fn partners(field: &LightField, camera: usize) -> Vec<usize> {
    let filmed = &field.capture().cameras;
    let others: Vec<usize> =
        (0..filmed.len()).filter(|&c| c != camera && !field.times_s(c).is_empty()).collect();
    let mut partners = nearest(field.capture(), &others, filmed[camera].camera.center());
    partners.truncate(MAX_PARTNERS);
    partners
}
