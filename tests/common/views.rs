//! The rig of `.captures/views`: `rigs/linear8.json` with the views that benchmarks measure and show.

use serde_json::{Value, json};
use std::path::Path;

/// The views: name, and place in metres to the right of the rig's middle, below and ahead.
const VIEWS: [(&str, [f64; 3]); 4] = [
    ("between", [0.0; 3]),
    ("side", [-0.12, 0.0, 0.0]),
    ("high", [-0.03, -0.12, 0.0]),
    ("ahead", [0.03, 0.0, 0.12]),
];

/// Writes a rig with [`VIEWS`] in place of its own.
pub fn write_rig(from: &Path, to: &Path) -> Result<(), Box<dyn std::error::Error>> {
    let mut rig: Value = serde_json::from_str(&std::fs::read_to_string(from)?)?;
    let lens = rig["views"][0].clone();
    let view = |(id, place): &(&str, [f64; 3])| {
        let mut view = lens.clone();
        view["id"] = json!(id);
        let translation = place.map(|v| if v == 0.0 { 0.0 } else { -v });
        let rotation = [1.0, 0.0, 0.0, 0.0];
        view["cam_from_rig"] = json!({"rotation_wxyz": rotation, "translation": translation});
        view
    };
    rig["views"] = VIEWS.iter().map(view).collect();
    let folder = to.parent().ok_or("has no folder")?;
    std::fs::create_dir_all(folder)?;
    Ok(std::fs::write(to, serde_json::to_string_pretty(&rig)?)?)
}
