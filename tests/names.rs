//! Names and other words from files: an id is a name, and nothing from a file drives a terminal or breaks
//! a table, a chart or another program's file.

mod common;

use common::{assert_refused, edit, read_json, run, stderr, succeed, synthetic, text};
use serde_json::json;
use std::path::Path;
use stlfr::exchange;
use tempfile::TempDir;

/// A capture of two cameras, of which the first is called `id`.
fn named(id: &str) -> TempDir {
    let folder = synthetic::capture(&[0.0, 0.3], 3);
    edit(folder.path(), |capture| capture["cameras"][0]["id"] = json!(id));
    folder
}

/// Whether nothing in a text but line breaks is a control character or turns the direction of writing.
fn is_plain(text: &str) -> bool {
    let drives =
        |c: char| c.is_control() || matches!(c, '\u{2028}'..='\u{202e}' | '\u{2066}'..='\u{2069}');
    !text.chars().any(|c| c != '\n' && drives(c))
}

#[test]
fn ids_that_are_no_names_are_refused_with_file_field_and_reason() {
    for id in [
        "",
        ".",
        "..",
        " cam",
        "cam ",
        "a/b",
        "<script>",
        "a&b",
        "\u{1b}[31mred",
        "bell\u{7}",
        "a\nb",
        "a\tb",
        "a\u{202e}b",
        "a\u{200b}b",
        "\u{3164}",
        &"x".repeat(101),
    ] {
        let folder = named(id);
        let output = run(&["plan", text(folder.path())]);
        assert_refused(&output, 2, "capture.json: cameras[0].id: ");
        assert!(is_plain(&stderr(&output)) && stderr(&output).len() < 900, "{}", stderr(&output));
    }
}

#[test]
fn legal_ids_reach_tables_charts_and_models_whole() {
    for id in ["Camera 1", "a-b_c.d", "Kamera süd", "カメラ3", &"x".repeat(100)] {
        let folder = named(id);
        let printed = succeed(&["offsets", text(folder.path())]);
        assert!(String::from_utf8_lossy(&printed.stdout).contains(id), "{id}");
        let svg = std::fs::read_to_string(folder.path().join("offsets.svg")).unwrap();
        assert!(svg.contains(id) && is_plain(&svg), "{id}");
        let binary = folder.path().join("binary");
        succeed(&["export", text(folder.path()), "--format", "colmap", "-o", text(&binary)]);
        let names = |model: &Path| exchange::read_colmap(model).unwrap().remove(0).name;
        assert_eq!(names(&binary), format!("{id}/0000.png"));
        let model = folder.path().join("text");
        let output =
            run(&["export", text(folder.path()), "--format", "colmap-text", "-o", text(&model)]);
        if id.contains(' ') {
            assert_refused(&output, 2, "can't hold a name with spaces");
            assert!(!model.exists());
        } else {
            assert!(output.status.success(), "{}", stderr(&output));
            assert_eq!(names(&model), format!("{id}/0000.png"));
        }
    }
}

/// Values that messages quote: an unknown field, a format, a reference, a model and a path.
#[test]
fn words_of_a_file_that_a_message_quotes_are_escaped() {
    let hostile = "x\u{1b}]0;owned\u{7}\n\u{202e}y\u{9b}31m";
    let changes: [(&str, &[&str]); 6] = [
        ("an unknown field", &["cameras", "0", hostile]),
        ("format", &["format"]),
        ("name", &["name"]),
        ("reference", &["reference"]),
        ("model", &["cameras", "0", "model"]),
        ("frames", &["cameras", "0", "frames"]),
    ];
    for (what, path) in changes {
        let folder = synthetic::capture(&[0.0, 0.3], 2);
        edit(folder.path(), |capture| {
            let (field, parents) = path.split_last().unwrap();
            let parent =
                parents.iter().fold(&mut *capture, |value, key| match key.parse::<usize>() {
                    Ok(index) => &mut value[index],
                    Err(_) => &mut value[*key],
                });
            parent[*field] = json!(hostile);
        });
        let output = run(&["plan", text(folder.path())]);
        assert_refused(&output, 2, "capture.json");
        assert!(is_plain(&stderr(&output)), "{what}: {:?}", stderr(&output));
    }
}

#[test]
fn the_schema_states_what_an_id_is() {
    let output = succeed(&["rig", "--schema", "capture"]);
    let schema: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    let id = &schema["$defs"]["FilmedCameraFormat"]["properties"]["id"];
    assert_eq!(id["maxLength"], json!(100));
    assert_eq!(id["pattern"], json!(stlfr::text::ID_PATTERN));
}

#[test]
fn ids_of_a_truth_and_of_a_rig_are_names_too() {
    let folder = synthetic::capture(&[0.0, 0.3], 2);
    std::fs::create_dir(folder.path().join("truth")).unwrap();
    let offset = json!({"id": "a\u{1b}[2J", "offset_s": 0.0});
    let truth = json!({"format": "stlfr-truth", "version": 1, "scene": "s", "rig": "r",
        "offsets": [offset], "shutter": [], "views": []});
    std::fs::write(folder.path().join("truth/truth.json"), truth.to_string()).unwrap();
    let output = run(&["compare", text(folder.path())]);
    assert_refused(&output, 2, "truth.json: offsets[0].id: ");
    assert!(is_plain(&stderr(&output)));

    for (field, hostile) in [("scene", "a\u{1b}[31m"), ("rig", "a\u{202e}b"), ("rig", "a\nb")] {
        let mut truth = truth.clone();
        (truth["offsets"], truth[field]) = (json!([]), json!(hostile));
        std::fs::write(folder.path().join("truth/truth.json"), truth.to_string()).unwrap();
        let output = run(&["compare", text(folder.path())]);
        assert_refused(&output, 2, &format!("truth.json: {field}: must be a line"));
        assert!(is_plain(&stderr(&output)));
    }

    let mut rig = read_json(&common::root().join("rigs/linear8.json"));
    rig["cameras"][0]["id"] = json!("x".repeat(101));
    let file = folder.path().join("rig.json");
    std::fs::write(&file, rig.to_string()).unwrap();
    assert_refused(&run(&["rig", "--check", text(&file)]), 2, "cameras[0].id has 101 characters");
}
