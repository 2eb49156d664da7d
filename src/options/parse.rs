//! Parsing of options from files and command lines. Given options override the options of a preset.

use super::{Preset, RenderOptions};
use crate::json;
use crate::text::most_similar;
use serde::Deserialize;
use serde_json::Value;

impl RenderOptions {
    /// Parses an options file, which is a JSON object. Missing options have the values of a preset. The preset is the
    /// argument `preset`, or else the preset named in the file's field `preset`, or else the default preset. If the
    /// file names the method of a stage, the automatic choice of this stage's method is turned off.
    ///
    /// The error is a sentence that starts with the path of the wrong field. A value out of its range is an error.
    pub fn parse(text: &str, preset: Option<Preset>) -> Result<Self, String> {
        let Value::Object(mut file) = json::parse(text)? else {
            return Err("must be an object".into());
        };
        let named = file.remove("preset");
        let named = named.map(|name| json::parse(&format!("{{\"preset\": {name}}}")));
        let named: Option<NamedPreset> = named.transpose()?;
        let start = preset.or(named.map(|n| n.preset)).unwrap_or_default().options();
        let mut merged = serde_json::to_value(start).map_err(|e| e.to_string())?;
        let file = Value::Object(file);
        for (method, auto) in CHOSEN {
            if let (Some(_), Some(auto)) = (file.pointer(method), merged.pointer_mut(auto)) {
                *auto = Value::Bool(false);
            }
        }
        merge(&mut merged, &file);
        Self::parse_whole(&merged.to_string())
    }

    fn parse_whole(text: &str) -> Result<Self, String> {
        let options: Self = json::parse(text)?;
        options.check().map_err(|error| error.to_string())?;
        Ok(options)
    }

    /// Sets the option with the path `name`, such as `blend.cameras`. `value` is JSON, but the name of a method needs
    /// no quotes. If `name` is a group, such as `proxy`, the group's method is set. If the method of a stage is set,
    /// the automatic choice of this stage's method is turned off.
    ///
    /// The error is a sentence that starts with the option's path.
    pub fn set(&mut self, name: &str, value: &str) -> Result<(), String> {
        let mut options = serde_json::to_value(&*self).map_err(|e| e.to_string())?;
        let method = format!("{name}.method");
        let pointer = |name: &str| format!("/{}", name.replace('.', "/"));
        let is_group = options.pointer(&pointer(&method)).is_some();
        let name = if is_group { method.as_str() } else { name };
        let names = option_names(&options);
        let option = options.pointer_mut(&pointer(name)).filter(|option| !option.is_object());
        let unknown = || {
            let similar = most_similar(name, names.iter().map(String::as_str));
            let similar = similar.map(|s| format!(" (similar: {s})")).unwrap_or_default();
            format!("{name}: no such option{similar}; stlfr options lists all")
        };
        let option = option.ok_or_else(unknown)?;
        *option = serde_json::from_str(value).unwrap_or_else(|_| Value::from(value));
        let chosen = CHOSEN.iter().find(|(method, _)| method[1..].replace('/', ".") == name);
        if let Some(auto) = chosen.and_then(|(_, auto)| options.pointer_mut(auto)) {
            *auto = Value::Bool(false);
        }
        // The position in the merged JSON text means nothing to the caller, and is removed from the message.
        let sentence = |error: String| match error.split_once(" at line 1 column ") {
            Some((sentence, _)) => sentence.to_owned(),
            None => error,
        };
        *self = Self::parse_whole(&options.to_string()).map_err(sentence)?;
        Ok(())
    }
}

/// Pairs of JSON pointers to options: the option that names the method of a stage, and the option that turns on the
/// automatic choice of this method.
const CHOSEN: [(&str, &str); 3] =
    [("/sync", "/auto/sync"), ("/proxy/method", "/auto/proxy"), ("/blend/method", "/auto/blend")];

/// Returns the paths of all options in a JSON object of options, such as `blend.cameras`.
fn option_names(options: &Value) -> Vec<String> {
    let Value::Object(fields) = options else { return Vec::new() };
    let names = fields.iter().flat_map(|(name, value)| match value {
        Value::Object(_) => {
            option_names(value).iter().map(|inner| format!("{name}.{inner}")).collect()
        }
        _ => vec![name.clone()],
    });
    names.collect()
}

/// The field `preset` of an options file, as a JSON object with this field alone.
#[derive(Deserialize)]
struct NamedPreset {
    preset: Preset,
}

/// Merges the JSON value `over` into `into`. Objects are merged field by field. Any other value of `over` replaces the
/// value in `into`.
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
        assert_eq!(RenderOptions::parse("{}", None), Ok(Preset::default().options()));
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
                ("{", "is no JSON: EOF"),
            ] {
                let message = RenderOptions::parse(text, preset).unwrap_err();
                assert!(message.starts_with(field), "{message}");
            }
        }
    }

    #[test]
    fn one_option_is_set_by_its_name() {
        let mut options = RenderOptions::default();
        for (name, value) in [
            ("sync", "nearest"),
            ("blend.cameras", "7"),
            ("proxy.plane_depth_m", "1.5"),
            ("auto.sync", "true"),
        ] {
            assert_eq!(options.set(name, value), Ok(()));
        }
        assert_eq!((options.sync.name(), options.blend.cameras), ("nearest", 7));
        assert_eq!((options.proxy.plane_depth_m, options.auto.sync), (Some(1.5), true));
        options.set("proxy.plane_depth_m", "null").unwrap();
        options.auto.proxy = true;
        options.set("proxy", "depth").unwrap();
        assert_eq!((options.proxy.method.name(), options.auto.proxy), ("depth", false));
        assert_eq!(options.proxy.plane_depth_m, None);
        let before = options.clone();
        for (name, value) in [
            ("blend.camera", "7"),
            ("trail", "{}"),
            ("blend.cameras", "many"),
            ("blend.cameras", "-1"),
            ("blend.cameras", "0"),
            ("blend.cameras", ""),
            ("sync", "no-such-method"),
            ("trail.duration_s", "NaN"),
        ] {
            let error = options.set(name, value).unwrap_err();
            assert!(error.starts_with(&format!("{name}: ")), "{error}");
            assert!(!error.contains("column"), "{error}");
            assert_eq!(options, before);
        }
        let error = options.set("blend.camera", "7").unwrap_err();
        assert!(error.contains("no such option (similar: blend.cameras);"), "{error}");
        let error = options.set("fog", "7").unwrap_err();
        assert!(error.contains("no such option; stlfr"), "{error}");
    }
}
