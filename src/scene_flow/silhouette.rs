//! Silhouettes: the pixels of a frame that certainly show a moving body, and those that certainly show the static
//! background. A point of a body is nowhere where another frame shows the background (Laurentini 1994, *The Visual Hull
//! Concept for Silhouette-Based Image Understanding*).

use super::still::{CompactImage, Rgb8, StillImage};
use crate::raster::Image;

/// Minimum difference of a body's outermost pixels from the background, as a fraction of the largest difference in their
/// 3×3 neighbourhood. If the difference is smaller, the pixel probably shows more of the background than of the body.
/// Smaller: bodies carry a fringe of the background along. Larger: thin bodies become thinner.
const MIN_CONTRAST: f32 = 0.6;

/// What a pixel shows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Shown {
    Background,
    Body,
    Unknown,
}

impl StillImage {
    /// Compares an image of the camera, without lens distortion, with the static background. Returns what each pixel shows,
    /// row by row. A pixel with the background's colour shows background, and one that differs by more than noise explains
    /// shows a body. Unknown is what other pixels show, those whose background is unknown, and those at outlines that mix
    /// body and background.
    pub fn silhouettes(&self, image: &Image) -> Vec<Shown> {
        let image = CompactImage::new(image);
        let is_background = self.shown_in(&image, self.tolerance);
        let difference = |k: usize| match self.colors[k] {
            Some(color) if !is_background[k] => largest_difference(color, image.pixels[k]),
            _ => 0,
        };
        let differences: Vec<u8> = (0..is_background.len()).map(difference).collect();
        let is_mixed = |k: usize| {
            let (mut is_outermost, mut largest) = (false, 0);
            self.around(k).for_each(|n| {
                is_outermost |= is_background[n];
                largest = differences[n].max(largest);
            });
            is_outermost && f32::from(differences[k]) < MIN_CONTRAST * f32::from(largest)
        };
        let shown = |k: usize| match self.colors[k] {
            None => Shown::Unknown,
            Some(_) if is_background[k] => Shown::Background,
            Some(_) if differences[k] <= self.noise || is_mixed(k) => Shown::Unknown,
            Some(_) => Shown::Body,
        };
        (0..is_background.len()).map(shown).collect()
    }
}

fn largest_difference(a: Rgb8, b: Rgb8) -> u8 {
    a[0].abs_diff(b[0]).max(a[1].abs_diff(b[1])).max(a[2].abs_diff(b[2]))
}

/// Returns what the pixels of the next coarser pyramid level show: background if all four pixels do, or a body if at least
/// two do. `width` is that of the finer level. An odd last row or column is dropped.
pub fn halved(finer: &[Shown], width: usize) -> Vec<Shown> {
    let (columns, rows) = (width / 2, finer.len() / width.max(1) / 2);
    let shown = |k: usize| {
        let at = 2 * (k / columns) * width + 2 * (k % columns);
        let four = [at, at + 1, at + width, at + width + 1].map(|k| finer[k]);
        let count = |of: Shown| four.iter().filter(|s| **s == of).count();
        match (count(Shown::Body), count(Shown::Background)) {
            (2.., _) => Shown::Body,
            (_, 4) => Shown::Background,
            _ => Shown::Unknown,
        }
    };
    (0..columns * rows).map(shown).collect()
}

#[cfg(test)]
mod tests {
    use super::Shown::{Background, Body, Unknown};
    use super::*;

    #[test]
    fn outermost_pixels_of_a_body_that_are_mostly_background_are_unknown() {
        let [width, height] = [9, 5];
        // Three rows of a body in front of a wall of 100/255: two pixels of it, and two mixed ones.
        let row = [100, 100, 130, 200, 200, 180, 100, 100, 100];
        let value = |k: usize| if (1..4).contains(&(k / width)) { row[k % width] } else { 100 };
        let data = (0..width * height).flat_map(|k| [value(k) as f32 / 255.0; 3]).collect();
        let image = Image::from_data(width, height, 3, data);
        let mut colors = vec![Some([100; 3]); width * height];
        colors[0] = None;
        let still = StillImage { width, colors, tolerance: 3, noise: 0 };
        let shown = still.silhouettes(&image);
        let middle =
            [Background, Background, Unknown, Body, Body, Body, Background, Background, Background];
        assert_eq!(shown[2 * width..3 * width], middle);
        assert_eq!((shown[0], shown[1], shown[4 * width + 4]), (Unknown, Background, Background));
    }

    #[test]
    fn a_difference_that_noise_explains_proves_no_body() {
        let [width, height] = [9, 9];
        let is_body = |k: usize| (2..7).contains(&(k % width)) && (2..7).contains(&(k / width));
        let value = |k: usize| if is_body(k) { 120 } else { 100 };
        let data = (0..width * height).flat_map(|k| [value(k) as f32 / 255.0; 3]).collect();
        let image = Image::from_data(width, height, 3, data);
        let colors = vec![Some([100; 3]); width * height];
        let center = |noise: u8| {
            let still = StillImage { width, colors: colors.clone(), tolerance: 10, noise };
            still.silhouettes(&image)[4 * width + 4]
        };
        assert_eq!([19, 20].map(center), [Body, Unknown]);
    }

    #[test]
    fn coarser_pixels_show_a_body_if_half_of_them_does() {
        let finer = [
            [Background, Background, Background, Body, Unknown],
            [Background, Background, Body, Background, Unknown],
            [Background, Background, Background, Body, Unknown],
            [Background, Unknown, Background, Background, Unknown],
        ];
        let expected = [Background, Body, Unknown, Unknown];
        assert_eq!(halved(&finer.concat(), 5), expected);
        assert!(halved(&[], 0).is_empty());
    }
}
