//! The description of a capture for the page.

use super::Studio;
use super::rig_frame::{Lens, MAX_TURN_DEG, ZOOMS};
use serde::Serialize;

/// The page's `scene.json`. Places are in the rig's axes ([`super::RigFrame`]), metres; times are on the reference's
/// clock, as in the capture's file.
#[derive(Serialize)]
pub(super) struct PageScene {
    name: String,
    folder: String,
    /// The words of a command line that choose the options.
    options: Vec<String>,
    reference: usize,
    cameras: Vec<SceneCamera>,
    lens: Lens,
    low: [f64; 3],
    high: [f64; 3],
    spacing_m: f64,
    /// The least and the largest.
    zooms: [f64; 2],
    /// The largest turn to any side.
    max_turn_deg: f64,
    /// The first and the last time of the slider; `None` for a capture that is the same at any time.
    span_s: Option<[f64; 2]>,
    /// The times of the reference's frames.
    frames_s: Vec<f64>,
    truths: Vec<SceneTruth>,
}

#[derive(Serialize)]
struct SceneCamera {
    id: String,
    at: [f64; 3],
    color: String,
}

#[derive(Serialize)]
struct SceneTruth {
    id: String,
    at: [f64; 3],
    time_s: f64,
}

impl PageScene {
    pub fn of(studio: &Studio) -> Self {
        let (capture, rig) = (studio.capture(), studio.places().rig());
        let field = studio.field();
        let origin_s = capture.time_origin_s;
        let camera = |(index, at): (usize, [f64; 3])| SceneCamera {
            id: capture.cameras[index].id.clone(),
            at,
            color: studio.colors().hex(index),
        };
        let truth = |view: &super::true_views::LiveTruth| SceneTruth {
            id: view.id.clone(),
            at: rig.place(&view.camera.center()),
            time_s: view.time_s,
        };
        let span_s = field.common_span_s().or_else(|| field.span_s(capture.reference));
        let [low, high] = rig.bounds();
        Self {
            name: capture.name.clone(),
            folder: capture.folder.display().to_string(),
            options: studio.words().to_vec(),
            reference: capture.reference,
            cameras: rig.places().into_iter().enumerate().map(camera).collect(),
            lens: rig.lens(),
            low,
            high,
            spacing_m: rig.spacing_m(),
            zooms: [*ZOOMS.start(), *ZOOMS.end()],
            max_turn_deg: MAX_TURN_DEG,
            span_s: span_s
                .filter(|_| !capture.is_static())
                .map(|(first, last)| [first + origin_s, last + origin_s]),
            frames_s: capture.times_in_file_s(capture.reference),
            truths: studio.truth().all().iter().map(truth).collect(),
        }
    }
}
