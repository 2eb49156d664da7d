//! A light field, as what is compared.

use super::Renderer;
use super::results::StageTime;
use crate::camera::Camera;
use crate::capture::Capture;
use crate::interpolation::{SyncMethod, Synchronized};
use crate::light_field::{LightField, RenderError};
use crate::lumigraph::Rendered;
use crate::offset::Offsets;
use crate::options::{ProxyMethod, RenderOptions, ViewOptions};
use crate::pipeline;
use crate::progress::Reporter;
use std::sync::Arc;
use std::time::Instant;

/// A light field with its options, and the time that its preparation took.
pub struct ComparedLightField {
    field: LightField,
    options: RenderOptions,
    view: ViewOptions,
    preparation_s: f64,
}

impl ComparedLightField {
    /// Opens it, with the offsets known, cached or estimated, and the methods that the capture
    /// requires where the options leave them to it.
    pub fn open(
        capture: Arc<Capture>,
        options: &RenderOptions,
        reporter: &Reporter,
    ) -> Result<Self, RenderError> {
        let start = Instant::now();
        let field = pipeline::open_field(capture, options, reporter)?;
        let options = pipeline::resolved(&field, options, reporter)?;
        let view = options.view();
        Ok(Self { field, options, view, preparation_s: start.elapsed().as_secs_f64() })
    }
}

impl Renderer for ComparedLightField {
    fn capture(&self) -> &Capture {
        self.field.capture()
    }

    fn offsets(&self) -> &Offsets {
        self.field.offsets()
    }

    fn synchronized(
        &self,
        sync: SyncMethod,
        camera: usize,
        time_s: f64,
    ) -> Result<Synchronized, String> {
        let options = self.view.clone().with_sync(sync);
        self.field.synchronized(camera, time_s, &options).map_err(|e| e.to_string())
    }

    fn view(
        &self,
        images: &[Option<Synchronized>],
        shape: &[Option<Synchronized>],
        proxy: ProxyMethod,
        target: &Camera,
        time_s: f64,
    ) -> Result<Rendered, String> {
        let mut options = self.view.clone();
        options.proxy.method = proxy;
        let geometry = self.field.geometry(shape, target, time_s, &options);
        let geometry = geometry.map_err(|e| e.to_string())?;
        Ok(self.field.blend(images, &geometry, target, &options.blend))
    }

    fn covered_span_s(&self) -> Option<(f64, f64)> {
        self.field.common_span_s()
    }

    fn options(&self) -> &RenderOptions {
        &self.options
    }

    fn timings(&self) -> Vec<StageTime> {
        vec![StageTime { stage: "offsets".into(), seconds: self.preparation_s }]
    }
}
