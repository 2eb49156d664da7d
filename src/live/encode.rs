//! Pictures as files, and the colours that stand for cameras.

use crate::lumigraph::Rendered;
use crate::raster::{BitDepth, Image, Samples, encode_png, quantize};
use image::ExtendedColorType::Rgb8;
use image::ImageEncoder;
use image::codecs::jpeg::JpegEncoder;
use image::codecs::png::{CompressionType, FilterType, PngEncoder};

/// Quality of the pictures while something changes, of 100. More: they take longer to encode and to draw; less:
/// blocks are seen.
const JPEG_QUALITY: u8 = 85;
/// What nothing is known of, grey of 0 to 1: unlike black, which may be of the scene. Lighter: it dazzles; darker:
/// it may be of the scene.
const UNKNOWN: f32 = 0.11;

/// A picture's file format.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FileKind {
    Jpeg,
    Png,
}

impl FileKind {
    pub fn media_type(self) -> &'static str {
        match self {
            Self::Jpeg => "image/jpeg",
            Self::Png => "image/png",
        }
    }
}

/// A view to be looked at: what no camera sees is dark grey. The error is a reason.
pub(super) fn encode(view: &Rendered, kind: FileKind) -> Result<(Vec<u8>, FileKind), String> {
    let image = filled(view);
    let (width, height) = (image.width() as u32, image.height() as u32);
    let (_, Samples::Eight(samples)) = quantize(&image, None, BitDepth::Eight) else {
        return Err("a picture has 8 bits".into());
    };
    let mut bytes = Vec::with_capacity(samples.len() / 4);
    match kind {
        FileKind::Jpeg => JpegEncoder::new_with_quality(&mut bytes, JPEG_QUALITY)
            .write_image(&samples, width, height, Rgb8),
        FileKind::Png => {
            PngEncoder::new_with_quality(&mut bytes, CompressionType::Fast, FilterType::Up)
                .write_image(&samples, width, height, Rgb8)
        }
    }
    .map_err(|error| format!("the picture can't be encoded ({error})"))?;
    Ok((bytes, kind))
}

/// A view as `stlfr render` writes it.
pub(super) fn encode_saved(
    view: &Rendered,
    depth: BitDepth,
) -> Result<(Vec<u8>, FileKind), String> {
    let coverage = Some(view.coverage.as_slice()).filter(|c| c.contains(&false));
    let bytes = encode_png(&view.image, coverage, depth);
    let failed = |error| format!("the picture can't be encoded ({error})");
    Ok((bytes.map_err(failed)?, FileKind::Png))
}

fn filled(view: &Rendered) -> Image {
    let mut image = view.image.to_rgb();
    let pixels = image.data_mut().chunks_exact_mut(3);
    for (pixel, _) in pixels.zip(&view.coverage).filter(|(_, covered)| !**covered) {
        pixel.fill(UNKNOWN);
    }
    image
}

/// A colour for each camera: neighbours' differ.
pub(super) struct Colors(Vec<[f32; 3]>);

/// Turn of the hue from one camera to the next: the golden angle, which never comes near an earlier one soon. Any
/// other: after some cameras, colours come again.
const HUE_STEP: f32 = 0.381_966;

impl Colors {
    pub fn of(cameras: usize) -> Self {
        Self((0..cameras).map(|k| vivid((0.58 + k as f32 * HUE_STEP).fract())).collect())
    }

    pub fn rgb(&self) -> &[[f32; 3]] {
        &self.0
    }

    /// `#rrggbb`.
    pub fn hex(&self, camera: usize) -> String {
        let [r, g, b] = self.0[camera].map(|v| (v * 255.0).round() as u8);
        format!("#{r:02x}{g:02x}{b:02x}")
    }
}

/// A colour of a hue from 0 to 1, neither pale nor dark.
fn vivid(hue: f32) -> [f32; 3] {
    [0.0, 2.0 / 3.0, 1.0 / 3.0].map(|shift| {
        let wave = (6.0 * (hue + shift).fract() - 3.0).abs() - 1.0;
        0.25 + 0.7 * wave.clamp(0.0, 1.0)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_no_camera_sees_is_gray_and_the_rest_is_the_view() {
        let data = (0..32 * 16).flat_map(|k| [k as f32 / 512.0, 0.5, 0.0]).collect();
        let image = Image::from_data(32, 16, 3, data);
        let coverage = (0..32 * 16).map(|k| k % 32 != 5).collect();
        let view = Rendered { image, coverage };
        for kind in [FileKind::Png, FileKind::Jpeg] {
            let (bytes, _) = encode(&view, kind).unwrap();
            let back = image::load_from_memory(&bytes).unwrap().into_rgb8();
            assert_eq!(back.dimensions(), (32, 16));
            if kind == FileKind::Png {
                assert_eq!(back.get_pixel(5, 3).0, [28; 3]);
                assert_eq!(back.get_pixel(6, 0).0, [3, 128, 0]);
            }
        }
        let (bytes, _) = encode_saved(&view, BitDepth::Eight).unwrap();
        let back = image::load_from_memory(&bytes).unwrap().into_rgba8();
        assert_eq!(back.get_pixel(5, 3).0, [0; 4]);
    }

    #[test]
    fn colors_differ() {
        let colors = Colors::of(9);
        for (k, a) in colors.rgb().iter().enumerate() {
            for b in &colors.rgb()[..k] {
                let distance: f32 = a.iter().zip(b).map(|(a, b)| (a - b).abs()).sum();
                assert!(distance > 0.2, "{a:?} {b:?}");
            }
        }
        assert!(colors.hex(0).len() == 7 && colors.hex(0).starts_with('#'));
    }
}
