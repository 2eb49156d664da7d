//! Depth and motion of a published frame: quantized, which loses precision, and then compressed without further loss.

use crate::light_field::LoadedFrame;
use crate::scene_flow::{Element, ElementMap, FlowMap};
use flate2::Compression;
use flate2::write::ZlibEncoder;
use serde::Serialize;
use std::io::Write;

/// Number of values of depth and motion per block of pixels: disparity, velocity (2), acceleration (2), and rate of
/// change of the disparity.
const CHANNELS: usize = 6;

/// Quantization steps of depth and motion in published frames.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub(super) struct FlowSteps {
    /// Side of a square block of pixels that share one value of depth and motion, pixels.
    pub block_px: usize,
    /// Quantization step of the disparity, pixels. The disparity is for a baseline of twice the distance between
    /// neighbouring cameras, or less in a wide array.
    pub disparity_px: f32,
    /// Quantization step of the components of a surface point's velocity in the image, pixels per frame.
    pub velocity_px: f32,
    /// Quantization step of the components of a surface point's acceleration in the image, pixels per frame².
    pub acceleration_px: f32,
    /// Quantization step of the disparity's rate of change, pixels per frame.
    pub rate_px: f32,
}

/// Quantized depth and motion of a frame, with one set of values per block of pixels.
pub(super) struct BlockMap {
    pub width: usize,
    pub height: usize,
    pub disparity_px: f32,
    /// Values of each block, row by row, in quantization steps. The first value is the disparity plus one, or 0 where
    /// the camera has no image content.
    blocks: Vec<[i16; CHANNELS]>,
}

/// Depth and motion of each pixel of a frame, row by row. An element is `None` where the camera has no image content.
pub(super) struct ElementImage {
    pub width: usize,
    pub height: usize,
    pub disparity_px: f32,
    pub elements: Vec<Option<Element>>,
}

impl ElementImage {
    pub fn new(loaded: &LoadedFrame) -> Self {
        let LoadedFrame { frame, map } = loaded;
        let is_filmed = |k: usize| frame.is_filmed.as_ref().is_none_or(|filmed| filmed[k]);
        let pixels = map.pixels().iter().enumerate();
        let elements = pixels.map(|(k, p)| is_filmed(k).then(|| map.element(p))).collect();
        let (width, height, disparity_px) = (map.width, map.height, map.disparity_px);
        Self { width, height, disparity_px, elements }
    }

    /// Returns depth and motion for the same frame at half its width and height.
    pub fn halved(&self) -> Self {
        let (width, height) = (self.width / 2, self.height / 2);
        let half = |e: Element| Element {
            velocity: e.velocity.map(|v| 0.5 * v),
            acceleration: e.acceleration.map(|a| 0.5 * a),
            ..e
        };
        let block = |k: usize| self.block(2 * (k % width), 2 * (k / width), 2).map(half);
        let elements = (0..width * height).map(block).collect();
        Self { width, height, disparity_px: 0.5 * self.disparity_px, elements }
    }

    /// Returns the element with the median depth in a square block of pixels, whose top left pixel is (x, y). `None` if
    /// the block has no element.
    fn block(&self, x: usize, y: usize, side: usize) -> Option<Element> {
        let rows = y..(y + side).min(self.height);
        let columns = x..(x + side).min(self.width);
        let pixels = rows.flat_map(|v| columns.clone().map(move |u| v * self.width + u));
        let mut elements: Vec<Element> = pixels.filter_map(|k| self.elements[k]).collect();
        elements.sort_by(|a, b| a.inverse_depth.total_cmp(&b.inverse_depth));
        elements.get(elements.len() / 2).copied()
    }
}

impl BlockMap {
    pub fn new(image: &ElementImage, steps: &FlowSteps) -> Self {
        let side = steps.block_px;
        let (width, height) = (image.width.div_ceil(side), image.height.div_ceil(side));
        let rounded = |v: f32, step: f32| (v / step).round() as i16; // saturates
        let block = |k: usize| {
            let Some(e) = image.block(side * (k % width), side * (k / width), side) else {
                return [0; CHANNELS];
            };
            let disparity = rounded(e.inverse_depth * image.disparity_px, steps.disparity_px);
            let [u, v] = e.velocity.map(|v| rounded(v, steps.velocity_px));
            let [a, b] = e.acceleration.map(|a| rounded(a, steps.acceleration_px));
            let rate = rounded(e.inverse_depth_rate * image.disparity_px, steps.rate_px);
            [disparity.max(0).saturating_add(1), u, v, a, b, rate]
        };
        let blocks = (0..width * height).map(block).collect();
        Self { width, height, disparity_px: image.disparity_px, blocks }
    }

    /// Returns the dequantized map for a frame of this size (width, height, pixels). The published page renders views
    /// from the same values. All pixels of a block have the same element.
    pub fn map(&self, steps: &FlowSteps, [width, height]: [usize; 2]) -> FlowMap {
        let element = |k: usize| {
            let side = steps.block_px;
            let block = self.blocks[k / width / side * self.width + k % width / side];
            let [disparity, u, v, a, b, rate] = block.map(f32::from);
            Element {
                inverse_depth: (disparity - 1.0).max(0.0) * steps.disparity_px / self.disparity_px,
                velocity: [u, v].map(|v| v * steps.velocity_px),
                acceleration: [a, b].map(|a| a * steps.acceleration_px),
                inverse_depth_rate: rate * steps.rate_px / self.disparity_px,
                ..Element::default()
            }
        };
        let elements: Vec<Element> = (0..width * height).map(element).collect();
        let depths = || elements.iter().map(|e| e.inverse_depth);
        let range = [depths().fold(f32::INFINITY, f32::min), depths().fold(0.0, f32::max)];
        let costs = vec![0.0; elements.len()];
        let map = ElementMap { width, height, scale: 1.0, elements, costs, given: Vec::new() };
        FlowMap::new(&map, range, self.disparity_px)
    }

    /// Returns the mask of the pixels with image content, for a frame of this size (width, height, pixels). `None` if
    /// all pixels have content.
    pub fn is_filmed(&self, steps: &FlowSteps, [width, height]: [usize; 2]) -> Option<Vec<bool>> {
        let side = steps.block_px;
        let is_filmed =
            |k: usize| self.blocks[k / width / side * self.width + k % width / side][0] > 0;
        let has_gaps = self.blocks.iter().any(|block| block[0] == 0);
        has_gaps.then(|| (0..width * height).map(is_filmed).collect())
    }

    /// Returns an upper bound of the frame's inverse depths, 1/m. It exceeds the largest quantized value by one step.
    pub fn max_inverse_depth(&self, steps: &FlowSteps) -> f32 {
        let disparity = self.blocks.iter().map(|b| b[0]).max().unwrap_or(0);
        f32::from(disparity) * steps.disparity_px / self.disparity_px
    }

    /// Compresses the map by zlib. In the stream, the channels follow one another. In each channel, all low bytes come
    /// before all high bytes. A value is coded as its difference from the prediction by its left and upper neighbours
    /// ([`predicted`]). The sign of this difference is in the lowest bit.
    pub fn packed(&self) -> Vec<u8> {
        let mut planes = Vec::with_capacity(self.blocks.len() * 2 * CHANNELS);
        for channel in 0..CHANNELS {
            let residuals: Vec<u16> = (0..self.blocks.len())
                .map(|k| {
                    let at = |k: usize| self.blocks[k][channel];
                    let (x, y) = (k % self.width, k / self.width);
                    let left = if x > 0 { at(k - 1) } else { 0 };
                    let above = if y > 0 { at(k - self.width) } else { left };
                    let left = if x > 0 { left } else { above };
                    let corner = if x > 0 && y > 0 { at(k - self.width - 1) } else { above };
                    zigzag(at(k).wrapping_sub(predicted(left, above, corner)))
                })
                .collect();
            planes.extend(residuals.iter().map(|r| r.to_le_bytes()[0]));
            planes.extend(residuals.iter().map(|r| r.to_le_bytes()[1]));
        }
        let mut encoder = ZlibEncoder::new(Vec::new(), Compression::best());
        // Writing to memory can't fail.
        encoder.write_all(&planes).and_then(|()| encoder.finish()).unwrap_or_default()
    }
}

/// Predicts a value as JPEG-LS does: by the median of the left value, the value above, and left + above − upper left.
fn predicted(left: i16, above: i16, corner: i16) -> i16 {
    let (low, high) = (left.min(above), left.max(above));
    let plane = i32::from(left) + i32::from(above) - i32::from(corner);
    plane.clamp(i32::from(low), i32::from(high)) as i16
}

fn zigzag(value: i16) -> u16 {
    ((value << 1) ^ (value >> 15)) as u16
}

#[cfg(test)]
mod tests {
    use super::*;
    use flate2::read::ZlibDecoder;
    use std::io::Read;

    const STEPS: FlowSteps = FlowSteps {
        block_px: 2,
        disparity_px: 0.125,
        velocity_px: 0.25,
        acceleration_px: 0.5,
        rate_px: 0.25,
    };

    /// Returns a slanted surface with an object in front of it. The last column has no image content.
    fn image() -> ElementImage {
        let (width, height, disparity_px) = (9, 7, 50.0);
        let element = |k: usize| {
            let (x, y) = ((k % width) as f32, (k / width) as f32);
            let body = Element { velocity: [-7.3, 2.1], ..Element::default() };
            let e = if x > 4.0 { body } else { Element::default() };
            let inverse_depth = if x > 4.0 { 0.9 } else { 0.3 + 0.01 * x - 0.02 * y };
            (k % width != 8).then_some(Element { inverse_depth, ..e })
        };
        let elements = (0..width * height).map(element).collect();
        ElementImage { width, height, disparity_px, elements }
    }

    #[test]
    fn values_are_off_by_half_a_step() {
        let steps = FlowSteps { block_px: 1, ..STEPS };
        let image = image();
        let blocks = BlockMap::new(&image, &steps);
        let map = blocks.map(&steps, [9, 7]);
        for (k, element) in image.elements.iter().enumerate() {
            let Some(expected) = element else { continue };
            let found = map.element(&map.pixels()[k]);
            let disparity = 50.0 * (found.inverse_depth - expected.inverse_depth);
            assert!(disparity.abs() <= 0.5 * steps.disparity_px + 1e-3, "{k}: {disparity}");
            let velocity = found.velocity[0] - expected.velocity[0];
            assert!(velocity.abs() <= 0.5 * steps.velocity_px + 0.01, "{k}: {velocity}");
        }
        let is_filmed = blocks.is_filmed(&steps, [9, 7]).unwrap();
        assert_eq!(is_filmed.iter().filter(|f| !**f).count(), 7);
    }

    #[test]
    fn a_block_has_its_median_depth_and_the_last_ones_are_smaller() {
        let blocks = BlockMap::new(&image(), &STEPS);
        assert_eq!((blocks.width, blocks.height), (5, 4));
        // Columns 4 and 5 show different surfaces. The upper median is from the nearer one.
        assert_eq!(blocks.blocks[2][0], (0.9f32 * 50.0 / 0.125).round() as i16 + 1);
        assert_eq!(blocks.blocks[4], [0; CHANNELS]);
        assert_eq!(image().halved().elements[2].unwrap().velocity, [-3.65, 1.05]);
    }

    #[test]
    fn packing_loses_nothing() {
        let mut blocks = BlockMap::new(&image(), &STEPS);
        blocks.blocks[7] = [i16::MAX, i16::MIN, -1, 1, i16::MAX, i16::MIN];
        let mut planes = Vec::new();
        ZlibDecoder::new(&*blocks.packed()).read_to_end(&mut planes).unwrap();
        let count = blocks.blocks.len();
        for channel in 0..CHANNELS {
            let mut values = vec![0i16; count];
            for k in 0..count {
                let byte = |plane: usize| u16::from(planes[(2 * channel + plane) * count + k]);
                let residual = byte(0) | byte(1) << 8;
                let (x, y) = (k % blocks.width, k / blocks.width);
                let [left, above, corner] = match (x, y) {
                    (0, 0) => [0; 3],
                    (0, _) => [values[k - blocks.width]; 3],
                    (_, 0) => [values[k - 1]; 3],
                    _ => [1, blocks.width, blocks.width + 1].map(|back| values[k - back]),
                };
                let difference = (residual >> 1) as i16 ^ -((residual & 1) as i16);
                values[k] = predicted(left, above, corner).wrapping_add(difference);
                assert_eq!(values[k], blocks.blocks[k][channel], "{channel}: {k}");
            }
        }
    }
}
