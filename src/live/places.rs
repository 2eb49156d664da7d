//! Viewpoints of pictures.

use super::{LiveError, PictureRequest, Place, RigFrame};
use crate::camera::Camera;
use crate::capture::Capture;

/// All viewpoints: around the rig, at its cameras, and at true images.
#[derive(Clone, Debug)]
pub struct Places {
    rig: RigFrame,
    cameras: Vec<Camera>,
    truths: Vec<Camera>,
}

impl Places {
    /// The viewpoints of a capture; `spacing_m` is the distance of neighbouring cameras.
    pub(super) fn new(capture: &Capture, spacing_m: f64, truths: Vec<Camera>) -> Self {
        let cameras = capture.cameras.iter().map(|c| c.camera.clone()).collect();
        Self { rig: RigFrame::new(capture, spacing_m), cameras, truths }
    }

    pub fn rig(&self) -> &RigFrame {
        &self.rig
    }

    /// The camera of a picture.
    ///
    /// # Errors
    /// If its place or its size is out of bounds, or no camera or image of the truth is there.
    pub fn camera(&self, request: &PictureRequest) -> Result<Camera, LiveError> {
        let found = |all: &[Camera], index: usize, what: &str| match all.get(index) {
            Some(camera) => self.rig.from_camera(camera, &request.view),
            None => Err(LiveError::Request(format!("at: there is no such {what}"))),
        };
        match request.place {
            Place::Free(place) => self.rig.from_place(place, &request.view),
            Place::Camera(index) => found(&self.cameras, index, "camera"),
            Place::Truth(index) => found(&self.truths, index, "image of the truth"),
        }
    }
}
