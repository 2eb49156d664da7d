//! The geometry proxy, and its depth map in a view.

use super::depth_map::DepthMap;
use super::rasterize::rasterize;
use super::rays::RayRow;
use super::{Mesh, Plane};
use crate::camera::Camera;
use nalgebra::Vector3;
use rayon::prelude::*;

/// Geometry proxy: an approximation of the scene's surfaces.
#[derive(Clone, Debug, PartialEq)]
pub enum Proxy {
    /// The proxy is a plane in the world.
    Plane(Plane),
    /// The proxy is a triangle mesh in the world.
    Mesh(Mesh),
}

impl Proxy {
    /// Computes the proxy's depth map in the view of the camera `target`.
    ///
    /// A pixel's depth is NaN if its ray misses the proxy or meets it behind the camera, or if the ray can't be
    /// computed.
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

/// Computes a plane's depth map in the view of the camera `target`.
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
                // The depth is negative if the plane is behind the camera; `from_data` turns it into NaN. It is
                // infinite for a ray parallel to the plane.
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
