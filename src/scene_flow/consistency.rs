//! Cost of a surface element that disagrees with the scene flow maps of the other frames. Beside a body, an end camera
//! of the rig sees background that no other camera sees. Without this cost, the matches of this background are wrong,
//! and lie in front of the surfaces that the other cameras see.

use super::element::Element;
use super::frame::FlowFrame;
use super::geometry::Projection;
use super::map::ElementMap;
use super::timing::TimeBetween;

/// Maximum time between two frames whose scene flow maps are compared, in frame periods of the reference camera.
const MAX_DT: f32 = 0.8;
/// Maximum motion of a surface element between its frame and the other scene flow map's frame, pixels. If the motion
/// is larger, the map is not compared, since a small error of the velocity would move the element off a thin body.
const MAX_MOTION_PX: f32 = 8.0;
/// Value at which the difference between a surface element and another scene flow map is truncated, pixels. The
/// difference is that of the disparities, plus that of the displacements during half a frame period.
const MAX_DIFFERENCE_PX: f32 = 4.0;
/// Minimum difference in disparity between a surface element and a nearer element of another scene flow map that
/// occludes it, pixels.
const HIDING_PX: f32 = 1.0;
/// Difference that is assumed between a surface element and a scene flow map in which the element is occluded, pixels.
/// It replaces the unknown true difference.
const HIDDEN_PX: f32 = 0.3;
/// Number of fictitious scene flow maps, with a difference of 0, that are included in the mean difference. They reduce
/// the influence of a single map.
const PRIOR_MAPS: f32 = 2.0;

/// Copy of a scene flow map's inverse depths and velocities, row by row, made before a pass that changes the map.
pub struct Snapshot {
    width: usize,
    height: usize,
    scale: f32,
    pixels: Vec<SnapshotPixel>,
}

#[derive(Clone, Copy)]
struct SnapshotPixel {
    inverse_depth: f32,
    velocity: [f32; 2],
}

impl Snapshot {
    pub fn new(map: &ElementMap) -> Self {
        let pixel =
            |e: &Element| SnapshotPixel { inverse_depth: e.inverse_depth, velocity: e.velocity };
        let pixels = map.elements.iter().map(pixel).collect();
        Self { width: map.width, height: map.height, scale: map.scale, pixels }
    }
}

/// Scene flow map of another frame, with the time and the projection from the estimated frame to that frame.
struct OtherMap<'a> {
    frame: &'a FlowFrame,
    time: TimeBetween,
    projection: Projection,
    map: &'a Snapshot,
}

/// Copies of the scene flow maps of the other frames, made before the current PatchMatch pass.
pub struct OtherMaps<'a> {
    maps: Vec<OtherMap<'a>>,
    disparity_px: f32,
}

impl<'a> OtherMaps<'a> {
    /// Collects the scene flow maps with which the map of frame `of` is compared: those of other frames near in time.
    /// `disparity_px` is the disparity, in pixels, of a point at a depth of 1 m, at a baseline of twice the distance
    /// between neighbouring cameras.
    pub fn new(
        frames: &[&'a FlowFrame],
        snapshots: &'a [Snapshot],
        of: usize,
        disparity_px: f32,
    ) -> Self {
        let other = |(k, map): (usize, &'a Snapshot)| {
            let time = TimeBetween::new(frames[of], frames[k]);
            let projection = Projection::new(&frames[of].view, &frames[k].view)?;
            let is_near = k != of && time.frames().abs() <= MAX_DT;
            is_near.then_some(OtherMap { frame: frames[k], time, projection, map })
        };
        Self { maps: snapshots.iter().enumerate().filter_map(other).collect(), disparity_px }
    }

    /// Returns the mean difference, pixels, between a surface element at pixel `[x, y]` of its frame and the other
    /// scene flow maps into which it projects. The difference from one map is the difference between the disparities,
    /// plus the difference between the displacements during half a frame period. The mean includes [`PRIOR_MAPS`] maps
    /// with a difference of 0.
    pub fn difference(&self, e: &Element, [x, y]: [f32; 2]) -> f32 {
        let (mut sum, mut count) = (0.0, 0.0);
        let speed = e.speed();
        for OtherMap { frame, time, projection, map } in &self.maps {
            let dt = time.of_element(e, (x, y), projection);
            if dt.abs() * speed > MAX_MOTION_PX {
                continue;
            }
            let ([u, v], here) = e.transferred(x, y, dt, projection);
            let is_filmed = frame.films([u, v]);
            let (u, v) = (u / map.scale, v / map.scale);
            // An odd last row or column of the frame has no pixel in the map.
            if is_filmed && u < map.width as f32 && v < map.height as f32 {
                sum += self.least_difference(map, [u, v], &here);
                count += 1.0;
            }
        }
        sum / (count + PRIOR_MAPS)
    }

    /// Returns the smallest difference, pixels, between the surface element `here` and the elements of the four pixels
    /// around `[u, v]`, a position in pixels of the scene flow map. An element of the map that occludes `here` counts
    /// with [`HIDDEN_PX`]. The result is truncated at [`MAX_DIFFERENCE_PX`].
    fn least_difference(&self, map: &Snapshot, [u, v]: [f32; 2], here: &Element) -> f32 {
        let around = |at: f32, size: usize| {
            let first = (at - 0.5) as usize; // saturates
            first..=(first + 1).min(size - 1)
        };
        let mut least = f32::INFINITY;
        for y in around(v, map.height) {
            for x in around(u, map.width) {
                let SnapshotPixel { inverse_depth, velocity } = map.pixels[y * map.width + x];
                let in_front = (inverse_depth - here.inverse_depth) * self.disparity_px;
                let [du, dv] = [0, 1].map(|c| (velocity[c] - here.velocity[c]).abs());
                let difference = in_front.abs() + 0.5 * (du + dv);
                let is_hidden = in_front > HIDING_PX;
                least = least.min(if is_hidden { HIDDEN_PX } else { difference });
            }
        }
        least.min(MAX_DIFFERENCE_PX)
    }
}
