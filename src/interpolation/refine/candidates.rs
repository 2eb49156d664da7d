//! The candidate motions around a point.

use crate::interpolation::local_motion::LocalMotion;
use crate::interpolation::{Motion, RefineOptions};
use crate::registration::Neighbors;
use nalgebra::Point2;

/// Finds the candidate motions around points.
pub struct Candidates {
    motions: Vec<Motion>,
    /// The motions' positions.
    neighbors: Neighbors,
    /// With lengths scaled to the image's size.
    options: RefineOptions,
}

impl Candidates {
    /// Of these motions. `options` have lengths scaled to the image's size.
    pub fn new(motions: Vec<Motion>, options: &RefineOptions) -> Self {
        let neighbors = Neighbors::new(motions.iter().map(|m| m.at));
        Self { neighbors, motions, options: options.clone() }
    }

    /// How many motions there are.
    pub fn count(&self) -> usize {
        self.motions.len()
    }

    /// The candidate motions around a point, nearest first: each fitted to tracks that move alike, weighted
    /// by nearness.
    pub fn around(&self, center: &Point2<f64>) -> Vec<LocalMotion> {
        let motions = &self.motions;
        let near = self.neighbors.nearest(center, usize::MAX, self.options.search_radius_px);
        let mut assigned = vec![false; near.len()];
        let mut candidates = Vec::new();
        for seed in 0..near.len() {
            if assigned[seed] || candidates.len() == self.options.max_motions {
                continue;
            }
            let own = &motions[near[seed]];
            let mut members = Vec::new();
            for k in seed..near.len() {
                // Between the middle frames, where tracks are most accurate.
                let distance_px = own.distance(&motions[near[k]]);
                if assigned[k] || distance_px > self.options.same_motion_px {
                    continue;
                }
                assigned[k] = true;
                members.push(&motions[near[k]]);
            }
            if members.len() >= self.options.min_tracks {
                candidates.extend(LocalMotion::fit(&members, center));
            }
        }
        candidates
    }
}
