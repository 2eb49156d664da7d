//! Inpainting of pixels whose surface points are occluded in every camera. Such pixels get the colours of the
//! background around them.

use super::depth_map::DepthMap;
use crate::raster::Image;
use rayon::prelude::*;
use std::f32::consts::TAU;

/// Number of image directions in which visible pixels are searched around an occluded pixel.
const DIRECTIONS: usize = 16;
/// Maximum distance from an occluded pixel at which visible pixels are searched, pixels.
const REACH_PX: usize = 128;
/// Number of visible pixels that are averaged in each search direction, starting with the first one found. A single
/// pixel at an object's outline would have mixed colours.
const AVERAGED_PX: usize = 6;

/// Visibility, in the cameras, of the surface point that a pixel of the view shows.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum PointVisibility {
    /// At least one camera sees the pixel's surface point.
    Visible,
    /// The pixel's surface point lies in the image of at least one camera. In every such image, a nearer surface
    /// occludes the point.
    Occluded,
    /// The pixel's surface point lies outside the images of all cameras.
    OutOfView,
}

/// Fills the occluded pixels of an image with the mean colour of visible pixels around them, weighted by inverse
/// distance.
///
/// The search for visible pixels in one direction stops at a surface that is nearer than the occluded point by more
/// than `fraction` of the point's depth. Such a surface is the occluder. An occluded pixel for which no visible pixel
/// is found keeps its colour.
pub(super) fn inpaint(
    image: &mut Image,
    visibility: &[PointVisibility],
    depth: &DepthMap,
    fraction: f32,
) {
    let is_occluded = |k: &usize| visibility[*k] == PointVisibility::Occluded;
    let occluded: Vec<usize> = (0..visibility.len()).filter(is_occluded).collect();
    let surroundings = Surroundings { image, visibility, depth, fraction };
    let colors: Vec<Option<[f32; 3]>> =
        occluded.par_iter().map(|&k| surroundings.color(k)).collect();
    let channels = image.channels();
    for (k, color) in occluded.into_iter().zip(colors) {
        if let Some(color) = color {
            image.data_mut()[k * channels..][..channels].copy_from_slice(&color[..channels]);
        }
    }
}

/// Inputs of [`inpaint`]: a view whose occluded pixels are filled with the colours of its visible pixels.
struct Surroundings<'a> {
    image: &'a Image,
    visibility: &'a [PointVisibility],
    depth: &'a DepthMap,
    fraction: f32,
}

impl Surroundings<'_> {
    /// Computes the colour of an occluded pixel, given by its index, from visible pixels around it. `None` if there are
    /// no such pixels.
    fn color(&self, occluded: usize) -> Option<[f32; 3]> {
        let (mut sum, mut weights) = ([0.0_f32; 3], 0.0_f32);
        for n in 0..DIRECTIONS {
            let angle = TAU * n as f32 / DIRECTIONS as f32;
            if let Some((mean, distance_px)) = self.towards(occluded, [angle.cos(), angle.sin()]) {
                // The distance is at least 1, so the weight is finite.
                let weight = 1.0 / distance_px;
                sum.iter_mut().zip(mean).for_each(|(sum, v)| *sum += weight * v);
                weights += weight;
            }
        }
        (weights > 0.0).then(|| sum.map(|v| v / weights))
    }

    /// Searches for visible pixels from an occluded pixel in one direction, given as a unit vector. Returns the mean
    /// colour of the first few visible pixels, and the distance to the first of them, pixels. `None` if no visible
    /// pixel is found.
    fn towards(&self, occluded: usize, direction: [f32; 2]) -> Option<([f32; 3], f32)> {
        let (w, h, channels) = (self.image.width(), self.image.height(), self.image.channels());
        let at = [occluded % w, occluded / w].map(|v| v as f32 + 0.5);
        let min_depth = self.depth.data()[occluded] * (1.0 - self.fraction);
        let (mut sum, mut count, mut first_px) = ([0.0_f32; 3], 0, 0.0);
        for step in 1..=REACH_PX {
            let [x, y] = [0, 1].map(|axis| at[axis] + step as f32 * direction[axis]);
            if x < 0.0 || y < 0.0 || x >= w as f32 || y >= h as f32 {
                break;
            }
            let k = y as usize * w + x as usize;
            if self.visibility[k] != PointVisibility::Visible {
                if count > 0 {
                    break;
                }
                continue;
            }
            // The negated comparison also ends the search at a NaN, which means that one of the two pixels has no
            // depth.
            if !(self.depth.data()[k] >= min_depth) {
                break;
            }
            if count == 0 {
                first_px = step as f32;
            }
            let pixel = &self.image.data()[k * channels..][..channels];
            sum.iter_mut().zip(pixel).for_each(|(sum, v)| *sum += v);
            count += 1;
            if count == AVERAGED_PX {
                break;
            }
        }
        (count > 0).then(|| (sum.map(|v| v / count as f32), first_px))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A body at 1 m stands in front of a wall at 2 m. To the right of the body is a strip of the wall that no camera
    /// sees. It must get the colour of the wall.
    #[test]
    fn what_is_occluded_is_filled_from_behind() {
        let (w, h) = (12, 5);
        let is_body = |x: usize| (3..6).contains(&x);
        let is_occluded = |x: usize| (6..8).contains(&x);
        let depth = (0..w * h).map(|k| if is_body(k % w) { 1.0 } else { 2.0 }).collect();
        let depth = DepthMap::from_data(w, h, depth);
        let of = |x: usize| {
            if is_occluded(x) { PointVisibility::Occluded } else { PointVisibility::Visible }
        };
        let visibility: Vec<PointVisibility> = (0..w * h).map(|k| of(k % w)).collect();
        let value = |x: usize| if is_body(x) || is_occluded(x) { 0.9 } else { 0.2 };
        let data: Vec<f32> = (0..w * h * 3).map(|k| value(k / 3 % w)).collect();
        let mut image = Image::from_data(w, h, 3, data);
        inpaint(&mut image, &visibility, &depth, 0.03);
        for (k, v) in image.data().iter().enumerate() {
            let expected = if is_body(k / 3 % w) { 0.9 } else { 0.2 };
            assert!((v - expected).abs() < 1e-6, "{k}: {v}");
        }
    }

    #[test]
    fn what_has_nothing_behind_it_stays() {
        let depth = DepthMap::from_data(3, 1, vec![1.0, f32::NAN, 1.0]);
        let mut image = Image::from_data(3, 1, 1, vec![0.1, 0.5, 0.3]);
        inpaint(
            &mut image,
            &[PointVisibility::Visible, PointVisibility::Occluded, PointVisibility::Visible],
            &depth,
            0.03,
        );
        assert_eq!(image.data(), [0.1, 0.5, 0.3]);
        inpaint(&mut image, &[PointVisibility::Occluded; 3], &depth, 0.03);
        assert_eq!(image.data(), [0.1, 0.5, 0.3]);
    }

    /// A pixel outside all cameras' images is black whatever its depth, and must not be used to fill other pixels.
    #[test]
    fn nothing_comes_from_pixels_that_no_camera_shows() {
        let depth = DepthMap::from_data(4, 1, vec![2.0; 4]);
        let mut image = Image::from_data(4, 1, 1, vec![0.0, 0.9, 0.9, 0.4]);
        inpaint(
            &mut image,
            &[
                PointVisibility::OutOfView,
                PointVisibility::Occluded,
                PointVisibility::Occluded,
                PointVisibility::Visible,
            ],
            &depth,
            0.03,
        );
        assert_eq!(image.data(), [0.0, 0.4, 0.4, 0.4]);
    }
}
