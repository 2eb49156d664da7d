//! The rig of the benchmark: any rig, with the views that are measured.

use super::Error;
use nalgebra::{Isometry3, Translation3};
use std::path::Path;
use stlfr::camera::PoseFormat;
use stlfr::rig::{Rig, RigView};

/// A view: its name, its place along the rig as a share of half the rig's width, metres from there, and how many
/// times as long its lens is as a camera's.
type View = (&'static str, f64, [f64; 3], f64);

/// The views of the benchmark. Of eight cameras in a line, `between` and `side` are halfway between two, and the
/// others are above and in front of one.
const VIEWS: [View; 4] = [
    ("between", 0.0, [0.0; 3], 1.0),
    ("side", -4.0 / 7.0, [0.0; 3], 1.0),
    ("high", -1.0 / 7.0, [0.0, -0.12, 0.0], 1.0),
    ("ahead", 1.0 / 7.0, [0.0, 0.0, 0.12], 1.0),
];

/// Views that enlarge what the cameras see.
const CLOSE: [View; 4] = [
    ("near", 0.0, [0.0, 0.0, 0.5], 1.0),
    ("zoom2", 0.0, [0.0; 3], 2.0),
    ("zoom4", 0.0, [0.0; 3], 4.0),
    ("zoom8", 0.0, [0.0; 3], 8.0),
];

/// Views of the pan, in rigs and truths: this and their number.
pub const PAN: &str = "pan";
/// The part of the rig that a pan crosses, its middle half: from so far left of its middle to so far right, as
/// shares of half its width.
pub const PAN_SHARES: [f64; 2] = [-0.5, 0.5];

/// Decimals of the poses that are written: a nanometre.
const DECIMALS: f64 = 1e9;

/// What a rig is written for.
#[derive(Clone, Copy, PartialEq)]
pub enum Purpose {
    /// The views that are measured.
    Views,
    /// The same, with all shutters at the reference's.
    Synchronized,
    /// Views that enlarge what the cameras see.
    Close,
    /// The first view that is measured, and a pan of so many.
    Pan(usize),
}

/// Writes a rig with other views in place of its own.
pub fn write(from: &str, to: &str, purpose: Purpose) -> Result<(), Error> {
    let mut rig = Rig::read(from.as_ref())?;
    if purpose == Purpose::Synchronized {
        synchronize(&mut rig);
    }
    let poses: Result<Vec<_>, _> =
        rig.cameras.iter().map(|c| c.cam_from_rig.isometry().map(|p| p.inverse())).collect();
    let mut poses = poses?;
    poses.sort_by(|a, b| a.translation.x.total_cmp(&b.translation.x));
    let lens = rig.cameras[0].view();
    let view = |id: &str, share: f64, offset: [f64; 3], enlarged: f64| {
        let from_rig = (on_rig(&poses, share) * Translation3::from(offset)).inverse();
        let round = |v: f64| (v * DECIMALS).round() / DECIMALS + 0.0;
        let q = from_rig.rotation;
        let cam_from_rig = PoseFormat {
            rotation_wxyz: [q.w, q.i, q.j, q.k].map(round),
            translation: from_rig.translation.vector.map(round).into(),
        };
        let mut view = RigView { id: id.to_owned(), cam_from_rig, ..lens.clone() };
        view.lens_mm *= enlarged;
        view
    };
    let all =
        |views: &[View]| views.iter().map(|(id, at, off, by)| view(id, *at, *off, *by)).collect();
    let [left, right] = PAN_SHARES;
    rig.views = match purpose {
        Purpose::Pan(count) => {
            let step = (right - left) / count.saturating_sub(1).max(1) as f64;
            let share = |k: usize| left + step * k as f64;
            let pan = (0..count).map(|k| view(&format!("{PAN}{k:03}"), share(k), [0.0; 3], 1.0));
            [view("between", 0.0, [0.0; 3], 1.0)].into_iter().chain(pan).collect()
        }
        Purpose::Close => all(&CLOSE),
        Purpose::Views | Purpose::Synchronized => all(&VIEWS),
    };
    let folder = Path::new(to).parent().ok_or("has no folder")?;
    std::fs::create_dir_all(folder)?;
    Ok(std::fs::write(to, rig.to_json())?)
}

/// Gives all cameras the reference's shutter, without jitter. The reference's clock stays what it is, so that an
/// instant is the same in the films of both rigs.
fn synchronize(rig: &mut Rig) {
    let own = rig.cameras.iter().find(|c| c.id == rig.reference);
    let Some((rate_hz, delay_s)) = own.map(|c| (c.rate_hz, c.delay_s)) else { return };
    for camera in &mut rig.cameras {
        (camera.rate_hz, camera.delay_s, camera.jitter_s) = (rate_hz, delay_s, 0.0);
    }
    rig.name.push_str("-synchronized");
}

/// The pose on the rig at a share of half its width, to the right of its middle: halfway up between its lowest
/// and its highest camera, else between the cameras on both sides. The cameras are sorted from left to right.
fn on_rig(cameras: &[Isometry3<f64>], share: f64) -> Isometry3<f64> {
    let x = |c: &Isometry3<f64>| c.translation.x;
    let (left, right) = (&cameras[0], &cameras[cameras.len() - 1]);
    let at = 0.5 * (x(left) + x(right)) + 0.5 * share * (x(right) - x(left));
    // A place at a camera is on its own side.
    let before = cameras.iter().rfind(|c| x(c) <= at + 1.0 / DECIMALS).unwrap_or(left);
    let after = cameras.iter().find(|c| x(c) > at + 1.0 / DECIMALS).unwrap_or(right);
    let width = x(after) - x(before);
    let part = if width > 0.0 { (at - x(before)) / width } else { 0.0 };
    let mut pose = before.lerp_slerp(after, part);
    let heights = || cameras.iter().map(|c| c.translation.y);
    let (low, high) = heights().fold((f64::MAX, f64::MIN), |(l, h), y| (l.min(y), h.max(y)));
    pose.translation.y = 0.5 * (low + high);
    pose
}
