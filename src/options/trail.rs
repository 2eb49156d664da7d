//! Temporal integration (Fig. 1): an image of a span of time before an instant.

use crate::method::methods;
use crate::option::options;
use serde::{Deserialize, Serialize};

/// How the instants of a trail make one image.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum TrailMode {
    /// The mean of the instants' light, as in a long exposure.
    #[default]
    Mean,
    /// The brightest of the instants' values, so that highlights leave full streaks.
    Lighten,
}

methods!(TrailMode {
    Mean = "mean": "The mean of the light, as a long exposure has it",
    Lighten = "lighten": "The brightest value: highlights leave full streaks",
});

options! {
    /// Temporal integration: a view is made of several instants that end at its own.
    pub struct TrailOptions {
        /// Length of the trail before the instant; 0: no trail.
        duration_s: f64 [0.0..=1e6, "s"] = 0.0,
        /// Evenly spaced instants that are overlaid, the first and the last included.
        instants: usize [1..=10_000, "instants"] = 16,
        /// How the instants make one image.
        mode: TrailMode = TrailMode::Mean,
    }
}

impl TrailOptions {
    /// The instants of a trail that ends at `time_s`, latest first. Without a trail, `time_s` alone.
    pub(crate) fn instants_s(&self, time_s: f64) -> Vec<f64> {
        if self.duration_s <= 0.0 || self.instants < 2 {
            return vec![time_s];
        }
        let step_s = self.duration_s / (self.instants - 1) as f64;
        (0..self.instants).map(|k| time_s - step_s * k as f64).collect()
    }

    /// Number of instants that make one view.
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
