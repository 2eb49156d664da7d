use super::*;
use crate::camera::tests::pinhole_at;
use nalgebra::{Point3, UnitQuaternion};

fn view() -> Camera {
    let mut view = pinhole_at([0.2, -0.1, 0.3]);
    view.cam_from_world.rotation = UnitQuaternion::from_euler_angles(0.1, -0.3, 0.05);
    view
}

/// Returns the world coordinates of a point that is given in a view's camera frame, metres.
fn at(view: &Camera, point: [f64; 3]) -> Point3<f64> {
    view.cam_from_world.inverse() * Point3::from(point)
}

#[test]
fn the_plane_of_convergence_has_no_parallax_and_views_are_not_turned() {
    let view = view();
    for name in ["go", "16-landscape", "27-portrait", "8x6:3360x3360"] {
        let layout: QuiltLayout = name.parse().unwrap();
        let cameras = layout.cameras(&view, 12.0, 2.0);
        assert_eq!(cameras.len(), layout.views());
        for corner in [[0.0, 0.0], [0.2, 0.1], [-0.3, 0.2], [0.1, -0.4]] {
            let [near, on, far] = [1.5, 2.0, 3.0].map(|z| at(&view, [corner[0], corner[1], z]));
            let pixels = |point| cameras.iter().map(move |c| c.project(&point).unwrap());
            let first = pixels(on).next().unwrap();
            assert!(pixels(on).all(|p| (p - first).norm() < 1e-9), "{name}");
            // From one view to the next on its right, near points move to the left and far points to the right, along
            // rows.
            let [near, far] = [near, far].map(|point| pixels(point).collect::<Vec<_>>());
            assert!(near.is_sorted_by(|a, b| a.x > b.x) && far.is_sorted_by(|a, b| a.x < b.x));
            assert!(
                near.iter()
                    .chain(&far)
                    .all(|p| (p.y - near[0].y).abs() < 1e-9 || (p.y - far[0].y).abs() < 1e-9)
            );
        }
        assert!(cameras.iter().all(|c| c.cam_from_world.rotation == view.cam_from_world.rotation));
    }
}

#[test]
fn the_cone_is_the_angle_between_the_first_and_the_last_view() {
    let view = view();
    let layout: QuiltLayout = "portrait".parse().unwrap();
    let subject = at(&view, [0.0, 0.0, 2.0]);
    let cameras = layout.cameras(&view, 40.0, 2.0);
    let ray = |camera: &Camera| camera.center() - subject;
    let angle = ray(&cameras[0]).angle(&ray(&cameras[47])).to_degrees();
    assert!((angle - 40.0).abs() < 1e-9, "{angle}");
    assert!((view.cam_from_world * cameras[0].center()).x < 0.0, "the first is the leftmost");
}

#[test]
fn a_tile_shows_the_part_of_the_view_that_has_the_displays_shape() {
    let view = view();
    for (name, shown) in
        [("go", [270.0, 480.0]), ("16-landscape", [640.0, 360.0]), ("portrait", [360.0, 480.0])]
    {
        let layout: QuiltLayout = name.parse().unwrap();
        let [width, height] = layout.tile_px().map(|side| side as f64);
        let tile = &layout.cameras(&view, 0.0, 2.0)[0];
        for (x, y) in [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (1.0, 1.0)] {
            let pixel =
                nalgebra::Point2::new(320.0 + (x - 0.5) * shown[0], 240.0 + (y - 0.5) * shown[1]);
            let point = view.center() + view.ray_world(&pixel).unwrap() * 2.0;
            let found = tile.project(&point).unwrap();
            let expected = nalgebra::Point2::new(x * width, y * height);
            assert!((found - expected).norm() < 1e-9, "{name}: {found} {expected}");
        }
    }
}

#[test]
fn layouts_are_the_vendors() {
    for (name, grid, size, end) in [
        ("go", [11, 6], [4092, 4092], "_qs11x6a0.5625"),
        ("portrait", [8, 6], [3360, 3360], "_qs8x6a0.75"),
        ("16-landscape", [8, 6], [7680, 4320], "_qs8x6a1.77778"),
        ("16-landscape-7x7", [7, 7], [5999, 5999], "_qs7x7a1.77778"),
        ("16-portrait", [11, 6], [5995, 6000], "_qs11x6a0.5625"),
        ("27-portrait", [12, 4], [7680, 4320], "_qs12x4a0.5625"),
        ("32-landscape", [7, 7], [8190, 8190], "_qs7x7a1.77778"),
        ("65", [8, 9], [8192, 8192], "_qs8x9a1.77778"),
        ("5x9:4096x4096", [5, 9], [4096, 4096], "_qs5x9a1.8"),
    ] {
        let layout: QuiltLayout = name.parse().unwrap();
        assert_eq!(([layout.columns, layout.rows], layout.size_px), (grid, size), "{name}");
        assert_eq!(layout.name(), end);
        let [width, height] = layout.tile_px();
        assert_eq!(layout.tile_origin(0), [0, size[1] - height], "bottom left");
        let [x, y] = layout.tile_origin(layout.views() - 1);
        assert_eq!(x, (grid[0] - 1) * width);
        assert_eq!(y, size[1] - grid[1] * height);
    }
    for wrong in [
        "",
        "glass",
        "8x6",
        "8x6:0x0",
        "0x6:100x100",
        "8x6:9000x9000",
        "1x1:100x100",
        "99x99:8192x8192",
    ] {
        assert!(wrong.parse::<QuiltLayout>().is_err(), "{wrong}");
    }
}

#[test]
fn eight_cameras_6_cm_apart_cover_12_degrees_at_2_m() {
    let cameras: Vec<Camera> =
        (0..8).map(|c| pinhole_at([0.06 * (f64::from(c) - 3.5), 0.0, 0.0])).collect();
    let covered = |x: f64, depth| covered_cone_deg(&pinhole_at([x, 0.0, 0.0]), &cameras, depth);
    assert!((covered(0.0, 2.0) - 11.99).abs() < 0.01, "{}", covered(0.0, 2.0));
    assert!(covered(0.1, 2.0) < covered(0.0, 2.0) && covered(0.0, 4.0) < 6.1);
    assert_eq!(covered(0.3, 2.0), 0.0);
}

#[test]
fn eyes_are_left_and_right() {
    let view = view();
    let [left, right] = stereo(&view, 0.06, 1.5);
    assert!(((left.center() - right.center()).norm() - 0.06).abs() < 1e-12);
    let on = at(&view, [0.1, 0.2, 1.5]);
    assert!((left.project(&on).unwrap() - right.project(&on).unwrap()).norm() < 1e-9);
    let near = at(&view, [0.0, 0.0, 1.0]);
    assert!(left.project(&near).unwrap().x > right.project(&near).unwrap().x);
}
