//! Everything that decides an image besides the capture: each stage's method and its options.
//!
//! | options | decide | given to |
//! |---|---|---|
//! | [`RenderOptions`] | all of it: what an option file holds | the programs' entry points |
//! | [`ViewOptions`] | one view of a light field that is open | [`crate::light_field::LightField`] |
//! | [`AutoOptions`] | which methods the capture itself decides | [`crate::plan`] |

mod auto;
mod check;
mod presets;
mod trail;

pub use auto::AutoOptions;
pub use check::OptionError;
pub use presets::Preset;
pub use trail::{TrailMode, TrailOptions};

use crate::interpolation::{InterpolationOptions, SyncMethod};
use crate::lumigraph::{BlendOptions, MeshOptions};
use crate::method::methods;
use crate::offset::OffsetOptions;
use crate::registration::RegistrationOptions;
use crate::stereo::StereoOptions;
use serde::{Deserialize, Serialize};

/// The options of all stages, as an option file holds them: a JSON object whose missing fields have
/// their defaults. Unknown fields are refused.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RenderOptions {
    pub sync: SyncMethod,
    pub proxy: ProxyOptions,
    /// Decided when a light field is opened.
    pub registration: RegistrationOptions,
    /// Decided when a light field is opened.
    pub offset: OffsetOptions,
    pub interpolation: InterpolationOptions,
    pub blend: BlendOptions,
    /// Used by `render` only: what is compared with the truth is an instant.
    pub trail: TrailOptions,
    /// Which methods the capture decides, in place of those above.
    pub auto: AutoOptions,
}

/// How one view of an open light field is rendered. Two views of one light field may have different
/// options.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ViewOptions {
    pub sync: SyncMethod,
    pub proxy: ProxyOptions,
    pub interpolation: InterpolationOptions,
    pub blend: BlendOptions,
    pub trail: TrailOptions,
}

impl ViewOptions {
    /// The same with another sync method.
    pub fn with_sync(self, sync: SyncMethod) -> Self {
        Self { sync, ..self }
    }
}

impl RenderOptions {
    /// The options of a view.
    pub fn view(&self) -> ViewOptions {
        ViewOptions {
            sync: self.sync,
            proxy: self.proxy.clone(),
            interpolation: self.interpolation.clone(),
            blend: self.blend.clone(),
            trail: self.trail.clone(),
        }
    }
}

/// The geometry proxy: what stands for the scene's shape (§6).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ProxyOptions {
    /// The kind of proxy. Files of earlier versions call it `rung`.
    #[serde(alias = "rung")]
    pub method: ProxyMethod,
    /// Depth of the plane before the view, metres: what is in focus. `None`: fitted to the points
    /// that the cameras see.
    pub plane_depth_m: Option<f64>,
    pub mesh: MeshOptions,
    pub depth: StereoOptions,
    /// How many cameras' features are triangulated: those nearest to the view. Fewer: fewer points
    /// at the view's borders and behind outlines; more cost time.
    pub cameras: usize,
    /// How many neighbours each of them is matched with. Fewer: less accurate points; more cost time.
    pub partners: usize,
    /// Largest distance of a match from its epipolar line at the instant, pixels. Larger keeps
    /// mismatches, smaller drops points that move.
    pub max_epipolar_px: f64,
    /// Largest reprojection error of a point (root mean square), pixels. Larger keeps mismatches,
    /// smaller drops points that move.
    pub max_error_px: f64,
}

/// The proxies, cheapest first.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum ProxyMethod {
    /// One plane, fitted to the scene's points or at a set depth.
    Plane,
    /// The paper's: triangulated correspondences, meshed, with a plane behind.
    #[default]
    Mesh,
    /// Depth per pixel from the images of several cameras, and what hides what.
    Depth,
}

methods!(ProxyMethod {
    Plane = "plane": "One plane, fitted or at a set depth",
    Mesh = "mesh": "The paper's: triangulated correspondences, meshed, with a plane behind",
    Depth = "depth": "Depth per pixel that all cameras agree on, and what hides what",
});

impl Default for ProxyOptions {
    fn default() -> Self {
        Self {
            method: ProxyMethod::default(),
            plane_depth_m: None,
            mesh: MeshOptions::default(),
            depth: StereoOptions::default(),
            cameras: 3,
            partners: 4,
            max_epipolar_px: 1.0,
            max_error_px: 0.7,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lumigraph::BlendMethod;
    use crate::method::Method;
    use crate::offset::OffsetMethod;

    /// Option files, the command line and Python name a method alike.
    fn named_as_in_files<M: Method + Serialize + std::fmt::Debug>() {
        assert!(!M::ALL.is_empty());
        for &method in M::ALL {
            assert_eq!(serde_json::to_value(method).unwrap(), method.name());
            assert_eq!(M::from_name(method.name()), Some(method));
            assert!(!method.help().is_empty() && !method.help().ends_with('.'));
        }
        assert_eq!(M::from_name("no-such-method"), None);
    }

    #[test]
    fn methods_have_the_names_of_option_files() {
        named_as_in_files::<SyncMethod>();
        named_as_in_files::<ProxyMethod>();
        named_as_in_files::<BlendMethod>();
        named_as_in_files::<OffsetMethod>();
        named_as_in_files::<TrailMode>();
        named_as_in_files::<Preset>();
    }

    #[test]
    fn fields_of_earlier_versions_are_read() {
        let text = r#"{"proxy": {"rung": "plane"}, "blend": {"rung": "uniform"},
            "offset": {"rung": "joint"}}"#;
        for preset in [None, Some(Preset::Draft)] {
            let options = RenderOptions::parse(text, preset).unwrap();
            assert_eq!(options.proxy.method, ProxyMethod::Plane);
            assert_eq!(options.blend.method, BlendMethod::Uniform);
            assert_eq!(options.offset.method, OffsetMethod::Joint);
            let both = r#"{"proxy": {"rung": "plane", "method": "mesh"}}"#;
            assert!(RenderOptions::parse(both, preset).is_err());
        }
    }
}
