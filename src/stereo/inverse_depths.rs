//! Inverse depths of one camera, from its own image and those of its partners, the cameras that it is matched
//! with.

use super::census::{CensusImage, census_pyramid, halved};
use super::cost_volume::{DepthLevels, StereoSet, cost_volume, upsampled};
use super::refine::refine;
use super::semi_global::{aggregate, winner_takes_all};
use super::{StereoImage, StereoOptions};
use crate::camera::Camera;
use crate::lumigraph::DepthMap;
use rayon::prelude::*;

/// Maximum difference between two cameras' measurements of one surface point, depth levels.
const TOLERANCE_LEVELS: f32 = 1.5;
/// Maximum distance of a camera that a camera is matched with (its partner), as a multiple of the nearest partner's
/// distance.
const MAX_PARTNER_DISTANCE: f64 = 2.5;
/// Maximum size of a cost volume, pixels times levels; each element takes three bytes.
const MAX_COSTS: usize = 1 << 26;

/// Inverse depths of a camera's pixels, row by row; NaN where unknown.
#[derive(Clone, Debug, PartialEq)]
pub struct InverseDepths {
    /// Inverse depths, 1/m.
    pub values: Vec<f32>,
    /// Maximum difference between two cameras' measurements of one surface point, 1/m.
    pub tolerance: f32,
}

impl InverseDepths {
    /// The depths along the camera's axis, metres.
    pub fn depth_map(&self, camera: &Camera) -> DepthMap {
        let depths = self.values.iter().map(|v| 1.0 / v).collect();
        DepthMap::from_data(camera.width, camera.height, depths)
    }
}

/// The images of several cameras at one instant, prepared for matching.
pub struct Matcher {
    /// The pyramid of each image, from fine to coarse.
    pyramids: Vec<Vec<CensusImage>>,
    /// Indices of each camera's partners, nearest first.
    partners: Vec<Vec<usize>>,
    step_px: f64,
}

impl Matcher {
    /// Computes the images' descriptors. `range` is the minimum and maximum inverse depth in any camera, 1/m.
    pub fn new(views: &[StereoImage], range: [f64; 2], options: &StereoOptions) -> Self {
        let cameras: Vec<&Camera> = views.iter().map(|v| v.camera).collect();
        let partners: Vec<Vec<usize>> =
            (0..views.len()).map(|k| partners(&cameras, k, options.partners)).collect();
        let halvings = halvings(&cameras, &partners, range, options);
        let pyramids = views.par_iter().map(|v| census_pyramid(v, halvings)).collect();
        Self { pyramids, partners, step_px: options.step_px }
    }

    /// Estimates the inverse depths of camera `index`, within the minimum and maximum `range`, 1/m. `None` if
    /// no other camera stands at another place.
    pub fn depths(&self, index: usize, range: [f64; 2]) -> Option<InverseDepths> {
        let (reference, partners) = (&self.pyramids[index], &self.partners[index]);
        let set = |k: usize| {
            let partners = partners.iter().map(move |&p| &self.pyramids[p][k]);
            StereoSet::new(&reference[k], partners)
        };
        let coarsest = reference.len() - 1;
        let coarse = set(coarsest);
        let farthest = &coarse.partners.last()?.image.camera;
        let levels = depth_levels(&coarse.image.camera, farthest, range, self.step_px);
        let costs = cost_volume(&coarse, &levels);
        let sums = aggregate(&costs, &coarse.image.gray, levels.count);
        let mut values = winner_takes_all(&sums, &levels);
        let mut step = levels.step;
        refine(&mut values, &coarse, step);
        for k in (0..coarsest).rev() {
            let fine = set(k);
            values = upsampled(&values, &reference[k + 1].camera, &fine);
            step *= 0.5;
            refine(&mut values, &fine, step);
        }
        Some(InverseDepths { values, tolerance: TOLERANCE_LEVELS * levels.step })
    }
}

/// The cameras with which camera `index` is matched: the `count` nearest ones at another place, except those
/// that are much farther than the nearest.
fn partners(cameras: &[&Camera], index: usize, count: usize) -> Vec<usize> {
    let center = cameras[index].center();
    let distance = |k: &usize| (cameras[*k].center() - center).norm();
    let mut order: Vec<usize> = (0..cameras.len()).filter(|k| distance(k) > 0.0).collect();
    // The sort is stable, so that equally distant cameras keep their order.
    order.sort_by(|a, b| distance(a).total_cmp(&distance(b)));
    let limit = order.first().map_or(0.0, |k| MAX_PARTNER_DISTANCE * distance(k));
    order.retain(|k| distance(k) <= limit);
    order.truncate(count.max(1));
    order
}

/// The number of times that all images are halved: at least that of the options, and so many that every cost
/// volume has at most [`MAX_COSTS`] elements.
fn halvings(
    cameras: &[&Camera],
    partners: &[Vec<usize>],
    range: [f64; 2],
    options: &StereoOptions,
) -> usize {
    let mut images: Vec<Camera> = cameras.iter().map(|c| (*c).clone()).collect();
    let mut halvings = 0;
    loop {
        let costs = |(own, partners): (&Camera, &Vec<usize>)| {
            let levels = depth_levels(own, cameras[*partners.last()?], range, options.step_px);
            Some((own.width * own.height).saturating_mul(levels.count))
        };
        let max_costs = images.iter().zip(partners).filter_map(costs).max().unwrap_or(0);
        if halvings >= options.halvings && max_costs <= MAX_COSTS {
            return halvings;
        }
        let Some(smaller) = images.iter().map(halved).collect() else { return halvings };
        images = smaller;
        halvings += 1;
    }
}

/// The depth hypotheses of a camera, at steps of `step_px` of disparity in its farthest partner.
fn depth_levels(own: &Camera, farthest: &Camera, range: [f64; 2], step_px: f64) -> DepthLevels {
    let baseline = (farthest.center() - own.center()).norm();
    DepthLevels::new(range, step_px / (own.focal_px() * baseline))
}
