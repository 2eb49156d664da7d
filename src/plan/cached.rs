//! Cached plans: the methods that a plan decided, for the next command. Planning renders dozens of views.

use crate::host::CacheKind;
use crate::interpolation::SyncMethod;
use crate::light_field::LightField;
use crate::lumigraph::BlendMethod;
use crate::options::{AutoOptions, ProxyMethod, RenderOptions};
use serde::{Deserialize, Serialize};

/// The version changes with every change of views, because they decide plans.
const PLANS: CacheKind = CacheKind { name: "plans", version: 1 };

/// The methods that a plan decided.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Methods {
    pub sync: SyncMethod,
    pub curved: bool,
    pub still_change: f32,
    pub proxy: ProxyMethod,
    pub blend: BlendMethod,
}

impl Methods {
    /// The methods of a plan's options.
    pub fn of(planned: &RenderOptions) -> Self {
        Self {
            sync: planned.sync,
            curved: planned.interpolation.curved,
            still_change: planned.interpolation.still_change,
            proxy: planned.proxy.method,
            blend: planned.blend.method,
        }
    }

    /// Replaces `auto` in options by these methods.
    pub fn put_into(&self, mut options: RenderOptions) -> RenderOptions {
        let AutoOptions { sync, proxy, blend, budget_px, budget_db } = options.auto;
        if sync {
            options.sync = self.sync;
            options.interpolation.curved = self.curved;
            options.interpolation.still_change = self.still_change;
        }
        if proxy {
            options.proxy.method = self.proxy;
        }
        if blend {
            options.blend.method = self.blend;
        }
        options.auto = AutoOptions { budget_px, budget_db, ..AutoOptions::default() };
        options
    }
}

/// What a plan depends on besides the capture's content.
fn inputs<'a>(field: &'a LightField, options: &'a RenderOptions) -> impl Serialize + 'a {
    (field.offsets(), options)
}

/// The methods that were planned before, if any.
pub fn load_plan(field: &LightField, options: &RenderOptions) -> Option<Methods> {
    let cache = field.capture().cache().ok()?;
    let methods: Methods = cache.load_json(PLANS, &inputs(field, options))?;
    (0.0..=1.0).contains(&methods.still_change).then_some(methods)
}

/// Caches a plan.
///
/// # Errors
/// If it can't be written, or a frame can't be read.
pub fn save_plan(
    field: &LightField,
    options: &RenderOptions,
    methods: &Methods,
) -> Result<(), String> {
    let cache = field.capture().cache().map_err(|error| error.to_string())?;
    let saved = cache.save_json(PLANS, &inputs(field, options), methods);
    saved.map(drop).map_err(|error| error.to_string())
}
