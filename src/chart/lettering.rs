//! Words on pictures: Noto Sans Mono, rasterized in advance (`noto-sans-mono-bitmap`: no font
//! file, the same bytes everywhere).

use crate::raster::Image;
use noto_sans_mono_bitmap::{FontWeight, RasterHeight, get_raster, get_raster_width};

/// Height of a line of text, pixels: 16 of the letters, 2 between lines.
pub(crate) const LINE_PX: usize = 18;

/// How a line looks.
#[derive(Clone, Copy)]
pub(crate) enum Weight {
    Regular,
    Bold,
}

impl Weight {
    fn font(self) -> FontWeight {
        match self {
            Self::Regular => FontWeight::Regular,
            Self::Bold => FontWeight::Bold,
        }
    }
}

/// Width of a line, pixels.
pub(crate) fn width_px(text: &str) -> usize {
    text.chars().count() * get_raster_width(FontWeight::Regular, RasterHeight::Size16)
}

/// Writes a line into an RGB image with its top left corner at (x, y) and at most `room_px` wide;
/// what doesn't fit is cut off with an ellipsis, and a letter that the font lacks is a `?`.
pub(crate) fn write(
    image: &mut Image,
    (x, y): (usize, usize),
    room_px: usize,
    text: &str,
    weight: Weight,
    color: [f32; 3],
) {
    letters(room_px, text, weight, |along, down, ink| {
        blend(image, x + along, y + down, ink, color)
    });
}

/// Calls `put` with the place of every pixel of a line, from its top left corner, and how much ink
/// it has.
pub(crate) fn letters(
    room_px: usize,
    text: &str,
    weight: Weight,
    mut put: impl FnMut(usize, usize, f32),
) {
    let advance = get_raster_width(FontWeight::Regular, RasterHeight::Size16);
    let fits = room_px / advance;
    let letters: Vec<char> = if text.chars().count() <= fits {
        text.chars().collect()
    } else {
        text.chars().take(fits.saturating_sub(2)).chain("..".chars().take(fits)).collect()
    };
    for (k, letter) in letters.into_iter().enumerate() {
        // The font has no minus sign.
        let letter = if letter == '−' { '-' } else { letter };
        let raster = get_raster(letter, weight.font(), RasterHeight::Size16)
            .or_else(|| get_raster('?', weight.font(), RasterHeight::Size16));
        let Some(raster) = raster else { continue };
        for (dy, row) in raster.rows().enumerate() {
            for (dx, ink) in row.iter().enumerate() {
                put(k * advance + dx, dy, f32::from(*ink) / 255.0);
            }
        }
    }
}

/// Mixes ink into one pixel of an RGB image; nothing outside of it.
pub(crate) fn blend(image: &mut Image, x: usize, y: usize, ink: f32, color: [f32; 3]) {
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
        write(&mut image, (2, 1), room_px, text, Weight::Regular, [1.0; 3]);
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
        write(&mut image, (1, 1), 100, "beyond", Weight::Bold, [1.0; 3]);
    }
}
