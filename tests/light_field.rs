//! Offsets and images through the command line, against a scene in closed form.

mod common;

use common::bodies::{Recording, board_before_wall, pose};
use common::scores::psnr_db;
use common::synthetic::{self, HEIGHT, RATE_HZ, WIDTH};
use common::worlds::line_rig;
use common::{assert_refused, edit, run, stderr, succeed, text};
use serde_json::{Value, json};
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use std::sync::Arc;
use stlfr::camera::Camera;
use stlfr::capture::Capture;
use stlfr::light_field::LightField;
use stlfr::offset::Offsets;
use stlfr::options::{ProxyMethod, RenderOptions};
use stlfr::raster::{BitDepth, Image, read_image, write_image};
use stlfr::raster::{encoded_from_linear, linear_from_encoded};
use tempfile::TempDir;

/// Frames after the scene's start, the reference (the middle one) not at 0.
const DELAYS_FRAMES: [f64; 3] = [0.6, 0.2, -0.1];
const FRAMES: usize = 6;

fn offsets(capture: &Path) -> Value {
    let output = succeed(&["-q", "offsets", text(capture), "--json"]);
    serde_json::from_slice(&output.stdout).unwrap()
}

fn offset_s(offsets: &Value, camera: usize) -> f64 {
    offsets["cameras"][camera]["offset_s"].as_f64().expect("the offset is known")
}

/// `render --like` at a time, decoded.
#[track_caller]
fn like(capture: &Path, camera: usize, time_s: f64) -> Image {
    let out = tempfile::tempdir().unwrap();
    let (file, id) = (out.path().join("like.png"), format!("cam{camera}"));
    let time = format!("{time_s:?}");
    let arguments = ["render", text(capture), "--like", &id, "--time", &time, "-o", text(&file)];
    succeed(&[&["-q"], arguments.as_slice()].concat());
    read_image(&file).unwrap().0
}

fn frame(capture: &Path, camera: usize, frame: usize) -> Image {
    read_image(&capture.join(format!("cam{camera}/{frame:04}.png"))).unwrap().0
}

/// The sign of offsets: time on the reference's clock = time on the camera's + offset.
#[test]
fn a_camera_that_opens_later_has_a_positive_offset() {
    let capture = synthetic::capture(&DELAYS_FRAMES, FRAMES);
    let found = offsets(capture.path());
    assert_eq!(found["reference"], "cam1");
    assert_eq!(found["cameras"][1], json!({"id": "cam1", "offset_s": 0.0, "std_err_s": 0.0}));
    for (camera, true_frames) in [(0, 0.4), (2, -0.3)] {
        let (found_s, std_err_s) = (
            offset_s(&found, camera),
            found["cameras"][camera]["std_err_s"].as_f64().expect("the error is known"),
        );
        let error_frames = (found_s * RATE_HZ - true_frames).abs();
        assert!(error_frames < 0.01, "cam{camera}: off by {error_frames} frame");
        assert!(std_err_s > 0.0 && std_err_s * RATE_HZ < 0.03, "cam{camera}: ±{std_err_s} s");
    }
    // 0.4 frame at 30 a second.
    assert!((offset_s(&found, 0) - 0.0133).abs() < 4e-4);
}

#[test]
fn at_the_time_of_a_frame_that_frame_is_rendered() {
    let capture = synthetic::capture(&DELAYS_FRAMES, FRAMES);
    let found = offsets(capture.path());
    for camera in 0..3 {
        for k in [0, 2, FRAMES - 1] {
            let time_s = k as f64 / RATE_HZ + offset_s(&found, camera);
            let rendered = like(capture.path(), camera, time_s);
            assert_eq!(rendered, frame(capture.path(), camera, k), "cam{camera}, frame {k}");
        }
    }
}

#[test]
fn between_frames_the_image_is_the_closed_form() {
    let capture = synthetic::capture(&DELAYS_FRAMES, FRAMES);
    for camera in 0..3 {
        let time_s = 2.5 / RATE_HZ;
        let world_s = time_s + DELAYS_FRAMES[1] / RATE_HZ;
        let truth = synthetic::image(synthetic::place_m(camera, 3), 0.0, world_s);
        let rendered = psnr_db(&like(capture.path(), camera, time_s), &truth, 8);
        let nearest = (0..FRAMES)
            .map(|k| psnr_db(&frame(capture.path(), camera, k), &truth, 8))
            .fold(0.0, f64::max);
        assert!(rendered > 30.0, "cam{camera}: {rendered} dB");
        assert!(rendered > nearest + 10.0, "cam{camera}: {rendered} dB, nearest {nearest} dB");
    }
}

#[test]
fn a_new_view_is_the_closed_form() {
    let capture = synthetic::capture(&DELAYS_FRAMES, FRAMES);
    let time_s = 2.45 / RATE_HZ;
    let world_s = time_s + DELAYS_FRAMES[1] / RATE_HZ;
    let truth = synthetic::image(0.025, 0.0, world_s);
    let (view, image) = (capture.path().join("view.json"), capture.path().join("view.png"));
    std::fs::write(&view, synthetic::view(0.025, 0.0).to_string()).unwrap();
    for proxy in ["plane", "mesh", "depth"] {
        let time = format!("{time_s:?}");
        let where_and_when = ["--camera", text(&view), "--time", &time, "--proxy", proxy];
        let arguments = [&["render", text(capture.path())], where_and_when.as_slice()].concat();
        succeed(&[arguments.as_slice(), &["-o", text(&image)]].concat());
        let rendered = psnr_db(&read_image(&image).unwrap().0, &truth, 8);
        assert!(rendered > 28.0, "{proxy}: {rendered} dB");
        succeed(&[arguments.as_slice(), &["--sync", "nearest", "-o", text(&image)]].concat());
        let traditional = psnr_db(&read_image(&image).unwrap().0, &truth, 8);
        assert!(rendered > traditional + 6.0, "{proxy}: {rendered} dB, LFR {traditional} dB");
    }
}

/// A board moves by 5 pixels a frame before a still wall.
#[test]
fn synchronized_cameras_show_motion_between_their_frames_by_scene_flow() {
    let world = board_before_wall(|frames| pose([0.0; 3], [0.04 * frames - 0.06, 0.0, 1.3]));
    let (cameras, folder) = (line_rig(8, 160), tempfile::tempdir().unwrap());
    Recording { world: &world, cameras: &cameras, first_frames: &[0.0; 8], frames: 4, noise: 0.0 }
        .write(folder.path());
    let capture = Arc::new(Capture::open(folder.path()).unwrap());
    let field = LightField::new(capture.clone(), Offsets::known(&capture));
    let mut options = RenderOptions::default();
    options.proxy.method = ProxyMethod::SceneFlow;
    let middle = Camera { cam_from_world: Default::default(), ..cameras[0].clone() };
    let time_s = 1.4 / 30.0 - capture.time_origin_s;
    let seen = field.view(&middle, time_s, &options).unwrap().image;
    let db = psnr_db(&seen, &world.film(&middle, 1.4, 0.0, 1), 8);
    let nearest = psnr_db(&world.film(&middle, 1.0, 0.0, 1), &world.film(&middle, 1.4, 0.0, 1), 8);
    println!("{db:.1} dB, nearest frame {nearest:.1} dB");
    assert!(db > nearest + 10.0, "{db:.1} dB, nearest frame {nearest:.1} dB");
}

/// Noise makes the frames of a still wall differ. Halfway between two frames of a camera, the later one takes over.
#[test]
fn a_view_by_scene_flow_does_not_jump_where_another_frame_takes_over() {
    let world = board_before_wall(|frames| pose([0.0; 3], [0.02 * frames, 0.0, 1.3]));
    let (cameras, folder) = (line_rig(4, 160), tempfile::tempdir().unwrap());
    let first_frames = &[0.0, 0.25, 0.5, 0.75];
    Recording { world: &world, cameras: &cameras, first_frames, frames: 4, noise: 0.02 }
        .write(folder.path());
    let capture = Arc::new(Capture::open(folder.path()).unwrap());
    let field = LightField::new(capture.clone(), Offsets::known(&capture));
    let mut options = RenderOptions::default();
    options.proxy.method = ProxyMethod::SceneFlow;
    let at = |frames: f64| {
        let time_s = frames / 30.0 - capture.time_origin_s;
        field.view(&cameras[1], time_s, &options).unwrap().image
    };
    let [before, after] = [1.75 - 1e-6, 1.75 + 1e-6].map(at);
    let later = psnr_db(&before, &at(1.95), 8);
    let db = psnr_db(&before, &after, 8);
    println!("{db:.1} dB, a fifth of a frame later {later:.1} dB");
    assert!(db > 45.0, "{db:.1} dB, a fifth of a frame later {later:.1} dB");
}

#[test]
fn many_times_are_each_one_time_as_images_and_as_a_video() {
    let capture = synthetic::capture(&DELAYS_FRAMES, FRAMES);
    let out = tempfile::tempdir().unwrap();
    let (start_s, end_s) = (1.25 / RATE_HZ, 3.75 / RATE_HZ);
    let times = format!("{start_s:?}:{end_s:?}:3");
    let render = |output: &Path, when: [&str; 2]| {
        let arguments = ["render", text(capture.path()), "--like", "cam1", when[0], when[1]];
        succeed(&[arguments.as_slice(), &["-o", text(output)]].concat());
    };
    render(&out.path().join("new/%04d.png"), ["--times", &times]);
    let mut names: Vec<String> = std::fs::read_dir(out.path().join("new"))
        .unwrap()
        .map(|e| e.unwrap().file_name().into_string().unwrap())
        .collect();
    names.sort();
    assert_eq!(names, ["0000.png", "0001.png", "0002.png"]);

    let mut raw = Vec::new();
    let mut all = Vec::new();
    for (name, time_s) in names.iter().zip([start_s, start_s + (end_s - start_s) / 2.0, end_s]) {
        let one = out.path().join("one.png");
        render(&one, ["--time", &format!("{time_s:?}")]);
        let bytes = std::fs::read(&one).unwrap();
        assert_eq!(bytes, std::fs::read(out.path().join("new").join(name)).unwrap(), "{name}");
        let image = read_image(&one).unwrap().0;
        raw.extend(image.data().iter().map(|v| (255.0 * v).round() as u8));
        all.push(bytes);
    }
    assert!(all[0] != all[1] && all[1] != all[2]);

    let video = out.path().join("slow.mkv");
    let ffmpeg = common::ffmpeg();
    render(&video, ["--times", &times]);
    let decoded = Command::new(ffmpeg)
        .args(["-v", "error", "-i", text(&video)])
        .args(["-f", "rawvideo", "-pix_fmt", "rgb24", "-"])
        .output()
        .unwrap();
    assert!(decoded.status.success(), "{}", stderr(&decoded));
    assert_eq!(decoded.stdout.len(), 3 * WIDTH * HEIGHT * 3, "three frames");
    assert!(decoded.stdout == raw, "the video holds other pixels than the images");
}

#[test]
fn times_outside_of_the_recordings_are_refused_with_the_range() {
    let capture = synthetic::capture(&DELAYS_FRAMES, FRAMES);
    let found = offsets(capture.path());
    let view = capture.path().join("view.json");
    std::fs::write(&view, synthetic::view(0.0, 0.0).to_string()).unwrap();
    let out = capture.path().join("out.png");
    let last_s = (FRAMES - 1) as f64 / RATE_HZ;
    let refused = |where_from: [&str; 2], time: &str, range_s: (f64, f64)| {
        let arguments = ["-q", "render", text(capture.path()), where_from[0], where_from[1]];
        let output = run(&[arguments.as_slice(), &["--time", time, "-o", text(&out)]].concat());
        assert_refused(&output, 2, &format!("around {time} s"));
        let numbers: Vec<f64> =
            stderr(&output).split(' ').filter_map(|word| word.trim().parse().ok()).collect();
        let range = &numbers[numbers.len() - 2..];
        // Rounded to four decimals.
        assert!((range[0] - range_s.0).abs() < 1e-4, "{numbers:?}, not {range_s:?}");
        assert!((range[1] - range_s.1).abs() < 1e-4, "{numbers:?}, not {range_s:?}");
        assert!(!out.exists());
    };
    refused(["--like", "cam1"], "0.2", (0.0, last_s));
    let offset = offset_s(&found, 0);
    refused(["--like", "cam0"], "0.001", (offset, last_s + offset));
    refused(["--camera", text(&view)], "-0.5", (offset_s(&found, 2), last_s + offset));
}

#[test]
fn one_camera_is_slow_motion_of_a_video() {
    let capture = synthetic::capture(&[0.0], FRAMES);
    for at_frames in [0.0, 2.3, 4.5] {
        let truth = synthetic::image(0.0, 0.0, at_frames / RATE_HZ);
        let rendered = psnr_db(&like(capture.path(), 0, at_frames / RATE_HZ), &truth, 8);
        assert!(rendered > 30.0, "{at_frames}: {rendered} dB");
    }
    assert_refused(&run(&["offsets", text(capture.path()), "--json"]), 2, "capture.json: cameras");
}

#[test]
fn one_frame_a_camera_is_a_static_light_field() {
    let capture = synthetic::capture(&[0.0; 3], 1);
    let (view, out) = (capture.path().join("view.json"), capture.path().join("out.png"));
    std::fs::write(&view, synthetic::view(0.025, 0.0).to_string()).unwrap();
    let images = ["0", "-7.5", "1e6"].map(|time| {
        let camera = ["--camera", text(&view), "--time", time, "-o", text(&out)];
        succeed(&[&["render", text(capture.path())], camera.as_slice()].concat());
        assert_eq!(like(capture.path(), 2, time.parse().unwrap()), frame(capture.path(), 2, 0));
        read_image(&out).unwrap().0
    });
    assert!(images[0] == images[1] && images[1] == images[2]);
    let found = psnr_db(&images[0], &synthetic::image(0.025, 0.0, 0.0), 8);
    assert!(found > 28.0, "{found} dB");
}

#[test]
fn nothing_in_a_static_light_field_moves_by_scene_flow() {
    let capture = synthetic::capture(&[0.0; 3], 1);
    let opened = Arc::new(Capture::open(capture.path()).unwrap());
    let field = LightField::new(opened.clone(), Offsets::known(&opened));
    let frames = [(0, 0), (1, 0), (2, 0)];
    for loaded in field.frames_with_flow(&frames, &RenderOptions::default()).unwrap() {
        let map = &loaded.map;
        assert!(map.pixels().iter().all(|pixel| map.element(pixel).velocity == [0.0; 2]));
    }
}

#[test]
fn cached_offsets_are_used_until_something_changes() {
    let capture = synthetic::capture(&DELAYS_FRAMES, FRAMES);
    let folder = capture.path();
    let out = folder.join("out.png");
    let render = ["render", text(folder), "--like", "cam0", "--time", "0.08", "-o", text(&out)];
    let notes = |more: &[&str]| stderr(&succeed(&[render.as_slice(), more].concat()));
    assert!(notes(&[]).contains("were estimated"));
    let estimated = offset_s(&offsets(folder), 0);
    assert!(notes(&[]).contains("those of offsets.json"), "nothing has changed");

    // Other options, those of rendering aside.
    let options = folder.join("options.json");
    std::fs::write(&options, r#"{"sync": "crossfade"}"#).unwrap();
    let view = notes(&["--options", text(&options)]);
    assert!(view.contains("those of offsets.json"), "a view's options don't matter: {view}");
    std::fs::write(&options, r#"{"offset": {"method": "joint"}}"#).unwrap();
    let joint = notes(&["--options", text(&options)]);
    assert!(joint.contains("made anew") && joint.contains("were estimated"), "{joint}");
    assert_eq!(offset_s(&offsets(folder), 0), estimated);

    // One byte of one frame: here the pixel's, the file stays a PNG.
    notes(&[]);
    let changed = folder.join("cam2/0003.png");
    let mut image = read_image(&changed).unwrap().0;
    image.data_mut()[0] = 1.0 - image.data()[0];
    write_image(&changed, &image, None, BitDepth::Eight).unwrap();
    assert!(notes(&[]).contains("were estimated"));
    let again = offset_s(&offsets(folder), 0);
    assert!((again - estimated).abs() < 1e-4, "{again} s, {estimated} s");
}

/// A capture to break, and where its view is written. Each refusal is one sentence with file and
/// field, and exit code 2; nothing is written.
struct Broken {
    capture: TempDir,
    out: PathBuf,
}

const LIKE: [&str; 4] = ["--like", "cam0", "--time", "0.01"];

impl Broken {
    fn new() -> Self {
        let capture = synthetic::capture(&[0.0, 0.3], 3);
        let out = capture.path().join("out.png");
        Self { capture, out }
    }

    fn folder(&self) -> &Path {
        self.capture.path()
    }

    fn render(&self, view: &[&str]) -> Output {
        let render = ["-q", "render", text(self.folder()), "-o", text(&self.out)];
        run(&[render.as_slice(), view].concat())
    }

    #[track_caller]
    fn assert_refused(&self, view: &[&str], words: &str) {
        assert_refused(&self.render(view), 2, words);
        assert!(!self.out.exists());
    }

    /// Once all is mended, it works: nothing was lost.
    #[track_caller]
    fn assert_works(&self) {
        assert!(Capture::open(self.folder()).is_ok());
        assert!(self.render(&LIKE).status.success());
        assert!(self.out.exists());
    }
}

#[test]
fn wrong_descriptions_are_refused() {
    let broken = Broken::new();
    let json_file = broken.folder().join("capture.json");
    let good = std::fs::read_to_string(&json_file).unwrap();

    type Break = fn(&mut Value);
    let cases: &[(Break, &str)] = &[
        (|j| j["cameras"] = json!([]), "capture.json: cameras"),
        (|j| j["cameras"][1]["id"] = json!("cam0"), "two cameras have the id 'cam0'"),
        (|j| j["speed"] = json!(1), "capture.json: speed: unknown field `speed`"),
        (|j| j["cameras"][1]["clock"]["speed"] = json!(1), "cameras[1].clock.speed: unknown field"),
        (|j| j["cameras"][1]["frames"] = json!("../%04d.png"), "(cam1).frames"),
        (|j| j["cameras"][1]["frames"] = json!("cam9/%04d.png"), "(cam1).frames"),
        (|j| j["cameras"][1]["params"][0] = json!(-1), "(cam1).params"),
        (|j| j["cameras"][1]["cam_from_world"]["rotation_wxyz"][0] = json!(0.9), "rotation_wxyz"),
        (|j| j["cameras"][1]["cam_from_world"]["translation"][0] = json!(null), "capture.json"),
        (|j| j["cameras"][1]["width"] = json!(161), "cam1/0000.png"),
    ];
    for (make_wrong, words) in cases {
        edit(broken.folder(), make_wrong);
        broken.assert_refused(&LIKE, words);
        std::fs::write(&json_file, &good).unwrap();
    }
    std::fs::write(&json_file, good.replacen("170.0", "NaN", 1)).unwrap();
    broken.assert_refused(&LIKE, "capture.json");
    std::fs::write(&json_file, &good).unwrap();
    broken.assert_works();
    assert_eq!(std::fs::read_to_string(&json_file).unwrap(), good);
}

#[test]
fn missing_and_broken_frames_are_refused() {
    let broken = Broken::new();
    let (camera, moved) = (broken.folder().join("cam1"), broken.folder().join("aside"));
    let middle = camera.join("0001.png");
    std::fs::rename(&middle, &moved).unwrap();
    broken.assert_refused(&LIKE, "(cam1)");
    let whole = std::fs::read(&moved).unwrap();
    for bytes in [&whole[..whole.len() / 2], b""] {
        std::fs::write(&middle, bytes).unwrap();
        broken.assert_refused(&LIKE, "cam1/0001.png");
    }
    std::fs::rename(&moved, &middle).unwrap();
    std::fs::rename(&camera, &moved).unwrap();
    std::fs::create_dir(&camera).unwrap();
    broken.assert_refused(&LIKE, "(cam1).frames");
    std::fs::remove_dir(&camera).unwrap();
    std::fs::rename(&moved, &camera).unwrap();
    broken.assert_works();
}

#[test]
fn wrong_views_and_outputs_are_refused() {
    let broken = Broken::new();
    broken.assert_refused(&["--like", "cam9", "--time", "0.01"], "'cam9'");
    let view = broken.folder().join("view.json");
    let camera = ["--camera", text(&view), "--time", "0.02"];
    let mut away = synthetic::view(0.0, 0.0);
    away["cam_from_world"]["rotation_wxyz"] = json!([0, 0, 1, 0]);
    std::fs::write(&view, away.to_string()).unwrap();
    broken.assert_refused(&camera, "sees");
    away["params"] = json!([1]);
    std::fs::write(&view, away.to_string()).unwrap();
    broken.assert_refused(&camera, "view.json: model");
    let nowhere = ["-q", "render", text(broken.folder()), "-o", "/proc/none/x.png"];
    assert_refused(&run(&[nowhere.as_slice(), &LIKE].concat()), 2, "/proc");
    broken.assert_works();
}

/// A trail is the overlay of the images at its instants, of a view as of a filming camera's image.
/// The brightest values are theirs exactly; their mean light is theirs to the rounding of 8 bits.
#[test]
fn a_trail_overlays_the_images_of_its_instants() {
    let capture = synthetic::capture(&[0.0, 0.0, 0.0], FRAMES);
    let out = tempfile::tempdir().unwrap();
    let (file, view) = (out.path().join("image.png"), out.path().join("view.json"));
    std::fs::write(&view, synthetic::view(0.02, 0.0).to_string()).unwrap();
    let image = |from: [&str; 2], time_s: f64, more: &[&str]| {
        let time = format!("{time_s:?}");
        let always = ["-q", "render", text(capture.path()), from[0], from[1], "--time", &time];
        succeed(&[always.as_slice(), &["--proxy", "plane", "-o", text(&file)], more].concat());
        read_image(&file).unwrap().0
    };
    let trail = |from: [&str; 2], mode: &str, duration: &str| {
        let more = ["--trail", duration, "--trail-instants", "4", "--trail-mode", mode];
        image(from, 0.1, &more)
    };
    for from in [["--camera", text(&view)], ["--like", "cam1"]] {
        let instants = [0.1, 0.08, 0.06, 0.04].map(|time_s| image(from, time_s, &[]));
        let brightest = trail(from, "lighten", "0.06");
        let mean = trail(from, "mean", "0.06");
        for k in 0..brightest.data().len() {
            let values = instants.each_ref().map(|i| i.data()[k]);
            assert_eq!(brightest.data()[k], values.iter().copied().fold(0.0, f32::max));
            let light = values.map(|v| linear_from_encoded(f64::from(v))).iter().sum::<f64>() / 4.0;
            let error = f64::from(mean.data()[k]) - encoded_from_linear(light);
            // Each of the four is rounded by half a level, and so is their mean.
            assert!(error.abs() < 1.6 / 255.0, "{k} {values:?}");
        }
        assert!(psnr_db(&mean, &instants[0], 8) < 30.0);
        // An instant that was not filmed is not in it: of 0.1, 0.02, -0.06 and -0.14, the first two.
        let long = trail(from, "lighten", "0.24");
        let (last, first) = (image(from, 0.1, &[]), image(from, 0.02, &[]));
        let both = last.data().iter().zip(first.data()).map(|(a, b)| a.max(*b));
        assert!(long.data().iter().zip(both).all(|(found, expected)| *found == expected));
    }
}

#[test]
fn trails_out_of_range_are_refused() {
    let capture = synthetic::capture(&[0.0, 0.0], 2);
    let out = tempfile::tempdir().unwrap();
    let file = out.path().join("image.png");
    let render = |more: &[&str]| {
        let always = ["render", text(capture.path()), "--like", "cam0", "--time", "0.01"];
        run(&[always.as_slice(), &["-o", text(&file)], more].concat())
    };
    assert_refused(&render(&["--trail=-0.1"]), 2, "trail.duration_s: is -0.1");
    assert_refused(&render(&["--trail", "0.1", "--trail-instants", "0"]), 2, "trail.instants");
    assert_refused(&render(&["--trail", "0.1", "--trail-mode", "max"]), 2, "--trail-mode");
    assert!(!file.exists());
}
