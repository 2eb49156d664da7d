use super::*;
use crate::camera::{Camera, EpipolarGeometry};
use nalgebra::{Point2, Point3};
use std::num::NonZeroUsize;

fn count(n: usize) -> NonZeroUsize {
    NonZeroUsize::new(n).unwrap()
}

fn centers(rig: &Rig) -> Vec<Point3<f64>> {
    rig.cameras.iter().map(|c| camera(c).center()).collect()
}

fn camera(camera: &RigCamera) -> Camera {
    Camera {
        width: camera.width as usize,
        height: camera.height as usize,
        model: camera.model(),
        cam_from_world: camera.cam_from_rig.isometry().unwrap(),
    }
}

fn near(a: Point3<f64>, b: [f64; 3]) -> bool {
    (a - Point3::from(b)).norm() < 1e-8
}

#[test]
fn a_line_is_the_papers_rig() {
    let rig = RigOptions::default().generate().unwrap();
    let centers = centers(&rig);
    assert_eq!((rig.cameras.len(), rig.reference.as_str()), (8, "cam3"));
    assert!(near(centers[0], [-0.21, 0.0, 0.0]) && near(centers[7], [0.21, 0.0, 0.0]));
    for camera in &rig.cameras {
        assert!((0.0..1.0 / 30.0).contains(&camera.delay_s));
    }
}

#[test]
fn a_grid_goes_row_by_row_from_the_top_left() {
    let layout = RigLayout::Grid { rows: count(2), columns: count(3) };
    let rig = RigOptions { layout, spacing_m: 0.1, ..Default::default() }.generate().unwrap();
    let centers = centers(&rig);
    assert!(near(centers[0], [-0.1, -0.05, 0.0]) && near(centers[5], [0.1, 0.05, 0.0]));
    assert_eq!(rig.reference, "cam1");
}

#[test]
fn an_arcs_cameras_see_its_centre_in_the_middle() {
    let layout = RigLayout::Arc { count: count(5), distance_m: 1.5 };
    let rig = RigOptions { layout, spacing_m: 0.2, ..Default::default() }.generate().unwrap();
    for c in &rig.cameras {
        let pixel = camera(c).project(&Point3::new(0.0, 0.0, 1.5)).unwrap();
        assert!((pixel - Point2::new(320.0, 240.0)).norm() < 1e-5, "{pixel}");
        assert!(((camera(c).center() - Point3::new(0.0, 0.0, 1.5)).norm() - 1.5).abs() < 1e-8);
    }
    // The first camera is left of the centre, and looks to the right.
    assert!(centers(&rig)[0].x < 0.0 && camera(&rig.cameras[0]).axis().x > 0.0);
    assert!(EpipolarGeometry::new(&camera(&rig.cameras[0]), &camera(&rig.cameras[1])).is_some());
    let narrow = RigLayout::Arc { count: count(5), distance_m: 0.3 };
    let refused = RigOptions { layout: narrow, spacing_m: 0.2, ..Default::default() }.generate();
    let sentence = "an arc needs a distance over half the array's width, not 0.3 m";
    assert_eq!(refused.unwrap_err().to_string(), sentence);
}

#[test]
fn views_stand_where_no_camera_does() {
    for n in 1..6 {
        let layouts = [
            RigLayout::Line { count: count(n) },
            RigLayout::Arc { count: count(n), distance_m: 2.0 },
            RigLayout::Grid { rows: count(n), columns: count(3) },
        ];
        for layout in layouts {
            let rig = RigOptions { layout, ..Default::default() }.generate().unwrap();
            for view in &rig.views {
                let cam_from_rig = view.cam_from_rig.isometry().unwrap();
                let center = cam_from_rig.inverse_transform_point(&Point3::origin());
                for c in centers(&rig) {
                    assert!((c - center).norm() > 0.025, "{layout:?} {} {c} {center}", view.id);
                }
            }
        }
    }
}

#[test]
fn lists_go_to_the_cameras_in_turn() {
    let options = RigOptions {
        rates_hz: vec![24.0, 60.0],
        colors: vec![RigColor::Gray, RigColor::Rgb, RigColor::Gray],
        delays: Delays::Listed(vec![0.25]),
        ..Default::default()
    };
    let cameras = options.generate().unwrap().cameras;
    let rates: Vec<f64> = cameras.iter().map(|c| c.rate_hz).collect();
    assert_eq!(rates, [24.0, 60.0, 24.0, 60.0, 24.0, 60.0, 24.0, 60.0]);
    assert_eq!((cameras[3].color, cameras[4].color), (RigColor::Gray, RigColor::Rgb));
    assert!(cameras.iter().all(|c| c.delay_s == 0.25));
    let none = RigOptions { gains: Vec::new(), ..Default::default() };
    assert_eq!(none.generate().unwrap_err().to_string(), "the list of gains must not be empty");
}

#[test]
fn the_reference_keeps_the_time() {
    let loss = Some(Loss { count: 3, within: 8, stamps: LossStamps::Hidden });
    let options =
        RigOptions { max_drift_ppm: 300.0, loss, jitters_s: vec![0.0], ..Default::default() };
    let rig = options.generate().unwrap();
    for camera in &rig.cameras {
        let is_reference = camera.id == rig.reference;
        assert_eq!(camera.drift_ppm == 0.0, is_reference);
        assert!(camera.drift_ppm.abs() <= 300.0);
        assert_eq!(camera.lost_frames.len(), if is_reference { 0 } else { 3 });
        assert!(camera.lost_frames.iter().all(|f| (1..8).contains(f)));
        assert_eq!(camera.lost_stamped, is_reference);
    }
    let many = Some(Loss { count: 8, within: 8, stamps: LossStamps::Hidden });
    assert!(RigOptions { loss: many, ..Default::default() }.generate().is_err());
}

#[test]
fn files_read_back_and_seeds_matter() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("rig.json");
    let loss = Some(Loss { count: 2, within: 9, stamps: LossStamps::Mixed });
    let options = RigOptions {
        layout: RigLayout::Arc { count: count(7), distance_m: 1.9 },
        distortion: RigDistortion { k1: -0.2, k2: 0.05, p1: 1e-3, p2: -2e-3 },
        jitter_stamped: false,
        exposures_s: vec![0.004],
        readouts_s: vec![0.0, 0.015],
        gains: vec![1.0, 1.3],
        noises: vec![0.01],
        bit_depth: 16,
        loss,
        max_drift_ppm: 50.0,
        ..Default::default()
    };
    let rig = options.generate().unwrap();
    std::fs::write(&path, rig.to_json()).unwrap();
    assert_eq!(Rig::read(&path).unwrap(), rig);
    assert_eq!(options.generate().unwrap().to_json(), rig.to_json());
    let other = RigOptions { seed: 1, ..options }.generate().unwrap();
    assert_ne!(other.cameras[0].delay_s, rig.cameras[0].delay_s);
}

#[test]
fn wrong_numbers_name_their_field() {
    type Break = fn(&mut RigOptions);
    let cases: [(Break, &str); 5] = [
        (|o| o.spacing_m = f64::NAN, "cameras[0].cam_from_rig.translation"),
        (|o| o.rates_hz = vec![30.0, 0.0], "cameras[1].rate_hz"),
        (|o| o.distortion.k1 = -2.0, "cameras[0].distortion has no inverse"),
        (|o| (o.clock_shared, o.max_drift_ppm) = (true, 10.0), "cameras[0].drift_ppm"),
        (|o| o.name = "a/b".into(), "name"),
    ];
    for (make_wrong, field) in cases {
        let mut options = RigOptions::default();
        make_wrong(&mut options);
        let message = options.generate().unwrap_err().to_string();
        assert!(message.starts_with(field), "{message}");
    }
}

#[test]
fn a_rig_is_parsed_from_its_own_text_and_errors_start_with_the_field() {
    let rig = RigOptions::default().generate().unwrap();
    assert_eq!(Rig::parse(&rig.to_json()), Ok(rig.clone()));
    let complaint = |from: &str, to: &str| {
        Rig::parse(&rig.to_json().replacen(from, to, 1)).unwrap_err().to_string()
    };
    let rate = "\"rate_hz\": 30.0";
    assert!(complaint(rate, "\"rate_hz\": 0").starts_with("cameras[0].rate_hz must be"));
    assert!(complaint(rate, "\"rate_hz\": \"a\"").starts_with("cameras[0].rate_hz"));
    assert!(!complaint("{", "[").contains('\n'));
}

#[test]
fn limits_are_those_of_the_captures_that_a_rig_makes() {
    let complaint = |options: RigOptions| options.generate().unwrap_err().to_string();
    let max = crate::capture::MAX_DRIFT_PPM;
    let mut rig = RigOptions::default().generate().unwrap();
    rig.cameras[0].drift_ppm = max;
    assert_eq!(rig.check(), Ok(()));
    rig.cameras[0].drift_ppm = 1.01 * max;
    assert!(rig.check().unwrap_err().to_string().starts_with("cameras[0].drift_ppm"));
    let large = RigOptions { sizes_px: vec![(16_000, 16_000)], ..Default::default() };
    assert!(complaint(large).starts_with("cameras[0].width times the height"));
    let layout = RigLayout::Grid { rows: count(32), columns: count(32) };
    let many = RigOptions { layout, ..Default::default() };
    assert_eq!(complaint(many), "a rig has from 1 to 1000 cameras, not 1024");
}

#[test]
fn options_are_read_from_json() {
    let read = |text: &str| crate::json::parse::<RigOptions>(text);
    assert_eq!(read("{}").unwrap(), RigOptions::default());
    let given = r#"{"layout": {"arc": {"count": 5, "distance_m": 1.5}}, "delays": {"listed": [0.25]},
        "loss": {"count": 1, "within": 9, "stamps": "mixed"}, "sizes_px": [[64, 48]]}"#;
    let expected = RigOptions {
        layout: RigLayout::Arc { count: count(5), distance_m: 1.5 },
        delays: Delays::Listed(vec![0.25]),
        loss: Some(Loss { count: 1, within: 9, stamps: LossStamps::Mixed }),
        sizes_px: vec![(64, 48)],
        ..Default::default()
    };
    assert_eq!(read(given).unwrap(), expected);
    for (wrong, field) in [
        (r#"{"layout": {"line": {"count": 0}}}"#, "layout.line.count"),
        (r#"{"layout": {"line": {"rows": 2}}}"#, "layout.line.rows"),
        (r#"{"delays": "late"}"#, "delays"),
        (r#"{"speed": 1}"#, "speed"),
    ] {
        let message = read(wrong).unwrap_err();
        assert!(message.starts_with(field), "{message}");
    }
}

#[test]
fn losses_among_too_many_frames_are_refused() {
    let loss = Some(Loss { count: 1, within: 200_000, stamps: LossStamps::Hidden });
    let long = RigOptions { loss, ..Default::default() }.generate();
    let sentence = "lost frames must be among the first 100000, not 200000";
    assert_eq!(long.unwrap_err().to_string(), sentence);
}
