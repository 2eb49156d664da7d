//! The ground-truth images of a comparison. They are checked before anything is rendered.

use super::{CompareError, CompareOptions};
use crate::camera::Camera;
use crate::capture::{Capture, Color, Truth};
use crate::metrics::moving_part;
use crate::raster::{BitDepth, Image};

/// Smallest time between two instants, seconds. Ground-truth images closer in time belong to one instant.
const SAME_INSTANT_S: f64 = 1e-6;

/// An instant at which the ground truth has images.
pub(crate) struct TrueInstant {
    /// Time of the instant as in `truth.json`, in seconds on the reference camera's clock.
    pub time_s: f64,
    /// Time of the instant from the capture's start, in seconds on the reference camera's clock: `time_s` minus the
    /// capture's time origin.
    pub inner_s: f64,
    pub views: Vec<TrueView>,
}

/// A ground-truth image of an instant, before it is read.
pub(crate) struct TrueView {
    /// Index of the view in [`Truth::views`].
    pub index: usize,
    /// Index of the capture's camera with the same lens and pose as the view. `None` if there is no such camera.
    pub like: Option<usize>,
    pub camera: Camera,
    /// Unique base name of the view's output files.
    pub stem: String,
}

/// A ground-truth image, and the row-major mask of the pixels whose surface moves.
pub(crate) struct TrueImage {
    pub image: Image,
    pub moving: Vec<bool>,
}

/// Groups the views of the ground truth by instant, in the order of `truth.json`. Returns an error if an image or
/// motion file is missing, or if a view is invalid.
pub(crate) fn instants(truth: &Truth, capture: &Capture) -> Result<Vec<TrueInstant>, CompareError> {
    let mut instants: Vec<TrueInstant> = Vec::new();
    for (index, view) in truth.views.iter().enumerate() {
        let wrong = |reason: String| CompareError::View { index, id: view.id.clone(), reason };
        if truth.views[..index].iter().any(|v| v.id == view.id) {
            return Err(wrong("has the id of an earlier view".into()));
        }
        if !view.time_s.is_finite() {
            return Err(wrong(format!("time_s is {}", view.time_s)));
        }
        for file in [&view.image, &view.motion] {
            truth.file(file)?;
        }
        let unknown = |id: &str| wrong(format!("like: no camera has the id '{id}'"));
        let index_of = |id: &String| capture.camera_index(id).ok_or_else(|| unknown(id));
        let like = view.like.as_ref().map(index_of).transpose()?;
        let camera = view.camera.camera().map_err(|e| wrong(format!("camera.{e}")))?;
        let entry = TrueView { index, like, camera, stem: stem(truth, index) };
        let time_s = view.time_s;
        match instants.iter_mut().find(|i| (i.time_s - time_s).abs() < SAME_INSTANT_S) {
            Some(instant) => instant.views.push(entry),
            None => instants.push(TrueInstant {
                time_s,
                inner_s: time_s - capture.time_origin_s,
                views: vec![entry],
            }),
        }
    }
    Ok(instants)
}

/// Makes a file name for a view from its id, with letters, digits, `-` and `_` only. The view's index is appended if
/// another view would have the same name.
fn stem(truth: &Truth, index: usize) -> String {
    let own = slug(&truth.views[index].id);
    let alike = truth.views.iter().filter(|v| slug(&v.id).eq_ignore_ascii_case(&own)).count();
    if alike > 1 || own.is_empty() { format!("{own}-{index}") } else { own }
}

/// Replaces all characters except ASCII letters, digits and `_` by `-`, and keeps at most 60 characters. The result is
/// safe as a file name.
pub(crate) fn slug(name: &str) -> String {
    let keep = |c: char| if c.is_ascii_alphanumeric() || c == '_' { c } else { '-' };
    name.chars().take(60).map(keep).collect()
}

impl TrueView {
    /// Reads a ground-truth image and computes the mask of the pixels whose surface moves. The image is converted to
    /// grey if the rendered images are grey, otherwise to RGB.
    pub fn read(
        &self,
        truth: &Truth,
        capture: &Capture,
        options: &CompareOptions,
    ) -> Result<TrueImage, CompareError> {
        let view = &truth.views[self.index];
        let image = truth.image(&view.image, &self.camera)?;
        let motion = truth.array(&view.motion, &self.camera)?;
        let gray = match self.like {
            Some(camera) => capture.cameras[camera].color == Color::Gray,
            None => capture.cameras.iter().all(|c| c.color == Color::Gray),
        };
        Ok(TrueImage {
            image: if gray { image.to_gray() } else { image.to_rgb() },
            moving: moving_part(
                &motion,
                self.camera.width,
                options.moving_threshold_px,
                options.moving_dilation_px,
            ),
        })
    }
}

/// Returns `image` with the pixels of the ground-truth image `truth` in place of its uncovered pixels. Metrics that
/// compare windows of pixels, such as SSIM, then find no error at the uncovered pixels. `covered` has one value per
/// pixel, row by row.
pub(crate) fn filled_with(truth: &Image, image: &Image, covered: &[bool]) -> Image {
    let n = image.channels();
    let mut filled = image.clone();
    for (k, pixel) in filled.data_mut().chunks_exact_mut(n).enumerate() {
        if !covered[k] {
            pixel.copy_from_slice(&truth.data()[k * n..(k + 1) * n]);
        }
    }
    filled
}

/// Returns the image as it would be read from a file of this bit depth: clamped to 0..=1, and rounded. The image is
/// converted to grey if `channels` is 1, otherwise to RGB.
pub(crate) fn as_written(image: &Image, channels: usize, depth: BitDepth) -> Image {
    let mut image = if channels == 1 { image.to_gray() } else { image.to_rgb() };
    let most = ((1u32 << bits(depth)) - 1) as f32;
    for v in image.data_mut() {
        // Rounds like `write_image`. NaN becomes 0.
        *v = ((*v * most + 0.5) as u32).min(most as u32) as f32 / most;
    }
    image
}

pub(crate) fn bits(depth: BitDepth) -> u32 {
    match depth {
        BitDepth::Eight => 8,
        BitDepth::Sixteen => 16,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::raster::read_image;

    #[test]
    fn what_is_measured_is_what_is_written() {
        let odd = [-0.3, 0.0, 0.123_456, 0.5, 1.0, 7.0, f32::NAN, f32::INFINITY, 0.998];
        let image = Image::from_data(3, 3, 1, odd.to_vec());
        let folder = tempfile::tempdir().unwrap();
        for depth in [BitDepth::Eight, BitDepth::Sixteen] {
            let path = folder.path().join("a.png");
            crate::raster::write_image(&path, &image, None, depth).unwrap();
            assert_eq!(read_image(&path).unwrap().0, as_written(&image, 1, depth));
        }
    }

    #[test]
    fn slugs_stay_in_their_folder() {
        assert_eq!(slug("../<script>"), "----script-");
        assert_eq!(slug("t0-cam_3"), "t0-cam_3");
    }
}
