//! The calibration's errors in the offsets.
//!
//! A wrong pose or focal length moves all epipolar lines of a pair, and with them the times at which trajectories cross
//! them. Such errors are common to all candidates of a camera, so that they do not average out. Where the capture says how
//! far its calibration may be off, the joint solution has the calibration's errors as further unknowns, with the stated
//! covariance as their prior. Offsets are then generalized least squares, and their standard errors include what the
//! calibration adds: J C Jᵀ, less what the candidates themselves say of the errors.
//!
//! Candidates are linear in the errors: slopes are central differences at the given calibration. After each solution, the
//! weights of the pairs' candidates are fitted again without the errors found.

use super::recording::Sample;
use crate::camera::{Camera, CameraParameter, EpipolarGeometry};
use crate::capture::CalibrationErrors;
use nalgebra::{DMatrix, DVector, Point2};

/// The smallest eigenvalue of the correlation matrix that is not rounding, as a fraction of the largest.
const MIN_EIGENVALUE: f64 = 1e-9;
/// The steps of the central differences: rotation (radians), centre (baselines), focal length (fraction), principal point
/// (pixels), distortion.
const STEPS: [f64; 5] = [1e-5, 1e-4, 1e-5, 1e-2, 1e-5];

/// A capture's calibration errors as unknowns.
pub struct CalibrationUnknowns<'a> {
    errors: &'a CalibrationErrors,
    /// The cameras as they are calibrated.
    cameras: Vec<&'a Camera>,
    /// L, with a row for each error and a column for each independent unknown: L Lᵀ is the covariance.
    pub factor: DMatrix<f64>,
}

impl<'a> CalibrationUnknowns<'a> {
    pub fn new(errors: &'a CalibrationErrors, cameras: Vec<&'a Camera>) -> Self {
        let std = errors.covariance.diagonal().map(|v| v.max(0.0).sqrt());
        let scale = std.map(|s| if s > 0.0 { s.recip() } else { 0.0 });
        let scaled =
            DMatrix::from_diagonal(&scale) * &errors.covariance * DMatrix::from_diagonal(&scale);
        if scaled.is_empty() {
            return Self { errors, cameras, factor: scaled };
        }
        let eigen = scaled.symmetric_eigen();
        let largest = eigen.eigenvalues.iter().copied().fold(0.0, f64::max);
        let count = eigen.eigenvalues.len();
        let kept: Vec<usize> =
            (0..count).filter(|&k| eigen.eigenvalues[k] > MIN_EIGENVALUE * largest).collect();
        let factor = DMatrix::from_fn(count, kept.len(), |row, column| {
            let k = kept[column];
            std[row] * eigen.eigenvectors[(row, k)] * eigen.eigenvalues[k].sqrt()
        });
        Self { errors, cameras, factor }
    }

    /// How the offset of each of a pair's samples changes with the errors of its two cameras.
    pub fn slopes(&self, cameras: [usize; 2], samples: &[(Sample, f64)]) -> SampleSlopes {
        let parameters = self.errors.parameters.iter().enumerate();
        let of_pair: Vec<(usize, usize, CameraParameter)> = parameters
            .filter(|(_, (camera, _))| cameras.contains(camera))
            .map(|(column, (camera, parameter))| (column, *camera, *parameter))
            .collect();
        let [i, j] = cameras;
        let directions =
            [[i, j], [j, i]].map(|direction| ChangedPair::all(self, direction, &of_pair));
        let mut values = Vec::with_capacity(samples.len() * of_pair.len());
        for (sample, _) in samples {
            let changed = &directions[usize::from(sample.cameras != cameras)];
            values.extend(changed.iter().map(|c| c.slope(self, sample).unwrap_or(0.0)));
        }
        SampleSlopes { columns: of_pair.iter().map(|p| p.0).collect(), values }
    }
}

/// How the offsets of a pair's samples, [`Sample::offset_s`], change with the calibration's errors, seconds per unit.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SampleSlopes {
    /// The errors of the pair's two cameras, as rows of the covariance.
    columns: Vec<usize>,
    /// Sample after sample: a slope for each of `columns`.
    values: Vec<f64>,
}

impl SampleSlopes {
    #[cfg(test)]
    pub fn new(columns: Vec<usize>, values: Vec<f64>) -> Self {
        Self { columns, values }
    }

    /// The slopes of one sample as (error, slope); none without calibration errors.
    pub fn of(&self, sample: usize) -> impl Iterator<Item = (usize, f64)> {
        let count = self.columns.len();
        let own = self.values.get(sample * count..(sample + 1) * count).unwrap_or_default();
        self.columns.iter().copied().zip(own.iter().copied())
    }

    /// By how much these errors change the offset of a sample, seconds.
    pub fn change_s(&self, sample: usize, errors: &DVector<f64>) -> f64 {
        self.of(sample).map(|(column, slope)| slope * errors[column]).sum()
    }

    /// The standard deviation of the mean of samples with these weights, which the errors alone cause, seconds; 0
    /// without weights. `signed` has a weight for each sample, negative where its offset counts negatively.
    pub fn std_err_s(&self, signed: &[f64], factor: &DMatrix<f64>) -> f64 {
        let total: f64 = signed.iter().map(|w| w.abs()).sum();
        let mut mean = DVector::zeros(factor.nrows());
        for (k, weight) in signed.iter().enumerate() {
            for (column, slope) in self.of(k) {
                mean[column] += weight * slope;
            }
        }
        if total > 0.0 { factor.tr_mul(&mean).norm() / total } else { 0.0 }
    }
}

/// The epipolar geometry of cameras a and b with one number a little smaller and a little larger.
struct ChangedPair {
    cameras: [[Camera; 2]; 2],
    geometry: [Option<EpipolarGeometry>; 2],
    /// Whether undistorted pixels change.
    is_of_lens: bool,
    /// The difference between the two values.
    difference: f64,
}

impl ChangedPair {
    /// One for each of the errors of the two cameras a and b.
    fn all(
        unknowns: &CalibrationUnknowns,
        [a, b]: [usize; 2],
        parameters: &[(usize, usize, CameraParameter)],
    ) -> Vec<Self> {
        let [camera_a, camera_b] = [a, b].map(|c| unknowns.cameras[c]);
        let baseline_m = (camera_b.center() - camera_a.center()).norm();
        let changed = |&(_, camera, parameter): &(usize, usize, CameraParameter)| {
            let [rotation, baselines, focal, principal_point, distortion] = STEPS;
            let step = match parameter {
                CameraParameter::Rotation(_) => rotation,
                CameraParameter::Center(_) => baselines * baseline_m,
                CameraParameter::Focal => focal,
                CameraParameter::PrincipalPoint(_) => principal_point,
                CameraParameter::Distortion(_) => distortion,
            };
            let cameras = [-step, step].map(|by| {
                let of = |c: usize, given: &Camera| {
                    if c == camera { given.with_change(parameter, by) } else { given.clone() }
                };
                [of(a, camera_a), of(b, camera_b)]
            });
            let geometry = [0, 1].map(|k: usize| {
                let [a, b] = &cameras[k];
                EpipolarGeometry::new(b, a)
            });
            let (is_of_lens, difference) = (parameter.is_of_lens(), 2.0 * step);
            Self { cameras, geometry, is_of_lens, difference }
        };
        parameters.iter().map(changed).collect()
    }

    /// The slope of a sample's offset; `None` where the geometry or a lens has no value.
    fn slope(&self, unknowns: &CalibrationUnknowns, sample: &Sample) -> Option<f64> {
        let sight = &sample.sight;
        let given = sample.cameras.map(|c| unknowns.cameras[c].model);
        let (fx, fy, cx, cy) = given[0].intrinsics();
        let at = Point2::new((sight.ideal_a.x - cx) / fx, (sight.ideal_a.y - cy) / fy);
        let mut distances = [0.0; 2];
        for (k, distance) in distances.iter_mut().enumerate() {
            let models = if self.is_of_lens {
                [0, 1].map(|c: usize| self.cameras[k][c].model)
            } else {
                given
            };
            let ideal_a = if self.is_of_lens {
                models[0].ideal_from_pixel(&given[0].pixel_from_normalized(&at))?
            } else {
                sight.ideal_a
            };
            let line =
                self.geometry[k].as_ref()?.line_in_j(&models[1].ideal_from_pixel(&sight.in_b)?)?;
            *distance = line.distance(&ideal_a);
        }
        // A normal may point to either side; its sign is that of the speed, which changes only slightly.
        let slope = (distances[1] - distances[0]) / self.difference / sight.across_px_s;
        slope.is_finite().then_some(-slope)
    }
}
