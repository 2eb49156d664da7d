//! Accounts for calibration errors in the estimated offsets.
//!
//! An error in a pose or a focal length shifts all epipolar lines of a pair, and so changes the times at which
//! trajectories cross these lines. Such an error is common to all offset candidates of a camera (the offsets that
//! single features imply), so it does not average out. If the capture states a covariance C of its calibration errors,
//! the joint solution has these errors as further unknowns, with C as the covariance of their prior. The offsets are
//! then generalized least-squares estimates. Let J be the derivatives of the offsets by the errors. The covariance of
//! the offsets includes J C Jᵀ, reduced by what the candidates reveal about the errors.
//!
//! The offset candidates are linearized in the errors. The derivatives are central differences at the given
//! calibration. After each solution, the estimated errors are subtracted from the candidates, and the weights of the
//! candidates are fitted again.
//!
//! The error of a rolling shutter's readout time is such an unknown too. It changes a feature's time in proportion to
//! the distance of the feature's image row from the middle of the image.

use super::recording::Sample;
use crate::camera::{Camera, CameraParameter, EpipolarGeometry};
use crate::capture::{CalibrationErrors, RowTimes};
use nalgebra::{DMatrix, DVector, Point2};

/// The minimum eigenvalue that is used of the calibration errors' correlation matrix, as a fraction of the largest
/// eigenvalue. Smaller eigenvalues are rounding errors.
const MIN_EIGENVALUE: f64 = 1e-9;
/// The steps of the central differences by which derivatives with respect to calibration parameters are computed. They
/// are, in this order, for rotation (radians), camera centre (fraction of the baseline), focal length (fraction),
/// principal point (pixels), and distortion parameter.
const STEPS: [f64; 5] = [1e-5, 1e-4, 1e-5, 1e-2, 1e-5];

/// The calibration errors of a capture and the errors of its cameras' readout times, as unknowns of the joint solution
/// for all clocks.
pub struct CalibrationUnknowns<'a> {
    /// Each error, as (index of the camera, parameter that has the error).
    parameters: Vec<(usize, Parameter)>,
    /// The cameras with the calibration that the capture states.
    cameras: Vec<&'a Camera>,
    /// The matrix L, where L Lᵀ is the covariance of the errors. The errors are L y, where y are independent unknowns of
    /// variance 1. L has a row for each error, and a column for each entry of y.
    pub factor: DMatrix<f64>,
}

/// A parameter that has an error.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Parameter {
    Calibration(CameraParameter),
    /// The readout time of a rolling shutter. Its error is the true value minus the given value, seconds.
    Readout,
}

impl<'a> CalibrationUnknowns<'a> {
    /// Makes the unknowns. `errors` are the calibration errors, `None` if the calibration is exact. `readout_std_s` holds
    /// the standard error of each camera's readout time, seconds; a readout time without an error is no unknown.
    pub fn new(
        errors: Option<&CalibrationErrors>,
        cameras: Vec<&'a Camera>,
        readout_std_s: &[f64],
    ) -> Self {
        let of_calibration = errors.map(|e| factor(&e.covariance));
        let (rows, columns) = of_calibration.as_ref().map_or((0, 0), DMatrix::shape);
        let mut parameters: Vec<(usize, Parameter)> = errors
            .iter()
            .flat_map(|e| &e.parameters)
            .map(|&(camera, parameter)| (camera, Parameter::Calibration(parameter)))
            .collect();
        let uncertain: Vec<usize> =
            (0..readout_std_s.len()).filter(|&c| readout_std_s[c] > 0.0).collect();
        let mut factor = DMatrix::zeros(rows + uncertain.len(), columns + uncertain.len());
        if let Some(of_calibration) = of_calibration {
            factor.view_mut((0, 0), (rows, columns)).copy_from(&of_calibration);
        }
        for (k, &camera) in uncertain.iter().enumerate() {
            factor[(rows + k, columns + k)] = readout_std_s[camera];
            parameters.push((camera, Parameter::Readout));
        }
        Self { parameters, cameras, factor }
    }

    /// Returns the index of the error of a camera's readout time; `None` if the readout time is exact.
    pub fn readout(&self, camera: usize) -> Option<usize> {
        self.parameters.iter().position(|p| *p == (camera, Parameter::Readout))
    }

    /// Returns the derivatives of the offsets of a pair's samples (offset candidates) by the errors of the pair's two
    /// cameras. `samples` holds each sample with its weight, which is not used. A derivative that can't be
    /// computed is 0.
    pub fn slopes(&self, cameras: [usize; 2], samples: &[(Sample, f64)]) -> SampleSlopes {
        let parameters = self.parameters.iter().enumerate();
        let of_pair: Vec<(usize, usize, Parameter)> = parameters
            .filter(|(_, (camera, _))| cameras.contains(camera))
            .map(|(column, (camera, parameter))| (column, *camera, *parameter))
            .collect();
        let calibration = |&(column, camera, parameter): &(usize, usize, Parameter)| {
            let Parameter::Calibration(parameter) = parameter else { return None };
            Some((column, camera, parameter))
        };
        let of_calibration: Vec<_> = of_pair.iter().filter_map(calibration).collect();
        let readouts: Vec<usize> =
            of_pair.iter().filter(|p| p.2 == Parameter::Readout).map(|p| p.1).collect();
        let [i, j] = cameras;
        let directions =
            [[i, j], [j, i]].map(|direction| ChangedPair::all(self, direction, &of_calibration));
        let mut values = Vec::with_capacity(samples.len() * of_pair.len());
        for (sample, _) in samples {
            let changed = &directions[usize::from(sample.cameras != cameras)];
            values.extend(changed.iter().map(|c| c.slope(self, sample).unwrap_or(0.0)));
            values.extend(readouts.iter().map(|&camera| self.readout_slope(sample, camera)));
        }
        // The errors of readout times follow all others.
        SampleSlopes { columns: of_pair.iter().map(|p| p.0).collect(), values }
    }

    /// Returns the derivative of a sample's offset by the error of a camera's readout time, seconds per second. For
    /// camera b, it is the time of the feature's image row after the middle of the frame, in readout times; for camera
    /// a, it is minus this time. It is from −0.5 to 0.5 inside the image, and 0 if the row in camera a is unknown.
    fn readout_slope(&self, sample: &Sample, camera: usize) -> f64 {
        let [a, _] = sample.cameras;
        let own = self.cameras[camera];
        let rows = RowTimes::new(1.0, own.height);
        if camera != a {
            return rows.offset_s(sample.sight.in_b.y);
        }
        let (fx, fy, cx, cy) = own.model.intrinsics();
        let ideal = &sample.sight.ideal_a;
        let at = Point2::new((ideal.x - cx) / fx, (ideal.y - cy) / fy);
        let slope = -rows.offset_s(own.model.pixel_from_normalized(&at).y);
        if slope.is_finite() { slope } else { 0.0 }
    }
}

/// Returns the matrix L of a covariance L Lᵀ. L has a row for each row of the covariance, and a column for each
/// eigenvalue that isn't a rounding error.
fn factor(covariance: &DMatrix<f64>) -> DMatrix<f64> {
    let std = covariance.diagonal().map(|v| v.max(0.0).sqrt());
    let scale = std.map(|s| if s > 0.0 { s.recip() } else { 0.0 });
    let scaled = DMatrix::from_diagonal(&scale) * covariance * DMatrix::from_diagonal(&scale);
    if scaled.is_empty() {
        return scaled;
    }
    let eigen = scaled.symmetric_eigen();
    let largest = eigen.eigenvalues.iter().copied().fold(0.0, f64::max);
    let count = eigen.eigenvalues.len();
    let kept: Vec<usize> =
        (0..count).filter(|&k| eigen.eigenvalues[k] > MIN_EIGENVALUE * largest).collect();
    DMatrix::from_fn(count, kept.len(), |row, column| {
        let k = kept[column];
        std[row] * eigen.eigenvectors[(row, k)] * eigen.eigenvalues[k].sqrt()
    })
}

/// Derivatives of the offsets of a pair's samples ([`Sample::offset_s`]) by the calibration errors, seconds per unit
/// of the error.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SampleSlopes {
    /// Indices of the rows (and columns) of the covariance that belong to the parameters of the pair's two cameras.
    columns: Vec<usize>,
    /// The derivatives, sample by sample. Each sample has one derivative for each entry of `columns`.
    values: Vec<f64>,
}

impl SampleSlopes {
    #[cfg(test)]
    pub fn new(columns: Vec<usize>, values: Vec<f64>) -> Self {
        Self { columns, values }
    }

    /// Returns the derivatives of one sample's offset by the calibration errors, as (index of the error, derivative).
    /// Empty if there are no calibration errors.
    pub fn of(&self, sample: usize) -> impl Iterator<Item = (usize, f64)> {
        let count = self.columns.len();
        let own = self.values.get(sample * count..(sample + 1) * count).unwrap_or_default();
        self.columns.iter().copied().zip(own.iter().copied())
    }

    /// Returns the change of a sample's offset that the given calibration errors cause, seconds.
    pub fn change_s(&self, sample: usize, errors: &DVector<f64>) -> f64 {
        self.of(sample).map(|(column, slope)| slope * errors[column]).sum()
    }

    /// Returns the standard error that the calibration errors alone cause in the weighted mean of the samples' offsets,
    /// seconds; 0 if all weights are 0. `signed` holds the weight of each sample, negative for a sample whose offset
    /// enters the mean with the opposite sign. `factor` is the matrix L, where L Lᵀ is the covariance of the
    /// calibration errors.
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

/// Two epipolar geometries of cameras a and b: one with a calibration parameter decreased by a small step, and one with
/// the parameter increased by this step.
struct ChangedPair {
    cameras: [[Camera; 2]; 2],
    geometry: [Option<EpipolarGeometry>; 2],
    /// Whether the changed parameter belongs to the lens model, so that undistorted positions change too.
    is_of_lens: bool,
    /// The difference between the increased and the decreased value of the calibration parameter.
    difference: f64,
}

impl ChangedPair {
    /// Returns the changed geometries for each of `parameters`, which are calibration parameters of cameras a and b. A
    /// parameter is given as (index of its error, index of its camera, kind of parameter).
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

    /// Returns the derivative of a sample's offset by the changed calibration parameter, seconds per unit of the
    /// parameter. `None` if the cameras have no epipolar geometry, if a position can't be undistorted, or if the
    /// derivative is not finite.
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
        // The line's normal may point to either side. The sample's speed is measured along a normal on the same side,
        // since the line changes only slightly.
        let slope = (distances[1] - distances[0]) / self.difference / sight.across_px_s;
        slope.is_finite().then_some(-slope)
    }
}
