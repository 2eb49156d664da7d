//! Writes rig files in a layout that is easy to read: three or four lines per camera.

use super::Rig;
use serde::Serialize;
use serde_json::ser::{Formatter, Serializer};
use std::io::{self, Write};

/// A JSON formatter that writes one line, with a space after every comma and colon.
struct Spaced;

impl Formatter for Spaced {
    fn begin_array_value<W: ?Sized + Write>(&mut self, w: &mut W, first: bool) -> io::Result<()> {
        if first { Ok(()) } else { w.write_all(b", ") }
    }
    fn begin_object_key<W: ?Sized + Write>(&mut self, w: &mut W, first: bool) -> io::Result<()> {
        if first { Ok(()) } else { w.write_all(b", ") }
    }
    fn begin_object_value<W: ?Sized + Write>(&mut self, w: &mut W) -> io::Result<()> {
        w.write_all(b": ")
    }
}

fn spaced(value: &impl Serialize) -> String {
    let mut bytes = Vec::new();
    // Serializing numbers, texts and lists to memory can't fail.
    let _ = value.serialize(&mut Serializer::with_formatter(&mut bytes, Spaced));
    String::from_utf8_lossy(&bytes).into_owned()
}

fn entries(list: &[impl Serialize]) -> String {
    let lines: Vec<String> = list
        .iter()
        .map(|entry| {
            let mut text = spaced(entry);
            // Each of these fields starts a new line.
            for field in ["distortion", "cam_from_rig", "rate_hz"] {
                let name = format!("\"{field}\": ");
                text = text.replacen(&format!(", {name}"), &format!(",\n      {name}"), 1);
            }
            format!("    {text}")
        })
        .collect();
    lines.join(",\n")
}

impl Rig {
    /// Returns the text of the rig file.
    pub fn to_json(&self) -> String {
        // The text before the cameras is that of a rig without cameras and views, cut off before its empty list of
        // cameras.
        let bare = Self { cameras: Vec::new(), views: Vec::new(), ..self.clone() };
        let head = spaced(&bare).replace(r#" "cameras": []}"#, "").split_off(1);
        let mut text = format!("{{\n  {head}\n  \"cameras\": [\n{}\n  ]", entries(&self.cameras));
        if !self.views.is_empty() {
            text += &format!(",\n  \"views\": [\n{}\n  ]", entries(&self.views));
        }
        text + "\n}\n"
    }
}
