//! Temporal integration (Fig. 1): how far a picture reaches back in time.

use crate::method::methods;
use serde::{Deserialize, Serialize};

/// How far an image reaches back in time.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct TrailOptions {
    /// Length of the trail before the instant, seconds; 0: none.
    pub duration_s: f64,
    /// Instants that are overlaid, evenly spaced, the trail's first and last included. Fewer show
    /// as separate images of what moves, more cost time in proportion.
    pub instants: usize,
    pub mode: TrailMode,
}

/// How the instants of a trail make one image.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum TrailMode {
    /// The mean of the light, as a long exposure has it
    #[default]
    Mean,
    /// The brightest value: highlights leave full streaks
    Lighten,
}

methods!(TrailMode {
    Mean = "mean": "The mean of the light, as a long exposure has it",
    Lighten = "lighten": "The brightest value: highlights leave full streaks",
});

impl Default for TrailOptions {
    fn default() -> Self {
        Self { duration_s: 0.0, instants: 16, mode: TrailMode::Mean }
    }
}

impl TrailOptions {
    /// The instants of a trail that ends at a time, seconds, the last one first. Only that one
    /// without a duration, or with one instant.
    pub(crate) fn instants_s(&self, time_s: f64) -> Vec<f64> {
        if self.duration_s <= 0.0 || self.instants < 2 {
            return vec![time_s];
        }
        let step_s = self.duration_s / (self.instants - 1) as f64;
        (0..self.instants).map(|k| time_s - step_s * k as f64).collect()
    }

    /// How many instants an image has.
    pub fn count(&self) -> usize {
        self.instants_s(0.0).len()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn instants_reach_back_from_the_last() {
        let trail = TrailOptions { duration_s: 0.3, instants: 4, mode: TrailMode::Mean };
        let instants = trail.instants_s(1.0);
        assert_eq!(instants[0], 1.0);
        for (found, expected) in instants.iter().zip([1.0, 0.9, 0.8, 0.7]) {
            assert!((found - expected).abs() < 1e-12);
        }
        assert_eq!(TrailOptions { duration_s: 0.0, ..trail.clone() }.instants_s(1.0), [1.0]);
        assert_eq!(TrailOptions { instants: 1, ..trail.clone() }.instants_s(1.0), [1.0]);
        assert_eq!(TrailOptions { instants: 0, ..trail }.count(), 1);
    }
}
