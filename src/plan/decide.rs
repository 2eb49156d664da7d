//! The decisions of a plan, the automatic choice of methods. Each function makes the decision for one stage of the
//! pipeline by a measured number, and gives the reason as a sentence.

use super::motion::MAX_NOISE;
use super::{Motion, Shape};
use crate::interpolation::SyncMethod;
use crate::light_field::{MAX_MATCHED_ANGLE_RAD, MIN_WIDE_ANGLE_RAD};
use crate::lumigraph::BlendMethod;
use crate::method::Method;
use crate::options::ProxyMethod;
use crate::registration::{GainCurve, Gains};
use serde::Serialize;

/// The choice of a method for one stage of the pipeline, with the reason of the choice.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Decision {
    /// Name of the stage, such as `sync`.
    pub stage: &'static str,
    /// Name of the chosen method, as in options files. A stage without methods has a word that describes the
    /// capture, such as `pinhole` for the lenses.
    pub method: &'static str,
    /// The measured number on which the decision is based, in pixels unless `because` names another unit. `None` if the
    /// decision is not based on a single number.
    pub measured: Option<f64>,
    /// The limit with which `measured` was compared, in the unit of `measured`; `None` if `measured` is `None`.
    pub limit: Option<f64>,
    /// The reason, as one sentence that contains the measured number.
    pub because: String,
}

impl Decision {
    /// Creates a decision without a measured number. [`Self::by`] can add the number.
    fn new(stage: &'static str, method: &'static str, because: impl Into<String>) -> Self {
        Self { stage, method, measured: None, limit: None, because: because.into() }
    }

    /// Adds the measured number on which the decision is based, and the limit with which this number was compared.
    fn by(self, measured: f64, limit: f64) -> Self {
        Self { measured: Some(measured), limit: Some(limit), ..self }
    }
}

/// Reports whether the cameras' temporal offsets have to be estimated. `clocks` has the index of each camera's clock.
/// Cameras with the same index share a clock; clock 0 is the reference camera's. `is_static` is true if every camera
/// took a single frame.
pub fn offsets(clocks: &[usize], is_static: bool) -> Decision {
    if is_static {
        let because = "Every camera took one frame, which is the same at any time.";
        return Decision::new("offsets", "none", because);
    }
    let cameras = clocks.len();
    let unknown = clocks.iter().filter(|clock| **clock != 0).count();
    if unknown == 0 {
        let because = format!("All {cameras} cameras share the reference's clock.");
        return Decision::new("offsets", "known clocks", because);
    }
    let because = format!("{unknown} of {cameras} cameras have clocks of their own.");
    Decision::new("offsets", "estimated", because)
}

/// Largest motion from one frame to the next at which the two frames are cross-faded, as a multiple of the error budget
/// `budget_px`. The multiple is 2, because halfway between the frames a cross-fade displaces each image by half of the
/// motion.
const CROSSFADE_BUDGETS: f64 = 2.0;

/// Chooses the sync method, which interpolates a camera's image between its frames, by the motion from frame to frame.
/// `budget_px` is the maximum position error, in pixels, that a cheaper method may cause.
pub fn sync(motion: &Motion, budget_px: f64) -> (SyncMethod, Decision) {
    let Motion { largest_px, residual_px, changed_fraction, .. } = *motion;
    let by = |method: SyncMethod, measured, limit, because: String| {
        (method, Decision::new("sync", method.name(), because).by(measured, limit))
    };
    if motion.pairs == 0 {
        let method = SyncMethod::Nearest;
        return (method, Decision::new("sync", method.name(), "There is one frame a camera."));
    }
    // The nearest frame is at most half a frame interval away, so its displacement is at most half of the motion.
    let nearest_px = 0.5 * largest_px;
    if nearest_px <= budget_px && changed_fraction == 0.0 {
        let because = format!(
            "Nothing moves by more than {largest_px:.2} px a frame, and no block of the images changes."
        );
        return by(SyncMethod::Nearest, nearest_px, budget_px, because);
    }
    if largest_px <= CROSSFADE_BUDGETS * budget_px {
        let because = format!(
            "Features move by {largest_px:.2} px a frame at most; {:.1} % of the blocks change.",
            100.0 * changed_fraction
        );
        return by(SyncMethod::Crossfade, largest_px, CROSSFADE_BUDGETS * budget_px, because);
    }
    if residual_px <= budget_px {
        let because = format!(
            "Features move by up to {largest_px:.1} px a frame, as their neighbours do to \
             {residual_px:.2} px."
        );
        return by(SyncMethod::Triangulation, residual_px, budget_px, because);
    }
    let because = format!(
        "Features move by up to {largest_px:.1} px a frame, and apart from their neighbours by up \
         to {residual_px:.2} px."
    );
    by(SyncMethod::Refined, residual_px, budget_px, because)
}

/// Ratio of the threshold for still frame pairs to the largest change by noise that was measured in a few still pairs.
/// In a still pair, nothing moves from one frame to the next. With a smaller factor, still pairs with stronger noise
/// would be registered needlessly. With a larger factor, slight motion would count as noise.
const NOISE_MARGIN: f32 = 1.25;

/// Chooses the threshold by which still frame pairs are recognized. A pair is still if no image block changes by more
/// than the threshold. Still pairs are cross-faded without registration. The change of a block is the mean absolute
/// difference of its pixel values, which are from 0 to 1. The threshold is 0 if no examined pair is still, or if
/// features in still pairs move too far for `budget_px`. `budget_px` is the maximum position error, in pixels, that a
/// cheaper method may cause.
pub fn still_pairs(motion: &Motion, budget_px: f64) -> (f32, Decision) {
    let Motion { still_pairs, still_change, still_px, pairs, .. } = *motion;
    if pairs == 0 {
        return (0.0, Decision::new("still pairs", "none", "There is one frame a camera."));
    }
    if still_pairs == 0 {
        let because =
            format!("In each of the {pairs} frame pairs that were examined something moves.");
        return (0.0, Decision::new("still pairs", "registered", because));
    }
    let limit_px = CROSSFADE_BUDGETS * budget_px;
    let still = format!(
        "In {still_pairs} of the {pairs} frame pairs that were examined no block changes, and features \
         move by {still_px:.2} px at most"
    );
    if still_px > limit_px {
        let because = format!("{still}.");
        let decision = Decision::new("still pairs", "registered", because);
        return (0.0, decision.by(still_px, limit_px));
    }
    let limit = (NOISE_MARGIN * still_change).min(MAX_NOISE);
    let because = format!(
        "{still}; pairs whose blocks change by up to {:.2}/255 count as still.",
        255.0 * limit
    );
    (limit, Decision::new("still pairs", "cross-faded", because).by(still_px, limit_px))
}

/// Chooses between two sync methods: [`SyncMethod::Refined`] if it can gain more than `budget_db` over
/// [`SyncMethod::Triangulation`], and triangulation otherwise. `gain_db` is the largest possible PSNR gain of
/// refinement, in decibels. `frames` lists the held-out frames for the text of the reason.
pub fn refinement(gain_db: f64, frames: &str, budget_db: f64) -> (SyncMethod, Decision) {
    let refines = gain_db > budget_db;
    let method = if refines { SyncMethod::Refined } else { SyncMethod::Triangulation };
    let because = format!(
        "Where frames change, refinement can make views {gain_db:.2} dB better than triangulation, if \
         all that it changes is for the better (held-out frames: {frames})."
    );
    (method, Decision::new("sync", method.name(), because).by(gain_db, budget_db))
}

/// Chooses between two sync methods. [`SyncMethod::Refined`] interpolates each camera's image from its own frames.
/// [`SyncMethod::AllCameras`] blends in images of other cameras, and takes twice as long. `gain_db` is the PSNR gain of
/// `AllCameras` on the held-out frames, in decibels; it is chosen if this gain exceeds `budget_db`. `frames` lists the
/// held-out frames for the text of the reason.
pub fn all_cameras(gain_db: f64, frames: &str, budget_db: f64) -> (SyncMethod, Decision) {
    let pays = gain_db > budget_db;
    let method = if pays { SyncMethod::AllCameras } else { SyncMethod::Refined };
    let because = format!(
        "Where frames change, views by all cameras' images are {} than by refined ones (held-out frames: \
         {frames}).",
        better_or_worse(gain_db)
    );
    (method, Decision::new("sync", method.name(), because).by(gain_db, budget_db))
}

/// Chooses scene flow as the proxy if its PSNR gain over depth per pixel exceeds `budget_db`, and depth per pixel
/// otherwise. `gain_db` is this gain on the held-out frames, in decibels. `frames` lists the held-out frames for the
/// text of the reason.
pub fn scene_flow(gain_db: f64, frames: &str, budget_db: f64) -> (ProxyMethod, Decision) {
    let method = if gain_db > budget_db { ProxyMethod::SceneFlow } else { ProxyMethod::Depth };
    let because = format!(
        "Where frames change, views by depth and motion of the frames are {} than by depth of synchronized images \
         (held-out frames: {frames}).",
        better_or_worse(gain_db)
    );
    (method, Decision::new("proxy", method.name(), because).by(gain_db, budget_db))
}

/// Chooses the proxy of a wide array: scene flow, or a plane if hardly any surface looks alike in two cameras. `angle_rad` is
/// the angle between neighbouring cameras, radians; `None` if the array isn't wide.
pub fn wide(angle_rad: Option<f64>) -> Option<(ProxyMethod, Decision)> {
    let [degrees, min, max] =
        [angle_rad?, MIN_WIDE_ANGLE_RAD, MAX_MATCHED_ANGLE_RAD].map(f64::to_degrees);
    let (method, limit, what) = if degrees > max {
        (
            ProxyMethod::Plane,
            max,
            "surfaces of one are hardly found in the other, and views between them show ghosts",
        )
    } else {
        (ProxyMethod::SceneFlow, min, "features of one are hardly found in the other")
    };
    let because = format!(
        "Neighbouring cameras are {degrees:.1} degrees apart, seen from what they look at, so that {what}."
    );
    Some((method, Decision::new("proxy", method.name(), because).by(degrees, limit)))
}

fn better_or_worse(gain_db: f64) -> String {
    let word = if gain_db < 0.0 { "worse" } else { "better" };
    format!("{:.2} dB {word}", gain_db.abs())
}

/// Chooses between blending weights in space only, and weights in space and time. `gain_db` is the PSNR gain of weights
/// in space and time on the held-out frames, in decibels. Any positive gain suffices, because both methods take about
/// the same time. If `gain_db` is `None`, no frames were compared, and no method is chosen. `frames` lists the held-out
/// frames for the text of the reason.
pub fn blend(gain_db: Option<f64>, frames: &str) -> (Option<BlendMethod>, Decision) {
    let Some(gain_db) = gain_db else {
        let because = "No held-out frames were compared: that needs refined motion, depth per pixel and a frame \
                       between other cameras' frames.";
        return (None, Decision::new("blend", "as given", because));
    };
    let method = if gain_db > 0.0 { BlendMethod::SpaceTime } else { BlendMethod::default() };
    let because = format!(
        "Where frames change, views by weights in space and time are {} than by those in space alone \
         (held-out frames: {frames}).",
        better_or_worse(gain_db)
    );
    (Some(method), Decision::new("blend", method.name(), because).by(gain_db, 0.0))
}

/// Maximum curvature ([`Motion::curvature_px`]) at which the trajectories of features are modelled as straight lines,
/// as a fraction of the error budget `budget_px`. With a larger value, views would lose 0.1 to 0.2 dB that curved
/// trajectories gain at hardly any cost. With a smaller value, the noise of tracks, 0.01 px, would count as curvature.
const CURVATURE_FRACTION: f64 = 0.2;

/// Decides whether the trajectories of features are modelled as curves or as straight lines. They are curves if their
/// measured curvature exceeds a fifth of the error budget `budget_px`, in pixels. The returned Boolean is true for
/// curves.
pub fn trajectory(motion: &Motion, budget_px: f64) -> (bool, Decision) {
    let limit_px = CURVATURE_FRACTION * budget_px;
    let is_curved = motion.curvature_px > limit_px;
    let because = format!(
        "Halfway between two frames, trajectories are {:.2} px off their chords.",
        motion.curvature_px
    );
    let method = if is_curved { "curved" } else { "straight" };
    let decision = Decision::new("trajectory", method, because);
    (is_curved, decision.by(motion.curvature_px, limit_px))
}

/// Chooses the geometry proxy: a plane if it displaces the scene's points by at most `budget_px` pixels in views
/// between cameras, otherwise depth per pixel. If `shape` is `None`, no point of the scene could be triangulated, and
/// no method is chosen.
pub fn proxy(shape: Option<&Shape>, budget_px: f64) -> (Option<ProxyMethod>, Decision) {
    let Some(shape) = shape else {
        let because = "No point of the scene could be triangulated to tell.";
        return (None, Decision::new("proxy", "as given", because));
    };
    let is_plane = shape.off_plane_px <= budget_px;
    let method = if is_plane { ProxyMethod::Plane } else { ProxyMethod::Depth };
    let because = format!(
        "Halfway between two cameras, the best plane displaces points by {:.2} px (95th percentile \
         of {}).",
        shape.off_plane_px, shape.points
    );
    let decision = Decision::new("proxy", method.name(), because);
    (Some(method), decision.by(shape.off_plane_px, budget_px))
}

/// Reports whether the cameras' gains differ from each other, or change over the recording, so that images are
/// corrected. Differences that are not significant count as none ([`Gains`]).
pub fn gains(gains: &Gains) -> Decision {
    let (difference, std_err) = gains.largest;
    let numbers = format!(
        "The light that cameras record differs by {:.1} % at most (standard error {:.1} %)",
        100.0 * difference,
        100.0 * std_err
    );
    let changing = gains.curves.iter().filter(|curve| !curve.is_constant());
    let largest = changing.map(GainCurve::largest_change).max_by(f64::total_cmp);
    if let Some(change) = largest {
        let because = format!(
            "{numbers}, and in a camera by up to {:.1} % over the recording, which is corrected.",
            100.0 * change
        );
        return Decision::new("gains", "corrected", because);
    }
    if gains.are_equal() {
        let because = format!("{numbers}, which counts as none.");
        return Decision::new("gains", "equal", because);
    }
    Decision::new("gains", "corrected", format!("{numbers}, which is corrected."))
}

/// Reports whether the lenses have distortion. `distortion_px` is the largest displacement of a pixel by lens
/// distortion, over all cameras.
pub fn lenses(distortion_px: f64) -> Decision {
    if distortion_px == 0.0 {
        return Decision::new("lenses", "pinhole", "No lens distorts.").by(0.0, 0.0);
    }
    let because = format!("Lenses move pixels by up to {distortion_px:.2} px, which is undone.");
    Decision::new("lenses", "distorted", because).by(distortion_px, 0.0)
}

/// Largest `extent_ratio` at which the cameras count as a line. The ratio is the extent of the camera centres across
/// their main direction, divided by the extent along it. Above this limit, the cameras count as a grid.
const LINE: f64 = 0.05;

/// Reports whether the cameras spread in one or in two directions. Tracks are tested by epipolar geometry against one
/// other camera in each of these directions. `extent_ratio` is the extent of the camera centres across their main
/// direction, divided by the extent along it.
pub fn references(extent_ratio: f64) -> Decision {
    let because = format!(
        "Across their main direction the cameras spread {extent_ratio:.2} times as far as along it."
    );
    let is_line = extent_ratio <= LINE;
    let method = if is_line { "one direction" } else { "two directions" };
    Decision::new("references", method, because).by(extent_ratio, LINE)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::registration::GainKnot;

    const BUDGET_PX: f64 = 0.25;

    fn moving(largest_px: f64, residual_px: f64, changed_fraction: f64) -> Motion {
        Motion { largest_px, residual_px, changed_fraction, pairs: 1, ..Motion::default() }
    }

    #[test]
    fn clocks_decide_whether_offsets_are_estimated() {
        let method = |clocks: &[usize], is_static| offsets(clocks, is_static).method;
        assert_eq!(method(&[0; 8], false), "known clocks");
        assert_eq!(method(&[0, 0, 1, 2, 3], false), "estimated");
        assert_eq!(method(&[0; 8], true), "none");
        assert!(offsets(&[0, 0, 1, 2, 3], false).because.contains("3 of 5"));
    }

    #[test]
    fn motion_decides_the_sync_method() {
        let method = |motion: Motion| sync(&motion, BUDGET_PX).0;
        assert_eq!(method(Motion::default()), SyncMethod::Nearest, "no pairs");
        assert_eq!(method(moving(0.2, 0.1, 0.0)), SyncMethod::Nearest);
        assert_eq!(
            method(moving(0.2, 0.1, 0.01)),
            SyncMethod::Crossfade,
            "what changes is no feature"
        );
        assert_eq!(method(moving(0.49, 0.1, 0.2)), SyncMethod::Crossfade);
        assert_eq!(method(moving(10.0, 0.2, 0.9)), SyncMethod::Triangulation);
        assert_eq!(method(moving(10.0, 4.0, 0.2)), SyncMethod::Refined);
    }

    #[test]
    fn still_pairs_are_cross_faded_within_the_budget() {
        let motion = Motion { pairs: 6, ..Motion::default() };
        let of = |motion: &Motion| {
            let (limit, decision) = still_pairs(motion, BUDGET_PX);
            (limit, decision.method)
        };
        assert_eq!(of(&Motion::default()), (0.0, "none"));
        assert_eq!(of(&motion), (0.0, "registered"));
        let still = Motion { still_pairs: 2, still_change: 0.0078125, still_px: 0.1, ..motion };
        assert_eq!(of(&still), (0.009765625, "cross-faded"));
        assert!(still_pairs(&still, BUDGET_PX).1.because.contains("2 of the 6"));
        assert_eq!(of(&Motion { still_change: 0.9, ..still }).0, MAX_NOISE);
        assert_eq!(of(&Motion { still_px: 0.6, ..still }), (0.0, "registered"));
        assert_eq!(still_pairs(&still, 0.0).0, 0.0);
    }

    #[test]
    fn gains_are_corrected_where_they_differ_or_change() {
        let mut all = Gains::equal(2);
        assert_eq!((gains(&all).method, all.are_equal()), ("equal", true));
        all.factors[1] = [1.2; 3];
        assert_eq!(gains(&all).method, "corrected");
        assert!(!gains(&all).because.contains("over the recording"));
        all.factors[1] = [1.0; 3];
        let knot = |time_s: f64, log: f64| GainKnot { time_s, log: [0.0, log, 0.0] };
        all.curves[0] = GainCurve::new(vec![knot(0.0, -0.1), knot(1.0, 0.1)]);
        let decision = gains(&all);
        assert_eq!((decision.method, all.are_equal()), ("corrected", false));
        assert!(decision.because.contains("by up to 22.1 % over the recording"), "{decision:?}");
    }

    #[test]
    fn what_refinement_gains_decides_whether_it_is_done() {
        let decided = |gain_db| refinement(gain_db, "cam1's 3", 0.1);
        assert_eq!(decided(0.0).0, SyncMethod::Triangulation);
        assert_eq!(decided(0.05).0, SyncMethod::Triangulation);
        assert_eq!(decided(0.6).0, SyncMethod::Refined);
        assert!(decided(0.6).1.because.contains("0.60 dB"), "{}", decided(0.6).1.because);
    }

    #[test]
    fn held_out_frames_decide_on_all_cameras_and_on_weights_in_time() {
        let sync = |gain_db| all_cameras(gain_db, "cam1's 3", 0.07);
        assert_eq!(sync(0.05).0, SyncMethod::Refined);
        assert_eq!(sync(0.3).0, SyncMethod::AllCameras);
        assert!(sync(-0.25).1.because.contains("0.25 dB worse"), "{}", sync(-0.25).1.because);
        let weights = |gain_db| blend(gain_db, "cam1's 3");
        assert_eq!(weights(Some(0.01)).0, Some(BlendMethod::SpaceTime));
        assert_eq!(weights(Some(-0.01)).0, Some(BlendMethod::default()));
        assert_eq!(weights(None).0, None);
        assert_eq!(weights(None).1.method, "as given");
    }

    #[test]
    fn held_out_frames_decide_on_scene_flow() {
        let proxy = |gain_db| scene_flow(gain_db, "cam1's 3", 0.07);
        assert_eq!(proxy(0.05).0, ProxyMethod::Depth);
        assert_eq!(proxy(2.0).0, ProxyMethod::SceneFlow);
        assert!(proxy(-0.25).1.because.contains("0.25 dB worse"), "{}", proxy(-0.25).1.because);
    }

    #[test]
    fn curvature_decides_whether_trajectories_are_curved() {
        let curved = |curvature_px| {
            trajectory(&Motion { curvature_px, ..moving(9.0, 3.0, 0.1) }, BUDGET_PX).0
        };
        assert!(!curved(0.04) && curved(0.06));
    }

    #[test]
    fn parallax_decides_the_proxy() {
        let method = |off_plane_px| proxy(Some(&Shape { off_plane_px, points: 300 }), BUDGET_PX).0;
        assert_eq!(method(0.1), Some(ProxyMethod::Plane));
        assert_eq!(method(2.0), Some(ProxyMethod::Depth));
        assert_eq!(proxy(None, BUDGET_PX).0, None);
    }

    #[test]
    fn lenses_and_the_rig_are_described() {
        assert_eq!(lenses(0.0).method, "pinhole");
        assert_eq!(lenses(0.4).method, "distorted");
        assert_eq!(references(0.0).method, "one direction");
        assert_eq!(references(0.3).method, "two directions");
    }

    #[test]
    fn every_decision_says_its_number() {
        let (_, d) = sync(&moving(10.0, 4.0, 0.2), BUDGET_PX);
        assert_eq!((d.measured, d.limit), (Some(4.0), Some(BUDGET_PX)));
        assert!(d.because.contains("4.00 px"), "{}", d.because);
    }
}
