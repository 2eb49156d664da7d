//! Frames whose scene flow is estimated: a camera's image, resampled to a pinhole camera, at its own time.

use super::lens_grid::LensGrid;
use super::matching_image::MatchingImage;
use super::still::{CompactImage, StillImage, TOLERANCE};
use crate::camera::{Camera, CameraModel};
use crate::raster::{Image, Sampling, sample, sample_each};
use nalgebra::Point2;

/// Frame of a camera at its own time, resampled to a pinhole camera.
pub struct FlowFrame {
    /// Pinhole camera to which the image is resampled. Its image is larger than the original one where the lens sees
    /// farther than a pinhole camera of the same size would.
    pub view: Camera,
    /// Time since the capture's start, in frame periods of the reference camera. With a rolling shutter, it is the
    /// time of the middle row.
    pub time: f64,
    /// Times of the camera's frames before and after this one, in frame periods of the reference camera; infinite where
    /// there is none.
    pub neighbors: [f64; 2],
    /// Time from one row to the next, in frame periods of the reference camera; 0 for a global shutter. The rows are
    /// those of the pinhole camera, so the time is only approximate for a lens with distortion.
    pub row_time: f64,
    pub is_color: bool,
    /// Image of the pinhole camera with 3 channels, corrected to the reference camera's exposure.
    pub image: Image,
    /// For each pixel, whether a part of it lies inside the camera's original image. `None` if all pixels do.
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
    /// `time` is in frame periods of the reference camera. The shutter is global, and the camera has no other frames.
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
        let neighbors = [f64::NEG_INFINITY, f64::INFINITY];
        Self {
            view,
            time,
            neighbors,
            row_time: 0.0,
            is_color,
            image,
            is_filmed,
            original,
            still: None,
        }
    }

    /// Returns the frame with the times of the camera's frames before and after it, in frame periods of the reference
    /// camera; infinite where there is none.
    pub fn with_neighbors(self, neighbors: [f64; 2]) -> Self {
        Self { neighbors, ..self }
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
        let still = Some(still.shown_in(&CompactImage::new(&self.image), TOLERANCE));
        Self { still, ..self }
    }

    /// Returns whether pixel `k` of a pyramid level shows static background and the level, with pixels of `scale` pixels
    /// of the image, is the finest. There, background keeps the surface element of the coarser level, except beside bodies.
    pub(super) fn keeps_element(&self, k: usize, scale: f32) -> bool {
        scale == 1.0 && self.still.as_ref().is_some_and(|still| still[k])
    }

    /// Returns the pyramid of the frame's image, finest level first.
    pub fn pyramid(&self) -> Vec<MatchingImage> {
        let levels = levels(self.view.width, self.view.height);
        MatchingImage::pyramid(
            &self.image,
            levels,
            self.still.as_deref(),
            self.is_filmed.as_deref(),
        )
    }

    /// Returns the pyramid with silhouettes before the static background `still` of the frame's camera. If the frame has a
    /// mask of the background, this decides, and no silhouettes are added.
    pub fn pyramid_before(&self, still: &StillImage) -> Vec<MatchingImage> {
        let mut pyramid = self.pyramid();
        if self.still.is_none() {
            MatchingImage::add_silhouettes(&mut pyramid, still.silhouettes(&self.image));
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

    /// Interpolates colours at many positions, as [`Self::color`] does. Each element of `places` is a position, pixels, and
    /// any value of the caller. For each, `put` is called with the caller's value and the colour.
    pub fn colors<T>(
        &self,
        places: impl Iterator<Item = ([f32; 2], T)>,
        mut put: impl FnMut(T, [f32; 3]),
    ) {
        match &self.original {
            None => sample_each(&self.image, places, Sampling::Cubic, put),
            Some(_) => places.for_each(|(place, with)| put(with, self.color(place))),
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

/// Resamples a camera's image to a pinhole camera. Returns the resampled image and, for each of its pixels, whether its centre
/// or a corner lies inside the original image, so that all that the camera films is in such pixels. The other pixels
/// continue the colours at its border, so that there is no edge. Beyond the range in which the lens model is monotonic, they
/// are black.
fn undistorted(camera: &Camera, pinhole: &Camera, image: &Image) -> (Image, Vec<bool>) {
    let (width, height) = (pinhole.width, pinhole.height);
    let place = |x: f64, y: f64| camera.project_cam(&pinhole.ray(&Point2::new(x, y))?.into());
    let is_inside = |place: &Point2<f64>| camera.contains(place);
    let corner = |k: usize| place((k % (width + 1)) as f64, (k / (width + 1)) as f64);
    let corners =
        (0..(width + 1) * (height + 1)).map(|k| corner(k).as_ref().is_some_and(is_inside));
    let corners: Vec<bool> = corners.collect();
    let mut out = Image::filled(width, height, 3, 0.0);
    let mut is_filmed = vec![false; width * height];
    for (k, (color, is_filmed)) in
        out.data_mut().chunks_exact_mut(3).zip(&mut is_filmed).enumerate()
    {
        let (x, y) = (k % width, k / width);
        let Some(filmed) = place(x as f64 + 0.5, y as f64 + 0.5) else { continue };
        let upper = y * (width + 1) + x;
        let lower = upper + width + 1;
        *is_filmed =
            is_inside(&filmed) || [upper, lower].iter().any(|&c| corners[c] || corners[c + 1]);
        image.sample_cubic(filmed.x as f32, filmed.y as f32, color);
    }
    (out, is_filmed)
}
