//! f32 kernels against f64 references with stated bounds, over random inputs and the ends of their
//! ranges. (Private ones stand beside the code: the tracker's sums and registers in
//! `registration::klt` and `simd`, corners in `corners`, the blend and its weights in
//! `lumigraph::tests` and `weights`, windows in `interpolation::warp`.)

use crate::common::swing::Swing;
use crate::common::wall::{FRAME_S, Scene, estimate, field_of, open, view};
use crate::naive;
use nalgebra::{Matrix2, Point2, Vector2};
use std::sync::Arc;
use stlfr::camera::Camera;
use stlfr::interpolation::SyncMethod;
use stlfr::interpolation::Synchronized;
use stlfr::interpolation::{Edge, EdgeFeature, RowFractions, Warp, cross_dissolve, morph_warp};
use stlfr::light_field::{Context, GivenImages, Images, LightField, Request, Viewpoint, render};
use stlfr::lumigraph::BlendMethod;
use stlfr::lumigraph::Rendered;
use stlfr::offset::{CameraOffset, Offsets};
use stlfr::options::{ProxyMethod, RenderOptions};
use stlfr::random::Random;
use stlfr::raster::{BitDepth, Image, Quantized, Samples};
use stlfr::registration::{Frame, KltParameters, RegistrationOptions, Tracker};

/// Values of any kind that an image may hold: noise, steps, next to nothing.
fn image(random: &mut Random, width: usize, height: usize, channels: usize) -> Image {
    let kind = (4.0 * random.unit()) as usize;
    let data = (0..width * height * channels)
        .map(|_| match kind {
            0 => random.unit() as f32,
            1 => random.unit().round() as f32,
            2 => f32::MIN_POSITIVE,
            _ => 1.0,
        })
        .collect();
    Image::from_data(width, height, channels, data)
}

/// A position in an image, on pixels' centres and far outside too.
fn position(random: &mut Random, size: usize) -> f32 {
    let size = size as f64;
    match (5.0 * random.unit()) as usize {
        0 => (random.unit() * size).floor() as f32 + 0.5,
        1 => random.in_range(-1e9, 1e9) as f32,
        2 => random.in_range(-2.0, 2.0) as f32,
        _ => random.in_range(-2.0, size + 2.0) as f32,
    }
}

/// Weights sum to 1 and their magnitudes to 1.57 at most: some rounding errors of 6e-8 each.
const SAMPLE_BOUND: f64 = 1e-6;

#[test]
fn samples_between_pixels() {
    let mut random = Random::new(1);
    for round in 0..300 {
        // The widest: positions there are told to 5e-4 px in f32, and are taken as given.
        let (w, h) = if round % 20 == 0 { (8192, 2) } else { (1 + round % 17, 1 + round % 5) };
        let channels = [1, 3][round % 2];
        let image = image(&mut random, w, h, channels);
        for _ in 0..100 {
            let (x, y) = (position(&mut random, w), position(&mut random, h));
            let (mut cubic, mut linear) = (vec![0.0; channels], vec![0.0; channels]);
            image.sample_cubic(x, y, &mut cubic);
            image.sample_bilinear(x, y, &mut linear);
            for k in 0..channels {
                let exact = naive::cubic(&image, f64::from(x), f64::from(y), k);
                assert!((f64::from(cubic[k]) - exact).abs() <= SAMPLE_BOUND, "{x} {y} {w}×{h}");
                let exact = naive::bilinear(&image, f64::from(x), f64::from(y), k);
                assert!((f64::from(linear[k]) - exact).abs() <= SAMPLE_BOUND, "{x} {y} {w}×{h}");
            }
        }
    }
}

#[test]
fn warps_and_their_cross_fade() {
    let mut random = Random::new(2);
    for round in 0..40 {
        let (w, h, channels) = (1 + round % 23, 1 + round % 7, [1, 3][round % 2]);
        let frames = [(); 2].map(|()| image(&mut random, w, h, channels));
        let warps = [(); 2].map(|()| {
            let source =
                (0..w * h).map(|_| [position(&mut random, w), position(&mut random, h)]).collect();
            Warp { width: w, height: h, source }
        });
        for fraction in [0.0, 0.3, 1.0] {
            let fractions = RowFractions::constant(fraction);
            let found = cross_dissolve(frames.each_ref(), warps.each_ref(), fractions, None);
            for (at, v) in found.data().iter().enumerate() {
                let [a, b] = [0, 1].map(|n| {
                    let [x, y] = warps[n].source[at / channels];
                    naive::cubic(&frames[n], f64::from(x), f64::from(y), at % channels)
                });
                let exact = (a + (b - a) * fraction).clamp(0.0, 1.0);
                assert!((f64::from(*v) - exact).abs() <= 2.0 * SAMPLE_BOUND, "{v} {exact}");
            }
        }
    }
}

/// Positions are f32: half a unit in the last place of 8192 is 5e-4 px, a few of which add up, and
/// the fraction b of the distances' rounding in the weights.
#[test]
fn the_morphs_field_to_a_hundredth_of_a_pixel() {
    let mut random = Random::new(3);
    for (w, h, boost) in [(8192, 3, 0.0), (8192, 3, 4.0), (3, 4320, 4.0), (64, 48, 10.0)] {
        let place = |r: &mut Random| {
            let target = Point2::new(r.in_range(0.0, w as f64), r.in_range(0.0, h as f64));
            let moved = Vector2::new(5.0 * (0.01 * target.x).sin(), 3.0 * (0.02 * target.x).cos());
            EdgeFeature { source: target + moved, other: target, target }
        };
        let edges: Vec<Edge> = (0..60)
            .map(|k| {
                let a = place(&mut random);
                let mut b = place(&mut random);
                if k % 2 == 0 {
                    // A short one, as most are.
                    b.target = a.target + Vector2::new(random.signed(), random.signed()) * 12.0;
                    b.source = b.target + (a.source - a.target);
                }
                Edge { ends: [a, b], mean_fitness: (k % 3 == 0).then_some(0.1 + 0.01 * k as f64) }
            })
            .collect();
        let warp = morph_warp(&edges, [w, h], boost, 1);
        for k in (0..w * h).step_by(7) {
            let at = Point2::new((k % w) as f64 + 0.5, (k / w) as f64 + 0.5);
            let exact = naive::morph(&edges, at, boost).expect("there are edges");
            let found = Point2::from(warp.source[k]).cast::<f64>();
            assert!((found - exact).norm() < 0.01, "{at}: {found} {exact}");
        }
    }
}

/// A window's place as the tracker finds it, and as its equations have it in f64.
#[test]
fn tracked_windows_to_a_thousandth_of_a_pixel() {
    let options = RegistrationOptions::default();
    // Beyond the default precision, until the steps vanish.
    let parameters = KltParameters { epsilon_px: 1e-6, iterations: 300, ..(&options).into() };
    let mut tracker = Tracker::new(parameters);
    for print in [1.0, 2.0] {
        let swing = Swing { print, ..Swing::default() };
        let images = [3.0, 3.8].map(|t| swing.truth(1, t));
        let [a, b] = images.each_ref().map(|i| Frame::new(i.clone(), &options));
        let mut apart = Vec::new();
        for source in a.corners(&options) {
            let Some(found) = tracker.track(&a.pyramid, &b.pyramid, *source, *source) else {
                continue;
            };
            let radius = options.window_radius_px as isize;
            let margin = radius as f64 + 4.0;
            let inside = |p: &Point2<f64>| {
                let (w, h) = (swing.width as f64, swing.height as f64);
                p.x.min(p.y).min(w - p.x).min(h - p.y) > margin
            };
            if !inside(source) || !inside(&found.position) {
                continue;
            }
            let exact = lucas_kanade(&images, *source, found.position, radius);
            apart.push((found.position - exact).norm());
        }
        apart.sort_by(f64::total_cmp);
        let (median, worst) = (apart[apart.len() / 2], apart[apart.len() - 1]);
        println!("{} windows, print {print}: {median:.5} px, worst {worst:.5}", apart.len());
        assert!(apart.len() > 20 && median < 1e-4 && worst < 1e-3, "{median} {worst}");
    }
}

/// Lucas and Kanade's steps from a place until they rest, with the source window's gradients (Scharr's,
/// of the interpolated window).
fn lucas_kanade(
    [from, to]: &[Image; 2],
    source: Point2<f64>,
    start: Point2<f64>,
    radius: isize,
) -> Point2<f64> {
    let value = |image: &Image, p: Point2<f64>| naive::bilinear(image, p.x, p.y, 0);
    let places = (-radius..=radius).flat_map(|y| (-radius..=radius).map(move |x| (x, y)));
    let window: Vec<(Vector2<f64>, Vector2<f64>)> = places
        .map(|(x, y)| {
            let d = Vector2::new(x as f64, y as f64);
            (d, naive::scharr(|dx, dy| value(from, source + d + Vector2::new(dx, dy))))
        })
        .collect();
    let normal: Matrix2<f64> = window.iter().map(|(_, g)| g * g.transpose()).sum();
    let inverse = normal.try_inverse().expect("a corner");
    let mut target = start;
    for _ in 0..100 {
        let difference = |d: &Vector2<f64>| value(from, source + d) - value(to, target + d);
        let right: Vector2<f64> = window.iter().map(|(d, g)| g * difference(d)).sum();
        target += inverse * right;
    }
    target
}

/// A view refines only what it is blended from: to the bit as if it refined all of every camera.
/// The view that is blended from these whole images.
fn of_given(
    field: &LightField,
    target: &Camera,
    time_s: f64,
    options: &RenderOptions,
    images: Vec<Option<Arc<Synchronized>>>,
) -> Rendered {
    let images = GivenImages::filmed(images);
    let images = Images::Given(&images);
    let request = Request::new(Viewpoint::View(target), time_s, options);
    let request = Request { images, shape: images, ..request };
    render(field, &request, &Context::unattended()).unwrap()
}

#[test]
fn views_of_parts_and_of_whole_images() {
    let scene = Scene { board: Some([-1.5, -0.8]), ..Scene::default() };
    let folder = scene.film();
    let capture = open(&folder);
    let field = field_of(&capture, estimate(&capture));
    let (target, time_s) = (view(&scene.camera([0.021, 0.007, 0.1])), 1.6 * FRAME_S);
    for cameras in [1, 2, 3] {
        let mut options = RenderOptions { sync: SyncMethod::Refined, ..RenderOptions::default() };
        options.blend.cameras = cameras;
        let found = field.view(&target, time_s, &options).unwrap();
        let images = field.synchronized_all(time_s, &options, &Context::unattended()).unwrap();
        let whole = of_given(&field, &target, time_s, &options, images);
        assert!(found == whole, "{cameras} cameras");
        for (proxy, blend) in [
            (ProxyMethod::Depth, BlendMethod::Lumigraph),
            (ProxyMethod::Mesh, BlendMethod::SpaceTime),
            (ProxyMethod::Depth, BlendMethod::SpaceTime),
        ] {
            let mut options = options.clone();
            (options.proxy.method, options.blend.method) = (proxy, blend);
            let found = field.view(&target, time_s, &options).unwrap();
            let images = field.synchronized_all(time_s, &options, &Context::unattended()).unwrap();
            let whole = of_given(&field, &target, time_s, &options, images);
            assert!(found == whole, "{cameras} cameras, {proxy:?}, {blend:?}");
        }
    }
}

/// Every number, finite or not, has a value in a file.
#[test]
fn not_a_number_is_black_in_an_image_and_null_in_json() {
    let odd = [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, -0.1, 1.1, 0.5];
    let image = Image::from_data(6, 1, 1, odd.to_vec());
    for depth in [BitDepth::Eight, BitDepth::Sixteen] {
        let values: Vec<f64> = match Quantized::new(&image, None, depth).samples {
            Samples::Eight(raw) => raw.into_iter().map(|v| f64::from(v) / 255.0).collect(),
            Samples::Sixteen(raw) => raw.into_iter().map(|v| f64::from(v) / 65535.0).collect(),
        };
        assert_eq!(values[..5], [0.0, 1.0, 0.0, 0.0, 1.0]);
        assert!((values[5] - 0.5).abs() < 0.003);
    }
    let camera = CameraOffset {
        id: "cam0".into(),
        offset_s: Some(f64::NAN),
        std_err_s: Some(f64::INFINITY),
        ..CameraOffset::default()
    };
    let offsets = Offsets { reference: "cam1".into(), cameras: vec![camera] };
    let text = serde_json::to_string(&offsets).expect("JSON");
    let back: Offsets = serde_json::from_str(&text).expect("what was written is read");
    assert_eq!((back.cameras[0].offset_s, back.cameras[0].std_err_s), (None, None));
}
