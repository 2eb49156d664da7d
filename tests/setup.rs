//! The set-up's order, stamps and sentences, with a Python that only writes down what it is asked.
//! (The real one is set up by every other test that needs it.)

mod common;

use common::{assert_refused, stderr};
use std::os::unix::fs::PermissionsExt;
use std::path::Path;
use std::process::{Command, Output, Stdio};
use std::time::{Duration, Instant};

/// Stands for python3.11, and for the environment's: marker files in the source folder say how it
/// behaves.
const PYTHON: &str = r#"#!/bin/sh
note() { echo "$1" >> "$STLFR_HOME/log"; }
case "$*" in
*ensurepip*)
    version=3.11; able=able
    [ -e "$STLFR_HOME/old" ] && version=3.9
    [ -e "$STLFR_HOME/unable" ] && able=unable
    echo "$version $able" ;;
*"-m venv"*)
    for venv; do :; done
    mkdir -p "$venv/bin"
    cp "$0" "$venv/bin/python"
    cp "$STLFR_HOME/bin/maturin" "$venv/bin/maturin"
    echo "version = 3.11" > "$venv/pyvenv.cfg"
    note venv ;;
*--constraint*) note maturin ;;
*--requirement*)
    if [ -e "$STLFR_HOME/slow" ]; then note slow; exec sleep 60; fi
    if [ -e "$STLFR_HOME/offline" ]; then echo "ERROR: no network" >&2; exit 1; fi
    note packages ;;
*--no-deps*) note module ;;
*package.py*)
    note package
    if [ -e "$STLFR_HOME/unpackable" ]; then echo "the manifest is wrong" >&2; exit 1; fi
    for zip; do :; done
    if [ -e "$STLFR_HOME/full" ]; then echo "$zip: No space left on device" >&2; exit 1; fi
    echo zip > "$zip" ;;
*bpy*)
    note import
    if [ -e "$STLFR_HOME/bare" ]; then
        echo "ImportError: libEGL.so.1: cannot open shared object file: No such file or directory" >&2
        exit 1
    fi ;;
esac
"#;

const MATURIN: &str = r#"#!/bin/sh
while [ "$1" != --out ]; do shift; done
mkdir -p "$2"
: > "$2/stlfr.whl"
echo build >> "$STLFR_HOME/log"
"#;

/// A source folder, with its Python.
fn source_folder() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    let write = |name: &str, text: &str| {
        let path = folder.path().join(name);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(&path, text).unwrap();
        std::fs::set_permissions(&path, std::fs::Permissions::from_mode(0o755)).unwrap();
    };
    for name in ["python3.11", "python3", "python"] {
        write(&format!("bin/{name}"), PYTHON);
    }
    write("bin/maturin", MATURIN);
    for name in ["Cargo.toml", "Cargo.lock", "src/lib.rs", "blender/pyproject.toml"] {
        write(name, name);
    }
    write("blender/requirements.txt", "bpy==5.0.1\n");
    write("blender/system-packages.txt", "libegl1\nlibsm6\n");
    write("blender/module/stlfr/__init__.py", "");
    folder
}

fn setup(folder: &Path) -> Command {
    let mut command = common::stlfr();
    let path = format!("{}:/usr/bin:/bin", folder.join("bin").display());
    command.args(["setup", "-q"]).env("STLFR_HOME", folder).env("PATH", path);
    command
}

fn run(folder: &Path) -> Output {
    setup(folder).output().unwrap()
}

/// What was asked of the Python since the last call, sorted: two of the steps run side by side.
fn log(folder: &Path) -> Vec<String> {
    let path = folder.join("log");
    let mut steps: Vec<String> =
        std::fs::read_to_string(&path).unwrap_or_default().lines().map(str::to_owned).collect();
    let _ = std::fs::remove_file(path);
    steps.sort();
    steps
}

const ALL: [&str; 6] = ["build", "import", "maturin", "module", "packages", "venv"];

#[test]
fn it_runs_once_even_if_started_twice() {
    let folder = source_folder();
    let both = [(); 2].map(|()| setup(folder.path()).stdout(Stdio::null()).spawn().unwrap());
    for mut child in both {
        assert!(child.wait().unwrap().success());
    }
    assert_eq!(log(folder.path()), ALL);
    assert!(run(folder.path()).status.success());
    assert_eq!(log(folder.path()), [""; 0]);
}

#[test]
fn changed_sources_need_the_module_only() {
    let folder = source_folder();
    run(folder.path());
    log(folder.path());
    std::fs::write(folder.path().join("src/lib.rs"), "changed").unwrap();
    assert!(run(folder.path()).status.success());
    assert_eq!(log(folder.path()), ["build", "import", "module"]);
    std::fs::write(folder.path().join("blender/requirements.txt"), "bpy==5.0.2\n").unwrap();
    assert!(run(folder.path()).status.success());
    assert_eq!(log(folder.path()), ALL);
}

#[test]
fn a_killed_set_up_is_done_again() {
    let folder = source_folder();
    std::fs::write(folder.path().join("slow"), "").unwrap();
    let mut child = setup(folder.path()).spawn().unwrap();
    let start = Instant::now();
    // The module is built while the packages are installed, and noted before the kill.
    let noted = |log: String| ["slow", "build"].iter().all(|step| log.contains(step));
    let is_slow = || std::fs::read_to_string(folder.path().join("log")).is_ok_and(noted);
    while !is_slow() && start.elapsed() < Duration::from_secs(30) {
        std::thread::sleep(Duration::from_millis(10));
    }
    assert!(is_slow());
    child.kill().unwrap();
    child.wait().unwrap();
    log(folder.path());
    std::fs::remove_file(folder.path().join("slow")).unwrap();
    assert!(run(folder.path()).status.success());
    assert_eq!(log(folder.path()), ALL);
}

#[test]
fn a_missing_library_is_named_and_the_packages_are_kept() {
    let folder = source_folder();
    std::fs::write(folder.path().join("bare"), "").unwrap();
    let output = run(folder.path());
    assert_refused(&output, 1, "libEGL.so.1");
    assert!(stderr(&output).contains("apt-get install -y libegl1 libsm6"), "{}", stderr(&output));
    log(folder.path());
    std::fs::remove_file(folder.path().join("bare")).unwrap();
    assert!(run(folder.path()).status.success());
    assert!(!log(folder.path()).contains(&"packages".to_owned()));
}

#[test]
fn what_is_missing_is_one_line_to_run() {
    let folder = source_folder();
    std::fs::write(folder.path().join("unable"), "").unwrap();
    assert_refused(&run(folder.path()), 1, "apt-get install -y python3.11-venv");
    std::fs::write(folder.path().join("old"), "").unwrap();
    assert_refused(&run(folder.path()), 1, "Python 3.11 is not installed");
    assert!(!folder.path().join(".venv").exists());
}

#[test]
fn without_a_network_pips_own_reason_is_given() {
    let folder = source_folder();
    std::fs::write(folder.path().join("offline"), "").unwrap();
    assert_refused(&run(folder.path()), 1, "no network");
    std::fs::remove_file(folder.path().join("offline")).unwrap();
    assert!(run(folder.path()).status.success());
}

#[test]
fn the_extension_is_packed_from_a_wheel_of_its_own() {
    let folder = source_folder();
    run(folder.path());
    log(folder.path());
    let zip = folder.path().join("out.zip");
    let pack = || setup(folder.path()).arg("--extension").arg(&zip).output().unwrap();
    let packed = pack();
    assert!(packed.status.success(), "{}", stderr(&packed));
    assert_eq!(std::fs::read(&zip).unwrap(), b"zip\n");
    assert_eq!(log(folder.path()), ["build", "package"]);
    assert!(!folder.path().join(".venv/wheels").exists());
    std::fs::write(folder.path().join("unpackable"), "").unwrap();
    assert_refused(&pack(), 1, "the manifest is wrong");
    std::fs::remove_file(folder.path().join("unpackable")).unwrap();
    std::fs::write(folder.path().join("full"), "").unwrap();
    assert_refused(&pack(), 1, &format!("{}: No space left", zip.display()));
    assert_eq!(std::fs::read(&zip).unwrap(), b"zip\n");
    let tar = setup(folder.path()).args(["--extension", "out.tar"]).output().unwrap();
    assert_refused(&tar, 2, "must name a .zip");
}
