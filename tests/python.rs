//! The Python side: its tests, its formatting and its types, in the pinned environment.

mod common;

use std::process::Command;
use stlfr::progress::Reporter;
use stlfr::toolchain::{Environment, ensure_environment, project_root};

fn environment() -> Environment {
    let root = project_root().expect("tests run in the source folder");
    ensure_environment(&root, &Reporter::new(false)).unwrap_or_else(|e| panic!("{e}"))
}

/// Runs a command in the project's folder, its output going where this test's process's goes, so
/// that it shows whether or not the test passes.
#[track_caller]
fn must_pass(command: &mut Command) {
    let status = command.current_dir(common::root()).status().expect("it starts");
    assert!(status.success(), "{command:?}: {status}");
}

/// The environment's Python, with nothing of the user's or of this folder's on its path: `stlfr` is
/// the module, not `blender/stlfr`.
fn python(environment: &Environment, module: &str) -> Command {
    let mut command = Command::new(&environment.python);
    command.args(["-I", "-m", module]);
    command
}

/// pytest ends with a status of its own where it found no test, so that fails too.
#[test]
fn pytest() {
    let environment = environment();
    must_pass(
        python(&environment, "pytest")
            .args(["-c", "blender/pyproject.toml", "--rootdir", ".", "tests/python"])
            .env("STLFR_TEST_CAPTURE", common::tiny_capture())
            .env("STLFR_TEST_PROGRAM", env!("CARGO_BIN_EXE_stlfr")),
    );
}

#[test]
fn formatting_and_lints() {
    let environment = environment();
    let ruff = environment.project_root.join(".venv/bin/ruff");
    for command in [["format", "--check"].as_slice(), &["check"]] {
        must_pass(Command::new(&ruff).args(command).args([
            "--no-cache",
            "--config",
            "blender/pyproject.toml",
            ".ci",
            "blender",
            "tests/bench",
            "tests/farm",
            "tests/python",
            "tests/window",
        ]));
    }
}

#[test]
fn types() {
    let environment = environment();
    must_pass(
        python(&environment, "mypy")
            .args(["--config-file", "blender/pyproject.toml", "--cache-dir"])
            .arg(common::root().join("target/mypy"))
            .args([
                ".ci/release.py",
                "blender/calibrate.py",
                "blender/capture.py",
                "blender/check.py",
                "blender/package.py",
                "blender/review.py",
                "blender/calibration",
                "blender/scenes",
                "blender/stlfr",
            ])
            .arg("tests/python"),
    );
}

/// What the stubs say is what the compiled module has.
#[test]
fn stubs_match_the_module() {
    let environment = environment();
    must_pass(python(&environment, "mypy.stubtest").args([
        "stlfr",
        "--ignore-missing-stub",
        "--concise",
    ]));
}
