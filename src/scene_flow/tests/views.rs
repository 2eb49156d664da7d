//! Views of the scenes.

use super::super::area::Area;
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
    let placement = Placement::new(mapped[0], &confidences[0], (&view, time)).unwrap();
    let splat = |area: &Area| Splat::new(&placement, area);
    let all = splat(&Area::of_rows(&view, rows.clone()));
    let some = splat(&Area::of_pixels(&view, rows, &pixels));
    assert!(all.pixels.iter().filter(|p| p.weight > 0.0).count() > all.pixels.len() / 2);
    for (pixel, &k) in some.pixels.iter().zip(&pixels) {
        assert_eq!(pixel, &all.pixels[k as usize]);
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
    for view in
        [turned(0.0, 0.0), turned(1.2, -0.4), turned(-2.5, 1.0), turned(0.4, 2.5), distorted]
    {
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
