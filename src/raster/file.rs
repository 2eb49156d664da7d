//! Reading and writing image files.

use super::png;
use super::{BitDepth, Image, Quantized, Samples};
use crate::host::{FileRead, open_bounded, read_hashed, write_atomically};
use image::codecs::jpeg::JpegEncoder;
use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use image::{DynamicImage, ExtendedColorType, ImageDecoder, ImageEncoder, ImageReader, Limits};
use std::fs::File;
use std::io::{BufRead, BufReader, Cursor, Seek};
use std::path::{Path, PathBuf};

/// Error of reading or writing an image file. Every message is one sentence that starts with the file's path.
#[derive(Debug, thiserror::Error)]
pub enum ImageFileError {
    /// The file can't be read.
    #[error("{path}: {source}")]
    Read { path: PathBuf, source: std::io::Error },
    /// The file can't be written.
    #[error("{path}: can't be written ({source})")]
    Write { path: PathBuf, source: std::io::Error },
    /// The bytes can't be decoded to an image, or an image can't be encoded.
    #[error("{path}: {reason}")]
    Content { path: PathBuf, reason: String },
}

/// Properties of an image from its file's header.
pub(crate) struct Header {
    pub width: u32,
    pub height: u32,
    pub bit_depth: BitDepth,
}

/// Maximum number of pixels of an image: 8192×8192.
pub const MAX_PIXELS: u64 = 1 << 26;

/// Maximum size of an image file, bytes: 8192×8192 pixels of incompressible 16-bit RGB, and metadata.
const MAX_FILE_BYTES: u64 = 448 << 20;

/// Maximum memory of a decoder of any format except PNG, bytes: an 8192×8192 image and the decoder's buffers.
const MAX_DECODE_BYTES: u64 = 1 << 30;

fn image_error(path: &Path, reason: impl std::fmt::Display) -> ImageFileError {
    ImageFileError::Content { path: path.to_owned(), reason: reason.to_string() }
}

fn read_error(path: &Path) -> impl Fn(std::io::Error) -> ImageFileError {
    |source| ImageFileError::Read { path: path.to_owned(), source }
}

/// An image file whose header has been read and checked. The image has at most [`MAX_PIXELS`] pixels.
struct OpenedImage<R: BufRead + Seek> {
    header: Header,
    decoder: Decoder<R>,
}

/// Decoder of an image file's pixels.
enum Decoder<R: BufRead + Seek> {
    Png(Box<::png::Reader<R>>),
    Other(Box<dyn ImageDecoder>),
}

fn open(path: &Path) -> Result<OpenedImage<BufReader<File>>, ImageFileError> {
    let (file, _) = open_bounded(path, MAX_FILE_BYTES).map_err(read_error(path))?;
    OpenedImage::new(path, BufReader::new(file))
}

impl<R: BufRead + Seek + 'static> OpenedImage<R> {
    fn new(path: &Path, mut file: R) -> Result<Self, ImageFileError> {
        let is_png = file.fill_buf().map_err(read_error(path))?.starts_with(&png::SIGNATURE);
        let (decoder, (width, height), bytes_per_sample) = if is_png {
            let reader = png::open(file).map_err(|e| image_error(path, e))?;
            let (size, bytes) = (reader.info().size(), png::bytes_per_sample(&reader));
            (Decoder::Png(Box::new(reader)), size, bytes)
        } else {
            pnm_header(file.fill_buf().map_err(read_error(path))?)
                .map_err(|reason| image_error(path, reason))?;
            let mut reader =
                ImageReader::new(file).with_guessed_format().map_err(read_error(path))?;
            let mut limits = Limits::default();
            limits.max_alloc = Some(MAX_DECODE_BYTES);
            reader.limits(limits);
            let decoder = reader.into_decoder().map_err(|e| image_error(path, e))?;
            let (size, color) = (decoder.dimensions(), decoder.color_type());
            let bytes = color.bytes_per_pixel() / color.channel_count();
            (Decoder::Other(Box::new(decoder)), size, usize::from(bytes))
        };
        match u64::from(width) * u64::from(height) {
            0 => Err(image_error(path, "has no pixels")),
            pixels if pixels > MAX_PIXELS => Err(image_error(
                path,
                format!("is {width}×{height} pixels, at most {MAX_PIXELS} are read"),
            )),
            _ => {
                let is_deep = bytes_per_sample > 1;
                let bit_depth = if is_deep { BitDepth::Sixteen } else { BitDepth::Eight };
                Ok(Self { header: Header { width, height, bit_depth }, decoder })
            }
        }
    }

    fn decode(self, path: &Path) -> Result<Image, ImageFileError> {
        match self.decoder {
            Decoder::Png(reader) => png::decode(*reader).map_err(|e| image_error(path, e)),
            Decoder::Other(decoder) => {
                let decoded = DynamicImage::from_decoder(decoder);
                Ok(unpacked(decoded.map_err(|e| image_error(path, e))?))
            }
        }
    }
}

/// Maximum length of a PNM header including its comments, bytes. A header of this length fits into the buffer of a
/// buffered reader.
const MAX_PNM_HEADER: usize = 4096;

/// Checks that the header of a PNM file has at most [`MAX_PNM_HEADER`] bytes. The PNM decoder would read the comments
/// of a longer header byte by byte, which takes long. `start` has the first bytes of the file. Files of other formats
/// are accepted. The error message doesn't name the file.
fn pnm_header(start: &[u8]) -> Result<(), String> {
    let (Some(header), [b'P', kind @ b'1'..=b'7', ..]) = (start.get(..MAX_PNM_HEADER), start)
    else {
        return Ok(());
    };
    let is_whole = match kind {
        b'7' => header.windows(6).any(|word| word == b"ENDHDR"),
        _ => pnm_words(&header[2..]) > 2,
    };
    if is_whole { Ok(()) } else { Err(format!("has a header of more than {MAX_PNM_HEADER} bytes")) }
}

/// Returns the number of words in a PNM header. Words in comments don't count.
fn pnm_words(header: &[u8]) -> usize {
    let (mut words, mut in_word, mut in_comment) = (0, false, false);
    for byte in header {
        in_comment = *byte == b'#' || in_comment && *byte != b'\n';
        let is_of_word = !in_comment && !byte.is_ascii_whitespace();
        words += usize::from(is_of_word && !in_word);
        in_word = is_of_word;
    }
    words
}

pub(crate) fn read_header(path: &Path) -> Result<Header, ImageFileError> {
    open(path).map(|opened| opened.header)
}

/// Reads an image file. Returns the image and its bit depth. Grey images have one channel, all others three. Alpha is
/// ignored. Samples are scaled to the range from 0 to 1.
///
/// Refused before any pixel is decoded are a file that isn't regular, a file of more than 448 MiB, and an image of more
/// than [`MAX_PIXELS`] pixels.
pub fn read_image(path: &Path) -> Result<(Image, BitDepth), ImageFileError> {
    let opened = open(path)?;
    let depth = opened.header.bit_depth;
    Ok((opened.decode(path)?, depth))
}

/// Reads an image file like [`read_image`]. Returns the image, the hash of the file's bytes, and the file's size and
/// times.
pub(crate) fn read_hashed_image(path: &Path) -> Result<(Image, FileRead), ImageFileError> {
    let (bytes, read) = read_hashed(path, MAX_FILE_BYTES).map_err(read_error(path))?;
    Ok((OpenedImage::new(path, Cursor::new(bytes))?.decode(path)?, read))
}

fn unpacked(decoded: DynamicImage) -> Image {
    let (w, h) = (decoded.width() as usize, decoded.height() as usize);
    if decoded.color().channel_count() <= 2 {
        Image::from_data(w, h, 1, decoded.to_luma32f().into_raw())
    } else {
        Image::from_data(w, h, 3, decoded.into_rgb32f().into_raw())
    }
}

/// File format of a single image.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StillFormat {
    /// PNG: lossless, with transparency.
    Png,
    /// JPEG of high quality, 8 bits per channel. Uncovered pixels are black.
    Jpeg,
}

impl StillFormat {
    /// Returns whether the format is lossless. A lossless format also supports an alpha channel and 16 bits per
    /// channel.
    pub fn is_lossless(self) -> bool {
        self == Self::Png
    }

    /// Returns the format for a file name's suffix in lower case. `None` for an unknown suffix.
    pub fn of_suffix(suffix: &str) -> Option<Self> {
        match suffix {
            "png" => Some(Self::Png),
            "jpg" | "jpeg" => Some(Self::Jpeg),
            _ => None,
        }
    }
}

/// JPEG quality on the scale from 1 to 100. At lower quality, block artefacts show at edges. At higher quality, files
/// grow without a visible gain.
const JPEG_QUALITY: u8 = 95;

/// Writes a quantized image as an image file. A missing folder is created.
///
/// # Errors
/// If the file can't be written. For JPEG, also if the image has alpha, 16 bits per channel or a side of more than
/// 65535 pixels.
pub fn write_still(
    path: &Path,
    picture: &Quantized,
    format: StillFormat,
) -> Result<(), ImageFileError> {
    let bytes = encode(picture, format).map_err(|e| image_error(path, e))?;
    write_atomically(path, &bytes)
        .map_err(|source| ImageFileError::Write { path: path.to_owned(), source })
}

/// Writes an image of 1 or 3 channels as PNG. A missing folder is created.
///
/// `coverage` has one value per pixel, row by row. If it is given, an alpha channel is added. Pixels with `false` are
/// black with alpha 0, and all others are opaque.
pub fn write_image(
    path: &Path,
    image: &Image,
    coverage: Option<&[bool]>,
    depth: BitDepth,
) -> Result<(), ImageFileError> {
    write_still(path, &Quantized::new(image, coverage, depth), StillFormat::Png)
}

/// Effort of the WebP encoder: method 0 to 6, and quality 0 to 100. With a larger effort, files are at most 10 %
/// smaller, and encoding takes up to a hundred times as long.
const WEBP_EFFORT: (i32, f32) = (1, 20.0);

/// Writes a grey or RGB image as lossless WebP with 8 bits per channel. A missing folder is created.
///
/// The file has 0.5 to 0.65 times the size of the PNG file from [`write_image`]. It is an error if a side of the image
/// has more than 16,383 pixels.
pub(crate) fn write_webp(path: &Path, image: &Image) -> Result<(), ImageFileError> {
    let failed = |reason: &str| image_error(path, reason);
    let quantized = Quantized::new(&image.to_rgb(), None, BitDepth::Eight);
    let Samples::Eight(raw) = &quantized.samples else {
        return Err(failed("has no 8-bit samples"));
    };
    let mut config = webp::WebPConfig::new().map_err(|()| failed("the WebP encoder is missing"))?;
    (config.lossless, config.method, config.quality) = (1, WEBP_EFFORT.0, WEBP_EFFORT.1);
    let encoder = webp::Encoder::from_rgb(raw, image.width() as u32, image.height() as u32);
    let bytes = encoder.encode_advanced(&config).map_err(|e| failed(&format!("{e:?}")))?;
    write_atomically(path, &bytes)
        .map_err(|source| ImageFileError::Write { path: path.to_owned(), source })
}

/// Encodes a grey or RGB image as PNG with 8 bits per channel, at the given compression level.
pub(crate) fn encode_png_8(
    image: &Image,
    compression: CompressionType,
) -> image::ImageResult<Vec<u8>> {
    let raw: Vec<u8> = image.data().iter().map(|v| (v * 255.0 + 0.5) as u8).collect();
    let color = if image.channels() == 1 { ExtendedColorType::L8 } else { ExtendedColorType::Rgb8 };
    let mut bytes = Vec::with_capacity(raw.len());
    PngEncoder::new_with_quality(&mut bytes, compression, FilterType::Adaptive).write_image(
        &raw,
        image.width() as u32,
        image.height() as u32,
        color,
    )?;
    Ok(bytes)
}

/// Encodes an image as the bytes of a PNG file, with the coverage mask as alpha like [`write_image`].
pub(crate) fn encode_png(
    image: &Image,
    coverage: Option<&[bool]>,
    depth: BitDepth,
) -> image::ImageResult<Vec<u8>> {
    encode(&Quantized::new(image, coverage, depth), StillFormat::Png)
}

fn encode(picture: &Quantized, format: StillFormat) -> image::ImageResult<Vec<u8>> {
    use ExtendedColorType::{L8, L16, La8, La16, Rgb8, Rgb16, Rgba8, Rgba16};
    let (width, height) = (picture.width as u32, picture.height as u32);
    let (colors, deep) = ([L8, La8, Rgb8, Rgba8], [L16, La16, Rgb16, Rgba16]);
    let words: Vec<u8>;
    let (bytes, colors) = match &picture.samples {
        Samples::Eight(raw) => (raw, colors),
        Samples::Sixteen(raw) => {
            words = raw.iter().flat_map(|v| v.to_ne_bytes()).collect();
            (&words, deep)
        }
    };
    let color = colors[picture.channels - 1];
    let mut file = Vec::new();
    match format {
        StillFormat::Png => PngEncoder::new(&mut file).write_image(bytes, width, height, color)?,
        StillFormat::Jpeg => JpegEncoder::new_with_quality(&mut file, JPEG_QUALITY)
            .write_image(bytes, width, height, color)?,
    }
    Ok(file)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn webp_keeps_every_sample() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("new/a.webp");
        for channels in [1, 3] {
            let image = gradient(channels);
            write_webp(&path, &image).unwrap();
            let decoded = webp::Decoder::new(&std::fs::read(&path).unwrap()).decode().unwrap();
            let quantized = Quantized::new(&image.to_rgb(), None, BitDepth::Eight);
            assert_eq!(Samples::Eight(decoded.to_vec()), quantized.samples);
        }
        let wide = Image::filled(1 << 14, 1, 1, 0.5);
        assert!(write_webp(&path, &wide).unwrap_err().to_string().contains("a.webp"));
    }

    fn gradient(channels: usize) -> Image {
        let data = (0..6 * 5 * channels).map(|k| k as f32 / (6 * 5 * channels) as f32).collect();
        Image::from_data(6, 5, channels, data)
    }

    #[test]
    fn round_trips_in_every_kind() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("sub/a.png");
        for channels in [1, 3] {
            for (depth, step) in
                [(BitDepth::Eight, 1.0 / 255.0), (BitDepth::Sixteen, 1.0 / 65535.0)]
            {
                let image = gradient(channels);
                write_image(&path, &image, None, depth).unwrap();
                let (back, back_depth) = read_image(&path).unwrap();
                assert_eq!((back.channels(), back_depth), (channels, depth));
                let worst = image.data().iter().zip(back.data()).map(|(a, b)| (a - b).abs());
                assert!(worst.fold(0.0, f32::max) <= 0.5001 * step);
            }
        }
        assert_eq!(std::fs::read_dir(folder.path().join("sub")).unwrap().count(), 1);
    }

    #[test]
    fn uncovered_pixels_are_transparent_black() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.png");
        let coverage: Vec<bool> = (0..30).map(|k| k != 7).collect();
        write_image(&path, &gradient(3), Some(&coverage), BitDepth::Eight).unwrap();
        let back = image::open(&path).unwrap().into_rgba8();
        assert_eq!(back.get_pixel(1, 1).0, [0; 4]);
        assert_eq!(back.get_pixel(2, 1).0[3], 255);
    }

    #[test]
    fn jpeg_shows_the_image_and_black_where_nothing_is_covered() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.jpg");
        let coverage: Vec<bool> = (0..32 * 16).map(|k| k % 32 < 16).collect();
        for channels in [1, 3] {
            let image = Image::filled(32, 16, channels, 0.6);
            let mut picture = Quantized::blank([32, 16], channels, BitDepth::Eight);
            picture.place(&image, Some(&coverage), [0, 0]);
            write_still(&path, &picture, StillFormat::Jpeg).unwrap();
            let (back, depth) = read_image(&path).unwrap();
            assert_eq!((back.channels(), depth), (channels, BitDepth::Eight));
            assert!((back.pixel(3, 3)[0] - 0.6).abs() < 0.01 && back.pixel(28, 3)[0] < 0.01);
        }
    }

    #[test]
    fn files_that_are_no_image_give_one_sentence() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.png");
        std::fs::write(&path, b"not a picture").unwrap();
        assert!(read_image(&path).unwrap_err().to_string().contains("a.png"));
        assert!(read_image(&folder.path().join("none.png")).is_err());
    }

    #[test]
    fn a_pnm_file_of_comments_is_refused_unread() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.ppm");
        let file = |comment: usize| {
            let comment = "x".repeat(comment);
            let start = std::time::Instant::now();
            std::fs::write(&path, format!("P6 2\n# {comment}\n 1 255 abcdef")).unwrap();
            let read = read_header(&path).map(|header| (header.width, header.height));
            assert!(start.elapsed() < std::time::Duration::from_secs(1));
            read
        };
        for short in [0, 1000, 4000] {
            assert_eq!(file(short).unwrap(), (2, 1));
        }
        for long in [MAX_PNM_HEADER, 20 << 20] {
            let message = file(long).err().unwrap().to_string();
            assert!(message.ends_with("has a header of more than 4096 bytes"), "{message}");
        }
        std::fs::write(&path, ["P6 64 32 255 ".as_bytes(), &[b'#'; 3 * 64 * 32]].concat()).unwrap();
        assert_eq!(read_image(&path).unwrap().0.width(), 64);
    }
}
