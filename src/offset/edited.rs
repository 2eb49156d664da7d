//! The validation of offsets that somebody has edited: field by field, against the capture.

use super::store::{CameraOffset, Offsets};
use crate::capture::{Capture, FilmedCamera, MAX_DRIFT_PPM, are_frame_times};

/// Longest reason of an unknown offset, characters. Larger: a file fills the terminal. Smaller: a
/// sentence is refused.
const MAX_REASON_CHARS: usize = 500;

/// The field that is refused, and the sentence's end.
#[derive(Debug, PartialEq)]
pub(super) struct Refused {
    pub field: String,
    pub reason: String,
}

type Checked = Result<(), Refused>;

fn refuse(field: impl Into<String>, reason: impl Into<String>) -> Checked {
    Err(Refused { field: field.into(), reason: reason.into() })
}

/// The offsets with their cameras in the capture's order, if all fields are as [`super::file`] says.
pub(super) fn checked(given: Offsets, capture: &Capture) -> Result<Offsets, Refused> {
    let reference = &capture.cameras[capture.reference].id;
    if given.reference != *reference {
        let reason = format!("is '{}', the capture's is '{reference}'", given.reference);
        refuse("reference", reason)?;
    }
    let mut in_order: Vec<Option<(usize, CameraOffset)>> = vec![None; capture.cameras.len()];
    for (k, camera) in given.cameras.into_iter().enumerate() {
        let field = format!("cameras[{k}].id");
        let Some(index) = capture.camera_index(&camera.id) else {
            refuse(field, format!("no camera of the capture has the id '{}'", camera.id))?;
            continue;
        };
        if in_order[index].is_some() {
            refuse(field, format!("'{}' is there twice", camera.id))?;
        }
        in_order[index] = Some((k, camera));
    }
    let reach_s = capture.reach_s();
    let mut cameras = Vec::new();
    for (index, entry) in in_order.into_iter().enumerate() {
        let Some((k, camera)) = entry else {
            refuse("cameras", format!("'{}' is missing", capture.cameras[index].id))?;
            continue;
        };
        let of = Fields { k, camera: &camera };
        let filmed = &capture.cameras[index];
        of.offset(reach_s, capture.has_reference_clock(index))?;
        of.rate(filmed.clock.drift && index != capture.reference)?;
        of.lost_before(filmed)?;
        of.reason()?;
        cameras.push((k, camera));
    }
    let places: Vec<usize> = cameras.iter().map(|(k, _)| *k).collect();
    let cameras = cameras.into_iter().map(|(_, camera)| camera).collect();
    let offsets = Offsets { reference: given.reference, cameras };
    times(&offsets, &places, capture)?;
    Ok(offsets)
}

/// The fields of one camera, and its place in the file.
struct Fields<'a> {
    k: usize,
    camera: &'a CameraOffset,
}

impl Fields<'_> {
    fn refuse(&self, field: &str, reason: impl Into<String>) -> Checked {
        refuse(format!("cameras[{}] ({}).{field}", self.k, self.camera.id), reason)
    }

    fn offset(&self, reach_s: f64, is_on_reference: bool) -> Checked {
        let CameraOffset { offset_s, std_err_s, .. } = *self.camera;
        if is_on_reference {
            for (field, value) in [("offset_s", offset_s), ("std_err_s", std_err_s)] {
                if value != Some(0.0) {
                    self.refuse(field, "must be 0 on the reference camera's clock")?;
                }
            }
            return Ok(());
        }
        match (offset_s, std_err_s) {
            (None, None) => Ok(()),
            (None, Some(_)) => self.refuse("std_err_s", "must be null where offset_s is"),
            (Some(_), None) => self.refuse("std_err_s", "is missing"),
            (Some(offset_s), _) if !offset_s.is_finite() => {
                self.refuse("offset_s", "must be finite")
            }
            (_, Some(error_s)) if !(0.0..=reach_s).contains(&error_s) => {
                self.refuse("std_err_s", format!("is {error_s:?}, must be from 0 to {reach_s} s"))
            }
            _ => Ok(()),
        }
    }

    fn rate(&self, may_drift: bool) -> Checked {
        let (rate, error) = (self.camera.rate_ppm, self.camera.rate_std_err_ppm);
        let Some(rate) = rate else {
            return match error {
                Some(_) => self.refuse("rate_std_err_ppm", "is there without a rate_ppm"),
                None => Ok(()),
            };
        };
        if self.camera.offset_s.is_none() {
            return self.refuse("rate_ppm", "is there without an offset_s");
        }
        if !may_drift && rate != 0.0 {
            return self.refuse("rate_ppm", "must be 0: the capture says nothing of a drift");
        }
        if !(rate.abs() <= MAX_DRIFT_PPM) {
            let reason = format!("is {rate:?}, must be from -{MAX_DRIFT_PPM} to {MAX_DRIFT_PPM}");
            return self.refuse("rate_ppm", reason);
        }
        match error {
            Some(error) if (0.0..=MAX_DRIFT_PPM).contains(&error) => Ok(()),
            Some(error) => self.refuse(
                "rate_std_err_ppm",
                format!("is {error:?}, must be from 0 to {MAX_DRIFT_PPM}"),
            ),
            None => self.refuse("rate_std_err_ppm", "is missing"),
        }
    }

    fn lost_before(&self, filmed: &FilmedCamera) -> Checked {
        let Some(lost) = &self.camera.lost_before else { return Ok(()) };
        let frames = filmed.frames.len();
        if !filmed.clock.lost && !lost.is_empty() {
            let reason = "must be empty: the capture says nothing of lost frames";
            return self.refuse("lost_before", reason);
        }
        if lost.len() > frames {
            let reason = format!("has {} entries, and the camera {frames} images", lost.len());
            return self.refuse("lost_before", reason);
        }
        if let Some(pair) = lost.windows(2).find(|pair| pair[0] > pair[1]) {
            let reason = format!("must ascend, and {} is before {}", pair[0], pair[1]);
            return self.refuse("lost_before", reason);
        }
        match lost.last() {
            Some(last) if *last >= frames => self.refuse(
                "lost_before",
                format!("has image {last}, and the camera's are 0 to {}", frames - 1),
            ),
            _ => Ok(()),
        }
    }

    fn reason(&self) -> Checked {
        match (&self.camera.reason, self.camera.offset_s) {
            (Some(_), Some(_)) => self.refuse("reason", "is there although offset_s is known"),
            (None, None) => self.refuse("reason", "is missing, and offset_s is null"),
            (Some(reason), None) => {
                let is_line = !reason.trim().is_empty() && !reason.contains(char::is_control);
                if is_line && reason.chars().count() <= MAX_REASON_CHARS {
                    return Ok(());
                }
                self.refuse(
                    "reason",
                    format!("must be a line of at most {MAX_REASON_CHARS} characters"),
                )
            }
            (None, Some(_)) => Ok(()),
        }
    }
}

/// That all images have times on the reference's clock, and none of them too far away. `places` are the
/// cameras' in the file.
fn times(offsets: &Offsets, places: &[usize], capture: &Capture) -> Checked {
    let all = offsets.common_times_s(capture);
    let reach_s = capture.reach_s();
    for (index, ((times, camera), &k)) in all.iter().zip(&offsets.cameras).zip(places).enumerate() {
        let (Some(times), Some(offset_s)) = (times, camera.offset_s) else { continue };
        let of = Fields { k, camera };
        let (first_s, last_s) = capture.widest_span_s(Some(index));
        if !(first_s <= times[0] && times[times.len() - 1] <= last_s) {
            let reason = format!(
                "is {offset_s:?}, which puts its images further from the reference's than all recordings last, {reach_s:.3} s"
            );
            return of.refuse("offset_s", reason);
        }
        if !are_frame_times(times) {
            return of.refuse("offset_s", format!(
                "is {offset_s:?}, so large that the times of successive frames are equal once rounded"
            ));
        }
    }
    Ok(())
}
