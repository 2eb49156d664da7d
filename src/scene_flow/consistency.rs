//! What the maps of the other frames say about an element while all maps are estimated. Beside a body, an end camera of the
//! rig sees what no other camera sees: there the match alone would place the element in front of what all others see.

use super::element::Element;
use super::frame::FlowFrame;
use super::geometry::Projection;
use super::map::ElementMap;

/// Frames farther away in time say nothing.
const MAX_DT: f32 = 0.8;
/// Maps say nothing of an element that moves farther until their frame's time, pixels: a small error of its velocity would
/// move it off a thin body.
const MAX_MOTION_PX: f32 = 8.0;
/// Largest difference from a map that counts, pixels.
const MAX_DIFFERENCE_PX: f32 = 4.0;
/// Disparity by which a map's element must be in front to hide one, pixels.
const HIDING_PX: f32 = 1.0;
/// Difference from a map that hides the element, pixels.
const HIDDEN_PX: f32 = 0.3;
/// Number of maps without a difference that is added to those found, so that one alone says little.
const PRIOR_MAPS: f32 = 2.0;

/// A copy of a map's depth and motion.
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

/// A map, as the frame in question sees it.
struct OtherMap<'a> {
    dt: f32,
    projection: Projection,
    map: &'a Snapshot,
}

/// The maps of the other frames, as they were before a pass.
pub struct OtherMaps<'a> {
    maps: Vec<OtherMap<'a>>,
    disparity_px: f32,
}

impl<'a> OtherMaps<'a> {
    /// The maps around frame `of`, whose disparities are stated by `disparity_px`.
    pub fn new(
        frames: &[&FlowFrame],
        snapshots: &'a [Snapshot],
        of: usize,
        disparity_px: f32,
    ) -> Self {
        let other = |(k, map): (usize, &'a Snapshot)| {
            let dt = (frames[k].time - frames[of].time) as f32;
            let projection = Projection::new(&frames[of].view, &frames[k].view)?;
            (k != of && dt.abs() <= MAX_DT).then_some(OtherMap { dt, projection, map })
        };
        Self { maps: snapshots.iter().enumerate().filter_map(other).collect(), disparity_px }
    }

    /// Mean difference of an element at a place of the frame from what the maps have where they see it: disparity and half a
    /// frame's motion, pixels. 0 if no map sees it.
    pub fn difference(&self, e: &Element, [x, y]: [f32; 2]) -> f32 {
        let (mut sum, mut count) = (0.0, 0.0);
        let speed = e.speed();
        for OtherMap { dt, projection, map } in &self.maps {
            if dt.abs() * speed > MAX_MOTION_PX {
                continue;
            }
            let ([u, v], here) = e.transferred(x, y, *dt, projection);
            let (u, v) = (u / map.scale, v / map.scale);
            if u >= 0.0 && v >= 0.0 && u < map.width as f32 && v < map.height as f32 {
                sum += self.least_difference(map, [u, v], &here);
                count += 1.0;
            }
        }
        sum / (count + PRIOR_MAPS)
    }

    /// The least difference from the four pixels around a place inside the map.
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
