//! Measures how much a camera's image changes in each interval between successive frames: the camera's activity.
//! Rough alignment correlates the activity signals of two cameras. Computing activity costs far less than tracking
//! features.
//!
//! Two successive frames are downsampled to a width of about 80 pixels. For each cell of a coarse grid, two sums are
//! computed over the cell's pixels: the energy of the temporal derivative, `Σ I_t²`, and the correlation of the
//! temporal derivative with the gradient, `−Σ I_t ∇I`. The correlation is a vector in the direction of motion. The
//! cells are grouped into epipolar bands. A band is the region between two epipolar lines. Corresponding bands of two
//! nearby cameras have the same energy, and the same motion perpendicular to the epipolar lines. Energy alone does
//! not distinguish a motion from its reverse.
//!
//! Known limit: motion along the epipolar lines contributes only energy.

use crate::camera::{Camera, EpipolarGeometry};
use crate::capture::CaptureError;
use crate::registration::FrameStore;
use nalgebra::{Point2, Vector2};
use std::collections::BTreeMap;

/// The number of columns of the grid of cells over an image, in which activity is summed.
const COLUMNS: usize = 16;
/// The number of rows of the grid of cells over an image, in which activity is summed.
const ROWS: usize = 12;
/// The approximate width of the downsampled frames from which activity is computed, pixels.
const WIDTH: usize = 80;
/// The number of epipolar bands into which each image of a pair is divided.
pub const BANDS: usize = 6;

/// Activity of one camera: how much its image changes in each interval between successive frames.
#[derive(Clone, Debug, Default)]
pub struct Activity {
    /// The middle of each interval between successive frames, seconds on the camera's clock.
    pub times_s: Vec<f64>,
    /// The energy of the temporal derivative of the brightness in each interval between successive frames, `Σ I_t²`,
    /// summed over the whole image, per s².
    pub energies: Vec<f64>,
    /// The activity signals, by the index of a camera pair. For each interval between successive frames, a signal holds
    /// the square root of each epipolar band's energy, then the signed square root of each band's motion perpendicular
    /// to the epipolar lines. The motion is the correlation `−Σ I_t ∇I` of the brightness's temporal derivative with
    /// its gradient.
    pub signals: BTreeMap<usize, Vec<[f32; 2 * BANDS]>>,
}

/// The sums of each cell of the grid, row by row: the energy `Σ I_t²`, per s², and the x and y components of the
/// correlation `−Σ I_t ∇I`, per second. `I_t` is the temporal derivative of the brightness, and `∇I` its gradient.
type Cells = [[f32; 3]; COLUMNS * ROWS];

impl Activity {
    /// Computes the activity of a camera from all its frames, whose brightness is converted to the exposure of the
    /// first frame. `bands` has an entry for each pair that contains the camera: the index of the pair, and the
    /// epipolar bands of this camera's image. Returns an error if a frame cannot be read.
    pub fn new(
        frames: &FrameStore,
        camera: usize,
        bands: &[(usize, &Bands)],
    ) -> Result<Self, CaptureError> {
        let (capture, gains) = (frames.capture(), frames.gains());
        let times = &capture.cameras[camera].clock.times_s;
        let mut activity = Self::default();
        let mut before: Option<Downsampled> = None;
        for (k, &time_s) in times.iter().enumerate() {
            let image = capture.read_frame(camera, k)?;
            let image = gains.exposed_at(camera, [time_s, times[0]], &image).unwrap_or(image);
            let current = Downsampled::new(&image.to_gray());
            if let Some(before) = before {
                // Frame times ascend strictly, so the interval is positive.
                let interval = time_s - times[k - 1];
                activity.times_s.push(time_s - 0.5 * interval);
                let cells = cells(&before, &current, interval as f32);
                activity.energies.push(cells.iter().map(|c| f64::from(c[0])).sum());
                for (pair, bands) in bands {
                    activity.signals.entry(*pair).or_default().push(bands.signal(&cells));
                }
            }
            before = Some(current);
        }
        Ok(activity)
    }
}

/// A grey frame, downsampled by averaging square blocks.
struct Downsampled {
    width: usize,
    height: usize,
    values: Vec<f32>,
}

impl Downsampled {
    fn new(gray: &crate::raster::Image) -> Self {
        let step = (gray.width() / WIDTH).max(1);
        let (width, height) = (gray.width() / step, gray.height() / step);
        let mut values = vec![0.0; width * height];
        let scale = 1.0 / (step * step) as f32;
        for y in 0..height * step {
            let row = &gray.row(y)[..width * step];
            let out = &mut values[(y / step) * width..][..width];
            for (sum, block) in out.iter_mut().zip(row.chunks_exact(step)) {
                *sum += scale * block.iter().sum::<f32>();
            }
        }
        Self { width, height, values }
    }
}

/// Computes the energy and the motion of all cells of the grid ([`Cells`]) from two successive frames, which are
/// `interval` seconds apart.
fn cells(before: &Downsampled, current: &Downsampled, interval: f32) -> Cells {
    let (w, h) = (current.width, current.height);
    let mut cells = [[0.0; 3]; COLUMNS * ROWS];
    // Border pixels have no central difference. Images smaller than 3 × 3 pixels have no activity.
    for y in 1..h.saturating_sub(1) {
        for x in 1..w.saturating_sub(1) {
            let at = y * w + x;
            let both = |k: usize| before.values[k] + current.values[k];
            let change = current.values[at] - before.values[at];
            let gradient =
                [0.25 * (both(at + 1) - both(at - 1)), 0.25 * (both(at + w) - both(at - w))];
            let cell = &mut cells[(y * ROWS / h) * COLUMNS + x * COLUMNS / w];
            cell[0] += change * change / (interval * interval);
            cell[1] -= change * gradient[0] / interval;
            cell[2] -= change * gradient[1] / interval;
        }
    }
    cells
}

/// Epipolar bands (image regions between two epipolar lines) of one camera of a pair. There is an entry for each cell
/// of the grid, row by row: the index of the cell's band, and the unit vector perpendicular to the epipolar line
/// through the cell's centre; `None` for a cell outside all bands. In both cameras of the pair, the vectors point to
/// the same side of corresponding epipolar lines.
#[derive(Clone, Debug)]
pub struct Bands {
    of_cell: Vec<Option<(usize, Vector2<f64>)>>,
}

impl Bands {
    /// Computes the epipolar bands of two cameras, in the order [a, b]. `None` if the cameras have a common centre.
    pub fn of_pair(a: &Camera, b: &Camera) -> Option<[Self; 2]> {
        let (b_from_a, a_from_b) = (EpipolarGeometry::new(a, b)?, EpipolarGeometry::new(b, a)?);
        let middle = |c: &Camera| Point2::new(0.5 * c.width as f64, 0.5 * c.height as f64);
        let (in_a, in_b) = (middle(a), middle(b));
        // An epipolar line is identified by its signed distance from the centre of camera b's image. Corresponding
        // lines of both images get the same number.
        let of_a = |p: &Point2<f64>| Some(b_from_a.line_in_j(p)?.distance(&in_b));
        let of_b = |q: &Point2<f64>| of_a(&a_from_b.line_in_j(q)?.nearest(&in_a));
        let max_distance = cell_centers(b)
            .filter_map(|q| of_b(&q))
            .fold(0.0_f64, |max, distance| max.max(distance.abs()));
        // The range is enlarged slightly, so that the outermost lines lie inside the outermost bands.
        let max_distance = max_distance * (1.0 + 1e-3);
        Some([Self::new(a, of_a, max_distance), Self::new(b, of_b, max_distance)])
    }

    /// Returns the activity signal of one interval between successive frames: the square root of each epipolar band's
    /// energy, then the signed square root of each band's motion perpendicular to the epipolar lines. `cells` holds the
    /// sums of energy and motion in this interval.
    fn signal(&self, cells: &Cells) -> [f32; 2 * BANDS] {
        let mut sums = [0.0; 2 * BANDS];
        for (cell, of_cell) in cells.iter().zip(&self.of_cell) {
            let Some((band, across)) = of_cell else { continue };
            sums[*band] += cell[0];
            sums[BANDS + band] += cell[1] * across.x as f32 + cell[2] * across.y as f32;
        }
        sums.map(|s| s.signum() * s.abs().sqrt())
    }

    fn new(
        camera: &Camera,
        distance: impl Fn(&Point2<f64>) -> Option<f64>,
        max_distance: f64,
    ) -> Self {
        let of_cell = cell_centers(camera)
            .map(|p| {
                let at = distance(&p)?;
                let band = ((at + max_distance) / (2.0 * max_distance) * BANDS as f64).floor();
                let slope = |v: Vector2<f64>| Some(distance(&(p + v))? - distance(&(p - v))?);
                let across = Vector2::new(slope(Vector2::x())?, slope(Vector2::y())?);
                let inside = (0.0..BANDS as f64).contains(&band);
                inside.then_some((band as usize, across.try_normalize(0.0)?))
            })
            .collect();
        Self { of_cell }
    }
}

/// Returns the centres of the grid's cells in a camera's image, row by row, pixels.
fn cell_centers(camera: &Camera) -> impl Iterator<Item = Point2<f64>> {
    let (w, h) = (camera.width as f64, camera.height as f64);
    (0..COLUMNS * ROWS).map(move |k| {
        let at = |n: usize, of: usize, size: f64| (n as f64 + 0.5) / of as f64 * size;
        Point2::new(at(k % COLUMNS, COLUMNS, w), at(k / COLUMNS, ROWS, h))
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::CameraModel;
    use crate::raster::Image;
    use nalgebra::{Isometry3, Translation3, UnitQuaternion};

    fn camera(x: f64, roll: f64) -> Camera {
        let turn = Isometry3::from_parts(
            Translation3::identity(),
            UnitQuaternion::from_euler_angles(0.0, 0.0, roll),
        );
        Camera {
            width: 160,
            height: 120,
            model: CameraModel::Pinhole { fx: 170.0, fy: 170.0, cx: 80.0, cy: 60.0 },
            cam_from_world: turn * Isometry3::translation(-x, 0.0, 0.0),
        }
    }

    #[test]
    fn bands_of_a_horizontal_baseline_are_rows_and_roll_with_the_camera() {
        let [a, b] = Bands::of_pair(&camera(0.0, 0.0), &camera(0.06, 0.0)).unwrap();
        let upright: Vec<_> = a.of_cell.iter().map(|c| c.unwrap()).collect();
        for (k, (band, across)) in upright.iter().enumerate() {
            assert_eq!((*band, b.of_cell[k].unwrap().0), (b.of_cell[k].unwrap().0, *band));
            assert!(across.x.abs() < 1e-6 && (across.y.abs() - 1.0).abs() < 1e-6);
            assert!((b.of_cell[k].unwrap().1 - across).norm() < 1e-6);
        }
        // In a camera rolled by 180°, the order of bands is reversed.
        let [a, b] =
            Bands::of_pair(&camera(0.0, 0.0), &camera(0.06, std::f64::consts::PI)).unwrap();
        for (k, cell) in a.of_cell.iter().enumerate() {
            let opposite = b.of_cell[COLUMNS * ROWS - 1 - k].unwrap();
            assert_eq!(cell.unwrap().0, opposite.0);
            assert!((cell.unwrap().1 + opposite.1).norm() < 1e-6);
        }
        assert!(Bands::of_pair(&camera(0.0, 0.0), &camera(0.0, 0.3)).is_none());
    }

    #[test]
    fn motion_has_the_sign_of_its_direction() {
        let frame = |shift: f32| {
            let data = (0..160 * 120).map(|k| 0.5 + 0.4 * (((k / 160) as f32 - shift) * 0.2).sin());
            Downsampled::new(&Image::from_data(160, 120, 1, data.collect()))
        };
        for (shift, sign) in [(1.0, 1.0), (-1.0, -1.0)] {
            let cells = cells(&frame(0.0), &frame(shift), 0.04);
            let down: f32 = cells.iter().map(|c| c[2]).sum();
            assert!(down * sign > 0.0, "{shift} {down}");
        }
        let unchanged = cells(&frame(0.0), &frame(0.0), 0.04);
        assert!(unchanged.iter().flatten().all(|v| *v == 0.0));
    }
}
