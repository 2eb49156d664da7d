//! Refines inverse depths between levels: Gauss–Newton steps (Lucas and Kanade 1981) that match the partners'
//! grey values to the reference's.

use super::cost_volume::{Partner, StereoSet};
use crate::lumigraph::RayRow;
use crate::raster::{Image, Sampling, box_filter, sample};
use rayon::prelude::*;

/// Half-width of the window over which a step's equations are summed, pixels.
const RADIUS: usize = 2;
/// Number of pixels of the window.
const WINDOW: f32 = ((2 * RADIUS + 1) * (2 * RADIUS + 1)) as f32;
/// Number of Gauss–Newton steps.
const STEPS: usize = 2;
/// Maximum step, levels.
const MAX_STEP: f32 = 0.75;
/// Maximum difference of grey values, 0..=1, of a pixel that is used. With a larger one, the point is taken
/// as occluded.
const MAX_DIFFERENCE: f32 = 0.06;
/// Standard error of a grey value, 0..=1, due to noise, resampling and synchronization.
const GRAY_STD_ERR: f32 = 0.01;
/// Information of the smoothness prior at every pixel: an inverse variance in levels⁻².
const PRIOR: f32 = 4.0;

/// Refines inverse depths, 1/m, in place. `level` is the difference between two levels, 1/m.
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
            // The divisor is positive, since the prior is.
            let step = slope / (info + prior / WINDOW);
            *value += step.clamp(-MAX_STEP * level, MAX_STEP * level);
        }
    }
}

/// At every pixel, the sums over the partners of g·r/σ² and g²/σ², where r is the difference of the grey
/// values, g is the derivative of the partner's grey value by inverse depth, and σ is [`GRAY_STD_ERR`].
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

/// The grey value at a position in pixels, bilinear; `None` outside the image.
fn gray_at(gray: &Image, [x, y]: [f32; 2]) -> Option<f32> {
    let (w, h) = (gray.width(), gray.height());
    // Also false for NaN.
    if !(x >= 0.0 && y >= 0.0 && x < w as f32 && y < h as f32) {
        return None;
    }
    let [value] = sample(gray, x, y, Sampling::Bilinear);
    Some(value)
}
