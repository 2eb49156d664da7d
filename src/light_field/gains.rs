//! Exposure gains of the cameras.
//!
//! Cameras that stand side by side are compared at matched features. Features can hardly be matched between cameras that
//! stand around the scene. These cameras are compared where scene flow finds the same surface in two of them. Scene flow
//! is estimated at low resolution, for one frame of each camera. It is estimated from the local contrast of the images,
//! which doesn't depend on the exposure.
//!
//! Known limits, for cameras around the scene: surfaces must have texture, and look equally bright from all directions.
//! There is one gain for the whole image, and no offset, which haze would cause.

use super::RenderError;
use super::graph::{LightField, Stage, StoredStage};
use super::matched_frames::{matched_with, search_range};
use super::points::nearest;
use super::slots::FrameId;
use super::stages::WideGains;
use super::wide::CommonPlace;
use crate::capture::Color;
use crate::host::CacheKind;
use crate::registration::{
    GainMethod, GainSamples, Gains, MatchedLight, RegistrationOptions, halved,
};
use crate::scene_flow::{
    EstimatedFrame, Estimation, FlowFrame, FlowMap, MappedFrame, MatchingImage, PyramidFrame,
    confirmed_by, local_contrast,
};
use rayon::prelude::*;
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

/// Maximum width of the images whose scene flow is estimated, pixels. The size of a larger image is halved repeatedly.
/// Smaller: thin bodies have no texture. Larger: the time rises with the number of pixels.
const WIDTH_PX: usize = 256;
/// Radius of the surroundings to which local contrast refers, as a fraction of the image's width. Smaller: only fine
/// texture is matched. Larger: shading is matched too.
const RADIUS: f64 = 1.0 / 16.0;
/// Number of nearest cameras with which each camera is compared. Smaller: one wrong comparison changes a gain by more.
/// Larger: cameras are compared that see few surfaces in common.
const NEIGHBORS: usize = 4;

impl LightField {
    /// Returns the exposure gains of the cameras relative to the reference camera.
    pub fn gains(&self, registration: &RegistrationOptions) -> Arc<Gains> {
        match self.place_of_wide_gains(registration) {
            Some(place) => WideGains { registration }.get(self, place),
            None => self.frames(registration).gains(),
        }
    }

    /// Stores the gains on disk, unless they are already stored. Returns their size on disk in bytes.
    ///
    /// # Errors
    /// If the gains can't be written.
    pub(super) fn store_gains(
        &self,
        registration: &RegistrationOptions,
    ) -> Result<u64, RenderError> {
        let bytes = self.frames(registration).store_gains()?;
        if self.place_of_wide_gains(registration).is_none() {
            return Ok(bytes);
        }
        let stage = WideGains { registration };
        let stored = match self.stored(&stage) {
            Some(stored) => stored,
            None => self.store(&stage, &*self.gains(registration))?,
        };
        Ok(bytes + stored.bytes)
    }

    /// Returns the place that all cameras look at. `None` if the array isn't wide, or if gains aren't estimated.
    fn place_of_wide_gains(&self, registration: &RegistrationOptions) -> Option<CommonPlace> {
        self.common_place().filter(|_| registration.gains != GainMethod::Equal)
    }
}

impl Stage for WideGains<'_> {
    type Output = Gains;
    const NAME: &'static str = "gains of a wide array";

    fn bytes(gains: &Gains) -> usize {
        gains.bytes()
    }
}

impl StoredStage for WideGains<'_> {
    const KIND: CacheKind = CacheKind { name: "wide-gains", version: 2 };
}

impl WideGains<'_> {
    /// Returns the gains. If no surfaces can be compared, they are those that features give.
    fn get(&self, field: &LightField, place: CommonPlace) -> Arc<Gains> {
        let cameras = field.capture().cameras.len();
        if let Some(found) = field.found(self).filter(|gains| gains.are_plausible(cameras)) {
            return found;
        }
        let by_features = field.frames(self.registration).gains();
        let compared = ComparedFrames::new(field, &by_features, place);
        let gains = compared.and_then(|compared| compared.gains(field, &by_features));
        field.insert(self, gains.map_or(by_features, Arc::new))
    }
}

/// A frame at low resolution, with the exposure of its camera's middle frame.
struct SmallFrame {
    filmed: FlowFrame,
    /// The frame's local contrast.
    contrast: FlowFrame,
    pyramid: Vec<MatchingImage>,
}

impl SmallFrame {
    /// Reads a frame. Of `gains`, only the changes over the recording are corrected. `None` if the frame can't be read.
    fn read(field: &LightField, (camera, frame): FrameId, gains: &Gains) -> Option<Self> {
        let recording = &field.capture().cameras[camera];
        let image = field.capture().read_frame(camera, frame).ok()?;
        let own_s = &recording.clock.times_s;
        let times_s = [own_s[frame], own_s[own_s.len() / 2]];
        let mut image = gains.exposed_at(camera, times_s, &image).unwrap_or(image);
        let mut small = recording.camera.clone();
        let mut row_s = recording.row_times().s_per_px();
        while small.width > WIDTH_PX {
            (image, small, row_s) = (halved(&image), small.halved()?, 2.0 * row_s);
        }
        let (time, row_time) =
            (field.in_frames(field.times_s(camera)[frame]), field.in_frames(row_s));
        let radius_px = (RADIUS * small.width as f64).ceil() as usize;
        let [filmed, contrast] = [&image, &local_contrast(&image, radius_px)]
            .map(|image| FlowFrame::new(&small, image, time).with_row_time(row_time));
        let pyramid = contrast.pyramid();
        Some(Self { filmed, contrast, pyramid })
    }

    fn with_pyramid(&self) -> PyramidFrame<'_> {
        PyramidFrame { frame: &self.contrast, levels: &self.pyramid }
    }
}

/// Frames of different cameras, with the depth and motion by which they are compared.
struct ComparedFrames {
    /// The frames, ascending by camera, each with its map of depth and motion.
    mapped: Vec<(FrameId, FlowMap)>,
    /// These frames, and those with which they are matched.
    frames: BTreeMap<FrameId, SmallFrame>,
}

impl ComparedFrames {
    /// Reads the frames in the middle of the recording, one of each camera, and estimates their depth and motion. `None`
    /// if the cameras film at no common time, if no frame can be read, or if the range of the scene's depths is unknown.
    fn new(field: &LightField, gains: &Gains, place: CommonPlace) -> Option<Self> {
        let (first_s, last_s) = field.common_span_s()?;
        let middle_s = 0.5 * (first_s + last_s);
        let cameras = 0..field.capture().cameras.len();
        let middle: Vec<FrameId> =
            cameras.filter_map(|c| Some((c, field.nearest_frame(c, middle_s)?))).collect();
        let matched: Vec<Vec<FrameId>> = middle.iter().map(|&id| matched_with(field, id)).collect();
        let needed: BTreeSet<FrameId> =
            middle.iter().chain(matched.iter().flatten()).copied().collect();
        let needed: Vec<FrameId> = needed.into_iter().collect();
        let read = |&id: &FrameId| Some((id, SmallFrame::read(field, id, gains)?));
        let frames: BTreeMap<FrameId, SmallFrame> = needed.par_iter().filter_map(read).collect();
        let of = |id: &FrameId| Some(frames.get(id)?.with_pyramid());
        let with_matched = |(id, matched): (&FrameId, &Vec<FrameId>)| {
            let others = matched.iter().filter_map(of).collect();
            Some((*id, EstimatedFrame { frame: of(id)?, others, background: None }))
        };
        let (compared, list): (Vec<FrameId>, Vec<_>) =
            middle.iter().zip(&matched).filter_map(with_matched).unzip();
        let side =
            list.iter().map(|f| &f.frame.frame.view).flat_map(|v| [v.width, v.height]).max()?;
        let range = field.common_range(place, compared.iter().map(|id| id.0))?;
        let limits = search_range(field, range, side);
        let baseline_m = field.matching_baseline_m();
        let maps = Estimation { frames: &list, limits, baseline_m }.run(&|| true);
        drop(list);
        Some(Self { mapped: compared.into_iter().zip(maps).collect(), frames })
    }

    /// Estimates the cameras' gains. Their changes over the recordings are those of `by_features`. `None` if no two
    /// cameras can be compared.
    fn gains(&self, field: &LightField, by_features: &Gains) -> Option<Gains> {
        let cameras: Vec<usize> = self.mapped.iter().map(|((camera, _), _)| *camera).collect();
        let samples = pairs(field, &cameras).into_par_iter().map(|[a, b]| {
            let mut log_ratios = self.log_ratios([a, b]);
            let back = self.log_ratios([b, a]);
            log_ratios.extend(back.into_iter().map(|log| log.map(|v| -v)));
            GainSamples { cameras: [a, b].map(|k| cameras[k]), log_ratios }
        });
        let samples: Vec<GainSamples> = samples.collect();
        let filmed = &field.capture().cameras;
        let are_gray: Vec<bool> = filmed.iter().map(|c| c.color == Color::Gray).collect();
        by_features.with_samples(field.capture().reference, &are_gray, &samples)
    }

    /// Returns the logarithms of the ratios of light in one frame to light in another, on surfaces that both see. `[own,
    /// other]` are the frames' indices. The ratios are those of the second to the first.
    fn log_ratios(&self, [own, other]: [usize; 2]) -> Vec<[f64; 3]> {
        let [(own, own_map), (other, other_map)] = [own, other].map(|k| {
            let (id, map) = &self.mapped[k];
            let frame = &self.frames[id];
            (&frame.filmed, MappedFrame { frame: &frame.contrast, map })
        });
        let mut colors = vec![None; own_map.map.pixels().len()];
        for (k, there) in confirmed_by(&own_map, &other_map) {
            let here = own_map.map.center(k);
            if own.films(here) {
                colors[k] = Some([own.color(here), other.color(there)]);
            }
        }
        let is_gray = !(own.is_color && other.is_color);
        MatchedLight { width: own_map.map.width, colors, is_gray }.log_ratios()
    }
}

/// Returns the pairs of each camera with its [`NEIGHBORS`] nearest cameras among `cameras`, as indices into this list.
/// Every pair occurs once.
fn pairs(field: &LightField, cameras: &[usize]) -> BTreeSet<[usize; 2]> {
    let index = |camera: usize| cameras.iter().position(|c| *c == camera);
    let pairs_of = |(a, &camera): (usize, &usize)| {
        let others: Vec<usize> = cameras.iter().copied().filter(|&other| other != camera).collect();
        let center = field.capture().cameras[camera].camera.center();
        let near = nearest(field.capture(), &others, center).into_iter().take(NEIGHBORS);
        near.filter_map(index).map(|b| [a.min(b), a.max(b)]).collect::<Vec<_>>()
    };
    cameras.iter().enumerate().flat_map(pairs_of).collect()
}
