//! What is searched, and which frames say something.

use super::super::transfer::Proposals;
use super::*;
use nalgebra::Vector3;

#[test]
fn frames_far_away_in_time_say_nothing_of_motion() {
    let recording = recording(&[STILL]);
    let late = {
        let camera = camera_at(3.0 * SPACING_M, 0.0);
        FlowFrame::new(&camera, &filmed(&camera, &[STILL], 0.0), 500.0)
    };
    let own = &recording[0][1];
    let near: Vec<&FlowFrame> = vec![&recording[1][1], &recording[2][1]];
    let with_late = [&near[..], &[&late]].concat();
    let errors = |others: Vec<&FlowFrame>| {
        let map = estimated(&[(own, others)], &[], MAX_SPEED, &|| true).remove(0);
        median(map.pixels().iter().map(|p| f64::from(p.errors().velocity_px)).collect())
    };
    let (without, with) = (errors(near), errors(with_late));
    assert!(with > 0.5 * without, "{without} and {with} px a frame");
}

#[test]
fn gradients_are_those_of_a_camera_that_is_rolled_or_has_another_focal_length() {
    let slanted = Element {
        inverse_depth: 0.5,
        inverse_depth_gradient: [0.002, 0.0],
        velocity: [1.0, 0.0],
        ..Element::default()
    };
    let own = camera_at(0.0, 0.0);
    let image = Image::filled(SIZE[0], SIZE[1], 3, 0.5);
    let [width, height] = SIZE;
    let map = || ElementMap {
        width,
        height,
        scale: 1.0,
        elements: vec![slanted; width * height],
        costs: vec![0.0; width * height],
        given: Vec::new(),
    };
    let quarter = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), std::f64::consts::FRAC_PI_2);
    let rolled = Camera {
        cam_from_world: Isometry3::from_parts(Translation3::identity(), quarter),
        ..own.clone()
    };
    let far = Camera {
        model: CameraModel::Pinhole { fx: 200.0, fy: 200.0, cx: 48.0, cy: 36.0 },
        ..own.clone()
    };
    for (camera, gradient, velocity) in
        [(rolled, [0.0, 0.002], [0.0, 1.0]), (far, [0.001, 0.0], [2.0, 0.0])]
    {
        let frames = [&own, &camera].map(|camera| FlowFrame::new(camera, &image, 0.0));
        let [own, there] = &frames;
        let proposals = Proposals::new(&[own, there], &[map(), map()], 1);
        let k = 36 * width + 48;
        // Twice as large, the image has a proposal in one of four pixels.
        let around = [k, k - 1, k - width, k - width - 1];
        let proposed = around.iter().find_map(|&k| proposals.at(k).next()).unwrap();
        for c in 0..2 {
            let error = proposed.inverse_depth_gradient[c] - gradient[c];
            assert!(error.abs() < 1e-4, "{proposed:?}");
            assert!((proposed.velocity[c] - velocity[c]).abs() < 1e-2, "{proposed:?}");
        }
    }
}
