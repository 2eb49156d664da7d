//! The renderer of a comparison for a light field: an implementation of [`Renderer`].

use super::results::StageTime;
use super::{ComparedView, Renderer, TRADITIONAL};
use crate::capture::Capture;
use crate::interpolation::{SyncMethod, Synchronized};
use crate::light_field::{Context, Images, LightField, RenderError, Request, Viewpoint, render};
use crate::lumigraph::Rendered;
use crate::options::{RenderOptions, TrailOptions};
use crate::pipeline;
use crate::progress::Reporter;
use std::sync::Arc;
use std::time::Instant;

/// A light field with its rendering options. It renders the images that are compared with the ground truth.
pub struct ComparedLightField {
    field: LightField,
    options: RenderOptions,
    preparation_s: f64,
}

impl ComparedLightField {
    /// Opens a capture's light field. Temporal offsets are read from `offsets.json` or estimated. Options with the
    /// method `auto` are replaced by the methods that the capture's plan selects.
    pub fn open(
        capture: Arc<Capture>,
        options: &RenderOptions,
        reporter: &Reporter,
    ) -> Result<Self, RenderError> {
        let start = Instant::now();
        let field = pipeline::open_field(capture, options, reporter)?;
        let options = pipeline::resolved(&field, options, reporter)?;
        Ok(Self { field, options, preparation_s: start.elapsed().as_secs_f64() })
    }
}

impl Renderer for ComparedLightField {
    fn field(&self) -> &LightField {
        &self.field
    }

    fn synchronized(
        &self,
        sync: SyncMethod,
        camera: usize,
        time_s: f64,
    ) -> Result<Arc<Synchronized>, String> {
        let options = RenderOptions { sync, ..self.options.clone() };
        let found = self.field.synchronized(camera, time_s, &options);
        let image = found.map_err(|e| e.to_string())?;
        Ok(self.field.exposed_first(camera, time_s, &image, &options).map_or(image, Arc::new))
    }

    fn view(&self, view: &ComparedView) -> Result<Rendered, String> {
        // A ground-truth image shows one instant, so the option for a motion trail is switched off.
        let mut options = RenderOptions { trail: TrailOptions::default(), ..self.options.clone() };
        // Traditional light field rendering is the baseline, so it uses the default options of blending and geometry.
        if matches!(view.images, Images::By(TRADITIONAL)) && options.sync != TRADITIONAL {
            let RenderOptions { blend, proxy, .. } = RenderOptions::default();
            (options.blend, options.proxy) = (blend, proxy);
        }
        options.proxy.method = view.proxy;
        let request = Request::new(Viewpoint::View(view.target), view.time_s, &options);
        let request = Request { images: view.images, shape: view.shape, ..request };
        render(&self.field, &request, &Context::unattended()).map_err(|e| e.to_string())
    }

    fn options(&self) -> &RenderOptions {
        &self.options
    }

    fn timings(&self) -> Vec<StageTime> {
        vec![StageTime { stage: "offsets".into(), seconds: self.preparation_s }]
    }
}
