//! Stored form of a scene flow map, compressed without loss.

use super::flow_pixel::FlowPixel;
use super::frame::pinhole;
use super::map::FlowMap;
use crate::camera::Camera;
use flate2::Compression;
use flate2::read::DeflateDecoder;
use flate2::write::DeflateEncoder;
use rayon::prelude::*;
use serde::de::Error;
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use std::io::{Read, Write};

/// Compression level of Deflate. Higher levels take three times as long, and reduce the size by a twentieth.
const LEVEL: u32 = 3;
/// Number of channels of a pixel, 16-bit and 8-bit ones.
const ALL_CHANNELS: usize = FlowPixel::CHANNELS + FlowPixel::BYTE_CHANNELS;

/// Scene flow map with compressed pixels.
#[derive(Serialize, Deserialize)]
struct PackedMap {
    width: usize,
    height: usize,
    disparity_px: f32,
    inverse_depth: [f32; 2],
    /// Channels of the pixels, each compressed on its own, so that they are decompressed in parallel. A 16-bit channel has all
    /// its low bytes before all its high bytes, and each value is stored as the difference from the previous pixel's
    /// value. The 8-bit channels follow, without differences.
    channels: Vec<Vec<u8>>,
}

impl PackedMap {
    fn new(map: &FlowMap) -> Self {
        let pixels = &map.pixels;
        let channel = |channel: usize| {
            let Some(of_bytes) = channel.checked_sub(FlowPixel::CHANNELS) else {
                let mut before = 0i16;
                let mut difference = |p: &FlowPixel| {
                    let value = p.channels()[channel];
                    value.wrapping_sub(std::mem::replace(&mut before, value)).to_le_bytes()
                };
                let differences: Vec<[u8; 2]> = pixels.iter().map(&mut difference).collect();
                let halves = [0, 1].map(|half| differences.iter().map(move |bytes| bytes[half]));
                return deflated(&halves.into_iter().flatten().collect::<Vec<u8>>());
            };
            deflated(&pixels.iter().map(|p| p.byte_channels()[of_bytes]).collect::<Vec<u8>>())
        };
        let channels = (0..ALL_CHANNELS).into_par_iter().map(channel).collect();
        let &FlowMap { width, height, disparity_px, inverse_depth, .. } = map;
        Self { width, height, disparity_px, inverse_depth, channels }
    }

    /// Returns the decompressed scene flow map. `None` if the bytes are damaged.
    fn unpacked(self) -> Option<FlowMap> {
        let Self { width, height, disparity_px, inverse_depth, channels } = self;
        if channels.len() != ALL_CHANNELS {
            return None;
        }
        let count = width.checked_mul(height)?;
        count.checked_mul(FlowPixel::BYTES)?;
        let bytes = |(channel, deflated): (usize, &Vec<u8>)| {
            inflated(deflated, if channel < FlowPixel::CHANNELS { 2 * count } else { count })
        };
        let planes: Vec<Vec<u8>> =
            channels.par_iter().enumerate().map(bytes).collect::<Option<_>>()?;
        let (words, bytes) = planes.split_at(FlowPixel::CHANNELS);
        let mut values = [0i16; FlowPixel::CHANNELS];
        let pixel = |k: usize| {
            for (value, plane) in values.iter_mut().zip(words) {
                let difference = i16::from_le_bytes([plane[k], plane[count + k]]);
                *value = value.wrapping_add(difference);
            }
            FlowPixel::new(values, std::array::from_fn(|channel| bytes[channel][k]))
        };
        let pixels = (0..count).map(pixel).collect();
        Some(FlowMap::of_pixels([width, height], disparity_px, inverse_depth, pixels))
    }
}

fn deflated(bytes: &[u8]) -> Vec<u8> {
    let mut encoder = DeflateEncoder::new(Vec::new(), Compression::new(LEVEL));
    // Writing to memory can't fail.
    encoder.write_all(bytes).and_then(|()| encoder.finish()).unwrap_or_default()
}

/// Returns the decompressed bytes. `None` if they aren't `size` bytes.
fn inflated(deflated: &[u8], size: usize) -> Option<Vec<u8>> {
    let mut bytes = Vec::new();
    let mut decoder = DeflateDecoder::new(deflated).take(size as u64 + 1);
    decoder.read_to_end(&mut bytes).ok()?;
    (bytes.len() == size).then_some(bytes)
}

impl FlowMap {
    /// Returns an upper bound of the size of the stored scene flow map of a frame by `camera`, bytes.
    pub fn max_stored_bytes(camera: &Camera) -> usize {
        let Camera { width, height, .. } = pinhole(camera);
        let bytes = width * height * FlowPixel::BYTES;
        // Deflate adds at most 5 bytes per 16 KiB of incompressible data.
        bytes + bytes / 1024 + 1024
    }
}

impl Serialize for FlowMap {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        PackedMap::new(self).serialize(serializer)
    }
}

impl<'de> Deserialize<'de> for FlowMap {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let packed = PackedMap::deserialize(deserializer)?;
        packed.unpacked().ok_or_else(|| D::Error::custom("a map that is damaged"))
    }
}
