//! Files of JSON, as every stage reads them: what is wrong is one sentence that names the field.

use serde::de::value::MapAccessDeserializer;
use serde::de::{Deserialize, DeserializeOwned, Deserializer, MapAccess, Visitor};
use std::io::Read;
use std::marker::PhantomData;
use std::path::Path;

/// Larger than any description of a capture (a hundred cameras' time stamps over a day are 200 MB);
/// what goes on beyond it is a device or a mistake, and is not read into memory.
const MAX_BYTES: u64 = 256 << 20;

/// Why a file could not be read as JSON. The caller's message names the file.
#[derive(Debug, thiserror::Error)]
pub enum JsonError {
    #[error(transparent)]
    Read(#[from] std::io::Error),
    /// Starts with the field, if it is known.
    #[error("{0}")]
    Content(String),
}

/// A value from a file.
pub fn read<T: DeserializeOwned>(path: &Path) -> Result<T, JsonError> {
    parse(&read_text(path)?).map_err(JsonError::Content)
}

/// A file's text.
pub fn read_text(path: &Path) -> Result<String, JsonError> {
    let mut text = String::new();
    std::fs::File::open(path)?.take(MAX_BYTES + 1).read_to_string(&mut text)?;
    if text.len() as u64 > MAX_BYTES {
        return Err(JsonError::Content(format!("is larger than {} MiB", MAX_BYTES >> 20)));
    }
    Ok(text)
}

/// A value from text; the error is a sentence that starts with the field.
pub fn parse<T: DeserializeOwned>(text: &str) -> Result<T, String> {
    let mut deserializer = serde_json::Deserializer::from_str(text);
    let value = serde_path_to_error::deserialize(&mut deserializer).map_err(|e| e.to_string())?;
    deserializer.end().map_err(|e| e.to_string())?;
    Ok(value)
}

/// A struct that stands as an object; serde alone takes a list of its fields' values too, which no
/// schema allows.
pub struct Object<T>(pub T);

impl<'de, T: Deserialize<'de>> Deserialize<'de> for Object<T> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Fields<T>(PhantomData<T>);
        impl<'de, T: Deserialize<'de>> Visitor<'de> for Fields<T> {
            type Value = T;
            fn expecting(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
                f.write_str("an object")
            }
            fn visit_map<A: MapAccess<'de>>(self, map: A) -> Result<T, A::Error> {
                T::deserialize(MapAccessDeserializer::new(map))
            }
        }
        deserializer.deserialize_map(Fields(PhantomData)).map(Object)
    }
}

/// For `deserialize_with`: an object and nothing else.
pub fn object<'de, T: Deserialize<'de>, D: Deserializer<'de>>(d: D) -> Result<T, D::Error> {
    Object::deserialize(d).map(|object| object.0)
}

/// For `deserialize_with`: a list of objects.
pub fn objects<'de, T: Deserialize<'de>, D: Deserializer<'de>>(d: D) -> Result<Vec<T>, D::Error> {
    Vec::<Object<T>>::deserialize(d).map(|list| list.into_iter().map(|o| o.0).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::options::RenderOptions;

    #[test]
    fn the_field_is_named() {
        for (text, field) in [
            (r#"{"registration": {"klt": {"levels": -1}}}"#, "registration.klt.levels: "),
            (r#"{"blend": {"feather_px": null}}"#, "blend.feather_px: "),
            (r#"{"blend": {"feather_px": 1e999}}"#, "blend.feather_px: "),
            (r#"{"sync": "none"}"#, "sync: "),
        ] {
            let message = parse::<RenderOptions>(text).unwrap_err();
            assert!(message.starts_with(field), "{message}");
        }
        assert!(parse::<RenderOptions>("{} {}").unwrap_err().contains("trailing"));
        assert!(parse::<RenderOptions>("").is_err());
    }

    #[test]
    fn what_never_ends_is_not_read_to_its_end() {
        let endless = read::<RenderOptions>(Path::new("/dev/zero")).unwrap_err();
        assert!(endless.to_string().contains("larger than"), "{endless}");
    }
}
