//! Every parser against mutations of good files: none panics, and what it refuses, it refuses in one
//! sentence. Seeds are fixed, so a run is repeatable; `STLFR_FUZZ_SECONDS=60 cargo test --release
//! --test fuzz` goes on for that long with each target, with other seeds. A file that fails is saved in
//! `target/fuzz/`; once the parser is mended, it becomes a named case in `tests/fuzz/cases/TARGET/`,
//! replayed first.

#[path = "../common/mod.rs"]
mod common;

mod mutate;
mod targets;

use mutate::Mutator;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};
use targets::Target;

/// Mutations a target by default: some seconds in all.
const MUTATIONS: usize = 3000;

/// Parses bytes as the target's file; why that is wrong, if it is.
fn verdict(target: &Target, folder: &Path, bytes: &[u8]) -> Result<(), String> {
    let file = folder.join(target.file);
    // A file that is cut and written again goes to the disk at once; a new one doesn't.
    std::fs::remove_file(&file).expect("the last one can be removed");
    std::fs::write(&file, bytes).expect("the folder can be written to");
    match catch_unwind(AssertUnwindSafe(|| (target.parse)(folder))) {
        Err(_) => Err("panics".into()),
        Ok(Ok(())) => Ok(()),
        Ok(Err(message)) if message.trim().is_empty() => Err("refuses without a word".into()),
        Ok(Err(message)) if message.lines().count() != 1 => Err(format!("says {message:?}")),
        Ok(Err(_)) => Ok(()),
    }
}

fn save(target: &Target, bytes: &[u8]) -> PathBuf {
    let folder = common::root().join("target/fuzz");
    std::fs::create_dir_all(&folder).expect("the target folder can be written to");
    let hash = bytes.iter().fold(0_u64, |h, b| h.wrapping_mul(0x100_0000_01b3) ^ u64::from(*b));
    let path = folder.join(format!("{}-{hash:016x}", target.name));
    std::fs::write(&path, bytes).expect("the target folder can be written to");
    path
}

fn fuzz(target: &Target) {
    let folder = tempfile::tempdir().expect("a temporary folder can be made");
    (target.prepare)(folder.path());
    let seed = std::fs::read(folder.path().join(target.file)).expect("the seed is there");
    (target.parse)(folder.path()).expect("the seed itself is right");

    let cases = common::root().join("tests/fuzz/cases").join(target.name);
    for case in std::fs::read_dir(cases).into_iter().flatten().flatten() {
        let bytes = std::fs::read(case.path()).expect("a case can be read");
        let found = verdict(target, folder.path(), &bytes);
        assert_eq!(found, Ok(()), "{}", case.path().display());
    }

    let seconds = std::env::var("STLFR_FUZZ_SECONDS").ok().and_then(|s| s.parse::<f64>().ok());
    let end = seconds.map(|s| Instant::now() + Duration::from_secs_f64(s));
    let first = if end.is_some() { u64::from(std::process::id()) << 32 } else { 0 };
    for n in 0.. {
        let done = end.map_or(n >= MUTATIONS, |end| Instant::now() >= end);
        if done {
            break;
        }
        let bytes = Mutator::new(first + n as u64).mutated(&seed, target.is_text);
        if let Err(why) = verdict(target, folder.path(), &bytes) {
            panic!("{}: {why}; saved as {}", target.name, save(target, &bytes).display());
        }
    }
}

/// One test a target, so that a failure names it.
macro_rules! targets {
    ($($name:ident),*) => {
        $(#[test] fn $name() { fuzz(&targets::$name()); })*
    };
}

targets!(
    capture,
    view,
    path,
    truth,
    options,
    offsets,
    rig,
    png_8,
    png_16,
    depth_npy,
    colmap_text_cameras,
    colmap_text_images,
    colmap_binary_cameras,
    colmap_binary_images,
    colmap_text_rigs,
    colmap_text_frames,
    colmap_binary_rigs,
    colmap_binary_frames,
    colmap_times,
    transforms,
    poses_bounds,
    calib_toml,
    qualisys,
    timestamps
);
