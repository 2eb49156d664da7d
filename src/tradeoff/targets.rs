//! Reference images against which quality is measured: ground truth, frames of held-out cameras, or a view that is
//! rendered by the most accurate methods.

use super::TradeoffError;
use super::combination::most_accurate;
use super::store::middle_s;
use crate::camera::Camera;
use crate::capture::{Capture, Truth};
use crate::compare::CompareOptions;
use crate::compare::truths::{self, TrueImage, as_written, filled_with};
use crate::light_field::LightField;
use crate::lumigraph::Rendered;
use crate::metrics::{ReferenceImage, RegionScores};
use crate::offset::Offsets;
use crate::options::RenderOptions;
use crate::plan::held_out::{
    field_of, halfway_to_neighbor, inner_cameras, recorded, rendered, well_covered_frames,
};
use crate::raster::BitDepth;
use crate::registration::FrameStore;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// The kind of reference images against which quality is measured.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Against {
    /// Ground-truth images of views that no camera filmed. If there are none, ground-truth images of the filming
    /// cameras.
    Truth,
    /// Frames of held-out cameras. The view of a frame is rendered from the other cameras at the frame's own time.
    HeldOut,
    /// A view that is rendered by the most accurate method of every stage. Quality then measures the difference from
    /// these methods, not the accuracy.
    MostAccurate,
}

/// A view with a reference image. Each combination of options renders this view, and the result is compared with the
/// reference image.
pub(super) struct Target {
    pub id: String,
    pub view: View,
    pub against: Against,
    /// Index of the held-out camera whose frame is the reference image. This camera isn't used for rendering. `None` if
    /// the reference image isn't a camera's frame.
    pub held_out: Option<usize>,
    reference: ReferenceImage,
    /// For each pixel, row by row, whether it shows a moving surface.
    moving: Vec<bool>,
    /// For each pixel, row by row, whether the most accurate methods can render a colour. Pixels without one are not
    /// compared.
    covered: Vec<bool>,
    depth: BitDepth,
}

/// A camera, and an instant in seconds from the capture's start.
#[derive(Clone, Debug)]
pub(super) struct View {
    pub camera: Camera,
    pub time_s: f64,
}

/// Number of cameras that are held out, one at a time, if there is no ground truth.
const HELD_OUT: usize = 2;

/// The inputs from which views with reference images are created: the capture, the temporal offsets of its cameras, and
/// the options that all measured combinations have in common.
pub(super) struct TargetScene<'a> {
    pub capture: &'a Arc<Capture>,
    pub offsets: &'a Offsets,
    pub base: &'a RenderOptions,
}

impl Target {
    /// Returns the scores of a rendered view against the reference image. Pixels that the most accurate methods leave
    /// empty are not compared. Other pixels that `rendered` leaves empty count as black.
    pub fn score(&self, rendered: &Rendered) -> RegionScores {
        let truth = self.reference.image();
        let image = as_written(&rendered.image, truth.channels(), self.depth);
        let image = filled_with(truth, &image, &self.covered);
        self.reference.compare(&image).regions(Some(&self.covered), &self.moving)
    }
}

impl TargetScene<'_> {
    /// Returns the light field of all cameras except the held-out camera, if there is one.
    pub fn field(&self, held_out: Option<usize>) -> LightField {
        let Some(index) = held_out else {
            return LightField::new(self.capture.clone(), self.offsets.clone());
        };
        let others: Vec<usize> = (0..self.capture.cameras.len()).filter(|&c| c != index).collect();
        field_of(self.capture, self.offsets, &others)
    }

    /// Returns the views with reference images, and the view whose rendering time is measured. `truth` is the ground
    /// truth; `None` if the capture has none.
    pub fn targets(&self, truth: Option<&Truth>) -> Result<(Vec<Target>, View), TradeoffError> {
        let mut found = truth.map_or(Ok(Vec::new()), |truth| self.true_views(truth))?;
        if let Some(first) = found.first() {
            let timed = first.view.clone();
            return Ok((found, timed));
        }
        found = self.held_out_frames()?;
        // The timed view is halfway between the reference camera and its nearest neighbour, in the middle of the
        // recording.
        let field = self.field(None);
        let camera = halfway_to_neighbor(self.capture, self.capture.reference);
        let timed = View { camera, time_s: middle_s(&field) };
        let rendered = field.view(&timed.camera, timed.time_s, &most_accurate(self.base))?;
        let channels = rendered.image.channels();
        let image = as_written(&rendered.image, channels, self.capture.bit_depth());
        let truth = TrueImage { image, moving: vec![false; rendered.coverage.len()] };
        let target = self.target("most-accurate".into(), timed.clone(), truth, rendered);
        found.push(Target { against: Against::MostAccurate, ..target });
        Ok((found, timed))
    }

    /// Creates a target with a ground-truth image. `rendered` is the same view, rendered by the most accurate methods;
    /// only pixels that it covers will be compared.
    fn target(&self, id: String, view: View, truth: TrueImage, rendered: Rendered) -> Target {
        let pixels_per_degree = CompareOptions::default().pixels_per_degree;
        Target {
            id,
            view,
            against: Against::Truth,
            held_out: None,
            reference: ReferenceImage::new(truth.image, pixels_per_degree),
            moving: truth.moving,
            covered: rendered.coverage,
            depth: self.capture.bit_depth(),
        }
    }

    /// Renders a view by the most accurate methods. Returns `None` if the view can't be rendered.
    fn rendered(&self, field: &LightField, view: &View) -> Result<Option<Rendered>, TradeoffError> {
        Ok(rendered(field, &view.camera, view.time_s, &most_accurate(self.base))?)
    }

    /// Returns the targets with ground-truth images. If there are ground-truth images of views that no camera
    /// filmed, only these are used. Otherwise, ground-truth images of the filming cameras' views are used.
    fn true_views(&self, truth: &Truth) -> Result<Vec<Target>, TradeoffError> {
        let field = self.field(None);
        let instants = truths::instants(truth, self.capture)?;
        let views = || instants.iter().flat_map(|i| i.views.iter().map(move |v| (i, v)));
        let has_free = views().any(|(_, v)| v.like.is_none());
        let mut found = Vec::new();
        for (instant, view) in views().filter(|(_, v)| !has_free || v.like.is_none()) {
            let image = view.read(truth, self.capture, &CompareOptions::default())?;
            let at = View { camera: view.camera.clone(), time_s: instant.inner_s };
            let Some(rendered) = self.rendered(&field, &at)? else { continue };
            found.push(self.target(view.stem.clone(), at, image, rendered));
        }
        Ok(found)
    }

    /// Returns one target for each held-out camera. The held-out cameras are the [`HELD_OUT`] nearest to the rig's
    /// centre that can be rendered. The reference image is the frame of the held-out camera at whose time the largest
    /// number of other cameras can give an image. If there are several such frames, it is the middle one.
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
            let filmed = &self.capture.cameras[camera];
            let at = View { camera: filmed.camera.clone(), time_s: times_s[frame] };
            let Some(rendered) = self.rendered(&field, &at)? else { continue };
            let truth = TrueImage { image, moving };
            let target = self.target(format!("{}-{frame}", filmed.id), at, truth, rendered);
            found.push(Target { against: Against::HeldOut, held_out: Some(camera), ..target });
            if found.len() == HELD_OUT {
                break;
            }
        }
        Ok(found)
    }
}
