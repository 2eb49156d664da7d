//! Presets: named sets of options for all stages, from fast to accurate.

use super::{AutoOptions, RenderOptions};
use crate::interpolation::SyncMethod;
use crate::method::methods;
use serde::{Deserialize, Serialize};

/// The presets, from the fastest to the most accurate. `tests/bench/README.md` compares them with other combinations of
/// methods.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Preset {
    /// The fastest methods that still synchronize the cameras' images, for interactive viewing.
    Draft,
    /// Methods with most of the accuracy of `Best`, in a fraction of its time.
    Balanced,
    /// Methods chosen by measurements of the capture ([`AutoOptions::all`]). A more expensive method is chosen only
    /// where a cheaper one would exceed the error budgets of [`AutoOptions`].
    #[default]
    Best,
}

methods!(Preset {
    Draft = "draft": "To look around: the fastest that still synchronizes",
    Balanced = "balanced": "Most of the accuracy for some of the time",
    Best = "best": "The most accurate that the capture shows to pay",
});

impl Preset {
    /// Returns the preset's options of all stages. All presets have the same registration options, so that they share
    /// cached registration results.
    pub fn options(self) -> RenderOptions {
        let mut options = RenderOptions::default();
        match self {
            Self::Draft => {
                options.sync = SyncMethod::Triangulation;
                (options.proxy.cameras, options.proxy.partners) = (1, 2);
                options.blend.cameras = 1;
            }
            Self::Balanced => {
                options.sync = SyncMethod::Triangulation;
                (options.proxy.cameras, options.proxy.partners) = (2, 2);
                options.blend.cameras = 2;
            }
            Self::Best => {
                options.auto = AutoOptions::all();
                options.blend.cameras = 4;
            }
        }
        options
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::method::Method;

    #[test]
    fn all_presets_can_be_worked_with_and_differ() {
        let all: Vec<_> = Preset::ALL.iter().map(|p| p.options()).collect();
        for (k, options) in all.iter().enumerate() {
            assert_eq!(options.check(), Ok(()));
            assert!(!all[..k].contains(options));
        }
        for preset in Preset::ALL {
            assert_eq!(Preset::from_name(preset.name()), Some(*preset));
        }
    }

    #[test]
    fn all_presets_register_alike() {
        let first = Preset::Draft.options().registration;
        assert!(Preset::ALL.iter().all(|p| p.options().registration == first));
    }
}
