//! The rays through the centres of a view's pixels, row by row.

use crate::camera::Camera;
use nalgebra::Point2;

/// The rays (x, y, 1) through the centres of one row's pixels, in the camera's frame. NaN where the lens
/// model can't be inverted.
pub(crate) struct RayRow<'a> {
    camera: &'a Camera,
    pub x: Vec<f64>,
    pub y: Vec<f64>,
}

impl<'a> RayRow<'a> {
    /// Allocates a row; [`Self::set`] computes the rays.
    pub fn new(camera: &'a Camera) -> Self {
        let (fx, _, cx, _) = camera.model.intrinsics();
        // For a pinhole, x is the same in every row.
        let x = (0..camera.width).map(|column| (column as f64 + 0.5 - cx) / fx).collect();
        Self { camera, x, y: vec![0.0; camera.width] }
    }

    /// Computes the rays of a row.
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

/// Bounding box, on the plane z = 1, of a view's border.
#[derive(Clone, Copy, Debug)]
pub(super) struct ViewBounds {
    pub min: Point2<f64>,
    pub max: Point2<f64>,
}

/// Number of samples along each side of the border.
const STEPS: usize = 32;

impl ViewBounds {
    /// Bounds of a camera's view. `None` if no ray of the border can be computed.
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

    /// Enlarges the bounds on every side by a fraction of their size.
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

    /// Largest squared distance of a corner from the optical axis.
    pub fn max_radius2(&self) -> f64 {
        self.corners().iter().map(|c| c.coords.norm_squared()).fold(0.0, f64::max)
    }
}
