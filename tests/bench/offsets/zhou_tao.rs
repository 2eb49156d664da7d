//! The offset estimator of Zhou and Tao (CVPR 2003), with which Figs. 19 to 22 compare: four points
//! instead of three.
//!
//! A feature in uniform motion has the images `p_i(t)`, `p_i(t+Δt_i)`, `p_j(t')` and `p_j(t'+Δt_j)`.
//! Camera j's two points correspond to the points at which their epipolar lines cross the feature's
//! straight trajectory in camera i. The cross ratio of these four points is invariant under projection,
//! and for uniform motion it equals the cross ratio of the four times. The speed in the image need not
//! be constant, unlike in eq. (10), but a fourth frame at a known time is required.
//!
//! Known limits: it shares eq. (10)'s degeneracy where motion runs along the epipolar line, and its
//! two solutions coincide at t̃ = 0.

use nalgebra::Point2;
use stlfr::camera::{Camera, EpipolarGeometry};

/// A feature's images in two frames of each camera, pixels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FourPoints {
    /// In camera i, at t and t + Δt_i.
    pub in_i: [Point2<f64>; 2],
    /// In camera j, at t' and t' + Δt_j.
    pub in_j: [Point2<f64>; 2],
}

/// One feature's candidate `t̃ = t' − t`, seconds, within `−Δt_j < t̃ < Δt_i`; `frame_s` holds Δt_i and
/// Δt_j.
///
/// `None` for cameras with a common centre, points without an epipolar line, a feature without motion
/// or with motion along the epipolar lines, backward motion in camera j, and where noise leaves the
/// cross ratio without a real solution.
pub fn cross_ratio_offset(
    [camera_i, camera_j]: [&Camera; 2],
    points: &FourPoints,
    frame_s: [f64; 2],
) -> Option<f64> {
    let i_from_j = EpipolarGeometry::new(camera_j, camera_i)?;
    let [start, end] = points.in_i.map(|p| camera_i.model.ideal_from_pixel(&p));
    let (start, end) = (start?, end?);
    // The crossing of epipolar line and trajectory: 0 at the earlier point, 1 at the later one.
    let crossing = |p: Point2<f64>| {
        let line = i_from_j.line_in_j(&camera_j.model.ideal_from_pixel(&p)?)?;
        let (near, far) = (line.distance(&start), line.distance(&end));
        let at = near / (near - far);
        at.is_finite().then_some(at)
    };
    let (first, second) = (crossing(points.in_j[0])?, crossing(points.in_j[1])?);
    solve([first, second], frame_s)
}

/// `(1 − 0)(s₂ − s₁) / ((1 − s₁)(s₂ − 0)) = Δt_i Δt_j / ((Δt_i − t̃)(Δt_j + t̃))`, solved for `t̃`.
/// The two solutions are symmetric about `(Δt_i − Δt_j) / 2`; `s₁` decides between them.
fn solve([s1, s2]: [f64; 2], [frame_i, frame_j]: [f64; 2]) -> Option<f64> {
    // (Δt_i − t̃)(Δt_j + t̃), from the left side's inverse.
    let product = frame_i * frame_j * (1.0 - s1) * s2 / (s2 - s1);
    // t̃² − (Δt_i − Δt_j) t̃ + product − Δt_i Δt_j = 0
    let half = 0.5 * (frame_i - frame_j);
    let discriminant = half * half + frame_i * frame_j - product;
    let solvable = s2 > s1 && discriminant >= 0.0;
    let root = solvable.then(|| discriminant.sqrt())?;
    // The solutions are symmetric about `half`; the first point's position decides between them.
    let offset = if s1 >= symmetric(s1, s2) { half + root } else { half - root };
    (offset.is_finite() && offset > -frame_j && offset < frame_i).then_some(offset)
}

/// The value of `s₁` at which both solutions coincide, for the same distance `s₂ − s₁`: camera j's two
/// frames then lie symmetrically about camera i's.
fn symmetric(s1: f64, s2: f64) -> f64 {
    0.5 * (1.0 - (s2 - s1))
}
