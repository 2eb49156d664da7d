//! §4: image registration. Sparse correspondences between frames of one camera (temporal flow) and of
//! two cameras (spatial flow), with mismatches removed by the epipolar constraint.
//!
//! | paper | here |
//! |---|---|
//! | 4.1 corners | [`corners`] |
//! | 4.1 pyramidal KLT | [`Tracker`], on [`Pyramid`]s |
//! | 4.1 bidirectional flow, merging | [`temporal_flow`], [`flow`] |
//! | beyond: affine windows | [`AffineOptions`] |
//! | beyond: motion predicted by neighbours | [`MotionPrior`] |
//! | beyond: features that turn | `turned_flow` |
//! | beyond: tracks over many frames | [`LongTracks`] |
//! | beyond: photometric calibration | [`Gains`] |
//! | 4.2 eq. (2), and curves beyond it | [`Trajectory`] |
//! | 4.2 eq. (3), 4.3 eqs. (4), (5) | [`epipolar_test`], [`select_references`] |

mod affine;
mod consensus;
mod corners;
mod directions;
mod epipolar_test;
mod flow;
mod frame;
mod frame_store;
mod gains;
mod gradient;
mod guided_flow;
mod klt;
mod long_tracks;
mod motion_prior;
mod neighbors;
mod options;
mod oriented;
mod pyramid;
mod references;
mod temporal_flow;
mod trajectory;
mod turned_flow;
mod window;

pub use affine::AffineOptions;
pub use corners::{CornerOptions, corners};
pub use epipolar_test::{Verdict, epipolar_test};
pub use flow::{Match, Start, flow};
pub use frame::Frame;
pub use frame_store::FrameStore;
pub use gains::Gains;
pub use klt::{Tracked, Tracker};
pub use long_tracks::{LongTrack, LongTracks};
pub use motion_prior::MotionPrior;
pub use neighbors::Neighbors;
pub use options::{GainMethod, KltOptions, RegistrationOptions};
pub use pyramid::{Level, Pyramid};
pub use references::{Reference, ReferenceQuery, References, select_references};
pub use temporal_flow::{
    FlowDirection, Track, neighbor_consensus, temporal_flow, temporal_flow_of,
};
pub use trajectory::Trajectory;
