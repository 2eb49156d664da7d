//! Errors of estimated temporal offsets against the ground truth: the benchmark of sub-frame synchronization.

use super::results::OffsetResult;
use crate::capture::Truth;
use crate::offset::{CameraOffset, Offsets};

impl OffsetResult {
    /// Compares a camera's estimated temporal offset with its true offset `truth_s`. `given` is the estimated offset,
    /// `None` if it is missing. `frame_s` is the frame interval in seconds. Without `frame_s`, the errors in frames are
    /// `None`.
    pub(super) fn new(
        camera: &str,
        given: Option<&CameraOffset>,
        truth_s: Option<f64>,
        frame_s: Option<f64>,
    ) -> Self {
        let finite = |v: Option<f64>| v.filter(|v| v.is_finite());
        let offset_s = finite(given.and_then(|g| g.offset_s));
        let std_err_s = finite(given.and_then(|g| g.std_err_s));
        let truth_s = finite(truth_s);
        let error_s = offset_s.zip(truth_s).map(|(o, t)| o - t);
        let frames = |s: Option<f64>| s.zip(frame_s).map(|(s, f)| s / f);
        Self {
            camera: camera.to_owned(),
            shares_clock: false,
            offset_s,
            std_err_s,
            truth_s,
            error_frames: frames(error_s),
            std_err_frames: frames(std_err_s),
            z: error_s.zip(std_err_s).filter(|(_, s)| *s > 0.0).map(|(e, s)| e / s),
            reason: given.and_then(|g| g.reason.clone()),
        }
    }
}

/// Returns the errors of the estimated offsets of all cameras except the reference, in the order of the ground truth.
/// `frame_s` is the reference camera's frame interval, seconds. Returns an error if the offsets aren't relative to the
/// camera `reference`, or if `offsets` has a camera that the ground truth lacks.
pub fn score_offsets(
    offsets: &Offsets,
    truth: &Truth,
    reference: &str,
    frame_s: f64,
) -> Result<Vec<OffsetResult>, String> {
    if offsets.reference != reference {
        return Err(format!(
            "reference: must be \"{reference}\", the capture's, not \"{}\"",
            offsets.reference
        ));
    }
    let known = |id: &str| truth.offset_s(id).is_some();
    if let Some(stranger) = offsets.cameras.iter().find(|c| !known(&c.id)) {
        return Err(format!("cameras: the truth knows no camera \"{}\"", stranger.id));
    }
    let others = truth.offsets.iter().filter(|t| t.id != reference);
    let scored = others.map(|t| {
        let given = offsets.cameras.iter().find(|c| c.id == t.id);
        OffsetResult::new(&t.id, given, Some(t.offset_s), Some(frame_s))
    });
    Ok(scored.collect())
}

/// Returns the absolute errors of the estimated offsets in frame intervals, ascending. Cameras without an error are
/// skipped.
pub fn errors_frames(scored: &[OffsetResult]) -> Vec<f64> {
    let errors = scored.iter().filter_map(|camera| camera.error_frames);
    let mut errors: Vec<f64> = errors.map(f64::abs).collect();
    errors.sort_by(f64::total_cmp);
    errors
}

#[cfg(test)]
mod tests {
    use super::*;

    fn truth() -> Truth {
        let folder = tempfile::tempdir().unwrap();
        let text = r#"{"format": "stlfr-truth", "version": 1, "scene": "s", "rig": "r",
            "offsets": [{"id": "a", "offset_s": 0.0}, {"id": "b", "offset_s": 0.010},
                        {"id": "c", "offset_s": -0.005}, {"id": "d", "offset_s": 0.001}],
            "shutter": [], "views": []}"#;
        crate::host::write_atomically(&folder.path().join("truth/truth.json"), text.as_bytes())
            .unwrap();
        Truth::open(folder.path()).unwrap().unwrap()
    }

    fn offsets(text: &str) -> Offsets {
        serde_json::from_str(text).unwrap()
    }

    #[test]
    fn errors_are_in_frames_and_in_standard_errors() {
        let given = offsets(
            r#"{"reference": "a", "cameras": [{"id": "a", "offset_s": 0, "std_err_s": 0},
                {"id": "b", "offset_s": 0.011, "std_err_s": 0.0005},
                {"id": "c", "offset_s": -0.0075, "std_err_s": 0},
                {"id": "d", "offset_s": null, "std_err_s": null}]}"#,
        );
        let scored = score_offsets(&given, &truth(), "a", 0.04).unwrap();
        assert_eq!(scored.len(), 3);
        assert!((scored[0].z.unwrap() - 2.0).abs() < 1e-9);
        assert_eq!((scored[1].z, scored[2].error_frames), (None, None));
        let errors = errors_frames(&scored);
        assert!(errors.len() == 2 && (errors[0] - 0.025).abs() < 1e-9);
        assert!((errors[1] - 0.0625).abs() < 1e-9);
    }

    #[test]
    fn another_reference_and_strangers_are_refused() {
        let other = offsets(r#"{"reference": "b", "cameras": []}"#);
        let complaint = score_offsets(&other, &truth(), "a", 0.04).unwrap_err();
        assert!(complaint.contains("must be \"a\""), "{complaint}");
        let stranger = offsets(
            r#"{"reference": "a", "cameras": [{"id": "x", "offset_s": 0, "std_err_s": 0}]}"#,
        );
        let complaint = score_offsets(&stranger, &truth(), "a", 0.04).unwrap_err();
        assert!(complaint.contains("no camera \"x\""), "{complaint}");
    }
}
