//! Describes a capture as JSON, for the page on which its light field is viewed.

use super::Studio;
use super::overlays::DEPTH_COLORS;
use super::rig_frame::{MAX_TURN_DEG, ZOOMS};
use crate::compare::TRADITIONAL;
use crate::interpolation::SyncMethod;
use crate::method::Method;
use crate::options::ProxyMethod;
use serde_json::{Value, json};

/// Returns the page's `scene.json`. Positions are in the rig's axes ([`super::RigFrame`]), metres. Times are seconds on
/// the reference camera's clock, as in the capture's file.
pub(super) fn scene(studio: &Studio) -> Value {
    let (field, rig) = (studio.field, &studio.rig);
    let capture = field.capture();
    let camera = |(index, at): (usize, [f64; 3])| {
        let filmed = &capture.cameras[index];
        let ahead = rig.place(&(filmed.camera.center() + filmed.camera.axis()));
        let ahead = [0, 1, 2].map(|k| ahead[k] - at[k]);
        json!({ "id": filmed.id, "at": at, "ahead": ahead, "color": studio.colors.hex(index) })
    };
    let cameras: Vec<Value> = rig.places().into_iter().enumerate().map(camera).collect();
    let truths = studio.truth.views.iter().map(
        |view| json!({ "id": view.id, "at": rig.place(&view.camera.center()), "time_s": view.time_s }),
    );
    let origin_s = capture.time_origin_s;
    let span_s = field.common_span_s().or_else(|| field.span_s(capture.reference));
    let span_s = span_s.map(|(first, last)| [first + origin_s, last + origin_s]);
    let [low, high] = rig.bounds();
    let [width, height] = rig.largest_size();
    let focal_px = capture.cameras[capture.reference].camera.model.intrinsics().0;
    let chosen = studio.full();
    json!({
        "name": capture.name,
        "folder": capture.folder.display().to_string(),
        // Command-line arguments that are equivalent to the chosen options.
        "options": studio.words,
        "cameras": cameras,
        // The focal length is given as a fraction of the width.
        "lens": { "width": width, "height": height, "focal": focal_px / width as f64 },
        "low": low,
        "high": high,
        "spacing_m": rig.spacing_m,
        "zooms": [ZOOMS.start(), ZOOMS.end()],
        "max_turn_deg": MAX_TURN_DEG,
        // The range of the time slider; null for a static capture.
        "span_s": span_s.filter(|_| !capture.is_static()),
        "frames_s": capture.times_in_file_s(capture.reference),
        "truths": truths.collect::<Vec<_>>(),
        "methods": {
            "sync": choices::<SyncMethod>(|m| m != TRADITIONAL),
            // Scene flow is offered only if it was chosen, because it takes half a minute for each instant that
            // `stlfr prepare` has not processed.
            "proxy": choices::<ProxyMethod>(|m| m != ProxyMethod::SceneFlow || m == chosen.proxy.method),
        },
        "chosen": { "sync": chosen.sync.name(), "proxy": chosen.proxy.method.name() },
        // Colours from far to near.
        "depth_colors": DEPTH_COLORS,
    })
}

/// Returns the methods of a stage that the page offers to the user, as JSON objects with the method's name and help
/// text.
fn choices<M: Method>(is_offered: impl Fn(M) -> bool) -> Vec<Value> {
    let offered = M::ALL.iter().copied().filter(|m| is_offered(*m));
    offered.map(|m| json!({ "name": m.name(), "help": m.help() })).collect()
}
