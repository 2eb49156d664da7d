//! Degenerate geometry: the picture that is right all the same, or a reason.

use crate::common::edit;
use crate::common::scores;
use crate::common::wall::{
    FRAME_S, H, Scene, W, by_plane, by_proxy, estimate, field_of, open, view,
};
use nalgebra::{Point2, Point3, Vector3};
use serde_json::{Value, json};
use stlfr::camera::Camera;
use stlfr::interpolation::SyncMethod;
use stlfr::light_field::{Context, RenderError, Request, Viewpoint, render};
use stlfr::lumigraph::{BlendOptions, Plane, Proxy, Source, blend, triangulate};
use stlfr::method::Method;
use stlfr::offset::Offsets;
use stlfr::options::{ProxyMethod, RenderOptions};
use stlfr::raster::Image;

/// Clocks that are known and agree, so that only space is degenerate.
fn simultaneous() -> Scene {
    Scene { offsets_s: [0.0; 3], shared: [true; 3], ..Scene::default() }
}

/// The view of a scene's capture at a time in frames.
fn rendered(
    scene: &Scene,
    method: ProxyMethod,
    target: &Value,
    frames: f64,
) -> Result<Image, RenderError> {
    let folder = scene.film();
    let capture = open(&folder);
    let field = field_of(&capture, estimate(&capture));
    let rendered = field.view(&view(target), scene.time_s(frames), &by_proxy(method))?;
    assert!(rendered.image.data().iter().all(|v| (0.0..=1.0).contains(v)), "finite values");
    Ok(rendered.image)
}

/// Over all but a border, where the view sees what no camera does.
fn psnr_db(a: &Image, b: &Image) -> f64 {
    scores::psnr_db(a, b, 8)
}

/// The view from there, by both proxies, is near the truth.
#[track_caller]
fn assert_right(scene: &Scene, place_m: [f64; 3], min_db: f64) {
    for &method in ProxyMethod::ALL {
        let image = rendered(scene, method, &scene.camera(place_m), 1.6);
        let image = image.unwrap_or_else(|e| panic!("{method:?}, {} px: {e}", scene.focal_px));
        let db = psnr_db(&image, &scene.image(place_m, 1.6 * FRAME_S));
        assert!(db > min_db, "{method:?}: {db} dB");
    }
}

#[test]
fn a_view_at_an_input_camera_is_its_image() {
    let scene = simultaneous();
    let folder = scene.film();
    let capture = open(&folder);
    let field = field_of(&capture, estimate(&capture));
    let time_s = 1.5 * FRAME_S;
    for &method in ProxyMethod::ALL {
        let options = by_proxy(method);
        let request = Request::new(Viewpoint::Like(1), time_s, &options);
        let own = render(&field, &request, &Context::unattended()).unwrap().image;
        let target = view(&scene.camera([0.0; 3]));
        let rendered = field.view(&target, time_s, &options).unwrap();
        let apart = rendered.image.data().iter().zip(own.data()).map(|(a, b)| (a - b).abs());
        // A zero angle: that camera alone answers.
        assert!(apart.fold(0.0, f32::max) < 1e-5);
    }
}

#[test]
fn cameras_in_one_place() {
    let scene = Scene { centers_m: [[0.0; 3]; 3], ..simultaneous() };
    // Nothing can be triangulated, so no proxy is invented.
    for &method in ProxyMethod::ALL {
        let refused = rendered(&scene, method, &scene.camera([0.0; 3]), 1.0);
        assert!(matches!(refused, Err(RenderError::NoPoints)), "{method:?}");
    }
    // A plane set by hand needs none.
    let folder = scene.film();
    let capture = open(&folder);
    let field = field_of(&capture, estimate(&capture));
    let options = by_plane(2.0).with_sync(SyncMethod::Nearest);
    let target = view(&scene.camera([0.0; 3]));
    let image = field.view(&target, scene.time_s(1.0), &options).unwrap().image;
    assert!(psnr_db(&image, &scene.image([0.0; 3], FRAME_S)) > 60.0);
}

#[test]
fn two_cameras_in_one_place_and_one_beside() {
    let centers_m = [[0.0; 3], [0.0; 3], [0.06, 0.0, 0.0]];
    assert_right(&Scene { centers_m, ..simultaneous() }, [0.02, 0.0, 0.0], 30.0);
}

#[test]
fn the_epipole_inside_the_image() {
    // Camera after camera along the axis that all look along.
    let centers_m = [[0.0, 0.0, -0.3], [0.0; 3], [0.0, 0.0, 0.3]];
    let scene = Scene { centers_m, ..simultaneous() };
    assert_right(&scene, [0.0, 0.0, 0.1], 30.0);
    // Epipolar lines run through the epipole in all directions: most motion crosses them.
    let scene = Scene { centers_m, ..Scene::default() };
    let offsets = estimate(&open(&scene.film()));
    for (camera, truth_s) in offsets.cameras.iter().zip(scene.offsets_s) {
        let error = (camera.offset_s.expect("is known") - truth_s).abs() / FRAME_S;
        assert!(error < 0.02, "{camera:?}");
    }
}

#[test]
fn a_scene_at_infinity() {
    let scene = Scene { depth_m: 1e9, ..simultaneous() };
    // Rays are parallel up to the tracker's noise: wherever points are put, or if none are, all
    // cameras see the same.
    for &method in ProxyMethod::ALL {
        match rendered(&scene, method, &scene.camera([0.02, 0.0, 0.0]), 1.6) {
            Ok(image) => assert!(psnr_db(&image, &scene.image([0.0; 3], 1.6 * FRAME_S)) > 30.0),
            Err(error) => assert!(matches!(error, RenderError::NoPoints), "{error}"),
        }
    }
    let folder = scene.film();
    let capture = open(&folder);
    let field = field_of(&capture, estimate(&capture));
    let target = view(&scene.camera([0.02, 0.0, 0.0]));
    let image = field.view(&target, scene.time_s(1.6), &by_plane(1e9)).unwrap().image;
    assert!(psnr_db(&image, &scene.image([0.0; 3], 1.6 * FRAME_S)) > 30.0);
}

#[test]
fn long_and_short_lenses() {
    for focal_px in [10.0, 1e4, 1e6] {
        // As many pixels of parallax as by default.
        let scene = Scene { focal_px, depth_m: 0.02 * focal_px, ..simultaneous() };
        assert_right(&scene, [0.02, 0.0, 0.0], 30.0);
    }
}

#[test]
fn a_plane_through_the_views_centre() {
    let scene = simultaneous();
    let folder = scene.film();
    let capture = open(&folder);
    let field = field_of(&capture, estimate(&capture));
    let target = view(&scene.camera([0.02, 0.0, 0.0]));
    let refused = field.view(&target, scene.time_s(1.0), &by_plane(1e-300));
    assert!(matches!(refused, Err(RenderError::NothingSeen)), "{:?}", refused.err());
}

/// A proxy that a filming camera stands in: its points have no place in that camera's image, or all of
/// them one. The others are blended, and where a point is seen at all it is as bright as the wall.
#[test]
fn a_plane_through_a_filming_cameras_centre() {
    let scene = simultaneous();
    let cameras: Vec<Camera> = scene.centers_m.iter().map(|c| view(&scene.camera(*c))).collect();
    let images = vec![Image::filled(W, H, 1, 0.25); 3];
    let sources: Vec<Source> =
        cameras.iter().zip(&images).map(|(c, i)| Source::new(c, i)).collect();
    let target = view(&scene.camera([0.02, 0.0, 0.1]));
    for normal in [Vector3::x(), Vector3::y(), Vector3::new(1.0, 0.0, 1e-9).normalize()] {
        let d = normal.dot(&cameras[0].center().coords);
        let depth = Proxy::Plane(Plane { normal, d }).depth_map(&target);
        let seen = blend(&sources, &depth, &target, &BlendOptions::default());
        for (v, covered) in seen.image.data().iter().zip(&seen.coverage) {
            assert!((v - if *covered { 0.25 } else { 0.0 }).abs() < 1e-6, "{v}");
        }
    }
}

#[test]
fn points_on_the_baseline_and_nearly_parallel_rays() {
    let scene = simultaneous();
    let [a, b] = [[0.0; 3], [0.0, 0.0, 0.5]].map(|c| view(&scene.camera(c)));
    // One behind the other, both see what is between and beyond them in one pixel, at any depth.
    let pixel = Point2::new(W as f64 / 2.0, H as f64 / 2.0);
    assert!(triangulate(&[(&a, pixel), (&b, pixel)]).is_none(), "no depth fits best");
    let [a, b] = [[0.0; 3], [0.06, 0.0, 0.0]].map(|c| view(&scene.camera(c)));
    // 6 px of parallax at a metre; below 0.07 px rays are parallel but for noise.
    for (depth_m, is_found) in
        [(1.0, true), (60.0, true), (1e2, false), (1e6, false), (1e12, false)]
    {
        let point = Point3::new(0.1 * depth_m, -0.05 * depth_m, depth_m);
        let seen = [&a, &b].map(|c| (c, c.project(&point).expect("is before it")));
        let found = triangulate(&seen);
        assert_eq!(found.is_some(), is_found, "{depth_m}");
        let off_m = found.map_or(0.0, |found| (found.point - point).norm());
        assert!(off_m < 1e-9 * depth_m * depth_m, "{depth_m}: {off_m}");
    }
}

#[test]
fn fewer_cameras_than_a_pixel_is_blended_from() {
    let scene = simultaneous();
    let folder = scene.film();
    edit(folder.path(), |json| {
        json["cameras"].as_array_mut().expect("a list").truncate(2);
    });
    let capture = open(&folder);
    let field = field_of(&capture, estimate(&capture));
    let mut options = RenderOptions::default();
    options.blend.cameras = 8;
    let place_m = [-0.02, 0.0, 0.0];
    let target = view(&scene.camera(place_m));
    let image = field.view(&target, scene.time_s(1.0), &options).unwrap().image;
    assert!(psnr_db(&image, &scene.image(place_m, FRAME_S)) > 30.0);
}

#[test]
fn one_camera_is_slow_motion() {
    let scene = simultaneous();
    let folder = scene.film();
    edit(folder.path(), |json| {
        let cameras = json["cameras"].as_array_mut().expect("a list");
        cameras.retain(|c| c["id"] == json!("cam1"));
    });
    let capture = open(&folder);
    let field = field_of(&capture, Offsets::known(&capture));
    let image = field.synchronized(0, scene.time_s(1.6), &RenderOptions::default()).unwrap();
    assert!(psnr_db(&image.image, &scene.image([0.0; 3], 1.6 * FRAME_S)) > 30.0);
}
