//! Videos and images as real cameras make them.

use crate::common::{assert_refused, edit, run, stderr, text};
use crate::{TEST, array, camera_toml, clocks, encode, import, open};
use serde_json::json;
use std::path::Path;
use stlfr::raster::{BitDepth, Image, write_image};

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

    std::fs::write(&film, "no video").unwrap();
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
