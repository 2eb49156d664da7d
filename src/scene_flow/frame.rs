//! Frames for matching. Each has an image pyramid of brightness, colour and gradients.

use super::lens_grid::LensGrid;
use super::noise;
use super::still::{CompactImage, StillImage};
use crate::camera::{Camera, CameraModel};
use crate::raster::{Image, Sampling, sample};
use nalgebra::Point2;

/// Weights of the four channels of a [`MatchingSample`]: brightness, red minus blue, and the two gradients of
/// brightness. Gradients locate outlines, and tolerate remaining differences in exposure.
pub const WEIGHTS: [f32; 4] = [1.0, 0.5, 1.5, 1.5];
/// Weights of red, green and blue in brightness.
const LUMA: [f32; 3] = [0.3, 0.59, 0.11];

/// Matching cost that noise alone causes, per standard deviation of the noise of brightness. It is computed for noise of
/// red, green and blue that is independent and normally distributed. Larger: wrong elements of noisy pixels count as
/// good. Smaller: noisy pixels are estimated anew in every pass.
const COST_BY_NOISE: f32 = 4.0;

/// Features of a pixel that matching compares: brightness, red minus blue, and the horizontal and vertical gradient
/// of brightness. Each is multiplied by its weight ([`WEIGHTS`]).
pub type MatchingSample = [f32; 4];

/// One level of an image pyramid for matching: a sample for each pixel, row by row.
pub struct MatchingImage {
    pub width: usize,
    pub height: usize,
    samples: Vec<MatchingSample>,
    /// For each pixel, whether it shows only static background. Empty if this is unknown.
    still: Vec<bool>,
    /// For each pixel, whether a part of it lies inside the camera's original image. Empty if all pixels do.
    filmed: Vec<bool>,
    /// Standard deviation of the noise of brightness.
    noise: f32,
}

impl MatchingImage {
    /// Returns the pyramid of an image, finest level first. Each level has half the width and height of the next
    /// finer level.
    pub fn pyramid(image: &Image, levels: usize) -> Vec<Self> {
        let (mut width, mut height) = (image.width(), image.height());
        let rgb = image.to_rgb();
        let mut pixels: Vec<[f32; 3]> =
            rgb.data().chunks_exact(3).map(|p| [p[0], p[1], p[2]]).collect();
        let mut pyramid = vec![Self::new(width, height, &pixels)];
        for _ in 1..levels {
            pixels = halved(width, height, &pixels);
            (width, height) = (width / 2, height / 2);
            pyramid.push(Self::new(width, height, &pixels));
        }
        pyramid
    }

    fn new(width: usize, height: usize, pixels: &[[f32; 3]]) -> Self {
        let brightness: Vec<f32> = pixels.iter().map(brightness).collect();
        let mut samples = Vec::with_capacity(width * height);
        for y in 0..height {
            let [above, below] = [y.saturating_sub(1), (y + 1).min(height - 1)];
            for x in 0..width {
                let [left, right] = [x.saturating_sub(1), (x + 1).min(width - 1)];
                let at = |x: usize, y: usize| brightness[y * width + x];
                let color = pixels[y * width + x];
                samples.push([
                    WEIGHTS[0] * at(x, y),
                    WEIGHTS[1] * (color[0] - color[2]),
                    WEIGHTS[2] * 0.5 * (at(right, y) - at(left, y)),
                    WEIGHTS[3] * 0.5 * (at(x, below) - at(x, above)),
                ]);
            }
        }
        Self { width, height, samples, still: Vec::new(), filmed: Vec::new(), noise: 0.0 }
    }

    /// Returns whether a pixel shows only static background. `None` if this is unknown for the whole image.
    #[inline(always)]
    pub fn is_still(&self, x: usize, y: usize) -> Option<bool> {
        self.still.get(y * self.width + x).copied()
    }

    /// Returns whether the camera filmed what lies at a position, pixels; (0, 0) is the centre of the first pixel.
    #[inline(always)]
    pub fn films(&self, [x, y]: [f32; 2]) -> bool {
        let [max_x, max_y] = self.limit();
        let is_inside = x > 0.0 && y > 0.0 && x < max_x && y < max_y;
        let index = || (y + 0.5) as usize * self.width + (x + 0.5) as usize;
        is_inside && (self.filmed.is_empty() || self.filmed[index()])
    }

    /// Returns whether the camera filmed a part of a pixel.
    #[inline(always)]
    pub fn films_pixel(&self, x: usize, y: usize) -> bool {
        self.filmed.is_empty() || self.filmed[y * self.width + x]
    }

    fn measured_noise(&self) -> f32 {
        let brightness: Vec<f32> = self.samples.iter().map(|s| s[0] / WEIGHTS[0]).collect();
        noise::standard_deviation(self.width, &brightness, &self.filmed)
    }

    /// Returns the mean matching cost that noise alone causes.
    pub fn noise_cost(&self) -> f32 {
        COST_BY_NOISE * self.noise
    }

    /// Returns the size of the level in memory, bytes.
    pub fn bytes(&self) -> usize {
        size_of_val(self.samples.as_slice()) + self.still.len() + self.filmed.len()
    }

    #[inline(always)]
    pub fn pixel(&self, x: usize, y: usize) -> MatchingSample {
        self.samples[y * self.width + x]
    }

    /// Returns the largest position `[x, y]` at which a bilinear sample can be read, pixels; (0, 0) is the centre of
    /// the first pixel.
    #[inline(always)]
    pub fn limit(&self) -> [f32; 2] {
        // Slightly less than the centre of the last pixel, so that rounding never reaches beyond the image.
        [self.width, self.height].map(|size| (size as f32 - 1.001).max(0.0))
    }

    /// Returns the 2×2 pixels whose top-left pixel is `(x, y)`: the upper row, then the lower row.
    #[inline(always)]
    pub fn quad(&self, x: usize, y: usize) -> [&[MatchingSample]; 2] {
        let k = y * self.width + x;
        [&self.samples[k..k + 2], &self.samples[k + self.width..][..2]]
    }
}

fn brightness(color: &[f32; 3]) -> f32 {
    LUMA.iter().zip(color).map(|(weight, value)| weight * value).sum()
}

/// Returns an image at half its size: the mean of each block of 2×2 pixels. An odd last row or column is dropped.
fn halved(width: usize, height: usize, pixels: &[[f32; 3]]) -> Vec<[f32; 3]> {
    let (columns, rows) = (width / 2, height / 2);
    let mean = |k: usize| {
        let (x, y) = (2 * (k % columns), 2 * (k / columns));
        let at = |dx: usize, dy: usize| pixels[(y + dy) * width + x + dx];
        let four = [at(0, 0), at(1, 0), at(0, 1), at(1, 1)];
        [0, 1, 2].map(|c| 0.25 * four.iter().map(|p| p[c]).sum::<f32>())
    };
    (0..columns * rows).map(mean).collect()
}

/// Returns `of` the four pixels of each block of 2×2 pixels of a mask of this width. An odd last row or column is dropped.
fn halved_mask(mask: &[bool], width: usize, of: fn([bool; 4]) -> bool) -> Vec<bool> {
    let (columns, rows) = (width / 2, mask.len() / width / 2);
    let block = |k: usize| {
        let at = 2 * (k / columns) * width + 2 * (k % columns);
        of([at, at + 1, at + width, at + width + 1].map(|k| mask[k]))
    };
    (0..columns * rows).map(block).collect()
}

/// Frame of a camera at its own time, resampled to a pinhole camera.
pub struct FlowFrame {
    /// Pinhole camera to which the image is resampled. Its image is larger than the original one where the lens sees
    /// farther than a pinhole camera of the same size would.
    pub view: Camera,
    /// Time since the capture's start, in frame periods of the reference camera. With a rolling shutter, it is the
    /// time of the middle row.
    pub time: f64,
    /// Time from one row to the next, in frame periods of the reference camera; 0 for a global shutter. The rows are
    /// those of the pinhole camera, so the time is only approximate for a lens with distortion.
    pub row_time: f64,
    pub is_color: bool,
    /// Image of the pinhole camera with 3 channels, corrected to the reference camera's exposure.
    pub image: Image,
    /// For each pixel, whether it lies inside the camera's original image. `None` if all pixels do.
    pub is_filmed: Option<Vec<bool>>,
    /// The image as the camera filmed it. `None` if its lens has no distortion, or it isn't known.
    pub original: Option<OriginalImage>,
    /// For each pixel, whether it shows the static background of the camera rather than a moving body. `None` if this
    /// is unknown.
    pub still: Option<Vec<bool>>,
}

/// Image of a camera whose lens has distortion, with 3 channels, corrected to the reference camera's exposure.
pub struct OriginalImage {
    image: Image,
    lens: LensGrid,
}

/// A frame with the pyramid of its image ([`FlowFrame::pyramid`]).
#[derive(Clone, Copy)]
pub struct PyramidFrame<'a> {
    pub frame: &'a FlowFrame,
    pub levels: &'a [MatchingImage],
}

/// Minimum length of the shorter side of a pyramid level, pixels.
const MIN_SIDE_PX: usize = 48;
/// Maximum width of the margins by which the image of a pinhole camera is larger than that of a lens with distortion, as a
/// fraction of the image's size. Larger: wide lenses take more memory and time. Smaller: their borders are lost.
const MAX_MARGIN: f64 = 0.125;
/// Maximum number of pyramid levels.
const MAX_LEVELS: usize = 5;

/// Returns the number of pyramid levels for images of this size, pixels.
pub fn levels(width: usize, height: usize) -> usize {
    let halvings = (width.min(height) / MIN_SIDE_PX).max(1).ilog2() as usize;
    (halvings + 1).min(MAX_LEVELS)
}

impl FlowFrame {
    /// Creates a frame from a camera's image. The image must already be corrected to the reference camera's exposure.
    /// `time` is in frame periods of the reference camera. The shutter is global.
    pub fn new(camera: &Camera, image: &Image, time: f64) -> Self {
        let view = pinhole(camera);
        let is_color = image.channels() > 1;
        let image = image.to_rgb();
        let (image, is_filmed, original) = if camera.model.is_pinhole() {
            (image, None, None)
        } else {
            let (resampled, is_filmed) = undistorted(camera, &view, &image);
            let lens = LensGrid::new(camera, &view);
            (resampled, Some(is_filmed), Some(OriginalImage { image, lens }))
        };
        Self { view, time, row_time: 0.0, is_color, image, is_filmed, original, still: None }
    }

    /// Returns the frame with a rolling shutter. `row_time` is the time from one row to the next, in frame periods of
    /// the reference camera.
    pub fn with_row_time(self, row_time: f64) -> Self {
        Self { row_time, ..self }
    }

    /// Compares the frame with the static background `still` of its camera. Returns the frame with a mask of the pixels
    /// that show this background. If no pixel's background is known, the frame is returned unchanged.
    pub fn with_still(self, still: &StillImage) -> Self {
        if still.is_empty() {
            return self;
        }
        let still = Some(still.shown_in(&CompactImage::new(&self.image)));
        Self { still, ..self }
    }

    /// Returns the pyramid of the frame's image, finest level first.
    pub fn pyramid(&self) -> Vec<MatchingImage> {
        let levels = levels(self.view.width, self.view.height);
        let mut pyramid = MatchingImage::pyramid(&self.image, levels);
        pyramid[0].still = self.still.clone().unwrap_or_default();
        pyramid[0].filmed = self.is_filmed.clone().unwrap_or_default();
        pyramid[0].noise = pyramid[0].measured_noise();
        for level in 1..pyramid.len() {
            let finer = &pyramid[level - 1];
            let still = halved_mask(&finer.still, finer.width, |four| four.iter().all(|v| *v));
            let filmed = halved_mask(&finer.filmed, finer.width, |four| four.iter().any(|v| *v));
            (pyramid[level].still, pyramid[level].filmed) = (still, filmed);
            // The mean of four pixels has half their noise.
            pyramid[level].noise = 0.5 * pyramid[level - 1].noise;
        }
        pyramid
    }

    /// Returns the colour at a position, pixels, by cubic interpolation. If the lens has distortion, the original image is
    /// interpolated, so that colours are interpolated only once.
    #[inline(always)]
    pub fn color(&self, [x, y]: [f32; 2]) -> [f32; 3] {
        match &self.original {
            None => sample(&self.image, x, y, Sampling::Cubic),
            Some(original) => {
                let place = original.lens.distorted([x, y]);
                let (image, [x, y]) =
                    place.map_or((&self.image, [x, y]), |place| (&original.image, place));
                sample(image, x, y, Sampling::Cubic)
            }
        }
    }

    /// Returns whether the camera filmed what lies at a position, pixels.
    #[inline(always)]
    pub fn films(&self, [x, y]: [f32; 2]) -> bool {
        let Camera { width, height, .. } = self.view;
        let is_inside = x >= 0.0 && y >= 0.0 && x < width as f32 && y < height as f32;
        let index = || y as usize * width + x as usize;
        is_inside && self.is_filmed.as_ref().is_none_or(|filmed| filmed[index()])
    }

    /// Returns whether pixel `k` is known to show a moving body instead of static background.
    pub fn is_moving(&self, k: usize) -> bool {
        self.still.as_ref().is_some_and(|still| !still[k])
    }

    /// Returns the size of the image and the masks in memory, bytes.
    pub fn bytes(&self) -> usize {
        let masks = [&self.is_filmed, &self.still];
        let masks: usize = masks.into_iter().flatten().map(Vec::len).sum();
        let original =
            self.original.as_ref().map_or(0, |o| size_of_val(o.image.data()) + o.lens.bytes());
        size_of_val(self.image.data()) + original + masks
    }
}

/// Returns a pinhole camera with the focal lengths of a camera, whose image contains all that the camera films. The
/// margin at each side is at most an eighth of the original size. The middle of the image stays the middle.
pub fn pinhole(camera: &Camera) -> Camera {
    let (fx, fy, cx, cy) = camera.model.intrinsics();
    let (width, height) = (camera.width as f64, camera.height as f64);
    let beyond = |pixel: Point2<f64>| {
        let ray = camera.ray(&pixel)?;
        let outside = |at: f64, size: f64| (-at).max(at - size);
        Some([outside(cx + fx * ray.x, width), outside(cy + fy * ray.y, height)])
    };
    let columns = (0..=camera.width).flat_map(|x| [(x as f64, 0.0), (x as f64, height)]);
    let rows = (0..=camera.height).flat_map(|y| [(0.0, y as f64), (width, y as f64)]);
    let margin = if camera.model.is_pinhole() {
        [0.0; 2]
    } else {
        let border = columns.chain(rows).filter_map(|(x, y)| beyond(Point2::new(x, y)));
        border.fold([0.0; 2], |[a, b]: [f64; 2], [c, d]| [a.max(c), b.max(d)])
    };
    let [left, top] = [(margin[0], width), (margin[1], height)]
        .map(|(margin, size)| margin.min(MAX_MARGIN * size).ceil());
    let model = CameraModel::Pinhole { fx, fy, cx: cx + left, cy: cy + top };
    let [width, height] = [camera.width + 2 * left as usize, camera.height + 2 * top as usize];
    Camera { model, width, height, ..camera.clone() }
}

/// Resamples a camera's image to a pinhole camera. Returns the resampled image and, for each of its pixels, whether
/// it lies inside the original image. The other pixels continue the colours at its border, so that there is no edge.
/// Beyond the range in which the lens model is monotonic, they are black.
fn undistorted(camera: &Camera, pinhole: &Camera, image: &Image) -> (Image, Vec<bool>) {
    let (width, height) = (pinhole.width, pinhole.height);
    let mut out = Image::filled(width, height, 3, 0.0);
    let mut is_filmed = vec![false; width * height];
    for (k, (color, is_filmed)) in
        out.data_mut().chunks_exact_mut(3).zip(&mut is_filmed).enumerate()
    {
        let pixel = Point2::new((k % width) as f64 + 0.5, (k / width) as f64 + 0.5);
        let Some(ray) = pinhole.ray(&pixel) else { continue };
        let Some(filmed) = camera.project_cam(&ray.into()) else { continue };
        *is_filmed = camera.contains(&filmed);
        image.sample_cubic(filmed.x as f32, filmed.y as f32, color);
    }
    (out, is_filmed)
}
