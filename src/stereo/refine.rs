//! Refinement of inverse depths to fractions of a depth level, by Gauss–Newton steps (Lucas and Kanade 1981). The steps
//! minimize the differences between the grey values of the reference image and of its partners, which are the images
//! that it is matched with.

use super::cost_volume::{Partner, StereoSet};
use crate::lumigraph::RayRow;
use crate::raster::{Image, Sampling, box_filter, sample};
use rayon::prelude::*;

/// Half-width of the window over which the normal equations of a pixel's inverse depth are summed, pixels.
const RADIUS: usize = 2;
/// Number of pixels in the window over which normal equations are summed.
const WINDOW: f32 = ((2 * RADIUS + 1) * (2 * RADIUS + 1)) as f32;
/// Number of Gauss–Newton steps that refine each inverse depth.
const STEPS: usize = 2;
/// Maximum length of a Gauss–Newton step, in depth levels.
const MAX_STEP: f32 = 0.75;
/// Maximum difference between the grey values, 0 to 1, of a pixel and of its projection into another camera's image. If
/// the difference is larger, the point counts as occluded in the other camera.
const MAX_DIFFERENCE: f32 = 0.06;
/// Standard error of a grey value (0 to 1), due to noise, resampling and synchronization.
const GRAY_STD_ERR: f32 = 0.01;
/// Inverse variance of the Gaussian prior on the length of a Gauss–Newton step, in units of 1 / (depth level)². The
/// prior has a mean of zero, and shortens the steps where there is little texture.
const PRIOR: f32 = 4.0;

/// Refines a camera's inverse depths, 1/m, row by row, in place. `set` has the reference image and the images it is
/// matched with. `level` is the difference between two successive depth levels, 1/m.
pub(super) fn refine(values: &mut [f32], set: &StereoSet, level: f32) {
    let (w, h) = (set.image.camera.width, set.image.camera.height);
    let prior = PRIOR / (level * level);
    for _ in 0..STEPS {
        let sums = normal_equations(values, set, level);
        let [slope, info] = [0, 1].map(|k| {
            let plane: Vec<f32> = sums.iter().map(|s| s[k]).collect();
            box_filter(&plane, w, h, RADIUS)
        });
        for ((value, slope), info) in values.iter_mut().zip(&slope).zip(&info) {
            // The divisor is positive, since the prior is positive.
            let step = slope / (info + prior / WINDOW);
            *value += step.clamp(-MAX_STEP * level, MAX_STEP * level);
        }
    }
}

/// Computes the normal equation of each pixel's inverse depth: the sums over the partners (the images that the
/// reference image is matched with) of g·r/σ² and g²/σ². Here r is the reference's grey value minus the partner's grey
/// value, g is the derivative of the partner's grey value with respect to inverse depth, and σ is [`GRAY_STD_ERR`].
/// `level` is the difference between two successive depth levels, 1/m.
fn normal_equations(values: &[f32], set: &StereoSet, level: f32) -> Vec<[f32; 2]> {
    let camera = &set.image.camera;
    let w = camera.width;
    let precision = GRAY_STD_ERR.powi(-2);
    let mut sums = vec![[0.0_f32; 2]; values.len()];
    sums.par_chunks_mut(w).enumerate().for_each_init(
        || RayRow::new(camera),
        |rays, (y, sums)| {
            rays.set(y);
            for (x, sum) in sums.iter_mut().enumerate() {
                let own = set.image.gray.data()[y * w + x];
                let value = values[y * w + x];
                for Partner { image, pose } in &set.partners {
                    let rotated = pose.rotated(rays.x[x] as f32, rays.y[x] as f32);
                    let at = |inverse: f32| {
                        gray_at(&image.gray, pose.pixel(&pose.point(&rotated, inverse)))
                    };
                    let (Some(low), Some(high)) =
                        (at(value - 0.5 * level), at(value + 0.5 * level))
                    else {
                        continue;
                    };
                    let (g, r) = ((high - low) / level, own - 0.5 * (low + high));
                    if r.abs() < MAX_DIFFERENCE {
                        *sum = [sum[0] + precision * g * r, sum[1] + precision * g * g];
                    }
                }
            }
        },
    );
    sums
}

/// Returns the bilinearly interpolated grey value at a position in pixels. `None` outside the image.
fn gray_at(gray: &Image, [x, y]: [f32; 2]) -> Option<f32> {
    let (w, h) = (gray.width(), gray.height());
    // The comparisons are also false for NaN.
    if !(x >= 0.0 && y >= 0.0 && x < w as f32 && y < h as f32) {
        return None;
    }
    let [value] = sample(gray, x, y, Sampling::Bilinear);
    Some(value)
}
