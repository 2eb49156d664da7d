//! Cross-validation on held-out frames. A view with the camera and the time of a recorded frame is rendered from other
//! cameras only. Its difference from the recorded frame measures the error of a method on this capture ([`Probe`]).
//!
//! Three methods are judged by their errors on held-out frames: the sync method that blends images from all cameras,
//! scene flow, and blending weights in time. The sync method that refines motion per pixel is judged by how much it
//! changes views between cameras, relative to the error on held-out frames.

use crate::camera::Camera;
use crate::capture::{Capture, CaptureError};
use crate::interpolation::changed_pixels;
use crate::light_field::{LightField, RenderError};
use crate::lumigraph::{BlendMethod, Rendered};
use crate::metrics::moving_part;
use crate::offset::Offsets;
use crate::options::RenderOptions;
use crate::raster::Image;
use crate::registration::{FrameStore, Gains, RegistrationOptions};
use nalgebra::Vector3;
use std::cmp::Reverse;
use std::f64::consts::LN_10;
use std::sync::Arc;

/// Number of held-out frames. Each is from a different camera. The frames are spread over the recording, because PSNR
/// gains differ by half a decibel between instants.
const FRAMES: usize = 4;

/// Number of cameras from which a held-out frame is rendered: those nearest to the camera that recorded the frame.
const NEIGHBORS: usize = 4;

/// Candidates for the instant at which sync methods are compared, in order of preference. Each is a fraction of the
/// time from the held-out frame to the camera's next frame.
const FRACTIONS: [f64; 3] = [0.5, 0.25, 0.75];

/// Radius, in pixels, by which the mask of a frame's changing pixels is dilated. It covers the parallax of the changing
/// surfaces between the frame and a view halfway to the nearest camera.
const PARALLAX_PX: usize = 16;

/// Minimum time between a view's instant and the camera's frames before and after it, as a fraction of the camera's
/// frame interval. Only cameras without a nearer frame are counted, because interpolation very near to a frame has
/// hardly any error to measure.
const MIN_FRACTION: f64 = 0.1;

/// Minimum number of changing pixels in a held-out frame. A pixel is changing if it differs from the frame before or
/// after by more than noise.
const MIN_PIXELS: usize = 64;

/// The held-out frames of a capture, by which methods are compared. Each held-out frame comes with a light field of the
/// neighbouring cameras only, from which its view is rendered.
pub struct Probe {
    frames: Vec<HeldOutFrame>,
}

struct HeldOutFrame {
    /// Light field of the nearest other cameras, without the camera of this frame.
    neighbors: LightField,
    camera: Camera,
    /// Description of the held-out frame, such as `frame 3 of cam1`, with the frame's index and the camera's id.
    name: String,
    time_s: f64,
    /// Camera of the view in which sync methods are compared. It is halfway between `camera` and the nearest other
    /// camera.
    view: Camera,
    /// Instant of `view`, in seconds. It lies between the held-out frame and the camera's next frame. If the held-out
    /// frame is the camera's last, it lies between this frame and the frame before.
    view_s: f64,
    /// The held-out frame as recorded, corrected to the gains of the reference camera.
    truth: Image,
    /// Exposure of views that are rendered from `neighbors`: a camera and a time. The views have the gains of this
    /// camera at this time. The camera is the reference camera of `neighbors`, by its index in the whole capture. The
    /// time is seconds on the camera's own clock.
    exposure: (usize, f64),
    gains: Arc<Gains>,
    /// Mask, row by row, of the changing pixels. There, the held-out frame differs from the camera's frame before or
    /// after by more than noise.
    changing: Vec<bool>,
    /// The mask of changing pixels, row by row, dilated by [`PARALLAX_PX`] pixels.
    near_changing: Vec<bool>,
}

/// Sums of the squared errors of views relative to the held-out frames, one sum for each kind of blending weights.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct HeldOutErrors {
    pub in_space: f64,
    pub in_space_and_time: f64,
}

impl HeldOutErrors {
    /// Returns the sum of squared errors for a blending method. If `is_decided_later` is true, the blending method will
    /// be chosen later, and the smaller of the two sums is returned.
    pub fn by(&self, blend: BlendMethod, is_decided_later: bool) -> f64 {
        match blend {
            _ if is_decided_later => self.in_space.min(self.in_space_and_time),
            BlendMethod::SpaceTime => self.in_space_and_time,
            BlendMethod::Lumigraph | BlendMethod::Uniform => self.in_space,
        }
    }
}

impl Probe {
    /// Chooses the held-out frames. Returns `None` if no camera has a suitable frame. In time, a suitable frame lies
    /// between two frames of at least half of the nearest cameras. At least 64 of its pixels change from the frame
    /// before or after. If all cameras film at the same times, no frame is suitable.
    pub fn open(
        whole: &LightField,
        registration: &RegistrationOptions,
    ) -> Result<Option<Self>, RenderError> {
        let times_s = whole.offsets().common_times_s(whole.capture());
        let mut frames = Vec::new();
        for camera in inner_cameras(whole.capture()) {
            let Some(times_s) = &times_s[camera] else { continue };
            frames.extend(HeldOutFrame::open(whole, camera, times_s, frames.len(), registration)?);
            if frames.len() == FRAMES {
                break;
            }
        }
        Ok((!frames.is_empty()).then_some(Self { frames }))
    }

    /// Returns a list of the held-out frames as text, such as `frame 3 of cam1, frame 8 of cam2`.
    pub fn names(&self) -> String {
        let names: Vec<&str> = self.frames.iter().map(|f| f.name.as_str()).collect();
        names.join(", ")
    }

    /// Estimates the largest PSNR gain, in decibels, that the slower options `dearer` can have over the options
    /// `cheaper`. The gain is 10·log₁₀(1 + D/E), for the changing pixels of views between cameras.
    ///
    /// D is the sum of squared differences between the views with both options. E is the sum of squared errors of
    /// `dearer` on the held-out frames. The estimate assumes that every change by `dearer` is an improvement, and that
    /// views between cameras have the same error as held-out frames. Returns `None` if no frame can be rendered, or if
    /// no changing pixel is visible.
    ///
    /// The gain on the held-out frames would be misleading, for two reasons. A held-out frame is twice as far from its
    /// neighbours as a view between cameras, which doubles the displacements that errors of the geometry proxy cause. A
    /// displaced outline costs a sharp image more PSNR than a blurred image.
    pub fn possible_gain_db(
        &self,
        field: &LightField,
        cheaper: &RenderOptions,
        dearer: &RenderOptions,
    ) -> Result<Option<f64>, RenderError> {
        let (mut difference, mut error) = (0.0, 0.0);
        for frame in &self.frames {
            let cheap = rendered(field, &frame.view, frame.view_s, cheaper)?;
            let dear = rendered(field, &frame.view, frame.view_s, dearer)?;
            let again = rendered(&frame.neighbors, &frame.camera, frame.time_s, dearer)?;
            let (Some(cheap), Some(dear), Some(again)) = (cheap, dear, again) else { continue };
            let counts = both(&both(&cheap.coverage, &dear.coverage), &frame.near_changing);
            difference += squared(&cheap.image, &dear.image, &counts);
            error += frame.squared_error(&again, &both(&again.coverage, &frame.changing));
        }
        // If no changing pixel is visible, or if `error` is 0, the gain isn't finite.
        let gain_db = 10.0 * (difference / error).ln_1p() / LN_10;
        Ok(gain_db.is_finite().then_some(gain_db))
    }

    /// Returns the errors of views that are rendered with each of the options `candidates`, for both kinds of blending
    /// weights. Errors are measured at the changing pixels of the held-out frames. A frame is used only if it can be
    /// rendered with all candidates, and a pixel only if all of these views cover it. Returns `None` if no pixel is
    /// used.
    ///
    /// All views must be equally sharp, because a displaced outline costs a sharp image more PSNR than a blurred image.
    pub fn errors(
        &self,
        candidates: &[RenderOptions],
    ) -> Result<Option<Vec<HeldOutErrors>>, RenderError> {
        let mut sums = vec![HeldOutErrors::default(); candidates.len()];
        let mut is_any = false;
        for frame in &self.frames {
            let mut views = Vec::with_capacity(candidates.len());
            for options in candidates {
                views.extend(frame.by_both_weights(options)?);
            }
            if views.len() < candidates.len() {
                continue;
            }
            let mut counts = frame.changing.clone();
            for view in views.iter().flatten() {
                counts = both(&counts, &view.coverage);
            }
            is_any |= counts.contains(&true);
            for (sum, [in_space, in_time]) in sums.iter_mut().zip(&views) {
                sum.in_space += frame.squared_error(in_space, &counts);
                sum.in_space_and_time += frame.squared_error(in_time, &counts);
            }
        }
        Ok(is_any.then_some(sums))
    }
}

impl HeldOutFrame {
    /// Chooses a frame of this camera as held-out frame `number`, which is from 0 to [`FRAMES`] - 1. `times_s` are the
    /// camera's frame times in seconds. Frames with larger numbers are later in the recording.
    ///
    /// Returns `None` if, at the time of every frame of this camera, no neighbouring camera can give an image. Also
    /// returns `None` if the chosen frame lies in time between two frames of fewer than half of the neighbouring
    /// cameras, or if fewer than [`MIN_PIXELS`] of its pixels change.
    fn open(
        whole: &LightField,
        camera: usize,
        times_s: &[f64],
        number: usize,
        registration: &RegistrationOptions,
    ) -> Result<Option<Self>, RenderError> {
        let capture = whole.capture();
        let filmed = &capture.cameras[camera];
        let view = halfway_to_neighbor(capture, camera);
        let mut order = by_distance(capture, &filmed.camera.center().coords);
        order.retain(|&c| c != camera);
        order.truncate(NEIGHBORS);
        let neighbors = field_of(capture, whole.offsets(), &order);
        let covered = well_covered_frames(&neighbors, times_s);
        let Some(&frame) = covered.get((2 * number + 1) * covered.len() / (2 * FRAMES)) else {
            return Ok(None);
        };
        let time_s = times_s[frame];
        let (truth, changing) = recorded(&whole.frames(registration), camera, frame)?;
        let count = changing.iter().filter(|c| **c).count();
        if 2 * neighbors.between_frames(time_s, MIN_FRACTION) < order.len() || count < MIN_PIXELS {
            return Ok(None);
        }
        let next_s = times_s[if frame + 1 < times_s.len() { frame + 1 } else { frame - 1 }];
        let instants = FRACTIONS.map(|fraction| time_s + fraction * (next_s - time_s));
        // Takes the first of the instants at which the most cameras are between two of their frames.
        let between = |s: &f64| Reverse(whole.between_frames(*s, MIN_FRACTION));
        let Some(view_s) = instants.into_iter().min_by_key(between) else { return Ok(None) };
        let gains = whole.gains(registration);
        let own_s = filmed.clock.times_s[frame];
        let bright_as = order[neighbors.capture().reference];
        let bright_as_s = &capture.cameras[bright_as].clock.times_s;
        let middle_s = bright_as_s[bright_as_s.len() / 2];
        let changing_px: Vec<f32> = changing.iter().map(|c| f32::from(u8::from(*c))).collect();
        Ok(Some(Self {
            camera: filmed.camera.clone(),
            name: format!("frame {frame} of {}", filmed.id),
            time_s,
            view,
            view_s,
            near_changing: moving_part(&changing_px, truth.width(), 0.5, PARALLAX_PX),
            truth: gains.corrected(camera, own_s, &truth).unwrap_or(truth),
            gains,
            exposure: (bright_as, middle_s),
            changing,
            neighbors,
        }))
    }

    /// Renders the view of this held-out frame from the neighbouring cameras twice: with blending weights in space, and
    /// with blending weights in space and time. Returns `None` if one of the two images can't be rendered.
    fn by_both_weights(
        &self,
        options: &RenderOptions,
    ) -> Result<Option<[Rendered; 2]>, RenderError> {
        let by = |method: BlendMethod| {
            let mut options = options.clone();
            options.blend.method = method;
            rendered(&self.neighbors, &self.camera, self.time_s, &options)
        };
        let (in_space, in_time) = (by(BlendMethod::default())?, by(BlendMethod::SpaceTime)?);
        Ok(in_space.zip(in_time).map(<[Rendered; 2]>::from))
    }

    /// Returns the sum of squared grey differences between a rendered view and this held-out frame, over the pixels at
    /// which `counts` is true. The gains of the view are corrected first.
    fn squared_error(&self, view: &Rendered, counts: &[bool]) -> f64 {
        let (camera, own_s) = self.exposure;
        let image = self.gains.corrected(camera, own_s, &view.image);
        squared(image.as_ref().unwrap_or(&view.image), &self.truth, counts)
    }
}

/// Renders the view of the camera `at` at the time `time_s`, seconds from the capture's start. Returns `None` if the
/// view can't be rendered. A frame that can't be read is an error.
pub(crate) fn rendered(
    field: &LightField,
    at: &Camera,
    time_s: f64,
    options: &RenderOptions,
) -> Result<Option<Rendered>, RenderError> {
    match field.view(at, time_s, options) {
        Ok(view) => Ok(Some(view)),
        Err(RenderError::Capture(error)) => Err(error.into()),
        Err(_) => Ok(None),
    }
}

/// Returns the logical conjunction of two masks, pixel by pixel.
fn both(a: &[bool], b: &[bool]) -> Vec<bool> {
    a.iter().zip(b).map(|(a, b)| *a && *b).collect()
}

/// Returns the sum of squared grey differences between two images, over the pixels at which `counts` is true.
fn squared(a: &Image, b: &Image, counts: &[bool]) -> f64 {
    let (a, b) = (a.to_gray(), b.to_gray());
    let pixels = a.data().iter().zip(b.data()).zip(counts);
    pixels.filter(|(_, counts)| **counts).map(|((a, b), _)| f64::from(a - b).powi(2)).sum()
}

/// Creates the light field of a part of the capture's cameras: those with the indices `cameras`, in this order.
pub(crate) fn field_of(capture: &Capture, offsets: &Offsets, cameras: &[usize]) -> LightField {
    let mut known = offsets.clone();
    known.cameras = cameras.iter().map(|&c| offsets.cameras[c].clone()).collect();
    LightField::new(Arc::new(capture.with_cameras(cameras)), known)
}

/// Returns the indices of all cameras, sorted by distance from the centre of the rig, the nearest first. The first
/// cameras lie between other cameras, as views do. Returns an empty list for fewer than three cameras.
pub(crate) fn inner_cameras(capture: &Capture) -> Vec<usize> {
    let cameras = &capture.cameras;
    if cameras.len() < 3 {
        return Vec::new();
    }
    let centers = cameras.iter().map(|c| c.camera.center().coords);
    by_distance(capture, &(centers.sum::<Vector3<f64>>() / cameras.len() as f64))
}

fn by_distance(capture: &Capture, from: &Vector3<f64>) -> Vec<usize> {
    let mut order: Vec<usize> = (0..capture.cameras.len()).collect();
    let distance = |c: usize| (capture.cameras[c].camera.center().coords - from).norm();
    order.sort_by(|&a, &b| distance(a).total_cmp(&distance(b)).then(a.cmp(&b)));
    order
}

/// Returns a view with the lens and direction of a camera, halfway to the nearest camera at another position. Returns
/// the camera itself if all cameras have the same position.
pub(crate) fn halfway_to_neighbor(capture: &Capture, camera: usize) -> Camera {
    let mut view = capture.cameras[camera].camera.clone();
    let from_own = capture.cameras.iter().map(|c| c.camera.center() - view.center());
    let elsewhere = from_own.filter(|d| d.norm() > 0.0);
    if let Some(aside) = elsewhere.min_by(|a, b| a.norm().total_cmp(&b.norm())) {
        let shift = view.cam_from_world.rotation * (0.5 * aside);
        view.cam_from_world.translation.vector -= shift;
    }
    view
}

/// Returns the indices of the times in `times_s` (a camera's frame times, seconds from the capture's start) at which
/// the largest number of the light field's cameras can give an image. Returns an empty list if no camera can give an
/// image at any of the times.
pub(crate) fn well_covered_frames(field: &LightField, times_s: &[f64]) -> Vec<usize> {
    let usable: Vec<usize> = times_s.iter().map(|t| field.usable(*t).len()).collect();
    let most = usable.iter().max().copied().unwrap_or(0).max(1);
    (0..usable.len()).filter(|&k| usable[k] == most).collect()
}

/// Returns the image of a recorded frame, and the mask of its changing pixels, row by row. A pixel is changing if it
/// differs from the same camera's frame before or after by more than noise.
pub(crate) fn recorded(
    frames: &FrameStore,
    camera: usize,
    frame: usize,
) -> Result<(Image, Vec<bool>), CaptureError> {
    let image = frames.get(camera, frame)?.image.clone();
    let own_s = frames.capture().cameras[camera].clock.times_s[frame];
    let mut moving = vec![false; image.width() * image.height()];
    for other in [frame.checked_sub(1), Some(frame + 1)].into_iter().flatten() {
        if other < frames.capture().cameras[camera].frames.len() {
            let changed =
                changed_pixels(&image, &frames.get_exposed_at(camera, other, own_s)?.image);
            moving.iter_mut().zip(changed).for_each(|(m, c)| *m |= c);
        }
    }
    Ok((image, moving))
}
