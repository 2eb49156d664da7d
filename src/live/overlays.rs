//! Pictures that explain a view: the cameras from which each pixel is blended, and the depth of each pixel.

use crate::camera::Camera;
use crate::light_field::{Geometry, GivenImages, LightField};
use crate::lumigraph::{BlendOptions, DepthMap, Rendered};
use crate::raster::{Image, luma};

/// Maximum number of cameras whose blending weights are computed for a picture. The cameras nearest to the viewpoint
/// are chosen.
const MAX_CAMERAS: usize = 24;
/// Period of the stripes that show the blending weights, as a fraction of the picture's width. With a larger period,
/// the stripes hide the scene. With a smaller period, the thin stripes of small weights vanish.
const PATTERN: f32 = 1.0 / 24.0;
/// Minimum period of the stripes that show the blending weights, pixels.
const MIN_PATTERN_PX: f32 = 8.0;
/// Opacity of the stripes that show the blending weights over the grey picture, from 0 to 1.
const TINT: f32 = 0.6;
/// Fraction of a view's depths, one per pixel, that are clipped at each end of the colour scale.
const OUTSIDE: f64 = 0.01;

/// Colours of the depth scale from far to near, RGB from 0 to 255, in equal steps of lightness (matplotlib's viridis).
pub(super) const DEPTH_COLORS: [[u8; 3]; 9] = [
    [68, 1, 84],
    [71, 44, 122],
    [59, 81, 139],
    [44, 113, 142],
    [33, 144, 141],
    [39, 173, 129],
    [92, 200, 99],
    [170, 220, 50],
    [253, 231, 37],
];

/// Blending weights of the cameras at every pixel of a view.
pub(super) struct Weights {
    /// Weights of each camera at all pixels, row by row. The cameras are in the capture's order. `None` for a camera
    /// whose weights were not computed.
    by_camera: Vec<Option<Vec<f32>>>,
    /// The view that is blended with these weights, still in colour. [`Self::striped`] converts it to grey.
    gray: Rendered,
}

impl Weights {
    /// Computes the blending weights of a view. `target` is the camera of the view. The view is blended from `images`,
    /// the cameras' images at the instant of the view.
    pub fn new(
        field: &LightField,
        images: &GivenImages,
        geometry: &Geometry,
        target: &Camera,
        options: &BlendOptions,
    ) -> Self {
        let filmed = &field.capture().cameras;
        let mut near: Vec<usize> =
            (0..filmed.len()).filter(|&c| images.all()[c].is_some()).collect();
        let distance = |c: usize| (filmed[c].camera.center() - target.center()).norm();
        near.sort_by(|&a, &b| distance(a).total_cmp(&distance(b)));
        near.truncate(MAX_CAMERAS);
        let mut by_camera = vec![None; filmed.len()];
        for cameras in near.chunks(3) {
            // If one camera's image is pure red, another's green and a third one's blue, the blend's channels
            // are the three cameras' weights.
            let mut colors = vec![[0.0; 3]; filmed.len()];
            cameras.iter().enumerate().for_each(|(channel, &c)| colors[c][channel] = 1.0);
            let blended = field.blend(images.with_colors(&colors).all(), geometry, target, options);
            for (channel, &c) in cameras.iter().enumerate() {
                let weights = blended.image.data().chunks_exact(3).map(|pixel| pixel[channel]);
                by_camera[c] = Some(weights.collect());
            }
        }
        Self { by_camera, gray: field.blend(images.all(), geometry, target, options) }
    }

    /// Returns the weights as one tall picture, a stack of pictures with the size of the view. The channels of the
    /// first picture are the weights of cameras 0, 1 and 2, those of the second picture are the weights of cameras 3, 4
    /// and 5, and so on.
    pub fn picture(&self) -> Rendered {
        let (width, height) = (self.gray.image.width(), self.gray.image.height());
        let mut data =
            Vec::with_capacity(width * height * self.by_camera.len().next_multiple_of(3));
        for cameras in self.by_camera.chunks(3) {
            for k in 0..width * height {
                let weight = |channel: usize| Some(cameras.get(channel)?.as_ref()?[k]);
                data.extend((0..3).map(|channel| weight(channel).unwrap_or(0.0)));
            }
        }
        let height = height * self.by_camera.len().div_ceil(3);
        let image = Image::from_data(width, height, 3, data);
        Rendered { image, coverage: vec![true; width * height] }
    }

    /// Returns the view in grey, overlaid with diagonal stripes in the cameras' colours. The width of a camera's stripe
    /// is proportional to its blending weight.
    pub fn striped(self, colors: &[[f32; 3]]) -> Rendered {
        let Rendered { image, coverage } = self.gray;
        let (width, shown) = (image.width(), image.to_rgb());
        let pattern_px = (PATTERN * width as f32).max(MIN_PATTERN_PX);
        let mut data = Vec::with_capacity(shown.data().len());
        for (k, pixel) in shown.data().chunks_exact(3).enumerate() {
            let gray = luma(pixel);
            let phase = ((k % width + k / width) as f32 / pattern_px).fract();
            let color = stripe(&self.by_camera, k, phase).map_or([gray; 3], |c| colors[c]);
            data.extend(color.map(|v| gray * (1.0 - TINT) + v * TINT));
        }
        Rendered { image: Image::from_data(width, image.height(), 3, data), coverage }
    }
}

/// Returns the index of the camera whose stripe covers a pixel. `phase` is the pixel's position within the period of
/// the stripes, from 0 to 1. `None` if all weights are 0 at the pixel.
fn stripe(by_camera: &[Option<Vec<f32>>], pixel: usize, phase: f32) -> Option<usize> {
    let weights =
        || by_camera.iter().enumerate().filter_map(|(c, w)| Some((c, w.as_ref()?[pixel])));
    let mut rest = phase * weights().map(|(_, weight)| weight).sum::<f32>();
    let found = weights().find(|(_, weight)| {
        rest -= weight;
        rest < 0.0
    });
    found.map(|(camera, _)| camera)
}

/// Converts a view's depths to colours, on a scale that is linear in inverse depth. Returns the picture, and the depths
/// of the first and the last colour of the scale, metres. `None` if no pixel has a depth.
pub(super) fn depth_picture(depths: &DepthMap) -> Option<(Rendered, [f32; 2])> {
    let inverse = |depth: &f32| 1.0 / depth;
    let mut sorted: Vec<f32> = depths.data().iter().map(inverse).filter(|v| !v.is_nan()).collect();
    sorted.sort_by(f32::total_cmp);
    let skipped = (OUTSIDE * sorted.len() as f64) as usize;
    let (low, high) = (*sorted.get(skipped)?, *sorted.iter().rev().nth(skipped)?);
    let color = |depth: &f32| {
        let fraction = (inverse(depth) - low) / (high - low).max(f32::MIN_POSITIVE);
        if fraction.is_nan() { [0.0; 3] } else { depth_color(fraction.clamp(0.0, 1.0)) }
    };
    let data = depths.data().iter().flat_map(color).collect();
    let image = Image::from_data(depths.width(), depths.height(), 3, data);
    let coverage = depths.data().iter().map(|depth| !depth.is_nan()).collect();
    Some((Rendered { image, coverage }, [inverse(&low), inverse(&high)]))
}

/// Returns the interpolated colour at a fraction, from 0 to 1, of the scale [`DEPTH_COLORS`]. The result is RGB from 0
/// to 1.
fn depth_color(fraction: f32) -> [f32; 3] {
    let at = fraction * (DEPTH_COLORS.len() - 1) as f32;
    let first = (at as usize).min(DEPTH_COLORS.len() - 2);
    let part = at - first as f32;
    [0, 1, 2].map(|c| {
        let [a, b] = [0, 1].map(|next| f32::from(DEPTH_COLORS[first + next][c]) / 255.0);
        a + (b - a) * part
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stripes_are_as_wide_as_the_weights() {
        let by_camera = vec![Some(vec![0.25, 0.0]), None, Some(vec![0.75, 0.0])];
        let count = |camera| {
            (0..100).filter(|k| stripe(&by_camera, 0, *k as f32 / 100.0) == Some(camera)).count()
        };
        assert_eq!((count(0), count(2)), (25, 75));
        assert_eq!(stripe(&by_camera, 1, 0.5), None, "no camera sees it");
    }

    #[test]
    fn weights_are_three_cameras_a_picture() {
        let image = Image::filled(2, 1, 3, 0.5);
        let gray = Rendered { image, coverage: vec![true; 2] };
        let by_camera = vec![Some(vec![0.25, 1.0]), None, None, Some(vec![0.75, 0.0])];
        let picture = Weights { by_camera, gray }.picture();
        assert_eq!((picture.image.width(), picture.image.height()), (2, 2));
        assert_eq!(picture.image.data()[..6], [0.25, 0.0, 0.0, 1.0, 0.0, 0.0]);
        assert_eq!(picture.image.data()[6..9], [0.75, 0.0, 0.0]);
    }

    #[test]
    fn near_is_bright_far_is_dark_and_nothing_is_left_open() {
        let depths = DepthMap::from_data(4, 1, vec![1.0, 4.0, f32::INFINITY, f32::NAN]);
        let (picture, [far_m, near_m]) = depth_picture(&depths).unwrap();
        assert_eq!((far_m, near_m), (f32::INFINITY, 1.0));
        assert_eq!(picture.coverage, [true, true, true, false]);
        let pixel = |k: usize| luma(&picture.image.data()[3 * k..3 * k + 3]);
        assert!(pixel(0) > pixel(1) && pixel(1) > pixel(2));
        assert!(depth_picture(&DepthMap::empty(2, 2)).is_none());
        let (flat, _) = depth_picture(&DepthMap::from_data(1, 1, vec![2.0])).unwrap();
        assert!(flat.image.data().iter().all(|v| v.is_finite()));
    }
}
