//! How finely frames, depth and motion are stored.

use super::flow::FlowSteps;
use serde::Serialize;

/// How frames are stored.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub(super) struct Quality {
    /// How often a frame is halved.
    pub halvings: usize,
    /// JPEG's, 1 to 100.
    pub jpeg: u8,
    pub steps: FlowSteps,
}

/// Steps of depth and motion where they are finest: half a step moves a pixel between two cameras by a hundredth of a pixel
/// or two.
const FINEST: FlowSteps = FlowSteps {
    block_px: 1,
    disparity_px: 1.0 / 16.0,
    velocity_px: 1.0 / 16.0,
    acceleration_px: 1.0 / 4.0,
    rate_px: 1.0 / 8.0,
};

/// Qualities of frames of one size, best first: that of JPEG, the block's side, and the multiple of the finest steps.
const LADDER: [(u8, usize, f32); 11] = [
    (94, 1, 1.0),
    (92, 1, 2.0),
    (90, 1, 3.0),
    (87, 1, 4.0),
    (88, 2, 2.0),
    (84, 2, 3.0),
    (80, 2, 4.0),
    (75, 2, 4.0),
    (75, 3, 4.0),
    (68, 3, 6.0),
    (60, 4, 6.0),
];
/// How often frames may be halved so that a site is small enough.
const MAX_HALVINGS: usize = 3;

impl Quality {
    /// All qualities of frames that are halved at least so often, best first.
    pub fn ladder(halvings: usize) -> impl Iterator<Item = Self> {
        let more = halvings..(halvings + 1).max(MAX_HALVINGS + 1);
        more.flat_map(|halvings| {
            LADDER.map(|(jpeg, block_px, multiple)| {
                let steps = FlowSteps {
                    block_px,
                    disparity_px: multiple * FINEST.disparity_px,
                    velocity_px: multiple * FINEST.velocity_px,
                    acceleration_px: multiple * FINEST.acceleration_px,
                    rate_px: multiple * FINEST.rate_px,
                };
                Self { halvings, jpeg, steps }
            })
        })
    }
}
