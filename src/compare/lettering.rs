//! Text in images: Noto Sans Mono, rasterized in advance (`noto-sans-mono-bitmap`: no font file, the
//! same bytes everywhere).

use crate::raster::Image;
use noto_sans_mono_bitmap::{FontWeight, RasterHeight, get_raster, get_raster_width};

/// Height of a line of text, pixels: 16 of the letters, 2 between lines.
pub const LINE_PX: usize = 18;

/// Look of a line.
#[derive(Clone, Copy)]
pub struct TextStyle {
    /// Bold or regular letters.
    pub bold: bool,
    /// Red, green and blue, 0 to 1.
    pub color: [f32; 3],
}

impl TextStyle {
    fn font(self) -> FontWeight {
        if self.bold { FontWeight::Bold } else { FontWeight::Regular }
    }
}

/// Advance of every letter, pixels.
fn advance_px() -> usize {
    get_raster_width(FontWeight::Regular, RasterHeight::Size16)
}

/// Width of a line, pixels.
pub fn width_px(text: &str) -> usize {
    text.chars().count() * advance_px()
}

/// Writes a line into an RGB image with its top left corner at the pixel (x, y), at most `room_px`
/// wide.
///
/// A line that doesn't fit is cut off with an ellipsis, a letter that the font lacks is a `?`, and
/// pixels outside of the image are skipped.
pub fn write(
    image: &mut Image,
    (x, y): (usize, usize),
    room_px: usize,
    text: &str,
    style: TextStyle,
) {
    for (k, letter) in fitted(text, room_px / advance_px()).into_iter().enumerate() {
        // The font has no minus sign.
        let letter = if letter == '−' { '-' } else { letter };
        let raster = get_raster(letter, style.font(), RasterHeight::Size16)
            .or_else(|| get_raster('?', style.font(), RasterHeight::Size16));
        let Some(raster) = raster else { continue };
        let left = x + k * advance_px();
        for (dy, row) in raster.rows().enumerate() {
            for (dx, ink) in row.iter().enumerate() {
                blend(image, (left + dx, y + dy), f32::from(*ink) / 255.0, style.color);
            }
        }
    }
}

/// The letters of a text, the end replaced by an ellipsis where there are more than `max`.
fn fitted(text: &str, max: usize) -> Vec<char> {
    if text.chars().count() <= max {
        text.chars().collect()
    } else {
        text.chars().take(max.saturating_sub(2)).chain("..".chars().take(max)).collect()
    }
}

/// Mixes a colour into one pixel of an RGB image, by `ink` of 0 to 1.
fn blend(image: &mut Image, (x, y): (usize, usize), ink: f32, color: [f32; 3]) {
    if x >= image.width() || y >= image.height() {
        return;
    }
    let at = (y * image.width() + x) * 3;
    for (v, c) in image.data_mut()[at..at + 3].iter_mut().zip(color) {
        *v += (c - *v) * ink;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn inked(text: &str, room_px: usize) -> Vec<(usize, usize)> {
        let mut image = Image::filled(64, 20, 3, 0.0);
        write(&mut image, (2, 1), room_px, text, TextStyle { bold: false, color: [1.0; 3] });
        (0..64 * 20).filter(|k| image.data()[3 * k] > 0.0).map(|k| (k % 64, k / 64)).collect()
    }

    #[test]
    fn letters_leave_ink_within_their_room() {
        let ink = inked("Wg×dB", 60);
        assert!(ink.len() > 50);
        assert!(ink.iter().all(|(x, y)| *x >= 2 && *x < 62 && *y >= 1 && *y < 17));
        assert!(inked("a long line that can't fit", 30).iter().all(|(x, _)| *x < 32));
    }

    #[test]
    fn nothing_panics_without_room_or_outside_of_the_font() {
        assert!(inked("abc", 0).is_empty());
        assert!(!inked("漢", 40).is_empty());
        let mut image = Image::filled(3, 3, 3, 0.0);
        write(&mut image, (1, 1), 100, "beyond", TextStyle { bold: true, color: [1.0; 3] });
    }
}
