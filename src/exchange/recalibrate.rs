//! Import of recordings without a calibration, and copies of captures with new calibrations.

use super::import::{NewCapture, import, link, name_of};
use super::pairing::{extension, uncalibrated};
use super::request::{ImportClock, ImportRequest};
use super::{ExchangeError, content};
use crate::camera::CameraFormat;
use crate::capture::{CAPTURE_FILE, CalibrationCovarianceFormat, Capture, CaptureFormat, Opening};
use crate::host::temporary::Temporary;
use crate::json;
use std::path::{Path, PathBuf};

/// Name of a [`Draft`]'s folder inside its temporary folder.
const DRAFT: &str = "draft";

/// A temporary capture that is not calibrated yet: its lenses and poses are placeholders. Its folder is removed when
/// the value is dropped.
pub struct Draft {
    /// Folder of the temporary capture.
    pub folder: PathBuf,
    /// Sentences for the user. They say which recordings were found, and how they are interpreted.
    pub notes: Vec<String>,
    _temporary: Temporary,
}

impl Draft {
    /// Imports the videos and the sub-folders of images in the folder `images` into a draft. The draft is in a
    /// temporary folder beside `target`, the path of the capture that will be made from it. `times` is a table with the
    /// times of all frames. The id of a camera is the name of its recording.
    ///
    /// Errors: the errors of [`import`], and fewer than two recordings.
    pub fn import(
        images: &Path,
        times: Option<&Path>,
        clock: ImportClock,
        target: &Path,
        opening: &Opening,
    ) -> Result<Self, ExchangeError> {
        let cameras = uncalibrated(images)?;
        let failed = |source| ExchangeError::Write { path: target.to_owned(), source };
        let absolute = std::path::absolute(target).map_err(failed)?;
        let beside = absolute.parent().ok_or_else(|| content(target, "names no folder"))?;
        let temporary = Temporary::inside(beside).map_err(failed)?;
        let folder = temporary.path().join(DRAFT);
        let request = ImportRequest {
            images,
            table: None,
            times,
            clock,
            is_cropped: false,
            is_uncalibrated: true,
        };
        let notes = import(&cameras, &request, &folder, opening)?;
        Ok(Self { folder, notes, _temporary: temporary })
    }
}

/// A calibration that was estimated for the cameras of a capture.
pub struct NewCalibration {
    /// Lens and pose of each camera, in the order of the capture's cameras.
    pub cameras: Vec<CameraFormat>,
    /// Joint covariance of the calibration errors of all cameras; `None` if it is unknown.
    pub covariance: Option<CalibrationCovarianceFormat>,
}

/// Makes the capture `target` from the frames and clocks of `capture`, with another calibration. Frames are
/// hard-linked, or copied where the file system can't link them. The folder `target` appears only when the capture is
/// complete and can be opened.
///
/// The ground truth, the offsets and the COLMAP model of `capture` are not copied, because they belong to the earlier
/// calibration.
///
/// Errors: a target that is not empty, another number of cameras, a camera whose size differs from the size of its
/// frames.
pub fn recalibrate(
    capture: &Capture,
    calibration: NewCalibration,
    target: &Path,
    opening: &Opening,
) -> Result<(), ExchangeError> {
    let NewCalibration { cameras, covariance } = calibration;
    let description = capture.folder.join(CAPTURE_FILE);
    let mut format: CaptureFormat =
        json::read(&description).map_err(|error| content(&description, error))?;
    if cameras.len() != capture.cameras.len() || format.cameras.len() != cameras.len() {
        return Err(content(&description, "has another number of cameras than the calibration"));
    }
    let new = NewCapture::begin(target)?;
    format.name = name_of(target)?;
    format.calibration_covariance = covariance;
    for ((filmed, described), camera) in
        capture.cameras.iter().zip(&mut format.cameras).zip(&cameras)
    {
        let id = &filmed.id;
        let linked = |from: &Path, name: String| {
            let linked = link(from, &new.whole.join(name));
            let (path, to) = (from.to_owned(), target.to_owned());
            linked.map_err(|source| ExchangeError::Copy { path, to, source })
        };
        described.frames = if let Some(video) = &filmed.video {
            let name = format!("{id}.{}", extension(&video.path).unwrap_or_default());
            linked(&video.path, name.clone())?;
            name
        } else {
            let extension = extension(&filmed.frames[0]).unwrap_or_default();
            let made = std::fs::create_dir(new.whole.join(id));
            made.map_err(|source| ExchangeError::Write { path: target.to_owned(), source })?;
            for (k, frame) in filmed.frames.iter().enumerate() {
                linked(frame, format!("{id}/{k:04}.{extension}"))?;
            }
            format!("{id}/%04d.{extension}")
        };
        let CameraFormat { width, height, model, params, cam_from_world } = camera.clone();
        (described.width, described.height) = (width, height);
        (described.model, described.params) = (model, params);
        described.cam_from_world = cam_from_world;
        described.calibration_std = None;
    }
    new.finish(&format, target, opening)
}
