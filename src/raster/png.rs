//! Reading PNG files, row by row into samples: what else such a file holds (colour profiles, texts,
//! metadata, further frames) is passed over, however large it is once it is expanded.

use super::{BitDepth, Image};
use png::{ColorType, DecodingError, Limits, Reader, Transformations};
use std::io::{BufRead, Seek};

/// The first bytes of every PNG file.
pub(super) const SIGNATURE: [u8; 8] = *b"\x89PNG\r\n\x1a\n";

/// Maximum memory of the decoder besides the image, bytes: a row of 65,536 16-bit pixels and a palette.
const MAX_DECODER_BYTES: usize = 16 << 20;

/// A file whose header is read.
pub(super) struct PngFile<R: BufRead + Seek>(Reader<R>);

impl<R: BufRead + Seek> PngFile<R> {
    pub fn open(file: R) -> Result<Self, DecodingError> {
        let limits = Limits { bytes: MAX_DECODER_BYTES };
        let mut decoder = png::Decoder::new_with_limits(file, limits);
        decoder.set_ignore_text_chunk(true);
        decoder.set_ignore_iccp_chunk(true);
        // Palettes and fewer than 8 bits become 8 bits a channel.
        decoder.set_transformations(Transformations::EXPAND);
        Ok(Self(decoder.read_info()?))
    }

    /// Width and height, pixels.
    pub fn size_px(&self) -> (u32, u32) {
        self.0.info().size()
    }

    pub fn bit_depth(&self) -> BitDepth {
        match self.0.output_color_type().1 {
            png::BitDepth::Sixteen => BitDepth::Sixteen,
            _ => BitDepth::Eight,
        }
    }

    /// Channels of a decoded pixel, and how many of them are colour or grey.
    fn channels(&self) -> (usize, usize) {
        match self.0.output_color_type().0 {
            ColorType::Grayscale => (1, 1),
            ColorType::GrayscaleAlpha => (2, 1),
            ColorType::Rgba => (4, 3),
            ColorType::Rgb | ColorType::Indexed => (3, 3),
        }
    }

    /// The image without its alpha, samples divided by their largest value.
    pub fn decode(mut self) -> Result<Image, DecodingError> {
        let (width, height) = self.size_px();
        let (width, height) = (width as usize, height as usize);
        let ((channels, colors), depth) = (self.channels(), self.bit_depth());
        let mut samples = Vec::with_capacity(width * height * colors);
        let eight = |v: &u8| f32::from(*v) / 255.0;
        let sixteen = |v: &[u8; 2]| f32::from(u16::from_be_bytes(*v)) / 65535.0;
        let mut add = |bytes: &[u8]| match (depth, channels == colors) {
            (BitDepth::Eight, true) => samples.extend(bytes.iter().map(eight)),
            (BitDepth::Eight, false) => {
                let pixels = bytes.chunks_exact(channels);
                samples.extend(pixels.flat_map(|p| &p[..colors]).map(eight));
            }
            (BitDepth::Sixteen, true) => {
                samples.extend(bytes.as_chunks().0.iter().map(sixteen));
            }
            (BitDepth::Sixteen, false) => {
                let pixels = bytes.as_chunks().0.chunks_exact(channels);
                samples.extend(pixels.flat_map(|p| &p[..colors]).map(sixteen));
            }
        };
        if self.0.info().interlaced {
            // Its rows are known when all of it is.
            let bytes = self.0.output_buffer_size().ok_or(DecodingError::LimitsExceeded)?;
            let mut whole = vec![0; bytes];
            self.0.next_frame(&mut whole)?;
            add(&whole);
        } else {
            while let Some(row) = self.0.next_row()? {
                add(row.data());
            }
        }
        Ok(Image::from_data(width, height, colors, samples))
    }
}
