//! Windows: against a naive tracker, known deformations, real images with stored tracks.

use crate::common;
use crate::naive;
use crate::pictures::{pictured, waves};
use nalgebra::{Matrix2, Point2, Vector2};
use stlfr::random::Random;
use stlfr::raster::Image;
use stlfr::raster::read_image;
use stlfr::registration::{
    AffineStart, AffineTracker, KltParameters, Pyramid, RegistrationOptions, Tracker, corners,
};

/// Odd sizes, single pixels, points at borders and corners, 8 and 16 bit, grey and colour.
#[test]
fn the_tracker_agrees_with_a_naive_one() {
    let mut random = Random::new(7);
    let (mut agreed, mut lost) = (0, 0);
    for case in 0..60 {
        let sizes = [(1, 1), (1, 9), (2, 2), (17, 31), (33, 40), (64, 47), (95, 81)];
        let (w, h) = sizes[case % sizes.len()];
        let channels = if case % 2 == 0 { 1 } else { 3 };
        let steps = if case % 3 == 0 { 65535.0 } else { 255.0 };
        let shift = Vector2::new(random.unit() - 0.5, random.unit() - 0.5) * 4.0;
        let value = waves(&mut random, channels);
        let a = pictured(w, h, channels, steps, &value);
        let b = pictured(w, h, channels, steps, |x, y, c| value(x - shift.x, y - shift.y, c));
        let options = RegistrationOptions {
            window_radius_px: [2, 3, 5, 7][case % 4],
            ..RegistrationOptions::default()
        };
        let [pa, pb] = [&a, &b].map(|i| Pyramid::new(i, options.levels, options.pad_px()));
        let mut tracker = Tracker::new(&options);
        for k in 0..12 {
            let from = match k {
                0 => Point2::new(0.0, 0.0),
                1 => Point2::new(w as f64, h as f64),
                2 => Point2::new(w as f64, 0.5),
                _ => Point2::new(random.unit() * w as f64, random.unit() * h as f64),
            };
            let fast = tracker.track(&pa, &pb, from, from).map(|t| t.position);
            let slow = naive::track(&a, &b, from, &KltParameters::from(&options));
            match (fast, slow) {
                (Some(fast), Some(slow)) => {
                    // Where the window has texture both ways, single precision decides nothing;
                    // where it has not, an iteration more or less may.
                    if (fast - slow).norm() < 2e-3 {
                        agreed += 1;
                    } else {
                        lost += 1;
                    }
                }
                (None, None) => agreed += 1,
                _ => lost += 1,
            }
        }
    }
    assert!(agreed >= 700 && lost * 100 <= agreed, "{agreed} agree, {lost} do not");
}

#[test]
fn constant_images_lose_every_point() {
    for (w, h) in [(1, 1), (9, 1), (31, 17), (64, 64)] {
        let image = Image::filled(w, h, 3, 0.3);
        let options = RegistrationOptions::default();
        let pyramid = Pyramid::new(&image, options.levels, options.pad_px());
        let mut tracker = Tracker::new(&options);
        for at in [(0.0, 0.0), (0.5, 0.5), (w as f64, h as f64)] {
            let at = Point2::new(at.0, at.1);
            assert_eq!(tracker.track(&pyramid, &pyramid, at, at), None);
        }
        assert!(corners(&pyramid.levels[0], 100).is_empty());
    }
}

/// Small images, borders, 8 and 16 bit, grey and colour, windows that turn, tilt and change light.
#[test]
fn the_deforming_window_agrees_with_a_naive_one() {
    let mut random = Random::new(19);
    let (mut tracked, mut apart) = (0, Vec::new());
    for case in 0..40 {
        let sizes = [(17, 31), (33, 40), (64, 47), (95, 81)];
        let (w, h) = sizes[case % sizes.len()];
        let channels = if case % 2 == 0 { 1 } else { 3 };
        let steps = if case % 3 == 0 { 65535.0 } else { 255.0 };
        let value = waves(&mut random, channels);
        let mut entry = || 0.2 * (random.unit() - 0.5);
        let matrix = Matrix2::identity() + Matrix2::new(entry(), entry(), entry(), entry());
        let shift = Vector2::new(10.0 * entry(), 10.0 * entry());
        let (gain, middle) = (1.0 + entry(), Vector2::new(0.5 * w as f64, 0.5 * h as f64));
        let a = pictured(w, h, channels, steps, &value);
        let b = pictured(w, h, channels, steps, |x, y, c| {
            let p = matrix * (Vector2::new(x, y) - middle - shift) + middle;
            0.5 + gain * (value(p.x, p.y, c) - 0.5)
        });
        let options = RegistrationOptions::default();
        // Wide enough for windows that reach beyond small images.
        let [pa, pb] = [&a, &b].map(|i| Pyramid::new(i, options.levels, 40));
        for k in 0..12 {
            let from = match k {
                0 => Point2::new(1.5, 1.5),
                1 => Point2::new(w as f64 - 0.1, 0.5 * h as f64),
                _ => Point2::new(random.unit() * w as f64, random.unit() * h as f64),
            };
            let translated = Tracker::new(&options).track(&pa, &pb, from, from);
            let Some(guess) = translated.map(|t| t.position) else { continue };
            let start = AffineStart { from, guess, deformation: Matrix2::identity() };
            let fast = AffineTracker::default().track(&pa, &pb, &start).map(|t| t.position);
            let slow = naive::deformed(&a, &b, from, guess);
            tracked += usize::from(slow.is_some());
            apart.push((fast.unwrap_or(guess) - slow.unwrap_or(guess)).norm());
        }
    }
    apart.sort_by(f64::total_cmp);
    // A step more or less, and what reaches beyond the padded border, is decided by little.
    let near = apart.iter().filter(|d| **d < 2e-3).count();
    println!(
        "{tracked} of {} tracked, {near} agree; median {}",
        apart.len(),
        apart[apart.len() / 2]
    );
    assert!(tracked > 250 && near * 100 >= 97 * apart.len(), "{near} of {}", apart.len());
}

/// A patch that turns, tilts, grows and changes its light: a deforming window finds it, which a
/// translated one can't.
#[test]
fn deforming_windows_are_found() {
    let mut random = Random::new(3);
    let (mut deforming_px, mut translated_px) = (Vec::new(), Vec::new());
    for _ in 0..40 {
        let value = waves(&mut random, 1);
        let mut entry = || 0.24 * (random.unit() - 0.5);
        let matrix = Matrix2::identity() + Matrix2::new(entry(), entry(), entry(), entry());
        let shift = Vector2::new(20.0 * entry(), 20.0 * entry());
        let (gain, bias) = (1.0 + entry(), 0.3 * entry());
        let middle = Vector2::new(48.3, 41.8);
        let a = pictured(96, 80, 1, 65535.0, &value);
        let inverse = matrix.try_inverse().expect("it is near one");
        let b = pictured(96, 80, 1, 65535.0, |x, y, c| {
            let p = inverse * (Vector2::new(x, y) - middle - shift) + middle;
            0.5 + gain * (value(p.x, p.y, c) - 0.5) + bias
        });
        let from = Point2::from(middle);
        let options = RegistrationOptions::default();
        let [pa, pb] = [&a, &b].map(|i| Pyramid::new(i, options.levels, options.pad_px()));
        let error = |found: Option<Point2<f64>>| {
            found.map_or(f64::INFINITY, |position| (position - from - shift).norm())
        };
        let translated = Tracker::new(&options).track(&pa, &pb, from, from).map(|t| t.position);
        let deforming = translated.and_then(|guess| {
            let start = AffineStart { from, guess, deformation: Matrix2::identity() };
            Some(AffineTracker::default().track(&pa, &pb, &start)?.position)
        });
        deforming_px.push(error(deforming));
        translated_px.push(error(translated));
    }
    for errors in [&mut deforming_px, &mut translated_px] {
        errors.sort_by(f64::total_cmp);
    }
    assert!(deforming_px[20] < 0.01 && deforming_px[35] < 0.05, "{deforming_px:?}");
    assert!(translated_px[20] > 10.0 * deforming_px[20], "{translated_px:?}");
}

/// The stored tracks of the KLT data: (x, y) with the top-left pixel's centre at (0.5, 0.5), by
/// feature and frame; `None` where lost.
fn stored() -> Vec<Vec<Option<Point2<f64>>>> {
    let path = common::root().join("tests/golden/klt/features.ft");
    let bytes = std::fs::read(path).expect("the table is there");
    let rest = bytes.strip_prefix(b"KLTFT1").expect("its signature");
    let (words, _) = rest.as_chunks::<4>();
    let count = |k: usize| i32::from_le_bytes(words[k]) as usize;
    let (frames, features) = (count(0), count(1));
    assert_eq!(words.len(), 2 + 3 * frames * features);
    let entry = |k: usize| {
        let at = &words[2 + 3 * k..];
        let v = |n: usize| f64::from(f32::from_le_bytes(at[n]));
        (i32::from_le_bytes(at[2]) >= 0).then(|| Point2::new(v(0) + 0.5, v(1) + 0.5))
    };
    (0..features).map(|f| (0..frames).map(|t| entry(f * frames + t)).collect()).collect()
}

/// The program that stored them takes half of every Newton step and stops at steps below 0.1 px, so
/// that its tracks lag behind: the same done here in full is 0.29 px away from the table in frame
/// 9 (median), with half steps 0.06 px (tests/golden/klt/README.md). Hence the bound.
#[test]
fn real_images_give_the_stored_tracks() {
    // The table's window.
    let options = RegistrationOptions { window_radius_px: 3, ..Default::default() };
    let folder = common::root().join("tests/golden/klt");
    let pyramids: Vec<Pyramid> = (0..10)
        .map(|k| {
            let (image, _) = read_image(&folder.join(format!("img{k}.pgm"))).expect("an image");
            Pyramid::new(&image, options.levels, options.pad_px())
        })
        .collect();
    let stored = stored();
    assert_eq!(stored.len(), 150);
    let mut tracker = Tracker::new(&options);
    let mut distances = Vec::new();
    let mut alive = 0;
    for feature in &stored {
        let start = feature[0].expect("all are selected in the first frame");
        let end = pyramids
            .windows(2)
            .try_fold(start, |p, pair| tracker.track(&pair[0], &pair[1], p, p).map(|t| t.position));
        let Some(end) = end else { continue };
        alive += 1;
        distances.extend(feature[9].map(|p| (p - end).norm()));
    }
    distances.sort_by(f64::total_cmp);
    let median = distances[distances.len() / 2];
    println!("alive {alive}, median {median:.3} px over {}", distances.len());
    assert!(alive >= 118, "{alive}");
    assert!(median < 0.35, "{median}");
}
