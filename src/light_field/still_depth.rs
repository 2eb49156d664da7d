//! Depth of the cameras' static background. It is estimated once, from what doesn't change over the whole recording.

use super::graph::{LightField, Stage, StoredStage};
use super::matched_frames::{limits, partners};
use super::slots::{FrameId, Slot, Slots};
use super::stages::{FlowOptions, StillContent, StillDepth, Undistorted};
use super::{Context, RenderError};
use crate::host::CacheKind;
use crate::scene_flow::{
    EstimatedFrame, Estimation, FlowFrame, FlowMap, MappedFrame, MatchingImage, PyramidFrame,
    StillImage, confidences,
};
use rayon::prelude::*;
use std::collections::btree_map::Entry;
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

/// Minimum confidence of the background's depth at a pixel, from 1 to 255. Smaller: depths count that other cameras
/// contradict. Larger: less is known, and more is estimated in every frame.
const MIN_CONFIDENCE: u8 = 127;

impl Stage for StillDepth<'_> {
    type Output = FlowMap;
    const NAME: &'static str = "depth of the static background";

    fn bytes(map: &FlowMap) -> usize {
        map.bytes()
    }
}

impl StoredStage for StillDepth<'_> {
    const KIND: CacheKind = CacheKind { name: "still-depth", version: 5 };
}

/// Static background of a camera, with its depth.
pub(super) struct StillCamera {
    pub still: Arc<StillImage>,
    pub map: Arc<FlowMap>,
}

/// Static background of cameras, by camera.
pub(super) type StillCameras = BTreeMap<usize, StillCamera>;

/// Static background of the cameras of slots, by group. It is kept while several slots are computed, since computing a
/// slot may evict it from the cache.
#[derive(Default)]
pub(super) struct Stills(BTreeMap<usize, StillCameras>);

impl Stills {
    /// Returns the static background of the cameras that filmed a slot ([`still_cameras`]).
    pub(super) fn of(
        &mut self,
        slots: &Slots,
        slot: Slot,
        options: FlowOptions,
        context: &Context,
    ) -> Result<&StillCameras, RenderError> {
        Ok(match self.0.entry(slot.group) {
            Entry::Occupied(found) => found.into_mut(),
            Entry::Vacant(new) => new.insert(still_cameras(slots, slot, options, context)?),
        })
    }

    /// Makes the static background of all cameras the most recently used in the cache, for further views. Computing a slot
    /// may have evicted it.
    pub(super) fn keep(&self, field: &LightField, options: FlowOptions) {
        for camera in 0..field.capture().cameras.len() {
            let content = StillContent { camera, registration: options.registration };
            let depth = StillDepth { camera, options };
            match self.0.values().find_map(|of_group| of_group.get(&camera)) {
                Some(StillCamera { still, map }) => {
                    field.insert(&content, still.clone());
                    field.insert(&depth, map.clone());
                }
                None => {
                    field.cached(&content);
                    field.cached(&depth);
                }
            }
        }
    }
}

/// Returns the static background of the cameras that filmed a slot. The result is empty if it isn't known: because nothing
/// is known to be static, or because the range of the scene's depths isn't known.
pub(super) fn still_cameras(
    slots: &Slots,
    slot: Slot,
    options: FlowOptions,
    context: &Context,
) -> Result<StillCameras, RenderError> {
    let field = slots.field;
    let nothing = Ok(StillCameras::new());
    let cameras = slots.cameras(slot);
    let with_still = |&camera: &usize| {
        let still = StillContent { camera, registration: options.registration }.get(field)?;
        Ok((camera, still))
    };
    let stills: BTreeMap<usize, Arc<StillImage>> =
        cameras.iter().map(with_still).collect::<Result<_, RenderError>>()?;
    if stills.values().any(|still| still.is_empty()) {
        return nothing;
    }
    let stage = |camera: usize| StillDepth { camera, options };
    let found: Option<Vec<Arc<FlowMap>>> =
        cameras.iter().map(|&camera| field.found(&stage(camera))).collect();
    let maps = match found {
        Some(maps) => maps,
        None => match estimated(field, &cameras, options, context)? {
            None => return nothing,
            Some(maps) => {
                let insert = |(&camera, map)| field.insert::<StillDepth>(&stage(camera), map);
                cameras.iter().zip::<Vec<FlowMap>>(maps).map(insert).collect()
            }
        },
    };
    let of = |((camera, still), map)| (camera, StillCamera { still, map });
    Ok(stills.into_iter().zip(maps).map(of).collect())
}

/// Stores the depth of the static background of cameras on disk, where it isn't stored yet.
pub(super) fn store_still_cameras(
    field: &LightField,
    stills: &StillCameras,
    options: FlowOptions,
) -> Result<(), RenderError> {
    for (&camera, StillCamera { map, .. }) in stills {
        let stage = StillDepth { camera, options };
        if field.stored(&stage).is_none() {
            field.store(&stage, map)?;
        }
    }
    Ok(())
}

/// Returns the total size on disk of the depth of all cameras' static background, bytes.
pub(super) fn stored_bytes(field: &LightField, options: FlowOptions) -> u64 {
    let cameras = 0..field.capture().cameras.len();
    let stored = cameras.filter_map(|camera| field.stored(&StillDepth { camera, options }));
    stored.map(|stored| stored.bytes).sum()
}

/// Estimates the depth of the static background of cameras. Where the cameras don't agree, it is unknown. `None` if the
/// range of the scene's depths is unknown.
fn estimated(
    field: &LightField,
    cameras: &[usize],
    options: FlowOptions,
    context: &Context,
) -> Result<Option<Vec<FlowMap>>, RenderError> {
    let middle = |&camera: &usize| (camera, field.times_s(camera).len() / 2);
    let middle: Vec<FrameId> = cameras.iter().map(middle).collect();
    let Some(mut limits) = limits(field, &middle, options)? else { return Ok(None) };
    limits.max_speed = 0.0;
    let others: Vec<Vec<usize>> = cameras.iter().map(|&camera| partners(field, camera)).collect();
    let needed: BTreeSet<usize> = cameras.iter().chain(others.iter().flatten()).copied().collect();
    let read = |&camera: &usize| {
        context.check()?;
        let registration = options.registration;
        let still = StillContent { camera, registration }.get(field)?;
        let first = Undistorted { camera, frame: 0, registration }.get(field)?;
        let frame = still.frame(&first);
        let pyramid = frame.pyramid();
        Ok((camera, (frame, pyramid)))
    };
    let needed: Vec<usize> = needed.into_iter().collect();
    let frames: BTreeMap<usize, (FlowFrame, Vec<MatchingImage>)> =
        needed.par_iter().map(read).collect::<Result<_, RenderError>>()?;
    let with_pyramid = |camera: &usize| {
        let (frame, levels) = &frames[camera];
        PyramidFrame { frame, levels }
    };
    let estimated = |(camera, others): (&usize, &Vec<usize>)| EstimatedFrame {
        frame: with_pyramid(camera),
        others: others.iter().map(with_pyramid).collect(),
        background: None,
    };
    let list: Vec<EstimatedFrame> = cameras.iter().zip(&others).map(estimated).collect();
    let baseline_m = field.matching_baseline_m();
    let maps = Estimation { frames: &list, limits, baseline_m }.run(&|| context.check().is_ok());
    context.check()?;
    let mapped = |(camera, map)| MappedFrame { frame: &frames[camera].0, map };
    let mapped: Vec<MappedFrame> = cameras.iter().zip(&maps).map(mapped).collect();
    let confidences = confidences(&mapped);
    let known = |(map, confidences): (FlowMap, Vec<u8>)| {
        map.known_where(|k| confidences[k] >= MIN_CONFIDENCE)
    };
    Ok(Some(maps.into_iter().zip(confidences).map(known).collect()))
}
