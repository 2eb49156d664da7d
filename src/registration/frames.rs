//! Frames as registration uses them: decoded, with pyramid and corners, made once and shared.

use super::{GainMethod, Gains, Pyramid, RegistrationOptions, corners};
use crate::capture::{Capture, CaptureError};
use crate::host::BoundedCache;
use crate::raster::Image;
use nalgebra::Point2;
use std::sync::{Arc, OnceLock};

/// One frame.
#[derive(Debug)]
pub struct Frame {
    /// As it was filmed.
    pub image: Image,
    /// As bright as the reference records it, to be tracked in.
    pub pyramid: Pyramid,
    corners: OnceLock<Vec<Point2<f64>>>,
}

impl Frame {
    pub fn new(image: Image, options: &RegistrationOptions) -> Self {
        let pyramid = Pyramid::new(&image, options.klt.levels, options.klt.pad_px());
        Self { image, pyramid, corners: OnceLock::new() }
    }

    /// Of a camera whose gain may not be the reference's.
    fn of_camera(
        image: Image,
        camera: usize,
        gains: &Gains,
        options: &RegistrationOptions,
    ) -> Self {
        match gains.corrected(camera, &image) {
            Some(corrected) => Self { image, ..Self::new(corrected, options) },
            None => Self::new(image, options),
        }
    }

    /// The frame's corners, found when they are first asked for.
    pub fn corners(&self, options: &RegistrationOptions) -> &[Point2<f64>] {
        self.corners.get_or_init(|| corners(&self.pyramid.levels()[0], &options.corners))
    }

    fn bytes(&self) -> usize {
        let level: usize = self.pyramid.levels().iter().map(|l| l.value.len()).sum();
        size_of::<f32>() * (self.image.data().len() + level)
    }
}

/// The frames of a capture that were used last, within a bound of memory.
pub struct FrameStore {
    capture: Arc<Capture>,
    options: RegistrationOptions,
    /// By camera and frame; the cost is in bytes.
    frames: BoundedCache<(usize, usize), Arc<Frame>>,
    /// What the smallest frame costs, bytes, so that the number of frames is bounded too.
    min_cost: usize,
    gains: OnceLock<Gains>,
}

/// What the store may hold, bytes: 35 frames of 640×480 in colour, what eight cameras need at one
/// instant, four frames each, and a few more. More only saves decoding.
const MAX_BYTES: usize = 192 << 20;

/// How many frames a camera the store may hold, so that a long recording of small images takes no
/// more memory than a short one. More only saves decoding.
const MAX_FRAMES: usize = 24;

impl FrameStore {
    pub fn new(capture: Arc<Capture>, options: &RegistrationOptions) -> Self {
        Self::with_bound(capture, options, MAX_BYTES)
    }

    /// One that holds no more than so many bytes of frames, though always the last one.
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
            min_cost: max_bytes.div_ceil(max_frames),
            gains: OnceLock::new(),
        }
    }

    /// Bytes of the frames that are held, a small frame counting as [`MAX_FRAMES`] allows.
    pub fn bytes(&self) -> usize {
        self.frames.cost()
    }

    pub fn capture(&self) -> &Capture {
        &self.capture
    }

    pub fn options(&self) -> &RegistrationOptions {
        &self.options
    }

    /// One frame of one camera.
    pub fn get(&self, camera: usize, index: usize) -> Result<Arc<Frame>, CaptureError> {
        if let Some(frame) = self.frames.get(&(camera, index)) {
            return Ok(frame);
        }
        let image = self.capture.read_frame(camera, index)?;
        let frame = Arc::new(Frame::of_camera(image, camera, self.gains(), &self.options));
        let cost = frame.bytes().max(self.min_cost);
        self.frames.insert((camera, index), frame.clone(), cost);
        Ok(frame)
    }

    /// The cameras' gains, estimated from the images when they are first asked for.
    pub fn gains(&self) -> &Gains {
        if let Some(gains) = self.gains.get() {
            return gains;
        }
        // Threads that ask at once all compute the same. They can't wait for each other: one of
        // them may be waited for by the estimate itself.
        let gains = match self.options.gains {
            GainMethod::Estimated if self.capture.cameras.len() > 1 => {
                Gains::survey(&self.capture, &self.options)
            }
            _ => Gains::equal(self.capture.cameras.len()),
        };
        self.gains.get_or_init(|| gains)
    }
}
