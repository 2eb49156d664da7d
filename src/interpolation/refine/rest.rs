//! Blocks in which nothing moves: the mean of all frames as they are, which trying motions comes to too,
//! but for what it resamples.

use super::block::Work;
use super::outer_weight;

/// What stands still may differ in an outer frame from the middle ones by this share of
/// [`super::RefineOptions::outer_slack`] more than they do from each other, in the mean of a block.
/// Larger: slow motion blurs; smaller: noise is taken for motion, which costs time.
const AT_REST: f32 = 0.25;

impl Work<'_> {
    /// Whether the frames before and after show these pixels as the middle ones do: each so that they
    /// count in full, and all together but for noise.
    pub(super) fn is_at_rest<I: Iterator<Item = (usize, usize)>>(
        &self,
        pixels: impl Fn() -> I,
    ) -> bool {
        let slack = self.options.outer_slack;
        self.outer_costs.iter().flatten().all(|costs| {
            let (mut sum, mut count) = (0.0, 0.0);
            for (x, y) in pixels() {
                let k = y * self.dissolved.width() + x;
                let excess = costs[k] - self.costs[k];
                if excess > slack {
                    return false;
                }
                (sum, count) = (sum + excess.max(0.0), count + 1.0);
            }
            sum <= AT_REST * slack * count
        })
    }

    /// All frames' mean of these pixels; black where there is none.
    pub(super) fn averaged(
        &self,
        pixels: impl Iterator<Item = Option<(usize, usize)>>,
    ) -> Vec<f32> {
        let weight = 0.25 * outer_weight(self.frames, self.options);
        let outer = [self.frames.before, self.frames.after];
        let mut colors = Vec::new();
        for at in pixels {
            let start = colors.len();
            let Some((x, y)) = at else {
                colors.resize(start + self.dissolved.channels(), 0.0);
                continue;
            };
            let middle = self.dissolved.pixel(x, y);
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
}
