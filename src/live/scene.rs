//! The description of a capture for the page.

use super::Studio;
use super::rig_frame::{MAX_TURN_DEG, ZOOMS};
use serde_json::{Value, json};

/// The page's `scene.json`. Places are in the rig's axes ([`super::RigFrame`]), metres; times are on the reference's
/// clock, as in the capture's file.
pub(super) fn scene(studio: &Studio) -> Value {
    let (field, rig) = (studio.field, &studio.rig);
    let capture = field.capture();
    let camera = |(index, at): (usize, [f64; 3])| json!({ "id": capture.cameras[index].id, "at": at, "color": studio.colors.hex(index) });
    let cameras: Vec<Value> = rig.places().into_iter().enumerate().map(camera).collect();
    let truths = studio.truth.views.iter().map(
        |view| json!({ "id": view.id, "at": rig.place(&view.camera.center()), "time_s": view.time_s }),
    );
    let origin_s = capture.time_origin_s;
    let span_s = field.common_span_s().or_else(|| field.span_s(capture.reference));
    let span_s = span_s.map(|(first, last)| [first + origin_s, last + origin_s]);
    let [low, high] = rig.bounds();
    let [width, height] = rig.largest_size();
    json!({
        "name": capture.name,
        "folder": capture.folder.display().to_string(),
        // The command-line arguments that give these options.
        "options": studio.words,
        "cameras": cameras,
        "lens": { "width": width, "height": height },
        "low": low,
        "high": high,
        "spacing_m": rig.spacing_m,
        "zooms": [ZOOMS.start(), ZOOMS.end()],
        "max_turn_deg": MAX_TURN_DEG,
        // The range of the slider; null for a capture that is the same at any time.
        "span_s": span_s.filter(|_| !capture.is_static()),
        "frames_s": capture.times_in_file_s(capture.reference),
        "truths": truths.collect::<Vec<_>>(),
    })
}
