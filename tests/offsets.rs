//! Clocks that are seconds apart, drift and lose frames; grids that see what a row does not; on
//! films in closed form.

mod common;
#[allow(dead_code)] // the benchmark uses all of it
#[path = "bench/offsets/scene.rs"]
mod scene;

use common::{run, stderr};
use scene::Film;
use std::sync::Arc;
use stlfr::capture::Capture;
use stlfr::offset::{Offsets, estimate};
use stlfr::options::RenderOptions;
use stlfr::progress::Reporter;
use stlfr::registration::FrameStore;

fn estimated(film: &Film) -> (Arc<Capture>, Offsets, Vec<f64>) {
    let folder = tempfile::tempdir().unwrap();
    let truth = film.write(folder.path()).unwrap();
    let capture = Arc::new(Capture::open(folder.path()).unwrap());
    let options = RenderOptions::default();
    let silent = Reporter::silent();
    let frames = FrameStore::new(capture.clone(), &options.registration);
    let found = estimate(&frames, &options.offset, &silent).unwrap();
    // Frames go with the folder; all that is used below is the clocks.
    (capture, found.offsets, truth)
}

fn small(boards: Vec<scene::Board>, delays_frames: &[f64], frames: usize) -> Film {
    let mut film = Film::new(boards, delays_frames, frames);
    film.size = [160, 120];
    film
}

/// Three recordings of one film, started and stopped by hand up to 3 s apart: 2.2 s in common.
#[test]
fn recordings_seconds_apart_are_aligned() {
    let delays = [0.3 + 66.0, 0.0, 21.0 - 0.2];
    let film = small(scene::restless(1), &delays, 132);
    let (capture, found, truth) = estimated(&film);
    for (camera, truth_s) in found.cameras.iter().zip(truth) {
        let error = (camera.offset_s.expect(&camera.id) - truth_s) / capture.frame_s();
        assert!(error.abs() < 0.02, "{}: {error} frame", camera.id);
    }
}

#[test]
fn drift_and_lost_frames_are_found_and_taken_into_account() {
    let mut film = small(scene::restless(2), &[0.3, 0.0, -0.2], 100);
    film.drift_ppm = vec![200.0, 0.0, -400.0];
    film.lost = vec![vec![41], vec![], vec![20, 71]];
    let (capture, found, _) = estimated(&film);
    assert_eq!(found.cameras[0].lost_before, Some(vec![41]));
    assert_eq!(found.cameras[1].lost_before, Some(vec![]));
    // The second is missing before the image that would have been its 72nd, less the first one.
    assert_eq!(found.cameras[2].lost_before, Some(vec![20, 70]));
    assert_eq!((found.cameras[1].offset_s, found.cameras[1].rate_ppm), (Some(0.0), None));
    for (c, camera) in found.cameras.iter().enumerate().filter(|(c, _)| *c != 1) {
        let rate = camera.rate_ppm.unwrap();
        let bar = camera.rate_std_err_ppm.unwrap();
        assert!((rate - film.drift_ppm[c]).abs() < 4.0 * bar && bar < 100.0, "{camera:?}");
    }
    // Every image's time on the reference's clock, the end of the film included.
    for (c, times) in found.common_times_s(&capture).into_iter().enumerate() {
        let kept = (0..).filter(|n| !film.lost[c].contains(n));
        for (time_s, n) in times.unwrap().into_iter().zip(kept) {
            let slow = 1.0 + 1e-6 * film.drift_ppm[c];
            let truth_s = film.delays_s[c] + n as f64 / film.rate_hz * slow - film.delays_s[1];
            let error = (time_s - truth_s) / capture.frame_s();
            assert!(error.abs() < 0.02, "camera {c}, frame {n}: {error} frame");
        }
    }
}

/// Short overlaps, drift and cameras that may lose frames, all at once, on many films: what is lost
/// is found or missed, but none is made up, and what is told is true within its error.
#[test]
fn no_frame_is_made_up_and_no_rate_is_wrong_and_sure() {
    for seed in 0..6 {
        let late = 10.0 + 7.0 * seed as f64;
        let mut film = small(scene::restless(40 + seed), &[0.3 + late, 0.0, -0.2], 75);
        film.drift_ppm = vec![150.0, 0.0, -300.0];
        film.may_lose = true;
        if seed % 2 == 1 {
            film.lost[2] = vec![37];
        }
        let (capture, found, truth) = estimated(&film);
        for (c, camera) in found.cameras.iter().enumerate() {
            let lost = camera.lost_before.clone().unwrap();
            assert!(lost == film.lost[c], "seed {seed}, {}: lost {lost:?}", camera.id);
            let Some((offset_s, bar_s)) = camera.offset_s.zip(camera.std_err_s) else { continue };
            if camera.id == found.reference {
                continue;
            }
            let error_s = offset_s - truth[c];
            let small = 4.0 * bar_s + 0.005 * capture.frame_s();
            assert!(error_s.abs() < small, "seed {seed}, {}: {error_s} ± {bar_s} s", camera.id);
            let (rate, bar) = camera.rate_ppm.zip(camera.rate_std_err_ppm).unwrap();
            let error = rate - film.drift_ppm[c];
            assert!(error.abs() < 4.0 * bar + 20.0, "seed {seed}, {}: {camera:?}", camera.id);
        }
    }
}

#[test]
fn motion_along_the_rows_is_seen_by_a_grids_columns() {
    let mut film = small(scene::rectangle([0.9, 0.0]), &[0.3, -0.2, 0.0, 0.4], 8);
    let (_, row, _) = estimated(&film);
    assert!(row.cameras.iter().filter(|c| c.id != row.reference).all(|c| c.offset_s.is_none()));
    film.second_row_m = 0.1;
    let (capture, grid, truth) = estimated(&film);
    for (camera, truth_s) in grid.cameras.iter().zip(truth) {
        let error = (camera.offset_s.expect(&camera.id) - truth_s) / capture.frame_s();
        assert!(error.abs() < 0.02, "{}: {error} frame", camera.id);
    }
}

/// What tells the time is the few features of one small body, which err together: their scatter says
/// little of what they are off by.
#[test]
fn a_small_body_alone_is_doubted() {
    let (mut known, mut beyond) = (0, Vec::new());
    for seed in 0..8 {
        let boards = scene::small_turning_board(seed);
        let mut film = small(boards, &[0.3, -0.2, 0.0, 0.4], 9);
        film.seed = seed;
        film.size = [240, 180];
        let (_, found, truth) = estimated(&film);
        for (camera, truth_s) in found.cameras.iter().zip(truth) {
            let Some((offset_s, bar_s)) = camera.offset_s.zip(camera.std_err_s) else { continue };
            if camera.id != found.reference {
                known += 1;
                let z = (offset_s - truth_s).abs() / bar_s;
                if z > 2.0 {
                    beyond.push(format!("{seed} {}: {z:.1}", camera.id));
                }
            }
        }
    }
    assert!(known > 12, "{known} known");
    assert!(20 * beyond.len() <= known, "of {known}, beyond two standard errors: {beyond:?}");
}

#[test]
fn the_command_prints_a_table_and_keeps_a_plot() {
    let folder = tempfile::tempdir().unwrap();
    let film = small(scene::rectangle([0.5, 0.7]), &[0.3, 0.0], 5);
    film.write(folder.path()).unwrap();
    let path = folder.path().to_str().unwrap();
    let first = run(&["offsets", path]);
    assert!(first.status.success(), "{}", stderr(&first));
    let table = String::from_utf8_lossy(&first.stdout).into_owned();
    assert!(table.contains("std. error") && table.contains("cam1"), "{table}");
    assert!(stderr(&first).contains("were estimated"));
    let plot = std::fs::read_to_string(folder.path().join("offsets.svg")).unwrap();
    for title in ["Each pair alone", "Candidates that agree", "Single triples", "epipolar lines"] {
        assert!(plot.contains(title), "{title}");
    }
    assert!(plot.matches("<circle").count() > 8 && !plot.contains("NaN"));
    let again = run(&["offsets", path]);
    assert_eq!(String::from_utf8_lossy(&again.stdout), table);
    assert!(stderr(&again).contains("kept in offsets.json"));
}

#[test]
fn a_static_capture_has_no_offsets_to_estimate() {
    let folder = tempfile::tempdir().unwrap();
    small(scene::rectangle([0.5, 0.7]), &[0.3, 0.0], 1).write(folder.path()).unwrap();
    let output = run(&["offsets", folder.path().to_str().unwrap()]);
    assert!(output.status.success());
    let notes = stderr(&output);
    assert!(
        notes.contains("no offsets to estimate") && !notes.contains("were estimated"),
        "{notes}"
    );
    assert!(!folder.path().join("offsets.json").exists());
}
