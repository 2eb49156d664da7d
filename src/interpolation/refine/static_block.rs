//! Blocks in which nothing moves: the mean of the four frames without resampling, which trying motions
//! would give too, at a higher cost.

use super::four_frames::FourFrames;
use crate::raster::Image;

/// Maximum excess of an outer frame's difference in a static block, in the mean over the block, as a fraction
/// of [`crate::interpolation::RefineOptions::outer_slack`]. Larger: slow motion is blurred; smaller: noise
/// is taken for motion, which costs time.
const STATIC_EXCESS: f32 = 0.25;

/// Whether the frames before and after show these pixels (indices, row by row) as the middle ones do:
/// each pixel so that the outer frames have full weight, and all together but for noise.
///
/// `outer_costs` and `costs` are the differences per pixel of the outer and of the middle frames; `slack` is
/// [`crate::interpolation::RefineOptions::outer_slack`].
pub(super) fn is_static<I: Iterator<Item = usize>>(
    outer_costs: &[Option<Vec<f32>>; 2],
    costs: &[f32],
    slack: f32,
    pixels: impl Fn() -> I,
) -> bool {
    outer_costs.iter().flatten().all(|outer| {
        let (mut sum, mut count) = (0.0, 0.0);
        for k in pixels() {
            let excess = outer[k] - costs[k];
            if excess > slack {
                return false;
            }
            (sum, count) = (sum + excess.max(0.0), count + 1.0);
        }
        sum <= STATIC_EXCESS * slack * count
    })
}

/// The mean of the cross-faded middle frames and the outer frames at these pixels, black where there is
/// no pixel. `outer_weight` is the outer frames' relative to the middle ones'.
pub(super) fn average(
    frames: &FourFrames,
    cross_faded: &Image,
    outer_weight: f32,
    pixels: impl Iterator<Item = Option<(usize, usize)>>,
) -> Vec<f32> {
    let weight = 0.25 * outer_weight;
    let outer = [frames.before, frames.after];
    let mut colors = Vec::new();
    for pixel in pixels {
        let start = colors.len();
        let Some((x, y)) = pixel else {
            colors.resize(start + cross_faded.channels(), 0.0);
            continue;
        };
        let middle = cross_faded.pixel(x, y);
        colors.extend_from_slice(middle);
        for image in outer.into_iter().flatten() {
            let outer = image.pixel(x, y).iter().zip(middle);
            for (color, (outer, middle)) in colors[start..].iter_mut().zip(outer) {
                *color += weight * (outer - middle);
            }
        }
    }
    colors
}
