//! A light field as what is compared.

use super::results::StageTime;
use super::{CameraOffset, RenderedView, Renderer};
use crate::camera::Camera;
use crate::capture::Capture;
use crate::interpolation::Sync;
use crate::lumigraph::Proxy;
use crate::raster::Image;
use crate::render::{LightField, ProxyRung};
use clap::ValueEnum;
use std::sync::{Arc, Mutex, PoisonError};

/// A light field, with the time its preparation took.
pub struct ComparedField<'a> {
    field: &'a LightField,
    preparation: Vec<StageTime>,
    /// The proxy made last: three methods in turn are blended through the same one.
    proxy: Mutex<Option<(ProxyKey, Arc<Proxy>)>>,
}

#[derive(Clone, PartialEq)]
struct ProxyKey {
    rung: usize,
    target: Camera,
    time_s: f64,
}

impl<'a> ComparedField<'a> {
    pub fn new(field: &'a LightField, preparation: Vec<StageTime>) -> Self {
        Self { field, preparation, proxy: Mutex::default() }
    }

    fn proxy(&self, rung: usize, target: &Camera, time_s: f64) -> Result<Arc<Proxy>, String> {
        let key = ProxyKey { rung, target: target.clone(), time_s };
        let mut kept = self.proxy.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some((of, proxy)) = &*kept
            && *of == key
        {
            return Ok(proxy.clone());
        }
        let rung = ProxyRung::value_variants()[rung];
        let proxy = self.field.proxy(rung, target, time_s).map_err(|e| e.to_string())?;
        let proxy = Arc::new(proxy);
        *kept = Some((key, proxy.clone()));
        Ok(proxy)
    }
}

/// The names of a ladder's rungs, as the command line and the options spell them.
fn names<R: ValueEnum>() -> Vec<String> {
    R::value_variants()
        .iter()
        .filter_map(|rung| Some(rung.to_possible_value()?.get_name().to_owned()))
        .collect()
}

impl Renderer for ComparedField<'_> {
    fn capture(&self) -> &Capture {
        self.field.capture()
    }

    fn offsets(&self) -> Vec<CameraOffset> {
        self.field
            .offsets()
            .cameras
            .iter()
            .map(|o| CameraOffset {
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
        let proxy = self.proxy(proxy, target, time_s)?;
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
        self.preparation.clone()
    }
}
