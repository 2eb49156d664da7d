//! Figs. 16 and 17: views over a plane and over the mesh.

use crate::Error;
use crate::draw::{line, magnified};
use crate::page::{Page, Panel};
use crate::scene::{Scene, center_of, over_plane};
use nalgebra::{Isometry3, Point2, Point3, Translation3, UnitQuaternion, Vector3};
use stlfr::camera::Camera;
use stlfr::interpolation::SyncMethod;
use stlfr::light_field::{Context, GivenImages, Images, Request, Viewpoint, render};
use stlfr::lumigraph::{DepthMap, Proxy};
use stlfr::options::{ProxyMethod, RenderOptions};
use stlfr::raster::Image;

/// From where a proxy is drawn: turned to the side and down, degrees, and farther away by this share of the
/// distance.
const YAW_DEG: f64 = 24.0;
const PITCH_DEG: f64 = 7.0;
const FARTHER: f64 = 0.4;
/// Depth of the point that it is turned about, as a share of the focus.
const PIVOT_SHARE: f64 = 1.5;
/// Distance of the samples of a depth map that is drawn as a surface, pixels.
const STEP_PX: usize = 8;
/// A triangle between depths that differ by more than this share is no surface.
const JUMP_SHARE: f32 = 0.08;

/// The two proxies, with their letters.
fn ways(focus_m: f64) -> [(RenderOptions, &'static str); 2] {
    let plane = over_plane(focus_m, SyncMethod::Refined);
    let mut mesh = plane.clone();
    mesh.proxy.method = ProxyMethod::Mesh;
    [(plane, "(a) Plane proxy"), (mesh, "(b) 3D mesh proxy")]
}

/// The book over both proxies, and these.
pub fn figure_16() -> Result<Page, Error> {
    const SIZE_PX: [usize; 2] = [320, 270];
    let scene = Scene::with_true_clocks("book")?;
    let truth = scene.true_view(0, "side")?;
    let focus_m = truth.focus_m();
    let part = truth.around_moving(SIZE_PX);
    let from = oblique(&truth.camera, PIVOT_SHARE * focus_m);
    let time_s = scene.instants_s[0];
    let (mut views, mut shapes) = (Vec::new(), Vec::new());
    for (options, title) in ways(focus_m) {
        let image = scene.view(&truth.camera, time_s, &options)?;
        views.push(Panel::new(magnified(&image, part, 2), title, truth.both_scores(&image)));
        let shape = match scene.field.proxy(&truth.camera, time_s, &options)? {
            Proxy::Mesh(mesh) => Shape { vertices: mesh.vertices, triangles: mesh.triangles },
            proxy => Shape::of_depths(&proxy.depth_map(&truth.camera), &truth.camera, 4 * STEP_PX),
        };
        shapes.push(Panel::new(shape.drawn(&from), "", ""));
    }
    views.push(Panel::new(magnified(&truth.image, part, 2), "Truth", ""));
    let shape = Shape::of_depths(&truth.depth, &truth.camera, STEP_PX);
    shapes.push(Panel::new(shape.drawn(&from), "", ""));
    Ok(Page {
        rows: vec![views, shapes],
        caption: "Fig. 16. Top row: the book, synthesized 12 cm beside the middle of the array. Bottom row: \
                  the proxy, drawn from the side. (a) A plane. (b) The reconstructed 3D mesh."
            .to_owned(),
    })
}

/// The head from two angles: as two cameras of the array see it, blended from the others.
pub fn figure_17() -> Result<Page, Error> {
    const SIZE_PX: [usize; 2] = [230, 260];
    let scene = Scene::with_true_clocks("head")?;
    let time_s = scene.instants_s[0];
    let mut rows = Vec::new();
    for (id, place) in [("cam1", "15 cm to the left"), ("cam6", "15 cm to the right")] {
        let truth = scene.true_view(0, id)?;
        let own = scene.capture.camera_index(id).ok_or("lacks a camera")?;
        let part = truth.top_of_moving(SIZE_PX);
        let mut row = Vec::new();
        for (options, title) in ways(truth.focus_m()) {
            let mut images =
                scene.field.synchronized_all(time_s, &options, &Context::unattended())?;
            images[own] = None;
            let images = GivenImages::filmed(images);
            let request = Request::new(Viewpoint::View(&truth.camera), time_s, &options);
            let request = Request { images: Images::Given(&images), ..request };
            let image = render(&scene.field, &request, &Context::unattended())?.image;
            row.push(Panel::new(magnified(&image, part, 2), title, truth.both_scores(&image)));
        }
        row.push(Panel::new(magnified(&truth.image, part, 2), "Truth", place));
        rows.push(row);
    }
    Ok(Page {
        rows,
        caption: "Fig. 17. A face from two angles, where cameras of the array stand that do not take part in \
                  the blend. (a) A plane in focus on the face. (b) The reconstructed 3D mesh."
            .to_owned(),
    })
}

/// A camera that looks at a point before the view from aside.
fn oblique(view: &Camera, pivot_m: f64) -> Camera {
    let turn = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), PITCH_DEG.to_radians())
        * UnitQuaternion::from_axis_angle(&Vector3::y_axis(), YAW_DEG.to_radians());
    let back = Translation3::new(0.0, 0.0, pivot_m * (1.0 + FARTHER));
    let to_pivot = Translation3::new(0.0, 0.0, -pivot_m);
    let oblique_from_view = back * Isometry3::from_parts(Translation3::identity(), turn) * to_pivot;
    Camera { cam_from_world: oblique_from_view * view.cam_from_world, ..view.clone() }
}

/// A surface to draw.
struct Shape {
    vertices: Vec<Point3<f64>>,
    triangles: Vec<[u32; 3]>,
}

impl Shape {
    /// The surface that a view's depths are, cut where they jump.
    fn of_depths(depth: &DepthMap, view: &Camera, step: usize) -> Self {
        let across = |size: usize| (0..size).step_by(step).chain([size - 1]).collect::<Vec<_>>();
        let (xs, ys) = (across(depth.width()), across(depth.height()));
        let (mut vertices, mut depths, mut triangles) = (Vec::new(), Vec::new(), Vec::new());
        for &y in &ys {
            for &x in &xs {
                let z = depth.row(y)[x];
                let ray = view.ray_world(&center_of(x, y)).unwrap_or_else(Vector3::zeros);
                vertices.push(view.center() + ray * f64::from(z));
                depths.push(z);
            }
        }
        let columns = xs.len();
        for k in 0..(ys.len() - 1) * columns {
            if k % columns + 1 == columns {
                continue;
            }
            for triangle in [[k, k + 1, k + columns], [k + 1, k + columns + 1, k + columns]] {
                let z = triangle.map(|v| depths[v]);
                let (near, far) = (z[0].min(z[1]).min(z[2]), z[0].max(z[1]).max(z[2]));
                if far - near < JUMP_SHARE * near {
                    triangles.push(triangle.map(|v| v as u32));
                }
            }
        }
        Self { vertices, triangles }
    }

    /// The surface as the camera sees it: shaded by its slope, with the triangles' sides, from far to near.
    fn drawn(&self, camera: &Camera) -> Image {
        let mut image = Image::filled(camera.width, camera.height, 3, 1.0);
        let points: Vec<Point3<f64>> =
            self.vertices.iter().map(|v| camera.cam_from_world * v).collect();
        let mut triangles = self.triangles.clone();
        triangles.retain(|t| t.iter().all(|v| points[*v as usize].z > 0.05));
        let far = |t: &[u32; 3]| t.iter().map(|v| points[*v as usize].z).sum::<f64>();
        triangles.sort_by(|a, b| far(b).total_cmp(&far(a)));
        for triangle in &triangles {
            let corners = triangle.map(|v| points[v as usize]);
            let normal = (corners[1] - corners[0]).cross(&(corners[2] - corners[0]));
            let light = Vector3::new(-0.5, -0.6, -0.7).normalize();
            let lit = normal.try_normalize(0.0).map_or(0.0, |n| n.dot(&light).abs());
            let pixels = corners.map(|p| camera.project_cam(&p));
            let [Some(a), Some(b), Some(c)] = pixels else { continue };
            let shade = (0.35 + 0.6 * lit) as f32;
            fill(&mut image, [a, b, c], [0.95 * shade, 0.97 * shade, shade]);
            for ends in [[a, b], [b, c], [c, a]] {
                line(&mut image, ends, [0.5 * shade, 0.5 * shade, 0.6 * shade], 0.3);
            }
        }
        image
    }
}

/// Fills a triangle.
fn fill(image: &mut Image, [a, b, c]: [Point2<f64>; 3], color: [f32; 3]) {
    let range = |v: [f64; 3], size: usize| {
        let low = v.iter().copied().fold(f64::INFINITY, f64::min).clamp(0.0, size as f64);
        let high = v.iter().copied().fold(0.0, f64::max).clamp(0.0, size as f64);
        low as usize..high.ceil() as usize
    };
    let side = |p: Point2<f64>, q: Point2<f64>, r: Point2<f64>| (q - p).perp(&(r - p));
    let area = side(a, b, c);
    let width = image.width();
    for y in range([a.y, b.y, c.y], image.height()) {
        for x in range([a.x, b.x, c.x], width) {
            let p = center_of(x, y);
            let inside = [side(a, b, p), side(b, c, p), side(c, a, p)];
            if inside.iter().all(|s| s * area >= 0.0) {
                let at = (y * width + x) * 3;
                image.data_mut()[at..at + 3].copy_from_slice(&color);
            }
        }
    }
}
