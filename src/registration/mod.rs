//! §4 of the paper: image registration. Sparse features are tracked between frames of one camera (temporal flow)
//! and between frames of two cameras (spatial flow). The epipolar constraint detects mismatches.
//!
//! | paper | here |
//! |---|---|
//! | 4.1 corners | [`corners`] |
//! | 4.1 pyramidal KLT | [`Tracker`], on [`Pyramid`]s |
//! | 4.1 bidirectional flow, merging | [`temporal_flow`], [`flow`] |
//! | beyond the paper: motion predicted by neighbours | `guided_flow` |
//! | beyond the paper: rotating patches | [`AffineTracker`] |
//! | beyond the paper: photometric calibration | [`Gains`] |
//! | 4.2 eq. (2), and curves beyond the paper | [`Trajectory`] |
//! | 4.2 eq. (3), 4.3 eqs. (4), (5) | [`epipolar_check`], [`select_references`] |

mod affine_tracker;
mod consensus;
mod corners;
mod epipolar_check;
mod flow;
mod frame;
mod frame_store;
mod gain_changes;
mod gain_curve;
mod gain_ratios;
mod gains;
mod gradient;
mod guided_flow;
mod klt;
mod matched_light;
mod neighbors;
mod options;
mod polar_gradients;
mod pyramid;
mod references;
mod rotating_patches;
mod sift;
mod temporal_flow;
mod trajectory;
mod window;

pub use affine_tracker::{AffineStart, AffineTracker, Deformed};
pub(crate) use consensus::Moved;
pub use corners::corners;
pub use epipolar_check::{Verdict, epipolar_check};
pub use flow::{Match, Start, flow};
pub use frame::Frame;
pub use frame_store::FrameStore;
pub use gain_curve::{GainCurve, GainKnot};
pub(crate) use gain_ratios::halved;
pub(crate) use gains::GainSamples;
pub use gains::Gains;
pub use klt::{KltParameters, Tracked, Tracker};
pub(crate) use matched_light::MatchedLight;
pub use neighbors::Neighbors;
pub use options::{ConsistencyThresholds, GainMethod, RegistrationOptions};
pub use pyramid::{Pyramid, PyramidLevel};
pub use references::{Reference, ReferenceQuery, References, select_references};
pub use temporal_flow::{
    FlowDirection, Track, neighbor_consensus, temporal_flow, temporal_flow_of,
};
pub use trajectory::Trajectory;
