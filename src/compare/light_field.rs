//! The light field of `render`, as what is compared.

use super::results::StageTime;
use super::{CameraOffset, RenderedView, Renderer};
use crate::camera::Camera;
use crate::capture::Capture;
use crate::interpolation::Sync;
use crate::progress::Reporter;
use crate::raster::Image;
use crate::render::{LightField, ProxyRung, RenderError, RenderOptions};
use clap::ValueEnum;
use std::sync::Arc;
use std::time::Instant;

/// A light field with the time that its preparation took.
pub struct ComparedLightField {
    field: LightField,
    preparation_s: f64,
}

impl ComparedLightField {
    /// Opens it, with the offsets known, kept or estimated.
    pub fn open(
        capture: Arc<Capture>,
        options: RenderOptions,
        reporter: &Reporter,
    ) -> Result<Self, RenderError> {
        let start = Instant::now();
        let field = LightField::open(capture, options, reporter)?;
        Ok(Self { field, preparation_s: start.elapsed().as_secs_f64() })
    }
}

/// The names of a ladder's rungs, as they stand on the command line and in option files.
fn names<T: ValueEnum>() -> Vec<String> {
    T::value_variants().iter().filter_map(name).collect()
}

fn name(rung: &impl ValueEnum) -> Option<String> {
    Some(rung.to_possible_value()?.get_name().to_owned())
}

/// The name of a sync rung.
pub fn sync_name(sync: Sync) -> String {
    name(&sync).unwrap_or_default()
}

impl Renderer for ComparedLightField {
    fn capture(&self) -> &Capture {
        self.field.capture()
    }

    fn offsets(&self) -> Vec<CameraOffset> {
        let rows = self.field.offsets().cameras.iter();
        rows.map(|o| CameraOffset {
            id: o.id.clone(),
            offset_s: o.offset_s,
            std_err_s: o.std_err_s,
            reason: o.reason.clone(),
        })
        .collect()
    }

    fn sync_rungs(&self) -> Vec<String> {
        names::<Sync>()
    }

    fn proxies(&self) -> Vec<String> {
        names::<ProxyRung>()
    }

    fn synchronized(&self, sync: &str, camera: usize, time_s: f64) -> Result<Image, String> {
        let sync = Sync::from_str(sync, false)?;
        self.field.synchronized_by(sync, camera, time_s).map_err(|e| e.to_string())
    }

    fn view(
        &self,
        images: &[Option<Image>],
        proxy: usize,
        target: &Camera,
        time_s: f64,
    ) -> Result<RenderedView, String> {
        let rung = ProxyRung::value_variants()[proxy];
        let proxy = self.field.proxy(rung, target, time_s).map_err(|e| e.to_string())?;
        let rendered = self.field.blend(images, &proxy, target);
        Ok(RenderedView { image: rendered.image, coverage: rendered.coverage })
    }

    fn covered_span_s(&self) -> Option<(f64, f64)> {
        self.field.common_span_s()
    }

    fn options(&self) -> serde_json::Value {
        serde_json::to_value(self.field.options()).unwrap_or_default()
    }

    fn timings(&self) -> Vec<StageTime> {
        vec![StageTime { stage: "offsets".into(), seconds: self.preparation_s }]
    }
}
