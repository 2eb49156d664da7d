//! `CAPTURE/.stlfr/plans/KEY.json`: the methods that a plan decided, kept for the next command, since planning
//! renders dozens of views.
//!
//! KEY is a hash of all that a plan depends on: the capture's content, the offsets, the options, the program's
//! version. A file that is missing, damaged or of another key is planned anew. The folder may be deleted at any
//! time.
//!
//! Known limit: plans of earlier contents and options stay, of a few hundred bytes each.

use crate::host::{cache_file, link_within};
use crate::interpolation::SyncMethod;
use crate::light_field::LightField;
use crate::lumigraph::BlendMethod;
use crate::options::{AutoOptions, ProxyMethod, RenderOptions};
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// Part of the key: changed whenever plans of the same capture may turn out otherwise.
const PLANNING: &[u8] = b"stlfr-plan-1";

/// The folder of all plans inside a capture.
const FOLDER: &str = ".stlfr/plans";

/// What a plan decided, of all that it may decide.
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
    /// Those of a plan's options.
    pub fn of(planned: &RenderOptions) -> Self {
        Self {
            sync: planned.sync,
            curved: planned.interpolation.curved,
            still_change: planned.interpolation.still_change,
            proxy: planned.proxy.method,
            blend: planned.blend.method,
        }
    }

    /// The options with these methods, and nothing left to the capture.
    pub fn put_into(&self, mut options: RenderOptions) -> RenderOptions {
        options.sync = self.sync;
        options.interpolation.curved = self.curved;
        options.interpolation.still_change = self.still_change;
        options.proxy.method = self.proxy;
        options.blend.method = self.blend;
        let AutoOptions { budget_px, budget_db, .. } = options.auto;
        options.auto = AutoOptions { budget_px, budget_db, ..AutoOptions::default() };
        options
    }
}

/// Where the plan of a light field with certain options is kept.
pub struct Kept {
    path: PathBuf,
    key: String,
}

impl Kept {
    /// `None` if a frame can't be read, or if the folder would be elsewhere, behind a link.
    pub fn of(field: &LightField, options: &RenderOptions) -> Option<Self> {
        let capture = field.capture();
        let mut hasher = blake3::Hasher::new();
        hasher.update(PLANNING);
        hasher.update(env!("CARGO_PKG_VERSION").as_bytes());
        hasher.update(capture.content_hash().ok()?.as_bytes());
        let all = (field.offsets(), field.frames().options(), options);
        hasher.update(serde_json::to_string(&all).ok()?.as_bytes());
        let key = hasher.finalize().to_hex().to_string();
        let path = capture.folder.join(FOLDER).join(format!("{}.json", &key[..32]));
        link_within(&capture.folder, &path).is_none().then_some(Self { path, key })
    }

    /// What was decided before; what doesn't hold is said to `note` in one sentence.
    pub fn load(&self, note: impl FnOnce(&str)) -> Option<Methods> {
        cache_file::load(&self.path, &self.key, note)
    }

    /// Keeps what was decided. A folder that can't be written to is no error: the next command plans anew.
    pub fn save(&self, methods: &Methods) {
        cache_file::save(&self.path, &self.key, methods).ok();
    }
}
