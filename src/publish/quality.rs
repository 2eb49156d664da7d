//! Quality settings of published frames, depth and motion.

use super::flow::FlowSteps;
use serde::Serialize;

/// Quality setting of published frames: frame size, JPEG quality, and quantization steps.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub(super) struct Quality {
    /// Number of times that each frame is halved in width and height before it is encoded.
    pub halvings: usize,
    /// JPEG quality of the frames, 1 to 100.
    pub jpeg: u8,
    pub steps: FlowSteps,
}

/// Smallest quantization steps of depth and motion. With an error of half a step, a view between two cameras shows
/// surfaces displaced by one or two hundredths of a pixel.
const FINEST: FlowSteps = FlowSteps {
    block_px: 1,
    disparity_px: 1.0 / 16.0,
    velocity_px: 1.0 / 16.0,
    acceleration_px: 1.0 / 4.0,
    rate_px: 1.0 / 8.0,
};

/// Quality settings for frames of one size, best first. Each is a JPEG quality, the side of a block in pixels, and a
/// factor. All other quantization steps are those of [`FINEST`] times this factor.
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
/// Maximum number of times that frames are halved to reduce the size of a site.
const MAX_HALVINGS: usize = 3;

impl Quality {
    /// Returns all quality settings with at least this number of halvings, best first.
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
