//! Three points on the trade of speed for accuracy, by name.

use super::{AutoOptions, RenderOptions};
use crate::interpolation::SyncMethod;
use crate::json;
use crate::method::methods;
use serde::{Deserialize, Serialize};
use serde_json::Value;

/// Options of all stages by name, cheapest first. `cargo bench --bench tradeoff` compares them with
/// other combinations; `tests/bench/README.md` has their figures.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Preset {
    /// To look around: the fastest that still synchronizes.
    Draft,
    /// Most of the accuracy for some of the time.
    Balanced,
    /// The most accurate methods that pay on the capture.
    #[default]
    Best,
}

methods!(Preset {
    Draft = "draft": "To look around: the fastest that still synchronizes",
    Balanced = "balanced": "Most of the accuracy for some of the time",
    Best = "best": "The most accurate that the capture shows to pay",
});

impl Preset {
    /// The preset's options of all stages. All register alike, so that frames that are prepared for one are
    /// prepared for all.
    pub fn options(self) -> RenderOptions {
        let mut options = RenderOptions::default();
        match self {
            Self::Draft => {
                options.sync = SyncMethod::Triangulation;
                (options.proxy.cameras, options.proxy.partners) = (1, 2);
                options.blend.cameras = 1;
            }
            Self::Balanced => {
                options.sync = SyncMethod::Triangulation;
                (options.proxy.cameras, options.proxy.partners) = (2, 2);
                options.blend.cameras = 2;
            }
            Self::Best => {
                options.auto = AutoOptions::all();
                options.blend.cameras = 4;
            }
        }
        options
    }
}

impl RenderOptions {
    /// Options as a file has them: a JSON object. What it leaves out is as in the preset, the given
    /// one or else that of its field `preset`, or the default.
    ///
    /// The error is a sentence that starts with the field.
    pub fn parse(text: &str, preset: Option<Preset>) -> Result<Self, String> {
        let Value::Object(mut over) = json::parse(text)? else {
            return Err("must be an object".into());
        };
        let named = over.remove("preset");
        if preset.is_none() && named.is_none() {
            return json::parse(text);
        }
        let named = named.map(|name| json::parse(&format!("{{\"preset\": {name}}}")));
        let named: Option<Named> = named.transpose()?;
        let start = preset.or(named.map(|n| n.preset)).map_or_else(Self::default, Preset::options);
        let mut merged = serde_json::to_value(start).map_err(|e| e.to_string())?;
        name_methods(&mut over);
        merge(&mut merged, &Value::Object(over));
        json::parse(&merged.to_string())
    }
}

/// The field of an options file that none of the stages has.
#[derive(Deserialize)]
struct Named {
    preset: Preset,
}

/// Files of earlier versions call a stage's `method` its `rung`. What is merged has one name only.
fn name_methods(over: &mut serde_json::Map<String, Value>) {
    for stage in ["proxy", "blend", "offset"] {
        if let Some(Value::Object(fields)) = over.get_mut(stage)
            && !fields.contains_key("method")
            && let Some(method) = fields.remove("rung")
        {
            fields.insert("method".into(), method);
        }
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
    use crate::method::Method;

    #[test]
    fn all_presets_can_be_worked_with_and_differ() {
        let all: Vec<_> = Preset::ALL.iter().map(|p| p.options()).collect();
        for (k, options) in all.iter().enumerate() {
            assert_eq!(options.check(), Ok(()));
            assert!(!all[..k].contains(options));
        }
        for preset in Preset::ALL {
            assert_eq!(Preset::from_name(preset.name()), Some(*preset));
        }
    }

    #[test]
    fn all_presets_register_alike() {
        let first = Preset::Draft.options().registration;
        assert!(Preset::ALL.iter().all(|p| p.options().registration == first));
    }

    #[test]
    fn options_go_before_the_preset() {
        let mut wanted = Preset::Draft.options();
        wanted.blend.cameras = 5;
        let text = r#"{"blend": {"cameras": 5}}"#;
        assert_eq!(RenderOptions::parse(text, Some(Preset::Draft)), Ok(wanted.clone()));
        let text = r#"{"preset": "draft", "blend": {"cameras": 5}}"#;
        assert_eq!(RenderOptions::parse(text, None), Ok(wanted));
        let text = r#"{"preset": "draft"}"#;
        assert_eq!(RenderOptions::parse(text, None), Ok(Preset::Draft.options()));
        let best = RenderOptions::parse(text, Some(Preset::Best));
        assert_eq!(best, Ok(Preset::Best.options()));
        assert_eq!(RenderOptions::parse("{}", None), Ok(RenderOptions::default()));
    }

    #[test]
    fn the_field_that_is_wrong_is_named() {
        for preset in [None, Some(Preset::Draft)] {
            for (text, field) in [
                (r#"{"blend": {"camera": 5}}"#, "blend"),
                (r#"{"sync": 3}"#, "sync"),
                (r#"{"preset": "worst"}"#, "preset"),
                (r#"{"preset": {"a": 1}}"#, "preset"),
                ("[]", "must be an object"),
                ("{", "EOF"),
            ] {
                let message = RenderOptions::parse(text, preset).unwrap_err();
                assert!(message.starts_with(field), "{message}");
            }
        }
    }
}
