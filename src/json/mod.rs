//! Reads JSON files into Rust types. An error is one sentence, which names the invalid field.

mod objects;

use crate::host::read_text;
use objects::Objects;
use serde::de::DeserializeOwned;
use serde_path_to_error::Segment;
use std::path::Path;

/// Default size limit of a JSON file, bytes. It suffices for the time stamps of a hundred cameras over twenty minutes.
/// Parsing such a file takes up to a gigabyte of memory.
pub const MAX_BYTES: u64 = 64 << 20;

/// Reason why a file can't be read as JSON. The caller adds the file's name to the message.
#[derive(Debug, thiserror::Error)]
pub enum JsonError {
    #[error(transparent)]
    Read(#[from] std::io::Error),
    /// The contents are invalid. The sentence starts with the field, if the field is known.
    #[error("{0}")]
    Content(String),
}

/// Reads a value from a JSON file: a regular file of at most [`MAX_BYTES`].
pub fn read<T: DeserializeOwned>(path: &Path) -> Result<T, JsonError> {
    read_within(path, MAX_BYTES)
}

/// Reads a value from a JSON file: a regular file of at most `max_bytes`.
pub fn read_within<T: DeserializeOwned>(path: &Path, max_bytes: u64) -> Result<T, JsonError> {
    parse(&read_text(path, max_bytes)?).map_err(JsonError::Content)
}

/// Parses a value from JSON text. A list in place of a struct's object is an error.
///
/// # Errors
/// A sentence that starts with the invalid field, if the field is known.
pub fn parse<T: DeserializeOwned>(text: &str) -> Result<T, String> {
    let mut deserializer = serde_json::Deserializer::from_str(text);
    let value = serde_path_to_error::deserialize(Objects(&mut deserializer));
    let value = value.map_err(|error| refusal(&error))?;
    deserializer.end().map_err(|e| e.to_string())?;
    Ok(value)
}

/// Words in serde's error messages that name Rust's number types, and the plain words that replace them.
const NUMBERS: [(&str, &str); 5] = [
    ("expected usize", "expected a whole number of 0 or more"),
    ("expected u64", "expected a whole number of 0 or more"),
    ("expected u32", "expected a whole number of 0 or more"),
    ("expected f64", "expected a number"),
    ("expected f32", "expected a number"),
];

/// Returns the sentence that describes a parsing error. The sentence of a syntax error outside of all fields starts
/// with "is no JSON".
fn refusal(error: &serde_path_to_error::Error<serde_json::Error>) -> String {
    let sentence = error.to_string();
    let is_syntax = error.inner().is_syntax() || error.inner().is_eof();
    let is_placed = |s: &Segment| !matches!(s, Segment::Unknown);
    if is_syntax && !error.path().iter().any(is_placed) {
        return format!("is no JSON: {sentence}");
    }
    NUMBERS.iter().fold(sentence, |sentence, (from, to)| sentence.replace(from, to))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::options::RenderOptions;

    #[test]
    fn the_field_is_named() {
        for (text, field) in [
            (r#"{"registration": {"levels": -1}}"#, "registration.levels: "),
            (r#"{"blend": {"cameras": null}}"#, "blend.cameras: "),
            (r#"{"blend": {"cameras": 1e999}}"#, "blend.cameras: "),
            (r#"{"sync": "none"}"#, "sync: "),
        ] {
            let message = parse::<RenderOptions>(text).unwrap_err();
            assert!(message.starts_with(field), "{message}");
        }
        assert!(parse::<RenderOptions>("{} {}").unwrap_err().contains("trailing"));
        assert!(parse::<RenderOptions>("").is_err());
        let message = parse::<RenderOptions>("# stlfr").unwrap_err();
        assert!(message.starts_with("is no JSON: expected value"), "{message}");
        let message = parse::<RenderOptions>(r#"{"blend": {"cameras": "two"}}"#).unwrap_err();
        assert!(message.contains(r#"string "two", expected a whole number"#), "{message}");
    }

    #[test]
    fn a_list_is_no_object() {
        for (text, field) in [
            ("[]", "invalid type: sequence, expected an object"),
            (r#"{"registration": []}"#, "registration: invalid type: sequence"),
            (r#"{"trail": [3]}"#, "trail: invalid type: sequence"),
        ] {
            let message = parse::<RenderOptions>(text).unwrap_err();
            assert!(message.starts_with(field), "{message}");
        }
    }

    #[test]
    fn what_never_ends_is_not_read_to_its_end() {
        let endless = read::<RenderOptions>(Path::new("/dev/zero")).unwrap_err();
        assert!(endless.to_string().contains("is a device"), "{endless}");
    }
}
