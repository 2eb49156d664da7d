//! Rays through the pixel centres of a camera, row by row, and the bounds of a camera's field of view.

use crate::camera::Camera;
use nalgebra::Point2;

/// Rays (x, y, 1) through the pixel centres of one image row, in the camera's frame. A ray is NaN where the lens model
/// can't be inverted.
pub(crate) struct RayRow<'a> {
    camera: &'a Camera,
    pub x: Vec<f64>,
    pub y: Vec<f64>,
}

impl<'a> RayRow<'a> {
    /// Allocates the rays of one row. [`Self::set`] computes their values.
    pub fn new(camera: &'a Camera) -> Self {
        let (fx, _, cx, _) = camera.model.intrinsics();
        // For a pinhole, x is the same in every row.
        let x = (0..camera.width).map(|column| (column as f64 + 0.5 - cx) / fx).collect();
        Self { camera, x, y: vec![0.0; camera.width] }
    }

    /// Computes the rays of the image row `row`.
    pub fn set(&mut self, row: usize) {
        let camera = self.camera;
        let v = row as f64 + 0.5;
        if camera.model.is_pinhole() {
            let (_, fy, _, cy) = camera.model.intrinsics();
            self.y.fill((v - cy) / fy);
            return;
        }
        for (column, (x, y)) in self.x.iter_mut().zip(&mut self.y).enumerate() {
            let pixel = Point2::new(column as f64 + 0.5, v);
            let n = camera.model.normalized_from_pixel(&pixel);
            (*x, *y) = n.map_or((f64::NAN, f64::NAN), |n| (n.x, n.y));
        }
    }
}

/// Axis-aligned bounding box of a camera's field of view, on the plane z = 1 of the camera's frame.
#[derive(Clone, Copy, Debug)]
pub(super) struct ViewBounds {
    pub min: Point2<f64>,
    pub max: Point2<f64>,
}

/// Number of intervals into which each side of an image's border is divided. The rays through the ends of the intervals
/// bound the field of view.
const STEPS: usize = 32;

impl ViewBounds {
    /// Computes the bounds of a camera's field of view from rays through its image border. `None` if none of these rays
    /// can be computed.
    pub fn of(camera: &Camera) -> Option<Self> {
        let (w, h) = (camera.width as f64, camera.height as f64);
        let mut bounds: Option<Self> = None;
        for k in 0..=STEPS {
            let s = k as f64 / STEPS as f64;
            for (x, y) in [(s * w, 0.0), (s * w, h), (0.0, s * h), (w, s * h)] {
                let Some(n) = camera.model.normalized_from_pixel(&Point2::new(x, y)) else {
                    continue;
                };
                let b = bounds.get_or_insert(Self { min: n, max: n });
                b.min = b.min.inf(&n);
                b.max = b.max.sup(&n);
            }
        }
        bounds
    }

    /// Returns the bounds, enlarged on every side by `fraction` of their width or height.
    pub fn enlarged(&self, fraction: f64) -> Self {
        let by = (self.max - self.min) * fraction;
        Self { min: self.min - by, max: self.max + by }
    }

    pub fn contains(&self, n: &Point2<f64>) -> bool {
        n.x >= self.min.x && n.y >= self.min.y && n.x <= self.max.x && n.y <= self.max.y
    }

    pub fn corners(&self) -> [Point2<f64>; 4] {
        let (a, b) = (self.min, self.max);
        [a, Point2::new(b.x, a.y), b, Point2::new(a.x, b.y)]
    }

    /// Returns the squared distance, on the plane z = 1, between the optical axis and the farthest corner.
    pub fn max_radius2(&self) -> f64 {
        self.corners().iter().map(|c| c.coords.norm_squared()).fold(0.0, f64::max)
    }
}
