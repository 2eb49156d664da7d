//! Generates rig files from a few options. Equal options give files with the same bytes.

use super::check::{FieldCheck, FieldError, wrong};
use super::format::{Rig, RigCamera, RigColor, RigDistortion, RigView};
use super::limits::{FORMAT, MAX_CAMERAS, MAX_LOSS_WITHIN, VERSION};
use crate::camera::PoseFormat;
use crate::capture::MAX_DRIFT_PPM;
use crate::method::methods;
use crate::random::Random;
use crate::text::number;
use nalgebra::{UnitQuaternion, Vector3};
use serde::Deserialize;
use std::num::NonZeroUsize;

/// Arrangement of a rig's cameras. All cameras look along the rig's +z axis, except in an arc.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(rename_all = "lowercase", deny_unknown_fields)]
pub enum RigLayout {
    /// Cameras in a line, from left to right.
    Line { count: NonZeroUsize },
    /// Cameras in a grid, row by row from the top left.
    Grid { rows: NonZeroUsize, columns: NonZeroUsize },
    /// Cameras on a circle, from left to right. All look at the centre of the circle, which is `distance_m` metres
    /// straight ahead of the rig's centre. Their spacing is measured along the arc.
    Arc { count: NonZeroUsize, distance_m: f64 },
}

impl RigLayout {
    /// Returns the number of cameras; `usize::MAX` if rows times columns overflows.
    fn count(&self) -> usize {
        match self {
            Self::Line { count } | Self::Arc { count, .. } => count.get(),
            Self::Grid { rows, columns } => rows.get().saturating_mul(columns.get()),
        }
    }
}

/// Delays: times from the scene's start to the cameras' first frames.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(rename_all = "lowercase", deny_unknown_fields)]
pub enum Delays {
    /// All cameras start at the scene's start.
    None,
    /// The delay of each camera is uniformly random within one of its frame intervals.
    Random,
    /// Delays in seconds. Camera k takes entry k of the list. If the list is shorter, the cameras start again from its
    /// first entry.
    Listed(Vec<f64>),
}

/// Whether the frames that a simulated camera loses leave gaps in its time stamps.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum LossStamps {
    /// Every lost frame leaves a gap in the time stamps.
    #[default]
    Stamped,
    /// No lost frame leaves a gap in the time stamps.
    Hidden,
    /// In every second camera, from the first on, lost frames leave gaps in the time stamps. In the other cameras, they
    /// don't.
    Mixed,
}

methods!(LossStamps {
    Stamped = "stamped": "Times have gaps",
    Hidden = "hidden": "Times have no gaps",
    Mixed = "mixed": "Either in turn, by camera",
});

/// Settings for the frames that simulated cameras lose. They apply to all cameras except the reference camera, which
/// loses none.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Loss {
    /// Number of frames that each camera loses.
    pub count: usize,
    /// Exclusive upper bound on the numbers of lost frames, which are drawn at random from 1 to `within − 1`. Frame 0
    /// is never lost.
    pub within: usize,
    /// Whether lost frames leave gaps in the time stamps.
    pub stamps: LossStamps,
}

/// Options of a generated rig.
///
/// An option that is a list has values for several cameras. The cameras take its entries in turn, and start again from
/// the first entry after the last. No list may be empty.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RigOptions {
    pub name: String,
    pub layout: RigLayout,
    /// Distance between the centres of neighbouring cameras, metres.
    pub spacing_m: f64,
    /// Widths and heights of images, pixels. The cameras take the entries in turn.
    pub sizes_px: Vec<(u32, u32)>,
    /// Focal lengths, millimetres. The cameras take the entries in turn.
    pub lenses_mm: Vec<f64>,
    /// Length of all sensors along their longer side, millimetres.
    pub sensor_width_mm: f64,
    /// Distortion of all lenses.
    pub distortion: RigDistortion,
    /// Frame rates, hertz. The cameras take the entries in turn.
    pub rates_hz: Vec<f64>,
    /// Times from the scene's start to the cameras' first frames.
    pub delays: Delays,
    /// Standard deviations of the jitter (the random errors in the times of exposures), seconds. The cameras take the
    /// entries in turn.
    pub jitters_s: Vec<f64>,
    /// Whether the cameras' time stamps include the jitter, the random errors in the times of exposures.
    pub jitter_stamped: bool,
    /// Maximum absolute drift of the cameras' clocks, parts per million. The drift of each clock is uniformly random
    /// between minus this value and this value. The reference camera's clock has no drift.
    pub max_drift_ppm: f64,
    /// Settings for lost frames. `None` if no frames are lost.
    pub loss: Option<Loss>,
    /// Whether all cameras share one clock.
    pub clock_shared: bool,
    /// Times for which shutters are open, seconds. The cameras take the entries in turn.
    pub exposures_s: Vec<f64>,
    /// Readout times of rolling shutters, seconds; 0 for a global shutter. The cameras take the entries in turn.
    pub readouts_s: Vec<f64>,
    /// Gains: factors on the linear light, before display encoding. The cameras take the entries in turn.
    pub gains: Vec<f64>,
    /// Standard deviations of sensor noise, on the scale of display-encoded pixel values from 0 to 1. The cameras take
    /// the entries in turn.
    pub noises: Vec<f64>,
    /// Whether cameras record colours or luminance alone. The cameras take the entries in turn.
    pub colors: Vec<RigColor>,
    /// Bits per channel of all images, 8 or 16.
    pub bit_depth: u32,
    /// Seed from which random delays, drifts and lost frames are drawn. It is also written into the field `seed` of the
    /// rig file.
    pub seed: u64,
}

/// The paper's rig: eight cameras in a line, 60 mm apart, 640×480 at 30 Hz.
impl Default for RigOptions {
    fn default() -> Self {
        Self {
            name: "rig".into(),
            layout: RigLayout::Line { count: NonZeroUsize::MIN.saturating_add(7) },
            spacing_m: 0.06,
            sizes_px: vec![(640, 480)],
            lenses_mm: vec![38.6],
            sensor_width_mm: 36.0,
            distortion: RigDistortion::default(),
            rates_hz: vec![30.0],
            delays: Delays::Random,
            jitters_s: vec![0.001],
            jitter_stamped: true,
            max_drift_ppm: 0.0,
            loss: None,
            clock_shared: false,
            exposures_s: vec![0.0],
            readouts_s: vec![0.0],
            gains: vec![1.0],
            noises: vec![0.0],
            colors: vec![RigColor::Rgb],
            bit_depth: 8,
            seed: 0,
        }
    }
}

/// Pose of a generated camera in the rig's frame: its centre in metres, and its rotation about the vertical axis.
#[derive(Clone, Copy)]
struct Stand {
    center: Vector3<f64>,
    /// Rotation to the left about the vertical axis, radians.
    yaw_rad: f64,
}

/// Translations in metres and quaternions are rounded to multiples of 1 / `POSE_STEPS`. Files are then equal on
/// platforms whose sine functions differ in the last digits.
const POSE_STEPS: f64 = 1e9;
/// Delays are rounded to multiples of 1 / `TIME_STEPS` seconds, that is, to microseconds.
const TIME_STEPS: f64 = 1e6;
/// Drifts are rounded to multiples of 1 / `DRIFT_STEPS` parts per million.
const DRIFT_STEPS: f64 = 1e3;

impl RigOptions {
    /// Generates and checks the rig.
    ///
    /// # Errors
    /// The first invalid option, or the first invalid field of the rig.
    pub fn generate(&self) -> Result<Rig, FieldError> {
        self.check()?;
        let stands = self.stands();
        let reference = reference(&stands);
        let mut delays = Random::stream(self.seed, "delays");
        let mut drifts = Random::stream(self.seed, "drifts");
        let mut losses = Random::stream(self.seed, "losses");
        let cameras: Vec<RigCamera> = stands
            .iter()
            .enumerate()
            .map(|(i, stand)| {
                let rate_hz = turn(&self.rates_hz, i);
                let within_frame = delays.unit() / rate_hz;
                let drift_ppm = self.max_drift_ppm * (2.0 * drifts.unit() - 1.0);
                let lost = self.loss.map(|loss| draw(&mut losses, loss)).unwrap_or_default();
                let is_reference = i == reference;
                RigCamera {
                    rate_hz,
                    delay_s: match &self.delays {
                        Delays::None => 0.0,
                        Delays::Random => round(within_frame, TIME_STEPS),
                        Delays::Listed(listed) => turn(listed, i),
                    },
                    drift_ppm: if is_reference { 0.0 } else { round(drift_ppm, DRIFT_STEPS) },
                    lost_frames: if is_reference { Vec::new() } else { lost },
                    lost_stamped: is_reference || !self.loss.is_some_and(|loss| loss.hides(i)),
                    ..self.camera(i, stand)
                }
            })
            .collect();
        let rig = Rig {
            format: FORMAT.into(),
            version: VERSION,
            name: self.name.clone(),
            reference: cameras[reference].id.clone(),
            seed: self.seed,
            views: self.views(&cameras[reference], &stands, reference),
            cameras,
        };
        rig.check()?;
        Ok(rig)
    }

    fn check(&self) -> FieldCheck {
        let empty = [
            ("list of sizes", self.sizes_px.is_empty()),
            ("list of lenses", self.lenses_mm.is_empty()),
            ("list of rates", self.rates_hz.is_empty()),
            ("list of delays", self.delays == Delays::Listed(Vec::new())),
            ("list of jitters", self.jitters_s.is_empty()),
            ("list of exposures", self.exposures_s.is_empty()),
            ("list of readouts", self.readouts_s.is_empty()),
            ("list of gains", self.gains.is_empty()),
            ("list of noises", self.noises.is_empty()),
            ("list of colours", self.colors.is_empty()),
        ];
        if let Some((name, _)) = empty.into_iter().find(|(_, empty)| *empty) {
            return wrong(format!("the {name}"), "must not be empty");
        }
        let count = self.layout.count();
        if count > MAX_CAMERAS {
            return wrong("a rig", format!("has from 1 to {MAX_CAMERAS} cameras, not {count}"));
        }
        let drift_ppm = self.max_drift_ppm;
        if !(0.0..=MAX_DRIFT_PPM).contains(&drift_ppm) {
            let reason =
                format!("must be from 0 to {MAX_DRIFT_PPM} ppm, not {}", number(drift_ppm));
            return wrong("the largest drift", reason);
        }
        if let RigLayout::Arc { count, distance_m } = self.layout {
            let half_width_m = 0.5 * self.spacing_m.abs() * (count.get() - 1) as f64;
            if !(distance_m > half_width_m && distance_m.is_finite()) {
                let reason = format!(
                    "needs a distance over half the array's width, not {} m",
                    number(distance_m)
                );
                return wrong("an arc", reason);
            }
        }
        let Some(Loss { count, within, .. }) = self.loss else { return Ok(()) };
        if count >= within {
            let reason = format!("don't fit among the frames 1 to {}", within.saturating_sub(1));
            return wrong(format!("{count} lost frames"), reason);
        }
        if within > MAX_LOSS_WITHIN {
            let reason = format!("must be among the first {MAX_LOSS_WITHIN}, not {within}");
            return wrong("lost frames", reason);
        }
        Ok(())
    }

    fn stands(&self) -> Vec<Stand> {
        let along = |k: usize, n: usize| (k as f64 - 0.5 * (n - 1) as f64) * self.spacing_m;
        match self.layout {
            RigLayout::Line { count } => {
                (0..count.get()).map(|k| Stand::ahead(along(k, count.get()), 0.0)).collect()
            }
            RigLayout::Grid { rows, columns } => (0..rows.get() * columns.get())
                .map(|k| (k / columns.get(), k % columns.get()))
                .map(|(row, column)| {
                    Stand::ahead(along(column, columns.get()), along(row, rows.get()))
                })
                .collect(),
            RigLayout::Arc { count, distance_m } => (0..count.get())
                .map(|k| along(k, count.get()) / distance_m)
                .map(|angle| on_arc(angle, distance_m))
                .collect(),
        }
    }

    /// Returns camera `i` of the rig, with the pose `stand`. The caller sets its frame rate, delay, drift and lost
    /// frames.
    fn camera(&self, i: usize, stand: &Stand) -> RigCamera {
        let (width, height) = turn(&self.sizes_px, i);
        RigCamera {
            id: format!("cam{i}"),
            width,
            height,
            lens_mm: turn(&self.lenses_mm, i),
            sensor_width_mm: self.sensor_width_mm,
            shift_x: 0.0,
            shift_y: 0.0,
            distortion: self.distortion,
            cam_from_rig: stand.cam_from_rig(),
            rate_hz: 0.0,
            delay_s: 0.0,
            jitter_s: turn(&self.jitters_s, i),
            jitter_stamped: self.jitter_stamped,
            drift_ppm: 0.0,
            lost_frames: Vec::new(),
            lost_stamped: true,
            clock_shared: self.clock_shared,
            exposure_s: turn(&self.exposures_s, i),
            readout_s: turn(&self.readouts_s, i),
            gain: turn(&self.gains, i),
            gain_drift_per_s: [0.0; 3],
            noise: turn(&self.noises, i),
            color: turn(&self.colors, i),
            bit_depth: self.bit_depth,
        }
    }

    /// Returns two virtual cameras with the reference camera's lens. The first is halfway between neighbouring cameras
    /// near the rig's centre. The second is to the left of the first, above it, and in front of it.
    fn views(&self, like: &RigCamera, stands: &[Stand], reference: usize) -> Vec<RigView> {
        let beside = 0.5 * self.spacing_m;
        let between = match self.layout {
            // If a camera stands in the middle, the virtual camera is halfway to its neighbour.
            RigLayout::Line { count } if count.get() % 2 == 1 => Stand::ahead(beside, 0.0),
            RigLayout::Grid { rows, columns } => {
                let aside = |n: usize| if n % 2 == 1 { beside } else { 0.0 };
                Stand::ahead(aside(columns.get()), aside(rows.get()))
            }
            RigLayout::Arc { count, distance_m } if count.get() % 2 == 1 => {
                on_arc(beside / distance_m, distance_m)
            }
            _ => Stand::ahead(0.0, 0.0),
        };
        // The second virtual camera is to the left of `between`, above it, and in front of it.
        let off = Vector3::new(-1.0, -0.4, 0.5) * self.spacing_m;
        let above = Stand { center: between.center + off, yaw_rad: stands[reference].yaw_rad };
        [("between", between), ("above", above)]
            .map(|(id, stand)| RigView {
                id: id.into(),
                cam_from_rig: stand.cam_from_rig(),
                ..like.view()
            })
            .into()
    }
}

impl Loss {
    fn hides(&self, camera: usize) -> bool {
        match self.stamps {
            LossStamps::Stamped => false,
            LossStamps::Hidden => true,
            LossStamps::Mixed => camera % 2 == 1,
        }
    }
}

impl Stand {
    /// Returns the pose of a camera at (x, y, 0) that looks along +z.
    fn ahead(x: f64, y: f64) -> Self {
        Self { center: Vector3::new(x, y, 0.0), yaw_rad: 0.0 }
    }

    fn cam_from_rig(&self) -> PoseFormat {
        let rotation = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), self.yaw_rad);
        let translation = rotation * -self.center;
        let rounded = |v: f64| round(v, POSE_STEPS);
        PoseFormat {
            rotation_wxyz: [rotation.w, rotation.i, rotation.j, rotation.k].map(rounded),
            translation: [translation.x, translation.y, translation.z].map(rounded),
        }
    }
}

/// Returns the pose of a camera that looks at the point `distance_m` metres ahead of the rig's centre. The camera is on
/// the circle around this point through the rig's centre, at `angle` radians to the right of the rig's centre.
fn on_arc(angle: f64, distance_m: f64) -> Stand {
    let center = Vector3::new(angle.sin(), 0.0, 1.0 - angle.cos()) * distance_m;
    Stand { center, yaw_rad: angle }
}

/// Returns the index of the camera nearest to the rig's centre. If several are equally near, returns the first.
fn reference(stands: &[Stand]) -> usize {
    let distance = |s: &Stand| s.center.norm();
    let nearest = stands.iter().map(distance).fold(f64::INFINITY, f64::min);
    // Distances that differ only by rounding count as equal.
    stands.iter().position(|s| distance(s) <= nearest * (1.0 + 1e-9)).unwrap_or(0)
}

/// Draws the numbers of a camera's lost frames: distinct, from 1 to `within − 1`, in ascending order.
fn draw(random: &mut Random, loss: Loss) -> Vec<u32> {
    let mut remaining: Vec<u32> = (1..loss.within as u32).collect();
    let mut lost: Vec<u32> = (0..loss.count)
        .map(|_| remaining.swap_remove((random.unit() * remaining.len() as f64) as usize))
        .collect();
    lost.sort_unstable();
    lost
}

/// Returns the entry of a list that belongs to a camera. The cameras take the entries in turn, cyclically.
fn turn<T: Clone>(list: &[T], camera: usize) -> T {
    list[camera % list.len()].clone()
}

/// Rounds a value to the nearest multiple of 1 / `steps`. −0 becomes 0.
fn round(value: f64, steps: f64) -> f64 {
    (value * steps).round() / steps + 0.0
}
