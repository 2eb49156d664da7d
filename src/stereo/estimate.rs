//! A camera's depths at an instant, from its own image and those of its neighbours.

use super::camera_image::CameraImage;
use super::levels::Levels;
use super::matching::{Prepared, costs, upsampled};
use super::options::StereoOptions;
use super::refine::refine;
use super::semi_global::aggregate;
use crate::camera::Camera;
use crate::lumigraph::DepthMap;
use rayon::prelude::*;

/// Inverse depths of a camera's pixels, row by row. NaN where nothing is known.
#[derive(Clone, Debug, PartialEq)]
pub struct InverseDepths {
    /// 1/m.
    pub values: Vec<f32>,
    /// Their standard errors, 1/m.
    pub std_err: Vec<f32>,
    /// How far apart two of the same surface may be, 1/m.
    pub tolerance: f32,
}

impl InverseDepths {
    /// The depths, metres.
    pub fn depth_map(&self, camera: &Camera) -> DepthMap {
        let depths = self.values.iter().map(|v| 1.0 / v).collect();
        DepthMap::from_data(camera.width, camera.height, depths)
    }
}

/// How far apart two of the same surface may be, levels. Larger: surfaces near each other become one;
/// smaller: slanted ones don't agree with themselves.
const TOLERANCE_LEVELS: f32 = 1.5;
/// A neighbour farther than this many times the nearest one's distance is no partner. Larger: the ends of a
/// line see other surfaces; smaller: they have one neighbour.
const FARTHEST_PARTNER: f64 = 2.5;
/// Largest number of costs, one a pixel and level: 64 MB of them, and twice as much of sums. Images with more
/// are halved. Larger: memory; smaller: thin things are missed in large images.
const MAX_COSTS: usize = 1 << 26;

/// The images of several cameras at one instant, prepared for comparison.
pub struct Matcher {
    /// By halvings of their size, then in the order given.
    prepared: Vec<Vec<Prepared>>,
}

impl Matcher {
    /// Prepares these images. `range` is that of the inverse depths that any of them will be asked for, 1/m.
    pub fn new(views: &[CameraImage], range: [f64; 2], options: &StereoOptions) -> Self {
        let full: Vec<Prepared> = views.par_iter().map(Prepared::new).collect();
        let mut matcher = Self { prepared: vec![full] };
        while matcher.halvings() < options.halvings
            || matcher.most_costs(range, options) > MAX_COSTS
        {
            let last = &matcher.prepared[matcher.halvings()];
            let Some(halved) = last.par_iter().map(Prepared::halved).collect() else { break };
            matcher.prepared.push(halved);
        }
        matcher
    }

    /// How often the coarsest images were halved.
    fn halvings(&self) -> usize {
        self.prepared.len() - 1
    }

    /// The most costs that one of the coarsest images has.
    fn most_costs(&self, range: [f64; 2], options: &StereoOptions) -> usize {
        let images = &self.prepared[self.halvings()];
        let costs = |k: usize| {
            let levels = self.levels(self.halvings(), k, range, options)?;
            let camera = images[k].camera();
            Some((camera.width * camera.height).saturating_mul(levels.count))
        };
        (0..images.len()).filter_map(costs).max().unwrap_or(0)
    }

    /// The levels of an image. `None` without a camera at another place.
    fn levels(
        &self,
        halvings: usize,
        index: usize,
        range: [f64; 2],
        options: &StereoOptions,
    ) -> Option<Levels> {
        let own = self.prepared[halvings][index].camera();
        let partners = self.partners(halvings, index, options.partners);
        let farthest = (partners.last()?.camera().center() - own.center()).norm();
        Some(Levels::new(range, options.step_px / (own.focal_px() * farthest)))
    }

    /// The depths of image `index`, of inverse depths in a range, 1/m. `None` without a camera at another
    /// place.
    pub fn depths(
        &self,
        index: usize,
        range: [f64; 2],
        options: &StereoOptions,
    ) -> Option<InverseDepths> {
        let coarsest = self.halvings();
        let levels = self.levels(coarsest, index, range, options)?;
        let reference = &self.prepared[coarsest][index];
        let partners = self.partners(coarsest, index, options.partners);
        let costs = costs(reference, &partners, &levels);
        let sums = aggregate(&costs, reference.gray(), levels.count);
        let mut values = winner_takes_all(&sums, &levels);
        let mut std_err = refine(&mut values, reference, &partners, levels.step);
        let mut step = levels.step;
        for halvings in (0..coarsest).rev() {
            let reference = &self.prepared[halvings][index];
            let partners = self.partners(halvings, index, options.partners);
            let coarse = self.prepared[halvings + 1][index].camera();
            values = upsampled(&values, coarse, reference, &partners);
            step *= 0.5;
            std_err = refine(&mut values, reference, &partners, step);
        }
        Some(InverseDepths { values, std_err, tolerance: TOLERANCE_LEVELS * levels.step })
    }

    /// The cameras that one is compared with, nearest first.
    fn partners(&self, halvings: usize, index: usize, count: usize) -> Vec<&Prepared> {
        let images = &self.prepared[halvings];
        let center = images[index].camera().center();
        let distance = |p: &Prepared| (p.camera().center() - center).norm();
        let mut order: Vec<&Prepared> = images.iter().filter(|p| distance(p) > 0.0).collect();
        // Stable, so that ties keep the cameras' order.
        order.sort_by(|a, b| distance(a).total_cmp(&distance(b)));
        let limit = order.first().map_or(0.0, |p| FARTHEST_PARTNER * distance(p));
        order.retain(|p| distance(p) <= limit);
        order.truncate(count.max(1));
        order
    }
}

/// The inverse depth of the least sum at every pixel, between levels by a parabola.
fn winner_takes_all(sums: &[i16], levels: &Levels) -> Vec<f32> {
    let n = levels.count;
    let of = |sums: &[i16]| {
        // First the least value, then its first place. Each search takes many levels at a time.
        let least = sums.iter().copied().min();
        let best = sums.iter().position(|sum| Some(*sum) == least).unwrap_or(0);
        let mut level = best as f32;
        if best > 0 && best + 1 < n {
            let [a, b, c] = [sums[best - 1], sums[best], sums[best + 1]].map(f32::from);
            // Not negative, because b is the least.
            let curvature = a - 2.0 * b + c;
            if curvature > 0.0 {
                level += 0.5 * (a - c) / curvature;
            }
        }
        levels.at(level)
    };
    sums.chunks_exact(n).map(of).collect()
}
