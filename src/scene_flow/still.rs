//! Static background of a camera (a background model), computed from frames of the camera's whole recording. A pixel
//! has a static background if at least a third of the frames show one colour there. Where a frame shows another colour,
//! a moving body is in front of the background.

use crate::raster::Image;
use rayon::prelude::*;

/// Maximum difference in each channel between two colours that count as equal, in steps of 1/255.
const TOLERANCE: u8 = 10;
/// Minimum fraction of the frames that show the background colour of a pixel. If the fraction were larger, a background
/// that is hidden for most of the recording would stay unknown. If it were smaller, a textureless body that passes
/// slowly would count as background.
const MIN_SUPPORT: f64 = 1.0 / 3.0;
/// Minimum number of moving pixels in the 3×3 neighbourhood of a moving pixel, the pixel included. If there are fewer,
/// the difference from the background is noise, and the pixel counts as background.
const MIN_MOVING: usize = 3;

/// Colour with 8 bits per channel: red, green, blue.
type Rgb8 = [u8; 3];

/// Static background of a camera: one colour for each pixel of its image, row by row.
pub struct StillImage {
    width: usize,
    /// Background colour of each pixel; `None` if less than a third of the frames show one colour there.
    colors: Vec<Option<Rgb8>>,
}

/// Image with 8 bits per channel, compact since many images are compared at once.
pub struct CompactImage {
    width: usize,
    pixels: Vec<Rgb8>,
}

impl CompactImage {
    pub fn new(image: &Image) -> Self {
        let rgb = image.to_rgb();
        let level = |v: f32| (255.0 * v).round() as u8; // saturates
        let pixels = rgb.data().chunks_exact(3).map(|p| [p[0], p[1], p[2]].map(level)).collect();
        Self { width: image.width(), pixels }
    }
}

fn is_equal(a: Rgb8, b: Rgb8) -> bool {
    (0..3).all(|c| a[c].abs_diff(b[c]) <= TOLERANCE)
}

impl StillImage {
    /// Computes the static background from frames of one camera, spread over its recording. With fewer than three
    /// frames, no pixel has a background.
    pub fn new(frames: &[CompactImage]) -> Self {
        let width = frames.first().map_or(0, |f| f.width);
        let pixels = frames.first().map_or(0, |f| f.pixels.len());
        let needed = ((MIN_SUPPORT * frames.len() as f64).ceil() as usize).max(2);
        let color = |k: usize| {
            let support = |of: Rgb8| frames.iter().filter(|f| is_equal(f.pixels[k], of)).count();
            let mut best: Option<(usize, Rgb8)> = None;
            for frame in frames {
                let of = frame.pixels[k];
                let count = support(of);
                if count >= needed && best.is_none_or(|(most, _)| count > most) {
                    best = Some((count, of));
                }
                if 2 * count > frames.len() {
                    break; // no other colour has more
                }
            }
            best.map(|(_, color)| color)
        };
        let is_enough = frames.len() > 2;
        let color = |k: usize| if is_enough { color(k) } else { None };
        Self { width, colors: (0..pixels).into_par_iter().map(color).collect() }
    }

    /// Returns whether no pixel has a known background.
    pub fn is_empty(&self) -> bool {
        self.colors.iter().all(Option::is_none)
    }

    /// Returns the number of pixels of the image.
    pub fn pixels(&self) -> usize {
        self.colors.len()
    }

    /// Returns, for each pixel of a frame, whether it shows static background. A pixel with unknown background counts
    /// as a moving body. A moving pixel with fewer than two moving neighbours counts as background. The mask of a
    /// moving body is not dilated by the pixels beside it. These may mix the colours of body and background, but as
    /// part of the mask they would widen the body's outline.
    pub fn shown_in(&self, frame: &CompactImage) -> Vec<bool> {
        let moving: Vec<bool> = self
            .colors
            .iter()
            .zip(&frame.pixels)
            .map(|(still, own)| still.is_none_or(|still| !is_equal(still, *own)))
            .collect();
        let is_noise = |k: usize| self.moving_around(&moving, k) < MIN_MOVING;
        (0..moving.len()).map(|k| !moving[k] || is_noise(k)).collect()
    }

    /// Returns the number of moving pixels in the 3×3 neighbourhood of pixel `k`, the pixel included.
    fn moving_around(&self, moving: &[bool], k: usize) -> usize {
        let (width, height) = (self.width, moving.len() / self.width);
        let (x, y) = (k % width, k / width);
        let rows = y.saturating_sub(1)..(y + 2).min(height);
        let columns = x.saturating_sub(1)..(x + 2).min(width);
        rows.map(|v| columns.clone().filter(|u| moving[v * width + u]).count()).sum()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns frames of a wall with noise-free stripes, in front of which a bright square moves by 4 pixels per frame.
    fn frames(count: usize) -> Vec<CompactImage> {
        let value = |frame: usize, k: usize| {
            let (x, y) = (k % 40, k / 40);
            let is_body = (4 * frame..4 * frame + 6).contains(&x) && (5..12).contains(&y);
            if is_body { 0.9 } else { 0.2 + 0.05 * (x % 3) as f32 }
        };
        let image = |frame: usize| {
            let data = (0..40 * 20).flat_map(|k| [value(frame, k); 3]).collect();
            CompactImage::new(&Image::from_data(40, 20, 3, data))
        };
        (0..count).map(image).collect()
    }

    #[test]
    fn a_body_that_passes_is_not_still_and_what_it_hides_is_known_from_other_frames() {
        let frames = frames(7);
        let still = StillImage::new(&frames);
        assert!(still.colors.iter().all(|c| c.is_some_and(|[r, _, _]| r < 100)));
        let shown = still.shown_in(&frames[2]);
        let at = |x: usize, y: usize| shown[y * 40 + x];
        // The body in frame 2 covers the columns 8 to 13.
        assert!(!at(8, 8) && !at(13, 5) && !at(8, 5) && !at(13, 11));
        assert!(at(7, 8) && at(14, 8) && at(20, 8) && at(10, 2) && at(10, 14));
    }

    #[test]
    fn in_two_frames_nothing_is_known_to_stand_still() {
        let frames = frames(2);
        let still = StillImage::new(&frames);
        assert!(still.shown_in(&frames[0]).iter().all(|s| !s));
    }
}
