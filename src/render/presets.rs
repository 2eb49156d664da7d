//! Three points of the trade of speed for accuracy, by name.

use super::{ProxyRung, RenderOptions};
use crate::interpolation::Sync;
use crate::json;
use crate::lumigraph::Sampling;
use serde::{Deserialize, Serialize};
use serde_json::Value;

/// Options of all stages by name, cheapest first: points of the front that `stlfr tradeoff` finds
/// on the project's scenes (README has their figures).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "kebab-case")]
pub enum Preset {
    /// To look around: the fastest that still synchronizes
    Draft,
    /// Most of the accuracy for some of the time
    Balanced,
    /// The most accurate
    Best,
}

impl Preset {
    pub fn name(self) -> &'static str {
        match self {
            Self::Draft => "draft",
            Self::Balanced => "balanced",
            Self::Best => "best",
        }
    }

    pub fn options(self) -> RenderOptions {
        let mut options = RenderOptions::default();
        match self {
            Self::Draft => {
                options.sync = Sync::Triangulation;
                options.registration.corners.max_corners = 1000;
                options.proxy.rung = ProxyRung::Mesh;
                (options.proxy.cameras, options.proxy.partners) = (1, 2);
                options.blend.cameras = 2;
                options.blend.sampling = Sampling::Bilinear;
            }
            Self::Balanced => {
                options.sync = Sync::Triangulation;
                (options.proxy.cameras, options.proxy.partners) = (2, 2);
            }
            Self::Best => {}
        }
        options
    }

    /// The preset, with those options of a JSON object that it has in their place.
    ///
    /// The error is a sentence that starts with the field.
    pub fn with(self, over: &Value) -> Result<RenderOptions, String> {
        let mut merged = serde_json::to_value(self.options()).map_err(|e| e.to_string())?;
        merge(&mut merged, over);
        json::parse(&merged.to_string())
    }
}

/// Objects field by field; anything else is replaced.
fn merge(into: &mut Value, over: &Value) {
    match (into, over) {
        (Value::Object(into), Value::Object(over)) => {
            for (name, value) in over {
                merge(into.entry(name.clone()).or_insert(Value::Null), value);
            }
        }
        (into, over) => *into = over.clone(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::ValueEnum;
    use serde_json::json;

    #[test]
    fn all_presets_can_be_worked_with_and_differ() {
        let all: Vec<_> = Preset::value_variants().iter().map(|p| p.options()).collect();
        for (k, options) in all.iter().enumerate() {
            assert_eq!(options.check(), Ok(()));
            assert!(!all[..k].contains(options));
        }
        for preset in Preset::value_variants() {
            assert_eq!(Preset::from_str(preset.name(), false).as_ref(), Ok(preset));
        }
    }

    #[test]
    fn options_go_before_the_preset() {
        let merged = Preset::Draft.with(&json!({"blend": {"cameras": 5}})).unwrap();
        let mut wanted = Preset::Draft.options();
        wanted.blend.cameras = 5;
        assert_eq!(merged, wanted);
        assert_eq!(Preset::Best.with(&json!({})).unwrap(), Preset::Best.options());
        for (over, field) in [
            (json!({"blend": {"camera": 5}}), "blend"),
            (json!({"sync": 3}), "sync"),
            (json!([]), ""),
        ] {
            let message = Preset::Draft.with(&over).unwrap_err();
            assert!(message.starts_with(field), "{message}");
        }
    }
}
