//! The frames of a capture, decoded and prepared for registration when they are first used, and shared.

use super::{Frame, GainMethod, Gains, RegistrationOptions};
use crate::capture::{Capture, CaptureError, Color};
use crate::host::BoundedCache;
use crate::raster::Image;
use std::sync::{Arc, OnceLock};

/// The frames of a capture, prepared for registration, in a cache of bounded memory that holds those
/// used last.
pub struct FrameStore {
    capture: Arc<Capture>,
    options: RegistrationOptions,
    /// By camera and frame index; the cost is in bytes.
    frames: BoundedCache<(usize, usize), Arc<Frame>>,
    max_bytes: usize,
    /// Minimum cost of a frame, bytes, so that the number of frames is bounded too.
    min_cost: usize,
    gains: OnceLock<Gains>,
    /// Camera and index of every frame that was decoded, in order.
    #[cfg(test)]
    pub(crate) decoded: std::sync::Mutex<Vec<(usize, usize)>>,
}

/// Default bound of the cache, bytes: 32 colour frames of 640×480, which is four for each of eight cameras
/// at an instant. Larger: memory; smaller: frames are decoded more than once.
const MAX_BYTES: usize = 192 << 20;

/// Maximum number of cached frames per camera, so that a long recording of small images takes no more
/// memory than a short one. Larger: memory; smaller: frames are decoded more than once.
const MAX_FRAMES: usize = 24;

impl FrameStore {
    /// A store with the default bound of memory, 192 MiB.
    pub fn new(capture: Arc<Capture>, options: &RegistrationOptions) -> Self {
        Self::with_bound(capture, options, MAX_BYTES)
    }

    /// A store that caches at most `max_bytes` of frames. The frame used last is cached whatever its
    /// size.
    pub fn with_bound(
        capture: Arc<Capture>,
        options: &RegistrationOptions,
        max_bytes: usize,
    ) -> Self {
        let max_frames = MAX_FRAMES * capture.cameras.len();
        Self {
            capture,
            options: options.clone(),
            frames: BoundedCache::new(max_bytes),
            max_bytes,
            min_cost: max_bytes.div_ceil(max_frames),
            gains: OnceLock::new(),
            #[cfg(test)]
            decoded: std::sync::Mutex::default(),
        }
    }

    /// The cost of the cached frames, bytes. A small frame counts as the 24th part of its camera's part
    /// of the bound.
    pub fn bytes(&self) -> usize {
        self.frames.cost()
    }

    /// The capture that the frames are of.
    pub fn capture(&self) -> &Capture {
        &self.capture
    }

    /// The options that the frames are prepared with.
    pub fn options(&self) -> &RegistrationOptions {
        &self.options
    }

    /// Frame `index` of camera `camera`, both indices into the capture.
    ///
    /// # Errors
    /// If the frame cannot be read.
    ///
    /// # Panics
    /// If there is no such camera or frame.
    pub fn get(&self, camera: usize, index: usize) -> Result<Arc<Frame>, CaptureError> {
        if let Some(frame) = self.frames.get(&(camera, index)) {
            return Ok(frame);
        }
        let image = self.capture.read_frame(camera, index)?;
        #[cfg(test)]
        self.decoded.lock().unwrap().push((camera, index));
        let frame = Arc::new(self.prepared(camera, image));
        self.frames.insert((camera, index), frame.clone(), self.cost(camera));
        Ok(frame)
    }

    /// Whether this many frames of each camera fit the cache together.
    pub fn fits(&self, cameras: impl Iterator<Item = usize>, frames_each: usize) -> bool {
        let cost: usize = cameras.map(|c| self.cost(c)).sum();
        cost.saturating_mul(frames_each) <= self.max_bytes
    }

    /// The cost of a camera's frame, bytes.
    fn cost(&self, camera: usize) -> usize {
        let filmed = &self.capture.cameras[camera];
        let size = [filmed.camera.width, filmed.camera.height];
        let channels = match filmed.color {
            Color::Rgb => 3,
            Color::Gray => 1,
        };
        Frame::bytes_of(size, channels, &self.options).max(self.min_cost)
    }

    /// The image of a camera as a frame whose pyramid is as bright as the reference camera's.
    fn prepared(&self, camera: usize, image: Image) -> Frame {
        match self.gains().corrected(camera, &image) {
            Some(corrected) => Frame::with_corrected(image, corrected, &self.options),
            None => Frame::new(image, &self.options),
        }
    }

    /// Makes these the cameras' gains, as an earlier store has estimated them. No effect once gains are known.
    pub(crate) fn know_gains(&self, gains: Gains) {
        let _ = self.gains.set(gains);
    }

    /// The cameras' gains, estimated from the images by the first call. All 1 for a single camera, or if
    /// [`RegistrationOptions::gains`] is [`GainMethod::Equal`].
    pub fn gains(&self) -> &Gains {
        if let Some(gains) = self.gains.get() {
            return gains;
        }
        // Threads that call at once all compute the same. They must not wait for each other: the
        // estimate itself may run on, and wait for, the thread that would have to wait.
        let gains = match self.options.gains {
            GainMethod::Estimated if self.capture.cameras.len() > 1 => {
                Gains::estimate(&self.capture, &self.options)
            }
            _ => Gains::equal(self.capture.cameras.len()),
        };
        self.gains.get_or_init(|| gains)
    }
}
