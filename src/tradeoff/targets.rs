//! Reference images: the truth, held-out cameras, or the most accurate view.

use super::TradeoffError;
use super::combination::most_accurate;
use crate::camera::Camera;
use crate::capture::{Capture, Truth};
use crate::compare::CompareOptions;
use crate::compare::truths::{self, TrueImage, as_written};
use crate::light_field::LightField;
use crate::lumigraph::Rendered;
use crate::metrics::{ReferenceImage, RegionScores};
use crate::offset::Offsets;
use crate::options::RenderOptions;
use crate::plan::held_out::{
    field_of, halfway_to_neighbor, inner_cameras, recorded, rendered, well_covered_frames,
};
use crate::raster::BitDepth;
use crate::raster::Image;
use crate::registration::FrameStore;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// The kind of reference images.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Against {
    /// True images of new views; without those, of the filming cameras.
    Truth,
    /// A camera's own frame, at its own time, rendered from the other cameras.
    HeldOut,
    /// The view by the slowest method of every stage: this measures loss, not accuracy.
    MostAccurate,
}

/// A view with a reference image.
pub(super) struct Target {
    pub id: String,
    pub camera: Camera,
    /// From the capture's start.
    pub time_s: f64,
    pub against: Against,
    /// The camera of the frame, which must not be used to render it.
    pub held_out: Option<usize>,
    reference: ReferenceImage,
    /// The moving pixels, and those that the most accurate methods cover, row by row.
    moving: Vec<bool>,
    covered: Vec<bool>,
    depth: BitDepth,
}

/// A target's view: its id, its place and its time.
#[derive(Clone, Debug)]
pub(super) struct TargetView {
    /// The target's id.
    pub target: String,
    pub camera: Camera,
    pub time_s: f64,
}

/// Number of cameras that are held out, one at a time, without truth.
const HELD_OUT: usize = 2;

/// A capture with its truth, from which targets are made.
pub(super) struct TargetScene<'a> {
    pub capture: &'a Arc<Capture>,
    pub offsets: &'a Offsets,
    pub base: &'a RenderOptions,
}

impl Target {
    /// The scores of a rendered view. Pixels that the most accurate methods don't cover aren't
    /// measured; pixels that only this view doesn't cover are black.
    pub fn score(&self, rendered: &Rendered) -> RegionScores {
        let truth = self.reference.image();
        let n = truth.channels();
        let mut image = as_written(&rendered.image, n, self.depth);
        for (k, pixel) in image.data_mut().chunks_exact_mut(n).enumerate() {
            if !self.covered[k] {
                pixel.copy_from_slice(&truth.data()[k * n..(k + 1) * n]);
            }
        }
        self.reference.compare(&image).regions(Some(&self.covered), &self.moving)
    }
}

impl TargetScene<'_> {
    /// The light field without a camera.
    pub fn field(&self, held_out: Option<usize>) -> LightField {
        let Some(index) = held_out else {
            return LightField::new(self.capture.clone(), self.offsets.clone());
        };
        let others: Vec<usize> = (0..self.capture.cameras.len()).filter(|&c| c != index).collect();
        field_of(self.capture, self.offsets, &others)
    }

    /// The targets, and the view to time.
    pub fn targets(
        &self,
        truth: Option<&Truth>,
    ) -> Result<(Vec<Target>, TargetView), TradeoffError> {
        let found = match truth {
            Some(truth) => self.true_views(truth)?,
            None => Vec::new(),
        };
        if let Some(Target { id, camera, time_s, .. }) = found.first() {
            let timed = TargetView { target: id.clone(), camera: camera.clone(), time_s: *time_s };
            return Ok((found, timed));
        }
        let timed = self.between();
        let mut found = self.held_out_frames()?;
        let field = self.field(None);
        let rendered = field.view(&timed.camera, timed.time_s, &most_accurate(self.base))?;
        let image =
            as_written(&rendered.image, rendered.image.channels(), self.capture.bit_depth());
        found.push(Target {
            id: timed.target.clone(),
            camera: timed.camera.clone(),
            time_s: timed.time_s,
            against: Against::MostAccurate,
            held_out: None,
            moving: vec![false; rendered.coverage.len()],
            covered: rendered.coverage,
            reference: self.reference(image),
            depth: self.capture.bit_depth(),
        });
        Ok((found, timed))
    }

    fn reference(&self, image: Image) -> ReferenceImage {
        ReferenceImage::new(image, CompareOptions::default().pixels_per_degree)
    }

    /// A target, with the pixels that the most accurate methods cover; `None` if they can't render it.
    fn target(
        &self,
        field: &LightField,
        TargetView { target: id, camera, time_s }: TargetView,
        truth: TrueImage,
        held_out: Option<usize>,
    ) -> Result<Option<Target>, TradeoffError> {
        let rendered = rendered(field, &camera, time_s, &most_accurate(self.base))?;
        let Some(rendered) = rendered else { return Ok(None) };
        let against = if held_out.is_some() { Against::HeldOut } else { Against::Truth };
        Ok(Some(Target {
            id,
            camera,
            time_s,
            against,
            held_out,
            reference: self.reference(truth.image),
            moving: truth.moving,
            covered: rendered.coverage,
            depth: self.capture.bit_depth(),
        }))
    }

    /// Views of the truth that no camera filmed; where it has none, the filming cameras'.
    fn true_views(&self, truth: &Truth) -> Result<Vec<Target>, TradeoffError> {
        let field = self.field(None);
        let instants = truths::instants(truth, self.capture)?;
        let views = || instants.iter().flat_map(|i| i.views.iter().map(move |v| (i, v)));
        let has_free = views().any(|(_, v)| v.like.is_none());
        let mut found = Vec::new();
        for (instant, view) in views().filter(|(_, v)| !has_free || v.like.is_none()) {
            let image = view.read(truth, self.capture, &CompareOptions::default())?;
            let at = TargetView {
                target: view.stem.clone(),
                camera: view.camera.clone(),
                time_s: instant.inner_s,
            };
            found.extend(self.target(&field, at, image, None)?);
        }
        Ok(found)
    }

    /// Middle frames of inner cameras, as held-out targets.
    fn held_out_frames(&self) -> Result<Vec<Target>, TradeoffError> {
        let times_s = self.offsets.common_times_s(self.capture);
        let frames = FrameStore::new(self.capture.clone(), &self.base.registration);
        let mut found: Vec<Target> = Vec::new();
        for camera in inner_cameras(self.capture) {
            let Some(times_s) = &times_s[camera] else { continue };
            let field = self.field(Some(camera));
            let shown = well_covered_frames(&field, times_s);
            let Some(&frame) = shown.get(shown.len() / 2) else { continue };
            let (image, moving) = recorded(&frames, camera, frame)?;
            let truth = TrueImage { image, moving };
            let filmed = &self.capture.cameras[camera];
            let at = TargetView {
                target: format!("{}-{frame}", filmed.id),
                camera: filmed.camera.clone(),
                time_s: times_s[frame],
            };
            found.extend(self.target(&field, at, truth, Some(camera))?);
            if found.len() == HELD_OUT {
                break;
            }
        }
        Ok(found)
    }

    /// A view halfway from the reference to its nearest neighbour, in the middle of the recording.
    fn between(&self) -> TargetView {
        let camera = halfway_to_neighbor(self.capture, self.capture.reference);
        let field = self.field(None);
        let own_span = || field.span_s(self.capture.reference);
        let (first, last) = field.common_span_s().or_else(own_span).unwrap_or_default();
        TargetView { target: "most-accurate".into(), camera, time_s: 0.5 * (first + last) }
    }
}
