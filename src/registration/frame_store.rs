//! The decoded frames of a capture, prepared for registration.

use super::{Frame, GainMethod, Gains, RegistrationOptions};
use crate::capture::{Capture, CaptureError, Color};
use crate::host::Memo;
use std::sync::Arc;

/// The frames of a capture. A frame is decoded and prepared for registration when it is first used. It is then
/// cached in memory.
#[derive(Clone)]
pub struct FrameStore {
    capture: Arc<Capture>,
    options: RegistrationOptions,
    /// The in-memory cache ("memo") that holds the frames.
    pub memo: Arc<Memo>,
    /// (Camera index, frame index) of every decoded frame, in the order of decoding. For tests.
    #[cfg(test)]
    pub(crate) decoded: Arc<std::sync::Mutex<Vec<(usize, usize)>>>,
}

/// Minimum size of the default in-memory cache, in bytes. Between this minimum and [`MAX_BYTES`], the size is
/// proportional to the size of the cameras' images.
const MIN_BYTES: usize = 208 << 20;
/// Maximum size of the default in-memory cache, in bytes. For eight cameras of 1920×1080 pixels, the cache can hold
/// the frames and their depth and motion maps for two of the time intervals in which scene flow is estimated.
const MAX_BYTES: usize = 1 << 30;

/// Size of the default in-memory cache, as a number of frames of each camera. This is sufficient for all data from
/// which views at one instant are rendered.
const FRAMES_OF_INSTANT: usize = 3;

/// Maximum number of cached frames per camera. It limits the memory that a long recording of small images takes.
const MAX_FRAMES: usize = 24;

/// Name under which the in-memory cache holds decoded frames.
const FRAME_STAGE: &str = "frame";

/// Name under which the in-memory cache holds estimated gains.
const GAINS_STAGE: &str = "gains";

impl FrameStore {
    /// Creates a store with its own in-memory cache of the default size.
    pub fn new(capture: Arc<Capture>, options: &RegistrationOptions) -> Self {
        let cameras = 0..capture.cameras.len();
        let instant: usize = cameras.map(|c| bytes_of(&capture, c, options)).sum();
        let max_bytes = instant.saturating_mul(FRAMES_OF_INSTANT).clamp(MIN_BYTES, MAX_BYTES);
        Self::with_memo(capture, options, Arc::new(Memo::new(max_bytes)))
    }

    /// Creates a store whose frames are cached in `memo`. `memo` must not hold frames of another capture.
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

    /// Returns the capture to which the frames belong.
    pub fn capture(&self) -> &Arc<Capture> {
        &self.capture
    }

    /// Returns the options of registration.
    pub fn options(&self) -> &RegistrationOptions {
        &self.options
    }

    /// Returns frame `index` of camera `camera`; both are indices into the capture. The frame is decoded if it is
    /// not cached.
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
        // The pyramid is built from the gain-corrected image, while `image` remains as filmed.
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

    /// Returns frame `index` of camera `camera`, with its image as the camera would have exposed it at `time_s`,
    /// seconds on the camera's own clock. If the camera's gains change, every call converts the image.
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

    /// Returns whether `frames_each` frames of each of these cameras fit the in-memory cache at the same time.
    pub fn fits(&self, cameras: impl Iterator<Item = usize>, frames_each: usize) -> bool {
        let bytes: usize = cameras.map(|c| self.bytes_of(c)).sum();
        bytes.saturating_mul(frames_each) <= self.memo.max_bytes()
    }

    /// Returns the size, in bytes, that is reserved in the in-memory cache for one frame of a camera. For small images,
    /// more than a frame's size is reserved, so that at most [`MAX_FRAMES`] frames of every camera fit.
    fn bytes_of(&self, camera: usize) -> usize {
        let max_frames = MAX_FRAMES * self.capture.cameras.len();
        let min_bytes = self.memo.max_bytes().div_ceil(max_frames);
        bytes_of(&self.capture, camera, &self.options).max(min_bytes)
    }

    /// Returns the cameras' gains, which are loaded from disk or estimated from the images. All gains are 1 for a
    /// single camera, or if [`RegistrationOptions::gains`] is [`GainMethod::Equal`].
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

    /// Stores the gains on disk, unless they are already stored. Returns their size on disk in bytes.
    ///
    /// # Errors
    /// If the gains can't be written.
    pub(crate) fn store_gains(&self) -> Result<u64, CaptureError> {
        let stored = match self.capture.stored(Gains::KIND, &self.options) {
            None => self.capture.store(Gains::KIND, &self.options, &*self.gains())?,
            Some(stored) => stored,
        };
        Ok(stored.bytes)
    }
}

/// Returns the size in memory of one frame of a camera, in bytes.
fn bytes_of(capture: &Capture, camera: usize, options: &RegistrationOptions) -> usize {
    let filmed = &capture.cameras[camera];
    let channels = match filmed.color {
        Color::Rgb => 3,
        Color::Gray => 1,
    };
    Frame::bytes_of([filmed.camera.width, filmed.camera.height], channels, options)
}
