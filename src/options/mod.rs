//! The options of rendering: the method of each stage, and the methods' parameters. Together with the capture, the
//! viewpoint and the instant, they determine a rendered image.
//!
//! | options | content | read by |
//! |---|---|---|
//! | [`RenderOptions`] | all options, in the form of an options file | the programs' entry points, [`crate::light_field::render()`] |
//! | [`AutoOptions`] | which methods are chosen by measurements of the capture | [`crate::plan`] |

mod groups;
mod parse;
mod presets;

pub use crate::option::OptionError;
pub use groups::{AutoOptions, ProxyMethod, ProxyOptions, TrailMode, TrailOptions};
pub use presets::Preset;

use crate::interpolation::{InterpolationOptions, SyncMethod};
use crate::lumigraph::BlendOptions;
use crate::method::Method;
use crate::offset::OffsetOptions;
use crate::option::{DeclaredOption, OptionValue, options, options_schema};
use crate::registration::RegistrationOptions;
use serde_json::{Value, json};

options! {
    /// The options of all stages, structured like an options file, which is a JSON object. Missing fields have their
    /// defaults, and unknown fields are errors.
    pub struct RenderOptions {
        /// The method that makes a camera's image at an instant between its frames, if auto.sync is false.
        sync: SyncMethod = SyncMethod::Refined,
        /// Options of the geometry proxy (§6).
        proxy: ProxyOptions,
        /// Options of image registration (§4).
        registration: RegistrationOptions,
        /// Options of the temporal offsets (§7), which are estimated when a light field is opened.
        offset: OffsetOptions,
        /// Options of temporal interpolation (§5).
        interpolation: InterpolationOptions,
        /// Options of blending the cameras' images (§6).
        blend: BlendOptions,
        /// Options of temporal integration, which only [`crate::light_field::render()`] uses.
        trail: TrailOptions,
        /// Options of the automatic choice of methods. For the stages that are chosen automatically, the methods above
        /// are ignored.
        auto: AutoOptions,
    }
}

impl RenderOptions {
    /// Returns these options with `sync` as the method that synchronizes the cameras' images.
    #[must_use]
    pub fn with_sync(self, sync: SyncMethod) -> Self {
        Self { sync, ..self }
    }

    /// Returns all options, each with its declaration and with its value in `self`.
    pub fn declared(&self) -> Vec<DeclaredOption> {
        let mut options = Vec::new();
        self.declare(&Self::default(), DeclaredOption::default(), &mut options);
        options
    }

    /// Returns the JSON Schema of an options file.
    pub fn schema() -> Value {
        let mut schema = options_schema(&Self::default().declared());
        schema["$schema"] = json!("https://json-schema.org/draft/2020-12/schema");
        schema["title"] = json!("stlfr options");
        schema["properties"]["preset"] = json!({
            "description": "The preset that supplies what the file leaves out.",
            "enum": Preset::names(),
        });
        schema
    }

    /// Returns an error if a value is out of its range. Options that come from a file, the command line or Python must
    /// be checked with this function.
    pub fn check(&self) -> Result<(), OptionError> {
        self.declared().iter().try_for_each(DeclaredOption::check)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lumigraph::BlendMethod;
    use crate::offset::OffsetMethod;
    use crate::option::OptionKind;
    use serde::Serialize;

    /// Checks that a method's name in options files equals its name on the command line and in Python.
    fn named_as_in_files<M: Method + Serialize + std::fmt::Debug>() {
        assert!(!M::ALL.is_empty());
        for &method in M::ALL {
            assert_eq!(serde_json::to_value(method).unwrap(), method.name());
            assert_eq!(M::from_name(method.name()), Some(method));
            assert!(!method.help().is_empty() && !method.help().ends_with('.'));
        }
        assert_eq!(M::from_name("no-such-method"), None);
    }

    #[test]
    fn methods_have_the_names_of_option_files() {
        named_as_in_files::<SyncMethod>();
        named_as_in_files::<ProxyMethod>();
        named_as_in_files::<BlendMethod>();
        named_as_in_files::<OffsetMethod>();
        named_as_in_files::<TrailMode>();
        named_as_in_files::<Preset>();
    }

    /// Appends the paths of all leaves of a JSON value to `found`.
    fn leaves(value: &Value, path: &str, found: &mut Vec<String>) {
        match value {
            Value::Object(fields) => {
                for (name, value) in fields {
                    let dot = if path.is_empty() { "" } else { "." };
                    leaves(value, &format!("{path}{dot}{name}"), found);
                }
            }
            _ => found.push(path.to_owned()),
        }
    }

    #[test]
    fn every_option_is_declared() {
        let json = serde_json::to_value(RenderOptions::default()).unwrap();
        let mut paths = Vec::new();
        leaves(&json, "", &mut paths);
        let options = RenderOptions::default().declared();
        let mut names: Vec<String> = options.iter().map(|o| o.name.clone()).collect();
        names.sort();
        paths.sort();
        assert_eq!(names, paths);
        assert!(names.len() <= 40, "{names:?}");
        for option in &options {
            let DeclaredOption { name, help, kind, .. } = option;
            assert!(help.len() > 10 && help.len() < 200, "{name}: {help}");
            assert!(help.ends_with('.') && !help.contains(['`', '[']), "{name}: {help}");
            let is_number = matches!(kind, OptionKind::Number | OptionKind::Integer);
            assert_eq!(is_number, option.range.is_some() && option.unit.is_some(), "{name}");
            assert_eq!(*kind == OptionKind::Choice, !option.choices.is_empty(), "{name}");
            assert_eq!(option.default, option.value, "{name}");
            assert_eq!(json.pointer(&pointer(name)), Some(&option.default), "{name}");
            assert_eq!(option.check(), Ok(()));
        }
    }

    fn pointer(name: &str) -> String {
        format!("/{}", name.replace('.', "/"))
    }

    #[test]
    fn numbers_out_of_range_are_refused_by_name() {
        let mut json = serde_json::to_value(RenderOptions::default()).unwrap();
        for option in RenderOptions::default().declared() {
            let Some([min, max]) = option.range else { continue };
            let mut error = |value: Value| {
                let old = json.pointer_mut(&pointer(&option.name)).unwrap();
                let old = std::mem::replace(old, value);
                let options = serde_json::from_value::<RenderOptions>(json.clone());
                *json.pointer_mut(&pointer(&option.name)).unwrap() = old;
                // Serde rejects negative counts.
                options.ok().map(|options| options.check().map_err(|e| e.to_string()))
            };
            let integer = option.kind == OptionKind::Integer;
            let number = |v: f64| if integer { json!(v as i64) } else { json!(v) };
            for limit in [min, max] {
                assert_eq!(error(number(limit)), Some(Ok(())), "{}", option.name);
            }
            for beyond in [min - 1.0, 2.0 * max + 1.0] {
                let Some(error) = error(number(beyond)) else { continue };
                let error = error.unwrap_err();
                assert!(error.starts_with(&format!("{}: is ", option.name)), "{error}");
                assert!(error.ends_with(&format!("must be from {min:?} to {max:?}")), "{error}");
            }
        }
    }

    #[test]
    fn nan_is_in_no_range() {
        let mut options = RenderOptions::default();
        options.trail.duration_s = f64::NAN;
        let error = options.check().unwrap_err().to_string();
        assert_eq!(error, "trail.duration_s: is NaN, must be from 0.0 to 1000000.0");
    }

    /// Returns whether a schema allows a value. Only the JSON Schema keywords that occur in the options' schema are
    /// checked.
    fn allows(schema: &Value, value: &Value) -> bool {
        let is_of = |kind: &Value| match kind.as_str().unwrap() {
            "object" => value.is_object(),
            "number" => value.is_number(),
            "integer" => value.is_u64(),
            "boolean" => value.is_boolean(),
            "string" => value.is_string(),
            "null" => value.is_null(),
            kind => panic!("{kind}"),
        };
        let is_typed = match &schema["type"] {
            Value::Array(kinds) => kinds.iter().any(is_of),
            Value::Null => true,
            kind => is_of(kind),
        };
        let is_listed = schema["enum"].as_array().is_none_or(|names| names.contains(value));
        let within = value.as_f64().is_none_or(|v| {
            schema["minimum"].as_f64().is_none_or(|min| min <= v)
                && schema["maximum"].as_f64().is_none_or(|max| v <= max)
        });
        let fields = value.as_object().into_iter().flatten();
        let mut fields = fields.map(|(name, value)| (schema["properties"].get(name), value));
        let are_known = fields.all(|(schema, value)| schema.is_some_and(|s| allows(s, value)));
        is_typed && is_listed && within && are_known
    }

    #[test]
    fn the_schema_allows_all_presets_and_nothing_else() {
        let schema = RenderOptions::schema();
        for preset in Preset::ALL {
            let options = serde_json::to_value(preset.options()).unwrap();
            assert!(allows(&schema, &options));
        }
        assert!(allows(&schema, &json!({"preset": "draft", "proxy": {"plane_depth_m": 2}})));
        for wrong in [
            json!({"preset": "worst"}),
            json!({"trails": {}}),
            json!({"trail": {"instants": 0}}),
            json!({"trail": {"instants": 1.5}}),
            json!({"trail": {"mode": 3}}),
            json!({"proxy": {"plane_depth_m": "far"}}),
            json!([]),
        ] {
            assert!(!allows(&schema, &wrong), "{wrong}");
        }
    }
}
