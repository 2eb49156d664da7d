use super::*;
use crate::camera::tests::pinhole_at;
use crate::json;
use crate::method::Method;
use crate::random::Random;
use nalgebra::{Point2, Point3};
use serde_json::{Value, json};
use std::f64::consts::PI;

fn key(at_s: f64, time_s: f64, center: [f64; 3], rotation: UnitQuaternion<f64>) -> PathKey {
    let mut camera = pinhole_at([0.0; 3]);
    let world_from_cam = Isometry3::from_parts(Vector3::from(center).into(), rotation);
    camera.cam_from_world = world_from_cam.inverse();
    PathKey { at_s, time_s, camera, rest: false }
}

fn turned(angle: f64) -> UnitQuaternion<f64> {
    UnitQuaternion::from_axis_angle(&Vector3::y_axis(), angle)
}

/// Returns a path with unevenly spaced keys that move, rotate and zoom in every direction. Two keys have the same view.
/// At another key, the path comes to rest.
fn uneven() -> CameraPath {
    let mut random = Random::new(7);
    let mut at_s = -3.0;
    let mut keys: Vec<PathKey> = (0..9)
        .map(|_| {
            at_s += 0.2 + random.unit();
            let [a, b, c] = [0; 3].map(|_| 2.0 * random.unit() - 1.0);
            let rotation = UnitQuaternion::new(Vector3::new(a, 2.0 * b, c));
            let mut key = key(at_s, a + b, [a, b, 3.0 * c], rotation);
            let focal = 600.0 + 200.0 * c;
            key.camera.model = CameraModel::Pinhole { fx: focal, fy: focal, cx: 320.0, cy: 240.0 };
            key
        })
        .collect();
    keys[4] = PathKey { at_s: keys[4].at_s, ..keys[3].clone() };
    keys[6].rest = true;
    CameraPath::new(keys, false).unwrap()
}

/// Returns the state of a path as one list: position, instant, focal length in thousands of pixels, and the vector part
/// of the quaternion `cam_from_world` with a positive scalar part.
fn state(path: &CameraPath, passed_s: f64) -> Vec<f64> {
    let frame = path.at(passed_s);
    let center = frame.camera.center();
    let rotation = frame.camera.cam_from_world.rotation;
    let q = if rotation.w < 0.0 { -rotation.into_inner() } else { rotation.into_inner() };
    let focal = frame.camera.focal_px() / 1000.0;
    vec![center.x, center.y, center.z, frame.time_s, focal, q.i, q.j, q.k]
}

#[test]
fn keys_are_met_and_nothing_jumps_in_the_first_derivative() {
    let path = uneven();
    let h = 1e-6;
    for key in path.keys().to_vec() {
        let passed_s = key.at_s - path.keys()[0].at_s;
        let frame = path.at(passed_s);
        assert!((frame.camera.center() - key.camera.center()).norm() < 1e-12);
        assert!(
            frame.camera.cam_from_world.rotation.angle_to(&key.camera.cam_from_world.rotation)
                < 1e-7
        );
        assert!((frame.time_s - key.time_s).abs() < 1e-12);
        if passed_s == 0.0 || passed_s == path.duration_s() {
            continue;
        }
        let [before, here, after] = [-h, 0.0, h].map(|step| state(&path, passed_s + step));
        for k in 0..before.len() {
            let (left, right) = ((here[k] - before[k]) / h, (after[k] - here[k]) / h);
            assert!((left - right).abs() < 1e-3, "{k} at {passed_s}: {left} {right}");
        }
    }
    let rest_s = path.keys()[6].at_s - path.keys()[0].at_s;
    let moved =
        state(&path, rest_s + h).into_iter().zip(state(&path, rest_s)).map(|(a, b)| (a - b) / h);
    assert!(moved.fold(0.0, |worst: f64, v| worst.max(v.abs())) < 1e-3);
}

#[test]
fn rotations_are_of_unit_length_and_still_between_equal_keys() {
    let path = uneven();
    for k in 0..=2000 {
        let frame = path.at(path.duration_s() * f64::from(k) / 2000.0);
        assert!((frame.camera.cam_from_world.rotation.norm() - 1.0).abs() < 1e-12);
    }
    let [from, to] = [3, 4].map(|k| path.keys()[k].at_s - path.keys()[0].at_s);
    for k in 0..=10 {
        let frame = path.at(from + (to - from) * f64::from(k) / 10.0);
        let key = &path.keys()[3];
        assert!((frame.camera.center() - key.camera.center()).norm() < 1e-12);
        assert_eq!(frame.time_s, key.time_s);
    }
}

#[test]
fn two_keys_are_a_line_at_constant_speed_along_the_shorter_arc() {
    // From 350° to 10° is a rotation by 20°, not by 340°. The second quaternion has the opposite sign.
    let turn = |degrees: f64| turned(degrees * PI / 180.0);
    let keys =
        vec![key(1.0, 0.0, [0.0; 3], turn(350.0)), key(3.0, 1.0, [1.0, 0.0, 2.0], turn(10.0))];
    let path = CameraPath::new(keys, false).unwrap();
    for (passed_s, fraction) in
        [(0.0, 0.0), (0.5, 0.25), (1.0, 0.5), (2.0, 1.0), (9.0, 1.0), (-1.0, 0.0)]
    {
        let frame = path.at(passed_s);
        assert!(
            (frame.camera.center() - Point3::new(fraction, 0.0, 2.0 * fraction)).norm() < 1e-12
        );
        let expected = turn(350.0 + 20.0 * fraction).inverse();
        assert!(frame.camera.cam_from_world.rotation.angle_to(&expected) < 1e-7, "{passed_s}");
        assert!((frame.time_s - fraction).abs() < 1e-12);
    }
}

#[test]
fn a_parabola_is_reproduced_and_a_steady_turn_is_steady() {
    let at = [0.0, 0.5, 1.7, 2.0, 3.0];
    let keys = at.map(|t| key(t, 0.1 * t, [t, t * t, 1.0 - t * t], turned(0.7 * t))).to_vec();
    let path = CameraPath::new(keys, false).unwrap();
    for k in 0..=300 {
        let t = f64::from(k) / 100.0;
        let frame = path.at(t);
        let expected = Point3::new(t, t * t, 1.0 - t * t);
        assert!((frame.camera.center() - expected).norm() < 1e-12, "{t}");
        assert!(frame.camera.cam_from_world.rotation.angle_to(&turned(0.7 * t).inverse()) < 1e-7);
        assert!((frame.time_s - 0.1 * t).abs() < 1e-12);
    }
}

#[test]
fn time_never_overshoots() {
    let times = [0.0, 1.0, 1.0, 1.0, 0.2, 0.1, 2.0];
    let keys = (0..7).map(|k| key(k as f64, times[k], [k as f64, 0.0, 0.0], turned(0.0))).collect();
    let path = CameraPath::new(keys, false).unwrap();
    for k in 0..=6000 {
        let t = f64::from(k) / 1000.0;
        let (a, b) = (times[t.floor() as usize], times[(t.floor() as usize + 1).min(6)]);
        let time_s = path.at(t).time_s;
        assert!(time_s >= a.min(b) - 1e-12 && time_s <= a.max(b) + 1e-12, "{t}: {time_s}");
    }
    // Time is stopped, and runs backwards after that.
    assert_eq!([1.0, 1.5, 2.25, 3.0].map(|t| path.at(t).time_s), [1.0; 4]);
    assert!(path.at(3.5).time_s > path.at(3.6).time_s);
}

#[test]
fn constant_speed_is_constant_where_keys_are_not() {
    let at = [0.0, 0.6, 2.0, 2.5, 4.0];
    let keys: Vec<PathKey> = at
        .iter()
        .enumerate()
        .map(|(k, &t)| key(t, t, [k as f64, (k as f64).sin(), 0.0], turned(0.1 * k as f64)))
        .collect();
    let path = CameraPath::new(keys.clone(), true).unwrap();
    let step_s = 4.0 / 4000.0;
    let lengths: Vec<f64> = (0..4000)
        .map(|k| [k, k + 1].map(|k| path.at(step_s * f64::from(k)).camera.center()))
        .map(|[a, b]| (a - b).norm())
        .collect();
    let mean = lengths.iter().sum::<f64>() / 4000.0;
    let worst = lengths.iter().map(|l| (l / mean - 1.0).abs()).fold(0.0, f64::max);
    // Where the curve bends, chords are shorter than arcs.
    assert!(worst < 2e-3, "{worst}");
    // The instant is not affected by the constant speed.
    assert!((path.at(1.0).time_s - 1.0).abs() < 1e-12);
    let still = keys.iter().map(|k| key(k.at_s, 0.0, [1.0; 3], turned(0.0))).collect();
    assert!((CameraPath::new(still, true).unwrap().at(2.0).camera.center().x - 1.0).abs() < 1e-12);
}

#[test]
fn one_key_is_a_still() {
    let path = CameraPath::new(vec![key(5.0, 0.3, [1.0, 2.0, 3.0], turned(1.0))], true).unwrap();
    assert_eq!(path.duration_s(), 0.0);
    let frames = path.frames(30.0).unwrap();
    assert_eq!((frames.len(), frames[0].time_s), (1, 0.3));
    assert!((frames[0].camera.center() - Point3::new(1.0, 2.0, 3.0)).norm() < 1e-12);
    assert_eq!(path.lasting(9.0).unwrap().frames(30.0).unwrap().len(), 1);
}

#[test]
fn frames_end_on_the_last_key() {
    let keys = vec![key(1.0, 0.0, [0.0; 3], turned(0.0)), key(3.0, 1.0, [0.0; 3], turned(0.0))];
    let path = CameraPath::new(keys, false).unwrap();
    for (rate_hz, count) in [(30.0, 61), (29.97, 60), (0.4, 1), (1.0, 3)] {
        assert_eq!(path.frames(rate_hz).unwrap().len(), count, "{rate_hz}");
    }
    assert_eq!(path.frames(30.0).unwrap()[60].time_s, 1.0);
    let longer = path.lasting(8.0).unwrap();
    assert_eq!((longer.duration_s(), longer.at(4.0).time_s), (8.0, 0.5));
    let longest = path.lasting(3e9).unwrap();
    assert!(longest.frames(1000.0).unwrap_err().to_string().contains("at most 1000000"));
    let shortest = path.lasting(1e-7).unwrap_err().to_string();
    assert!(shortest.starts_with("keys[1].at_s: is 0.0000001, "), "{shortest}");
}

fn file() -> Value {
    let camera = |x: f64| {
        json!({"width": 64, "height": 48, "model": "PINHOLE", "params": [64, 64, 32, 24],
            "cam_from_world": {"rotation_wxyz": [1, 0, 0, 0], "translation": [-x, 0, 0]}})
    };
    json!({"format": "stlfr-path", "version": 1, "keys": [
        {"at_s": 0, "time_s": 0.1, "camera": camera(0.0)},
        {"at_s": 2, "time_s": 0.1, "camera": camera(0.2), "rest": true}]})
}

fn parsed(file: &Value) -> Result<CameraPath, String> {
    json::parse::<PathFormat>(&file.to_string())?.path()
}

#[test]
fn files_are_read_and_wrong_fields_named() {
    let path = parsed(&file()).unwrap();
    assert_eq!((path.keys().len(), path.duration_s(), path.rate_hz), (2, 2.0, None));
    type Break = fn(&mut Value);
    let cases: [(Break, &str); 14] = [
        (|f| f["format"] = json!("path"), "format: must be stlfr-path"),
        (|f| f["version"] = json!(2), "version: is 2"),
        (|f| f["rate_hz"] = json!(0), "rate_hz: must be"),
        (|f| f["keys"] = json!([]), "keys: there are none"),
        (
            |f| f["keys"][1]["at_s"] = json!(0),
            "keys[1].at_s: is 0, must be at least 0.000001 s after 0",
        ),
        (|f| f["keys"][1]["at_s"] = json!(-1), "keys[1].at_s: is -1"),
        (|f| f["keys"][1]["at_s"] = json!(1e300), "keys[1].at_s: must be within"),
        (|f| f["keys"][0]["time_s"] = json!(-1e300), "keys[0].time_s: must be within"),
        (|f| f["keys"][0]["time_s"] = json!(null), "keys[0].time_s: "),
        (|f| f["keys"][1]["camera"]["width"] = json!(65), "keys[1].camera: is PINHOLE, 65×48"),
        (|f| f["keys"][1]["camera"]["params"][2] = json!(1e300), "keys[1].camera.params: must be"),
        (|f| f["keys"][1]["camera"]["params"][0] = json!(-1), "keys[1].camera.params: "),
        (
            |f| f["keys"][0]["camera"]["cam_from_world"]["rotation_wxyz"][0] = json!(0),
            "keys[0].camera.cam_from_world",
        ),
        (|f| f["keys"][0]["ease"] = json!(1), "keys[0].ease: unknown field"),
    ];
    for (wrong, words) in cases {
        let mut file = file();
        wrong(&mut file);
        let message = parsed(&file).map(drop).unwrap_err();
        assert!(message.starts_with(words), "{words}: {message}");
    }
}

/// For any numbers in a file, either the file is refused with one sentence, or all views are finite.
#[test]
fn hostile_numbers_are_refused_or_give_finite_views() {
    let numbers = [
        "0", "-0.0", "1", "-1", "1e-300", "5e-324", "1e-7", "1e9", "-1e9", "4e9", "1e12", "-1e12",
        "1e154", "1e308", "-1e308", "1e999", "0.9995", "64", "null", "[]", "\"x\"", "true",
    ];
    let text = file().to_string();
    let places: Vec<usize> = text
        .char_indices()
        .filter(|(k, c)| {
            let before = text[..*k].chars().next_back().unwrap_or(' ');
            (c.is_ascii_digit() || *c == '-') && "[:,".contains(before)
        })
        .map(|(k, _)| k)
        .collect();
    assert!(places.len() > 20);
    let mut random = Random::new(11);
    let mut pick = |count: usize| (random.unit() * count as f64) as usize % count;
    let mut accepted = 0;
    for _ in 0..4000 {
        let mut changed = text.clone();
        let mut chosen: Vec<usize> = (0..1 + pick(4)).map(|_| places[pick(places.len())]).collect();
        chosen.sort_unstable();
        chosen.dedup();
        for &start in chosen.iter().rev() {
            let end = start + text[start..].find([',', ']', '}']).unwrap();
            changed.replace_range(start..end, numbers[pick(numbers.len())]);
        }
        let path = match json::parse::<PathFormat>(&changed).and_then(PathFormat::path) {
            Ok(path) => path,
            Err(sentence) => {
                assert!(!sentence.contains('\n') && sentence.len() < 300, "{sentence}");
                continue;
            }
        };
        accepted += 1;
        for k in 0..=16 {
            let frame = path.at(path.duration_s() * f64::from(k) / 16.0);
            let all = [frame.time_s, frame.camera.cam_from_world.rotation.norm()];
            let translation = frame.camera.cam_from_world.translation.vector;
            let params = frame.camera.model.params();
            assert!(
                all.iter().chain(&params).chain(translation.iter()).all(|v| v.is_finite()),
                "{changed}: {frame:?}"
            );
            assert!(params[0] > 0.0 && params[1] > 0.0, "{changed}");
        }
    }
    assert!(accepted > 200, "{accepted}");
}

/// Returns four rigs: a line, an arc that looks at a point 3 m away, a grid, and a single camera.
fn rigs() -> [Vec<Camera>; 4] {
    let line = (0..8).map(|c| pinhole_at([0.06 * (c as f64 - 3.5), 0.0, 0.0])).collect();
    let arc = (0..8)
        .map(|c| {
            let angle = 0.1 * (f64::from(c) - 3.5);
            let mut camera = pinhole_at([0.0; 3]);
            let rotation = turned(-angle);
            let place = Vector3::new(3.0 * angle.sin(), 0.0, 3.0 - 3.0 * angle.cos());
            camera.cam_from_world = Isometry3::from_parts(place.into(), rotation).inverse();
            camera
        })
        .collect();
    let grid = (0..8)
        .map(|c| pinhole_at([0.1 * (f64::from(c % 4) - 1.5), 0.1 * f64::from(c / 4), 0.0]))
        .collect();
    [line, arc, grid, vec![pinhole_at([1.0, 2.0, 3.0])]]
}

fn scene(cameras: &[Camera]) -> PathScene<'_> {
    PathScene {
        cameras,
        lens: &cameras[cameras.len() / 2],
        depths_m: [2.0, 3.0, 5.0],
        span_s: (0.1, 0.5),
        frozen_s: None,
        duration_s: 4.0,
    }
}

#[test]
fn ready_made_paths_stay_inside_of_what_the_cameras_see() {
    for cameras in rigs() {
        for kind in ReadyMadePath::ALL {
            let path = kind.path(&scene(&cameras)).unwrap();
            let mut moved = 0.0_f64;
            for frame in path.frames(30.0).unwrap() {
                let view = &frame.camera;
                assert!((0.1..=0.5).contains(&frame.time_s), "{kind:?} {}", frame.time_s);
                moved = moved.max((view.center() - path.keys()[0].camera.center()).norm());
                // Corners and centre of the image, at depths of 2, 3 and 4.9 m from the view.
                let corners =
                    [[0.0, 0.0], [640.0, 0.0], [0.0, 480.0], [640.0, 480.0], [320.0, 240.0]];
                let corner = corners.map(|p| view.ray_world(&p.into()).unwrap());
                let seen = corner.iter().flat_map(|ray| {
                    [2.0, 3.0, 4.9].map(|depth| {
                        let point = view.center() + ray * depth;
                        cameras.iter().any(|c| c.project(&point).is_some_and(|p| c.contains(&p)))
                    })
                });
                let seen: Vec<bool> = seen.collect();
                let count = seen.iter().filter(|s| **s).count();
                assert!(count * 10 >= 9 * seen.len(), "{kind:?}: {count} of {}", seen.len());
            }
            assert!(cameras.len() == 1 || moved > 0.05, "{kind:?} stands still: {moved}");
        }
    }
}

#[test]
fn bullet_time_stops_and_goes_on() {
    let [line, ..] = rigs();
    let path = ReadyMadePath::BulletTime.path(&scene(&line)).unwrap();
    let times: Vec<f64> = path.frames(30.0).unwrap().iter().map(|f| f.time_s).collect();
    assert!(times.is_sorted() && (times[0] - 0.1).abs() < 1e-9 && (times[120] - 0.5).abs() < 1e-9);
    assert!(times[31..90].iter().all(|t| (t - 0.3).abs() < 1e-9));
    let place = |s: f64| path.at(s).camera.center().x;
    assert!(place(1.0) == place(0.0) && place(3.0) == place(4.0) && place(3.0) > place(1.0) + 0.2);
    let at = |frozen_s| {
        let scene = PathScene { frozen_s: Some(frozen_s), ..scene(&line) };
        ReadyMadePath::Sweep.path(&scene).unwrap().at(1.3).time_s
    };
    assert_eq!(at(0.2), 0.2);
}

#[test]
fn an_orbit_is_a_closed_loop_aimed_at_the_subject() {
    let [line, _, grid, _] = rigs();
    for cameras in [line, grid] {
        let path = ReadyMadePath::Orbit.path(&scene(&cameras)).unwrap();
        let (start, end) = (path.at(0.0).camera, path.at(4.0).camera);
        assert!((start.center() - end.center()).norm() < 1e-9);
        let middle = cameras.iter().map(|c| c.center().coords).sum::<Vector3<f64>>() / 8.0;
        let subject = Point3::from(middle + Vector3::new(0.0, 0.0, 3.0));
        for k in 0..=40 {
            let view = path.at(f64::from(k) / 10.0).camera;
            let pixel = view.project(&subject).unwrap();
            assert!((pixel - Point2::new(320.0, 240.0)).norm() < 0.3, "{pixel}");
        }
    }
}
