//! The decoded frames of a capture, prepared for registration.

use super::{Frame, GainMethod, Gains, RegistrationOptions};
use crate::capture::{Capture, CaptureError, Color};
use crate::host::Memo;
use std::sync::Arc;

/// The frames of a capture. They are decoded and prepared for registration when they are first used, and then
/// cached.
#[derive(Clone)]
pub struct FrameStore {
    capture: Arc<Capture>,
    options: RegistrationOptions,
    /// The memo, which is the cache in memory that holds the frames.
    pub memo: Arc<Memo>,
    /// Camera and index of every frame that has been decoded, in order; for tests.
    #[cfg(test)]
    pub(crate) decoded: Arc<std::sync::Mutex<Vec<(usize, usize)>>>,
}

/// Minimum size of the default memo, bytes. Between this and [`MAX_BYTES`], the size is proportional to that
/// of the cameras' images.
const MIN_BYTES: usize = 208 << 20;
/// Maximum size of the default memo, bytes. It is enough for eight cameras of 1920×1080: their frames, and
/// their depth and motion maps, in two of the time intervals in which scene flow is estimated.
const MAX_BYTES: usize = 1 << 30;

/// Size of the default memo, in frames of each camera. It is enough for all data from which views at one
/// instant are rendered.
const FRAMES_OF_INSTANT: usize = 3;

/// Maximum number of cached frames per camera. It bounds the memory for a long recording of small images.
const MAX_FRAMES: usize = 24;

/// Name, in the memo, of the stage that decodes a frame.
const FRAME_STAGE: &str = "frame";

/// Name, in the memo, of the stage that estimates the gains.
const GAINS_STAGE: &str = "gains";

impl FrameStore {
    /// A store with a memo of its own, of the default size.
    pub fn new(capture: Arc<Capture>, options: &RegistrationOptions) -> Self {
        let cameras = 0..capture.cameras.len();
        let instant: usize = cameras.map(|c| bytes_of(&capture, c, options)).sum();
        let max_bytes = instant.saturating_mul(FRAMES_OF_INSTANT).clamp(MIN_BYTES, MAX_BYTES);
        Self::with_memo(capture, options, Arc::new(Memo::new(max_bytes)))
    }

    /// A store whose frames are cached in a memo, which must not hold frames of another capture.
    pub fn with_memo(
        capture: Arc<Capture>,
        options: &RegistrationOptions,
        memo: Arc<Memo>,
    ) -> Self {
        Self {
            capture,
            options: options.clone(),
            memo,
            #[cfg(test)]
            decoded: Arc::default(),
        }
    }

    /// The capture to which the frames belong.
    pub fn capture(&self) -> &Arc<Capture> {
        &self.capture
    }

    /// The options of registration.
    pub fn options(&self) -> &RegistrationOptions {
        &self.options
    }

    /// Frame `index` of camera `camera`; both are indices into the capture.
    ///
    /// # Errors
    /// If the frame cannot be read.
    ///
    /// # Panics
    /// If there is no such camera or frame.
    pub fn get(&self, camera: usize, index: usize) -> Result<Arc<Frame>, CaptureError> {
        let inputs = (camera, index, &self.options);
        if let Some(frame) = self.memo.get(FRAME_STAGE, &inputs) {
            return Ok(frame);
        }
        let image = self.capture.read_frame(camera, index)?;
        #[cfg(test)]
        self.decoded.lock().unwrap().push((camera, index));
        // The pyramid is of the gain-corrected image.
        let time_s = self.capture.cameras[camera].clock.times_s[index];
        let frame = match self.gains().corrected(camera, time_s, &image) {
            None => Frame::new(image, &self.options),
            Some(corrected) => {
                let mut frame = Frame::new(corrected, &self.options);
                frame.image = image;
                frame
            }
        };
        Ok(self.memo.insert(FRAME_STAGE, &inputs, Arc::new(frame), self.bytes_of(camera)))
    }

    /// Frame `index` of camera `camera`, with its image as the camera would have exposed it at a time on its own clock,
    /// seconds. It is converted anew by each call if the camera's gains change.
    ///
    /// # Errors
    /// If the frame cannot be read.
    ///
    /// # Panics
    /// If there is no such camera or frame.
    pub fn get_exposed_at(
        &self,
        camera: usize,
        index: usize,
        time_s: f64,
    ) -> Result<Arc<Frame>, CaptureError> {
        let frame = self.get(camera, index)?;
        let own_s = self.capture.cameras[camera].clock.times_s[index];
        let image = self.gains().exposed_at(camera, [own_s, time_s], &frame.image);
        Ok(image.map_or_else(|| frame.clone(), |image| Arc::new(frame.with_image(image))))
    }

    /// Whether `frames_each` frames of each of these cameras fit the memo together.
    pub fn fits(&self, cameras: impl Iterator<Item = usize>, frames_each: usize) -> bool {
        let bytes: usize = cameras.map(|c| self.bytes_of(c)).sum();
        bytes.saturating_mul(frames_each) <= self.memo.max_bytes()
    }

    /// The size, bytes, that the memo assumes for one frame of a camera. It is at least so large that
    /// [`MAX_FRAMES`] frames of every camera fill the memo.
    fn bytes_of(&self, camera: usize) -> usize {
        let max_frames = MAX_FRAMES * self.capture.cameras.len();
        let min_bytes = self.memo.max_bytes().div_ceil(max_frames);
        bytes_of(&self.capture, camera, &self.options).max(min_bytes)
    }

    /// The cameras' gains, estimated from the images. All 1 for a single camera, or if
    /// [`RegistrationOptions::gains`] is [`GainMethod::Equal`].
    pub fn gains(&self) -> Arc<Gains> {
        if let Some(gains) = self.memo.get(GAINS_STAGE, &self.options) {
            return gains;
        }
        let cameras = self.capture.cameras.len();
        let gains = if self.options.gains == GainMethod::Equal || cameras == 1 {
            Gains::equal(cameras)
        } else {
            let stored = self.capture.load_stored(Gains::KIND, &self.options);
            let stored = stored.filter(|gains: &Gains| gains.are_plausible(cameras));
            stored.unwrap_or_else(|| Gains::estimate(&self.capture, &self.options))
        };
        let bytes = gains.bytes();
        self.memo.insert(GAINS_STAGE, &self.options, Arc::new(gains), bytes)
    }

    /// Stores the gains on disk, unless they are already there; returns their size in bytes.
    ///
    /// # Errors
    /// If they can't be written.
    pub(crate) fn store_gains(&self) -> Result<u64, CaptureError> {
        let stored = match self.capture.stored(Gains::KIND, &self.options) {
            None => self.capture.store(Gains::KIND, &self.options, &*self.gains())?,
            Some(stored) => stored,
        };
        Ok(stored.bytes)
    }
}

/// The size in memory of one of a camera's frames, bytes.
fn bytes_of(capture: &Capture, camera: usize, options: &RegistrationOptions) -> usize {
    let filmed = &capture.cameras[camera];
    let channels = match filmed.color {
        Color::Rgb => 3,
        Color::Gray => 1,
    };
    Frame::bytes_of([filmed.camera.width, filmed.camera.height], channels, options)
}
