//! §4: image registration: sparse correspondences within a camera (temporal) and between cameras
//! (spatial), with the wrong ones found by the epipolar constraint.
//!
//! | paper | here |
//! |---|---|
//! | 4.1 corners | [`corners`] |
//! | 4.1 pyramidal KLT | [`Tracker`], on [`Pyramid`]s |
//! | 4.1 bidirectional flow, merging | [`temporal_flow`], [`flow`] |
//! | the last sub-pixel step: a window that deforms | [`AffineOptions`] |
//! | chains over many frames | [`LongTracks`] |
//! | 4.2 eq. (2), and curved motion | [`Trajectory`] |
//! | 4.2 eq. (3), 4.3 eqs. (4), (5) | [`epipolar_test`], [`select_references`] |

mod affine;
mod corners;
mod epipolar_test;
mod flow;
mod frames;
mod gains;
mod guide;
mod klt;
mod lanes;
mod long_tracks;
mod neighbors;
mod options;
mod pyramid;
mod trajectory;
mod window;

pub use affine::AffineOptions;
use corners::Spaced;
pub use corners::{CornerOptions, corners};
pub use epipolar_test::{Reference, References, Verdict, epipolar_test, select_references};
pub use flow::{Match, Run, Start, Track, agreeing, flow, temporal_flow, temporal_flow_of};
pub use frames::{Frame, FrameStore};
pub use gains::{GainMethod, Gains};
pub use guide::Guide;
pub use klt::{Tracked, Tracker};
pub use long_tracks::{LongTrack, LongTracks};
pub use neighbors::Neighbors;
pub use options::{KltOptions, RegistrationOptions};
pub use pyramid::{Level, Pyramid};
pub use trajectory::Trajectory;
