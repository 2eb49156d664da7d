//! The depth and motion of a frame.

use super::element::Element;
use super::frame::FlowFrame;
use serde::{Deserialize, Serialize};

/// A frame's surface elements while they are estimated, one a pixel.
#[derive(Clone)]
pub struct ElementMap {
    pub width: usize,
    pub height: usize,
    /// Pixels of the frame a pixel of the map.
    pub scale: f32,
    pub elements: Vec<Element>,
    /// What their match costs.
    pub costs: Vec<f32>,
}

impl ElementMap {
    /// The centre of a pixel of the map, pixels of the frame.
    pub fn center(&self, k: usize) -> [f32; 2] {
        [k % self.width, k / self.width].map(|v| (v as f32 + 0.5) * self.scale)
    }

    /// The map's pixel at a place, pixels of the frame. `None` outside.
    pub fn index(&self, [x, y]: [f32; 2]) -> Option<usize> {
        let (u, v) = (x / self.scale, y / self.scale);
        let is_inside = u >= 0.0 && v >= 0.0 && u < self.width as f32 && v < self.height as f32;
        is_inside.then(|| v as usize * self.width + u as usize)
    }

    /// The element of a pixel, continued to a place near it.
    pub fn element_at(&self, k: usize, [x, y]: [f32; 2]) -> Element {
        let [cx, cy] = self.center(k);
        self.elements[k].at(x - cx, y - cy)
    }
}

/// Quantization steps a pixel: of velocity, acceleration, and the rate of the inverse depth as disparity.
const STEPS: f32 = 64.0;
/// Sum of the differences in disparity and in motion above which two neighbours are on different surfaces, pixels.
const MAX_JUMP_PX: f32 = 1.0;
/// Time over which their motions are compared, frames.
const JUMP_FRAMES: f32 = 0.5;

/// A frame's depth and motion as views need them: 16 bytes a pixel.
///
/// Disparities, velocities and accelerations are rounded to 1/64 pixel, and depths to 1/1000 pixel of disparity or less.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct FlowMap {
    pub width: usize,
    pub height: usize,
    /// Pixels of disparity of an inverse depth of 1/m, for cameras as far apart as the rig's next but one.
    pub disparity_px: f32,
    pixels: Vec<FlowPixel>,
}

/// The element of a pixel.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct FlowPixel {
    /// 1/m.
    pub inverse_depth: f32,
    velocity: [i16; 2],
    acceleration: [i16; 2],
    rate: i16,
    confidence: u8,
    /// Whether the neighbours to the left, to the right, above and below are of other surfaces, one bit each.
    edges: u8,
}

impl FlowPixel {
    pub fn confidence(&self) -> f32 {
        f32::from(self.confidence) / 255.0
    }

    /// Bit 0: to the left, 1: to the right, 2: above, 3: below.
    pub fn is_edge(&self, side: usize) -> bool {
        self.edges & (1 << side) != 0
    }
}

impl FlowMap {
    /// A map that holds an estimate's elements, which has one a pixel of the frame.
    pub fn new(map: &ElementMap, confidence: &[f32], disparity_px: f32) -> Self {
        let rounded = |v: f32| (v * STEPS).round() as i16; // saturates
        let pixel = |(k, e): (usize, &Element)| {
            let (x, y) = (k % map.width, k / map.width);
            let mut edges = 0;
            for (side, (dx, dy)) in [(-1, 0), (1, 0), (0, -1), (0, 1)].into_iter().enumerate() {
                let (u, v) = (x.wrapping_add_signed(dx), y.wrapping_add_signed(dy));
                if u < map.width && v < map.height {
                    let neighbor = map.elements[v * map.width + u].at(-dx as f32, -dy as f32);
                    edges |= u8::from(is_jump(e, &neighbor, disparity_px)) << side;
                }
            }
            FlowPixel {
                inverse_depth: e.inverse_depth,
                velocity: e.velocity.map(rounded),
                acceleration: e.acceleration.map(rounded),
                rate: rounded(e.inverse_depth_rate * disparity_px),
                confidence: (confidence[k] * 255.0).round().clamp(1.0, 255.0) as u8,
                edges,
            }
        };
        let pixels = map.elements.iter().enumerate().map(pixel).collect();
        Self { width: map.width, height: map.height, disparity_px, pixels }
    }

    pub fn pixels(&self) -> &[FlowPixel] {
        &self.pixels
    }

    /// A pixel's element, parallel to the image.
    #[inline(always)]
    pub fn element(&self, pixel: &FlowPixel) -> Element {
        let value = |v: i16| f32::from(v) / STEPS;
        Element {
            inverse_depth: pixel.inverse_depth,
            velocity: pixel.velocity.map(value),
            acceleration: pixel.acceleration.map(value),
            inverse_depth_rate: value(pixel.rate) / self.disparity_px,
            ..Element::default()
        }
    }

    /// Its size in memory, bytes.
    pub fn bytes(&self) -> usize {
        size_of_val(self.pixels.as_slice())
    }
}

fn is_jump(a: &Element, b: &Element, disparity_px: f32) -> bool {
    let motion = (a.velocity[0] - b.velocity[0]).abs() + (a.velocity[1] - b.velocity[1]).abs();
    let disparity = (a.inverse_depth - b.inverse_depth).abs() * disparity_px;
    disparity + JUMP_FRAMES * motion > MAX_JUMP_PX
}

/// A frame, with its map.
#[derive(Clone, Copy)]
pub struct MappedFrame<'a> {
    pub frame: &'a FlowFrame,
    pub map: &'a FlowMap,
}
