//! A published frame: a JPEG image, with its depth and motion.

use super::flow::{BlockMap, ElementImage, FlowSteps};
use super::quality::Quality;
use crate::camera::Camera;
use crate::light_field::LoadedFrame;
use crate::raster::Image;
use crate::scene_flow::FlowFrame;
use image::codecs::jpeg::JpegEncoder;
use image::{ExtendedColorType, ImageEncoder, ImageFormat};
use std::collections::BTreeMap;

/// Published frames of all cameras, by (camera index, frame index).
pub(super) type Published = BTreeMap<(usize, usize), PublishedFrame>;

/// A frame that is encoded for the published page at a given quality.
pub(super) struct PublishedFrame {
    /// Pinhole camera of the frame, at the published size.
    pub view: Camera,
    /// Time of the frame in units of the reference camera's frame interval, from the capture's start.
    pub time: f64,
    pub is_color: bool,
    pub jpeg: Vec<u8>,
    pub map: BlockMap,
    /// Depth and motion of the surface at each pixel of the frame, quantized in blocks, as a zlib stream.
    pub flow: Vec<u8>,
}

impl PublishedFrame {
    /// Encodes a frame, with its depth and motion, at a given quality.
    ///
    /// # Errors
    /// If the image can't be encoded. The error says why.
    pub fn new(loaded: &LoadedFrame, quality: &Quality) -> Result<Self, String> {
        let frame = &loaded.frame;
        let (mut view, mut image) = (frame.view.clone(), frame.image.clone());
        let mut elements = ElementImage::new(loaded);
        for _ in 0..quality.halvings {
            let Some(half) = view.halved() else { break };
            (view, image, elements) = (half, halved(&image), elements.halved());
        }
        let map = BlockMap::new(&elements, &quality.steps);
        let jpeg = encoded(&image, quality.jpeg).map_err(|e| e.to_string())?;
        let flow = map.packed();
        Ok(Self { view, time: frame.time, is_color: frame.is_color, jpeg, map, flow })
    }

    pub fn bytes(&self) -> usize {
        self.jpeg.len() + self.flow.len()
    }

    /// Decodes the frame with its depth and motion, as the published page does.
    ///
    /// # Errors
    /// If the image can't be decoded. The error says why.
    pub fn decoded(&self, steps: &FlowSteps) -> Result<LoadedFrame, String> {
        let decoded = image::load_from_memory_with_format(&self.jpeg, ImageFormat::Jpeg);
        let rgb = decoded.map_err(|e| e.to_string())?.into_rgb8();
        let (width, height) = (self.view.width, self.view.height);
        let data = rgb.as_raw().iter().map(|v| f32::from(*v) / 255.0).collect();
        let frame = FlowFrame {
            view: self.view.clone(),
            time: self.time,
            neighbors: [f64::NEG_INFINITY, f64::INFINITY], // the page doesn't fade frames
            row_time: 0.0, // the page doesn't render rolling shutters
            is_color: self.is_color,
            image: Image::from_data(width, height, 3, data),
            is_filmed: self.map.is_filmed(steps, [width, height]),
            original: None,
            still: None,
        };
        let map = self.map.map(steps, [width, height]);
        Ok(LoadedFrame { frame: frame.into(), map: map.into() })
    }
}

/// Returns the image at half its size, as means of 2×2 pixels. An odd last row or column is dropped.
fn halved(image: &Image) -> Image {
    let (width, height, channels) = (image.width() / 2, image.height() / 2, image.channels());
    let mean = |k: usize| {
        let (x, y, c) = (k / channels % width, k / channels / width, k % channels);
        let at = |dx: usize, dy: usize| image.pixel(2 * x + dx, 2 * y + dy)[c];
        0.25 * (at(0, 0) + at(1, 0) + at(0, 1) + at(1, 1))
    };
    let data = (0..width * height * channels).map(mean).collect();
    Image::from_data(width, height, channels, data)
}

/// Encodes an RGB image as JPEG, without chroma subsampling.
fn encoded(image: &Image, quality: u8) -> image::ImageResult<Vec<u8>> {
    let bytes: Vec<u8> = image.data().iter().map(|v| (255.0 * v).round() as u8).collect(); // saturates
    let mut jpeg = Vec::new();
    let encoder = JpegEncoder::new_with_quality(&mut jpeg, quality);
    let (width, height) = (image.width() as u32, image.height() as u32);
    encoder.write_image(&bytes, width, height, ExtendedColorType::Rgb8)?;
    Ok(jpeg)
}
