//! What `stlfr render` writes: paths, quilts and eyes, videos for browsers, JPEG, OpenEXR.

mod common;

use common::synthetic::{HEIGHT, WIDTH, view};
use common::{assert_refused, edit, run, stderr, succeed, synthetic, text};
use nalgebra::{Point2, Point3, Vector2};
use serde_json::{Value, json};
use std::path::{Path, PathBuf};
use std::process::Command;
use stlfr::camera::{Camera, CameraFormat};
use stlfr::display::{QuiltLayout, covered_cone_deg};
use stlfr::raster::{BitDepth, Image, linear_from_encoded, read_image, write_image};
use tempfile::TempDir;

/// Five cameras 6 cm apart with one clock, before a plane 2 m away.
fn capture() -> TempDir {
    let folder = synthetic::capture(&[0.0; 5], 4);
    edit(folder.path(), |capture| {
        for camera in capture["cameras"].as_array_mut().unwrap() {
            camera["clock"]["shared"] = json!(true);
        }
    });
    folder
}

fn written(folder: &Path, name: &str, content: &Value) -> PathBuf {
    let path = folder.join(name);
    std::fs::write(&path, content.to_string()).unwrap();
    path
}

/// Renders by the plane proxy; the path of the output.
#[track_caller]
fn render(capture: &Path, arguments: &[&str], output: &Path) -> PathBuf {
    let start = ["-q", "render", text(capture), "--preset", "draft", "--proxy", "plane"];
    let depth = ["--set", "proxy.plane_depth_m=2", "-o", text(output)];
    succeed(&[start.as_slice(), arguments, &depth].concat());
    output.to_owned()
}

fn refused(capture: &Path, arguments: &[&str], output: &str, words: &str) {
    let out = capture.join(output);
    let start = ["-q", "render", text(capture), "--preset", "draft"];
    assert_refused(&run(&[start.as_slice(), arguments, &["-o", text(&out)]].concat()), 2, words);
    assert!(!out.exists(), "{output}");
}

fn pixels(path: &Path) -> Image {
    read_image(path).unwrap().0
}

/// The largest difference of two images, in steps of 8 bits.
fn worst_step(a: &Image, b: &Image) -> f32 {
    assert_eq!((a.width(), a.height()), (b.width(), b.height()));
    let differences = a.data().iter().zip(b.data()).map(|(a, b)| 255.0 * (a - b).abs());
    differences.fold(0.0, f32::max)
}

fn path_file() -> Value {
    json!({"format": "stlfr-path", "version": 1, "rate_hz": 8, "keys": [
        {"at_s": 1, "time_s": 0.02, "camera": view(-0.05, 0.0)},
        {"at_s": 1.25, "time_s": 0.05, "camera": view(0.02, 0.0)},
        {"at_s": 1.5, "time_s": 0.05, "camera": view(0.06, 0.01), "rest": true}]})
}

#[test]
fn a_path_shows_its_keys_and_what_lies_between() {
    let capture = capture();
    let root = capture.path();
    let path = written(root, "path.json", &path_file());
    let out = root.join("out/%d.png");
    render(root, &["--path", text(&path)], &out);
    assert_eq!(std::fs::read_dir(root.join("out")).unwrap().count(), 5, "0.5 s at 8 a second");
    for (frame, time_s, x_m, y_m) in
        [(0, "0.02", -0.05, 0.0), (2, "0.05", 0.02, 0.0), (4, "0.05", 0.06, 0.01)]
    {
        let camera = written(root, "view.json", &view(x_m, y_m));
        let still = ["--camera", text(&camera), "--time", time_s];
        let key = pixels(&render(root, &still, &root.join("key.png")));
        assert!(
            worst_step(&key, &pixels(&root.join(format!("out/{frame}.png")))) <= 1.0,
            "{frame}"
        );
    }
    // Frozen by --time, and one frame in the middle of two parts.
    let frozen = ["--path", text(&path), "--time", "0.03", "--fps", "4", "--part", "2/3"];
    render(root, &frozen, &root.join("frozen/%d.jpg"));
    let camera = written(root, "view.json", &view(0.02, 0.0));
    let still = ["--camera", text(&camera), "--time", "0.03"];
    let still = pixels(&render(root, &still, &root.join("still.jpg")));
    assert!(worst_step(&still, &pixels(&root.join("frozen/1.jpg"))) <= 1.0);
    assert_eq!(std::fs::read_dir(root.join("frozen")).unwrap().count(), 1);
}

#[test]
fn wrong_paths_are_refused_with_file_and_field() {
    let capture = capture();
    let root = capture.path();
    let mut file = path_file();
    file["keys"][2]["at_s"] = json!(1.25);
    let path = written(root, "path.json", &file);
    refused(root, &["--path", text(&path)], "a.mp4", "path.json: keys[2].at_s: is 1.25, must be");
    file = path_file();
    file["keys"][1]["time_s"] = json!(7);
    let path = written(root, "path.json", &file);
    refused(root, &["--path", text(&path)], "a.mp4", "they cover 0 to 0.1 s");
    std::fs::write(&path, "[1]").unwrap();
    refused(root, &["--path", text(&path)], "a.mp4", "path.json: ");
    refused(root, &["--path", "sweep", "--time", "9"], "a.mp4", "around 9 s");
    refused(root, &["--path", text(&root.join("none.blend"))], "a.mp4", "none.blend");
}

#[test]
fn ready_made_paths_see_the_whole_scene() {
    let capture = capture();
    let root = capture.path();
    for name in ["sweep", "orbit", "bullet-time", "dolly"] {
        let out = root.join(format!("{name}/%d.png"));
        render(root, &["--path", name, "--duration", "1", "--fps", "8"], &out);
        let mut images = Vec::new();
        for k in 0..9 {
            let bytes = std::fs::read(root.join(format!("{name}/{k}.png"))).unwrap();
            // Only what isn't seen whole has alpha: colour type 6.
            assert_eq!(bytes[25], 2, "{name} {k}");
            images.push(bytes);
        }
        assert!(images.windows(2).any(|pair| pair[0] != pair[1]), "{name} stands still");
    }
}

#[test]
fn processes_share_a_sequence_and_leave_only_its_images() {
    let capture = capture();
    let root = capture.path();
    let sweep = ["--path", "sweep", "--duration", "1", "--fps", "15", "--time", "0.05"];
    render(root, &sweep, &root.join("alone/%d.png"));
    let start = ["-q", "render", text(root), "--preset", "draft", "--proxy", "plane"];
    let out = root.join("shared/%d.png");
    let rest = ["--set", "proxy.plane_depth_m=2", "-o", text(&out)];
    let spawn =
        |_| common::stlfr().args([start.as_slice(), &sweep, &rest].concat()).spawn().unwrap();
    let mut processes: Vec<_> = (0..3).map(spawn).collect();
    assert!(processes.iter_mut().all(|process| process.wait().unwrap().success()));
    let names = |folder: &str| -> Vec<_> {
        let entries = std::fs::read_dir(root.join(folder)).unwrap().flatten();
        let mut names: Vec<_> = entries.map(|entry| entry.file_name()).collect();
        names.sort();
        names
    };
    assert_eq!((names("alone").len(), names("shared")), (16, names("alone")));
    for name in names("alone") {
        let [alone, shared] = ["alone", "shared"].map(|f| std::fs::read(root.join(f).join(&name)));
        assert!(alone.unwrap() == shared.unwrap(), "{name:?}");
    }
}

/// The camera of a view.
#[test]
fn a_sequence_without_room_for_an_image_leaves_nothing() {
    let capture = capture();
    let root = capture.path();
    let out = root.join("out");
    // Files of more than 1024 bytes fail, as on a full disk.
    let script = "trap '' XFSZ; ulimit -f 2; exec \"$0\" \"$@\"";
    let program = common::stlfr().get_program().to_owned();
    let mut command = Command::new("sh");
    command.args(["-c", script]).arg(program).args(["-q", "render", text(root), "--like", "cam2"]);
    command.args(["--preset", "draft", "--proxy", "plane", "--set", "proxy.plane_depth_m=2"]);
    command.args(["--times", "0.02:0.08:3", "-o", text(&out.join("%d.png"))]);
    assert_refused(&command.output().unwrap(), 1, "0.png: can't be written");
    assert_eq!(std::fs::read_dir(&out).unwrap().count(), 0);
}

fn camera(x_m: f64) -> Camera {
    serde_json::from_value::<CameraFormat>(view(x_m, 0.0)).unwrap().camera().unwrap()
}

#[test]
fn tiles_of_a_quilt_are_renders_of_the_same_sheared_cameras() {
    let capture = capture();
    let root = capture.path();
    let middle = written(root, "view.json", &view(0.01, 0.0));
    let still = ["--camera", text(&middle), "--time", "0.05"];
    let layout: QuiltLayout = "4x3:402x303".parse().unwrap();
    let arguments =
        [still.as_slice(), &["--quilt", "4x3:402x303", "--convergence", "1.5", "--cone", "7"]]
            .concat();
    let out = root.join("quilt.png");
    render(root, &arguments, &out);
    assert!(!out.exists());
    let quilt = pixels(&root.join("quilt_qs4x3a0.9901.png"));
    assert_eq!((quilt.width(), quilt.height()), (402, 303));
    let cameras = layout.cameras(&camera(0.01), 7.0, 1.5);
    // The four corners, and views inside the grid.
    for k in [0, 3, 5, 6, 8, 11] {
        let file = serde_json::to_value(CameraFormat::from(&cameras[k])).unwrap();
        let file = written(root, "tile.json", &file);
        let view = pixels(&render(
            root,
            &["--camera", text(&file), "--time", "0.05"],
            &root.join("tile.png"),
        ));
        let [x, y] = layout.tile_origin(k);
        let rows = (0..view.height())
            .flat_map(|row| quilt.row(y + row)[3 * x..3 * (x + view.width())].to_vec());
        let tile = Image::from_data(view.width(), view.height(), 3, rows.collect());
        assert!(worst_step(&tile, &view) <= 1.0, "tile {k}");
    }
    // Bottom left, not top left, is the first; what is beyond the tiles is black.
    assert_eq!(layout.tile_origin(0), [0, 202]);
    assert!(quilt.row(100)[3 * 400..].iter().all(|v| *v == 0.0));
}

#[test]
fn a_plane_at_the_convergence_has_no_parallax_and_one_behind_it_has() {
    let capture = capture();
    let root = capture.path();
    let still = ["--like", "cam2", "--time", "0.05", "--quilt", "6x2:480x120", "--cone", "6"];
    let quilt = |convergence_m: &str| {
        let arguments = [still.as_slice(), &["--convergence", convergence_m]].concat();
        let out = root.join(format!("{convergence_m}_qs6x2a1.33333.png"));
        pixels(&render(root, &arguments, &out))
    };
    let tile = |quilt: &Image, k: usize| {
        let (x, y) = (80 * (k % 6), 60 * (1 - k / 6));
        let rows = (0..60).flat_map(|row| quilt.row(y + row)[3 * x..3 * (x + 80)].to_vec());
        Image::from_data(80, 60, 3, rows.collect())
    };
    let same = quilt("2");
    let moved = quilt("1.6");
    let mean = |a: &Image, b: &Image| {
        let all = a.data().iter().zip(b.data()).map(|(a, b)| 255.0 * (a - b).abs());
        all.sum::<f32>() / a.data().len() as f32
    };
    for k in 1..12 {
        let (still, shifted) =
            (mean(&tile(&same, 0), &tile(&same, k)), mean(&tile(&moved, 0), &tile(&moved, k)));
        // The images of other cameras, resampled: they differ, but not by a shift.
        assert!(still < 1.0, "{k}: {still}");
        assert!(k < 3 || shifted > 3.0 * still, "{k}: {shifted} {still}");
    }
}

/// The centre of what is brighter than the background, pixels.
fn centroid(image: &Image) -> Point2<f64> {
    let (mut sum, mut weights) = (Vector2::zeros(), 0.0);
    for (k, pixel) in image.data().chunks_exact(image.channels()).enumerate() {
        // What no camera sees is black, and counts as background.
        let weight = f64::from(pixel[0]).max(DARK) - DARK;
        let at = Vector2::new((k % image.width()) as f64, (k / image.width()) as f64);
        sum += weight * at.add_scalar(0.5);
        weights += weight;
    }
    Point2::from(sum / weights)
}

/// Brightness of the background and of the disc.
const DARK: f64 = 51.0 / 255.0;
const BRIGHT: f64 = 204.0 / 255.0;

#[test]
fn a_disc_at_the_convergence_has_no_parallax() {
    let capture = capture();
    let root = capture.path();
    let disc = Point3::new(0.03, -0.05, 2.0);
    for c in 0..5 {
        let filming = camera(synthetic::place_m(c, 5));
        let center = filming.project(&disc).unwrap();
        let value = |k: usize| {
            let pixel = Point2::new((k % WIDTH) as f64 + 0.5, (k / WIDTH) as f64 + 0.5);
            // The edge is linear over three pixels.
            let inside = ((18.0 - (pixel - center).norm()) / 3.0 + 0.5).clamp(0.0, 1.0);
            (DARK + (BRIGHT - DARK) * inside) as f32
        };
        let image = Image::from_data(WIDTH, HEIGHT, 1, (0..WIDTH * HEIGHT).map(value).collect());
        for frame in 0..4 {
            let path = root.join(format!("cam{c}/{frame:04}.png"));
            write_image(&path, &image.to_rgb(), None, BitDepth::Sixteen).unwrap();
        }
    }
    let layout: QuiltLayout = "6x2:960x240".parse().unwrap();
    for (convergence, has_parallax) in [("2", false), ("1.6", true)] {
        let still = ["--like", "cam2", "--time", "0.05", "--quilt", "6x2:960x240", "--cone", "5"];
        let arguments = [still.as_slice(), &["--convergence", convergence]].concat();
        let out = root.join(format!("{convergence}_qs6x2a1.33333.png"));
        let quilt = pixels(&render(root, &arguments, &out));
        let cameras = layout.cameras(&camera(0.0), 5.0, convergence.parse().unwrap());
        let mut found = Vec::new();
        for (k, tile_camera) in cameras.iter().enumerate() {
            let [x, y] = layout.tile_origin(k);
            let rows = (y..y + 120).flat_map(|row| quilt.row(row)[3 * x..3 * (x + 160)].to_vec());
            found.push(centroid(&Image::from_data(160, 120, 3, rows.collect())));
            let expected = tile_camera.project(&disc).unwrap();
            assert!((found[k] - expected).norm() < 0.05, "{k}: {} {expected}", found[k]);
        }
        let parallax_px = (found[0] - found[11]).norm();
        assert_eq!(parallax_px > 0.05, has_parallax, "{parallax_px} px at {convergence} m");
    }
}

#[test]
fn a_video_of_quilts_has_their_size_and_name() {
    let capture = capture();
    let root = capture.path();
    let times = ["--like", "cam2", "--times", "0.02:0.08:3", "--convergence", "2"];
    for suffix in ["mp4", "mkv"] {
        let quilt = [times.as_slice(), &["--quilt", "6x2:480x120", "--cone", "6"]].concat();
        render(root, &quilt, &root.join(format!("q.{suffix}")));
        let video = root.join(format!("q_qs6x2a1.33333.{suffix}"));
        let told =
            Command::new(common::ffmpeg()).args(["-hide_banner", "-i", text(&video)]).output();
        let told = stderr(&told.unwrap());
        assert!(told.contains("480x120"), "{told}");
        assert_eq!(decoded(&video, (480, 120)).len(), 3);
    }
}

#[test]
fn a_cone_beyond_the_cameras_is_narrowed_or_refused() {
    let capture = capture();
    let root = capture.path();
    let cameras: Vec<Camera> = (0..5).map(|c| camera(synthetic::place_m(c, 5))).collect();
    let covered = covered_cone_deg(&cameras[2], &cameras, 2.0);
    let still =
        ["--like", "cam2", "--time", "0.05", "--proxy", "plane", "--set", "proxy.plane_depth_m=2"];
    let wide = [still.as_slice(), &["--quilt", "go", "--cone", "30"]].concat();
    refused(
        root,
        &wide,
        "a.png",
        &format!("--cone: the cameras cover a cone of {covered:.1} degrees"),
    );
    let outside = ["--like", "cam0", "--time", "0.05", "--quilt", "go", "--convergence", "2"];
    refused(root, &outside, "a.png", "--quilt: the cameras cover a cone of 0.0 degrees");
    let out = root.join("a.png");
    let start = ["render", text(root), "--preset", "draft"];
    let rest = ["--quilt", "3x2:240x120", "-o", text(&out)];
    let output = succeed(&[start.as_slice(), &still, &rest].concat());
    let note = format!(
        "cover a cone of {covered:.1} degrees at 2.00 m; the quilt has {covered:.1} of the display's 35."
    );
    assert!(stderr(&output).contains(&note), "{}", stderr(&output));
}

#[test]
fn eyes_are_side_by_side() {
    let capture = capture();
    let root = capture.path();
    let still = ["--like", "cam2", "--time", "0.05"];
    let both = [still.as_slice(), &["--stereo", "0.06", "--convergence", "2"]].concat();
    let both = pixels(&render(root, &both, &root.join("both.png")));
    assert_eq!((both.width(), both.height()), (2 * WIDTH, HEIGHT));
    let half = |eye: usize| {
        let rows =
            (0..HEIGHT).flat_map(|y| both.row(y)[3 * WIDTH * eye..3 * WIDTH * (eye + 1)].to_vec());
        Image::from_data(WIDTH, HEIGHT, 3, rows.collect())
    };
    for (eye, camera) in stlfr::display::stereo(&camera(0.0), 0.06, 2.0).iter().enumerate() {
        let file = serde_json::to_value(CameraFormat::from(camera)).unwrap();
        let file = written(root, "eye.json", &file);
        let view =
            render(root, &["--camera", text(&file), "--time", "0.05"], &root.join("eye.png"));
        assert!(worst_step(&half(eye), &pixels(&view)) <= 1.0, "{eye}");
    }
}

/// The frames of a video as ffmpeg decodes them to RGB, of this size.
fn decoded(video: &Path, (width, height): (usize, usize)) -> Vec<Image> {
    let output = Command::new(common::ffmpeg())
        .args(["-v", "error", "-i", text(video)])
        .args(["-f", "rawvideo", "-pix_fmt", "rgb24", "-fps_mode", "passthrough", "-"])
        .output()
        .unwrap();
    assert!(output.status.success() && output.stderr.is_empty(), "{}", stderr(&output));
    let frame = |raw: &[u8]| {
        Image::from_data(width, height, 3, raw.iter().map(|v| f32::from(*v) / 255.0).collect())
    };
    assert_eq!(output.stdout.len() % (3 * width * height), 0);
    output.stdout.chunks_exact(3 * width * height).map(frame).collect()
}

#[test]
fn videos_of_every_kind_show_the_images() {
    let capture = capture();
    let root = capture.path();
    let times = ["--like", "cam2", "--times", "0.02:0.08:5", "--fps", "12.5"];
    render(root, &times, &root.join("%d.png"));
    for (suffix, worst) in [("mp4", 4.0), ("webm", 5.0), ("gif", 12.0), ("mkv", 0.01)] {
        let video = render(root, &times, &root.join(format!("a.{suffix}")));
        let frames = decoded(&video, (WIDTH, HEIGHT));
        assert_eq!(frames.len(), 5, "{suffix}");
        for (k, frame) in frames.iter().enumerate() {
            let image = pixels(&root.join(format!("{k}.png")));
            // Colours have half the resolution in 4:2:0, brightness has not.
            let (frame, image) = (frame.to_gray(), image.to_gray());
            let all = frame.data().iter().zip(image.data()).map(|(a, b)| 255.0 * (a - b).abs());
            let mean = all.sum::<f32>() / frame.data().len() as f32;
            assert!(mean < worst, "{suffix} {k}: {mean}");
        }
        let told =
            Command::new(common::ffmpeg()).args(["-hide_banner", "-i", text(&video)]).output();
        let told = stderr(&told.unwrap());
        assert!(told.contains("12.50 fps"), "{suffix}: {told}");
        let labelled = told.contains("tv, bt709/bt709/iec61966-2-1");
        assert_eq!(labelled, ["mp4", "webm"].contains(&suffix), "{told}");
    }
}

#[test]
fn an_odd_size_is_padded_for_browsers() {
    let capture = capture();
    let root = capture.path();
    let mut odd = view(0.0, 0.0);
    (odd["width"], odd["height"]) = (json!(WIDTH - 1), json!(HEIGHT - 1));
    let file = written(root, "odd.json", &odd);
    let times = ["--camera", text(&file), "--times", "0.02:0.08:2"];
    for suffix in ["mp4", "webm"] {
        let video = render(root, &times, &root.join(format!("a.{suffix}")));
        assert_eq!(decoded(&video, (WIDTH, HEIGHT)).len(), 2, "{suffix}");
    }
}

#[test]
fn an_ffmpeg_without_the_encoder_is_told_before_rendering() {
    use std::os::unix::fs::PermissionsExt;
    let capture = capture();
    let root = capture.path();
    let programs = tempfile::tempdir().unwrap();
    let ffmpeg = programs.path().join("ffmpeg");
    std::fs::write(&ffmpeg, "#!/bin/sh\necho ' V..... ffv1 FFmpeg video codec #1'\n").unwrap();
    std::fs::set_permissions(&ffmpeg, std::fs::Permissions::from_mode(0o755)).unwrap();
    let out = root.join("a.mp4");
    let mut command = common::stlfr();
    command.env("PATH", programs.path()).args(["-q", "render", text(root), "--like", "cam2"]);
    command.args(["--times", "0.02:0.08:2", "-o", text(&out)]);
    let output = command.output().unwrap();
    assert_refused(&output, 1, "has no encoder libx264, which .mp4 needs");
    assert!(!out.exists());
}

#[test]
fn an_exr_has_linear_light() {
    let capture = capture();
    let root = capture.path();
    let still = ["--like", "cam2", "--time", "0.05"];
    let path = render(root, &still, &root.join("a.exr"));
    let shown = pixels(&render(root, &still, &root.join("a.png")));
    // Read by ffmpeg, which has its own reader: planes G, B, R, A of floats.
    let output = Command::new(common::ffmpeg())
        .args(["-v", "error", "-i", text(&path), "-f", "rawvideo", "-pix_fmt", "gbrapf32le", "-"])
        .output()
        .unwrap();
    assert!(output.status.success(), "{}", stderr(&output));
    let values: Vec<f32> =
        output.stdout.chunks_exact(4).map(|b| f32::from_le_bytes(b.try_into().unwrap())).collect();
    let count = WIDTH * HEIGHT;
    assert_eq!(values.len(), 4 * count);
    for k in 0..count {
        for (plane, channel) in [1, 2, 0].into_iter().enumerate() {
            let linear = linear_from_encoded(f64::from(shown.data()[3 * k + channel]));
            let found = f64::from(values[plane * count + k]);
            // Half floats have 11 bits, PNG 8.
            assert!((found - linear).abs() < 0.006, "{channel} {k}: {found} {linear}");
        }
        assert_eq!(values[3 * count + k], 1.0);
    }
    refused(
        root,
        &["--like", "cam2", "--time", "0.05", "--quilt", "go"],
        "q.exr",
        "an .exr holds one view",
    );
}
