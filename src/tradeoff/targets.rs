//! What views are held against: the truth, cameras that were left out, or the most accurate view.

use super::TradeoffError;
use super::combination::most_accurate;
use crate::camera::Camera;
use crate::capture::{BitDepth, Capture, Truth};
use crate::compare::CompareOptions;
use crate::compare::metrics::{Reference, RegionScores};
use crate::compare::truths::{self, TrueImage, as_written};
use crate::lumigraph::Rendered;
use crate::offset::Offsets;
use crate::raster::Image;
use crate::render::left_out::{beside, filmed, inner_cameras, only, shown_frames};
use crate::render::{LightField, RenderError, RenderOptions};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// What quality is measured against.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Against {
    /// Views of a simulator that no camera filmed, or where it has none the filming cameras'.
    Truth,
    /// A camera's own frame, at its own time, rendered from the other cameras.
    LeftOut,
    /// The view by the dearest rung of every ladder: how much is lost, not how much is right.
    MostAccurate,
}

/// A view whose image is known.
pub(super) struct Target {
    pub id: String,
    pub camera: Camera,
    /// From the capture's start.
    pub time_s: f64,
    pub against: Against,
    /// The camera whose frame it is: not to be used.
    pub left_out: Option<usize>,
    reference: Reference,
    /// What moves, and what the most accurate rungs see, row by row.
    moving: Vec<bool>,
    covered: Vec<bool>,
    depth: BitDepth,
}

/// A view that is timed: that of a target.
#[derive(Clone, Debug)]
pub(super) struct Timed {
    /// The target's id.
    pub target: String,
    pub camera: Camera,
    pub time_s: f64,
}

/// Cameras that are left out, one at a time, where there is no truth. More cost time; one alone
/// stands for its own place.
const LEFT_OUT: usize = 2;

/// Everything that is measured against, with what it takes to find out.
pub(super) struct Scene<'a> {
    pub capture: &'a Arc<Capture>,
    pub offsets: &'a Offsets,
    pub base: &'a RenderOptions,
}

impl Target {
    /// How far a rendered view is from it. What the most accurate rungs don't see isn't measured;
    /// what only this one doesn't see is black.
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

impl Scene<'_> {
    /// The light field without a camera.
    pub fn field(&self, options: &RenderOptions, left_out: Option<usize>) -> LightField {
        let Some(index) = left_out else {
            return LightField::new(self.capture.clone(), self.offsets.clone(), options.clone());
        };
        let kept: Vec<usize> = (0..self.capture.cameras.len()).filter(|&c| c != index).collect();
        let (capture, offsets) = only(self.capture, self.offsets, &kept);
        LightField::new(capture, offsets, options.clone())
    }

    /// What there is to measure against, and the view to time.
    pub fn targets(&self, truth: Option<&Truth>) -> Result<(Vec<Target>, Timed), TradeoffError> {
        let found = match truth {
            Some(truth) => self.true_views(truth)?,
            None => Vec::new(),
        };
        if let Some(Target { id, camera, time_s, .. }) = found.first() {
            let timed = Timed { target: id.clone(), camera: camera.clone(), time_s: *time_s };
            return Ok((found, timed));
        }
        let timed = self.between();
        let mut found = self.left_out_frames()?;
        let field = self.field(&most_accurate(self.base), None);
        let rendered = field.view(&timed.camera, timed.time_s)?;
        let image =
            as_written(&rendered.image, rendered.image.channels(), self.capture.bit_depth());
        found.push(Target {
            id: timed.target.clone(),
            camera: timed.camera.clone(),
            time_s: timed.time_s,
            against: Against::MostAccurate,
            left_out: None,
            moving: vec![false; rendered.coverage.len()],
            covered: rendered.coverage,
            reference: self.reference(image),
            depth: self.capture.bit_depth(),
        });
        Ok((found, timed))
    }

    fn reference(&self, image: Image) -> Reference {
        Reference::new(image, CompareOptions::default().pixels_per_degree)
    }

    /// A target, covered as the most accurate rungs see it; `None` where they can't render it.
    fn target(
        &self,
        field: &LightField,
        id: String,
        (camera, time_s): (&Camera, f64),
        truth: TrueImage,
        left_out: Option<usize>,
    ) -> Result<Option<Target>, TradeoffError> {
        let rendered = match field.view(camera, time_s) {
            Ok(rendered) => rendered,
            Err(RenderError::Capture(error)) => return Err(error.into()),
            Err(_) => return Ok(None),
        };
        let against = if left_out.is_some() { Against::LeftOut } else { Against::Truth };
        Ok(Some(Target {
            id,
            camera: camera.clone(),
            time_s,
            against,
            left_out,
            reference: self.reference(truth.image),
            moving: truth.moving,
            covered: rendered.coverage,
            depth: self.capture.bit_depth(),
        }))
    }

    /// Views of the truth that no camera filmed; where it has none, the filming cameras'.
    fn true_views(&self, truth: &Truth) -> Result<Vec<Target>, TradeoffError> {
        let field = self.field(&most_accurate(self.base), None);
        let instants = truths::instants(truth, self.capture)?;
        let views = || instants.iter().flat_map(|i| i.views.iter().map(move |v| (i, v)));
        let has_free = views().any(|(_, v)| v.like.is_none());
        let mut found = Vec::new();
        for (instant, view) in views().filter(|(_, v)| !has_free || v.like.is_none()) {
            let image = view.read(truth, self.capture, &CompareOptions::default())?;
            let place = (&view.camera, instant.inner_s);
            found.extend(self.target(&field, view.stem.clone(), place, image, None)?);
        }
        Ok(found)
    }

    /// The middle frames of cameras amid the others.
    fn left_out_frames(&self) -> Result<Vec<Target>, TradeoffError> {
        let times_s = self.offsets.common_times_s(self.capture);
        let mut found: Vec<Target> = Vec::new();
        for camera in inner_cameras(self.capture) {
            let Some(times_s) = &times_s[camera] else { continue };
            let field = self.field(&most_accurate(self.base), Some(camera));
            let shown = shown_frames(&field, times_s);
            let Some(&frame) = shown.get(shown.len() / 2) else { continue };
            let (image, moving) = filmed(self.capture, camera, frame)?;
            let truth = TrueImage { image, moving };
            let filmed = &self.capture.cameras[camera];
            let place = (&filmed.camera, times_s[frame]);
            let id = format!("{}-{frame}", filmed.id);
            found.extend(self.target(&field, id, place, truth, Some(camera))?);
            if found.len() == LEFT_OUT {
                break;
            }
        }
        Ok(found)
    }

    /// A view halfway from the reference to its nearest neighbour, in the middle of the film.
    fn between(&self) -> Timed {
        let camera = beside(self.capture, self.capture.reference);
        let field = self.field(self.base, None);
        let own_span = || field.span_s(self.capture.reference);
        let (first, last) = field.common_span_s().or_else(own_span).unwrap_or_default();
        Timed { target: "most-accurate".into(), camera, time_s: 0.5 * (first + last) }
    }
}
