//! Variance factors of standard errors, as in the adjustment of observations by least squares: by how much the maps of
//! different frames differ, relative to the standard errors from their images.
//!
//! The covariance of a single estimate knows neither what smoothness adds, nor what surfaces lack to be plane. Both depend
//! on the scene. The maps of other cameras, made from other patches, show both.

use super::agreements::{MAX_CONFIRMING_DT, MAX_DISPARITY_ERROR_PX};
use super::element::ElementErrors;
use super::flow_pixel::FlowPixel;
use super::geometry::Projection;
use super::map::{ElementMap, MappedFrame};
use super::timing::TimeBetween;
use super::uncertainty::PRIOR_ERRORS;

/// Distance between the pixels of a map that are compared with other maps, pixels.
const STEP_PX: usize = 4;
/// Maximum standard error of a compared element, as a fraction of the standard error without any image gradient. Where images
/// tell less, maps agree because neighbours and proposals do.
const MAX_ERROR: f32 = 0.5;
/// Minimum number of differences from which a factor is computed. With fewer, it is 1.
const MIN_DIFFERENCES: usize = 100;
/// Range of factors. It keeps standard errors positive where maps are equal.
const FACTORS: [f32; 2] = [0.1, 10.0];
/// Median of the absolute value of a normally distributed number, in standard deviations.
const NORMAL_MEDIAN: f32 = 0.6745;

/// Estimated map of a frame: before and after quantization, and standard errors from the images, row by row.
pub struct Estimated<'a> {
    pub mapped: MappedFrame<'a>,
    pub elements: &'a ElementMap,
    pub errors: &'a [ElementErrors],
}

/// Differences between a map and the others, in standard errors.
#[derive(Default)]
struct Differences {
    /// Of the disparity where nothing moves.
    still: Vec<f32>,
    /// Of the disparity of moving elements.
    moving: Vec<f32>,
    /// Of both components of the velocity of moving elements.
    velocity: Vec<f32>,
}

impl Differences {
    /// Adds the differences between two maps.
    fn add(&mut self, of: &Estimated, by: &Estimated) {
        let time = TimeBetween::new(of.mapped.frame, by.mapped.frame);
        let (own, other) = (of.mapped.map, by.mapped.map);
        let projection = Projection::new(&of.mapped.frame.view, &by.mapped.frame.view);
        let Some(projection) = projection.filter(|_| time.frames().abs() <= MAX_CONFIRMING_DT)
        else {
            return;
        };
        for y in (0..own.height).step_by(STEP_PX) {
            for k in (0..own.width).step_by(STEP_PX).map(|x| y * own.width + x) {
                let [x, y] = own.center(k);
                if of.elements.is_given(k) || !of.mapped.frame.films([x, y]) {
                    continue;
                }
                let e = own.element(&own.pixels()[k]);
                let dt = time.of_element(&e, (x, y), &projection);
                let ([u, v], there) = e.transferred(x, y, dt, &projection);
                let Some(n) = by.elements.index([u, v]) else { continue };
                if by.elements.is_given(n) || !by.mapped.frame.films([u, v]) {
                    continue;
                }
                let [cx, cy] = other.center(n);
                let found = other.element(&other.pixels()[n]).at(u - cx, v - cy);
                let apart_px = (there.inverse_depth - found.inverse_depth) * own.disparity_px;
                if apart_px.abs() > MAX_DISPARITY_ERROR_PX {
                    continue;
                }
                let is_moving = e.speed() > 0.0;
                let disparities = if is_moving { &mut self.moving } else { &mut self.still };
                let errors = [of.errors[k], by.errors[n]];
                let of_disparity = errors.map(|e| e.disparity_px);
                disparities.extend(in_errors(apart_px, of_disparity, PRIOR_ERRORS.disparity_px));
                if is_moving {
                    let of_velocity = errors.map(|e| e.velocity_px);
                    let apart = [0, 1].map(|c| there.velocity[c] - found.velocity[c]);
                    let apart =
                        apart.map(|px| in_errors(px, of_velocity, PRIOR_ERRORS.velocity_px));
                    self.velocity.extend(apart.into_iter().flatten());
                }
            }
        }
    }
}

/// Returns a difference between two elements in standard errors. `errors` are those of both elements, and `prior` that
/// without any image gradient. `None` if an element is hardly known.
fn in_errors(difference: f32, errors: [f32; 2], prior: f32) -> Option<f32> {
    let is_known = errors.iter().all(|&e| e > 0.0 && e < MAX_ERROR * prior);
    is_known.then(|| difference.abs() / errors[0].hypot(errors[1]))
}

/// Returns a standard error of which the part that comes from images is multiplied by a factor. `prior` is the standard error
/// without any image gradient.
fn scaled(error: f32, factor: f32, prior: f32) -> f32 {
    // Acceleration adds to the standard error of velocities, so that it may exceed that of the prior.
    if error >= prior {
        return error;
    }
    let of_prior = 1.0 / (prior * prior);
    // Positive, since the error is smaller than that of the prior; and finite.
    let of_images = 1.0 / (error * error).max(f32::MIN_POSITIVE) - of_prior;
    1.0 / (of_images / (factor * factor) + of_prior).sqrt()
}

/// Returns the standard errors of the elements of map `of`, multiplied by their variance factors. There is one factor for the
/// disparity where nothing moves, one for that of moving elements, and one for the velocity. What images don't tell isn't
/// scaled.
pub fn scaled_errors(all: &[Estimated], of: usize) -> Vec<ElementErrors> {
    let mut differences = Differences::default();
    let others = all.iter().enumerate().filter(|(k, _)| *k != of);
    others.for_each(|(_, by)| differences.add(&all[of], by));
    let Differences { still, moving, velocity } = differences;
    let [still, moving, velocity] = [still, moving, velocity].map(factor);
    let Estimated { mapped: MappedFrame { map, .. }, errors, .. } = &all[of];
    let scaled = |(pixel, errors): (&FlowPixel, &ElementErrors)| {
        let is_moving = map.element(pixel).speed() > 0.0;
        let by = if is_moving { moving } else { still };
        ElementErrors {
            disparity_px: scaled(errors.disparity_px, by, PRIOR_ERRORS.disparity_px),
            velocity_px: scaled(errors.velocity_px, velocity, PRIOR_ERRORS.velocity_px),
        }
    };
    map.pixels().iter().zip(*errors).map(scaled).collect()
}

/// Returns the factor of standard errors from differences in standard errors.
fn factor(mut differences: Vec<f32>) -> f32 {
    let middle = differences.len() / 2;
    if differences.len() < MIN_DIFFERENCES {
        return 1.0;
    }
    let (_, median, _) = differences.select_nth_unstable_by(middle, f32::total_cmp);
    (*median / NORMAL_MEDIAN).clamp(FACTORS[0], FACTORS[1])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_images_dont_tell_is_not_scaled() {
        assert!((scaled(0.01, 3.0, 2.0) - 0.03).abs() < 1e-4);
        assert_eq!(scaled(2.0, 0.1, 2.0), 2.0);
        assert!(scaled(1.9, 0.1, 2.0) < 1.0);
        assert_eq!(scaled(3.0, 0.1, 2.0), 3.0);
        assert!(scaled(0.0, 3.0, 2.0).is_finite() && scaled(0.0, 0.1, 2.0).is_finite());
        assert!((in_errors(-0.1, [0.03, 0.04], 2.0).expect("both are known") - 2.0).abs() < 1e-6);
        assert_eq!(in_errors(0.1, [0.03, 1.5], 2.0), None);
        assert_eq!(in_errors(0.1, [0.0, 0.03], 2.0), None);
    }

    #[test]
    fn a_factor_is_the_spread_and_one_where_little_is_known() {
        // Quantiles of a uniform distribution up to 2, whose median is 1.
        let spread: Vec<f32> = (0..1001).map(|k| 0.002 * k as f32).collect();
        assert!((factor(spread.clone()) - 1.0 / NORMAL_MEDIAN).abs() < 1e-3);
        assert_eq!(factor(spread[..50].to_vec()), 1.0);
        assert_eq!(factor(vec![0.0; 200]), FACTORS[0]);
        assert_eq!(factor(vec![1e9; 200]), FACTORS[1]);
    }
}
