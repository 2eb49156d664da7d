//! Cross-validation on held-out frames: recorded frames are rendered from other cameras only, which measures the error
//! of a method on this capture ([`Probe`]).
//!
//! Images from all cameras and blending weights in time are judged by the errors of held-out frames. Refinement is
//! judged differently: by how much it changes views between cameras, relative to the error of held-out frames.

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

/// Number of held-out frames. Each is of another camera, and they are spread over the recording, because gains in PSNR
/// differ by half a decibel between instants.
const FRAMES: usize = 4;

/// Number of nearest cameras from which a held-out frame is rendered.
const NEIGHBORS: usize = 4;

/// Candidate instants of views, as fractions of the frame interval, the preferred one first.
const FRACTIONS: [f64; 3] = [0.5, 0.25, 0.75];

/// Radius of the dilation of a frame's changing part, pixels. It covers the part's parallax in a neighbouring view.
const PARALLAX_PX: usize = 16;

/// Smallest time between a view and a frame, as a fraction of the frame interval. At a smaller one, synchronization
/// has hardly any error.
const MIN_FRACTION: f64 = 0.1;

/// Minimum number of pixels in the changing part of a held-out frame.
const MIN_PIXELS: usize = 64;

/// The held-out frames, with the light fields of neighbouring cameras from which they are rendered.
pub struct Probe {
    frames: Vec<HeldOutFrame>,
}

struct HeldOutFrame {
    /// The light field of the neighbouring cameras, without the held-out camera.
    neighbors: LightField,
    camera: Camera,
    /// Text such as `frame 3 of cam1`: the frame's index and the camera's id.
    name: String,
    time_s: f64,
    /// The view in which sync methods are compared: halfway between the camera and its nearest neighbour.
    view: Camera,
    /// The instant of `view`, seconds: between this frame and the next one; for the last frame, the one before.
    view_s: f64,
    /// The held-out frame, corrected to the reference camera's gains.
    truth: Image,
    /// The exposure of the views of `neighbors`: that of a camera, by its index in the whole capture, at a time on its
    /// own clock, seconds.
    exposure: (usize, f64),
    gains: Arc<Gains>,
    /// Mask, row by row, of the pixels at which the frame differs from the frame before or after it.
    changing: Vec<bool>,
    /// The mask `changing`, dilated by [`PARALLAX_PX`] pixels.
    near_changing: Vec<bool>,
}

/// Sums of squared errors of held-out frames, for both kinds of blending weights.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct HeldOutErrors {
    pub in_space: f64,
    pub in_space_and_time: f64,
}

impl HeldOutErrors {
    /// The error for a blending method. If the method is decided later, the smaller of the two errors.
    pub fn by(&self, blend: BlendMethod, is_decided_later: bool) -> f64 {
        match blend {
            _ if is_decided_later => self.in_space.min(self.in_space_and_time),
            BlendMethod::SpaceTime => self.in_space_and_time,
            BlendMethod::Lumigraph | BlendMethod::Uniform => self.in_space,
        }
    }
}

impl Probe {
    /// Chooses the held-out frames. `None` if no camera has a frame that lies between frames of its neighbours in time
    /// (as with a common clock), or if hardly anything changes.
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

    /// The held-out frames as text, such as `frame 3 of cam1, frame 8 of cam2`.
    pub fn names(&self) -> String {
        let names: Vec<&str> = self.frames.iter().map(|f| f.name.as_str()).collect();
        names.join(", ")
    }

    /// The largest PSNR gain that costlier options can have over cheaper ones in the changing part of views between
    /// cameras, decibels: 10·log₁₀(1 + D/E).
    ///
    /// D is the sum of squared differences between the views of both options. E is the sum of squared errors of the
    /// costlier options on the held-out frames. The gain assumes that every change by the costlier options is an
    /// improvement, and that views have the error of held-out frames. `None` if no frame can be rendered, or none has
    /// a changing part.
    ///
    /// The gain on the held-out frames would be misleading. They are twice as far from their neighbours as views are,
    /// which doubles the error of the proxy, and a sharp image loses more PSNR by a displaced outline than a blurred
    /// one.
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
        // Without visible pixels or without error, the quotient isn't finite.
        let gain_db = 10.0 * (difference / error).ln_1p() / LN_10;
        Ok(gain_db.is_finite().then_some(gain_db))
    }

    /// The errors of each candidate in the changing part of the held-out frames, for both kinds of blending weights.
    /// `None` if there are no pixels to compare. Only frames that all candidates can render are compared, on pixels
    /// that all cover.
    ///
    /// Candidates must be equally sharp, because a sharp image loses more PSNR by a displaced outline than a blurred
    /// one.
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
    /// Chooses a frame of this camera as held-out frame `number` of [`FRAMES`]. `None` if no frame lies within the
    /// time span of the neighbouring cameras, if too few of them have frames before and after it, or if too little of
    /// the images changes.
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
        // Of the instants at which most cameras are between two of their frames, the first.
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

    /// The frame as rendered from its neighbours, with weights in space, and with weights in space and time. `None` if
    /// it can't be rendered.
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

    /// Sum of squared errors of a view against this frame, over the pixels where `counts` is true.
    fn squared_error(&self, view: &Rendered, counts: &[bool]) -> f64 {
        let (camera, own_s) = self.exposure;
        let image = self.gains.corrected(camera, own_s, &view.image);
        squared(image.as_ref().unwrap_or(&view.image), &self.truth, counts)
    }
}

/// Renders a view; `None` if it can't be rendered. A frame that can't be read is an error.
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

/// The logical conjunction of two masks.
fn both(a: &[bool], b: &[bool]) -> Vec<bool> {
    a.iter().zip(b).map(|(a, b)| *a && *b).collect()
}

/// The sum of squared grey differences over the pixels where `counts` is true.
fn squared(a: &Image, b: &Image, counts: &[bool]) -> f64 {
    let (a, b) = (a.to_gray(), b.to_gray());
    let pixels = a.data().iter().zip(b.data()).zip(counts);
    pixels.filter(|(_, counts)| **counts).map(|((a, b), _)| f64::from(a - b).powi(2)).sum()
}

/// The light field of the given cameras, in this order.
pub(crate) fn field_of(capture: &Capture, offsets: &Offsets, cameras: &[usize]) -> LightField {
    let mut known = offsets.clone();
    known.cameras = cameras.iter().map(|&c| offsets.cameras[c].clone()).collect();
    LightField::new(Arc::new(capture.with_cameras(cameras)), known)
}

/// Indices of all cameras, the nearest to the rig's centre first. Inner cameras lie between others, as views do. Empty
/// for fewer than three cameras.
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

/// A view with a camera's lens and direction, halfway to the nearest camera at another place. The camera itself if
/// there is none.
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

/// Indices of the times at which the number of cameras that can give an image is largest.
pub(crate) fn well_covered_frames(field: &LightField, times_s: &[f64]) -> Vec<usize> {
    let usable: Vec<usize> = times_s.iter().map(|t| field.usable(*t).len()).collect();
    let most = usable.iter().max().copied().unwrap_or(0).max(1);
    (0..usable.len()).filter(|&k| usable[k] == most).collect()
}

/// A frame, and a mask, row by row, of the pixels at which it differs from the frame before or after it by more than
/// noise.
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
