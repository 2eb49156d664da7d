//! From what was measured to a rung and a sentence. No images here.

use super::motion::MOST_NOISE;
use super::{Clocks, Decision, Motion, Shape};
use crate::interpolation::Sync;
use crate::registration::Gains;
use crate::render::ProxyRung;
use clap::ValueEnum;

fn decision(
    stage: &'static str,
    rung: &str,
    numbers: Option<(f64, f64)>,
    because: String,
) -> Decision {
    let (measured, limit) = numbers.unzip();
    Decision { stage, rung: rung.to_owned(), measured, limit, because }
}

fn name(rung: &impl ValueEnum) -> String {
    rung.to_possible_value().map(|v| v.get_name().to_owned()).unwrap_or_default()
}

pub fn offsets(clocks: &Clocks) -> Decision {
    let Clocks { cameras, unknown, one_frame } = clocks;
    let (rung, because) = if *one_frame {
        ("none", "Every camera took one frame, which is the same at any time.".to_owned())
    } else if *unknown == 0 {
        ("known clocks", format!("All {cameras} cameras share the reference's clock."))
    } else {
        let because = format!("The clocks of {unknown} of {cameras} cameras are unknown.");
        ("estimated", because)
    };
    decision("offsets", rung, None, because)
}

/// A crossfade of two images that lie this many budgets apart blurs by less than a budget:
/// halfway, the mean is where it should be, and the halves are half the distance off.
const FADED_BUDGETS: f64 = 2.0;

pub fn sync(motion: &Motion, budget_px: f64) -> (Sync, Decision) {
    let Motion { largest_px, unevenness_px, changed_share, .. } = *motion;
    let made = |rung: Sync, numbers, because: String| {
        (rung, decision("sync", &name(&rung), Some(numbers), because))
    };
    if motion.pairs == 0 {
        return (
            Sync::Nearest,
            decision("sync", &name(&Sync::Nearest), None, "There is one frame a camera.".into()),
        );
    }
    // The nearest frame is at most half a frame away.
    let nearest_px = 0.5 * largest_px;
    if nearest_px <= budget_px && changed_share == 0.0 {
        let because = format!(
            "Nothing moves by more than {largest_px:.2} px a frame, and no block of the images changes."
        );
        return made(Sync::Nearest, (nearest_px, budget_px), because);
    }
    if largest_px <= FADED_BUDGETS * budget_px {
        let because = format!(
            "Features move by {largest_px:.2} px a frame at most; {:.1} % of the blocks change.",
            100.0 * changed_share
        );
        return made(Sync::Crossfade, (largest_px, FADED_BUDGETS * budget_px), because);
    }
    if unevenness_px <= budget_px {
        let because = format!(
            "Features move by up to {largest_px:.1} px a frame, as their neighbours do to \
             {unevenness_px:.2} px."
        );
        return made(Sync::Triangulation, (unevenness_px, budget_px), because);
    }
    let because = format!(
        "Features move by up to {largest_px:.1} px a frame, and apart from their neighbours by up \
         to {unevenness_px:.2} px."
    );
    made(Sync::Refined, (unevenness_px, budget_px), because)
}

/// Other pairs' noise may be larger than that of those that were looked at, by this factor.
const NOISE_MARGIN: f32 = 1.25;

/// How much the blocks of a frame pair may change for the pair to go without registration.
pub fn still_pairs(motion: &Motion, budget_px: f64) -> (f32, Decision) {
    let Motion { still_pairs, still_change, still_px, pairs, .. } = *motion;
    let made = |rung, numbers, because| decision("still pairs", rung, numbers, because);
    if pairs == 0 {
        return (0.0, made("none", None, "There is one frame a camera.".into()));
    }
    if still_pairs == 0 {
        let because = format!("In each of {pairs} frame pairs looked at something moves.");
        return (0.0, made("registered", None, because));
    }
    let limit_px = FADED_BUDGETS * budget_px;
    let still = format!(
        "In {still_pairs} of {pairs} frame pairs looked at no block changes, and features move by \
         {still_px:.2} px at most"
    );
    if still_px > limit_px {
        return (0.0, made("registered", Some((still_px, limit_px)), format!("{still}.")));
    }
    let limit = (NOISE_MARGIN * still_change).min(MOST_NOISE);
    let because = format!(
        "{still}; pairs whose blocks change by up to {:.2}/255 are as still.",
        255.0 * limit
    );
    (limit, made("dissolved", Some((still_px, limit_px)), because))
}

/// Whether the refined rung pays, where views by it and by triangulation could be compared.
pub fn refinement(gain_db: f64, frames: &str, budget_db: f64) -> (Sync, Decision) {
    let rung = if gain_db > budget_db { Sync::Refined } else { Sync::Triangulation };
    let because = format!(
        "Where frames change, refinement can make views {gain_db:.2} dB better than triangulation, if all \
         that it changes is for the better (frames {frames}, rendered from their neighbours)."
    );
    (rung, decision("sync", &name(&rung), Some((gain_db, budget_db)), because))
}

/// The share of the budget that paths may bend by. Larger: straight where views on curved paths are
/// better by 0.1 to 0.2 dB, and hardly slower; smaller: the tracks' own noise, 0.01 px, bends them.
const BEND_SHARE: f64 = 0.2;

/// Whether paths must be curved.
pub fn path(motion: &Motion, budget_px: f64) -> (bool, Decision) {
    let limit_px = BEND_SHARE * budget_px;
    let curved = motion.bend_px > limit_px;
    let because = format!(
        "Halfway between two frames, paths bend by {:.2} px from straight lines.",
        motion.bend_px
    );
    let rung = if curved { "curved" } else { "straight" };
    (curved, decision("path", rung, Some((motion.bend_px, limit_px)), because))
}

/// `None` leaves the proxy as it is.
pub fn proxy(shape: Option<&Shape>, budget_px: f64) -> (Option<ProxyRung>, Decision) {
    let Some(shape) = shape else {
        let because = "No point of the scene could be triangulated to tell.".to_owned();
        return (None, decision("proxy", "as given", None, because));
    };
    let rung = if shape.off_plane_px <= budget_px { ProxyRung::Plane } else { ProxyRung::Mesh };
    let because = format!(
        "Halfway between two cameras, the best plane displaces points by {:.2} px (95th percentile \
         of {}).",
        shape.off_plane_px, shape.points
    );
    (Some(rung), decision("proxy", &name(&rung), Some((shape.off_plane_px, budget_px)), because))
}

/// What a gain of 1 is told from is in [`Gains`].
pub fn gains(gains: &Gains) -> Decision {
    let (difference, std_err) = gains.largest_difference();
    let numbers = format!(
        "The light that cameras record differs by {:.1} % at most (standard error {:.1} %)",
        100.0 * difference,
        100.0 * std_err
    );
    if gains.are_equal() {
        return decision("gains", "equal", None, format!("{numbers}, which is taken as none."));
    }
    decision("gains", "corrected", None, format!("{numbers}, which is corrected."))
}

pub fn lenses(distortion_px: f64) -> Decision {
    if distortion_px == 0.0 {
        let because = "No lens distorts: rays are straight arithmetic.".to_owned();
        return decision("lenses", "pinhole", Some((0.0, 0.0)), because);
    }
    let because = format!("Lenses move pixels by up to {distortion_px:.2} px, which is undone.");
    decision("lenses", "distorted", Some((distortion_px, 0.0)), because)
}

/// A rig that is less wide across than this share of its length counts as a line.
const LINE: f64 = 0.05;

pub fn references(extent_ratio: f64) -> Decision {
    let because = format!(
        "Across their main direction the cameras spread {extent_ratio:.2} times as far as along it."
    );
    let rung = if extent_ratio > LINE { "two directions" } else { "one direction" };
    decision("references", rung, Some((extent_ratio, LINE)), because)
}

#[cfg(test)]
mod tests {
    use super::*;

    const BUDGET_PX: f64 = 0.25;

    fn moving(largest_px: f64, unevenness_px: f64, changed_share: f64) -> Motion {
        Motion { largest_px, unevenness_px, changed_share, pairs: 1, ..Motion::default() }
    }

    #[test]
    fn clocks_decide_whether_offsets_are_estimated() {
        let clocks = Clocks { cameras: 8, unknown: 0, one_frame: false };
        assert_eq!(offsets(&clocks).rung, "known clocks");
        assert_eq!(offsets(&Clocks { unknown: 3, ..clocks }).rung, "estimated");
        assert_eq!(offsets(&Clocks { one_frame: true, ..clocks }).rung, "none");
    }

    #[test]
    fn motion_decides_the_sync_rung() {
        let rung = |motion: Motion| sync(&motion, BUDGET_PX).0;
        assert_eq!(rung(Motion::default()), Sync::Nearest, "no pairs");
        assert_eq!(rung(moving(0.2, 0.1, 0.0)), Sync::Nearest);
        assert_eq!(rung(moving(0.2, 0.1, 0.01)), Sync::Crossfade, "what changes is no feature");
        assert_eq!(rung(moving(0.49, 0.1, 0.2)), Sync::Crossfade);
        assert_eq!(rung(moving(10.0, 0.2, 0.9)), Sync::Triangulation);
        assert_eq!(rung(moving(10.0, 4.0, 0.2)), Sync::Refined);
    }

    #[test]
    fn still_pairs_are_dissolved_within_the_budget() {
        let motion = Motion { pairs: 6, ..Motion::default() };
        let of = |motion: &Motion| {
            let (limit, decision) = still_pairs(motion, BUDGET_PX);
            (limit, decision.rung)
        };
        assert_eq!(of(&Motion::default()), (0.0, "none".into()));
        assert_eq!(of(&motion), (0.0, "registered".into()));
        let still = Motion { still_pairs: 2, still_change: 0.0078125, still_px: 0.1, ..motion };
        assert_eq!(of(&still), (0.009765625, "dissolved".into()));
        assert!(still_pairs(&still, BUDGET_PX).1.because.contains("2 of 6"));
        assert_eq!(of(&Motion { still_change: 0.9, ..still }).0, MOST_NOISE);
        assert_eq!(of(&Motion { still_px: 0.6, ..still }), (0.0, "registered".into()));
        assert_eq!(still_pairs(&still, 0.0).0, 0.0);
    }

    #[test]
    fn what_refinement_gains_decides_whether_it_is_done() {
        let rung = |gain_db| refinement(gain_db, "cam1's 3", 0.1);
        assert_eq!(rung(0.0).0, Sync::Triangulation);
        assert_eq!(rung(0.05).0, Sync::Triangulation);
        assert_eq!(rung(0.6).0, Sync::Refined);
        assert!(rung(0.6).1.because.contains("0.60 dB"), "{}", rung(0.6).1.because);
    }

    #[test]
    fn bends_decide_whether_paths_are_curved() {
        let bent = |bend_px| path(&Motion { bend_px, ..moving(9.0, 3.0, 0.1) }, BUDGET_PX).0;
        assert!(!bent(0.04) && bent(0.06));
    }

    #[test]
    fn parallax_decides_the_proxy() {
        let rung = |off_plane_px| proxy(Some(&Shape { off_plane_px, points: 300 }), BUDGET_PX).0;
        assert_eq!(rung(0.1), Some(ProxyRung::Plane));
        assert_eq!(rung(2.0), Some(ProxyRung::Mesh));
        assert_eq!(proxy(None, BUDGET_PX).0, None);
    }

    #[test]
    fn lenses_and_the_rig_are_described() {
        assert_eq!(lenses(0.0).rung, "pinhole");
        assert_eq!(lenses(0.4).rung, "distorted");
        assert_eq!(references(0.0).rung, "one direction");
        assert_eq!(references(0.3).rung, "two directions");
    }

    #[test]
    fn every_decision_says_its_number() {
        let (_, d) = sync(&moving(10.0, 4.0, 0.2), BUDGET_PX);
        assert_eq!((d.measured, d.limit), (Some(4.0), Some(BUDGET_PX)));
        assert!(d.because.contains("4.00 px"), "{}", d.because);
    }
}
