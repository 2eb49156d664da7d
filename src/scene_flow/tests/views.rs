//! Views of the scenes.

use super::super::splat::{Area, Splat};
use super::*;

/// PSNR inside a border of 8 pixels, dB.
fn psnr_db(a: &Image, b: &Image) -> f64 {
    let (mut error, mut count) = (0.0, 0.0);
    for y in 8..SIZE[1] - 8 {
        for x in 8..SIZE[0] - 8 {
            for (a, b) in a.pixel(x, y).iter().zip(b.pixel(x, y)) {
                error += f64::from(a - b).powi(2);
                count += 1.0;
            }
        }
    }
    -10.0 * (error / f64::max(count, 1.0)).log10()
}

/// Returns the mapped middle frames, and the camera and the time of a view between the cameras and the frames.
fn between<'a>(
    recording: &'a [[FlowFrame; 3]],
    maps: &'a [FlowMap],
) -> (Vec<MappedFrame<'a>>, Camera, f64) {
    let mapped = recording.iter().zip(maps).map(|(f, map)| MappedFrame { frame: &f[1], map });
    (mapped.collect(), camera_at(0.15, 0.02), 1.4)
}

#[test]
fn a_view_between_cameras_and_frames_is_the_true_one_and_moves_like_it() {
    let walls = [MOVING, STILL];
    let recording = recording(&walls);
    let maps = maps(&recording);
    let (mapped, view, time) = between(&recording, &maps);
    let FlowView { rendered, depths, motions } =
        blend(&mapped, &confidences(&mapped), &view, time, Detail::WithMotion);
    let motions = motions.unwrap();
    let mut motion_errors = [Vec::new(), Vec::new()];
    for k in 0..SIZE[0] * SIZE[1] {
        let place = [(k % SIZE[0]) as f64 + 0.5, (k / SIZE[0]) as f64 + 0.5];
        let seen = walls.iter().position(|w| w.hit(&view, place, time).is_some()).unwrap();
        let true_px = walls[seen].velocity.map(|v| v * FOCAL_PX / walls[seen].depth_m);
        let found = motions.motion(k).velocity;
        let [du, dv] = [0, 1].map(|c| f64::from(found[c]) - true_px[c]);
        motion_errors[seen].push(du.hypot(dv));
    }
    for errors in motion_errors {
        let error_px = median(errors);
        assert!(error_px < 0.05, "{error_px} px a frame");
    }
    let truth = filmed(&view, &walls, time);
    let psnr_db = psnr_db(&rendered.image, &truth);
    let inside = (8..SIZE[1] - 8).flat_map(|y| (8..SIZE[0] - 8).map(move |x| (x, y)));
    for (x, y) in inside {
        assert!(rendered.coverage[y * SIZE[0] + x] && depths.row(y)[x] > 0.0);
    }
    // Outlines are off by up to a pixel.
    assert!(psnr_db > 29.0, "{psnr_db} dB");
}

#[test]
fn a_quick_view_is_nearly_that_of_full_detail() {
    let recording = recording(&[MOVING, STILL]);
    let maps = maps(&recording);
    let (mapped, view, time) = between(&recording, &maps);
    let confidences = confidences(&mapped);
    let [full, quick] = [Detail::Full, Detail::Quick]
        .map(|detail| blend(&mapped, &confidences, &view, time, detail).rendered);
    assert!(quick.coverage == full.coverage);
    let psnr_db = psnr_db(&quick.image, &full.image);
    assert!(psnr_db > 30.0, "{psnr_db} dB");
}

#[test]
fn single_pixels_are_splatted_as_all_pixels_are() {
    let recording = recording(&[MOVING, STILL]);
    let maps = maps(&recording);
    let (mapped, view, time) = between(&recording, &maps);
    let confidences = confidences(&mapped);
    let rows = 10..60;
    let pixels: Vec<u32> = (0..(rows.len() * SIZE[0]) as u32).step_by(7).collect();
    let splat = |area: &Area| Splat::new(mapped[0], &confidences[0], area, time).unwrap();
    let all = splat(&Area::of_rows(&view, rows.clone()));
    let some = splat(&Area::of_pixels(&view, rows, &pixels));
    assert!(all.pixels.iter().filter(|p| p.weight > 0.0).count() > all.pixels.len() / 2);
    for (pixel, &k) in some.pixels.iter().zip(&pixels) {
        assert_eq!(pixel, &all.pixels[k as usize]);
    }
}

#[test]
fn outlines_are_antialiased() {
    let walls = [MOVING, STILL];
    let recording = recording(&walls);
    let maps = maps(&recording);
    let (mapped, view, time) = between(&recording, &maps);
    let rendered = blend(&mapped, &confidences(&mapped), &view, time, Detail::Full).rendered;
    let truth = filmed(&view, &walls, time);
    let (mut error, mut count) = (0.0, 0.0);
    for k in 0..SIZE[0] * SIZE[1] {
        let [x, y] = [k % SIZE[0], k / SIZE[0]];
        let corner = |n: usize| [(x + n % 2) as f64, (y + n / 2) as f64];
        let seen = (0..4).filter(|&n| MOVING.hit(&view, corner(n), time).is_some()).count();
        if (1..4).contains(&seen) {
            for (a, b) in rendered.image.pixel(x, y).iter().zip(truth.pixel(x, y)) {
                error += f64::from(a - b).powi(2);
                count += 1.0;
            }
        }
    }
    let rms = (error / count).sqrt();
    assert!(rms < 0.1, "{rms}");
}
