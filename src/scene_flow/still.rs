//! Static background of a camera (a background model), computed from frames of the camera's whole recording. A pixel
//! has a static background if sufficiently many frames show one colour there. Where a frame shows another colour,
//! a moving body is in front of the background.

use super::grid::neighbors;
use crate::raster::Image;
use rayon::prelude::*;

/// Maximum difference in each channel between the background colour and that of a pixel that shows it, in steps of
/// 1/255. Larger than noise, so that faint shadows on the background count as background.
pub(super) const TOLERANCE: u8 = 10;
/// Minimum tolerance with which frames support a background colour, in steps of 1/255. In frames without noise, a larger
/// one lets textures of a body pass for background where the body is always in front.
const MIN_SUPPORT_TOLERANCE: u8 = 3;
/// Maximum tolerance with which frames support a background colour, in steps of 1/255: that of noise of 2.4 %. Smaller: the
/// background of noisier films stays unknown. Larger: bodies count as background if most of the image moves.
const MAX_SUPPORT_TOLERANCE: u8 = 24;
/// Maximum difference between two frames that noise explains, as a multiple of the median difference. With normally
/// distributed noise, it is 2.7 standard deviations of this difference.
const MAX_NOISE_BY_MEDIAN: usize = 4;
/// Minimum number of moving pixels in the 3×3 neighbourhood of a moving pixel, the pixel included. If there are fewer,
/// the difference from the background is noise, and the pixel counts as background.
const MIN_MOVING: usize = 3;
/// Maximum size of an island, as a fraction of the image's pixels. An island is a region that looks like background, with
/// moving pixels around it. It probably shows the body, in a colour that the background has too. Larger: gaps
/// between limbs count as body. Smaller: bodies have holes.
const MAX_ISLAND: f64 = 5e-4;

/// Colour with 8 bits per channel: red, green, blue.
pub(super) type Rgb8 = [u8; 3];

/// Static background of a camera: one colour for each pixel of its image, row by row.
pub struct StillImage {
    pub(super) width: usize,
    /// Background colour of each pixel; `None` if too few frames show one colour there.
    pub(super) colors: Vec<Option<Rgb8>>,
    /// Maximum difference in each channel between the background's colour and that of a pixel that certainly shows it, in steps
    /// of 1/255.
    pub(super) tolerance: u8,
    /// Maximum difference in each channel between two frames that noise explains, in steps of 1/255. If more than half of all
    /// pixels move, it is large, so that no difference proves a body.
    pub(super) noise: u8,
}

/// Image with 8 bits per channel, compact since many images are compared at once.
pub struct CompactImage {
    width: usize,
    pub(super) pixels: Vec<Rgb8>,
}

impl CompactImage {
    pub fn new(image: &Image) -> Self {
        let rgb = image.to_rgb();
        let level = |v: f32| (255.0 * v).round() as u8; // saturates
        let pixels = rgb.data().chunks_exact(3).map(|p| [p[0], p[1], p[2]].map(level)).collect();
        Self { width: image.width(), pixels }
    }
}

fn is_equal(a: Rgb8, b: Rgb8, tolerance: u8) -> bool {
    (0..3).all(|c| a[c].abs_diff(b[c]) <= tolerance)
}

/// Returns the maximum difference in each channel between two frames that noise explains, in steps of 1/255. It follows from
/// the median difference between successive frames, if at least half of all pixels are static.
fn noise(frames: &[CompactImage]) -> u8 {
    let mut histogram = [0usize; 256];
    for pair in frames.windows(2) {
        for (a, b) in pair[0].pixels.iter().zip(&pair[1].pixels) {
            (0..3).for_each(|c| histogram[usize::from(a[c].abs_diff(b[c]))] += 1);
        }
    }
    let half = histogram.iter().sum::<usize>() / 2;
    let mut up_to = 0;
    let is_median = |count: &usize| {
        up_to += count;
        up_to > half
    };
    let median = histogram.iter().position(is_median).unwrap_or(0);
    (MAX_NOISE_BY_MEDIAN * median).min(u8::MAX.into()) as u8
}

/// Returns the mean colour of pixel `k` of frames; black without frames.
fn mean_color<'a>(frames: impl Iterator<Item = &'a CompactImage>, k: usize) -> Rgb8 {
    let (mut sum, mut count) = ([0usize; 3], 0);
    for frame in frames {
        (0..3).for_each(|c| sum[c] += usize::from(frame.pixels[k][c]));
        count += 1;
    }
    sum.map(|s| ((s + count / 2) / count.max(1)) as u8) // at most 255
}

impl StillImage {
    /// Computes the static background from frames of one camera, spread over its recording. `min_support` is the minimum
    /// fraction of the frames that show the background colour of a pixel. With fewer than three frames, no pixel has a
    /// background.
    pub fn new(frames: &[CompactImage], min_support: f64) -> Self {
        let width = frames.first().map_or(0, |f| f.width);
        let pixels = frames.first().map_or(0, |f| f.pixels.len());
        let needed = ((min_support * frames.len() as f64).ceil() as usize).max(2);
        let noise = noise(frames);
        let support_tolerance = noise.clamp(MIN_SUPPORT_TOLERANCE, MAX_SUPPORT_TOLERANCE);
        let tolerance = support_tolerance.min(TOLERANCE);
        let color = |k: usize| {
            let is_support = |f: &&CompactImage, of| is_equal(f.pixels[k], of, support_tolerance);
            let support = |of: Rgb8| frames.iter().filter(|f| is_support(f, of)).count();
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
            best.map(|(_, color)| mean_color(frames.iter().filter(|f| is_support(f, color)), k))
        };
        let is_enough = frames.len() > 2;
        let color = |k: usize| if is_enough { color(k) } else { None };
        Self { width, colors: (0..pixels).into_par_iter().map(color).collect(), tolerance, noise }
    }

    /// Returns whether no pixel has a known background.
    pub fn is_empty(&self) -> bool {
        self.colors.iter().all(Option::is_none)
    }

    /// Returns the number of pixels of the image.
    pub fn pixels(&self) -> usize {
        self.colors.len()
    }

    /// Returns, for each pixel of a frame, whether it shows static background. `tolerance` is the maximum difference in each
    /// channel between the background's colour and the frame's, in steps of 1/255. A pixel with unknown background counts
    /// as a moving body. A moving pixel with fewer than two moving neighbours counts as background, and an island of
    /// background in a body as body. The mask of a moving body is not dilated by the pixels beside it. These may mix the
    /// colours of body and background, but as part of the mask they would widen the body's outline.
    pub fn shown_in(&self, frame: &CompactImage, tolerance: u8) -> Vec<bool> {
        let moving: Vec<bool> = self
            .colors
            .iter()
            .zip(&frame.pixels)
            .map(|(still, own)| still.is_none_or(|still| !is_equal(still, *own, tolerance)))
            .collect();
        let is_noise = |k: usize| self.moving_around(&moving, k) < MIN_MOVING;
        let mut still: Vec<bool> = (0..moving.len()).map(|k| !moving[k] || is_noise(k)).collect();
        self.remove_islands(&mut still);
        still
    }

    /// Marks the pixels of islands ([`MAX_ISLAND`]) as moving.
    fn remove_islands(&self, still: &mut [bool]) {
        let max = (MAX_ISLAND * still.len() as f64) as usize;
        let mut is_visited = vec![false; still.len()];
        for first in 0..still.len() {
            if is_visited[first] || !still[first] {
                continue;
            }
            is_visited[first] = true;
            let mut region = vec![first];
            let mut next = 0;
            while let Some(&k) = region.get(next) {
                next += 1;
                for n in neighbors(k, self.width, still.len()) {
                    if still[n] && !is_visited[n] {
                        is_visited[n] = true;
                        region.push(n);
                    }
                }
            }
            if region.len() <= max {
                region.iter().for_each(|&k| still[k] = false);
            }
        }
    }

    /// Returns the number of moving pixels in the 3×3 neighbourhood of pixel `k`, the pixel included.
    fn moving_around(&self, moving: &[bool], k: usize) -> usize {
        self.around(k).filter(|&n| moving[n]).count()
    }

    /// Returns the indices of the pixels in the 3×3 neighbourhood of pixel `k`, the pixel included.
    pub(super) fn around(&self, k: usize) -> impl Iterator<Item = usize> {
        let (width, height) = (self.width, self.colors.len() / self.width);
        let (x, y) = (k % width, k / width);
        let columns = x.saturating_sub(1)..(x + 2).min(width);
        let rows = y.saturating_sub(1)..(y + 2).min(height);
        rows.flat_map(move |v| columns.clone().map(move |u| v * width + u))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::Random;

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
        let still = StillImage::new(&frames, 1.0 / 3.0);
        assert!(still.colors.iter().all(|c| c.is_some_and(|[r, _, _]| r < 100)));
        let shown = still.shown_in(&frames[2], TOLERANCE);
        let at = |x: usize, y: usize| shown[y * 40 + x];
        // The body in frame 2 covers the columns 8 to 13.
        assert!(!at(8, 8) && !at(13, 5) && !at(8, 5) && !at(13, 11));
        assert!(at(7, 8) && at(14, 8) && at(20, 8) && at(10, 2) && at(10, 14));
    }

    #[test]
    fn in_two_frames_nothing_is_known_to_stand_still() {
        let frames = frames(2);
        let still = StillImage::new(&frames, 1.0 / 3.0);
        assert!(still.shown_in(&frames[0], TOLERANCE).iter().all(|s| !s));
    }

    /// Returns frames of one grey value each at every pixel but the first, at which the values are `first`.
    fn plain_frames(values: &[u8], first: &[u8]) -> Vec<CompactImage> {
        let frame = |(value, first): (&u8, &u8)| {
            let mut pixels = vec![[*value; 3]; 40 * 40];
            pixels[0] = [*first; 3];
            CompactImage { width: 40, pixels }
        };
        values.iter().zip(first).map(frame).collect()
    }

    #[test]
    fn a_texture_that_passes_is_no_background_unless_noise_is_as_strong() {
        // A dark body is always in front of the first pixel, and its texture is dark in each frame.
        let texture = [10, 16, 22, 28, 34, 40];
        let without_noise = StillImage::new(&plain_frames(&[100; 6], &texture), 1.0 / 3.0);
        assert_eq!((without_noise.colors[0], without_noise.colors[1]), (None, Some([100; 3])));
        let with_noise =
            StillImage::new(&plain_frames(&[100, 102, 100, 102, 100, 102], &texture), 1.0 / 3.0);
        assert!(with_noise.colors[0].is_some() && with_noise.colors[1].is_some());
    }

    #[test]
    fn background_behind_a_passing_body_is_known_despite_noise() {
        // A wall of a single colour with noise of 2 %, before which a body passes in two of nine frames.
        let mut random = Random::new(3);
        let mut frame = |k: usize| {
            let grey = if (3..5).contains(&k) { 200.0 } else { 100.0 };
            let mut noisy = |_| (grey + 0.02 * 255.0 * random.gaussian()).round() as u8;
            let pixels = (0..40 * 40).map(|_| [0; 3].map(&mut noisy)).collect();
            CompactImage { width: 40, pixels }
        };
        let frames: Vec<CompactImage> = (0..9).map(&mut frame).collect();
        let still = StillImage::new(&frames, 0.6);
        let known: Vec<Rgb8> = still.colors.iter().flatten().copied().collect();
        assert!(known.len() > 1550, "{} of 1600", known.len());
        assert!(known.iter().all(|[red, ..]| red.abs_diff(100) < 12));
    }

    #[test]
    fn a_small_island_in_a_body_is_body_and_a_large_gap_is_background() {
        let colors = vec![Some([100; 3]); 100 * 100];
        let still = StillImage { width: 100, colors, tolerance: TOLERANCE, noise: 0 };
        // A body from column 10 to 49, with an island of 2 × 2 pixels and a gap of 4 × 4.
        let is_body = |x: usize, y: usize| {
            let is_island = (20..22).contains(&x) && (30..32).contains(&y);
            let is_gap = (30..34).contains(&x) && (30..34).contains(&y);
            (10..50).contains(&x) && !is_island && !is_gap
        };
        let pixel = |k: usize| if is_body(k % 100, k / 100) { [200; 3] } else { [100; 3] };
        let frame = CompactImage { width: 100, pixels: (0..100 * 100).map(pixel).collect() };
        let shown = still.shown_in(&frame, TOLERANCE);
        let at = |x: usize, y: usize| shown[y * 100 + x];
        assert!(!at(20, 30) && !at(21, 31) && !at(15, 50));
        assert!(at(30, 30) && at(33, 33) && at(5, 50) && at(60, 0) && at(99, 99));
    }
}
