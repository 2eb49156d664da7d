//! The combinations of methods and parameters whose time and quality are measured.

use crate::interpolation::SyncMethod;
use crate::lumigraph::BlendMethod;
use crate::method::Method;
use crate::offset::OffsetMethod;
use crate::options::{ProxyMethod, ProxyOptions, RenderOptions};

/// The methods of the geometry proxy that are combined with the other stages' methods and measured.
const PROXIES: &[ProxyMethod] = &[ProxyMethod::Plane, ProxyMethod::Mesh, ProxyMethod::Depth];

/// Returns options for all combinations of synchronization, proxy and blending methods. All other options are
/// copied from `base`.
///
/// The offset method is varied in [`variations`], like a parameter, because offsets are estimated once and then
/// take no time per view. [`SyncMethod::AllCameras`] always computes depth per pixel, so that it is combined only
/// with [`ProxyMethod::Depth`]. [`ProxyMethod::SceneFlow`] is left out, because the time for a single view would be
/// misleading: most of the time is spent on the recorded frames, and views at several instants share these results.
pub fn methods(base: &RenderOptions) -> Vec<RenderOptions> {
    let mut found = Vec::new();
    for &sync in SyncMethod::ALL {
        for &proxy in PROXIES {
            if sync == SyncMethod::AllCameras && proxy != ProxyMethod::Depth {
                continue;
            }
            for &blend in BlendMethod::ALL {
                let mut options = base.clone();
                (options.sync, options.proxy.method, options.blend.method) = (sync, proxy, blend);
                found.push(options);
            }
        }
    }
    found
}

/// Returns options with the most accurate method of every stage. Options that choose no method are copied from
/// `base`.
pub fn most_accurate(base: &RenderOptions) -> RenderOptions {
    let mut options = base.clone();
    (options.sync, options.proxy.method) = (SyncMethod::Refined, ProxyMethod::Depth);
    options.blend.method = BlendMethod::SpaceTime;
    options.offset.method = OffsetMethod::JointCurved;
    options
}

/// Properties of a capture that determine which options can change its views, and are therefore varied.
#[derive(Clone, Copy, Debug)]
pub struct Variable {
    /// Whether the temporal offsets between cameras are estimated.
    pub offsets: bool,
    /// Number of the capture's cameras. It is the maximum number of cameras that can be blended into a view.
    pub cameras: usize,
}

/// Returns copies of the options in which one main parameter is changed. For each main parameter that the methods
/// in `options` use, there is one copy for each of its measured values, except the present value.
pub fn variations(options: &RenderOptions, variable: Variable) -> Vec<RenderOptions> {
    let mut found = Vec::new();
    let mut add = |change: &dyn Fn(&mut RenderOptions)| {
        let mut varied = options.clone();
        change(&mut varied);
        found.extend(Some(varied).filter(|varied| varied != options));
    };
    if variable.offsets {
        for &method in OffsetMethod::ALL {
            add(&|o| o.offset.method = method);
        }
    }
    for count in [500, 1000, 2000, 4000] {
        add(&|o| o.registration.max_corners = count);
    }
    if options.sync.needs_tracks() {
        for curved in [false, true] {
            add(&|o| o.interpolation.curved = curved);
        }
    }
    if matches!(options.sync, SyncMethod::Morph | SyncMethod::EdgeMorph) {
        for grid_px in [4, 8] {
            add(&|o| o.interpolation.grid_px = grid_px);
        }
        for max_length_px in [12.0, 24.0, 48.0] {
            add(&|o| o.interpolation.max_edge_length_px = max_length_px);
        }
    }
    if options.proxy.method == ProxyMethod::Depth {
        for (cameras, halvings) in [(4, 1), (4, 0), (6, 1), (6, 0)] {
            add(&|o| (o.proxy.depth.cameras, o.proxy.depth.halvings) = (cameras, halvings));
        }
    }
    // A proxy plane at a given depth needs no scene points.
    if options.proxy.method != ProxyMethod::Plane || options.proxy.plane_depth_m.is_none() {
        for (cameras, partners) in [(1, 2), (2, 2), (3, 4)] {
            add(&|o| (o.proxy.cameras, o.proxy.partners) = (cameras, partners));
        }
    }
    if options.blend.method != BlendMethod::Uniform {
        for cameras in [1, 2, 3, 4].into_iter().filter(|k| *k <= variable.cameras) {
            add(&|o| o.blend.cameras = cameras);
        }
    }
    found
}

/// Returns the name of a combination of options: its methods, and the main parameters whose values are not the
/// defaults.
pub fn name(options: &RenderOptions) -> String {
    let default = RenderOptions::default();
    let (sync, proxy, blend) = (options.sync, &options.proxy, &options.blend);
    let (interpolation, offset) = (&options.interpolation, options.offset.method);
    let (features, grid_px) = (options.registration.max_corners, interpolation.grid_px);
    let longest_px = interpolation.max_edge_length_px;
    let points = |o: &ProxyOptions| (o.cameras, o.partners);
    let depth = |o: &ProxyOptions| (o.depth.cameras, o.depth.halvings);
    let ((cameras, partners), (depths, halvings)) = (points(proxy), depth(proxy));
    let has_k = blend.method != BlendMethod::Uniform && blend.cameras != default.blend.cameras;
    let words = [
        (true, sync.name().to_owned()),
        (true, proxy.method.name().to_owned()),
        (blend.method != default.blend.method, blend.method.name().to_owned()),
        (offset != default.offset.method, format!("{} offsets", offset.name())),
        (features != default.registration.max_corners, format!("{features} features")),
        (!interpolation.curved, "straight".to_owned()),
        (interpolation.still_change > 0.0, "still cross-faded".to_owned()),
        (grid_px != default.interpolation.grid_px, format!("grid {grid_px}")),
        (longest_px != default.interpolation.max_edge_length_px, format!("L {longest_px}")),
        (points(proxy) != points(&default.proxy), format!("points {cameras}x{partners}")),
        (depth(proxy) != depth(&default.proxy), format!("depth {depths}/{halvings}")),
        (has_k, format!("k {}", blend.cameras)),
    ];
    let said = words.into_iter().filter(|(is_said, _)| *is_said);
    said.map(|(_, word)| word).collect::<Vec<_>>().join(", ")
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::HashSet;

    #[test]
    fn every_combination_is_one_and_can_be_worked_with() {
        let base = RenderOptions::default();
        let mut all = methods(&base);
        // `all-cameras` is combined with only one proxy.
        let images_and_proxies = (SyncMethod::ALL.len() - 1) * PROXIES.len() + 1;
        assert_eq!(all.len(), images_and_proxies * BlendMethod::ALL.len());
        assert!(all.contains(&most_accurate(&base)));
        let variable = Variable { offsets: true, cameras: 8 };
        for options in methods(&base) {
            all.extend(variations(&options, variable));
        }
        for options in &all {
            assert_eq!(options.check(), Ok(()));
        }
        // Different combinations have different names.
        let texts: HashSet<String> =
            all.iter().map(|o| serde_json::to_string(o).unwrap()).collect();
        let names: HashSet<String> = all.iter().map(name).collect();
        assert_eq!(texts.len(), names.len());
        assert_eq!(texts.len(), all.len());
    }

    #[test]
    fn only_what_is_used_is_varied() {
        let mut options = RenderOptions::default();
        let few = Variable { offsets: false, cameras: 2 };
        options.sync = SyncMethod::Nearest;
        options.blend.method = BlendMethod::Uniform;
        let names: Vec<String> = variations(&options, few).iter().map(name).collect();
        for word in ["offsets", "straight", "grid", "L ", "k "] {
            assert!(!names.iter().any(|n| n.contains(word)), "{word}: {names:?}");
        }
        let names: Vec<String> =
            variations(&RenderOptions::default(), few).iter().map(name).collect();
        assert!(
            names.iter().any(|n| n.contains("k 1")) && !names.iter().any(|n| n.contains("k 4"))
        );
    }
}
