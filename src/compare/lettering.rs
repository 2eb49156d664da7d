//! Text in images, in the font Noto Sans Mono. The glyphs were rasterized in advance (`noto-sans-mono-bitmap`).
//! Therefore no font file is needed, and the result is the same on every machine.

use crate::raster::Image;
use noto_sans_mono_bitmap::{FontWeight, RasterHeight, get_raster, get_raster_width};

/// Height of a line of text, pixels: 16 for the glyphs, and 2 between lines.
pub const LINE_PX: usize = 18;

/// Style of a line of text.
#[derive(Clone, Copy)]
pub struct TextStyle {
    /// True for bold letters, false for regular letters.
    pub bold: bool,
    /// Text colour: red, green and blue, each from 0 to 1.
    pub color: [f32; 3],
}

/// Returns the horizontal advance of every glyph, pixels.
fn advance_px() -> usize {
    get_raster_width(FontWeight::Regular, RasterHeight::Size16)
}

/// Returns the width of a line of text, pixels.
pub fn width_px(text: &str) -> usize {
    text.chars().count() * advance_px()
}

/// Draws a line of text into an RGB image. The text's top left corner is at the pixel (x, y). The text is at most
/// `room_px` pixels wide.
///
/// A longer line is cut off and ends with two dots. A character that the font lacks is drawn as `?`. Pixels outside of
/// the image are skipped.
pub fn write(
    image: &mut Image,
    (x, y): (usize, usize),
    room_px: usize,
    text: &str,
    style: TextStyle,
) {
    let font = if style.bold { FontWeight::Bold } else { FontWeight::Regular };
    for (k, letter) in fitted(text, room_px / advance_px()).into_iter().enumerate() {
        // The font lacks the minus sign.
        let letter = if letter == '−' { '-' } else { letter };
        let [raster, unknown] = [letter, '?'].map(|c| get_raster(c, font, RasterHeight::Size16));
        let Some(raster) = raster.or(unknown) else { continue };
        let left = x + k * advance_px();
        for (dy, row) in raster.rows().enumerate().take(image.height().saturating_sub(y)) {
            for (dx, ink) in row.iter().enumerate().take(image.width().saturating_sub(left)) {
                let at = ((y + dy) * image.width() + left + dx) * 3;
                for (v, c) in image.data_mut()[at..at + 3].iter_mut().zip(style.color) {
                    *v += (c - *v) * (f32::from(*ink) / 255.0);
                }
            }
        }
    }
}

/// Returns the characters of a text. If there are more than `max`, the text is cut off and ends with two dots.
fn fitted(text: &str, max: usize) -> Vec<char> {
    if text.chars().count() <= max {
        return text.chars().collect();
    }
    text.chars().take(max.saturating_sub(2)).chain("..".chars().take(max)).collect()
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
