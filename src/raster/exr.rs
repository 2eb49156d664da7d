//! Writer of OpenEXR files: linear light as half floats, depth and motion, in channels with the usual names.
//!
//! The format is described at <https://openexr.com/en/latest/OpenEXRFileLayout.html>. Files are single-part scanline
//! files of version 2, with ZIP compression of blocks of 16 rows. The crate `exr` isn't used, because it depends on
//! dozens of crates for reading and for other codecs.

use super::file::ImageFileError;
use super::{Image, linear_from_encoded};
use crate::host::temporary::Temporary;
use flate2::{Compression, write::ZlibEncoder};
use rayon::prelude::*;
use std::fs::File;
use std::io::{Seek, SeekFrom, Write};
use std::path::Path;

/// Depth that is written for a pixel without a surface, metres. Blender writes the same value.
const NO_DEPTH_M: f32 = 1e10;

/// Number of rows in a compressed block. The format prescribes this number for ZIP compression.
const BLOCK_ROWS: usize = 16;

/// Number of blocks that are compressed in parallel before they are written. A larger number takes more memory. With a
/// smaller number, threads wait for each other.
const BLOCKS_AT_ONCE: usize = 32;

/// Name of an OpenEXR file in the temporary folder in which it is written. The finished file is moved to its path.
const FILE: &str = "exr";

/// Magic number at the start of every OpenEXR file.
const MAGIC: u32 = 20_000_630;
/// Version of the OpenEXR format.
const VERSION: u32 = 2;
/// Code of the ZIP compression of blocks of 16 rows in the OpenEXR format.
const ZIP: u8 = 3;
/// Code of channels of half floats in the OpenEXR format.
const HALF: u32 = 1;
/// Code of channels of 32-bit floats in the OpenEXR format.
const FLOAT: u32 = 2;

/// A channel of an OpenEXR file: the type of its values, and a function that returns the value at a pixel. The
/// function's argument is the pixel's index, row by row.
enum Channel<'a> {
    Half(Value<'a>),
    Float(Value<'a>),
}

type Value<'a> = Box<dyn Fn(usize) -> f32 + Sync + 'a>;

/// Layers of an OpenEXR file. Every layer has one value per pixel, row by row.
pub struct ExrLayers<'a> {
    /// The image: 1 or 3 channels, display-encoded (sRGB).
    pub image: &'a Image,
    /// Mask of the covered pixels. All other pixels are written black, with alpha 0 and without motion.
    pub coverage: &'a [bool],
    /// Depth along the camera's axis, metres. A depth that isn't finite is written as 1e10.
    pub depths_m: &'a [f32],
    /// Displacements of each pixel's surface point to the previous and to the next picture, pixels to the right and
    /// down. If it is `None`, no motion channels are written.
    pub motion: Option<&'a Displacements<'a>>,
}

/// Two displacements of a pixel's surface point: to the previous picture and to the next picture. Each is in pixels to
/// the right and down. The argument is the pixel's index.
pub type Displacements<'a> = dyn Fn(usize) -> [[f32; 2]; 2] + Sync + 'a;

/// Writes layers as an OpenEXR file. A missing folder is created.
///
/// | channels | contents |
/// |---|---|
/// | `R`, `G`, `B`, `A` | scene-linear light and alpha, half floats |
/// | `Z` | depth, metres, 32-bit floats |
/// | `forward.u`, `forward.v` | motion to the next picture, pixels to the right and up, half floats, named as in Nuke |
/// | `backward.u`, `backward.v` | motion to the previous picture, pixels to the right and up, half floats |
/// | `Vector.X`, `.Y`, `.Z`, `.W` | Blender's Vector pass: X and Y are `backward`, Z and W are minus `forward` |
///
/// Half floats have 11 significant bits. A motion of 64 pixels is therefore exact to 0.03 pixels.
///
/// # Panics
/// If `coverage` or `depths_m` doesn't have one value per pixel.
///
/// # Errors
/// If the file can't be written.
pub fn write_exr(path: &Path, layers: &ExrLayers) -> Result<(), ImageFileError> {
    let channels = channels(layers);
    let size = [layers.image.width(), layers.image.height()];
    let written = Temporary::for_file(path).and_then(|temporary| {
        let file = File::create(temporary.path().join(FILE))?;
        encode(file, size, &channels)?;
        temporary.place(FILE, path)
    });
    written.map_err(|source| ImageFileError::Write { path: path.to_owned(), source })
}

/// Returns the file's channels, sorted by name as the format requires.
fn channels<'a>(layers: &ExrLayers<'a>) -> Vec<(&'static str, Channel<'a>)> {
    let ExrLayers { image, coverage, depths_m, motion } = *layers;
    let pixels = image.width() * image.height();
    assert_eq!((coverage.len(), depths_m.len()), (pixels, pixels), "one a pixel");
    let count = image.channels();
    let color = |channel: usize| {
        Channel::Half(Box::new(move |k| {
            let value = f64::from(image.data()[k * count + channel.min(count - 1)]);
            if coverage[k] { linear_from_encoded(value) as f32 } else { 0.0 }
        }))
    };
    let alpha = |k: usize| f32::from(u8::from(coverage[k]));
    let depth = |k: usize| if depths_m[k].is_finite() { depths_m[k] } else { NO_DEPTH_M };
    let mut channels = vec![
        ("A", Channel::Half(Box::new(alpha))),
        ("B", color(2)),
        ("G", color(1)),
        ("R", color(0)),
        ("Z", Channel::Float(Box::new(depth))),
    ];
    if let Some(displacements) = motion {
        channels.extend(motion_channels(displacements, coverage));
        channels.sort_unstable_by_key(|(name, _)| *name);
    }
    channels
}

/// Returns the motion channels: name, and value at each pixel. In the file, vertical motion is positive upwards.
fn motion_channels<'a>(
    displacements: &'a Displacements<'a>,
    coverage: &'a [bool],
) -> [(&'static str, Channel<'a>); 8] {
    let [before, after] = [0, 1];
    let [right, up] = [(0, 1.0), (1, -1.0)];
    let channel = |name, to: usize, (axis, sign): (usize, f32), factor: f32| {
        let value = move |k: usize| match coverage[k] {
            true => factor * sign * displacements(k)[to][axis],
            false => 0.0,
        };
        (name, Channel::Half(Box::new(value) as Value))
    };
    [
        channel("Vector.X", before, right, 1.0),
        channel("Vector.Y", before, up, 1.0),
        channel("Vector.Z", after, right, -1.0),
        channel("Vector.W", after, up, -1.0),
        channel("backward.u", before, right, 1.0),
        channel("backward.v", before, up, 1.0),
        channel("forward.u", after, right, 1.0),
        channel("forward.v", after, up, 1.0),
    ]
}

/// Returns the bits of the half float nearest to a value, with ties to even. NaN becomes 0. Values beyond the largest
/// half float become the largest.
fn half(value: f32) -> u16 {
    const MAX: f32 = 65_504.0;
    /// Smallest positive half float, 2^−24.
    const MIN: f32 = 5.960_464_5e-8;
    /// Smallest half float with full precision, 2^−14.
    const MIN_NORMAL: f32 = 6.103_515_6e-5;
    let sign = if value.is_sign_negative() { 0x8000 } else { 0 };
    let size = if value.is_nan() { 0.0 } else { value.abs().min(MAX) };
    if size < MIN_NORMAL {
        return sign | (size / MIN).round_ties_even() as u16;
    }
    // The exponent's bias differs by 112, and the mantissa by 13 bits. Rounding may carry into the exponent.
    let bits = size.to_bits();
    let rounded = bits + 0x0fff + ((bits >> 13) & 1);
    sign | ((rounded >> 13) - (112 << 10)) as u16
}

/// Encodes channels as an OpenEXR file, and writes it in runs of [`BLOCKS_AT_ONCE`] blocks. Only one run is in memory
/// at a time.
fn encode(
    mut file: impl Write + Seek,
    [width, height]: [usize; 2],
    channels: &[(&str, Channel)],
) -> std::io::Result<()> {
    let block = |index: usize| -> std::io::Result<Vec<u8>> {
        let rows = index * BLOCK_ROWS..((index + 1) * BLOCK_ROWS).min(height);
        let raw: Vec<u8> = rows.flat_map(|y| row(channels, width, y)).collect();
        let packed = compressed(&raw)?;
        // A block that compression doesn't shrink is stored uncompressed.
        Ok(if packed.len() < raw.len() { packed } else { raw })
    };
    let count = height.div_ceil(BLOCK_ROWS);
    let mut start = Vec::new();
    start.extend(MAGIC.to_le_bytes());
    start.extend(VERSION.to_le_bytes());
    header(&mut start, [width as u32, height as u32], channels);
    // The table of the blocks' positions in the file follows the header. It is written after the blocks.
    file.write_all(&start)?;
    file.write_all(&vec![0; 8 * count])?;
    let mut place = start.len() + 8 * count;
    let mut table = Vec::new();
    for first in (0..count).step_by(BLOCKS_AT_ONCE) {
        let run = first..(first + BLOCKS_AT_ONCE).min(count);
        let blocks = run.into_par_iter().map(block).collect::<std::io::Result<Vec<_>>>()?;
        for (index, block) in (first..).zip(blocks) {
            file.write_all(&((index * BLOCK_ROWS) as i32).to_le_bytes())?;
            file.write_all(&(block.len() as u32).to_le_bytes())?;
            file.write_all(&block)?;
            table.extend((place as u64).to_le_bytes());
            place += 8 + block.len();
        }
    }
    file.seek(SeekFrom::Start(start.len() as u64))?;
    file.write_all(&table)
}

fn header(file: &mut Vec<u8>, [width, height]: [u32; 2], channels: &[(&str, Channel)]) {
    let mut attribute = |name: &str, kind: &str, value: &[u8]| {
        for word in [name, kind] {
            file.extend(word.as_bytes());
            file.push(0);
        }
        file.extend((value.len() as u32).to_le_bytes());
        file.extend(value);
    };
    let mut list = Vec::new();
    for (name, channel) in channels {
        list.extend(name.as_bytes());
        list.push(0);
        let kind = if matches!(channel, Channel::Half(_)) { HALF } else { FLOAT };
        // Pixel type, linearity flag with padding, and sampling steps of columns and rows.
        [kind, 0, 1, 1].iter().for_each(|number| list.extend(number.to_le_bytes()));
    }
    list.push(0);
    let window: Vec<u8> =
        [0, 0, width - 1, height - 1].iter().flat_map(|v| v.to_le_bytes()).collect();
    attribute("channels", "chlist", &list);
    attribute("compression", "compression", &[ZIP]);
    attribute("dataWindow", "box2i", &window);
    attribute("displayWindow", "box2i", &window);
    attribute("lineOrder", "lineOrder", &[0]);
    attribute("pixelAspectRatio", "float", &1.0_f32.to_le_bytes());
    attribute("screenWindowCenter", "v2f", &[0; 8]);
    attribute("screenWindowWidth", "float", &1.0_f32.to_le_bytes());
    file.push(0);
}

/// Returns the uncompressed bytes of the pixel row `y`: the whole row of the first channel, then of the second channel,
/// and so on.
fn row(channels: &[(&str, Channel)], width: usize, y: usize) -> Vec<u8> {
    let span = y * width..(y + 1) * width;
    let bytes = |(_, channel): &(&str, Channel)| -> Vec<u8> {
        match channel {
            Channel::Half(value) => {
                span.clone().flat_map(|k| half(value(k)).to_le_bytes()).collect()
            }
            Channel::Float(value) => span.clone().flat_map(|k| value(k).to_le_bytes()).collect(),
        }
    };
    channels.iter().flat_map(bytes).collect()
}

/// Compresses a block by the format's ZIP compression: even bytes before odd bytes, differences of neighbours, then
/// deflate.
fn compressed(raw: &[u8]) -> std::io::Result<Vec<u8>> {
    let halves = raw.iter().step_by(2).chain(raw.iter().skip(1).step_by(2));
    let mut before = None;
    let differences = halves.map(|&byte| {
        let difference =
            before.map_or(byte, |before: u8| byte.wrapping_sub(before).wrapping_add(128));
        before = Some(byte);
        difference
    });
    let differences: Vec<u8> = differences.collect();
    let mut encoder = ZlibEncoder::new(Vec::new(), Compression::new(4));
    encoder.write_all(&differences)?;
    encoder.finish()
}

#[cfg(test)]
mod tests {
    use super::*;
    use flate2::read::ZlibDecoder;
    use std::io::Read;

    /// Returns the value of a half float, from the definition of the format.
    fn value(half: u16) -> f64 {
        let (exponent, mantissa) = (i32::from(half >> 10 & 31), f64::from(half & 1023));
        let size = match exponent {
            0 => mantissa * 2.0_f64.powi(-24),
            31 => f64::INFINITY,
            _ => (1024.0 + mantissa) * 2.0_f64.powi(exponent - 25),
        };
        if half >> 15 == 1 { -size } else { size }
    }

    #[test]
    fn halves_are_the_nearest() {
        for bits in (0..31 << 10).chain(0x8000..0x8000 + (31 << 10)) {
            assert_eq!(half(value(bits) as f32), bits);
        }
        for number in [0.1_f32, 1.0 / 3.0, 0.999_9, 1234.5, 3e-5, 1e-7, 2049.0, 2051.0] {
            let found = half(number);
            let error = |bits: u16| (value(bits) - f64::from(number)).abs();
            assert!(
                error(found) <= error(found + 1) && error(found) <= error(found - 1),
                "{number}"
            );
        }
        assert_eq!((half(f32::NAN) & 0x7fff, value(half(1e30))), (0, 65_504.0));
        // A value halfway between two half floats becomes the one with an even mantissa.
        assert_eq!((value(half(2049.0)), value(half(2051.0))), (2048.0, 2052.0));
    }

    #[test]
    fn blocks_are_undone_to_the_rows() {
        let raw: Vec<u8> = (0..999_u32).map(|k| (k * k / 7) as u8).collect();
        let mut bytes = Vec::new();
        ZlibDecoder::new(&*compressed(&raw).unwrap()).read_to_end(&mut bytes).unwrap();
        for k in 1..bytes.len() {
            bytes[k] = bytes[k].wrapping_add(bytes[k - 1]).wrapping_sub(128);
        }
        let (even, odd) = bytes.split_at(raw.len().div_ceil(2));
        let undone: Vec<u8> =
            (0..raw.len()).map(|k| if k % 2 == 0 { even[k / 2] } else { odd[k / 2] }).collect();
        assert_eq!(undone, raw);
    }

    #[test]
    fn channels_are_linear_light_alpha_depth_and_motion() {
        // sRGB 0.735357 is linear 0.5.
        let image = Image::from_data(2, 1, 3, vec![0.735_357, 1.0, 0.0, 1.0, 1.0, 1.0]);
        let motion = |_: usize| [[-3.0, 1.0], [4.0, -2.0]];
        let layers = ExrLayers {
            image: &image,
            coverage: &[true, false],
            depths_m: &[2.5, f32::NAN],
            motion: Some(&motion),
        };
        let found = channels(&layers);
        assert!(found.is_sorted_by(|a, b| a.0 < b.0));
        let values: Vec<(&str, Vec<f64>)> = found
            .iter()
            .map(|(name, channel)| match channel {
                Channel::Half(of) => (*name, (0..2).map(|k| value(half(of(k)))).collect()),
                Channel::Float(of) => (*name, (0..2).map(|k| f64::from(of(k))).collect()),
            })
            .collect();
        let expected = [
            ("A", [1.0, 0.0]),
            ("B", [0.0; 2]),
            ("G", [1.0, 0.0]),
            ("R", [0.5, 0.0]),
            ("Vector.W", [-2.0, 0.0]),
            ("Vector.X", [-3.0, 0.0]),
            ("Vector.Y", [-1.0, 0.0]),
            ("Vector.Z", [-4.0, 0.0]),
            ("Z", [2.5, 1e10]),
            ("backward.u", [-3.0, 0.0]),
            ("backward.v", [-1.0, 0.0]),
            ("forward.u", [4.0, 0.0]),
            ("forward.v", [2.0, 0.0]),
        ];
        assert_eq!(values.len(), expected.len());
        for ((name, values), (expected_name, expected)) in values.iter().zip(expected) {
            assert_eq!(*name, expected_name);
            for (value, expected) in values.iter().zip(expected) {
                assert!((value - expected).abs() <= 1e-3 * expected.abs(), "{name}: {values:?}");
            }
        }
        let still = channels(&ExrLayers { motion: None, ..layers });
        assert!(still.iter().map(|(name, _)| *name).eq(["A", "B", "G", "R", "Z"]));
    }
}
