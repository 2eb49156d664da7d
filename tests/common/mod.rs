//! What the integration tests share: the program, scenes whose images are formulas, and the tiny
//! capture that Blender films once.

#![allow(dead_code)] // each test binary uses some of it

pub mod arc;
pub mod bodies;
pub mod peak;
pub mod random;
pub mod scores;
pub mod swing;
pub mod synthetic;
pub mod wall;
pub mod worlds;

use serde_json::Value;
use std::fs::File;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use std::sync::OnceLock;
use stlfr::toolchain::find_ffmpeg;

/// The project's folder.
pub fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

/// The program under test.
pub fn stlfr() -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_stlfr"));
    command.current_dir(root());
    command
}

/// The same as a terminal starts it: signals end it. What ignores a signal, as `nohup` does, would pass that on.
pub fn interruptible(command: &mut Command) -> &mut Command {
    use std::os::unix::process::CommandExt;
    let defaults = || {
        for signal in [libc::SIGINT, libc::SIGTERM, libc::SIGHUP] {
            // SAFETY: it is called between fork and exec, where `signal` may be.
            unsafe { libc::signal(signal, libc::SIG_DFL) };
        }
        Ok(())
    };
    // SAFETY: it calls nothing but `signal`.
    unsafe { command.pre_exec(defaults) }
}

/// The system's ffmpeg, or that which `stlfr setup` brings.
pub fn ffmpeg() -> PathBuf {
    find_ffmpeg().unwrap_or_else(|| {
        run(&["setup", "-q"]);
        find_ffmpeg().expect("an ffmpeg")
    })
}

/// Runs the program; its output.
pub fn run(arguments: &[&str]) -> Output {
    stlfr().args(arguments).output().expect("the program starts")
}

/// Runs the program, which must succeed; its output.
#[track_caller]
pub fn succeed(arguments: &[&str]) -> Output {
    let output = run(arguments);
    assert!(output.status.success(), "{arguments:?}: {}", stderr(&output));
    output
}

/// A path as a command line has it.
pub fn text(path: &Path) -> &str {
    path.to_str().expect("test folders are UTF-8")
}

/// What went to stderr.
pub fn stderr(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

/// Asserts that a command ends with this exit code, one sentence on stderr that contains `words`,
/// and nothing on stdout.
#[track_caller]
pub fn assert_refused(output: &Output, code: i32, words: &str) {
    let message = stderr(output);
    assert_eq!(output.status.code(), Some(code), "{message}");
    assert!(message.contains(words), "{words}: {message}");
    assert_eq!(message.trim_end().lines().count(), 1, "{message}");
    assert!(output.stdout.is_empty(), "{}", String::from_utf8_lossy(&output.stdout));
}

/// A JSON file's content.
pub fn read_json(path: &Path) -> Value {
    let bytes = std::fs::read(path).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
    serde_json::from_slice(&bytes).unwrap_or_else(|e| panic!("{}: {e}", path.display()))
}

/// Writes the description of a capture.
pub fn describe(folder: &Path, capture: &Value) {
    std::fs::write(folder.join("capture.json"), capture.to_string())
        .expect("capture.json can be written");
}

/// Changes the description of a capture.
pub fn edit(folder: &Path, change: impl FnOnce(&mut Value)) {
    let mut capture = read_json(&folder.join("capture.json"));
    change(&mut capture);
    describe(folder, &capture);
}

/// The tiny capture: the demo's scene and rig, 8 cameras of 160×120 with 6 frames, truth at one
/// instant. Filmed once, by whichever test process comes first, and cached in the target folder; not
/// to be written to (see [`tiny_copy`]).
pub fn tiny_capture() -> &'static Path {
    static CAPTURE: OnceLock<PathBuf> = OnceLock::new();
    CAPTURE.get_or_init(|| {
        let folder = root().join("target/test-captures");
        std::fs::create_dir_all(&folder).expect("the target folder can be written to");
        let lock = File::create(folder.join("tiny.lock")).expect("the lock can be made");
        lock.lock().expect("the lock can be taken");
        let capture = folder.join("tiny");
        let mut output = film_tiny(&capture);
        if output.status.code() == Some(2) && capture.exists() {
            // Another version of the scene, the rig or the filming code made it.
            std::fs::remove_dir_all(&capture).expect("the old capture can be removed");
            output = film_tiny(&capture);
        }
        assert!(output.status.success(), "filming: {}", stderr(&output));
        capture
    })
}

fn film_tiny(capture: &Path) -> Output {
    stlfr()
        .args(["capture", "rigs/linear8.json", "--scene", "magazine", "--size", "160x120"])
        .args(["--frames", "6", "--instants", "1", "-o"])
        .arg(capture)
        .output()
        .expect("the program starts")
}

/// A copy of the tiny capture, to change.
pub fn tiny_copy() -> tempfile::TempDir {
    let copy = tempfile::tempdir().expect("a temporary folder can be made");
    copy_folder(tiny_capture(), copy.path());
    copy
}

/// Copies a folder with all that is in it.
pub fn copy_folder(from: &Path, to: &Path) {
    for entry in std::fs::read_dir(from).expect("a folder of the capture") {
        let path = entry.expect("an entry of the capture").path();
        let target = to.join(path.file_name().expect("entries have names"));
        if path.is_dir() {
            std::fs::create_dir(&target).expect("the copy can be written");
            copy_folder(&path, &target);
        } else {
            std::fs::copy(&path, &target).expect("the copy can be written");
        }
    }
}

/// A named pipe, at which a reader waits for a writer.
pub fn make_pipe(path: &Path) {
    let made = Command::new("mkfifo").arg(path).status().expect("mkfifo starts");
    assert!(made.success(), "{}", path.display());
}
