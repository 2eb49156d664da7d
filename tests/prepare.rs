//! Frame pairs that are registered beforehand, and read back.

mod common;

use common::bodies::{Recording, World, board_before_wall, pose};
use common::worlds::line_rig;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex};
use stlfr::capture::Capture;
use stlfr::host::DiskCache;
use stlfr::light_field::{LightField, PREPARED, Preparation};
use stlfr::offset::Offsets;
use stlfr::options::{ProxyMethod, RenderOptions};
use stlfr::raster::Image;
use stlfr::registration::{Gains, RegistrationOptions, Track};
use tempfile::TempDir;

/// Three cameras that film a board that moves right, before a still wall.
fn filmed() -> TempDir {
    let world: World = board_before_wall(|frames| pose([0.0; 3], [0.02 * frames, 0.0, 1.3]));
    let (cameras, folder) = (line_rig(3, 160), tempfile::tempdir().expect("a temporary folder"));
    let first_frames = &[0.0, 0.25, 0.5];
    Recording { world: &world, cameras: &cameras, first_frames, frames: 4, noise: 0.004 }
        .write(folder.path());
    folder
}

fn opened(folder: &Path) -> LightField {
    let capture = Arc::new(Capture::open(folder).expect("a capture"));
    LightField::new(capture.clone(), Offsets::known(&capture))
}

fn prepared(field: &LightField) -> Preparation {
    field.prepare(&RenderOptions::default(), |_| ()).expect("a capture that can be prepared")
}

fn view(field: &LightField) -> Image {
    view_by(field, &RenderOptions::default())
}

fn view_by(field: &LightField, options: &RenderOptions) -> Image {
    let time_s = 1.6 / 30.0 - field.capture().time_origin_s;
    field.view(&field.capture().cameras[1].camera, time_s, options).expect("a view").image
}

fn tracks(folder: &Path) -> Arc<Vec<Track>> {
    opened(folder).tracks(1, 1, &RegistrationOptions::default()).unwrap()
}

fn gains(folder: &Path) -> Arc<Gains> {
    opened(folder).gains(&RegistrationOptions::default())
}

/// Whether there was something to delete.
fn delete_prepared(folder: &Path) -> std::io::Result<bool> {
    let cache = DiskCache::new(folder, |_| ());
    let deleted = PREPARED.map(|kind| cache.delete(Some(kind)));
    let mut entries = 0;
    for deleted in deleted {
        entries += deleted?.entries;
    }
    Ok(entries > 0)
}

/// All files of tracks, by name, and that of the gains.
fn files(folder: &Path) -> Vec<PathBuf> {
    let folders = PREPARED.map(|kind| folder.join(".stlfr/cache").join(kind));
    // Depth and motion have a folder only if they were prepared.
    let all = folders.iter().filter_map(|folder| std::fs::read_dir(folder).ok()).flatten();
    let mut all: Vec<PathBuf> = all.map(|entry| entry.unwrap().path()).collect();
    all.sort_by_key(|file| !file.starts_with(&folders[0]));
    all
}

#[test]
fn views_are_the_same_bytes_and_what_is_there_is_kept() {
    let folder = filmed();
    let expected = view(&opened(folder.path()));
    let field = opened(folder.path());
    let (pairs, bytes) = field.preparation_size(&RenderOptions::default());
    let first = prepared(&field);
    assert_eq!((pairs, first.pairs, first.found), (9, 9, 0));
    let on_disk: u64 = files(folder.path()).iter().map(|f| f.metadata().unwrap().len()).sum();
    assert!(first.bytes == on_disk && first.bytes <= bytes, "{first:?}, {on_disk}, {bytes}");
    assert_eq!(view(&field), expected);
    assert_eq!(view(&opened(folder.path())), expected);

    // Two are missing: as after a command that was stopped.
    let all = files(folder.path());
    let before = std::fs::read(&all[3]).unwrap();
    for file in &all[2..4] {
        std::fs::remove_file(file).unwrap();
    }
    assert_eq!(view(&opened(folder.path())), expected);
    let again = prepared(&opened(folder.path()));
    assert_eq!(again, Preparation { found: 7, ..first });
    assert_eq!(std::fs::read(&all[3]).unwrap(), before);
}

#[test]
fn views_by_prepared_maps_are_the_same_bytes() {
    let folder = filmed();
    let mut options = RenderOptions::default();
    options.proxy.method = ProxyMethod::SceneFlow;
    let view = |field: &LightField| view_by(field, &options);
    let expected = view(&opened(folder.path()));
    let field = opened(folder.path());
    let (steps, bytes) = field.preparation_size(&options);
    assert!(!field.has_prepared_maps(&options));
    let last = AtomicUsize::new(0);
    let first = field.prepare(&options, |done| last.store(done, Ordering::Relaxed)).unwrap();
    assert_eq!((first.maps, first.maps_found, steps, last.into_inner()), (12, 0, 21, 21));
    assert!(first.bytes <= bytes && field.has_prepared_maps(&options));
    assert_eq!(view(&opened(folder.path())), expected);

    // One is missing: as after a command that was stopped.
    let maps = folder.path().join(".stlfr/cache").join(PREPARED[2]);
    let file = std::fs::read_dir(maps).unwrap().next().unwrap().unwrap().path();
    let before = std::fs::read(&file).unwrap();
    std::fs::remove_file(&file).unwrap();
    assert_eq!(view(&opened(folder.path())), expected);
    let again = opened(folder.path()).prepare(&options, |_| ()).unwrap();
    assert_eq!((again.maps, again.maps_found), (12, 11));
    assert_eq!(std::fs::read(&file).unwrap(), before);

    // The depth of the static background is missing too, and is found anew.
    let stills = folder.path().join(".stlfr/cache").join(PREPARED[3]);
    assert_eq!(std::fs::read_dir(&stills).unwrap().count(), 3, "one for each camera");
    std::fs::remove_dir_all(&stills).unwrap();
    std::fs::remove_file(&file).unwrap();
    assert_eq!(view(&opened(folder.path())), expected);
    let anew = opened(folder.path()).prepare(&options, |_| ()).unwrap();
    assert_eq!((anew.maps_found, anew.bytes), (11, first.bytes));
    assert_eq!(std::fs::read(&file).unwrap(), before);
}

/// The files of a kind of results on disk, and what they contain, sorted by path.
fn stored(folder: &Path, kind: &str) -> Vec<(Vec<u8>, PathBuf)> {
    let entries = std::fs::read_dir(folder.join(".stlfr/cache").join(kind)).unwrap();
    let mut files: Vec<PathBuf> = entries.map(|entry| entry.unwrap().path()).collect();
    files.sort();
    files.into_iter().map(|file| (std::fs::read(&file).unwrap(), file)).collect()
}

/// With five threads, the maps of several slots are estimated at a time.
#[test]
fn maps_are_the_same_bytes_for_any_number_of_threads() {
    let folder = filmed();
    let mut options = RenderOptions::default();
    options.proxy.method = ProxyMethod::SceneFlow;
    let [one, five] = [1, 5].map(|threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let mut done = Mutex::new(Vec::new());
        let report = |steps| done.lock().unwrap().push(steps);
        let prepared = pool.install(|| opened(folder.path()).prepare(&options, report)).unwrap();
        assert_eq!((prepared.maps, prepared.maps_found), (12, 0));
        // Tracks of nine frame pairs come first. Then a slot at a time is reported, in whatever order they finish.
        let of_maps = done.get_mut().unwrap().split_off(9);
        assert!(of_maps.is_sorted() && of_maps.last() == Some(&21), "{of_maps:?}");
        let maps = [PREPARED[2], PREPARED[3]].map(|kind| stored(folder.path(), kind));
        assert!(delete_prepared(folder.path()).unwrap());
        maps
    });
    assert_eq!(one[0].len(), 12);
    assert!(one == five);
}

#[test]
fn damaged_maps_and_backgrounds_are_estimated_anew() {
    let folder = filmed();
    let mut options = RenderOptions::default();
    options.proxy.method = ProxyMethod::SceneFlow;
    let prepare = || opened(folder.path()).prepare(&options, |_| ()).unwrap();
    let view = || view_by(&opened(folder.path()), &options);
    prepare();
    let expected = view();
    let [maps, backgrounds] = [2, 3].map(|kind| stored(folder.path(), PREPARED[kind]));
    let flipped = |bytes: &[u8], at: usize| {
        let mut bytes = bytes.to_vec();
        bytes[at] ^= 4;
        bytes
    };
    type Damage<'a> = &'a dyn Fn(&[u8]) -> Vec<u8>;
    for kind in [&maps, &backgrounds] {
        let of_another = &kind[0].0;
        let damages: [Damage; 3] = [
            &|whole| flipped(whole, whole.len() / 2),
            &|whole| whole[..whole.len() / 2].to_vec(),
            &|_| of_another.clone(),
        ];
        for (n, damage) in damages.into_iter().enumerate() {
            for (whole, file) in &kind[1..] {
                std::fs::write(file, damage(whole)).unwrap();
            }
            if std::ptr::eq(kind, &backgrounds) {
                // Only maps that are missing need the background.
                maps.iter().for_each(|(_, file)| drop(std::fs::remove_file(file)));
            }
            assert_eq!(view(), expected, "damage {n} of {}", kind[1].1.display());
        }
        // Prepared anew, they are whole again.
        prepare();
        for (whole, file) in maps.iter().chain(&backgrounds) {
            assert!(std::fs::read(file).unwrap() == *whole, "{}", file.display());
        }
    }
}

#[test]
fn gains_are_kept_and_their_damage_is_noticed() {
    let folder = filmed();
    let expected = gains(folder.path());
    assert!(expected.largest.1 > 0.0, "measured");
    prepared(&opened(folder.path()));
    assert_eq!(gains(folder.path()), expected);
    let file = files(folder.path()).pop().expect("the gains, the last kind");
    let bytes = std::fs::read(&file).unwrap();
    // A checksum, the number of cameras, three gains a camera, the same number again, the number of a curve's knots a
    // camera, a difference and its standard error.
    assert_eq!(bytes.len(), 32 + (1 + 8 * 3 * 3) + (1 + 3) + 8 * 2);
    for at in [0, 31, 32, bytes.len() - 1] {
        let mut damaged = bytes.clone();
        damaged[at] ^= 4;
        std::fs::write(&file, damaged).unwrap();
        assert_eq!(gains(folder.path()), expected, "byte {at}");
        std::fs::write(&file, &bytes[..at]).unwrap();
        assert_eq!(gains(folder.path()), expected, "{at} bytes");
    }
    // Prepared anew, it is whole again.
    prepared(&opened(folder.path()));
    assert_eq!(std::fs::read(&file).unwrap(), bytes);
}

/// A file that was moved to the place of another is not believed.
#[test]
fn a_file_holds_at_its_own_place_alone() {
    let folder = filmed();
    let expected = view(&opened(folder.path()));
    prepared(&opened(folder.path()));
    let many = tracks(folder.path()).len();
    for file in files(folder.path()) {
        let of_another = files(folder.path())[0].clone();
        if file != of_another {
            std::fs::copy(&of_another, &file).unwrap();
        }
    }
    assert_eq!(tracks(folder.path()).len(), many);
    assert_eq!(view(&opened(folder.path())), expected);
}

#[test]
fn damage_is_noticed() {
    let folder = filmed();
    prepared(&opened(folder.path()));
    let expected = tracks(folder.path());
    let files: Vec<(PathBuf, Vec<u8>)> = files(folder.path())
        .into_iter()
        .map(|file| (file.clone(), std::fs::read(file).unwrap()))
        .collect();
    let each = |change: &dyn Fn(&Path, &[u8])| files.iter().for_each(|(f, b)| change(f, b));
    let same = |what: &str| assert!(tracks(folder.path()) == expected, "{what}");
    for at in [0, 31, 32, 33, 40, 60] {
        each(&|file, bytes| {
            let mut damaged = bytes.to_vec();
            damaged[at] ^= 4;
            std::fs::write(file, damaged).unwrap();
        });
        same(&format!("byte {at}"));
        each(&|file, bytes| std::fs::write(file, &bytes[..at]).unwrap());
        same(&format!("{at} bytes"));
    }
    each(&|file, bytes| {
        let last = bytes.len() - 1;
        std::fs::write(file, [&bytes[..last], &[bytes[last] ^ 4]].concat()).unwrap();
    });
    same("the last byte");
    each(&|file, _| {
        std::fs::remove_file(file).unwrap();
        std::os::unix::fs::symlink("/dev/zero", file).unwrap();
    });
    same("a device");
    prepared(&opened(folder.path()));
    each(&|file, bytes| assert_eq!(std::fs::read(file).unwrap(), bytes, "the link is replaced"));
}

#[test]
fn other_contents_and_options_have_pairs_of_their_own() {
    let folder = filmed();
    let first = prepared(&opened(folder.path()));
    let mut fewer = RenderOptions::default();
    fewer.registration.max_corners = 300;
    assert_eq!(opened(folder.path()).prepare(&fewer, |_| ()).unwrap().found, 0);
    assert_eq!(prepared(&opened(folder.path())).found, first.pairs);
    let frame = opened(folder.path()).capture().cameras[0].frames[0].clone();
    let other = opened(folder.path()).capture().cameras[0].frames[2].clone();
    std::fs::copy(other, frame).unwrap();
    assert_eq!(prepared(&opened(folder.path())).found, 0);
    assert!(delete_prepared(folder.path()).unwrap());
    assert!(!delete_prepared(folder.path()).unwrap());
    assert_eq!(prepared(&opened(folder.path())).found, 0);
}

#[test]
fn links_lead_nowhere() {
    let (folder, elsewhere) = (filmed(), tempfile::tempdir().unwrap());
    std::fs::write(elsewhere.path().join("mine"), "precious").unwrap();
    std::fs::create_dir_all(folder.path().join(".stlfr")).unwrap();
    let link = folder.path().join(".stlfr/cache");
    std::os::unix::fs::symlink(elsewhere.path(), &link).unwrap();
    let error = opened(folder.path()).prepare(&RenderOptions::default(), |_| ());
    let error = error.unwrap_err().to_string();
    assert!(error.contains(".stlfr/cache") && error.contains("link"), "{error}");
    assert!(delete_prepared(folder.path()).is_err());
    assert_eq!(std::fs::read_dir(elsewhere.path()).unwrap().count(), 1);
}

fn delete_by_command(folder: &Path) -> (Option<i32>, String) {
    let program = env!("CARGO_BIN_EXE_stlfr");
    let output =
        std::process::Command::new(program).arg("prepare").arg(folder).arg("--delete").output();
    let output = output.expect("the program runs");
    let said = [output.stdout, output.stderr].concat();
    (output.status.code(), String::from_utf8(said).expect("text"))
}

#[test]
fn of_a_damaged_capture_too_it_is_deleted() {
    let folder = filmed();
    prepared(&opened(folder.path()));
    std::fs::write(folder.path().join("capture.json"), "{").unwrap();
    assert_eq!(delete_by_command(folder.path()), (Some(0), "Deleted.\n".to_owned()));
    assert_eq!(delete_by_command(folder.path()), (Some(0), "Nothing was prepared.\n".to_owned()));
    std::fs::remove_file(folder.path().join("capture.json")).unwrap();
    let (code, said) = delete_by_command(folder.path());
    assert!(code == Some(2) && said.contains("capture.json"), "{said}");
}
