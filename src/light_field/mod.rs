//! A capture's light field, continuous in space and time (Fig. 2).
//!
//! | file | what |
//! |---|---|
//! | `mod.rs` | what is decided when it is opened |
//! | `clocks.rs` | which frames lie around an instant |
//! | `registered.rs` | §4: tracks of frame pairs, cached |
//! | `prepared.rs` | the same on disk, and the cameras' gains |
//! | `synchronized.rs` | §5: a camera's image at an instant |
//! | `joint.rs` | the same from all cameras |
//! | `correspondences.rs` | §6: features that show the same point |
//! | `points.rs`, `proxy.rs`, `geometry.rs` | §6: the scene's shape at an instant |
//! | `view.rs` | §6: the blended view |
//! | `moment.rs` | many views of one instant |
//! | `trail.rs` | Fig. 1: temporal integration |
//! | `held_out.rs` | cameras that are held out, so that their frames are the truth |

mod clocks;
mod correspondences;
mod error;
mod geometry;
pub(crate) mod held_out;
mod joint;
mod moment;
mod points;
mod prepared;
mod proxy;
mod registered;
mod synchronized;
mod trail;
mod view;

pub use clocks::check_times_before_offsets;
pub use error::RenderError;
pub use geometry::Geometry;
pub use moment::Moment;
pub use prepared::{Prepared, delete_prepared};
pub use trail::Viewpoint;

use crate::capture::Capture;
use crate::host::BoundedCache;
use crate::interpolation::{PairCosts, Triangles};
use crate::offset::Offsets;
use crate::registration::{FrameStore, Gains, RegistrationOptions, Track};
use correspondences::{Correspondences, CorrespondencesKey};
use joint::{Joint, JointKey};
use nalgebra::Point3;
use points::PointsKey;
use prepared::Store;
use registered::PairCostsKey;
use std::sync::{Arc, OnceLock};

/// A capture, its clocks and its registered frames: what all views share.
///
/// It doesn't change. How frames are registered and which offsets clocks have is decided when it is
/// opened; every view takes its own [`crate::options::ViewOptions`], and may be asked for from any
/// thread. What is computed once is cached within bounds; a cached value depends on nothing but its
/// key, so that no result depends on the views before it.
///
/// Times are seconds on the reference camera's clock, from the capture's start
/// ([`Capture::time_origin_s`]).
pub struct LightField {
    /// But for its options and its capture, used through [`LightField::frames`].
    frames: FrameStore,
    offsets: Offsets,
    /// Every camera's frame times on the reference's clock; `None` if they are unknown.
    times_s: Vec<Option<Vec<f64>>>,
    /// By camera and earlier frame; the cost is the number of tracks.
    tracks: BoundedCache<(usize, usize), Arc<Vec<Track>>>,
    /// Where tracks and gains are on disk; looked for when frames are first needed.
    store: OnceLock<Option<Store>>,
    /// The triangles of these tracks; the cost is their number.
    triangles: BoundedCache<(usize, usize), Arc<Triangles>>,
    /// What refinement needs of frame pairs; the cost is its size in bytes.
    pair_costs: BoundedCache<PairCostsKey, Arc<PairCosts>>,
    /// The largest changes of frame pairs, by camera and earlier frame.
    changes: BoundedCache<(usize, usize), f32>,
    /// The cost is their size in bytes.
    correspondences: BoundedCache<CorrespondencesKey, Arc<Correspondences>>,
    points: BoundedCache<PointsKey, Arc<Vec<Point3<f64>>>>,
    /// All cameras' images at an instant, with their depths.
    joints: BoundedCache<JointKey, Arc<Joint>>,
}

impl LightField {
    /// The light field of a capture whose offsets are known.
    pub fn new(
        capture: Arc<Capture>,
        offsets: Offsets,
        registration: &RegistrationOptions,
    ) -> Self {
        Self::with_frames(FrameStore::new(capture, registration), offsets)
    }

    /// The same with frames that other stages have used already.
    pub fn with_frames(frames: FrameStore, offsets: Offsets) -> Self {
        let times_s = offsets.common_times_s(frames.capture());
        Self {
            frames,
            offsets,
            times_s,
            tracks: BoundedCache::new(registered::MAX_CACHED_TRACKS),
            store: OnceLock::new(),
            triangles: BoundedCache::new(registered::MAX_CACHED_TRIANGLES),
            pair_costs: BoundedCache::new(registered::MAX_CACHED_COST_BYTES),
            changes: BoundedCache::new(registered::MAX_CACHED_CHANGES),
            correspondences: BoundedCache::new(correspondences::MAX_CACHED_BYTES),
            points: BoundedCache::new(points::MAX_CACHED_POINTS),
            joints: BoundedCache::new(joint::MAX_CACHED_INSTANTS),
        }
    }

    pub fn capture(&self) -> &Capture {
        self.frames.capture()
    }

    pub fn offsets(&self) -> &Offsets {
        &self.offsets
    }

    /// How frames are registered.
    pub(crate) fn registration(&self) -> &RegistrationOptions {
        self.frames.options()
    }

    /// The decoded frames, with what registration derives from them.
    pub fn frames(&self) -> &FrameStore {
        // With the gains that were prepared.
        self.store();
        &self.frames
    }

    /// How much more light each camera records than the reference.
    pub fn gains(&self) -> &Gains {
        self.frames().gains()
    }

    /// The median distance of a camera from its nearest neighbour at another place, metres; 0
    /// without one.
    pub(crate) fn spacing_m(&self) -> f64 {
        let centers: Vec<_> = self.capture().cameras.iter().map(|c| c.camera.center()).collect();
        let nearest = |a: &Point3<f64>| {
            let distances = centers.iter().map(|b| (a - b).norm()).filter(|d| *d > 0.0);
            distances.min_by(f64::total_cmp)
        };
        let mut distances: Vec<f64> = centers.iter().filter_map(nearest).collect();
        distances.sort_by(f64::total_cmp);
        distances.get(distances.len() / 2).copied().unwrap_or(0.0)
    }
}
