//! Tests of the static background, whose depth is found once for a recording.

use super::*;

/// A wall that passes before the static one. It moves by 10 pixels per frame.
const PASSING: Wall = Wall { depth_m: 2.0, velocity: [0.2, 0.0], half_m: [0.2; 2], plain_m: 0.0 };
/// Number of frames of each camera.
const FRAMES: usize = 7;

/// Returns the frames of four cameras in a line while a wall passes, which is in the middle at time 0.
fn passing() -> Vec<Vec<FlowFrame>> {
    passing_of(PASSING)
}

/// Returns the frames of the same cameras while this wall passes.
fn passing_of(wall: Wall) -> Vec<Vec<FlowFrame>> {
    let frames = |c: usize| {
        let camera = camera_at(SPACING_M * c as f64, 0.0);
        let frame = |k: usize| {
            let time = k as f64 - 3.0 + 0.25 * [0.0, 2.0, 1.0, 3.0][c];
            FlowFrame::new(&camera, &filmed(&camera, &[wall, STILL], time), time)
        };
        (0..FRAMES).map(frame).collect()
    };
    (0..4).map(frames).collect()
}

/// Returns the static background of the cameras.
fn still_images(recording: &[Vec<FlowFrame>]) -> Vec<StillImage> {
    let compact = |frames: &Vec<FlowFrame>| {
        let all: Vec<_> = frames.iter().map(|f| CompactImage::new(&f.image)).collect();
        StillImage::new(&all, 0.6)
    };
    recording.iter().map(compact).collect()
}

/// Returns the static background of the cameras, and its maps.
fn stills(recording: &[Vec<FlowFrame>]) -> (Vec<StillImage>, Vec<FlowMap>) {
    let stills = still_images(recording);
    let frames: Vec<FlowFrame> =
        stills.iter().zip(recording).map(|(still, f)| still.frame(&f[0])).collect();
    let with_others = |c: usize| {
        let others = frames.iter().enumerate().filter(|(k, _)| *k != c).map(|(_, f)| f).collect();
        (&frames[c], others)
    };
    let list: Vec<(&FlowFrame, Vec<&FlowFrame>)> = (0..frames.len()).map(with_others).collect();
    let maps = estimated(&list, &[], 0.0, &|| true);
    (stills, maps)
}

fn error_px(map: &FlowMap, k: usize, depth_m: f64) -> f64 {
    let element = map.element(&map.pixels()[k]);
    ((f64::from(element.inverse_depth) - 1.0 / depth_m) * f64::from(map.disparity_px)).abs()
}

#[test]
fn the_background_has_its_depth_where_a_body_passes_and_no_motion() {
    let (_, maps) = stills(&passing());
    for map in &maps {
        let errors = (0..map.pixels().len()).map(|k| error_px(map, k, STILL.depth_m)).collect();
        assert!(median(errors) < 0.05);
        assert!(map.pixels().iter().all(|p| map.element(p).speed() == 0.0));
    }
}

#[test]
fn a_frame_takes_the_background_as_given_and_finds_depth_and_motion_of_the_body() {
    assert_given(&passing());
}

#[test]
fn a_frame_with_a_mask_of_the_background_takes_it_as_given_too() {
    let stills = still_images(&passing());
    let masked = |(frames, still): (Vec<FlowFrame>, &StillImage)| {
        frames.into_iter().map(|frame| frame.with_still(still)).collect()
    };
    let recording: Vec<Vec<FlowFrame>> = passing().into_iter().zip(&stills).map(masked).collect();
    assert!(recording.iter().flatten().all(|frame| frame.still.is_some()));
    assert_given(&recording);
}

/// Returns each camera's middle frame, with the frames before and after it, and the other cameras' middle frames.
fn middle_frames(recording: &[Vec<FlowFrame>]) -> Vec<(&FlowFrame, Vec<&FlowFrame>)> {
    let middle = FRAMES / 2;
    let matched = |c: usize| {
        let own = &recording[c];
        let others = (0..4).filter(|&other| other != c).map(|other| &recording[other][middle]);
        (&own[middle], [&own[middle - 1], &own[middle + 1]].into_iter().chain(others).collect())
    };
    (0..4).map(matched).collect()
}

/// Asserts that maps of the middle frames have the background's depth where it is given, and the body's depth and motion
/// in the body.
fn assert_given(recording: &[Vec<FlowFrame>]) {
    let (stills, still_maps) = stills(recording);
    let middle = FRAMES / 2;
    let frames = middle_frames(recording);
    let backgrounds: Vec<_> = stills.iter().zip(&still_maps).collect();
    let maps = estimated(&frames, &backgrounds, MAX_SPEED, &|| true);
    let plain = estimated(&frames, &[], MAX_SPEED, &|| true);
    for (c, map) in maps.iter().enumerate() {
        let frame = &recording[c][middle];
        let (mut errors, mut motion, mut given) = (Vec::new(), Vec::new(), 0);
        let levels = frame.pyramid_before(&stills[c]);
        let background = Background::new(PyramidFrame { frame, levels: &levels }, &still_maps[c]);
        for k in 0..map.pixels().len() {
            let place = [k % SIZE[0], k / SIZE[0]];
            let is_body =
                PASSING.hit(&frame.view, place.map(|v| v as f64 + 0.5), frame.time).is_some();
            if let Some(element) = background.element(0, place) {
                assert!(!is_body, "camera {c}: {place:?} is in the body");
                let found = map.element(&map.pixels()[k]);
                assert!((found.inverse_depth - element.inverse_depth).abs() < 1e-4);
                assert_eq!(found.speed(), 0.0);
                given += 1;
            } else if is_body {
                errors.push(error_px(map, k, PASSING.depth_m));
                motion.push((f64::from(map.element(&map.pixels()[k]).velocity[0]) - 10.0).abs());
            }
        }
        assert!(2 * given > map.pixels().len(), "camera {c}: {given} pixels are given");
        let [disparity, motion] = [errors, motion].map(median);
        assert!(disparity < 0.1 && motion < 0.3, "camera {c}: {disparity} px, {motion} px");
        assert!(map != &plain[c], "the background changes the map");
    }
}

#[test]
fn pixels_of_unknown_depth_are_not_given() {
    let recording = passing();
    let (stills, maps) = stills(&recording);
    let map = maps[0].clone().known_where(|k| k % SIZE[0] >= 48);
    assert!(!map.pixels()[0].is_known() && map.pixels()[48].is_known());
    let frame = &recording[0][0];
    let levels = frame.pyramid_before(&stills[0]);
    let background = Background::new(PyramidFrame { frame, levels: &levels }, &map);
    let last = SIZE[1] - 1;
    assert!((0..48).all(|x| background.element(0, [x, last]).is_none()));
    assert!((48..SIZE[0]).all(|x| background.element(0, [x, last]).is_some()));
    // A pixel of a coarser level is given if all of it is.
    assert!(background.element(2, [20, last / 4]).is_some());
    assert!(background.element(2, [2, last / 4]).is_none());
}

/// Returns the frames of the four cameras while this wall passes, and the maps of their middle frames, with the static
/// background known.
fn estimated_before_background(wall: Wall) -> (Vec<Vec<FlowFrame>>, Vec<FlowMap>) {
    let recording = passing_of(wall);
    let (stills, still_maps) = stills(&recording);
    let backgrounds: Vec<_> = stills.iter().zip(&still_maps).collect();
    let maps = estimated(&middle_frames(&recording), &backgrounds, MAX_SPEED, &|| true);
    (recording, maps)
}

/// Returns the fraction of a body's pixels whose disparity or motion to the right is wrong by more than a pixel.
fn wrong_of(body: Wall) -> f64 {
    let (recording, maps) = estimated_before_background(body);
    let (mut wrong, mut all) = (0u32, 0u32);
    for (map, frames) in maps.iter().zip(&recording) {
        let FlowFrame { view, time, .. } = &frames[FRAMES / 2];
        for (k, pixel) in map.pixels().iter().enumerate() {
            let place = [k % SIZE[0], k / SIZE[0]].map(|v| v as f64 + 0.5);
            if body.hit(view, place, *time).is_some() {
                let expected = body.velocity[0] * FOCAL_PX / body.depth_m;
                let motion_px = (f64::from(map.element(pixel).velocity[0]) - expected).abs();
                wrong += u32::from(error_px(map, k, body.depth_m).max(motion_px) > 1.0);
                all += 1;
            }
        }
    }
    f64::from(wrong) / f64::from(all)
}

#[test]
fn small_bodies_are_found_where_other_frames_show_the_background_behind_them() {
    // Squares of 6 and 8 pixels that move by 3 to 8 pixels per frame.
    let cases = [0.06, 0.08].map(|half| [0.06, 0.1, 0.16].map(|speed| (half, speed))).concat();
    let body = |&(half, speed)| Wall { half_m: [half; 2], velocity: [speed, 0.0], ..PASSING };
    let wrong: Vec<f64> = cases.iter().map(|case| wrong_of(body(case))).collect();
    let mean = wrong.iter().sum::<f64>() / wrong.len() as f64;
    assert!(mean < 0.11, "these fractions of the squares' pixels are wrong: {wrong:.2?}");
}

/// Returns how much the motions along a vertical bar differ between pixels that are 6 rows apart: the 95th percentile, pixels
/// per frame.
fn difference_along(bar: Wall) -> f64 {
    let (recording, maps) = estimated_before_background(bar);
    let mut differences = Vec::new();
    for (map, frames) in maps.iter().zip(&recording) {
        let FlowFrame { view, time, .. } = &frames[FRAMES / 2];
        let is_bar = |k: usize| {
            let place = [k % SIZE[0], k / SIZE[0]].map(|v| v as f64 + 0.5);
            bar.hit(view, place, *time).is_some()
        };
        let along = |k: usize| map.element(&map.pixels()[k]).velocity[1];
        let pairs = (0..SIZE[0] * (SIZE[1] - 6)).map(|k| (k, k + 6 * SIZE[0]));
        let pairs = pairs.filter(|&(a, b)| is_bar(a) && is_bar(b));
        differences.extend(pairs.map(|(a, b)| f64::from((along(a) - along(b)).abs())));
    }
    differences.sort_by(f64::total_cmp);
    differences[differences.len() * 19 / 20]
}

#[test]
fn a_thin_plain_body_moves_as_a_whole() {
    // Bars 2 pixels wide, across the whole image. No image shows their motion along themselves.
    let bar = Wall { half_m: [0.02, 2.0], plain_m: f64::INFINITY, ..PASSING };
    let speeds = [0.06, 0.1, 0.2]; // 3, 5 and 10 pixels per frame
    let along = speeds.map(|speed| difference_along(Wall { velocity: [speed, 0.0], ..bar }));
    let mean = along.iter().sum::<f64>() / 3.0;
    assert!(
        mean < 2.8,
        "pieces of the bars move along them by amounts that differ by {along:?} px"
    );
}
