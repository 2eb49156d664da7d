//! Stored form of a scene flow map, compressed without loss.

use super::frame::pinhole;
use super::map::{FlowMap, FlowPixel};
use crate::camera::Camera;
use flate2::Compression;
use flate2::read::DeflateDecoder;
use flate2::write::DeflateEncoder;
use serde::de::Error;
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use std::io::{Read, Write};

/// Compression level of Deflate. Higher levels take three times as long, and reduce the size by a twentieth.
const LEVEL: u32 = 3;

/// Scene flow map with compressed pixels. The pixels are compressed in planes, channel by channel. A 16-bit channel has
/// all its low bytes before all its high bytes, and each value is stored as the difference from the previous pixel's
/// value. The 8-bit channels follow, without differences.
#[derive(Serialize, Deserialize)]
struct PackedMap {
    width: usize,
    height: usize,
    disparity_px: f32,
    inverse_depth: [f32; 2],
    deflated: Vec<u8>,
}

impl PackedMap {
    fn new(map: &FlowMap) -> Self {
        let mut planes = Vec::with_capacity(map.pixels.len() * FlowPixel::BYTES);
        for channel in 0..FlowPixel::CHANNELS {
            let mut before = 0u16;
            let differences: Vec<u16> = map
                .pixels
                .iter()
                .map(|p| {
                    let value = p.channels()[channel];
                    value.wrapping_sub(std::mem::replace(&mut before, value))
                })
                .collect();
            planes.extend(differences.iter().map(|d| d.to_le_bytes()[0]));
            planes.extend(differences.iter().map(|d| d.to_le_bytes()[1]));
        }
        for channel in 0..FlowPixel::BYTE_CHANNELS {
            planes.extend(map.pixels.iter().map(|p| p.byte_channels()[channel]));
        }
        let mut encoder = DeflateEncoder::new(Vec::new(), Compression::new(LEVEL));
        // Writing to memory can't fail.
        let deflated = encoder.write_all(&planes).and_then(|()| encoder.finish());
        let &FlowMap { width, height, disparity_px, inverse_depth, .. } = map;
        Self { width, height, disparity_px, inverse_depth, deflated: deflated.unwrap_or_default() }
    }

    /// Returns the decompressed scene flow map. `None` if the bytes are damaged.
    fn unpacked(self) -> Option<FlowMap> {
        let Self { width, height, disparity_px, inverse_depth, deflated } = self;
        let count = width.checked_mul(height)?;
        let expected = count.checked_mul(FlowPixel::BYTES)?;
        let mut planes = Vec::new();
        let mut decoder = DeflateDecoder::new(&*deflated).take(expected as u64 + 1);
        decoder.read_to_end(&mut planes).ok()?;
        if planes.len() != expected {
            return None;
        }
        let mut channels = vec![[0u16; FlowPixel::CHANNELS]; count];
        let (words, bytes) = planes.split_at(2 * FlowPixel::CHANNELS * count);
        for (channel, bytes) in words.chunks_exact(2 * count.max(1)).enumerate() {
            let (low, high) = bytes.split_at(count);
            let mut value = 0u16;
            for ((pixel, low), high) in channels.iter_mut().zip(low).zip(high) {
                value = value.wrapping_add(u16::from_le_bytes([*low, *high]));
                pixel[channel] = value;
            }
        }
        let pixel = |(k, c): (usize, &[u16; FlowPixel::CHANNELS])| {
            FlowPixel::new(*c, std::array::from_fn(|channel| bytes[channel * count + k]))
        };
        let pixels = channels.iter().enumerate().map(pixel).collect();
        Some(FlowMap::of_pixels([width, height], disparity_px, inverse_depth, pixels))
    }
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
