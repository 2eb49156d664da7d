//! Which options can be worked with. One table: outside it, a stage would divide by nothing, run
//! for hours, or take the machine's memory.

use super::RenderOptions;
use crate::interpolation::{EdgeOptions, InterpolationOptions, MorphOptions, RefineOptions};
use crate::option::{DeclaredOption, OptionError, OptionField, OptionValue};
use std::ops::RangeInclusive;

type Checked = Result<(), OptionError>;

/// Lengths in an image, pixels.
const PIXELS: RangeInclusive<f64> = 0.0..=1000.0;
/// Shares of something that may be larger than the whole.
const SHARE: RangeInclusive<f64> = 0.0..=100.0;

impl RenderOptions {
    pub(super) fn check_undeclared(&self) -> Checked {
        interpolation(&self.interpolation)
    }
}

/// Groups of options that are not yet declared by `options!`.
macro_rules! undeclared {
    ($($group:ty),*) => { $(
        impl OptionValue for $group {
            fn declare(&self, _: &Self, _: OptionField, _: &mut Vec<DeclaredOption>) {}
        }
    )* };
}
undeclared!(InterpolationOptions);

/// The options `prefix.name`, each with its value and the range that it must be in. NaN is in none.
fn all_within(prefix: &str, options: &[(&str, f64, RangeInclusive<f64>)]) -> Checked {
    match options.iter().find(|(_, value, range)| !range.contains(value)) {
        None => Ok(()),
        Some((name, value, range)) => Err(OptionError {
            field: format!("{prefix}.{name}"),
            value: *value,
            min: *range.start(),
            max: *range.end(),
        }),
    }
}

fn interpolation(o: &InterpolationOptions) -> Checked {
    all_within("interpolation", &[("still_change", f64::from(o.still_change), 0.0..=1.0)])?;
    edges(&o.edges)?;
    morph(&o.morph)?;
    refine(&o.refine)
}

fn edges(o: &EdgeOptions) -> Checked {
    all_within(
        "interpolation.edges",
        &[
            // Pairs of features that are tried: time and memory grow with its square.
            ("max_length_px", o.max_length_px, 0.0..=200.0),
            // Where every pair of features is an edge, their crossings take minutes and gigabytes.
            ("beta", o.beta, 0.0..=1.0),
            ("min_fitness", o.min_fitness, 0.01..=100.0),
            ("sample_step_px", o.sample_step_px, 0.25..=1000.0),
            ("max_length_change", o.max_length_change, SHARE),
            ("max_length_change_px", o.max_length_change_px, PIXELS),
            ("duplicate_angle_deg", o.duplicate_angle_deg, 0.0..=90.0),
            ("duplicate_distance_px", o.duplicate_distance_px, PIXELS),
        ],
    )
}

fn morph(o: &MorphOptions) -> Checked {
    all_within(
        "interpolation.morph",
        &[
            ("a", o.a, PIXELS),
            ("b", o.b, 0.0..=32.0),
            ("rho", o.rho, 0.0..=1.0),
            ("tau", o.tau, 0.0..=32.0),
            ("grid_px", o.grid_px as f64, 1.0..=256.0),
            ("tolerance_px", o.tolerance_px, 0.0..=1.0),
        ],
    )
}

fn refine(o: &RefineOptions) -> Checked {
    all_within(
        "interpolation.refine",
        &[
            ("window_radius_px", o.window_radius_px as f64, 0.0..=16.0),
            ("search_radius_px", o.search_radius_px, 0.0..=200.0),
            ("same_motion_px", o.same_motion_px, PIXELS),
            ("min_tracks", o.min_tracks as f64, 1.0..=1000.0),
            ("max_motions", o.max_motions as f64, 0.0..=32.0),
            ("min_difference", f64::from(o.min_difference), 0.0..=1.0),
            // A difference of 1 over the least softness is a weight of e^-1000, which is floored.
            ("softness", f64::from(o.softness), 0.001..=1.0),
            ("one_frame_cost", f64::from(o.one_frame_cost), 0.0..=1.0),
            ("outer_share", f64::from(o.outer_share), 0.0..=1.0),
            ("outer_slack", f64::from(o.outer_slack), 0.0..=1.0),
            ("outer_softness", f64::from(o.outer_softness), 0.001..=1.0),
        ],
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::Value;

    /// The paths of all numbers in a JSON value.
    fn numbers(value: &Value, path: &str, found: &mut Vec<String>) {
        match value {
            Value::Number(_) => found.push(path.to_owned()),
            Value::Object(fields) => {
                for (name, value) in fields {
                    numbers(value, &format!("{path}/{name}"), found);
                }
            }
            _ => {}
        }
    }

    /// Every option that is a number has a range, also one that is added later.
    #[test]
    fn every_number_has_a_range() {
        assert_eq!(RenderOptions::default().check(), Ok(()));
        let mut options = RenderOptions::default();
        options.proxy.plane_depth_m = Some(1.0);
        let json = serde_json::to_value(&options).unwrap();
        let mut paths = Vec::new();
        numbers(&json, "", &mut paths);
        assert!(paths.len() > 40, "{paths:?}");
        for path in paths {
            for extreme in [serde_json::json!(9_000_000_000_000_000_u64), serde_json::json!(-1.0)] {
                let mut changed = json.clone();
                *changed.pointer_mut(&path).unwrap() = extreme;
                // Counts can't be negative: serde refuses those.
                let Ok(changed) = serde_json::from_value::<RenderOptions>(changed) else {
                    continue;
                };
                let error = changed.check().expect_err(&path).to_string();
                assert!(error.starts_with(&path[1..].replace('/', ".")), "{error}");
            }
        }
    }
}
