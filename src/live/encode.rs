//! Encodes rendered pictures as PNG files, and assigns colours to cameras.

use crate::lumigraph::Rendered;
use crate::raster::{BitDepth, encode_png, encode_png_8};
use image::codecs::png::CompressionType;

/// Grey value of pixels that no camera sees, from 0 to 1.
const UNKNOWN: f32 = 0.11;

/// Encodes a view as an 8-bit PNG with the fastest compression. Pixels that no camera sees become dark grey.
///
/// PNG is used because its encoding takes an eighth of the time of JPEG (`cargo bench --bench view`). The error is a
/// sentence with the reason.
pub(super) fn encode(view: &Rendered) -> Result<Vec<u8>, String> {
    let mut image = view.image.to_rgb();
    let pixels = image.data_mut().chunks_exact_mut(3);
    for (pixel, _) in pixels.zip(&view.coverage).filter(|(_, covered)| !**covered) {
        pixel.fill(UNKNOWN);
    }
    encode_png_8(&image, CompressionType::Fast).map_err(failed)
}

fn failed(error: image::ImageError) -> String {
    format!("the picture can't be encoded ({error})")
}

/// Encodes a view as the PNG file that `stlfr render` writes: pixels that no camera sees are transparent.
pub(super) fn encode_saved(view: &Rendered, depth: BitDepth) -> Result<Vec<u8>, String> {
    let coverage = Some(view.coverage.as_slice()).filter(|c| c.contains(&false));
    encode_png(&view.image, coverage, depth).map_err(failed)
}

/// Colours that stand for the cameras in pictures of blending weights: RGB from 0 to 1, by camera index. Neighbouring
/// cameras have clearly different colours.
pub(super) struct Colors(Vec<[f32; 3]>);

/// Difference in hue between the colours of successive cameras, as a fraction of the colour circle. It is the smaller
/// part of the golden section, so that no two cameras have the same hue.
const HUE_STEP: f64 = 0.381_966;
/// Hue of the leftmost camera's colour, as a fraction of the colour circle.
const FIRST_HUE: f64 = 0.58;
/// Lightness of the cameras' colours, from 0 to 1. Successive cameras take the three values in turn.
const LIGHTNESS: [f64; 3] = [0.5, 0.66, 0.38];

impl Colors {
    /// Assigns colours to cameras, in order from left to right. `places` are the cameras' positions in the rig's axes
    /// (right, up, ahead).
    pub fn of(places: &[[f64; 3]]) -> Self {
        let mut order: Vec<usize> = (0..places.len()).collect();
        order.sort_by(|&a, &b| {
            places[a][0].total_cmp(&places[b][0]).then(places[a][1].total_cmp(&places[b][1]))
        });
        let mut colors = vec![[0.0; 3]; places.len()];
        for (rank, camera) in order.into_iter().enumerate() {
            let hue = (FIRST_HUE + HUE_STEP * rank as f64).fract();
            colors[camera] = vivid(hue, LIGHTNESS[rank % LIGHTNESS.len()]);
        }
        Self(colors)
    }

    pub fn rgb(&self) -> &[[f32; 3]] {
        &self.0
    }

    /// Returns a camera's colour as the text `#rrggbb`.
    pub fn hex(&self, camera: usize) -> String {
        let [r, g, b] = self.0[camera].map(|v| (v * 255.0).round() as u8);
        format!("#{r:02x}{g:02x}{b:02x}")
    }
}

/// Saturation of the cameras' colours, from 0 to 1.
const SATURATION: f64 = 0.75;

/// Converts a hue and a lightness, each from 0 to 1, to RGB from 0 to 1. The saturation is [`SATURATION`].
fn vivid(hue: f64, lightness: f64) -> [f32; 3] {
    let chroma = SATURATION * (1.0 - (2.0 * lightness - 1.0).abs());
    [0.0, 2.0 / 3.0, 1.0 / 3.0].map(|shift| {
        let wave = (6.0 * (hue + shift).fract() - 3.0).abs() - 1.0;
        (lightness + chroma * (wave.clamp(0.0, 1.0) - 0.5)) as f32
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::raster::Image;

    #[test]
    fn what_no_camera_sees_is_gray_and_the_rest_is_the_view() {
        let data = (0..32 * 16).flat_map(|k| [k as f32 / 512.0, 0.5, 0.0]).collect();
        let image = Image::from_data(32, 16, 3, data);
        let coverage = (0..32 * 16).map(|k| k % 32 != 5).collect();
        let view = Rendered { image, coverage };
        let back = image::load_from_memory(&encode(&view).unwrap()).unwrap().into_rgb8();
        assert_eq!(back.dimensions(), (32, 16));
        assert_eq!(back.get_pixel(5, 3).0, [28; 3]);
        assert_eq!(back.get_pixel(6, 0).0, [3, 128, 0]);
        let bytes = encode_saved(&view, BitDepth::Eight).unwrap();
        let back = image::load_from_memory(&bytes).unwrap().into_rgba8();
        assert_eq!(back.get_pixel(5, 3).0, [0; 4]);
    }

    #[test]
    fn colors_differ_in_lines_and_grids() {
        let line: Vec<[f64; 3]> = (0..9).map(|k| [0.1 * f64::from(k), 1e-7, 0.0]).collect();
        let grid: Vec<[f64; 3]> =
            (0..12).map(|k| [f64::from(k % 4), f64::from(k / 4), 0.0]).collect();
        for places in [line, grid] {
            let colors = Colors::of(&places);
            for (k, a) in colors.rgb().iter().enumerate() {
                for b in &colors.rgb()[..k] {
                    let distance: f32 = a.iter().zip(b).map(|(a, b)| (a - b).abs()).sum();
                    assert!(distance > 0.15, "{a:?} {b:?}");
                }
                assert!(a.iter().all(|v| (0.0..=1.0).contains(v)));
            }
            assert!(colors.hex(0).len() == 7 && colors.hex(0).starts_with('#'));
        }
    }
}
