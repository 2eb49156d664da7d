//! Undistortion: resampling of a distorted lens's images to those of a pinhole camera.

use crate::camera::{Camera, CameraModel};
use crate::raster::Image;
use nalgebra::{Point2, Point3};

/// Resampling map from a distorted camera's image to the image of a pinhole camera with the same pose.
pub struct Undistortion {
    /// The pinhole camera. It has the image size of the distorted camera.
    pub camera: Camera,
    /// For each pixel of the pinhole camera, row by row: its position in the distorted image, in pixels; `None` if the
    /// position is outside the distorted image. Empty if the images of both cameras are equal.
    sources: Vec<Option<Point2<f64>>>,
    is_identity: bool,
}

impl Undistortion {
    /// Creates the resampling map to a pinhole camera with the same focal lengths and principal point. If
    /// `is_centered`, both focal lengths of the pinhole camera are the mean focal length, and its principal point is in
    /// the middle of the image.
    pub fn new(camera: &Camera, is_centered: bool) -> Self {
        let (fx, fy, cx, cy) = camera.model.intrinsics();
        let (width, height) = (camera.width, camera.height);
        let model = if is_centered {
            let f = camera.focal_px();
            CameraModel::Pinhole { fx: f, fy: f, cx: 0.5 * width as f64, cy: 0.5 * height as f64 }
        } else {
            CameraModel::Pinhole { fx, fy, cx, cy }
        };
        let pinhole = Camera { model, ..camera.clone() };
        let is_identity = camera.model.is_pinhole() && (fx, fy, cx, cy) == model.intrinsics();
        let pixels = (0..height).flat_map(|y| (0..width).map(move |x| (x, y)));
        let sources = if is_identity {
            Vec::new()
        } else {
            pixels.map(|(x, y)| source(camera, &pinhole, [x, y])).collect()
        };
        Self { camera: pinhole, sources, is_identity }
    }

    /// Resamples an image of the distorted camera by bicubic interpolation. Pixels whose position is outside the image
    /// are black.
    pub fn apply(&self, image: &Image) -> Image {
        if self.is_identity {
            return image.clone();
        }
        let channels = image.channels();
        let mut data = Vec::with_capacity(self.sources.len() * channels);
        let mut pixel = vec![0.0; channels];
        for source in &self.sources {
            match source {
                Some(at) => image.sample_cubic(at.x as f32, at.y as f32, &mut pixel),
                None => pixel.fill(0.0),
            }
            data.extend(pixel.iter().map(|v: &f32| v.clamp(0.0, 1.0)));
        }
        Image::from_data(self.camera.width, self.camera.height, channels, data)
    }
}

/// Projects the centre of the pinhole camera's pixel (x, y) into the distorted image. Returns the position in pixels;
/// `None` if it is outside the distorted image.
fn source(camera: &Camera, pinhole: &Camera, [x, y]: [usize; 2]) -> Option<Point2<f64>> {
    let ray = pinhole.ray(&Point2::new(x as f64 + 0.5, y as f64 + 0.5))?;
    camera.project_cam(&Point3::from(ray)).filter(|pixel| camera.contains(pixel))
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Isometry3;

    fn camera(model: CameraModel) -> Camera {
        Camera { width: 64, height: 48, model, cam_from_world: Isometry3::identity() }
    }

    /// Returns a camera's image of a smooth pattern on the plane z = 1, which is the same for every camera.
    fn picture(camera: &Camera) -> Image {
        let value = |k: usize| {
            let pixel = Point2::new((k % 64) as f64 + 0.5, (k / 64) as f64 + 0.5);
            let n = camera.ray(&pixel).unwrap();
            (0.5 + 0.3 * (5.0 * n.x).sin() * (4.0 * n.y).cos()) as f32
        };
        Image::from_data(64, 48, 1, (0..64 * 48).map(value).collect())
    }

    #[test]
    fn straight_things_are_straight_again() {
        let params = [60.0, 61.0, 31.0, 25.0, -0.2, 0.05, 1e-3, -2e-3];
        let bent = camera(CameraModel::from_params("OPENCV", &params).unwrap());
        for is_centered in [false, true] {
            let map = Undistortion::new(&bent, is_centered);
            let (found, expected) = (map.apply(&picture(&bent)), picture(&map.camera));
            let mut seen = 0;
            for (k, source) in map.sources.iter().enumerate() {
                let Some(source) = source else { continue };
                // Pixels near the border are skipped, because interpolation repeats border pixels there.
                if source.x > 2.0 && source.y > 2.0 && source.x < 62.0 && source.y < 46.0 {
                    assert!((found.data()[k] - expected.data()[k]).abs() < 2e-3, "{k}");
                    seen += 1;
                }
            }
            assert!(seen > 2000, "{seen}");
        }
    }

    #[test]
    fn a_pinhole_keeps_its_pixels() {
        let model = CameraModel::SimplePinhole { f: 60.0, cx: 31.0, cy: 25.0 };
        let image = picture(&camera(model));
        assert!(Undistortion::new(&camera(model), false).apply(&image) == image);
    }
}
