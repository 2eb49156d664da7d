//! `CAPTURE/.stlfr/plans/KEY.json`: the methods that a plan decided, kept for the next command. Planning renders
//! dozens of views.
//!
//! KEY is a hash of all that a plan depends on: the capture's content, the offsets, the options, the program's
//! version. A file that is missing, damaged or of another key is planned anew. The folder may be deleted at any
//! time.
//!
//! Known limits: plans of earlier contents and options stay, of a few hundred bytes each. A checksum tells damage, not a
//! forger, who can choose other methods, but nothing else.

use crate::host::{cache_file, link_within};
use crate::interpolation::SyncMethod;
use crate::light_field::LightField;
use crate::lumigraph::BlendMethod;
use crate::options::{AutoOptions, ProxyMethod, RenderOptions};
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// Part of the key: changed whenever plans of the same capture may turn out otherwise, as with every change of views.
const PLANNING: &[u8] = b"stlfr-plan-2";

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

    /// The options with these methods where they are left to the capture; nothing is left to it then.
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
        let all = (field.offsets(), field.registration(), options);
        hasher.update(serde_json::to_string(&all).ok()?.as_bytes());
        let key = hasher.finalize().to_hex().to_string();
        let folder = capture.folder.join(FOLDER);
        let path = folder.join(format!("{}.json", &key[..32]));
        link_within(&capture.folder, &folder).is_none().then_some(Self { path, key })
    }

    /// What was decided before. Tells `note` in one sentence of a file that doesn't hold.
    pub fn load(&self, note: impl FnOnce(&str)) -> Option<Methods> {
        let methods: Methods = cache_file::load(&self.path, &self.key, note)?;
        (0.0..=1.0).contains(&methods.still_change).then_some(methods)
    }

    /// Keeps what was decided.
    ///
    /// # Errors
    /// If the file can't be written.
    pub fn save(&self, methods: &Methods) -> std::io::Result<()> {
        cache_file::save(&self.path, &self.key, methods)
    }
}
