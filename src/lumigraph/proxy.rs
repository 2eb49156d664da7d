//! The geometry proxy, and its depths in a view.

use super::rasterize::rasterize;
use super::rays::RayRow;
use super::{Mesh, Plane};
use crate::camera::Camera;
use nalgebra::Vector3;
use rayon::prelude::*;

/// Depths at a view's pixel centres along the camera's +z, metres: positive, infinite for the sky, and NaN where
/// there is no proxy.
#[derive(Clone, Debug, PartialEq)]
pub struct DepthMap {
    width: usize,
    height: usize,
    data: Vec<f32>,
}

impl DepthMap {
    /// A map of these depths, row by row. Depths that aren't positive become NaN.
    ///
    /// # Panics
    /// If the number of depths is not `width * height`.
    pub fn from_data(width: usize, height: usize, mut data: Vec<f32>) -> Self {
        assert_eq!(data.len(), width * height, "depths of a {width}×{height} view");
        for z in &mut data {
            if !(*z > 0.0) {
                *z = f32::NAN;
            }
        }
        Self { width, height, data }
    }

    /// A map of depths that are known to be positive or NaN.
    pub(super) fn from_depths(width: usize, height: usize, data: Vec<f32>) -> Self {
        debug_assert!(data.len() == width * height && data.iter().all(|z| !(*z <= 0.0)));
        Self { width, height, data }
    }

    /// A map without depths.
    pub fn empty(width: usize, height: usize) -> Self {
        Self::from_data(width, height, vec![f32::NAN; width * height])
    }

    /// Width, pixels.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Height, pixels.
    pub fn height(&self) -> usize {
        self.height
    }

    /// All depths, row by row.
    pub fn data(&self) -> &[f32] {
        &self.data
    }

    /// The depths of one row. Panics outside of the view.
    pub fn row(&self, y: usize) -> &[f32] {
        &self.data[y * self.width..(y + 1) * self.width]
    }

    /// Smallest depth of the 3×3 pixels around a position in pixels, which is clamped to the image. NaN if none of
    /// them has a depth.
    pub(super) fn nearest_around(&self, x: f32, y: f32) -> f32 {
        let span = |v: f32, size: usize| {
            let at = v.max(0.0).min((size - 1) as f32) as usize;
            at.saturating_sub(1)..(at + 2).min(size)
        };
        let mut nearest = f32::NAN;
        for row in span(y, self.height) {
            for column in span(x, self.width) {
                // `min` ignores NaN.
                nearest = nearest.min(self.data[row * self.width + column]);
            }
        }
        nearest
    }

    /// Largest depth of the 2×2 pixels around a position in pixels, which is clamped to the image. NaN if any of
    /// them has no depth.
    pub(super) fn farthest_around(&self, x: f32, y: f32) -> f32 {
        let cell = |v: f32, size: usize| {
            let floor = (v - 0.5).max(0.0).min((size - 1) as f32) as usize;
            (floor, (floor + 1).min(size - 1))
        };
        let (x0, x1) = cell(x, self.width);
        let (y0, y1) = cell(y, self.height);
        let at = |x: usize, y: usize| self.data[y * self.width + x];
        let (a, b, c, d) = (at(x0, y0), at(x1, y0), at(x0, y1), at(x1, y1));
        // The sum is NaN exactly if one of four positive depths is.
        if (a + b + c + d).is_nan() { f32::NAN } else { a.max(b).max(c).max(d) }
    }
}

/// An approximation of the scene's geometry.
#[derive(Clone, Debug, PartialEq)]
pub enum Proxy {
    /// One plane of the world.
    Plane(Plane),
    /// A triangle mesh of the world.
    Mesh(Mesh),
}

impl Proxy {
    /// The proxy's depth at every pixel's centre of a view.
    ///
    /// NaN where the ray misses the proxy or can't be computed, and where the proxy lies behind the view.
    pub fn depth_map(&self, target: &Camera) -> DepthMap {
        match self {
            Self::Plane(plane) => plane_depth(plane, target),
            Self::Mesh(mesh) => {
                let points: Vec<Vector3<f64>> =
                    mesh.vertices.iter().map(|p| (target.cam_from_world * p).coords).collect();
                rasterize(&points, &mesh.triangles, target)
            }
        }
    }
}

/// The plane's depth at every pixel of a view.
fn plane_depth(plane: &Plane, target: &Camera) -> DepthMap {
    let Some(g) = plane.inverse_depth(target) else {
        return DepthMap::empty(target.width, target.height);
    };
    let mut depths = vec![f32::NAN; target.width * target.height];
    depths.par_chunks_exact_mut(target.width).enumerate().for_each_init(
        || RayRow::new(target),
        |rays, (row, depths)| {
            rays.set(row);
            for ((depth, &x), &y) in depths.iter_mut().zip(&rays.x).zip(&rays.y) {
                // Negative behind the view, which `from_data` makes NaN; ∞ along the plane.
                *depth = (1.0 / (g.x * x + g.y * y + g.z)) as f32;
            }
        },
    );
    DepthMap::from_data(target.width, target.height, depths)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::tests::pinhole_at;

    #[test]
    fn a_fronto_parallel_plane_has_one_depth() {
        let camera = pinhole_at([0.3, 0.1, -1.0]);
        let map = Proxy::Plane(Plane::fronto_parallel(&camera, 2.5)).depth_map(&camera);
        assert!(map.data().iter().all(|z| (z - 2.5).abs() < 1e-6));
    }

    #[test]
    fn a_tilted_plane_is_met_where_the_ray_meets_it() {
        let camera = pinhole_at([0.1, 0.0, 0.0]);
        let plane = Plane { normal: Vector3::new(0.3, 0.4, 0.8).normalize(), d: 2.0 };
        let map = Proxy::Plane(plane).depth_map(&camera);
        for (x, y) in [(0, 0), (100, 400), (639, 479)] {
            let pixel = nalgebra::Point2::new(x as f64 + 0.5, y as f64 + 0.5);
            let z = f64::from(map.row(y)[x]);
            let p = camera.center() + camera.ray_world(&pixel).unwrap() * z;
            assert!((plane.normal.dot(&p.coords) - plane.d).abs() < 1e-6);
        }
    }

    #[test]
    fn proxies_behind_or_of_another_view_have_no_depth() {
        let camera = pinhole_at([0.0; 3]);
        let nowhere = [
            Proxy::Plane(Plane { normal: Vector3::z(), d: -1.0 }),
            Proxy::Plane(Plane { normal: Vector3::z(), d: 0.0 }),
            Proxy::Mesh(Mesh { vertices: vec![], triangles: vec![] }),
        ];
        for proxy in nowhere {
            assert!(proxy.depth_map(&camera).data().iter().all(|z| z.is_nan()), "{proxy:?}");
        }
    }
}
