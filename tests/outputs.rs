//! Outputs: what they may replace, what they leave, and where they are printed. Every bug found is a
//! test with a name. `tests/output_matrix.py` tries all outputs against all kinds of targets by hand.

mod common;

use common::wall::Scene;
use common::{assert_refused, describe, interruptible, run, stderr, stlfr, succeed, text};
use serde_json::{Value, json};
use std::fs::File;
use std::os::unix::fs::{FileTypeExt, symlink};
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};
use stlfr::raster::{BitDepth, Image, write_image};
use tempfile::TempDir;

/// A small capture with known clocks, and truth that nothing here reads.
fn capture() -> TempDir {
    let folder = Scene { shared: [true; 3], frames: 3, ..Scene::default() }.film();
    std::fs::create_dir(folder.path().join("truth")).unwrap();
    std::fs::write(folder.path().join("truth/0.png"), "the truth").unwrap();
    std::fs::write(folder.path().join("truth/0.json"), "the truth").unwrap();
    folder
}

/// Every command with an output that is one file, that file's suffix, and its arguments before it.
fn file_outputs(capture: &str) -> Vec<(&'static str, Vec<&str>)> {
    vec![
        ("png", vec!["render", capture, "--like", "cam1", "--time", "0.05", "-o"]),
        ("mkv", vec!["render", capture, "--like", "cam1", "--times", "0.05:0.06:2", "-o"]),
        ("exr", vec!["render", capture, "--like", "cam1", "--time", "0.05", "-o"]),
        ("gif", vec!["render", capture, "--like", "cam1", "--times", "0.05:0.06:2", "-o"]),
        ("json", vec!["plan", capture, "-o"]),
        ("json", vec!["rig", "line", "-o"]),
        ("json", vec!["check", capture, "--json"]),
        ("json", vec!["export", capture, "--format", "nerf", "-o"]),
        ("npy", vec!["export", capture, "--format", "llff", "--near", "1", "--far", "6", "-o"]),
        ("zip", vec!["setup", "--extension"]),
    ]
}

fn run_into(arguments: &[&str], target: &Path) -> Output {
    run(&[&["-q"], arguments, &[text(target)]].concat())
}

/// All files of a folder with their bytes, and what else is in it.
fn contents(folder: &Path) -> Vec<(PathBuf, Option<Vec<u8>>)> {
    let mut found = Vec::new();
    for entry in std::fs::read_dir(folder).unwrap().flatten() {
        let (path, kind) = (entry.path(), entry.file_type().unwrap());
        if kind.is_dir() {
            found.extend(contents(&path));
        }
        found.push((path.clone(), kind.is_file().then(|| std::fs::read(path).unwrap())));
    }
    found.sort();
    found
}

#[test]
fn nothing_of_a_capture_is_written_over() {
    let folder = capture();
    let root = folder.path();
    let before = contents(root);
    for (suffix, arguments) in file_outputs(text(root)) {
        for target in ["truth/0", "truth/new/0", "colmap/0", ".stlfr/cache/video/0"] {
            let target = root.join(target).with_extension(suffix);
            let refused = run_into(&arguments, &target);
            assert_refused(&refused, 2, "belongs to the capture, and is not written over");
        }
    }
    let with = |name: &str, words: &str, arguments: &[&str]| {
        let capture_first = [&arguments[..1], &[text(root)], &arguments[1..]].concat();
        assert_refused(&run_into(&capture_first, &root.join(name)), 2, words);
    };
    with("capture.json", "describes the capture", &["export", "--format", "nerf", "-o"]);
    with("capture.json", "describes the capture", &["plan", "-o"]);
    with("capture.json", "describes the capture", &["check", "--json"]);
    let llff = ["export", "--format", "llff", "--near", "1", "--far", "6", "-o"];
    with("cam0/0.png", "is a frame of the capture", &llff);
    with("cam0/99.png", "is a frame of the capture", &llff);
    with("offsets.json", "belongs to the capture", &["plan", "-o"]);
    for (name, words) in [("", "is a capture"), ("cam0", "frames"), ("truth", "belongs to")] {
        with(name, words, &["compare", "-o"]);
        with(name, words, &["tradeoff", "-o"]);
        with(name, words, &["publish", "-o"]);
        with(name, words, &["export", "--format", "colmap", "-o"]);
    }
    let rig = run_into(&["rig", "line", "-o"], &root.join("capture.json"));
    assert_refused(&rig, 2, "describes the capture");
    let film = ["capture", "rigs/linear8.json", "--scene", "magazine", "-o"];
    assert_refused(&run_into(&film, &root.join("truth/new")), 2, "belongs to the capture");
    assert_refused(&run_into(&["demo", "-o"], &root.join("truth")), 2, "belongs to the capture");
    assert_eq!(contents(root), before);
    // Results beside it are welcome.
    succeed(&["-q", "plan", text(root), "-o", text(&root.join("options.json"))]);
    succeed(&["-q", "plan", text(root), "-o", text(&root.join("review/options.json"))]);
}

#[test]
fn only_regular_files_are_written_over() {
    let folder = capture();
    let out = tempfile::tempdir().unwrap();
    for (suffix, arguments) in file_outputs(text(folder.path())) {
        let [pipe, link, dangling, here] = ["pipe", "link", "dangling", "folder"]
            .map(|name| out.path().join(name).with_extension(suffix));
        let name = std::ffi::CString::new(text(&pipe)).unwrap();
        // SAFETY: the name is a string that ends with 0.
        unsafe { libc::mkfifo(name.as_ptr(), 0o600) };
        File::create(out.path().join("goal")).unwrap();
        let _ = [symlink("goal", &link), symlink("nowhere", &dangling)];
        std::fs::create_dir_all(&here).unwrap();
        for (target, words) in [
            (&pipe, "is a pipe"),
            (&link, "is a link"),
            (&dangling, "is a link"),
            (&here, "is a folder"),
        ] {
            assert_refused(&run_into(&arguments, target), 2, words);
        }
        assert!(pipe.symlink_metadata().unwrap().file_type().is_fifo());
        assert_eq!(std::fs::read(out.path().join("goal")).unwrap(), b"");
    }
    // Without a suffix of its own, a device has none.
    for arguments in [vec!["rig", "line", "-o"], vec!["plan", text(folder.path()), "-o"]] {
        assert_refused(&run_into(&arguments, Path::new("/dev/null")), 2, "is a device");
    }
    assert!(!Path::new("/dev/null").symlink_metadata().unwrap().is_file());
    for command in ["compare", "tradeoff", "publish"] {
        let file = out.path().join("goal");
        let arguments = [command, text(folder.path()), "-o"];
        assert_refused(&run_into(&arguments, &file), 2, "is no folder");
    }
    for format in ["colmap", "colmap-text"] {
        let arguments = ["export", text(folder.path()), "--format", format, "-o"];
        assert_refused(&run_into(&arguments, &out.path().join("goal")), 2, "is no folder");
        std::fs::create_dir_all(out.path().join(format)).unwrap();
        for file in ["cameras.bin", "cameras.txt"] {
            symlink("nowhere", out.path().join(format).join(file)).unwrap();
        }
        assert_refused(&run_into(&arguments, &out.path().join(format)), 2, "is a link");
    }
}

/// Every command with an output folder, and its arguments before the folder.
fn folder_outputs(capture: &str) -> Vec<Vec<&str>> {
    vec![
        vec!["compare", capture, "-o"],
        vec!["tradeoff", capture, "--rounds", "0", "--runs", "1", "-o"],
        vec!["publish", capture, "-o"],
        vec!["farm", capture, "-o"],
        vec!["calibrate", capture, "-o"],
        vec!["refine", capture, "-o"],
        vec!["export", capture, "--format", "nerf", "--frames", "-o"],
        vec!["export", capture, "--format", "colmap", "--synchronized", "-o"],
        vec!["export", capture, "--format", "colmap", "-o"],
        vec!["export", capture, "--format", "colmap-text", "-o"],
        vec!["import", capture, "--images", capture, "--rate", "25", "-o"],
        vec!["capture", "rigs/linear8.json", "--scene", "magazine", "-o"],
        vec!["demo", "-o"],
    ]
}

#[test]
fn a_link_as_output_folder_leads_into_no_capture() {
    let (folder, out) = (capture(), tempfile::tempdir().unwrap());
    let (root, link) = (folder.path(), out.path().join("link"));
    let before = contents(root);
    for target in ["", "cam0", "truth", "truth/new", ".stlfr/cache/video", "offsets.json"] {
        let _ = std::fs::remove_file(&link);
        symlink(root.join(target), &link).unwrap();
        for arguments in folder_outputs(text(root)) {
            let makes_a_capture = ["import", "capture", "demo"].contains(&arguments[0]);
            if makes_a_capture && ["", "cam0"].contains(&target) {
                continue; // these refuse what holds other files
            }
            let output = run_into(&arguments, &link);
            assert_eq!(output.status.code(), Some(2), "{target}: {arguments:?}");
            let message = stderr(&output);
            assert_eq!(message.lines().count(), 1, "{target}: {arguments:?}: {message}");
            assert_eq!(contents(root), before, "{target}: {arguments:?}");
        }
    }
}

#[test]
fn no_folder_in_an_output_is_written_through_a_link() {
    let folder = capture();
    let root = folder.path();
    for name in ["images", "sheets", "video"] {
        for target in ["truth", "cam0", "."] {
            let review = root.join("review");
            std::fs::create_dir(&review).unwrap();
            symlink(root.join(target), review.join(name)).unwrap();
            let before = contents(root);
            for arguments in [vec!["compare"], vec!["compare", "-o", text(&review)]] {
                let arguments = [&["-q"], &arguments[..], &[text(root)]].concat();
                assert_refused(&run(&arguments), 2, "is a link, which is not written through");
            }
            assert_eq!(contents(root), before, "{name} to {target}");
            std::fs::remove_dir_all(&review).unwrap();
        }
    }
    let film = ["capture", "rigs/linear8.json", "--scene", "magazine", "-o"];
    for name in ["images", "sparse"] {
        let data = tempfile::tempdir().unwrap();
        symlink(root.join("cam0"), data.path().join(name)).unwrap();
        let before = contents(root);
        let export = ["export", text(root), "--format", "colmap", "--frames", "-o"];
        assert_refused(
            &run_into(&export, data.path()),
            2,
            "is a link, which is not written through",
        );
        assert_eq!(contents(root), before, "{name}");
    }
    for name in ["cam0", "truth", ".film", ".stlfr", "truth/views"] {
        let unfinished = tempfile::tempdir().unwrap();
        let link = unfinished.path().join(name);
        std::fs::create_dir_all(link.parent().unwrap()).unwrap();
        symlink(root.join("cam0"), &link).unwrap();
        let output = run_into(&film, unfinished.path());
        assert_refused(&output, 2, "is a link, which is not written through");
    }
}

#[test]
fn the_longest_names_are_written() {
    let folder = capture();
    let out = tempfile::tempdir().unwrap();
    for (suffix, arguments) in file_outputs(text(folder.path())) {
        if ["check", "setup"].contains(&arguments[0]) {
            continue; // minutes
        }
        let target = out.path().join("n".repeat(254 - suffix.len())).with_extension(suffix);
        assert_eq!(target.file_name().unwrap().len(), 255);
        let written = run_into(&arguments, &target);
        assert!(written.status.success(), "{arguments:?}: {}", stderr(&written));
        assert!(target.metadata().unwrap().len() > 0);
        assert_eq!(std::fs::read_dir(out.path()).unwrap().count(), 1, "{arguments:?}");
        std::fs::remove_file(&target).unwrap();
    }
}

/// A calibration of two cameras and their images, three each.
fn importable() -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    let mut frames = Vec::new();
    for (c, id) in ["a", "b"].into_iter().enumerate() {
        for k in 0..3 {
            let path = folder.path().join(format!("images/{id}/{:04}.png", k + 1));
            let shade = Image::filled(8, 6, 1, 0.1 * (3 * c + k) as f32);
            write_image(&path, &shade, None, BitDepth::Eight).unwrap();
        }
        frames.push(json!({"file_path": format!("{id}/0.png"), "transform_matrix":
            [[1, 0, 0, c], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]}));
    }
    let transforms = json!({"w": 8, "h": 6, "fl_x": 8, "frames": frames});
    std::fs::write(folder.path().join("transforms.json"), transforms.to_string()).unwrap();
    folder
}

fn import(folder: &Path, to: &str) -> Output {
    let [file, images, to] = ["transforms.json", "images", to].map(|name| folder.join(name));
    let arguments = ["import", text(&file), "--images", text(&images), "--rate", "30", "-o"];
    run_into(&arguments, &to)
}

#[test]
fn an_import_takes_nothing_of_what_is_there() {
    let folder = importable();
    let root = folder.path();
    let before = contents(&root.join("images"));
    assert_refused(&import(root, "images"), 2, "images: holds files already");
    assert_refused(&import(root, "images/a"), 2, "images/a: holds files already");
    // Frames of an earlier recording.
    let stale = root.join("capture/a/0003.png");
    write_image(&stale, &Image::filled(8, 6, 1, 0.9), None, BitDepth::Eight).unwrap();
    assert_refused(&import(root, "capture"), 2, "holds files already");
    assert_refused(&import(root, "transforms.json"), 2, "is no folder");
    assert_eq!(contents(&root.join("images")), before);
    assert_eq!(contents(&root.join("capture")).len(), 2);
}

#[test]
fn an_import_that_fails_can_be_mended_and_done_again() {
    let folder = importable();
    let root = folder.path();
    let frame = root.join("images/b/0002.png");
    let whole = std::fs::read(&frame).unwrap();
    std::fs::remove_file(&frame).unwrap();
    assert_refused(&import(root, "capture"), 2, "0001.png and 0003.png must follow each other");
    std::fs::create_dir(&frame).unwrap();
    assert_refused(&import(root, "capture"), 2, "b/0002.png: has an image's name");
    std::fs::remove_dir(&frame).unwrap();
    write_image(&frame, &Image::filled(4, 6, 1, 0.5), None, BitDepth::Eight).unwrap();
    assert_refused(&import(root, "capture"), 2, "b/0001.png: is 4×6 pixels, its camera 8×6");
    assert_eq!(std::fs::read_dir(root).unwrap().count(), 2, "images and transforms.json");
    std::fs::write(&frame, whole).unwrap();
    let done = import(root, "capture");
    assert!(done.status.success(), "{}", stderr(&done));
    assert_eq!(std::fs::read_dir(root).unwrap().count(), 3);
}

/// Commands that print, all of them quick.
fn printing(capture: &str) -> Vec<Vec<&str>> {
    vec![
        vec!["--help"],
        vec!["--version"],
        vec!["render", "--help"],
        vec!["rig", "line"],
        vec!["rig", "--schema", "capture"],
        vec!["rig", "--check", "rigs/linear8.json"],
        vec!["plan", capture],
        vec!["plan", capture, "--json"],
        vec!["offsets", capture],
        vec!["offsets", capture, "--json"],
    ]
}

/// The ends of a pipe whose reader is gone.
fn closed_pipe() -> Stdio {
    let (reader, writer) = std::io::pipe().unwrap();
    drop(reader);
    writer.into()
}

#[test]
fn a_closed_pipe_ends_quietly() {
    let folder = capture();
    for arguments in printing(text(folder.path())) {
        let output = stlfr().args(&arguments).stdout(closed_pipe()).output().unwrap();
        let message = stderr(&output);
        assert_eq!(output.status.code(), Some(0), "{arguments:?}: {message}");
        assert!(!message.contains("stdout") && !message.contains("panicked"), "{message}");
        let silent = stlfr().args(&arguments).stderr(closed_pipe()).output().unwrap();
        assert_eq!(silent.status.code(), Some(0), "{arguments:?}");
    }
    for (arguments, code) in [(&["fly"][..], 2), (&[], 2), (&["offsets", "/nowhere"], 2)] {
        let status = stlfr().args(arguments).stderr(closed_pipe()).status().unwrap();
        assert_eq!(status.code(), Some(code), "{arguments:?}");
    }
}

#[test]
fn a_full_stdout_is_one_sentence() {
    let folder = capture();
    let full = || File::options().write(true).open("/dev/full").unwrap();
    for arguments in printing(text(folder.path())) {
        let arguments = [&["-q"], &arguments[..]].concat();
        let output = stlfr().args(&arguments).stdout(full()).output().unwrap();
        assert_refused(&output, 1, "stdout: can't be written (No space left");
        let silent = stlfr().args(&arguments).stderr(full()).output().unwrap();
        assert_eq!(silent.status.code(), Some(0), "{arguments:?}");
    }
}

/// A temporary folder as a killed process leaves it.
fn leave_in(folder: &Path) -> PathBuf {
    let left = folder.join(".stlfr-1-0.tmp");
    std::fs::create_dir_all(&left).unwrap();
    std::fs::write(left.join("video"), "half").unwrap();
    left
}

#[test]
fn what_killed_runs_left_is_removed() {
    let folder = capture();
    let out = tempfile::tempdir().unwrap();
    for (suffix, arguments) in file_outputs(text(folder.path())) {
        if !["check", "setup"].contains(&arguments[0]) {
            let left = leave_in(out.path());
            assert!(
                run_into(&arguments, &out.path().join("o").with_extension(suffix)).status.success()
            );
            assert!(!left.exists(), "{arguments:?}");
        }
    }
    let importable = importable();
    let left = leave_in(importable.path());
    assert!(import(importable.path(), "capture").status.success() && !left.exists());
    // A trade-off takes what it left for its own.
    let out = tempfile::tempdir().unwrap();
    let left =
        [leave_in(out.path()), leave_in(&folder.path().join(".stlfr/cache/tradeoff-points"))];
    let arguments = ["tradeoff", text(folder.path()), "--rounds", "0", "--runs", "1", "-o"];
    let mut tradeoff = stlfr().args(arguments).arg(out.path()).arg("-q").spawn().unwrap();
    let gone = || left.iter().all(|left| !left.exists());
    while !gone() && tradeoff.try_wait().unwrap().is_none() {
        std::thread::sleep(std::time::Duration::from_millis(5));
    }
    assert!(gone());
    tradeoff.kill().unwrap();
    tradeoff.wait().unwrap();
}

/// Names in a folder, hidden ones too.
fn names(folder: &Path) -> Vec<String> {
    let entries = std::fs::read_dir(folder).unwrap().flatten();
    let mut names: Vec<String> =
        entries.map(|entry| entry.file_name().to_string_lossy().into_owned()).collect();
    names.sort();
    names
}

#[test]
fn an_interrupted_video_leaves_nothing() {
    use std::os::unix::process::ExitStatusExt;
    let folder = capture();
    for signal in [libc::SIGINT, libc::SIGTERM, libc::SIGHUP] {
        let out = tempfile::tempdir().unwrap();
        let target = out.path().join("o.mkv");
        let mut command = stlfr();
        command.args(["-q", "render", text(folder.path()), "--like", "cam1"]).args([
            "--times",
            "0.01:0.07:100000",
            "-o",
            text(&target),
        ]);
        let mut child = interruptible(&mut command).spawn().unwrap();
        while !names(out.path()).iter().any(|name| name.ends_with(".tmp")) {
            assert!(child.try_wait().unwrap().is_none(), "it ended by itself");
            std::thread::sleep(std::time::Duration::from_millis(5));
        }
        std::thread::sleep(std::time::Duration::from_millis(100));
        // SAFETY: the child was not waited for, so its id is still its own.
        unsafe { libc::kill(i32::try_from(child.id()).unwrap(), signal) };
        assert_eq!(child.wait().unwrap().signal(), Some(signal));
        assert_eq!(names(out.path()), [""; 0]);
    }
}

#[test]
fn a_cache_behind_a_link_is_refused() {
    let elsewhere = tempfile::tempdir().unwrap();
    std::fs::write(elsewhere.path().join("mine"), "").unwrap();
    let folder = one_video();
    symlink(elsewhere.path(), folder.path().join(".stlfr")).unwrap();
    assert_refused(&run(&["offsets", text(folder.path())]), 2, ".stlfr: is a link");
    std::fs::remove_file(folder.path().join(".stlfr")).unwrap();
    std::fs::create_dir(folder.path().join(".stlfr")).unwrap();
    symlink(elsewhere.path(), folder.path().join(".stlfr/cache")).unwrap();
    assert_refused(&run(&["offsets", text(folder.path())]), 2, ".stlfr/cache: is a link");
    assert_eq!(names(elsewhere.path()), ["mine"]);
}

/// A capture of one video camera, its video rendered by the program.
fn one_video() -> TempDir {
    let source = capture();
    let folder = tempfile::tempdir().unwrap();
    let arguments =
        ["render", text(source.path()), "--like", "cam1", "--times", "0.02:0.06:9", "-o"];
    let written = run_into(&arguments, &folder.path().join("video.mkv"));
    assert!(written.status.success(), "{}", stderr(&written));
    let camera = Scene::default().camera([0.0; 3]);
    let mut camera: Value = camera;
    camera["id"] = json!("a");
    camera["frames"] = json!("video.mkv");
    camera["clock"] = json!({"rate_hz": 25.0, "first_s": 0.0, "shared": true});
    describe(
        folder.path(),
        &json!({"format": "stlfr-capture", "version": 1, "name": "one", "cameras": [camera]}),
    );
    folder
}

#[test]
fn a_full_disk_is_no_broken_video() {
    let folder = one_video();
    // Files of more than 2 KiB can't be written; who tries is told so, not ended.
    let limited = "trap '' XFSZ; ulimit -f 2; exec \"$0\" \"$@\"";
    let output = Command::new("bash")
        .args(["-c", limited, env!("CARGO_BIN_EXE_stlfr"), "-q", "offsets", text(folder.path())])
        .output()
        .unwrap();
    assert_refused(&output, 1, "can't be written (File too large");
    assert!(stderr(&output).contains(".stlfr/cache/video"), "{}", stderr(&output));
    assert!(names(&folder.path().join(".stlfr/cache/video")).iter().all(|n| n.ends_with(".lock")));
    let video = ["render", text(folder.path()), "--like", "a", "--times", "0:0.3:9", "-o"];
    let out = folder.path().join("out.mkv");
    let output = Command::new("bash")
        .args(["-c", limited, env!("CARGO_BIN_EXE_stlfr"), "-q"])
        .args(video)
        .arg(&out)
        .output()
        .unwrap();
    assert_eq!(output.status.code(), Some(1), "{}", stderr(&output));
    assert!(!stderr(&output).contains("0x"), "{}", stderr(&output));
}
