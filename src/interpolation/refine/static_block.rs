//! Blocks in which nothing moves: the mean of the four frames without resampling, which trying motions
//! would give too, at a higher cost.

use super::four_frames::FourFrames;
use super::square::Square;
use crate::raster::Image;

/// Maximum excess of an outer frame's difference in a static block, in the mean over the block, as a fraction
/// of [`crate::interpolation::RefineOptions::outer_slack`]. Larger: slow motion is blurred; smaller: noise
/// is taken for motion, which costs time.
const STATIC_EXCESS: f32 = 0.25;

/// Whether the frames before and after show these pixels (indices, row by row) as the middle ones do:
/// each pixel so that the outer frames have full weight, and all together but for noise.
///
/// `outer_costs` and `costs` are the differences of the image's pixels, of the outer and of the middle frames; `slack` is
/// [`crate::interpolation::RefineOptions::outer_slack`].
pub(super) fn is_static(
    outer_costs: &[Option<Vec<f32>>; 2],
    costs: &[f32],
    slack: f32,
    square: Square,
) -> bool {
    outer_costs.iter().flatten().all(|outer| {
        let (mut sum, mut count) = (0.0, 0.0);
        for (outer, own) in square.rows_of(outer).zip(square.rows_of(costs)) {
            for (outer, own) in outer.iter().zip(own) {
                let excess = outer - own;
                if excess > slack {
                    return false;
                }
                (sum, count) = (sum + excess.max(0.0), count + 1.0);
            }
        }
        sum <= STATIC_EXCESS * slack * count
    })
}

/// The mean of the cross-faded middle frames and the outer frames at these pixels, row by row, black outside the
/// image. `outer_weight` is the outer frames' relative to the middle ones'.
pub(super) fn average(
    frames: &FourFrames,
    cross_faded: &Image,
    outer_weight: f32,
    square: Square,
) -> Vec<f32> {
    let weight = 0.25 * outer_weight;
    let channels = cross_faded.channels();
    let mut colors = vec![0.0; square.side * square.side * channels];
    for (first, columns, y) in square.rows() {
        let columns = columns.start * channels..columns.end * channels;
        let middle = &cross_faded.row(y)[columns.clone()];
        let out = &mut colors[first * channels..][..middle.len()];
        out.copy_from_slice(middle);
        for image in [frames.before, frames.after].into_iter().flatten() {
            let outer = &image.row(y)[columns.clone()];
            for ((out, outer), middle) in out.iter_mut().zip(outer).zip(middle) {
                *out += weight * (outer - middle);
            }
        }
    }
    colors
}
