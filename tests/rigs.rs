//! Rig files: which are refused, and which commands write the shipped ones.

mod common;

use common::{assert_refused, root, run, stderr};
use serde_json::Value;
use stlfr::rig::Rig;

/// The commands that wrote the rigs of `rigs/`. `linear8` is written by hand, as in the paper.
const SHIPPED: [(&str, &str); 8] = [
    ("linear8-sync", "line --delays none --jitter 0 --shared-clock"),
    ("grid2x4", "grid --rows 2 --columns 4 --seed 2"),
    ("arc8", "arc --distance 1.8 --seed 3"),
    ("mixed-rates", "line --rate 24,60,25,30 --seed 4"),
    ("grey-mix", "line --color gray,rgb,gray,rgb,gray,gray,rgb,gray --seed 5"),
    ("lost-frames", "line --jitter 0 --lost 2 --lost-stamps mixed --seed 6"),
    ("drift", "line --drift 300 --seed 7"),
    ("distorted", "line --distortion -0.18,0.06,0.001,-0.0005 --seed 8"),
];

#[test]
fn the_shipped_rigs_are_what_their_commands_write() {
    let folder = tempfile::tempdir().unwrap();
    for (name, arguments) in SHIPPED {
        let file = folder.path().join(format!("{name}.json"));
        let mut command: Vec<&str> = vec!["rig"];
        command.extend(arguments.split(' '));
        command.extend(["-o", file.to_str().unwrap()]);
        let output = run(&command);
        assert!(output.status.success(), "{name}: {}", stderr(&output));
        let written = std::fs::read_to_string(&file).unwrap();
        let shipped = root().join("rigs").join(format!("{name}.json"));
        assert_eq!(written, std::fs::read_to_string(shipped).unwrap(), "{name}");
    }
    let shipped = std::fs::read_dir(root().join("rigs")).unwrap().count();
    assert_eq!(shipped, SHIPPED.len() + 1);
}

#[test]
fn without_a_file_the_rig_is_printed() {
    let output = run(&["rig", "line", "--count", "2", "--name", "pair"]);
    let rig: Rig = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!((rig.name.as_str(), rig.cameras.len(), rig.reference.as_str()), ("pair", 2, "cam0"));
}

/// The corpus that Python's tests put through the module.
fn corpus() -> Value {
    let text = std::fs::read_to_string(root().join("tests/golden/rigs.json")).unwrap();
    serde_json::from_str(&text).unwrap()
}

/// The corpus's rig with fields changed; a field's path has dots.
fn changed(corpus: &Value, changes: &Value) -> String {
    let mut rig = corpus["rig"].clone();
    for (path, value) in changes.as_object().unwrap() {
        let (parent, field) = path.rsplit_once('.').unwrap_or(("", path));
        let mut at = &mut rig;
        for step in parent.split('.').filter(|s| !s.is_empty()) {
            at = match step.parse::<usize>() {
                Ok(index) => &mut at[index],
                Err(_) => &mut at[step],
            };
        }
        at[field] = value.clone();
    }
    rig.to_string()
}

#[test]
fn the_corpus_of_rigs_is_judged_rightly() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("rig.json");
    let corpus = corpus();
    for changes in corpus["good"].as_array().unwrap() {
        std::fs::write(&path, changed(&corpus, changes)).unwrap();
        assert!(Rig::read(&path).is_ok(), "{changes}: {}", Rig::read(&path).unwrap_err());
    }
    for case in corpus["bad"].as_array().unwrap() {
        std::fs::write(&path, changed(&corpus, &case[0])).unwrap();
        let message = Rig::read(&path).expect_err(&case.to_string()).to_string();
        let (file, field) = (path.to_str().unwrap(), case[1].as_str().unwrap());
        assert!(message.starts_with(file) && message.contains(field), "{field}: {message}");
    }
}

#[test]
fn wrong_commands_are_one_sentence() {
    assert_refused(&run(&["rig"]), 2, "LAYOUT");
    assert_refused(&run(&["rig", "ring"]), 2, "ring");
    assert_refused(&run(&["rig", "line", "--count", "0"]), 2, "--count");
    assert_refused(&run(&["rig", "line", "--count", "2000"]), 2, "from 1 to 1000");
    assert_refused(&run(&["rig", "grid", "--count", "9"]), 2, "--count: a grid has --rows");
    assert_refused(&run(&["rig", "line", "--rows", "3"]), 2, "--rows and --columns: ");
    assert_refused(&run(&["rig", "line", "--distance", "2"]), 2, "--distance: only an arc");
    assert_refused(&run(&["rig", "line", "--rate", "30,0"]), 2, "cameras[1].rate_hz");
    assert_refused(&run(&["rig", "line", "--distortion=1,2"]), 2, "four numbers");
    assert_refused(&run(&["rig", "line", "--delays", "soon"]), 2, "soon");
    assert_refused(&run(&["rig", "line", "--name", "a/b"]), 2, "name can't be");
    assert_refused(&run(&["rig", "arc", "--distance", "0.1"]), 2, "an arc needs a distance");
    assert_refused(&run(&["rig", "line", "--lost", "9"]), 2, "9 lost frames");
    assert_refused(&run(&["rig", "line", "-o", "/proc/none/rig.json"]), 2, "/proc/none/rig.json");
    assert_refused(&run(&["rig", "line", "--check", "rigs/linear8.json"]), 2, "cannot be used");
    assert_refused(&run(&["rig", "--check", "rigs/none.json"]), 2, "rigs/none.json");
    assert_refused(&run(&["capture", "Cargo.toml", "--scene", "x", "-o", "target/x"]), 2, "Cargo");
}

#[test]
fn schemas_are_printed() {
    for (format, field) in [("rig", "lens_mm"), ("capture", "times_s")] {
        let output = run(&["rig", "--schema", format]);
        let schema: Value = serde_json::from_slice(&output.stdout).unwrap();
        assert!(schema["$schema"].is_string() && schema["required"].is_array());
        assert!(schema.to_string().contains(field), "{schema}");
    }
}
