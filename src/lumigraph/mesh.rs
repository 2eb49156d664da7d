//! The mesh proxy of §6: "a backplane based on the reconstructed 3D vertices. The plane is positioned and
//! oriented so that all the vertices are in the front. Finally, all the vertices (including the four corners
//! of the plane) are triangulated to create a 3D mesh."
//!
//! Beyond the paper: mismatched points are removed, and triangles that span a depth edge are replaced ([`DepthEdges`]).
//!
//! Known limit: a mesh is built for one view. In other views, it has gaps at depth edges.

use super::plane::{PlaneLoss, ProjectedPoint, fit_plane};
use super::rays::ViewBounds;
use crate::camera::Camera;
use crate::method::methods;
use nalgebra::{Point2, Point3, Vector3};
use serde::{Deserialize, Serialize};
use spade::handles::VertexHandle as Handle;
use spade::{DelaunayTriangulation, HasPosition, Triangulation};

/// A triangle mesh in world coordinates.
#[derive(Clone, Debug, PartialEq)]
pub struct Mesh {
    /// Positions of the vertices in the world, metres.
    pub vertices: Vec<Point3<f64>>,
    /// Three vertex indices per triangle, in either orientation.
    pub triangles: Vec<[u32; 3]>,
}

/// Treatment of mesh triangles whose vertices lie on two surfaces at different depths.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum DepthEdges {
    /// The triangle keeps its vertices, and stretches from one surface to the other, as in the paper.
    Stretch,
    /// The whole triangle gets the depth of the farther surface.
    Back,
    /// The whole triangle gets the depth of the nearer surface. Feature points lie inside an object's outline, so that
    /// such triangles extend the object's surface up to its outline.
    #[default]
    Front,
    /// The triangle is cut halfway between the two surfaces. Each part gets the depth of its own surface.
    Cut,
}

methods!(DepthEdges {
    Stretch = "stretch": "The triangle stretches from one surface to the other, as in the paper",
    Back = "back": "The triangle lies on the surface behind",
    Front = "front": "The triangle lies on the surface in front",
    Cut = "cut": "The triangle is cut in the middle between the two surfaces",
});

/// Difference between the largest and the smallest inverse depth of a triangle's vertices above which the triangle
/// spans a depth edge, as a fraction of the largest.
const EDGE_FRACTION: f64 = 0.1;
/// Maximum length of a triangle's longest side, pixels, for [`DepthEdges`] to apply. A larger triangle is always
/// stretched, since the object's outline may be anywhere in it.
const MAX_EDGE_PX: f64 = 24.0;
/// Maximum difference between the inverse depths of a point and of a neighbour that supports this point, as a fraction
/// of the point's inverse depth. Points with too few supporting neighbours are mismatches.
const SUPPORT_FRACTION: f64 = 0.05;
/// Minimum number of neighbours that must support a point, so that the point becomes a vertex of the mesh. Neighbours
/// are at most two edges of the triangulation away.
const MIN_SUPPORT: usize = 2;
/// Distance of the mesh's corners outside the field of view, as a fraction of the field of view's width or height.
const MARGIN: f64 = 0.05;
/// Side of the square image cells in each of which only the nearest point becomes a vertex, pixels.
const CELL_PX: f64 = 0.5;
/// Weight of a point in front of the back plane in the fit of that plane. A point behind the plane has the weight 1.
const FRONT_WEIGHT: f64 = 0.02;
/// Number of corners of the back plane, a rectangle behind all points.
const CORNERS: usize = 4;
/// Factor by which the back plane's inverse depth is multiplied, so that the plane is slightly behind all vertices.
const BACK_FACTOR: f64 = 0.999;

/// A vertex of the Delaunay triangulation of points in the view's image.
struct MeshSite {
    position: spade::Point2<f64>,
    index: u32,
}

impl HasPosition for MeshSite {
    type Scalar = f64;
    fn position(&self) -> spade::Point2<f64> {
        self.position
    }
}

type MeshSites = DelaunayTriangulation<MeshSite>;

impl Mesh {
    /// Builds a mesh from points in the world, metres. The mesh covers the whole view of `target`.
    ///
    /// A point is ignored if it is behind the camera, outside the view, not finite, or not supported by its neighbours.
    /// Points may be duplicate or collinear. `None` if no point remains, or if no ray of the view can be computed.
    pub fn build(points: &[Point3<f64>], target: &Camera, depth_edges: DepthEdges) -> Option<Self> {
        let bounds = ViewBounds::of(target)?.enlarged(MARGIN);
        let focal = target.focal_px();
        let mut all = projected(points, target, &bounds, focal);
        let corners = bounds.corners();
        let mut sites = triangulated(&all, &corners, focal);
        drop_unsupported(&mut all, &mut sites);
        let plane = back_plane(&all, &bounds)?;
        all.extend(corners.map(|at| ProjectedPoint {
            at,
            inverse_depth: plane.dot(&Vector3::new(at.x, at.y, 1.0)),
        }));
        let mut builder = MeshBuilder { vertices: all, triangles: Vec::new() };
        for face in sites.inner_faces() {
            let triangle = face.vertices().map(|v| v.data().index);
            builder.add(triangle, focal, depth_edges);
        }
        let world_from_cam = target.cam_from_world.inverse();
        let vertices = builder
            .vertices
            .iter()
            .map(|s| world_from_cam * Point3::from(s.ray() / s.inverse_depth))
            .collect();
        Some(Self { vertices, triangles: builder.triangles })
    }
}

/// Projects world points into the camera `target`, and drops points outside of `bounds`. Of several points in one
/// square image cell with the side [`CELL_PX`], only the nearest is returned. The result is sorted by cell. `focal` is
/// the focal length, pixels.
fn projected(
    points: &[Point3<f64>],
    target: &Camera,
    bounds: &ViewBounds,
    focal: f64,
) -> Vec<ProjectedPoint> {
    let cell = |at: &Point2<f64>| {
        let size = CELL_PX / focal;
        ((at.y / size).floor() as i64, (at.x / size).floor() as i64)
    };
    let mut projections: Vec<((i64, i64), ProjectedPoint)> = points
        .iter()
        .filter_map(|point| {
            let projection = ProjectedPoint::new(point, target, bounds)?;
            // A point exactly at a corner is dropped, since the corner itself is a vertex.
            let is_corner = bounds.corners().contains(&projection.at);
            (!is_corner).then(|| (cell(&projection.at), projection))
        })
        .collect();
    projections.sort_unstable_by(|(a_cell, a), (b_cell, b)| {
        let near_first = b.inverse_depth.total_cmp(&a.inverse_depth);
        let position = a.at.y.total_cmp(&b.at.y).then(a.at.x.total_cmp(&b.at.x));
        a_cell.cmp(b_cell).then(near_first).then(position)
    });
    projections.dedup_by_key(|(cell, _)| *cell);
    projections.into_iter().map(|(_, s)| s).collect()
}

/// Computes the Delaunay triangulation of the projected points and the mesh's `corners`, with coordinates in pixels. In
/// the triangulation's indices, the corners follow the points. Of several points at one position, only one becomes a
/// vertex. `focal` is the focal length, pixels.
fn triangulated(projections: &[ProjectedPoint], corners: &[Point2<f64>], focal: f64) -> MeshSites {
    // The library spade accepts only coordinates that are 0 or have a magnitude in [2⁻¹⁴², 2²⁰¹]. Magnitudes below a
    // millionth of a pixel are rounded to 0.
    let coordinate = |v: f64| if (v * focal).abs() < 1e-6 { 0.0 } else { v * focal };
    let positions = projections.iter().map(|s| &s.at).chain(corners).enumerate();
    let sites = positions.map(|(index, at)| {
        let position = spade::Point2::new(coordinate(at.x), coordinate(at.y));
        MeshSite { position, index: index as u32 }
    });
    MeshSites::bulk_load(sites.collect()).unwrap_or_default()
}

/// Removes points that have fewer than [`MIN_SUPPORT`] supporting neighbours, from the list and from the triangulation.
/// Removes nothing if there are fewer than four points, or if no point is supported.
fn drop_unsupported(projections: &mut Vec<ProjectedPoint>, sites: &mut MeshSites) {
    let count = projections.len();
    if count < 4 {
        return;
    }
    let points = || sites.vertices().filter(|s| (s.data().index as usize) < count);
    let unsupported: Vec<_> =
        points().filter(|s| !has_support(projections, s)).map(|s| s.fix()).collect();
    if unsupported.len() == points().count() {
        return;
    }
    // Sites are removed in descending order, because a removal gives the removed site's handle to the last site.
    for site in unsupported.into_iter().rev() {
        sites.remove(site);
    }
    // Of several points at one position, only one is in the triangulation. The others are removed from the list too.
    let mut is_kept = vec![false; count];
    for site in sites.vertices() {
        if let Some(is_kept) = is_kept.get_mut(site.data().index as usize) {
            *is_kept = true;
        }
    }
    let mut kept = Vec::with_capacity(count);
    // The indices of the corners follow the indices of the points.
    let mut renumbered: Vec<u32> = is_kept
        .iter()
        .zip(&*projections)
        .map(|(&is_kept, point)| {
            kept.extend(is_kept.then_some(*point));
            kept.len().saturating_sub(1) as u32
        })
        .collect();
    renumbered.extend((0..CORNERS).map(|corner| (kept.len() + corner) as u32));
    for handle in sites.fixed_vertices() {
        let site = sites.vertex_data_mut(handle);
        site.index = renumbered[site.index as usize];
    }
    *projections = kept;
}

/// Returns the vertices that share an edge with `site`.
fn neighbors(site: Handle<MeshSite>) -> impl Iterator<Item = Handle<MeshSite>> {
    site.out_edges().map(|edge| edge.to())
}

/// Returns whether a vertex is supported: at least [`MIN_SUPPORT`] vertices, at most two edges away, have a similar
/// inverse depth.
fn has_support(projections: &[ProjectedPoint], site: &Handle<MeshSite>) -> bool {
    let index = |s: &Handle<MeshSite>| s.data().index as usize;
    let own = projections[index(site)].inverse_depth;
    let agrees = |k: &usize| (own - projections[*k].inverse_depth).abs() <= SUPPORT_FRACTION * own;
    // The corners have no depth yet, and are skipped.
    let around = |s| neighbors(s).filter(|s| index(s) < projections.len());
    let near = around(*site).map(|s| index(&s)).filter(agrees).count();
    if near >= MIN_SUPPORT {
        return true;
    }
    let mut all: Vec<usize> = around(*site)
        .chain(around(*site).flat_map(around))
        .filter(|s| s.fix() != site.fix())
        .map(|s| index(&s))
        .filter(agrees)
        .collect();
    all.sort_unstable();
    all.dedup();
    all.len() >= MIN_SUPPORT
}

/// Fits the back plane to the farthest points, and moves it behind all points. Returns the vector g of the plane, with
/// `1/z = g · (x, y, 1)` (see [`super::plane`]). `None` without points.
fn back_plane(projections: &[ProjectedPoint], bounds: &ViewBounds) -> Option<Vector3<f64>> {
    let g = fit_plane(projections, PlaneLoss::Behind(FRONT_WEIGHT), bounds)?;
    // The plane's inverse depth is positive in the whole view, so the ratio is positive too.
    let behind = projections.iter().map(|s| s.inverse_depth / g.dot(&s.ray())).fold(1.0, f64::min);
    Some(g * (behind * BACK_FACTOR))
}

/// A mesh under construction. Its vertices are given by their projections into the view, with inverse depths.
struct MeshBuilder {
    vertices: Vec<ProjectedPoint>,
    triangles: Vec<[u32; 3]>,
}

impl MeshBuilder {
    /// Appends a vertex at the position `at` on the plane z = 1, with an inverse depth in 1/m. Returns the vertex's
    /// index.
    fn vertex(&mut self, at: Point2<f64>, inverse_depth: f64) -> u32 {
        self.vertices.push(ProjectedPoint { at, inverse_depth });
        (self.vertices.len() - 1) as u32
    }

    /// Adds a triangle, given by three vertex indices. A triangle that spans a depth edge is replaced as [`DepthEdges`]
    /// describes. `focal` is the focal length, pixels.
    fn add(&mut self, triangle: [u32; 3], focal: f64, depth_edges: DepthEdges) {
        // The vertices are sorted with the nearest first.
        let mut v = triangle.map(|k| (k, self.vertices[k as usize]));
        v.sort_by(|a, b| b.1.inverse_depth.total_cmp(&a.1.inverse_depth));
        let [a, b, c] = v.map(|(_, s)| s.inverse_depth);
        let at = v.map(|(_, s)| s.at);
        let longest_px = || {
            let sides = [at[0] - at[1], at[1] - at[2], at[2] - at[0]];
            focal * sides.iter().map(|s| s.norm()).fold(0.0, f64::max)
        };
        if depth_edges == DepthEdges::Stretch
            || a - c <= EDGE_FRACTION * a
            || longest_px() > MAX_EDGE_PX
        {
            self.triangles.push(triangle);
            return;
        }
        // Either one vertex is in front of the other two, or two are in front of the third.
        let one_in_front = a - b > b - c;
        let (front, back) = if one_in_front { (a, 0.5 * (b + c)) } else { (0.5 * (a + b), c) };
        match depth_edges {
            DepthEdges::Stretch => {}
            DepthEdges::Back => self.flat(at, back),
            DepthEdges::Front => self.flat(at, front),
            DepthEdges::Cut => {
                let [alone, p, q] = if one_in_front { at } else { [at[2], at[0], at[1]] };
                let (own, other) = if one_in_front { (front, back) } else { (back, front) };
                let (half_p, half_q) = (nalgebra::center(&alone, &p), nalgebra::center(&alone, &q));
                self.flat([alone, half_p, half_q], own);
                self.flat([half_p, p, q], other);
                self.flat([half_p, q, half_q], other);
            }
        }
    }

    /// Adds a triangle with vertices at the positions `at` on the plane z = 1. All three have the same inverse depth,
    /// 1/m.
    fn flat(&mut self, at: [Point2<f64>; 3], inverse_depth: f64) {
        let triangle = at.map(|at| self.vertex(at, inverse_depth));
        self.triangles.push(triangle);
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::Random;
    use super::super::{Proxy, tests::assert_covered};
    use super::*;
    use crate::camera::tests::pinhole_at;

    const ALL: [DepthEdges; 4] =
        [DepthEdges::Stretch, DepthEdges::Back, DepthEdges::Front, DepthEdges::Cut];

    fn on_ray(camera: &Camera, x: f64, y: f64, z: f64) -> Point3<f64> {
        camera.center() + camera.ray_world(&Point2::new(x, y)).unwrap() * z
    }

    #[test]
    fn points_of_a_plane_give_back_the_plane() {
        let camera = pinhole_at([0.2, 0.1, -0.3]);
        let mut random = Random::new(11);
        let points: Vec<_> = (0..300)
            .map(|_| {
                let (x, y) = (random.in_range(0.0, 640.0), random.in_range(0.0, 480.0));
                on_ray(&camera, x, y, 2.0)
            })
            .collect();
        for depth_edges in ALL {
            let mesh = Mesh::build(&points, &camera, depth_edges).unwrap();
            let map = Proxy::Mesh(mesh).depth_map(&camera);
            assert!(map.data().iter().all(|z| (z - 2.0).abs() < 0.01));
        }
    }

    #[test]
    fn mismatches_are_dropped_and_a_foreground_object_stays() {
        let camera = pinhole_at([0.0; 3]);
        let mut points = Vec::new();
        for y in (12..480).step_by(16) {
            for x in (4..640).step_by(16) {
                let front = (200..300).contains(&x) && (200..300).contains(&y);
                let z = if front { 1.0 } else { 3.0 };
                points.push(on_ray(&camera, f64::from(x), f64::from(y), z));
            }
        }
        points.push(on_ray(&camera, 500.0, 100.5, 0.4));
        points.push(on_ray(&camera, 100.0, 400.0, 20.0));
        // The vertices at x = 292 are the last on the nearer surface, and those at x = 308 the first on the farther
        // surface. Halfway between them, a stretched triangle has the mean of their inverse depths.
        let expected = [
            (DepthEdges::Stretch, 1.5, 1.5),
            (DepthEdges::Back, 3.0, 3.0),
            (DepthEdges::Front, 1.0, 1.0),
            (DepthEdges::Cut, 1.0, 3.0),
        ];
        for (depth_edges, before, after) in expected {
            let mesh = Mesh::build(&points, &camera, depth_edges).unwrap();
            let map = Proxy::Mesh(mesh).depth_map(&camera);
            let at = |x: usize, y: usize| f64::from(map.row(y)[x]);
            assert!((at(500, 100) - 3.0).abs() < 0.05 && (at(100, 400) - 3.0).abs() < 0.05);
            assert!((at(250, 250) - 1.0).abs() < 0.01 && (at(320, 250) - 3.0).abs() < 0.01);
            assert!((at(298, 250) - before).abs() < 0.2, "{depth_edges:?} {}", at(298, 250));
            assert!((at(301, 250) - after).abs() < 0.2, "{depth_edges:?} {}", at(301, 250));
        }
    }

    #[test]
    fn every_vertex_is_in_front_of_the_back_plane() {
        let camera = pinhole_at([0.0; 3]);
        let mut random = Random::new(12);
        let points: Vec<_> = (0..200)
            .map(|_| {
                let (x, y) = (random.in_range(50.0, 590.0), random.in_range(50.0, 430.0));
                on_ray(&camera, x, y, random.in_range(1.0, 5.0))
            })
            .collect();
        let bounds = ViewBounds::of(&camera).unwrap();
        let projections = projected(&points, &camera, &bounds, camera.focal_px());
        assert_eq!(projections.len(), 200);
        let g = back_plane(&projections, &bounds).unwrap();
        assert!(projections.iter().all(|s| g.dot(&s.ray()) < s.inverse_depth));
        assert!(bounds.corners().iter().all(|c| g.dot(&Vector3::new(c.x, c.y, 1.0)) > 0.0));
    }

    #[test]
    fn any_points_cover_the_whole_view() {
        let camera = pinhole_at([0.0; 3]);
        let line: Vec<_> =
            (0..9).map(|k| on_ray(&camera, 70.0 * f64::from(k), 240.0, 2.0)).collect();
        let cases = [
            vec![on_ray(&camera, 320.0, 240.0, 2.0)],
            vec![on_ray(&camera, 320.0, 240.0, 2.0); 7],
            line,
            vec![on_ray(&camera, 0.0, 0.0, 1e-3), on_ray(&camera, 640.0, 480.0, 1e9)],
            vec![on_ray(&camera, 100.0, 100.0, 1.0), on_ray(&camera, 100.0 + 1e-9, 100.0, 5.0)],
        ];
        for (case, points) in cases.iter().enumerate() {
            for depth_edges in ALL {
                println!("case {case}, {depth_edges:?}");
                let mesh = Mesh::build(points, &camera, depth_edges).unwrap();
                assert_covered(&Proxy::Mesh(mesh).depth_map(&camera));
            }
        }
    }

    #[test]
    fn odd_points_never_panic() {
        let camera = pinhole_at([0.0; 3]);
        let mut random = Random::new(14);
        let odd = [0.0, -0.0, 1e-300, -1e-320, 1e300, f64::INFINITY, f64::NAN, 1e-9, 0.3, 1.0];
        let mut built = 0;
        for _ in 0..500 {
            let count = (random.unit() * 30.0) as usize;
            let points: Vec<_> = (0..count)
                .map(|_| {
                    let mut pick = || odd[(random.unit() * odd.len() as f64) as usize];
                    let (x, y, z) = (pick(), pick(), pick());
                    // A third of the points are on a coarse grid, so that many are collinear and cocircular.
                    match (random.unit() * 3.0) as usize {
                        0 => Point3::new(x, y, z),
                        1 => Point3::new(x, y, 2.0),
                        _ => {
                            let grid = |r: &mut Random| (r.unit() * 5.0).floor() * 0.1 - 0.2;
                            Point3::new(grid(&mut random), grid(&mut random), 1.0)
                        }
                    }
                })
                .collect();
            for depth_edges in ALL {
                if let Some(mesh) = Mesh::build(&points, &camera, depth_edges) {
                    built += 1;
                    assert!(mesh.vertices.iter().all(|v| v.iter().all(|c| c.is_finite())));
                }
            }
        }
        assert!(built > 1000);
    }

    #[test]
    fn no_point_in_the_view_gives_none() {
        let camera = pinhole_at([0.0; 3]);
        let build = |p: &[Point3<f64>]| Mesh::build(p, &camera, DepthEdges::default());
        assert_eq!(build(&[]), None);
        assert_eq!(build(&[Point3::new(0.0, 0.0, -1.0), Point3::new(f64::NAN, 0.0, 1.0)]), None);
        assert_eq!(build(&[Point3::new(9.0, 0.0, 1.0)]), None);
    }

    #[test]
    fn the_order_of_the_points_does_not_matter() {
        let camera = pinhole_at([0.0; 3]);
        let mut random = Random::new(13);
        let mut points: Vec<_> = (0..100)
            .map(|_| {
                let (x, y) = (random.in_range(0.0, 640.0), random.in_range(0.0, 480.0));
                on_ray(&camera, x, y, random.in_range(1.0, 1.2))
            })
            .collect();
        let forward = Mesh::build(&points, &camera, DepthEdges::default());
        points.reverse();
        assert_eq!(Mesh::build(&points, &camera, DepthEdges::default()), forward);
    }
}
