//! Tests of the calibration errors in the joint solution, and a synthetic recording for other tests.

use super::calibration::{CalibrationUnknowns, SampleSlopes};
use super::clock::ClockModel;
use super::joint::{ClockLayout, solve_clocks};
use super::pair::PairEstimate;
use super::recording::{Sample, Sight};
use crate::camera::{Camera, CameraModel, CameraParameter, EpipolarGeometry};
use crate::capture::{CalibrationErrors, Capture};
use crate::random::Random;
use crate::raster::{BitDepth, Image, write_image};
use nalgebra::{DMatrix, DVector, Isometry3, Point2, Translation3, UnitQuaternion, Vector2};
use std::path::Path;
use std::sync::Arc;

/// A recording by cameras in a row, 128×96 pixels and 4 pixels of disparity apart, of a textured plane that moves
/// vertically.
pub(super) struct PlaneRecording {
    pub cameras: usize,
    pub frames: usize,
    pub rate_hz: f64,
}

impl PlaneRecording {
    /// Writes the capture into the folder. `lift_px` gives how far the plane is up, pixels, in a camera's frame. The
    /// capture's clocks all begin at 0, with unknown offsets.
    pub fn write(&self, folder: &Path, lift_px: impl Fn(usize, usize) -> f64) -> Arc<Capture> {
        let (w, h) = (128, 96);
        let mut cameras = Vec::new();
        for c in 0..self.cameras {
            for n in 0..self.frames {
                let lift_px = lift_px(c, n);
                let value = |k: usize| {
                    let x = (k % w) as f64 + 4.0 * c as f64;
                    let y = (k / w) as f64 + lift_px;
                    let waves = (0.71 * x + 0.2 * y).sin() * (0.63 * y - 0.11 * x).cos()
                        + (0.23 * x).cos() * (0.31 * y + 1.0).sin();
                    (0.5 + 0.2 * waves) as f32
                };
                let image = Image::from_data(w, h, 1, (0..w * h).map(value).collect());
                let path = folder.join(format!("cam{c}/{n:04}.png"));
                write_image(&path, &image, None, BitDepth::Sixteen).unwrap();
            }
            cameras.push(serde_json::json!({
                "id": format!("cam{c}"), "frames": format!("cam{c}/%04d.png"),
                "width": w, "height": h, "model": "PINHOLE", "params": [100, 100, 64, 48],
                "cam_from_world": {
                    "rotation_wxyz": [1, 0, 0, 0], "translation": [-0.08 * c as f64, 0, 0]
                },
                "color": "gray",
                "clock": {"rate_hz": self.rate_hz, "first_s": 0.0, "shared": false}
            }));
        }
        let capture = serde_json::json!({
            "format": "stlfr-capture", "version": 1, "name": "plane", "cameras": cameras
        });
        std::fs::write(folder.join("capture.json"), capture.to_string()).unwrap();
        Arc::new(Capture::open(folder).unwrap())
    }
}

fn camera(x_m: f64, model: CameraModel) -> Camera {
    let rotation = UnitQuaternion::from_euler_angles(0.02, -0.3 * x_m, 0.01);
    let translation = Translation3::from(-(rotation * nalgebra::Vector3::new(x_m, 0.0, 0.0)));
    let cam_from_world = Isometry3::from_parts(translation, rotation);
    Camera { width: 640, height: 480, model, cam_from_world }
}

/// Returns the time at which a straight trajectory in camera a crosses the epipolar line of the pixel `in_b` of
/// camera b, seconds. `track` holds the trajectory's pixels in camera a at 0 s and at 1 s.
fn crossing_s([a, b]: [&Camera; 2], track: [Point2<f64>; 2], in_b: &Point2<f64>) -> f64 {
    let geometry = EpipolarGeometry::new(b, a).unwrap();
    let line = geometry.line_in_j(&b.model.ideal_from_pixel(in_b).unwrap()).unwrap();
    let [near, far] = track.map(|p| line.distance(&a.model.ideal_from_pixel(&p).unwrap()));
    near / (near - far)
}

#[test]
fn slopes_are_how_crossings_move() {
    let radial = CameraModel::Radial { f: 600.0, cx: 320.0, cy: 240.0, k: [-0.1, 0.02] };
    let pinhole = CameraModel::Pinhole { fx: 600.0, fy: 610.0, cx: 322.0, cy: 238.0 };
    let (a, b) = (camera(0.0, radial), camera(0.15, pinhole));
    let all = CameraParameter::POSE.into_iter().chain([
        CameraParameter::Focal,
        CameraParameter::PrincipalPoint(0),
        CameraParameter::PrincipalPoint(1),
        CameraParameter::Distortion(0),
    ]);
    let parameters: Vec<_> = all.flat_map(|p| [(0, p), (1, p)]).collect();
    let covariance = DMatrix::identity(parameters.len(), parameters.len());
    let errors = CalibrationErrors { parameters, covariance };
    let unknowns = CalibrationUnknowns::new(Some(&errors), vec![&a, &b], &[0.0, 0.0]);
    let point = nalgebra::Point3::new(0.3, 0.2, 2.0);
    let in_b = b.project(&point).unwrap();
    let middle = a.project(&point).unwrap();
    let motion = Vector2::new(3.0, 8.0);
    let track = [middle - 0.5 * motion, middle + 0.5 * motion];
    let time_a_s = crossing_s([&a, &b], track, &in_b);
    let [from, to] = track.map(|p| a.model.ideal_from_pixel(&p).unwrap());
    let geometry = EpipolarGeometry::new(&b, &a).unwrap();
    let line = geometry.line_in_j(&b.model.ideal_from_pixel(&in_b).unwrap()).unwrap();
    let across_px_s = line.normal.dot(&(to - from));
    let sight = Sight { ideal_a: from + time_a_s * (to - from), in_b, across_px_s };
    let (cell, window) = (0, 0);
    let sample =
        Sample { cameras: [0, 1], time_a_s, time_b_s: 0.0, across_px_s, cell, window, sight };
    let slopes = unknowns.slopes([0, 1], &[(sample, 1.0)]);
    assert_eq!(slopes.of(0).count(), errors.parameters.len());
    for (column, slope) in slopes.of(0) {
        let (changed, parameter) = errors.parameters[column];
        let step = 1e-4;
        let moved = [&a, &b].map(|c| c.with_change(parameter, step));
        let cameras = if changed == 0 { [&moved[0], &b] } else { [&a, &moved[1]] };
        let expected = (crossing_s(cameras, track, &in_b) - time_a_s) / step;
        // The two ends of the trajectory are undistorted by slightly different amounts.
        let tolerance = 0.01 * expected.abs() + 1e-3;
        assert!(
            (slope - expected).abs() < tolerance,
            "{changed} {parameter:?}: {slope} {expected}"
        );
    }
}

/// Checks that the error of a readout time shifts a feature's time in proportion to its image row.
#[test]
fn slopes_of_readouts_are_rows() {
    let radial = CameraModel::Radial { f: 600.0, cx: 320.0, cy: 240.0, k: [-0.1, 0.02] };
    let pinhole = CameraModel::Pinhole { fx: 600.0, fy: 610.0, cx: 322.0, cy: 238.0 };
    let cameras = [camera(0.0, radial), camera(0.15, pinhole)];
    let unknowns = CalibrationUnknowns::new(None, cameras.iter().collect(), &[0.01, 0.02]);
    assert_eq!((unknowns.readout(0), unknowns.readout(1)), (Some(0), Some(1)));
    assert_eq!(unknowns.factor, DMatrix::from_row_slice(2, 2, &[0.01, 0.0, 0.0, 0.02]));
    // The pixels are at the middles of the first row and of the last row.
    let pixels = [Point2::new(100.0, 0.5), Point2::new(90.0, 479.5)];
    for (a, b) in [(0, 1), (1, 0)] {
        let ideal_a = cameras[a].model.ideal_from_pixel(&pixels[a]).unwrap();
        let sight = Sight { ideal_a, in_b: pixels[b], across_px_s: 1.0 };
        let (time_a_s, time_b_s, across_px_s, cell, window) = (0.0, 0.0, 1.0, 0, 0);
        let sample =
            Sample { cameras: [a, b], time_a_s, time_b_s, across_px_s, cell, window, sight };
        let slopes = unknowns.slopes([0, 1], &[(sample, 1.0)]);
        let found: Vec<(usize, f64)> = slopes.of(0).collect();
        let sign = if a == 0 { 1.0 } else { -1.0 };
        for (k, slope) in found {
            assert!((slope - sign * 0.5).abs() < 1e-3, "{a} {k}: {slope}");
        }
    }
}

/// Simulates the estimate of one pair of cameras. Its offset candidates have noise, and the calibration errors
/// `error` shift them.
fn pair(
    cameras: [usize; 2],
    truth_s: [f64; 2],
    error: &DVector<f64>,
    random: &mut Random,
) -> PairEstimate {
    let columns = vec![2 * cameras[0], 2 * cameras[0] + 1, 2 * cameras[1], 2 * cameras[1] + 1];
    let (mut samples, mut values) = (Vec::new(), Vec::new());
    for k in 0..240 {
        let across_px_s: f64 = 60.0 + 30.0 * random.gaussian();
        let place = random.unit() - 0.5;
        // Each camera has two errors across the epipolar lines: a shift of the whole image, and a shift in proportion
        // to the position.
        let own = [1.0, place, -1.0, -place].map(|px| px / across_px_s);
        let of_errors: f64 = columns.iter().zip(own).map(|(c, slope)| slope * error[*c]).sum();
        let noise_s = 0.05 * random.gaussian() / across_px_s;
        let time_b_s = 0.04 * f64::from(k / 20);
        let time_a_s = time_b_s + truth_s[1] - truth_s[0] + of_errors + noise_s;
        let (cell, window, sight) = (k as usize % 20, k as usize, Sight::default());
        let sample = Sample { cameras, time_a_s, time_b_s, across_px_s, cell, window, sight };
        samples.push((sample, 400.0));
        values.extend(own);
    }
    let information = |s: &(Sample, f64)| s.1 * s.0.across_px_s.powi(2);
    let total: f64 = samples.iter().map(information).sum();
    let mean_s = samples.iter().map(|s| information(s) * s.0.offset_s()).sum::<f64>() / total;
    PairEstimate {
        cameras,
        clock: ClockModel::constant(mean_s),
        std_err_s: total.sqrt().recip(),
        std_err_inflation: 1.0,
        samples: samples.into(),
        slopes: Arc::new(SampleSlopes::new(columns, values)),
        ..PairEstimate::default()
    }
}

/// Checks that the errors of the offsets agree with their standard errors in 200 simulated arrays with wrong
/// calibrations. If the solution ignores the calibration errors, the standard errors are less than half of the errors.
#[test]
fn calibration_errors_are_in_the_standard_errors() {
    let random = &mut Random::new(7);
    let layout = ClockLayout {
        of_camera: vec![0, 1, 2, 3],
        first_s: vec![0.0; 4],
        drifts: vec![false; 4],
        frame_s: 0.04,
    };
    let std = [0.5, 0.2];
    let factor = DMatrix::from_diagonal(&DVector::from_fn(8, |k, _| std[k % 2]));
    let (mut with, mut without, mut errors_s, mut of_errors) = (0.0, 0.0, [0.0; 2], 0.0);
    let arrays = 200;
    for _ in 0..arrays {
        let truth_s = [0.0, 0.01, -0.02, 0.005];
        let error = DVector::from_fn(8, |k, _| std[k % 2] * random.gaussian());
        let indices = [[0, 1], [1, 2], [2, 3], [0, 2], [1, 3]];
        let pairs: Vec<_> = indices
            .iter()
            .map(|&c| pair(c, c.map(|k: usize| truth_s[k]), &error, random))
            .collect();
        let exact = solve_clocks(&pairs, &layout, None).by_clock;
        let solved = solve_clocks(&pairs, &layout, Some(&factor));
        assert_eq!((solved.errors.len(), solved.error_std_errs.len()), (8, 8));
        for k in 0..8 {
            of_errors += ((solved.errors[k] - error[k]) / solved.error_std_errs[k]).powi(2);
        }
        for c in 1..4 {
            let (s, e) = (solved.by_clock[c].as_ref().unwrap(), exact[c].as_ref().unwrap());
            let off = [s, e].map(|x| x.clock.offset_s - truth_s[c]);
            with += (off[0] / s.std_err_s).powi(2);
            without += (off[1] / e.std_err_s).powi(2);
            errors_s[0] += off[0].powi(2);
            errors_s[1] += off[1].powi(2);
        }
    }
    let n = f64::from(3 * arrays);
    let [z, z_without] = [with, without].map(|sum| (sum / n).sqrt());
    assert!((0.7..1.25).contains(&z) && z_without > 2.0, "{z} {z_without}");
    assert!(errors_s[0] < 0.5 * errors_s[1], "{errors_s:?}");
    let z = (of_errors / f64::from(8 * arrays)).sqrt();
    assert!((0.6..1.1).contains(&z), "errors of the calibration: {z}");
}

/// Checks a covariance of lower rank than its size, as of a calibration whose gauge is fixed: two errors that are always
/// equal. Without pairs, the standard errors are those of the prior.
#[test]
fn a_covariance_may_lack_rank() {
    let random = &mut Random::new(9);
    let layout = ClockLayout {
        of_camera: vec![0, 1],
        first_s: vec![0.0; 2],
        drifts: vec![false; 2],
        frame_s: 0.04,
    };
    let factor = DMatrix::from_row_slice(4, 2, &[0.5, 0.0, 0.0, 0.2, 0.5, 0.0, 0.0, 0.1]);
    let error = &factor * DVector::from_vec(vec![1.0, -0.5]);
    let pairs = [pair([0, 1], [0.0, 0.01], &error, random)];
    let solved = solve_clocks(&pairs, &layout, Some(&factor));
    let clock = solved.by_clock[1].as_ref().unwrap();
    assert!((clock.clock.offset_s - 0.01).abs() < 2.0 * clock.std_err_s, "{clock:?}");
    assert!((solved.errors[0] - solved.errors[2]).abs() < 1e-9, "{}", solved.errors);
    let unseen = solve_clocks(&[], &layout, Some(&factor));
    assert_eq!(unseen.error_std_errs, DVector::from_vec(vec![0.5, 0.2, 0.5, 0.1]));
}

#[test]
fn a_mean_has_the_common_error_of_its_samples() {
    let slopes = SampleSlopes::new(vec![0, 1], vec![2.0, 0.0, 4.0, -3.0]);
    let factor = DMatrix::from_row_slice(2, 2, &[0.1, 0.0, 0.0, 0.2]);
    let std_err_s = slopes.std_err_s(&[3.0, 1.0], &factor);
    assert!((std_err_s - (0.25_f64.powi(2) + 0.15_f64.powi(2)).sqrt()).abs() < 1e-12);
    assert_eq!(slopes.std_err_s(&[0.0, 0.0], &factor), 0.0);
    assert_eq!(SampleSlopes::default().of(3).count(), 0);
}
