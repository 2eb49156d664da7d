//! Rasterization of triangles to a depth map, for every lens model (homogeneous rasterization, Olano and Greer 1997).
//!
//! The vertices a, b, c of a triangle are vectors in the camera's frame. The ray r = (x, y, 1) of a pixel hits the
//! triangle if r · (b × c), r · (c × a) and r · (a × b) have the same sign. The depth z at the pixel is given by
//! `1/z = g · r`, with a vector g that describes the triangle's plane. Nothing is divided by a vertex's depth, so that
//! vertices behind the camera need no clipping.
//!
//! If two triangles share an edge, their products for this edge are equal except for the sign. A ray through the edge
//! then hits both triangles, so that a mesh has no cracks. Of all triangles that a ray hits, the nearest one counts.

use super::depth_map::DepthMap;
use super::rays::RayRow;
use crate::camera::Camera;
use crate::simd::multiversion;
use nalgebra::{Point2, Vector3};
use rayon::prelude::*;
use std::ops::Range;

/// Number of image rows that one parallel task rasterizes.
const BAND_ROWS: usize = 16;
/// Tolerance of the test whether a ray r hits a triangle. The products r · (a × b), with unit vectors a and b towards
/// two vertices, may be negative by this amount. A ray that passes up to about 1e-8 px outside an edge thus still hits
/// the triangle.
const ON_EDGE: f64 = 1e-11;
/// Minimum triple product of the unit vectors from the camera to a triangle's vertices. It is about twice the
/// triangle's solid angle in sr. The depths of a smaller triangle would be rounding noise.
const MIN_VOLUME: f64 = 1e-15;
/// Depth of the near clipping plane, as a fraction of the depth of the triangle's nearest vertex in front of the
/// camera.
const NEAR_FRACTION: f64 = 1e-4;
/// Number of neighbouring pixels that are tested against a triangle at once (SIMD).
const WORD_PX: usize = 4;
/// Number of segments into which each edge of a triangle is divided to find the triangle's bounding box in an image
/// with lens distortion.
const BEND_STEPS: usize = 8;

/// A triangle in a camera's frame, prepared for rasterization.
struct ProjectedTriangle {
    /// Normals of the planes through the camera's centre and each edge. The normals point to the inside of the
    /// triangle.
    edges: [Vector3<f64>; 3],
    /// Vector g of the triangle's plane: on the ray r = (x, y, 1), the inverse depth is 1/z = g · r, in 1/m.
    g: Vector3<f64>,
    /// Image columns of the triangle's bounding box.
    columns: Range<usize>,
    /// Image rows of the triangle's bounding box.
    rows: Range<usize>,
}

/// Computes a depth map of triangles: the depth of the nearest triangle at each pixel's centre, metres. `points` are in
/// the camera's frame, metres. A triangle consists of three indices of points.
///
/// A triangle is skipped if it is seen edge-on, has no area, or has a vertex that is not finite or not in `points`.
pub(super) fn rasterize(
    points: &[Vector3<f64>],
    triangles: &[[u32; 3]],
    camera: &Camera,
) -> DepthMap {
    let projected: Vec<ProjectedTriangle> =
        triangles.par_iter().filter_map(|t| project(points, t, camera)).collect();
    let mut in_bands = vec![Vec::new(); camera.height.div_ceil(BAND_ROWS)];
    for t in &projected {
        // `rows` is not empty.
        let bands = t.rows.start / BAND_ROWS..=(t.rows.end - 1) / BAND_ROWS;
        in_bands[bands].iter_mut().for_each(|band| band.push(t));
    }
    let mut depths = vec![0.0; camera.width * camera.height];
    depths.par_chunks_mut(BAND_ROWS * camera.width).zip(&in_bands).enumerate().for_each_init(
        || DepthBand::new(camera),
        |band, (index, (depths, triangles))| {
            band.set(index * BAND_ROWS);
            draw(triangles, band);
            invert(&band.nearest, depths);
        },
    );
    DepthMap::from_depths(camera.width, camera.height, depths)
}

multiversion! {
    /// Converts inverse depths, 1/m, to depths, metres. An inverse depth of 0 becomes NaN.
    fn invert(inverse: &[f64], depths: &mut [f32]) = invert_by
}

#[inline(always)]
fn invert_by(inverse: &[f64], depths: &mut [f32]) {
    for (depth, &inverse) in depths.iter_mut().zip(inverse) {
        let own = (1.0 / inverse) as f32;
        *depth = if inverse > 0.0 { own } else { f32::NAN };
    }
}

/// Prepares a triangle, given by three indices of `points`, for rasterization. `None` if it is degenerate or outside
/// the image.
fn project(
    points: &[Vector3<f64>],
    triangle: &[u32; 3],
    camera: &Camera,
) -> Option<ProjectedTriangle> {
    let mut v = [Vector3::zeros(); 3];
    for (v, &index) in v.iter_mut().zip(triangle) {
        *v = *points.get(index as usize)?;
        if !v.iter().all(|x| x.is_finite()) {
            return None;
        }
    }
    // The hit test uses unit vectors. Otherwise, the rounding of far vertices would be larger than near vertices.
    let lengths = v.map(|p| p.norm());
    let unit = [v[0] / lengths[0], v[1] / lengths[1], v[2] / lengths[2]];
    let mut edges = [unit[1].cross(&unit[2]), unit[2].cross(&unit[0]), unit[0].cross(&unit[1])];
    let mut volume = unit[0].dot(&edges[0]);
    // The negated comparison also rejects NaN, which results from a vertex at the camera's centre.
    if !(volume.abs() > MIN_VOLUME) {
        return None;
    }
    if volume < 0.0 {
        edges = edges.map(|e| -e);
        volume = -volume;
    }
    let g = (edges[0] / lengths[0] + edges[1] / lengths[1] + edges[2] / lengths[2]) / volume;
    let (columns, rows) = image_box(&v, camera)?;
    Some(ProjectedTriangle { edges, g, columns, rows })
}

/// Depth buffer of a band of neighbouring image rows.
struct DepthBand<'a> {
    first_row: usize,
    rays: Vec<RayRow<'a>>,
    /// Inverse depth of the nearest triangle at each pixel, 1/m, row by row; 0 without a triangle.
    nearest: Vec<f64>,
}

impl<'a> DepthBand<'a> {
    fn new(camera: &'a Camera) -> Self {
        let rows = BAND_ROWS.min(camera.height);
        let rays = (0..rows).map(|_| RayRow::new(camera)).collect();
        Self { first_row: 0, rays, nearest: vec![0.0; rows * camera.width] }
    }

    /// Moves the band to the rows that start at `first_row`, computes their rays, and clears the buffer.
    fn set(&mut self, first_row: usize) {
        self.first_row = first_row;
        self.rays.iter_mut().enumerate().for_each(|(k, rays)| rays.set(first_row + k));
        self.nearest.fill(0.0);
    }
}

multiversion! {
    /// Draws triangles into the depth buffer `band`.
    fn draw(triangles: &[&ProjectedTriangle], band: &mut DepthBand) = draw_by
}

#[inline(always)]
fn draw_by(triangles: &[&ProjectedTriangle], band: &mut DepthBand) {
    for t in triangles {
        let from = t.rows.start.max(band.first_row) - band.first_row;
        let until = t.rows.end.min(band.first_row + band.rays.len()) - band.first_row;
        for (row, rays) in band.rays[from..until].iter().enumerate() {
            let width = rays.x.len();
            let nearest = &mut band.nearest[(from + row) * width..][..width];
            t.draw_row(rays, nearest);
        }
    }
}

impl ProjectedTriangle {
    /// Draws one image row of the triangle into `nearest`, the row's inverse depths.
    #[inline(always)]
    fn draw_row(&self, rays: &RayRow, nearest: &mut [f64]) {
        let columns = self.columns.clone();
        let (xs, ys) = (&rays.x[columns.clone()], &rays.y[columns.clone()]);
        let nearest = &mut nearest[columns];
        // Words of several pixels are drawn first. The last word may overlap the word before, since drawing a pixel
        // twice has no effect.
        let mut left = xs.len();
        while left >= WORD_PX {
            let k = xs.len() - left;
            self.draw_word::<WORD_PX>(word(xs, k), word(ys, k), word_mut(nearest, k));
            left = if left < 2 * WORD_PX && left > WORD_PX { WORD_PX } else { left - WORD_PX };
        }
        for k in xs.len() - left..xs.len() {
            self.draw_word::<1>(word(xs, k), word(ys, k), word_mut(nearest, k));
        }
    }

    /// Draws the triangle at N neighbouring pixels with the rays (x, y, 1) into `nearest`, the pixels' inverse depths.
    #[inline(always)]
    fn draw_word<const N: usize>(&self, x: &[f64; N], y: &[f64; N], nearest: &mut [f64; N]) {
        let [a, b, c] = &self.edges;
        for k in 0..N {
            let at = |n: &Vector3<f64>| n.x * x[k] + n.y * y[k] + n.z;
            let inverse = at(&self.g);
            let edge = |n: &Vector3<f64>| at(n) >= -ON_EDGE;
            let own = if edge(a) & edge(b) & edge(c) { inverse } else { 0.0 };
            // Every pixel is written, even if it is unchanged, since a masked store would delay the next word's load.
            nearest[k] = if own > nearest[k] { own } else { nearest[k] };
        }
    }
}

#[inline(always)]
fn word<const N: usize>(values: &[f64], at: usize) -> &[f64; N] {
    values[at..].first_chunk().expect("the row goes on")
}

#[inline(always)]
fn word_mut<const N: usize>(values: &mut [f64], at: usize) -> &mut [f64; N] {
    values[at..].first_chunk_mut().expect("the row goes on")
}

/// Returns the columns and the rows of a triangle's bounding box in the image. `v` are the vertices in the camera's
/// frame. `None` if the triangle lies behind the camera or outside the image.
fn image_box(v: &[Vector3<f64>; 3], camera: &Camera) -> Option<(Range<usize>, Range<usize>)> {
    let in_front = v.iter().map(|p| p.z).filter(|z| *z > 0.0);
    let near = in_front.fold(f64::INFINITY, f64::min) * NEAR_FRACTION;
    if !(near > 0.0 && near.is_finite()) {
        return None;
    }
    let (mut low, mut high) = (Point2::new(f64::MAX, f64::MAX), Point2::new(f64::MIN, f64::MIN));
    let mut add = |p: Point2<f64>| {
        low = low.inf(&p);
        high = high.sup(&p);
    };
    let projected =
        |p: &Vector3<f64>| camera.model.pixel_from_normalized(&Point2::new(p.x / p.z, p.y / p.z));
    let pinhole = camera.model.is_pinhole();
    let mut longest: f64 = 0.0;
    if pinhole && v.iter().all(|p| p.z > 0.0) {
        // In a pinhole image, a triangle that isn't clipped has straight sides, so that its vertices bound it.
        v.iter().for_each(|p| add(projected(p)));
    } else {
        let steps = if pinhole { 1 } else { BEND_STEPS };
        for k in 0..3 {
            let Some((from, to)) = clip(v[k], v[(k + 1) % 3], near) else { continue };
            let mut last: Option<Point2<f64>> = None;
            for step in 0..=steps {
                let pixel = projected(&(from + (to - from) * (step as f64 / steps as f64)));
                if let Some(last) = last {
                    longest = longest.max((pixel - last).norm());
                }
                last = Some(pixel);
                add(pixel);
            }
        }
    }
    // A distorted edge deviates from the polygon through its samples by far less than the distance between two samples.
    let margin = if pinhole { 1e-6 } else { 1.0 + 0.25 * longest };
    let range = |low: f64, high: f64, size: usize| {
        let last = size as f64;
        let first = (low - margin - 0.5).ceil().clamp(0.0, last);
        let end = ((high + margin - 0.5).floor() + 1.0).clamp(0.0, last);
        (first < end).then_some(first as usize..end as usize)
    };
    let all = !(low.x.is_finite() && low.y.is_finite() && high.x.is_finite() && high.y.is_finite());
    if all {
        return Some((0..camera.width, 0..camera.height));
    }
    Some((range(low.x, high.x, camera.width)?, range(low.y, high.y, camera.height)?))
}

/// Clips the segment from `a` to `b` to depths z of at least `near`. `None` if the whole segment is nearer than `near`.
fn clip(a: Vector3<f64>, b: Vector3<f64>, near: f64) -> Option<(Vector3<f64>, Vector3<f64>)> {
    match (a.z >= near, b.z >= near) {
        (true, true) => Some((a, b)),
        (false, false) => None,
        // One depth is below `near` and the other is not, so that the divisor is not 0.
        (true, false) => Some((a, a + (b - a) * ((a.z - near) / (a.z - b.z)))),
        (false, true) => Some((b + (a - b) * ((b.z - near) / (b.z - a.z)), b)),
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::Random;
    use super::*;
    use crate::camera::CameraModel;
    use crate::camera::tests::pinhole_at;

    fn small() -> Camera {
        let model = CameraModel::Pinhole { fx: 70.0, fy: 70.0, cx: 32.0, cy: 24.0 };
        Camera { width: 64, height: 48, model, ..pinhole_at([0.0; 3]) }
    }

    fn bent() -> Camera {
        let model = CameraModel::OpenCv {
            fx: 70.0,
            fy: 70.0,
            cx: 32.0,
            cy: 24.0,
            k1: -0.2,
            k2: 0.05,
            p1: 1e-3,
            p2: -1e-3,
        };
        Camera { model, ..small() }
    }

    /// Reference implementation, which intersects every pixel's ray with every triangle (Möller and Trumbore).
    fn naive(points: &[Vector3<f64>], triangles: &[[u32; 3]], camera: &Camera) -> Vec<f32> {
        let mut out = vec![f32::NAN; camera.width * camera.height];
        for (at, depth) in out.iter_mut().enumerate() {
            let (x, y) = (at % camera.width, at / camera.width);
            let ray = camera.ray(&Point2::new(x as f64 + 0.5, y as f64 + 0.5)).unwrap();
            for t in triangles {
                let [a, b, c] = t.map(|k| points[k as usize]);
                let (e1, e2) = (b - a, c - a);
                let p = ray.cross(&e2);
                let det = e1.dot(&p);
                let (s, q) = (-a / det, (-a).cross(&e1));
                let (u, v, z) = (s.dot(&p), ray.dot(&q) / det, e2.dot(&q) / det);
                if u >= 0.0 && v >= 0.0 && u + v <= 1.0 && z > 0.0 && !(z as f32 >= *depth) {
                    *depth = z as f32;
                }
            }
        }
        out
    }

    #[test]
    fn equals_the_naive_one_on_random_triangles_through_and_behind_the_camera() {
        let mut random = Random::new(7);
        for camera in [small(), bent()] {
            for _ in 0..100 {
                let points: Vec<_> = (0..9)
                    .map(|_| {
                        Vector3::new(
                            random.in_range(-3.0, 3.0),
                            random.in_range(-3.0, 3.0),
                            random.in_range(-1.0, 5.0),
                        )
                    })
                    .collect();
                let triangles = [[0, 1, 2], [3, 4, 5], [6, 7, 8]];
                let got = rasterize(&points, &triangles, &camera);
                for (a, b) in got.data().iter().zip(naive(&points, &triangles, &camera)) {
                    // Depths below 1e-3 aren't compared, since the near plane may clip them.
                    let same = (a - b).abs() <= 1e-4 * b || (a.is_nan() && b.is_nan());
                    assert!(same || !(b > 1e-3), "{a} {b}");
                }
            }
        }
    }

    #[test]
    fn a_mesh_has_no_cracks_even_where_vertices_are_pixel_centres() {
        let camera = small();
        let mut random = Random::new(8);
        // The vertices form a grid on pixel centres and have random depths. The grid extends beyond the image.
        let (columns, rows) = (19, 15);
        let points: Vec<_> = (0..columns * rows)
            .map(|k| {
                let (x, y) = (k % columns, k / columns);
                let pixel = Point2::new(4.0 * x as f64 - 3.5, 4.0 * y as f64 - 3.5);
                camera.ray(&pixel).unwrap() * random.in_range(1.0, 4.0)
            })
            .collect();
        let mut triangles = Vec::new();
        for y in 0..rows - 1 {
            for x in 0..columns - 1 {
                let k = (y * columns + x) as u32;
                let c = columns as u32;
                triangles.push([k, k + 1, k + c]);
                triangles.push([k + c + 1, k + c, k + 1]);
            }
        }
        let got = rasterize(&points, &triangles, &camera);
        assert!(got.data().iter().all(|z| z.is_finite()));
    }

    #[test]
    fn inverse_depth_is_linear_in_the_image() {
        let camera = small();
        let points = [[-9.0, -9.0, 2.0], [9.0, -9.0, 4.0], [0.0, 12.0, 3.0]].map(Vector3::from);
        let got = rasterize(&points, &[[0, 1, 2]], &camera);
        let row: Vec<f32> = got.row(20).iter().map(|z| 1.0 / z).collect();
        for w in row.windows(3) {
            assert!((w[0] - 2.0 * w[1] + w[2]).abs() < 1e-6);
        }
    }

    #[test]
    fn degenerate_triangles_are_skipped() {
        let p = [[0.0, 0.0, 1.0], [0.0, 0.0, 2.0], [0.0, 1.0, 3.0], [f64::NAN, 0.0, 1.0]]
            .map(Vector3::from);
        for t in [[0, 0, 0], [0, 1, 2], [0, 1, 0], [0, 2, 3], [0, 2, 99]] {
            let got = rasterize(&p, &[t], &small());
            assert!(got.data().iter().all(|z| z.is_nan()), "{t:?}");
        }
    }

    #[test]
    fn inverse_depths_are_inverted_alike_with_and_without_avx2() {
        let inverse: Vec<f64> =
            (0..37).map(|k| if k % 5 == 0 { 0.0 } else { 0.1 * f64::from(k) }).collect();
        let [a, b] = [invert, invert_by].map(|invert| {
            let mut depths = vec![0.0; inverse.len()];
            invert(&inverse, &mut depths);
            depths.iter().map(|z: &f32| z.to_bits()).collect::<Vec<_>>()
        });
        assert_eq!(a, b);
        assert!(f32::from_bits(a[5]).is_nan() && f32::from_bits(a[4]) == 2.5);
    }

    #[test]
    fn bands_are_drawn_alike_with_and_without_avx2() {
        let mut random = Random::new(9);
        for camera in [small(), bent()] {
            let mut vertex = || {
                let [x, y] = [0, 1].map(|_| random.in_range(-1.5, 1.5));
                Vector3::new(x, y, random.in_range(0.5, 4.0))
            };
            let points: Vec<_> = (0..90).map(|_| vertex()).collect();
            let triangles: Vec<_> = (0..30).map(|k| [3 * k, 3 * k + 1, 3 * k + 2]).collect();
            let all: Vec<_> =
                triangles.iter().filter_map(|t| project(&points, t, &camera)).collect();
            for first_row in (0..camera.height).step_by(BAND_ROWS) {
                let touches = |t: &&ProjectedTriangle| {
                    t.rows.start < first_row + BAND_ROWS && t.rows.end > first_row
                };
                let triangles: Vec<&ProjectedTriangle> = all.iter().filter(touches).collect();
                let [mut band, mut plain] = [(); 2].map(|()| DepthBand::new(&camera));
                band.set(first_row);
                plain.set(first_row);
                draw(&triangles, &mut band);
                draw_by(&triangles, &mut plain);
                assert_eq!(band.nearest, plain.nearest);
                assert!(band.nearest.iter().any(|v| *v > 0.0));
            }
        }
    }
}
