//! Decoder of PNG files. Rows are converted to samples one by one. Everything else in a file (colour profiles, texts,
//! metadata, further frames) is skipped, whatever its decompressed size.

use super::Image;
use png::{BitDepth, ColorType, DecodingError, Limits, Reader, Transformations};
use std::io::{BufRead, Seek};

/// The first bytes of every PNG file.
pub(super) const SIGNATURE: [u8; 8] = *b"\x89PNG\r\n\x1a\n";

/// Maximum memory of the decoder in addition to the image, bytes. A row of 65,536 RGBA pixels with 16 bits per channel
/// takes half a megabyte of it. The rest is for compressed metadata.
const MAX_DECODER_BYTES: usize = 16 << 20;

/// Opens a PNG file and reads its header.
pub(super) fn open<R: BufRead + Seek>(file: R) -> Result<Reader<R>, DecodingError> {
    let limits = Limits { bytes: MAX_DECODER_BYTES };
    let mut decoder = png::Decoder::new_with_limits(file, limits);
    decoder.set_ignore_text_chunk(true);
    decoder.set_ignore_iccp_chunk(true);
    // Palettes and samples of fewer than 8 bits are expanded to 8 bits per channel.
    decoder.set_transformations(Transformations::EXPAND);
    decoder.read_info()
}

pub(super) fn bytes_per_sample<R: BufRead + Seek>(reader: &Reader<R>) -> usize {
    if reader.output_color_type().1 == BitDepth::Sixteen { 2 } else { 1 }
}

/// Decodes the image of a PNG file, without its alpha channel. Samples are scaled to the range from 0 to 1.
pub(super) fn decode<R: BufRead + Seek>(mut reader: Reader<R>) -> Result<Image, DecodingError> {
    let (width, height) = reader.info().size();
    let (width, height) = (width as usize, height as usize);
    // Number of channels of a decoded pixel, with and without alpha.
    let (channels, colors) = match reader.output_color_type().0 {
        ColorType::Grayscale => (1, 1),
        ColorType::GrayscaleAlpha => (2, 1),
        ColorType::Rgba => (4, 3),
        ColorType::Rgb | ColorType::Indexed => (3, 3),
    };
    let bytes_per_sample = bytes_per_sample(&reader);
    let mut samples = Vec::with_capacity(width * height * colors);
    let mut add = |row: &[u8]| {
        let (opaque, mut bytes): (Vec<u8>, &[u8]);
        bytes = row;
        if channels > colors {
            let pixels = bytes.chunks_exact(channels * bytes_per_sample);
            opaque = pixels.flat_map(|p| &p[..colors * bytes_per_sample]).copied().collect();
            bytes = &opaque;
        }
        if bytes_per_sample == 1 {
            samples.extend(bytes.iter().map(|v| f32::from(*v) / 255.0));
        } else {
            let values = bytes.as_chunks().0.iter().map(|v| u16::from_be_bytes(*v));
            samples.extend(values.map(|v| f32::from(v) / 65535.0));
        }
    };
    if reader.info().interlaced {
        // An interlaced image is decoded as a whole, because the pixels of a row are spread over several passes.
        let bytes = reader.output_buffer_size().ok_or(DecodingError::LimitsExceeded)?;
        let mut whole = vec![0; bytes];
        reader.next_frame(&mut whole)?;
        add(&whole);
    } else {
        while let Some(row) = reader.next_row()? {
            add(row.data());
        }
    }
    Ok(Image::from_data(width, height, colors, samples))
}
