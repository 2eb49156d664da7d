//! Frames as registration uses them: decoded, with pyramid and corners, made once and shared.

use super::{GainRung, Gains, Pyramid, RegistrationOptions, corners};
use crate::capture::{Capture, CaptureError};
use crate::raster::Image;
use nalgebra::Point2;
use std::collections::HashMap;
use std::sync::{Arc, Mutex, OnceLock};

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
    kept: Mutex<Kept>,
    max_bytes: usize,
    gains: OnceLock<Gains>,
}

#[derive(Default)]
struct Kept {
    frames: HashMap<(usize, usize), (u64, Arc<Frame>)>,
    bytes: usize,
    clock: u64,
}

/// What the store may hold, bytes: 35 frames of 640×480 in colour, what eight cameras need at one
/// instant, four frames each, and a few more. More only saves decoding.
const MAX_BYTES: usize = 192 << 20;
/// And frames a camera, so that a long film of small images takes no more memory than a short one.
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
        Self {
            capture,
            options: options.clone(),
            kept: Mutex::default(),
            max_bytes,
            gains: OnceLock::new(),
        }
    }

    /// Bytes of the frames that are held.
    pub fn bytes(&self) -> usize {
        self.kept().bytes
    }

    pub fn capture(&self) -> &Capture {
        &self.capture
    }

    pub fn options(&self) -> &RegistrationOptions {
        &self.options
    }

    /// One frame of one camera.
    pub fn get(&self, camera: usize, index: usize) -> Result<Arc<Frame>, CaptureError> {
        if let Some(frame) = self.kept().find((camera, index)) {
            return Ok(frame);
        }
        let image = self.capture.read_frame(camera, index)?;
        let frame = Arc::new(Frame::of_camera(image, camera, self.gains(), &self.options));
        let max_frames = MAX_FRAMES * self.capture.cameras.len();
        self.kept().insert((camera, index), &frame, max_frames, self.max_bytes);
        Ok(frame)
    }

    /// The cameras' gains, told from the images when they are first asked for.
    pub fn gains(&self) -> &Gains {
        if let Some(gains) = self.gains.get() {
            return gains;
        }
        // Threads that ask at once all find the same. To let them wait would not do: one of them
        // may be waited for by the search itself.
        let found = match self.options.gains {
            GainRung::Estimated if self.capture.cameras.len() > 1 => {
                Gains::survey(&self.capture, &self.options)
            }
            _ => Gains::equal(self.capture.cameras.len()),
        };
        self.gains.get_or_init(|| found)
    }

    fn kept(&self) -> std::sync::MutexGuard<'_, Kept> {
        // Nothing in there panics half-way, so a poisoned lock still guards a whole store.
        self.kept.lock().unwrap_or_else(std::sync::PoisonError::into_inner)
    }
}

impl Kept {
    fn find(&mut self, key: (usize, usize)) -> Option<Arc<Frame>> {
        self.clock += 1;
        let (used, frame) = self.frames.get_mut(&key)?;
        *used = self.clock;
        Some(frame.clone())
    }

    fn insert(
        &mut self,
        key: (usize, usize),
        frame: &Arc<Frame>,
        max_frames: usize,
        max_bytes: usize,
    ) {
        self.clock += 1;
        if self.frames.insert(key, (self.clock, frame.clone())).is_none() {
            self.bytes += frame.bytes();
        }
        let too_many = |kept: &Self| kept.bytes > max_bytes || kept.frames.len() > max_frames;
        while too_many(self) && self.frames.len() > 1 {
            let oldest = self.frames.iter().min_by_key(|(_, (used, _))| *used).map(|(k, _)| *k);
            if let Some((_, frame)) = oldest.and_then(|k| self.frames.remove(&k)) {
                self.bytes -= frame.bytes();
            }
        }
    }
}
