//! Inverse depths between the levels, and how certain they are: Gauss-Newton steps (Lucas and Kanade 1981)
//! towards the inverse depth at which the partners' grey values are the camera's own.

use super::matching::Prepared;
use super::relative::Relative;
use crate::lumigraph::RayRow;
use crate::raster::{Image, Sampling, box_filter, sample};
use rayon::prelude::*;

/// Half the side of the window that a step is taken over, pixels. Larger: the depths of several surfaces are
/// averaged; smaller: noise.
const RADIUS: usize = 2;
/// Number of steps. Larger: time; smaller: depths stay near the levels.
const STEPS: usize = 2;
/// Longest step, levels. Larger: mismatches run away; smaller: depths stay near the levels.
const MAX_STEP: f32 = 0.75;
/// Largest difference of grey values, 0..=1, of a pixel that counts. Larger: what a partner doesn't see counts;
/// smaller: highlights leave nothing to measure by.
const MAX_DIFFERENCE: f32 = 0.06;
/// Standard error of a grey value, 0..=1: noise, resampling, and what synchronization leaves. Larger and
/// smaller: standard errors of depths are off in proportion.
const GRAY_STD_ERR: f32 = 0.01;
/// Information, of a standard error of one level, that every pixel has from its neighbours' smoothness. Larger:
/// depths stay near the levels; smaller: where the image is flat, noise decides.
const PRIOR: f32 = 4.0;

/// Refines inverse depths in place, 1/m, `level` apart; returns their standard errors, 1/m.
pub(super) fn refine(
    values: &mut [f32],
    reference: &Prepared,
    partners: &[&Prepared],
    level: f32,
) -> Vec<f32> {
    let (w, h) = (reference.camera().width, reference.camera().height);
    let prior = PRIOR / (level * level);
    let mut information = Vec::new();
    for _ in 0..STEPS {
        let sums = sums(values, reference, partners, level);
        let [slope, info, residual] = [0, 1, 2].map(|k| {
            let plane: Vec<f32> = sums.iter().map(|s| s[k]).collect();
            box_filter(&plane, w, h, RADIUS)
        });
        for ((value, slope), info) in values.iter_mut().zip(&slope).zip(&info) {
            // The prior is positive.
            let step = slope / (info + prior / WINDOW);
            *value += step.clamp(-MAX_STEP * level, MAX_STEP * level);
        }
        information = info.iter().zip(&residual).map(|(i, r)| i / r.max(1.0)).collect();
    }
    let least = (LEAST_STD_ERR * level).powi(2);
    information.iter().map(|i| ((i * WINDOW + prior).recip() + least).sqrt()).collect()
}

/// Smallest standard error, levels: slants within a window, resampling, and the pull towards the levels. Larger
/// and smaller: standard errors of well textured surfaces are too large and too small.
const LEAST_STD_ERR: f32 = 0.15;

/// Pixels of a window.
const WINDOW: f32 = ((2 * RADIUS + 1) * (2 * RADIUS + 1)) as f32;

/// At every pixel, the sums over the partners of g·r/σ² and g²/σ², with r the difference of the grey values and
/// g the change of the partner's with inverse depth; and the mean of r²/σ².
fn sums(values: &[f32], reference: &Prepared, partners: &[&Prepared], level: f32) -> Vec<[f32; 3]> {
    let camera = reference.camera();
    let w = camera.width;
    let relatives: Vec<Relative> =
        partners.iter().map(|p| Relative::new(camera, p.camera())).collect();
    let precision = GRAY_STD_ERR.powi(-2);
    let mut sums = vec![[0.0_f32; 3]; values.len()];
    sums.par_chunks_mut(w).enumerate().for_each_init(
        || RayRow::new(camera),
        |rays, (y, sums)| {
            rays.set(y);
            for (x, sum) in sums.iter_mut().enumerate() {
                let own = reference.gray().data()[y * w + x];
                let value = values[y * w + x];
                let ray = [rays.x[x] as f32, rays.y[x] as f32];
                let mut count = 0.0_f32;
                for (partner, relative) in partners.iter().zip(&relatives) {
                    // Half a level to both sides.
                    let turned = relative.turned(ray[0], ray[1]);
                    let at = |inverse: f32| {
                        gray_at(partner.gray(), relative.pixel(&relative.point(&turned, inverse)))
                    };
                    let (Some(low), Some(high)) =
                        (at(value - 0.5 * level), at(value + 0.5 * level))
                    else {
                        continue;
                    };
                    let (g, r) = ((high - low) / level, own - 0.5 * (low + high));
                    if r.abs() < MAX_DIFFERENCE {
                        *sum = [
                            sum[0] + precision * g * r,
                            sum[1] + precision * g * g,
                            sum[2] + precision * r * r,
                        ];
                        count += 1.0;
                    }
                }
                sum[2] /= count.max(1.0);
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
