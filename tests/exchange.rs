//! Import of real recordings: calibrations of other programs, and videos as real cameras make them.

mod common;

use common::{assert_refused, edit, ffmpeg, read_json, run, stderr, succeed, synthetic, text};
use serde_json::{Value, json};
use std::path::Path;
use std::process::Command;
use stlfr::capture::{Capture, Opening};
use stlfr::exchange::{read_anipose, read_colmap, read_nerf, read_qualisys};
use stlfr::progress::Reporter;
use stlfr::raster::{BitDepth, Image, read_image, write_image};
use tempfile::TempDir;

/// Encodes a video with ffmpeg's own arguments.
#[track_caller]
fn encode(arguments: &str, path: &Path) {
    std::fs::create_dir_all(path.parent().unwrap()).unwrap();
    let status = Command::new(ffmpeg())
        .args(["-v", "error", "-y"])
        .args(arguments.split(' '))
        .arg(path)
        .status()
        .unwrap();
    assert!(status.success(), "{arguments}");
}

/// A table of Anipose's calibration: a camera of this size, `x_m` to the right.
fn camera_toml(name: &str, [width, height]: [usize; 2], x_m: f64) -> String {
    format!(
        "[{name}]\nname = \"{name}\"\nsize = [ {width}, {height}.0 ]\n\
         matrix = [[ 60, 0.0, 31.5 ], [ 0.0, 60.0, 23.5 ], [ 0.0, 0.0, 1.0 ]]\n\
         distortions = [ 0.0, 0.0, 0.0, 0.0, 0.0 ]\nrotation = [ 0.0, 0.0, 0.0 ]\n\
         translation = [ {}, 0.0, 0.0 ]\nfisheye = false\n\n",
        -x_m
    )
}

/// A folder with `Calib.toml` of cameras of 64×48 pixels, and an empty folder `film`.
fn array(names: &[&str]) -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    let tables = names.iter().enumerate();
    let toml: String = tables.map(|(k, name)| camera_toml(name, [64, 48], k as f64)).collect();
    let toml = format!("{toml}[metadata]\nadjusted = false\nerror = 0.0\n");
    std::fs::write(folder.path().join("Calib.toml"), toml).unwrap();
    std::fs::create_dir(folder.path().join("film")).unwrap();
    folder
}

/// `stlfr import` of such a folder.
fn import(folder: &Path, more: &[&str]) -> std::process::Output {
    let [toml, film, out] = ["Calib.toml", "film", "capture"].map(|name| folder.join(name));
    let arguments = ["import", text(&toml), "--images", text(&film), "-o", text(&out)];
    run(&[&arguments, more].concat())
}

fn open(folder: &Path) -> Capture {
    let reporter = &Reporter::silent();
    Capture::open_with(folder, &Opening { ffmpeg: Some(&ffmpeg()), reporter }).unwrap()
}

fn clocks(capture: &Path) -> Vec<Value> {
    let json = read_json(&capture.join("capture.json"));
    json["cameras"].as_array().unwrap().iter().map(|c| c["clock"].clone()).collect()
}

const TEST: &str = "-f lavfi -i testsrc2=size=64x48:rate=30:duration=1";

#[test]
fn videos_of_different_rates_lengths_and_depths_are_one_capture() {
    let folder = array(&["a", "b", "c", "d"]);
    let film = |name: &str| folder.path().join("film").join(name);
    encode(&format!("{TEST} -c:v ffv1"), &film("a.mkv"));
    let slow = TEST.replace("rate=30", "rate=24000/1001");
    encode(&format!("{slow} -frames:v 9 -c:v libx264 -qp 0"), &film("b.mp4"));
    encode(&format!("{TEST} -pix_fmt yuv420p10le -c:v ffv1"), &film("c.mkv"));
    // A phone's frames: every other one is late.
    let late = "-vf settb=1/90000,setpts=(N+0.25*mod(N\\,2))/30/TB -fps_mode passthrough -enc_time_base 1/90000";
    encode(&format!("{TEST} {late} -video_track_timescale 90000 -c:v libx264"), &film("d.mp4"));
    let output = import(folder.path(), &[]);
    assert!(output.status.success(), "{}", stderr(&output));
    for words in [
        "By the videos' own times, they have 23.976024 to 30.000000 frames a second.",
        "Frames of d are not evenly spaced: their times are the video's.",
        "4 cameras with 9 to 30 frames, each on its own clock",
    ] {
        assert!(stderr(&output).contains(words), "{words}: {}", stderr(&output));
    }
    let capture = folder.path().join("capture");
    let clocks = clocks(&capture);
    assert_eq!(clocks[0], json!({"rate_hz": 30.0, "first_s": 0.0, "shared": false}));
    let rate_hz = clocks[1]["rate_hz"].as_f64().unwrap();
    assert!((rate_hz - 24_000.0 / 1001.0).abs() < 1e-12, "{rate_hz}");
    for (k, time) in clocks[3]["times_s"].as_array().unwrap().iter().enumerate() {
        let expected = (k as f64 + 0.25 * (k % 2) as f64) / 30.0;
        assert!((time.as_f64().unwrap() - expected).abs() < 1.2e-5, "{k}: {time}");
    }
    let capture = open(&capture);
    let frames: Vec<usize> = capture.cameras.iter().map(|c| c.frames.len()).collect();
    assert_eq!(frames, [30, 9, 30, 30]);
    let depths: Vec<BitDepth> = capture.cameras.iter().map(|c| c.bit_depth).collect();
    assert_eq!(depths[..3], [BitDepth::Eight, BitDepth::Eight, BitDepth::Sixteen]);
    // OpenCV's pixels begin at 0: half a pixel is added. Poses are from the world to the camera.
    assert_eq!(capture.cameras[0].camera.model.params(), [60.0, 60.0, 32.0, 24.0]);
    assert_eq!(capture.cameras[3].camera.center().x, 3.0);
}

/// A phone held upright films the sensor's rows, and says in the file how to turn them.
#[test]
fn a_rotation_in_the_file_is_applied() {
    let folder = tempfile::tempdir().unwrap();
    let toml = camera_toml("a", [48, 64], 0.0);
    std::fs::write(folder.path().join("Calib.toml"), toml).unwrap();
    let flat = folder.path().join("flat.mp4");
    // The left half is red, the right half blue.
    let halves = "-f lavfi -i color=c=red:size=32x48:rate=30:duration=0.2 \
                  -f lavfi -i color=c=blue:size=32x48:rate=30:duration=0.2";
    encode(&format!("{halves} -filter_complex hstack -c:v libx264rgb -qp 0"), &flat);
    let rotated = folder.path().join("film/a.mp4");
    encode(&format!("-display_rotation 90 -i {} -c copy", flat.display()), &rotated);
    let output = import(folder.path(), &["--shared"]);
    assert!(output.status.success(), "{}", stderr(&output));
    let image = open(&folder.path().join("capture")).read_frame(0, 0).unwrap();
    assert_eq!((image.width(), image.height()), (48, 64));
    // Turned by 90° against the clock: what was right is on top.
    let is_blue = |y: usize| image.pixel(24, y)[2] > 0.9 && image.pixel(24, y)[0] < 0.1;
    assert!(is_blue(5) && !is_blue(60), "{:?} {:?}", image.pixel(24, 5), image.pixel(24, 60));
}

#[test]
fn what_no_method_can_use_is_refused_in_a_sentence() {
    let folder = array(&["a"]);
    let film = folder.path().join("film/a.mkv");
    let fields = "-flags +ildct+ilme -c:v mpeg2video";
    encode(&format!("{TEST} -vf setfield=tff {fields}"), &film);
    assert_refused(&import(folder.path(), &[]), 2, "a.mkv: is interlaced, and the two fields");
    // Through a hand-written capture.json, too.
    encode(&format!("{TEST} -c:v ffv1"), &film);
    assert!(import(folder.path(), &[]).status.success());
    let capture = folder.path().join("capture");
    encode(&format!("{TEST} -vf setfield=tff {fields}"), &capture.join("b.mkv"));
    edit(&capture, |json| json["cameras"][0]["frames"] = json!("b.mkv"));
    assert_refused(&run(&["plan", text(&capture)]), 2, "'b.mkv' is interlaced");
    std::fs::remove_dir_all(&capture).unwrap();

    // A broken packet: some bytes in the middle of the file.
    let mut bytes = std::fs::read(&film).unwrap();
    let middle = bytes.len() / 2;
    bytes[middle..middle + 64].fill(0x55);
    std::fs::write(&film, bytes).unwrap();
    assert_refused(&import(folder.path(), &[]), 2, "a.mkv: is not a whole video");

    let wide = TEST.replace("64x48", "60x48");
    encode(&format!("{wide} -c:v ffv1"), &film);
    let sizes =
        "a.mkv: has images of 60×48 pixels, its calibration 64×48; if they are its top left";
    assert_refused(&import(folder.path(), &[]), 2, sizes);
    let output = import(folder.path(), &["--crop"]);
    assert!(output.status.success(), "{}", stderr(&output));
    let cropped = open(&capture);
    assert_eq!(cropped.cameras[0].camera.model.params(), [60.0, 60.0, 32.0, 24.0]);
    assert_eq!(cropped.cameras[0].camera.width, 60);
    std::fs::remove_dir_all(&capture).unwrap();

    let half = TEST.replace("64x48", "32x24");
    encode(&format!("{half} -c:v ffv1"), &film);
    let output = import(folder.path(), &[]);
    assert!(stderr(&output).contains("a has images of 32×24 pixels"), "{}", stderr(&output));
    assert_eq!(open(&capture).cameras[0].camera.model.params(), [30.0, 30.0, 16.0, 12.0]);
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 3, "nothing is left");
}

/// Writes three grey images as a camera's sequence.
fn sequence(folder: &Path, shade: f32) {
    for k in 0..3 {
        let image = Image::filled(64, 48, 1, shade);
        write_image(&folder.join(format!("{k}.png")), &image, None, BitDepth::Eight).unwrap();
    }
}

#[test]
fn recordings_are_paired_by_name_number_or_table_and_never_in_silence() {
    let folder = array(&["cam_0", "cam_1"]);
    let film = folder.path().join("film");
    let capture = folder.path().join("capture");
    let shades = |capture: &Path| {
        let capture = open(capture);
        let shade = |k| capture.read_frame(k, 0).unwrap().pixel(0, 0)[0];
        [0, 1].map(|k| (10.0 * shade(k)).round())
    };
    sequence(&film.join("view0"), 0.1);
    sequence(&film.join("view1"), 0.2);
    assert_refused(&import(folder.path(), &[]), 2, "view0/0.png: is an image, which has no time");
    let output = import(folder.path(), &["--rate", "30"]);
    assert!(stderr(&output).contains("paired by number: cam_0 is view0."), "{}", stderr(&output));
    assert_eq!(shades(&capture), [1.0, 2.0]);
    std::fs::remove_dir_all(&capture).unwrap();

    let table = folder.path().join("table.csv");
    std::fs::write(&table, "camera,frames\ncam_0,view1\ncam_1,view0\n").unwrap();
    let output = import(folder.path(), &["--rate", "30", "--table", text(&table)]);
    assert!(output.status.success(), "{}", stderr(&output));
    assert_eq!(shades(&capture), [2.0, 1.0]);
    std::fs::remove_dir_all(&capture).unwrap();

    for (content, words) in [
        (
            "camera,frames\ncam_0,view1\ncam_0,view0\n",
            "table.csv: line 3: there is a camera 'cam_0' already",
        ),
        ("camera,frames\ncam_7,view1\n", "table.csv: line 2: there is no camera 'cam_7'"),
        ("camera,frames\ncam_0,../none\n", "table.csv: line 2: there is no '../none' in"),
        ("camera,frames\ncam_0\n", "table.csv: line 2: has 1 values for 2 columns"),
        ("camera,frames\n", "table.csv: lists no camera"),
        ("a,b\n", "table.csv: has no column camera"),
    ] {
        std::fs::write(&table, content).unwrap();
        let more = ["--rate", "30", "--table", text(&table)];
        assert_refused(&import(folder.path(), &more), 2, words);
    }
    std::fs::write(&table, "camera,frames\ncam_1,view0\n").unwrap();
    let output = import(folder.path(), &["--rate", "30", "--table", text(&table)]);
    assert!(stderr(&output).contains("The table has no camera cam_0; not imported."));
    std::fs::remove_dir_all(&capture).unwrap();

    // Names count for more than numbers; what no camera filmed is named.
    sequence(&film.join("cam_0"), 0.3);
    assert_refused(
        &import(folder.path(), &["--rate", "30"]),
        2,
        "has a recording cam_0, and none cam_1",
    );
    sequence(&film.join("cam_1"), 0.4);
    let output = import(folder.path(), &["--rate", "30"]);
    assert!(
        stderr(&output).contains("no camera for view0, view1; not imported."),
        "{}",
        stderr(&output)
    );
    assert_eq!(shades(&capture), [3.0, 4.0]);
    std::fs::remove_dir_all(&capture).unwrap();
    encode(&format!("{TEST} -c:v ffv1"), &film.join("cam_1.mkv"));
    let words = "has two recordings of one camera, cam_1 and cam_1.mkv";
    assert_refused(&import(folder.path(), &["--rate", "30"]), 2, words);
}

#[test]
fn frames_have_the_times_of_a_table() {
    let folder = array(&["cam_0", "cam_1"]);
    let film = folder.path().join("film");
    for name in ["cam_0", "cam_1"] {
        sequence(&film.join(name), 0.5);
    }
    let start = "1700000000";
    let rows: String =
        [("0", "001"), ("1", "002"), ("0", "501"), ("1", "502"), ("0", "901"), ("1", "902")]
            .iter()
            .map(|(camera, time)| format!("{camera},{start}.{time}000001\n"))
            .collect();
    let times = film.join("timestamps.csv");
    std::fs::write(&times, format!("cam_id,frame_time\n{rows}")).unwrap();
    let output = import(folder.path(), &[]);
    assert!(output.status.success(), "{}", stderr(&output));
    assert!(stderr(&output).contains("those of timestamps.csv"), "{}", stderr(&output));
    assert!(stderr(&output).contains(&format!("Times count from {start} s")));
    let capture = folder.path().join("capture");
    let clocks = clocks(&capture);
    for (clock, milliseconds) in clocks.iter().zip([[1, 501, 901], [2, 502, 902]]) {
        for (time, ms) in clock["times_s"].as_array().unwrap().iter().zip(milliseconds) {
            let expected = f64::from(ms) / 1e3 + 1e-9;
            assert!((time.as_f64().unwrap() - expected).abs() < 1e-10, "{time}");
        }
    }
    std::fs::remove_dir_all(&capture).unwrap();

    let output = import(folder.path(), &["--rate", "30"]);
    assert!(stderr(&output).contains("timestamps.csv is not used"), "{}", stderr(&output));
    std::fs::remove_dir_all(&capture).unwrap();
    let other = folder.path().join("times.csv");
    for (content, words) in [
        ("camera,time_s\ncam_0,0\n", "times.csv: has 1 times of cam_0 for 3 frames"),
        ("camera,time_s\ncam_2,0\n", "times.csv: has no times of cam_0"),
        ("camera,time_s\ncam_0,then\n", "times.csv: line 2: 'then' is no time"),
        ("camera\ncam_0\n", "times.csv: has no column time_s"),
        ("", "times.csv: is empty"),
    ] {
        std::fs::write(&other, content).unwrap();
        assert_refused(&import(folder.path(), &["--times", text(&other)]), 2, words);
    }
    std::fs::write(&other, "camera,time_s\ncam_0,1\ncam_0,1\ncam_0,2\ncam_1,1\ncam_1,2\ncam_1,3\n")
        .unwrap();
    let words = "the times of frames 0 and 1 do not ascend";
    assert_refused(&import(folder.path(), &["--times", text(&other)]), 2, words);
}

/// Caliscope's tables, with matrices for rotations, and Rodrigues' vectors.
#[test]
fn calibrations_in_toml_have_opencvs_conventions() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("camera_array.toml");
    let quarter = std::f64::consts::FRAC_PI_2;
    let lens = "size = [640, 480]\nmatrix = [[500.0, 0, 319.5], [0, 510.0, 239.5], [0, 0, 1]]\n";
    let turned = "rotation = [[0, -1, 0], [1, 0, 0], [0, 0, 1]]\ntranslation = [0.1, 0.2, 0.3]\n";
    let toml = format!(
        "version = 2\n[cameras.0]\ncam_id = 0\ndistortions = [0.1, -0.2, 0.001, 0.002, 0.3]\n{lens}{turned}\n\
         [cameras.10]\nfisheye = true\ndistortions = [0.01, 0.02, 0.03, 0.04]\n{lens}{turned}\n\
         [cameras.2]\nignore = true\n{lens}{turned}\n\
         [vector]\ndistortions = [0.1]\nrotation = [0, 0, {quarter}]\ntranslation = [0.1, 0.2, 0.3]\n{lens}"
    );
    std::fs::write(&path, &toml).unwrap();
    let cameras = read_anipose(&path).unwrap();
    let names: Vec<&str> = cameras.iter().map(|c| c.name.as_str()).collect();
    assert_eq!(names, ["cam_0", "cam_10", "vector"]);
    let models: Vec<&str> = cameras.iter().map(|c| c.camera.model.name()).collect();
    assert_eq!(models, ["FULL_OPENCV", "OPENCV_FISHEYE", "OPENCV"]);
    assert_eq!(
        cameras[0].camera.model.params(),
        [500.0, 510.0, 320.0, 240.0, 0.1, -0.2, 0.001, 0.002, 0.3, 0.0, 0.0, 0.0]
    );
    for camera in &cameras {
        // x right of the camera is y of the world, turned by a quarter.
        let pose = camera.camera.cam_from_world * nalgebra::Point3::new(1.0, 0.0, 0.0);
        assert!((pose - nalgebra::Point3::new(0.1, 1.2, 0.3)).norm() < 1e-12, "{pose}");
    }
    for (from, to, words) in [
        ("matrix", "matrices", "holds no camera"),
        ("[0, 510.0, 239.5]", "[0.1, 510.0, 239.5]", "cam_0: matrix must be fx 0 cx"),
        ("0.3]", "0.3, 1, 1, 1, 1]", "cam_0: 9 distortions are more than are known"),
        ("[0, -1, 0]", "[0, -2, 0]", "cam_0: a pose's rotation is no rotation"),
        ("[640, 480]", "[640, 0]", "cam_0: an image can't be 640×0 pixels"),
        ("[640, 480]", "\"large\"", "cam_0: invalid type"),
        ("translation = [0.1", "translation = [nan", "cam_0: "),
        ("[vector]", "[cameras.0]", "duplicate key"),
        ("[0, 0, 1]]\n", "[0, 0, 1]\n", "camera_array.toml: "),
    ] {
        std::fs::write(&path, toml.replacen(from, to, if from == "matrix" { 9 } else { 1 }))
            .unwrap();
        let arguments =
            ["import", text(&path), "--images", text(folder.path()), "-o", "target/none"];
        assert_refused(&run(&arguments), 2, words);
    }
}

/// Qualisys' file of two cameras, in its units.
fn qca() -> String {
    let camera = |serial: &str, active: u8| {
        format!(
            "<camera active=\"{active}\" serial=\"{serial}\" model=\"none\">\
             <fov_video left=\"0\" top=\"8\" right=\"639\" bottom=\"487\"/>\
             <transform r11=\"1\" r12=\"0\" r13=\"0\" r21=\"0\" r22=\"0\" r23=\"1\" r31=\"0\" r32=\"-1\" r33=\"0\" \
             x=\"100\" y=\"-2000\" z=\"1500\"/>\
             <intrinsic focalLengthU=\"32000\" focalLengthV=\"32640\" centerPointU=\"20448\" centerPointV=\"15840\" \
             skew=\"0.0\" radialDistortion1=\"-0.1\" radialDistortion2=\"0.2\" radialDistortion3=\"0.0\" \
             tangentalDistortion1=\"0.001\" tangentalDistortion2=\"0.002\"/></camera>"
        )
    };
    format!(
        "<?xml version='1.0' encoding='ASCII'?>\n<calibration><cameras>{}{}</cameras></calibration>\n",
        camera("11", 1),
        camera("12", 0)
    )
}

#[test]
fn qualisys_calibrations_are_read_in_their_units() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("Calib.qca.txt");
    std::fs::write(&path, qca()).unwrap();
    let cameras = read_qualisys(&path).unwrap();
    assert_eq!((cameras.len(), cameras[0].name.as_str()), (1, "11"));
    let camera = &cameras[0].camera;
    assert_eq!((camera.width, camera.height), (640, 480));
    assert_eq!(camera.model.params(), [500.0, 510.0, 320.0, 240.0, -0.1, 0.2, 0.001, 0.002]);
    assert!((camera.center() - nalgebra::Point3::new(0.1, -2.0, 1.5)).norm() < 1e-12);
    // It looks along +y, with z up.
    assert!((camera.axis() - nalgebra::Vector3::y()).norm() < 1e-12, "{}", camera.axis());
    let above = camera.project(&nalgebra::Point3::new(0.1, 0.0, 1.6)).unwrap();
    assert!(above.y < 240.0, "{above}");
    for (from, to, words) in [
        ("<calibration>", "<calibration", "is no XML"),
        ("serial=\"11\"", "", "camera 1: serial is missing"),
        (
            "focalLengthU=\"32000\"",
            "focalLengthU=\"long\"",
            "camera 1: focalLengthU can't be 'long'",
        ),
        ("r33=\"0\"", "r33=\"1\"", "camera 1: a pose's rotation is no rotation"),
        ("right=\"639\"", "right=\"-1\"", "camera 1: an image can't be 0×480 pixels"),
        ("transform", "transformed", "camera 1: transform is missing"),
        ("active=\"1\"", "active=\"0\"", "holds no camera"),
    ] {
        std::fs::write(&path, qca().replacen(from, to, 1)).unwrap();
        let arguments =
            ["import", text(&path), "--images", text(folder.path()), "-o", "target/none"];
        assert_refused(&run(&arguments), 2, words);
    }
}

/// All frames, poses and times of two captures are the same, camera by camera.
#[track_caller]
fn assert_same(found: &Path, expected: &Path, times_s: &[Vec<f64>], is_named: bool) {
    let (found, expected) = (open(found), open(expected));
    assert_eq!(found.cameras.len(), expected.cameras.len());
    for (b, camera) in expected.cameras.iter().enumerate() {
        let a = if is_named { found.camera_index(&camera.id).unwrap() } else { b };
        let [pose, other] = [&found.cameras[a], camera].map(|c| c.camera.cam_from_world);
        assert!((pose.to_homogeneous() - other.to_homogeneous()).amax() < 1e-6, "{pose} {other}");
        let times = found.times_in_file_s(a);
        assert_eq!(times.len(), times_s[b].len());
        for (time, expected) in times.iter().zip(&times_s[b]) {
            assert!((time - expected).abs() <= 1e-9, "{time} {expected}");
        }
        for frame in 0..times.len() {
            let (image, other) =
                (found.read_frame(a, frame).unwrap(), expected.read_frame(b, frame).unwrap());
            let off = image.data().iter().zip(other.data()).map(|(a, b)| (a - b).abs());
            assert!(off.fold(0.0, f32::max) <= 1.0 / 255.0, "{} {frame}", camera.id);
        }
    }
}

/// A capture whose cameras are synchronized: rendered at the frames' times, images are the frames.
#[test]
fn synchronized_images_come_back_in_every_format() {
    let folder = synthetic::capture(&[0.0, 0.0, 0.0], 4);
    edit(folder.path(), |json| {
        for c in 0..3 {
            json["cameras"][c]["clock"]["shared"] = json!(true);
        }
    });
    let capture = text(folder.path());
    let times_s: Vec<Vec<f64>> =
        vec![(0..4).map(|k| f64::from(k) / synthetic::RATE_HZ).collect(); 3];
    let out = tempfile::tempdir().unwrap();
    for (format, calibration, images) in [
        ("colmap", "sparse/0", "images"),
        ("nerf", "transforms.json", "."),
        ("llff", "poses_bounds.npy", "."),
    ] {
        let data = out.path().join(format);
        let mut export =
            vec!["-q", "export", capture, "--synchronized", "--format", format, "-o", text(&data)];
        if format == "llff" {
            export.extend(["--near", "1", "--far", "6"]);
        }
        succeed(&export);
        let again = out.path().join(format!("{format}-again"));
        let [calibration, images] = [calibration, images].map(|name| data.join(name));
        succeed(&[
            "import",
            text(&calibration),
            "--images",
            text(&images),
            "--shared",
            "-o",
            text(&again),
        ]);
        assert_same(&again, folder.path(), &times_s, format != "llff");
        // It takes nothing of what is there.
        assert_refused(&run(&export), 2, "holds files already");
    }
    let outside = ["--times", "0.05:0.3:3", "-o", "target/none"];
    let export = ["-q", "export", capture, "--synchronized", "--format", "nerf"];
    let words = "not all cameras film at 0.1750 s; all do from 0.0000 to 0.1000 s";
    assert_refused(&run(&[&export[..], &outside].concat()), 2, words);
    let frames = ["export", capture, "--frames", "--near", "1", "--far", "2", "--format", "llff"];
    assert_refused(&run(&[&frames[..], &["-o", "target/none"]].concat()), 2, "llff has no times");
}

/// Frames as they were filmed have their times on the reference's clock, and come back as a synchronized clock's.
#[test]
fn filmed_frames_come_back_with_their_estimated_times() {
    let folder = synthetic::capture(&[0.0, 0.3, 0.6], 3);
    let offset_s = [-0.3, 0.0, 0.3].map(|frames| frames / synthetic::RATE_HZ);
    let camera = |k: usize| json!({"id": format!("cam{k}"), "offset_s": offset_s[k], "std_err_s": if k == 1 { 0.0 } else { 1e-5 }});
    let offsets = json!({"reference": "cam1", "cameras": [camera(0), camera(1), camera(2)]});
    std::fs::write(folder.path().join("offsets.json"), offsets.to_string()).unwrap();
    let times_s: Vec<Vec<f64>> = offset_s
        .iter()
        .map(|offset| (0..3).map(|k| f64::from(k) / synthetic::RATE_HZ + offset).collect())
        .collect();
    let out = tempfile::tempdir().unwrap();
    for (format, calibration, images) in
        [("colmap", "sparse/0", "images"), ("nerf", "transforms.json", ".")]
    {
        let data = out.path().join(format);
        succeed(&[
            "export",
            text(folder.path()),
            "--frames",
            "--format",
            format,
            "-o",
            text(&data),
        ]);
        let again = out.path().join(format!("{format}-again"));
        let [calibration, images] = [calibration, images].map(|name| data.join(name));
        let output =
            succeed(&["import", text(&calibration), "--images", text(&images), "-o", text(&again)]);
        assert!(stderr(&output).contains("as of one clock"), "{}", stderr(&output));
        assert_same(&again, folder.path(), &times_s, true);
        assert!(clocks(&again).iter().all(|clock| clock["shared"] == true));
    }
    let times = std::fs::read(out.path().join("colmap/sparse/0/times.bin")).unwrap();
    // Nine images; the first is the reference's, image 1 at 0 ns.
    assert_eq!(
        times[..20],
        [&9_u64.to_le_bytes()[..], &1_u32.to_le_bytes(), &0_i64.to_le_bytes()].concat()
    );
    assert_eq!(times.len(), 8 + 9 * 12);
}

/// Images in one folder belong to one camera where pose and lens are the same.
#[test]
fn flat_lists_of_images_are_grouped_by_pose() {
    let folder = tempfile::tempdir().unwrap();
    let mut frames = Vec::new();
    for time in 0..2 {
        for camera in 0..2 {
            let name = format!("images/view{camera}_{time:04}.png");
            let image = Image::filled(8, 6, 1, 0.2 * (1 + 2 * time + camera) as f32);
            write_image(&folder.path().join(&name), &image, None, BitDepth::Eight).unwrap();
            frames
                .push(json!({"file_path": name, "time": 0.5 * f64::from(time), "transform_matrix":
                [[1, 0, 0, camera], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]}));
        }
    }
    let path = folder.path().join("transforms.json");
    let mut json = json!({"w": 8, "h": 6, "fl_x": 8, "frames": frames});
    std::fs::write(&path, json.to_string()).unwrap();
    let out = folder.path().join("capture");
    let output = succeed(&["import", text(&path), "-o", text(&out)]);
    assert!(
        stderr(&output).contains("one camera: 2 cameras, from view0 on."),
        "{}",
        stderr(&output)
    );
    let capture = open(&out);
    let ids: Vec<&str> = capture.cameras.iter().map(|c| c.id.as_str()).collect();
    assert_eq!(ids, ["view0", "view1"]);
    let shade = |camera, frame| capture.read_frame(camera, frame).unwrap().pixel(0, 0)[0];
    let shades = [shade(0, 0), shade(1, 0), shade(0, 1), shade(1, 1)].map(|v| (10.0 * v).round());
    assert_eq!(shades, [2.0, 4.0, 6.0, 8.0]);
    assert_eq!(capture.times_in_file_s(1), [0.0, 0.5]);

    for (frame, field, value, words) in [
        (1, "time", json!(1e300), "frames[1]: time 1e300 must be within"),
        (2, "time", json!("late"), "frames[2].time: "),
        (3, "file_path", json!("images/none.png"), "has no image 'images/none.png'"),
    ] {
        let before = json["frames"][frame][field].take();
        json["frames"][frame][field] = value;
        std::fs::write(&path, json.to_string()).unwrap();
        let output = run(&["import", text(&path), "-o", text(&folder.path().join("none"))]);
        assert_refused(&output, 2, words);
        json["frames"][frame][field] = before;
    }
    // A camera that moves, as of a video that walks around.
    for k in 0..4 {
        json["frames"][k]["transform_matrix"][0][3] = json!(k);
    }
    std::fs::write(&path, json.to_string()).unwrap();
    let output = run(&["import", text(&path), "-o", text(&folder.path().join("none"))]);
    assert_refused(&output, 2, "cameras must not move");
}

/// A model of COLMAP in text whose frames, and not its images, have the poses.
#[test]
fn rigs_and_frames_give_the_poses() {
    let folder = tempfile::tempdir().unwrap();
    let file = |name: &str, text: &str| std::fs::write(folder.path().join(name), text).unwrap();
    file("cameras.txt", "1 PINHOLE 8 6 8 8 4 3\n2 PINHOLE 8 6 8 8 4 3\n");
    file("images.txt", "1 1 0 0 0 0 0 0 1 a/0.png\n\n2 1 0 0 0 0 0 0 2 b/0.png\n\n");
    file("rigs.txt", "# rigs\n7 2 CAMERA 1 CAMERA 2 1 1 0 0 0 -0.5 0 0\n");
    file("frames.txt", "1 7 1 0 0 0 0 0 -2 2 CAMERA 1 1 CAMERA 2 2\n");
    file("times.txt", "# colmap4d\n1 5\n2 -7\n1 6\n");
    let cameras = read_colmap(folder.path()).unwrap();
    let centers: Vec<_> = cameras.iter().map(|c| c.camera.center()).collect();
    assert_eq!(
        centers,
        [nalgebra::Point3::new(0.0, 0.0, 2.0), nalgebra::Point3::new(0.5, 0.0, 2.0)]
    );
    assert_eq!(
        [cameras[0].time_ns, cameras[1].time_ns],
        [Some(6), Some(-7)],
        "the last one counts"
    );
    for (name, content, words) in [
        ("rigs.txt", "7 2 CAMERA 1 CAMERA 2 1 1 0 0 0 -0.5\n", "rigs.txt: line 1: TY is missing"),
        ("rigs.txt", "7 1 CAMERA 1\n", "frames.txt: rig 7 has no camera 2"),
        ("rigs.txt", "8 1 CAMERA 1\n", "frames.txt: there is no rig 7"),
        ("rigs.txt", "7 99999999 CAMERA 1\n", "rigs.txt: line 1: holds more than"),
        ("frames.txt", "1 7 2 0 0 0 0 0 0 0\n", "frames.txt: line 1: its quaternion has length 2"),
        (
            "frames.txt",
            "1 7 1 0 0 0 0 0 0 3 CAMERA 1 1\n",
            "frames.txt: line 1: SENSOR_TYPE is missing",
        ),
        ("times.txt", "1 now\n", "times.txt: line 1: T_NS can't be 'now'"),
        ("times.txt", "1\n", "times.txt: line 1: T_NS is missing"),
    ] {
        let before = std::fs::read_to_string(folder.path().join(name)).unwrap();
        file(name, content);
        let arguments =
            ["import", text(folder.path()), "--images", text(folder.path()), "--rate", "30"];
        assert_refused(&run(&[&arguments[..], &["-o", "target/none"]].concat()), 2, words);
        file(name, &before);
    }
}

/// Lenses that the formats can't hold are straightened.
#[test]
fn distorted_lenses_are_undistorted_on_request() {
    let folder = synthetic::capture(&[0.0, 0.0], 2);
    edit(folder.path(), |json| {
        for c in 0..2 {
            json["cameras"][c]["clock"]["shared"] = json!(true);
            json["cameras"][c]["model"] = json!("SIMPLE_RADIAL");
            json["cameras"][c]["params"] = json!([170.0, 81.0, 60.0, -0.05]);
        }
    });
    let out = tempfile::tempdir().unwrap();
    let data = out.path().join("data");
    let export =
        ["-q", "export", text(folder.path()), "--synchronized", "--format", "llff", "--near", "1"];
    let export = [&export[..], &["--far", "6", "-o", text(&data)]].concat();
    assert_refused(&run(&export), 2, "data: can't describe cam0: it knows one focal length");
    succeed(&[&export[..], &["--undistort"]].concat());
    assert!(data.join("cam00.mp4").is_file() && data.join("cam01.mp4").is_file());
    let nerf = out.path().join("nerf");
    let arguments =
        ["export", text(folder.path()), "--synchronized", "--undistort", "--format", "nerf"];
    succeed(&[&arguments[..], &["-o", text(&nerf)]].concat());
    let cameras = read_nerf(&nerf.join("transforms.json")).unwrap();
    assert_eq!(cameras[0].camera.model.params(), [170.0, 170.0, 81.0, 60.0]);
    let (image, _) = read_image(&nerf.join("images/cam0/0000.png")).unwrap();
    assert_eq!((image.width(), image.height()), (160, 120));
}
