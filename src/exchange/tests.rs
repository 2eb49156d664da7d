use super::*;
use crate::camera::tests::pinhole_at;
use nalgebra::{Point2, Point3, UnitQuaternion};

/// Returns a camera at (1, 2, 3) in the world, in metres. It is rotated by 90° about its own x axis and looks up: its
/// axes in the world are right = +x, down = +z, forward = −y.
fn looking_up() -> NamedCamera {
    let axes = Matrix3::from_columns(&[Vector3::x(), Vector3::z(), -Vector3::y()]);
    let pose = pose_from_axes(&axes, Vector3::new(1.0, 2.0, 3.0)).unwrap();
    let model = CameraModel::Pinhole { fx: 700.0, fy: 700.0, cx: 320.0, cy: 240.0 };
    let camera = Camera { width: 640, height: 480, model, cam_from_world: pose };
    NamedCamera { name: "cam0".into(), time_ns: None, camera }
}

/// Returns one camera of each camera model that the program supports. The poses have no symmetry.
fn one_of_each() -> Vec<NamedCamera> {
    CameraModel::KNOWN
        .iter()
        .enumerate()
        .map(|(k, (name, _, count))| {
            let params: Vec<f64> = (0..*count).map(|p| 500.1 / (1.0 + p as f64).powi(4)).collect();
            let mut camera = pinhole_at([0.1 * k as f64, -0.3, 1.0 / 3.0]);
            let turn = UnitQuaternion::from_euler_angles(0.3 * k as f64, -0.7, 2.0 + k as f64);
            camera.cam_from_world = Isometry3::from_parts([0.1, -1.0 / 7.0, k as f64].into(), turn);
            camera.model = CameraModel::from_params(name, &params).unwrap();
            NamedCamera { name: format!("cam{k}/0000.png"), time_ns: None, camera }
        })
        .collect()
}

fn assert_same(a: &[NamedCamera], b: &[NamedCamera]) {
    assert_eq!(a.len(), b.len());
    for (a, b) in a.iter().zip(b) {
        assert_eq!(a.name, b.name);
        let (a, b) = (&a.camera, &b.camera);
        assert_eq!((a.width, a.height), (b.width, b.height));
        let [pa, pb] = [a, b].map(|c| c.model.params());
        assert_eq!(a.model.name(), b.model.name());
        assert!(pa.iter().zip(&pb).all(|(x, y)| (x - y).abs() <= 1e-12 * x.abs()), "{pa:?} {pb:?}");
        let (a, b) = (&a.cam_from_world, &b.cam_from_world);
        assert!((a.to_homogeneous() - b.to_homogeneous()).amax() < 1e-12, "{a} {b}");
    }
}

#[test]
fn colmap_models_round_trip() {
    let cameras = one_of_each();
    let folder = tempfile::tempdir().unwrap();
    write_colmap_text(&folder.path().join("text"), &cameras).unwrap();
    assert_same(&read_colmap(&folder.path().join("text")).unwrap(), &cameras);
    write_colmap_binary(&folder.path().join("binary"), &cameras).unwrap();
    assert_same(&read_colmap(&folder.path().join("binary")).unwrap(), &cameras);
}

/// Numbers in a COLMAP text file are formatted as by C and Python.
#[test]
fn colmap_text_is_this_text() {
    let mut camera = CameraFormat::from(&looking_up().camera);
    camera.cam_from_world.rotation_wxyz = [0.5, 0.5, -1.5e-7, 1e-5];
    camera.cam_from_world.translation = [1.0, 1e16, 0.0001];
    let files = colmap_text(&[("cam0/0000.png".into(), camera)]);
    let lines = |name: &str| files[name].lines().skip(1).map(str::to_owned).collect::<Vec<_>>();
    assert_eq!(lines("cameras.txt"), ["1 PINHOLE 640 480 700.0 700.0 320.0 240.0"]);
    let image = "1 0.5 0.5 -1.5e-07 1e-05 1.0 1e+16 0.0001 1 cam0/0000.png";
    assert_eq!(lines("images.txt")[1..], [image, ""]);
    assert_eq!(lines("points3D.txt"), [""; 0]);
}

#[test]
fn colmap_points_are_skipped() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("cameras.txt"), "# c\n7 SIMPLE_RADIAL 64 48 60 32 24 -0.1\n")
        .unwrap();
    let images = "# i\n2 1 0 0 0 0 0 5 7 b c.png\n1.5 2.5 -1 3 4 9\n1 1 0 0 0 1 2 3 7 a.png\n\n";
    std::fs::write(folder.path().join("images.txt"), images).unwrap();
    let cameras = read_colmap(folder.path()).unwrap();
    assert_eq!((cameras[0].name.as_str(), cameras[1].name.as_str()), ("a.png", "b c.png"));
    assert_eq!(cameras[0].camera.center(), Point3::new(-1.0, -2.0, -3.0));
    assert_eq!(cameras[1].camera.model.name(), "SIMPLE_RADIAL");
}

/// The expected row of the LLFF file is computed by hand. Its columns are the axes down (0, 0, 1), right (1, 0, 0) and
/// back (0, 1, 0), the centre, and (height, width, focal length).
#[test]
fn llff_is_down_right_back() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("poses_bounds.npy");
    write_llff(&path, &[looking_up()], (0.5, 8.0)).unwrap();
    let bytes = std::fs::read(&path).unwrap();
    assert_eq!(bytes.len(), 128 + 17 * 8);
    let values: Vec<f64> =
        bytes[128..].as_chunks().0.iter().map(|b| f64::from_le_bytes(*b)).collect();
    let expected =
        [[0.0, 1.0, 0.0, 1.0, 480.0], [0.0, 0.0, 1.0, 2.0, 640.0], [1.0, 0.0, 0.0, 3.0, 700.0]];
    for (value, expected) in values.iter().zip(expected.as_flattened().iter().chain(&[0.5, 8.0])) {
        assert!((value - expected).abs() < 1e-12, "{values:?}");
    }
    let mut back = read_llff(&path).unwrap();
    assert_eq!(back[0].name, "0");
    back[0].name = "cam0".into();
    assert_same(&back, &[looking_up()]);
}

#[test]
fn llff_refuses_lenses_that_it_cannot_describe() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("poses_bounds.npy");
    for params in [[700.0, 701.0, 320.0, 240.0], [700.0, 700.0, 319.5, 239.5]] {
        let mut camera = looking_up();
        camera.camera.model = CameraModel::from_params("PINHOLE", &params).unwrap();
        let message = write_llff(&path, &[camera], (1.0, 2.0)).unwrap_err().to_string();
        assert!(message.contains("can't describe cam0"), "{message}");
    }
}

/// The expected matrix is computed by hand. Its columns are right (1, 0, 0), up (0, 0, −1), back (0, 1, 0) and the
/// centre, as in OpenGL.
#[test]
fn transforms_have_opengls_axes() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("transforms.json");
    write_nerf(&path, &[looking_up()]).unwrap();
    let json: serde_json::Value =
        serde_json::from_str(&std::fs::read_to_string(&path).unwrap()).unwrap();
    let frame = &json["frames"][0];
    let expected =
        [[1.0, 0.0, 0.0, 1.0], [0.0, 0.0, 1.0, 2.0], [0.0, -1.0, 0.0, 3.0], [0.0, 0.0, 0.0, 1.0]];
    for (row, expected) in expected.iter().enumerate() {
        for (column, expected) in expected.iter().enumerate() {
            let value = frame["transform_matrix"][row][column].as_f64().unwrap();
            assert!((value - expected).abs() < 1e-12, "{frame}");
        }
    }
    assert_eq!((frame["cx"].as_f64(), frame["fl_x"].as_f64()), (Some(320.0), Some(700.0)));
    assert_same(&read_nerf(&path).unwrap(), &[looking_up()]);
}

#[test]
fn transforms_round_trip_with_distortion() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("transforms.json");
    let cameras: Vec<_> = one_of_each()
        .into_iter()
        .filter(|c| ["PINHOLE", "OPENCV", "OPENCV_FISHEYE"].contains(&c.camera.model.name()))
        .collect();
    write_nerf(&path, &cameras).unwrap();
    assert_same(&read_nerf(&path).unwrap(), &cameras);
}

/// NeRF's synthetic scenes give one horizontal field of view for all frames. With a focal length of 700 pixels, an
/// image of 640 pixels has a field of view of 2 atan(320/700).
#[test]
fn a_lens_for_all_frames_is_read() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("transforms.json");
    let angle = 2.0 * (320.0_f64 / 700.0).atan();
    let text = format!(
        r#"{{"camera_angle_x": {angle}, "w": 640, "h": 480, "aabb_scale": 4, "frames": [
            {{"file_path": "a", "sharpness": 3, "transform_matrix":
            [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 2], [0, 0, 0, 1]]}}]}}"#
    );
    std::fs::write(&path, text).unwrap();
    let camera = &read_nerf(&path).unwrap()[0].camera;
    assert!((camera.focal_px() - 700.0).abs() < 1e-9);
    // The camera is on the +z axis and looks along −z. World +x is right, and world +y is up.
    let pixel = camera.project(&Point3::new(0.2, 0.1, 0.0)).unwrap();
    assert!((pixel - Point2::new(390.0, 205.0)).norm() < 1e-9, "{pixel}");
}

#[test]
fn damaged_files_are_one_sentence() {
    let folder = tempfile::tempdir().unwrap();
    let dir = folder.path();
    write_colmap_binary(dir, &one_of_each()).unwrap();
    let images = std::fs::read(dir.join("images.bin")).unwrap();
    for end in 0..images.len() {
        std::fs::write(dir.join("images.bin"), &images[..end]).unwrap();
        let message = read_colmap(dir).unwrap_err().to_string();
        assert!(message.contains("images.bin: ") && !message.contains('\n'), "{end}: {message}");
    }
    // This number of points would exhaust the memory if memory were allocated for it.
    let mut huge = images.clone();
    let name = images.windows(10).position(|w| w == b"/0000.png\0").unwrap() + 10;
    huge[name..name + 8].fill(0xff);
    std::fs::write(dir.join("images.bin"), &huge).unwrap();
    assert!(read_colmap(dir).unwrap_err().to_string().contains("cut short"));

    let npy = dir.join("poses_bounds.npy");
    write_llff(&npy, &[looking_up()], (1.0, 2.0)).unwrap();
    let whole = std::fs::read(&npy).unwrap();
    for end in 0..whole.len() {
        std::fs::write(&npy, &whole[..end]).unwrap();
        assert!(read_llff(&npy).is_err(), "{end}");
    }
    let json = dir.join("transforms.json");
    for (text, field) in [
        ("{}", "frames"),
        (r#"{"frames": []}"#, "frames"),
        (r#"{"frames": [{"file_path": "a", "transform_matrix": [[1]]}]}"#, "frames"),
    ] {
        std::fs::write(&json, text).unwrap();
        let message = read_nerf(&json).unwrap_err().to_string();
        assert!(message.contains(field), "{message}");
    }
}

#[test]
fn matrices_that_are_no_rotation_are_refused() {
    for axes in [Matrix3::zeros(), Matrix3::identity() * 1.01, -Matrix3::identity()] {
        assert!(pose_from_axes(&axes, Vector3::zeros()).is_err(), "{axes}");
    }
    assert!(pose_from_axes(&Matrix3::identity(), Vector3::new(f64::NAN, 0.0, 0.0)).is_err());
}

#[test]
fn a_model_and_sequences_become_a_capture() {
    use crate::capture::Capture;
    use crate::raster::{BitDepth, write_image};
    let folder = tempfile::tempdir().unwrap();
    let (images, target) = (folder.path().join("images"), folder.path().join("capture"));
    let mut cameras: Vec<NamedCamera> = Vec::new();
    for id in ["left", "right"] {
        for k in [8, 9, 10] {
            let shade = crate::raster::Image::filled(8, 6, 3, k as f32 / 10.0);
            let path = images.join(format!("{id}/f{k}.png"));
            write_image(&path, &shade, None, BitDepth::Eight).unwrap();
            let mut camera = pinhole_at([if id == "left" { 0.0 } else { 0.1 }, 0.0, 0.0]);
            (camera.width, camera.height) = (8, 6);
            cameras.push(NamedCamera { name: format!("{id}/f{k}.png"), time_ns: None, camera });
        }
    }
    let clock = ImportClock { first_s: 2.0, ..CLOCK };
    import_by(&cameras, &images, clock, &target).unwrap();
    let capture = Capture::open(&target).unwrap();
    assert_eq!(capture.cameras.len(), 2);
    assert!((capture.cameras[1].camera.center() - Point3::new(0.1, 0.0, 0.0)).norm() < 1e-12);
    assert_eq!(capture.cameras[1].frames.len(), 3);
    // The order of the frames is f8, f9, f10. It is by number, not alphabetical.
    assert_eq!(capture.read_frame(0, 2).unwrap().pixel(0, 0), [1.0; 3]);
    assert_eq!(capture.times_in_file_s(0), [2.0, 2.04, 2.08]);
    let again = import_by(&cameras, &images, clock, &target).unwrap_err().to_string();
    assert!(again.contains("not written over"), "{again}");

    cameras[1].camera.cam_from_world.translation.x += 0.01;
    let moving = import_by(&cameras, &images, clock, &folder.path().join("other")).unwrap_err();
    assert!(moving.to_string().contains("must not move"), "{moving}");
}

/// Writes images with the given numbers into the folder `a`, and returns their camera.
fn sequence_of(folder: &Path, numbers: &[&str]) -> NamedCamera {
    for number in numbers {
        let shade = crate::raster::Image::filled(8, 6, 1, 0.5);
        let path = folder.join(format!("a/{number}.png"));
        crate::raster::write_image(&path, &shade, None, crate::raster::BitDepth::Eight).unwrap();
    }
    let mut camera = looking_up();
    (camera.camera.width, camera.camera.height) = (8, 6);
    NamedCamera { name: "a/0.png".into(), ..camera }
}

fn import_by(
    cameras: &[NamedCamera],
    images: &Path,
    clock: ImportClock,
    target: &Path,
) -> Result<Vec<String>, ExchangeError> {
    let request = ImportRequest {
        images,
        table: None,
        times: None,
        clock,
        is_cropped: false,
        is_uncalibrated: false,
    };
    let reporter = &crate::progress::Reporter::silent();
    import(cameras, &request, target, &crate::capture::Opening { ffmpeg: None, reporter })
}

const CLOCK: ImportClock = ImportClock {
    rate_hz: Some(25.0),
    first_s: 0.0,
    shared: false,
    readout_s: None,
    readout_std_s: None,
};

#[test]
fn every_frame_counts_in_an_import() {
    for (numbers, words) in [
        (["0", "1", "3"].as_slice(), "1.png and 3.png must follow"),
        (&["f0", "g0"], "f0.png and g0.png must follow"),
        (&["a", "b"], "a.png and b.png must follow"),
        (&["99999999999999999999"], "too large to count"),
    ] {
        let folder = tempfile::tempdir().unwrap();
        let camera = sequence_of(&folder.path().join("images"), numbers);
        let target = folder.path().join("capture");
        let error =
            import_by(&[camera], &folder.path().join("images"), CLOCK, &target).unwrap_err();
        assert!(error.to_string().contains(words), "{error}");
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1, "only the images");
    }
    let folder = tempfile::tempdir().unwrap();
    let camera = sequence_of(folder.path(), &["0", "1", "2"]);
    std::fs::remove_file(folder.path().join("a/1.png")).unwrap();
    std::fs::create_dir(folder.path().join("a/1.png")).unwrap();
    let target = folder.path().join("capture");
    let error = import_by(&[camera], folder.path(), CLOCK, &target).unwrap_err();
    assert!(error.to_string().contains("1.png: has an image's name and is no"), "{error}");
}

#[test]
fn an_import_is_whole_or_not_there() {
    let folder = tempfile::tempdir().unwrap();
    let images = folder.path().join("images");
    let camera = std::slice::from_ref(&sequence_of(&images, &["7", "8"])).to_vec();
    // The folder of the original images and other folders that aren't empty are refused as targets.
    let before = std::fs::read(images.join("a/7.png")).unwrap();
    for target in [&images, &images.join("a"), &images.join("a/7.png")] {
        assert!(import_by(&camera, &images, CLOCK, target).is_err());
    }
    assert_eq!(std::fs::read(images.join("a/7.png")).unwrap(), before);
    // A failed import leaves no files, so that it can be repeated.
    let target = folder.path().join("capture");
    let fast = ImportClock { rate_hz: Some(1e12), ..CLOCK };
    let error = import_by(&camera, &images, fast, &target).unwrap_err().to_string();
    assert!(error.contains("capture: capture.json: cameras[0]"), "{error}");
    std::fs::write(images.join("a/8.png"), "no image").unwrap();
    let error = import_by(&camera, &images, CLOCK, &target).unwrap_err().to_string();
    assert!(error.contains("capture: a/0001.png"), "{error}");
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
    std::fs::copy(images.join("a/7.png"), images.join("a/8.png")).unwrap();
    std::fs::create_dir(&target).unwrap();
    import_by(&camera, &images, CLOCK, &target).unwrap();
    assert_eq!(crate::capture::Capture::open(&target).unwrap().cameras[0].frames.len(), 2);
}

#[test]
fn names_that_lead_elsewhere_are_refused() {
    let clock = CLOCK;
    let folder = tempfile::tempdir().unwrap();
    for name in ["../a.png", "", "/", "a%d/0.png", ".x/0.png"] {
        let mut camera = looking_up();
        camera.name = name.into();
        let message =
            import_by(&[camera], folder.path(), clock, &folder.path().join("c")).unwrap_err();
        assert!(message.to_string().contains("can't name a camera"), "{name}: {message}");
    }
}

/// Ten styles of names for cameras and folders. Each function maps an index to a name.
const STYLES: [fn(usize) -> String; 10] = [
    |k| format!("cam{k}"),
    |k| format!("cam{k:03}"),
    |k| format!("{}", k + 1),
    |k| format!("{}", 40 - k),
    |k| format!("Kamera süd {}", 8 + k),
    |k| format!("r{}c{}", k % 4, k / 4),
    |k| format!("rig2.2024-01-{k}"),
    |k| format!("{}{}", (b'a' + (k % 26) as u8) as char, (k / 26) as u8),
    |k| format!("{:x}", 7 + k),
    |k| format!("{}7{}", "0".repeat(k % 3), k / 3),
];

#[test]
fn every_camera_keeps_its_pose_through_export_and_import() {
    let folder = tempfile::tempdir().unwrap();
    let (model, npy) = (folder.path().join("model"), folder.path().join("poses_bounds.npy"));
    let json = folder.path().join("transforms.json");
    for (style, name) in STYLES.iter().enumerate() {
        let images = folder.path().join(format!("images{style}"));
        let mut paired_without_names = 0;
        for count in 1..=40 {
            let last = name(count - 1);
            std::fs::create_dir_all(images.join(&last)).unwrap();
            let at = |k: usize| pinhole_at([0.5 + k as f64, 0.0, 0.0]);
            let named = |k| NamedCamera {
                name: format!("{}/0000.png", name(k)),
                time_ns: None,
                camera: at(k),
            };
            let cameras: Vec<NamedCamera> = (0..count).map(named).collect();
            let of_its_name = |pairs: &pairing::Pairs| {
                assert_eq!(pairs.recordings.len(), count);
                for (camera, folder) in pairs.cameras.iter().zip(&pairs.recordings) {
                    let k = camera.camera.center().x.floor() as usize;
                    assert_eq!(folder, &images.join(name(k)), "{} of {count}", camera.name);
                    assert_eq!(camera.name, name(k));
                }
            };
            write_colmap_binary(&model, &cameras).unwrap();
            of_its_name(&pairing::pair(&read_colmap(&model).unwrap(), &images).unwrap());
            write_nerf(&json, &cameras).unwrap();
            of_its_name(&pairing::pair(&read_nerf(&json).unwrap(), &images).unwrap());
            write_llff(&npy, &cameras, (1.0, 2.0)).unwrap();
            match pairing::pair(&read_llff(&npy).unwrap(), &images) {
                Ok(pairs) => {
                    of_its_name(&pairs);
                    let note = &pairs.notes[0];
                    assert!(note.contains("has no names; its rows are the recordings"), "{note}");
                    paired_without_names += 1;
                }
                Err(error) => {
                    assert!(error.to_string().contains("leave their order open"), "{error}");
                }
            }
        }
        let wanted = if style < 7 { 40 } else { 1 };
        assert!(paired_without_names >= wanted, "{style}: {paired_without_names}");
    }
}

#[test]
fn names_that_differ_pair_by_number_or_not_at_all() {
    let folder = tempfile::tempdir().unwrap();
    let camera = |name: &str, x| NamedCamera {
        name: name.into(),
        time_ns: None,
        camera: pinhole_at([x, 0.0, 0.0]),
    };
    let cameras = [camera("view10.png", 10.0), camera("view9.png", 9.0)];
    for name in ["cam9", "cam10"] {
        std::fs::create_dir(folder.path().join(name)).unwrap();
    }
    let pairs = pairing::pair(&cameras, folder.path()).unwrap();
    assert_eq!(pairs.recordings, ["cam9", "cam10"].map(|name| folder.path().join(name)));
    assert_eq!(pairs.cameras[0].camera.center().x, 9.0);
    for other in [["view8.png", "view9.png"], ["left.png", "right.png"]] {
        let cameras = [camera(other[0], 10.0), camera(other[1], 9.0)];
        let error = pairing::pair(&cameras, folder.path()).err().unwrap().to_string();
        assert!(error.contains("has recordings like cam9, and none"), "{error}");
    }
}
