//! Scores offsets against the truth: the sub-frame synchronization benchmark.

use crate::capture::Truth;
use crate::offset::Offsets;

/// One camera's offset beside the true one.
#[derive(Clone, Debug, PartialEq)]
pub struct ScoredOffset {
    pub id: String,
    pub true_s: f64,
    /// `None` if not given, or given as unknown.
    pub offset_s: Option<f64>,
    pub std_err_s: Option<f64>,
}

/// Every camera but the reference, in the truth's order.
#[derive(Clone, Debug, PartialEq)]
pub struct OffsetScore {
    pub cameras: Vec<ScoredOffset>,
    /// Frame interval of the reference camera, seconds.
    pub frame_s: f64,
}

impl ScoredOffset {
    /// Given minus true offset, seconds.
    pub fn error_s(&self) -> Option<f64> {
        self.offset_s.map(|offset_s| offset_s - self.true_s)
    }

    /// The error in standard errors; `None` without a positive standard error.
    pub fn z(&self) -> Option<f64> {
        let std_err_s = self.std_err_s.filter(|s| *s > 0.0)?;
        self.error_s().map(|error_s| error_s / std_err_s)
    }
}

impl OffsetScore {
    /// Scores offsets. They must be relative to the camera `reference`, like the truth's; otherwise the error is one
    /// sentence.
    pub fn new(
        offsets: &Offsets,
        truth: &Truth,
        reference: &str,
        frame_s: f64,
    ) -> Result<Self, String> {
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
        let cameras = truth
            .offsets
            .iter()
            .filter(|t| t.id != reference)
            .map(|t| {
                let given = offsets.cameras.iter().find(|c| c.id == t.id);
                ScoredOffset {
                    id: t.id.clone(),
                    true_s: t.offset_s,
                    offset_s: given.and_then(|c| c.offset_s),
                    std_err_s: given.and_then(|c| c.std_err_s),
                }
            })
            .collect();
        Ok(Self { cameras, frame_s })
    }

    /// Absolute errors in frames, ascending, of cameras with an offset.
    pub fn errors_frames(&self) -> Vec<f64> {
        let mut errors: Vec<f64> = self
            .cameras
            .iter()
            .filter_map(ScoredOffset::error_s)
            .map(|error_s| error_s.abs() / self.frame_s)
            .collect();
        errors.sort_by(f64::total_cmp);
        errors
    }
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
        let score = OffsetScore::new(&given, &truth(), "a", 0.04).unwrap();
        assert_eq!(score.cameras.len(), 3);
        assert!((score.cameras[0].z().unwrap() - 2.0).abs() < 1e-9);
        assert_eq!((score.cameras[1].z(), score.cameras[2].error_s()), (None, None));
        let errors = score.errors_frames();
        assert!(errors.len() == 2 && (errors[0] - 0.025).abs() < 1e-9);
        assert!((errors[1] - 0.0625).abs() < 1e-9);
    }

    #[test]
    fn another_reference_and_strangers_are_refused() {
        let other = offsets(r#"{"reference": "b", "cameras": []}"#);
        let complaint = OffsetScore::new(&other, &truth(), "a", 0.04).unwrap_err();
        assert!(complaint.contains("must be \"a\""), "{complaint}");
        let stranger = offsets(
            r#"{"reference": "a", "cameras": [{"id": "x", "offset_s": 0, "std_err_s": 0}]}"#,
        );
        let complaint = OffsetScore::new(&stranger, &truth(), "a", 0.04).unwrap_err();
        assert!(complaint.contains("no camera \"x\""), "{complaint}");
    }
}
