//! Views of the scenes.

use super::super::area::{Area, QUARTERS, doubled};
use super::super::placement::Placement;
use super::super::splat::Splat;
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
    let all = confidences(&mapped);
    let compared = quick_maps(&mapped, &view, time);
    assert!(compared.len() < mapped.len());
    let of = |k: usize| match compared.contains(&k) {
        true => all[k].clone(),
        false => uncompared(mapped[k].map),
    };
    let some: Vec<Vec<u8>> = (0..mapped.len()).map(of).collect();
    let full = blend(&mapped, &all, &view, time, Detail::Full).rendered;
    let quick = blend(&mapped, &some, &view, time, Detail::Quick).rendered;
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
    // Some pixels far apart, and some together, with empty places between them.
    let apart = (0..(20 * SIZE[0]) as u32).step_by(171);
    let together = (30..33).flat_map(|y| (40..50).map(move |x| (y * SIZE[0] + x) as u32));
    let pixels: Vec<u32> = apart.chain(together).collect();
    let splat = |camera: &Camera, area: &Area| {
        let placement = Placement::new(mapped[0], &confidences[0], (camera, time)).unwrap();
        Splat::new(&placement, area).pixels
    };
    let all = splat(&view, &Area::of_rows(&view, rows.clone()));
    let some = splat(&view, &Area::of_pixels(&view, rows.clone(), &pixels));
    assert!(all.iter().filter(|p| p.weight > 0.0).count() > all.len() / 2);
    for (pixel, &k) in some.iter().zip(&pixels) {
        assert_eq!(pixel, &all[k as usize]);
    }
    let doubled = doubled(&view);
    let all = splat(&doubled, &Area::of_rows(&doubled, 2 * rows.start..2 * rows.end));
    let quarters = splat(&doubled, &Area::of_quarters(&doubled, rows, &pixels));
    for (quarters, &k) in quarters.chunks_exact(QUARTERS).zip(&pixels) {
        let [x, y] = [k as usize % SIZE[0], k as usize / SIZE[0]].map(|at| 2 * at);
        for (n, quarter) in quarters.iter().enumerate() {
            assert_eq!(quarter, &all[(y + n / 2) * doubled.width + x + n % 2]);
        }
    }
}

/// A view is blended in bands. Where they are cut makes no difference.
#[test]
fn a_part_of_a_view_is_as_in_the_whole() {
    let recording = recording(&[MOVING, STILL]);
    let maps = maps(&recording);
    let (mapped, view, time) = between(&recording, &maps);
    let confidences = confidences(&mapped);
    let large = |first: f64, height: usize| Camera {
        width: 320,
        height,
        model: CameraModel::Pinhole { fx: 333.0, fy: 333.0, cx: 160.0, cy: 120.0 - first },
        ..view.clone()
    };
    for detail in [Detail::WithMotion, Detail::Quick] {
        let of = |camera: Camera| blend(&mapped, &confidences, &camera, time, detail);
        let (whole, part) = (of(large(0.0, 240)), of(large(70.0, 100)));
        // What holes are filled with depends on their surroundings.
        let mut differing = 0;
        for (x, y) in (8..92).flat_map(|y| (0..320).map(move |x| (x, y))) {
            let colors = [part.rendered.image.pixel(x, y), whole.rendered.image.pixel(x, y + 70)];
            let differs = |c: usize| (colors[0][c] - colors[1][c]).abs() > 0.01;
            differing += usize::from((0..3).any(differs));
            if let (Some(a), Some(b)) = (&part.motions, &whole.motions) {
                let [a, b] =
                    [a.motion(y * 320 + x), b.motion((y + 70) * 320 + x)].map(|m| m.velocity);
                differing += usize::from((0..2).any(|c| (a[c] - b[c]).abs() > 0.05));
            }
        }
        assert!(differing < 30, "{detail:?}: {differing}");
    }
}

/// Tiles whose bounds lie outside an area are left out. None of them would cover a part of the area.
#[test]
fn rows_are_splatted_alone_as_together() {
    let recording = recording(&[MOVING, STILL]);
    let mut maps = maps(&recording);
    let rolling = recording[1][1].view.clone();
    let image = recording[1][1].image.clone();
    let rolling = FlowFrame::new(&rolling, &image, recording[1][1].time).with_row_time(0.01);
    let mapped = MappedFrame { frame: &rolling, map: &maps.remove(1) };
    let confidences = vec![200; SIZE[0] * SIZE[1]];
    let (near, time) = (camera_at(0.15, 0.02), 1.9);
    let turned = |roll: f64, forward_m: f64| {
        let mut view = near.clone();
        view.cam_from_world = Isometry3::from_parts(
            Translation3::new(0.0, 0.0, -forward_m),
            UnitQuaternion::from_euler_angles(0.05, -0.1, roll),
        ) * view.cam_from_world;
        view
    };
    let distorted = Camera {
        model: CameraModel::SimpleRadial { f: FOCAL_PX, cx: 48.0, cy: 36.0, k: -0.15 },
        ..turned(0.3, 0.0)
    };
    // At its corners, lengths are halved.
    let strongly_distorted = Camera {
        model: CameraModel::SimpleRadial { f: 80.0, cx: 48.0, cy: 36.0, k: -0.2 },
        ..turned(0.1, 1.2)
    };
    let pinhole = [turned(0.0, 0.0), turned(1.2, -0.4), turned(-2.5, 1.0), turned(0.4, 2.5)];
    for view in pinhole.into_iter().chain([distorted, strongly_distorted]) {
        let placement = Placement::new(mapped, &confidences, (&view, time)).unwrap();
        let all = Splat::new(&placement, &Area::of_rows(&view, 0..SIZE[1])).pixels;
        assert!(all.iter().filter(|p| p.weight > 0.0).count() > all.len() / 9);
        for first in (0..SIZE[1]).step_by(7) {
            let rows = first..(first + 7).min(SIZE[1]);
            let alone = Splat::new(&placement, &Area::of_rows(&view, rows.clone())).pixels;
            assert!(alone == all[rows.start * SIZE[0]..rows.end * SIZE[0]], "{rows:?}");
        }
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
