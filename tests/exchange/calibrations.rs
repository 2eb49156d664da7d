//! Calibrations of other programs, whole and damaged.

use crate::common::{assert_refused, edit, run, stderr, succeed, synthetic, text};
use crate::open;
use serde_json::json;
use stlfr::exchange::{read_anipose, read_colmap, read_qualisys};
use stlfr::raster::{BitDepth, Image, write_image};

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

/// The calibration of a capture serves another recording of the same array.
#[test]
fn a_captures_calibration_is_imported() {
    let folder = synthetic::capture(&[0.0, 0.3], 2);
    let description = folder.path().join("capture.json");
    let again = folder.path().join("again");
    succeed(&["import", text(&description), "--rate", "30", "-o", text(&again)]);
    let [before, after] = [folder.path(), &again].map(open);
    assert_eq!(before.cameras.len(), after.cameras.len());
    for (before, after) in before.cameras.iter().zip(&after.cameras) {
        assert_eq!((&before.id, &before.camera), (&after.id, &after.camera));
        assert_eq!(before.clock, after.clock);
    }
    edit(folder.path(), |json| json["cameras"][1]["params"][0] = json!(-1));
    let output = run(&["import", text(&description), "--rate", "30", "-o", "target/none"]);
    assert_refused(&output, 2, "capture.json: cameras[1].params: must be finite");
    edit(folder.path(), |json| json["cameras"][1]["lens"] = json!(1));
    let output = run(&["import", text(&description), "--rate", "30", "-o", "target/none"]);
    assert_refused(&output, 2, "capture.json: cameras[1].lens: unknown field");
}
