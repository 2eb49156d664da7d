//! Estimation of the inverse depths of one camera, from its own image and the images of its partners, which are the
//! cameras that it is matched with.

use super::census::{CensusImage, census_pyramid, halved};
use super::cost_volume::{DepthLevels, StereoSet, cost_volume, upsampled};
use super::refine::refine;
use super::semi_global::{aggregate, winner_takes_all};
use super::{StereoImage, StereoOptions};
use crate::camera::Camera;
use crate::lumigraph::DepthMap;
use rayon::prelude::*;

/// Maximum difference between two cameras' measurements of one surface point, as a multiple of the difference between
/// successive depth levels.
const TOLERANCE_LEVELS: f32 = 1.5;
/// Maximum distance between a camera and a partner, which is a camera that it is matched with, as a multiple of the
/// nearest partner's distance.
const MAX_PARTNER_DISTANCE: f64 = 2.5;
/// Maximum number of elements of a cost volume, which is the number of pixels times the number of depth levels. Each
/// element takes three bytes.
const MAX_COSTS: usize = 1 << 26;

/// Inverse depths of a camera's pixels, with their tolerance.
#[derive(Clone, Debug, PartialEq)]
pub struct InverseDepths {
    /// Inverse depths of the pixels, 1/m, row by row; NaN where unknown.
    pub values: Vec<f32>,
    /// Maximum difference between two cameras' measurements of one surface point, 1/m.
    pub tolerance: f32,
}

impl InverseDepths {
    /// Returns the camera's depth map, metres.
    pub fn depth_map(&self, camera: &Camera) -> DepthMap {
        let depths = self.values.iter().map(|v| 1.0 / v).collect();
        DepthMap::from_data(camera.width, camera.height, depths)
    }
}

/// Stereo matcher: the images of several cameras at one instant, prepared for matching.
pub struct Matcher {
    /// Image pyramid of each camera, from fine to coarse.
    pyramids: Vec<Vec<CensusImage>>,
    /// For each camera, the indices of the cameras that it is matched with, nearest first.
    partners: Vec<Vec<usize>>,
    step_px: f64,
}

impl Matcher {
    /// Prepares images for matching: chooses the partners of each camera, and computes image pyramids and descriptors.
    /// `range` is the minimum and the maximum inverse depth in any camera, 1/m.
    pub fn new(views: &[StereoImage], range: [f64; 2], options: &StereoOptions) -> Self {
        let cameras: Vec<&Camera> = views.iter().map(|v| v.camera).collect();
        let partners: Vec<Vec<usize>> =
            (0..views.len()).map(|k| partners(&cameras, k, options.partners)).collect();
        let halvings = halvings(&cameras, &partners, range, options);
        let pyramids = views.par_iter().map(|v| census_pyramid(v, halvings)).collect();
        Self { pyramids, partners, step_px: options.step_px }
    }

    /// Estimates the inverse depths of camera `index`. `range` is their minimum and maximum, 1/m. `None` if all other
    /// cameras have the same centre as this camera, or if there are none.
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

/// Returns the indices of the cameras with which camera `index` is matched: the `count` nearest cameras at another
/// place. Cameras farther than [`MAX_PARTNER_DISTANCE`] times the nearest are left out.
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

/// Returns the number of times that all images are halved before matching. It is the number in the options, or a larger
/// number if a cost volume would otherwise have more than [`MAX_COSTS`] elements. Halving stops when an image can't be
/// halved again.
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

/// Returns the depth levels for the camera `own`, which cover the inverse depths `range`, 1/m. `farthest` is the most
/// distant camera with which `own` is matched. In its image, successive levels differ by a disparity of `step_px`
/// pixels.
fn depth_levels(own: &Camera, farthest: &Camera, range: [f64; 2], step_px: f64) -> DepthLevels {
    let baseline = (farthest.center() - own.center()).norm();
    DepthLevels::new(range, step_px / (own.focal_px() * baseline))
}
