//! Matching cost of a surface element: how well the element agrees with the frames of all cameras, each at its own
//! time.

use super::element::Element;
use super::footprint::{Footprint, PlacedElement, ProjectionLanes};
use super::matching_image::{MatchingImage, MatchingSample, UNITS, WEIGHTS, dequantized};
use super::observing_frame::ObservingFrame;
use super::patch::{Patch, WEIGHT_UNITS};
use super::silhouette::Shown;
use crate::simd::{F32x8, I16x16, LANES, PIXELS, multiversion};

/// Brightness residual at which a pixel's weight in a Gauss–Newton step falls to one half.
const RESIDUAL: f32 = 0.05;
/// Fraction of the observing frames whose costs are averaged: numerator and denominator. The frames with the smallest
/// costs are used. In the others, the surface element may be occluded.
const BEST_FRACTION: [usize; 2] = [11, 20];
/// Minimum number of observing frames whose costs are averaged.
const MIN_BEST: usize = 3;
/// Matching cost in an observing frame that separates two cases. If the surface element is inside the frame's image,
/// the cost is smaller. If it is outside, the cost is set to a larger value.
const OUTSIDE: f32 = 1.0;
/// Cost with which an observing frame enters the averaged costs if the surface element is outside its image. The value
/// lies between the cost of a match and the cost of a mismatch.
const OUTSIDE_COST: f32 = 0.19;
/// Cost that is added for a surface element outside the images of all observing frames. If the element is outside
/// some of the images, the same fraction of this cost is added.
const OUTSIDE_PENALTY: f32 = 0.02;
/// Frames of the same time are averaged apart if they are more than one in this many. Larger: fewer frames decide on motion
/// where shutters are spread. Smaller: synchronized cameras say little of motion.
const ONE_IN: usize = 3;
/// Maximum number of observing frames for each matched frame.
pub const MAX_OBSERVATIONS: usize = 16;

/// The frames with which a frame is matched. Frames of the same time match whatever the motion is. If many are such, their
/// costs are averaged apart from those of the others, so that the motion counts.
pub struct Observations<'a> {
    pub frames: Vec<ObservingFrame<'a>>,
    /// Their projections. Empty if a shutter is rolling.
    lanes: Vec<ProjectionLanes>,
    /// Number of frames, from the first on, that are averaged apart from the others.
    apart: usize,
}

impl<'a> Observations<'a> {
    /// Takes the first [`MAX_OBSERVATIONS`] of these frames.
    pub fn new(frames: impl IntoIterator<Item = ObservingFrame<'a>>) -> Self {
        let mut frames: Vec<_> = frames.into_iter().take(MAX_OBSERVATIONS).collect();
        let mut apart = frames.iter().filter(|o| o.is_simultaneous()).count();
        if ONE_IN * apart > frames.len() {
            frames.sort_by_key(|o| !o.is_simultaneous());
        } else {
            apart = 0;
        }
        let lanes = ProjectionLanes::all(&frames);
        Self { frames, lanes, apart }
    }
}

/// Matching cost of a surface element in each observing frame.
pub type Costs = [f32; MAX_OBSERVATIONS];

/// A surface element at a pixel of the pyramid level, with its patch and matching costs.
pub struct MatchedElement<'a> {
    pub element: &'a Element,
    pub pixel: (usize, usize),
    pub patch: &'a Patch,
    /// Matching cost in each observing frame. [`Self::cost`] combines these costs.
    pub costs: &'a Costs,
    pub cost: f32,
}

/// Matches one frame with its observing frames at one pyramid level.
pub struct PatchMatcher<'a> {
    pub own: &'a MatchingImage,
    pub observations: &'a Observations<'a>,
    pub level: usize,
    /// Side of a pixel of the pyramid level, in pixels of the full-resolution image.
    pub scale: f32,
    /// Disparity of a point at a depth of 1 m, pixels, at a baseline of twice the distance between neighbouring
    /// cameras. It is the factor from an inverse depth, 1/m, to a disparity.
    pub disparity_px: f32,
}

/// Matching costs of a surface element in those of `all` observing frames that are evaluated so far, ascending.
struct SortedCosts {
    all: usize,
    /// The costs, then infinity.
    sorted: [f32; MAX_OBSERVATIONS],
    count: usize,
    /// Number of observing frames evaluated so far whose image contains the surface element.
    inside: usize,
}

impl SortedCosts {
    #[inline(always)]
    fn none_of(all: usize) -> Self {
        Self { all, sorted: [f32::INFINITY; MAX_OBSERVATIONS], count: 0, inside: 0 }
    }

    #[inline(always)]
    fn add(&mut self, cost: f32) {
        // Larger entries move up by one, and the cost takes the place below them. A loop that ends at this place is
        // slower, since its end can't be predicted.
        let before = self.sorted;
        self.sorted[0] = if before[0] < cost { before[0] } else { cost };
        for k in 1..MAX_OBSERVATIONS {
            let smaller = if before[k] < cost { before[k] } else { cost };
            self.sorted[k] = if before[k - 1] > smaller { before[k - 1] } else { smaller };
        }
        self.count += 1;
        self.inside += usize::from(cost < OUTSIDE);
    }

    /// Returns the number of smallest costs that are averaged, by the number of images with the element inside.
    #[inline(always)]
    fn averaged(&self, inside: usize) -> usize {
        let [numerator, denominator] = BEST_FRACTION;
        let rounded = (numerator * inside + denominator / 2) / denominator;
        rounded.max(MIN_BEST).min(self.all)
    }

    /// Returns the sum of the smallest costs, their number, and the number of frames with the element outside their image.
    /// The costs of such frames are replaced by [`OUTSIDE_COST`]. At the finest level, all other costs are truncated to
    /// this value. Frames that are not evaluated yet are assumed to cost 0, so that the sum is a lower bound.
    #[inline(always)]
    fn smallest(&self, is_finest: bool) -> (f32, usize, usize) {
        let free = self.all - self.count;
        let inside = self.inside + free;
        let best = self.averaged(inside);
        // At the finest level, a mismatch costs at most as much as an element outside the image. At coarser levels it
        // may cost more, since finer levels may still improve it.
        let most = if is_finest { OUTSIDE_COST } else { OUTSIDE };
        let mut sum = 0.0;
        let mut k = 0;
        while k + free < best {
            let cost = self.sorted[k];
            sum += if cost < most { cost } else { OUTSIDE_COST };
            k += 1;
        }
        (sum, best, self.all - inside)
    }
}

/// Returns the mean of the smallest costs of two groups of observing frames, plus the cost [`OUTSIDE_PENALTY`] for frames
/// with the element outside their image.
#[inline(always)]
fn mean(groups: &[SortedCosts; 2], is_finest: bool) -> f32 {
    let [(a, best_a, outside_a), (b, best_b, outside_b)] =
        [groups[0].smallest(is_finest), groups[1].smallest(is_finest)];
    let n = groups[0].all + groups[1].all;
    let outside = (outside_a + outside_b) as f32 / n.max(1) as f32;
    (a + b) / (best_a + best_b).max(1) as f32 + OUTSIDE_PENALTY * outside
}

/// Computes the matching cost of a surface element, as [`PatchMatcher::cost`] does.
#[inline(always)]
fn cost<V: F32x8>(
    matcher: &PatchMatcher,
    placed: &PlacedElement,
    patch: &Patch,
    limit: f32,
    costs: &mut Costs,
) -> f32 {
    let Observations { frames, lanes, apart } = matcher.observations;
    let (n, is_finest) = (frames.len(), matcher.level == 0);
    let mut groups = [SortedCosts::none_of(*apart), SortedCosts::none_of(n - apart)];
    let mut footprints = None;
    let mut k = 0;
    while k < n {
        let o = &frames[k];
        let image = &o.levels[matcher.level];
        if k % LANES == 0 && !lanes.is_empty() {
            footprints = Some(lanes[k / LANES].footprints::<V>(placed));
        }
        let footprint = match &footprints {
            Some(eight) => eight.lane(k % LANES),
            None => placed.footprint(o),
        };
        costs[k] = if image.films(footprint.center) {
            differences::<V>(image, &footprint, patch, &o.truncation) * patch.normalization
        } else {
            2.0 * OUTSIDE
        };
        groups[usize::from(k >= *apart)].add(costs[k]);
        k += 1;
        if 2 * k > n && k < n && mean(&groups, is_finest) > limit {
            return f32::INFINITY;
        }
    }
    mean(&groups, is_finest)
}

/// Returns the weighted sum of truncated absolute differences between a patch's samples and an image sampled at the
/// patch's footprint. Positions outside the image are clamped to its border.
#[inline(always)]
fn differences<V: F32x8>(
    image: &MatchingImage,
    footprint: &Footprint,
    patch: &Patch,
    truncation: &MatchingSample,
) -> f32 {
    let truncation = V::Integers::load(&[*truncation; PIXELS]);
    let mut sums = V::Integers::no_sums();
    for first in (0..patch.count).step_by(LANES) {
        let places = footprint.places::<V>(image, patch, first);
        let own = V::Integers::load(&patch.samples[first..]);
        let weights = V::Integers::load(&patch.weights[first..]);
        sums = places.samples::<0>(image).add_difference(own, truncation, weights, sums);
        let second = first + PIXELS;
        if second < patch.count {
            let own = V::Integers::load(&patch.samples[second..]);
            let weights = V::Integers::load(&patch.weights[second..]);
            let sampled = places.samples::<PIXELS>(image);
            sums = sampled.add_difference(own, truncation, weights, sums);
        }
    }
    // A pixel adds at most the sum of the truncations, 3,050, times its weight. All weights are at most 16 together, so
    // that the sum is at most 8e8, and 32 bits hold it.
    V::Integers::total(sums) as f32 * (1.0 / (UNITS * WEIGHT_UNITS))
}

/// Returns sums over the patch for the normal equations: of the products of image gradients, `xx`, `xy`, `yy`, and of
/// gradient times brightness residual, `x`, `y`. Positions outside the image have weight 0.
#[inline(always)]
fn gradient_sums<V: F32x8>(
    image: &MatchingImage,
    footprint: &Footprint,
    patch: &Patch,
) -> [f32; 5] {
    let mut sums = [V::zero(); 5];
    let [max_u, max_v] = image.limit();
    let [max_u, max_v] = [V::splat(max_u), V::splat(max_v)];
    let [half_x, half_y] = [V::splat(0.5 / WEIGHTS[2]), V::splat(0.5 / WEIGHTS[3])];
    let (zero, one) = (V::zero(), V::splat(1.0));
    let narrowing = V::splat(1.0 / (WEIGHTS[0] * RESIDUAL));
    for first in (0..patch.count).step_by(LANES) {
        let places = footprint.places::<V>(image, patch, first);
        // One array for each channel.
        let [mut sampled, mut own] = [[[0.0f32; LANES]; 4]; 2];
        let halves = [places.samples::<0>(image), places.samples::<PIXELS>(image)];
        for (k, half) in halves.into_iter().enumerate() {
            for (l, sample) in half.to_pixels().iter().enumerate() {
                for (channel, value) in sampled.iter_mut().zip(dequantized(sample)) {
                    channel[PIXELS * k + l] = value;
                }
            }
        }
        for (l, sample) in patch.samples[first..first + LANES].iter().enumerate() {
            for (channel, value) in own.iter_mut().zip(dequantized(sample)) {
                channel[l] = value;
            }
        }
        let weight = V::load(&patch.weight, first);
        let weight = zero.if_below(places.u, weight, zero);
        let weight = zero.if_below(places.v, weight, zero);
        let weight = places.u.if_below(max_u, weight, zero);
        let weight = places.v.if_below(max_v, weight, zero);
        let residual = V::from_array(&sampled[0]) - V::from_array(&own[0]);
        let gx = (V::from_array(&sampled[2]) + V::from_array(&own[2])) * half_x;
        let gy = (V::from_array(&sampled[3]) + V::from_array(&own[3])) * half_y;
        let relative = residual * narrowing;
        let weight = weight / (one + relative * relative);
        let (wx, wy) = (weight * gx, weight * gy);
        sums[0] = sums[0] + wx * gx;
        sums[1] = sums[1] + wx * gy;
        sums[2] = sums[2] + wy * gy;
        sums[3] = sums[3] + wx * residual;
        sums[4] = sums[4] + wy * residual;
    }
    let sums = V::sums(&sums);
    let by = 1.0 / WEIGHTS[0];
    [sums[0] as f32, sums[1] as f32, sums[2] as f32, sums[3] as f32 * by, sums[4] as f32 * by]
}

/// Positions of eight pixels of a patch in an image. `u` and `v` are the positions. The others are these after clamping
/// to the image: the indices of the pixels at the top left of the positions, and the fractions of a pixel from there.
struct Places<V: F32x8> {
    u: V,
    v: V,
    corners: [u32; LANES],
    right: <V::Integers as I16x16>::Fractions,
    down: <V::Integers as I16x16>::Fractions,
}

impl Footprint {
    /// Returns the positions of eight pixels of a patch in an image, from the patch's pixel `first` on.
    #[inline(always)]
    fn places<V: F32x8>(&self, image: &MatchingImage, patch: &Patch, first: usize) -> Places<V> {
        let [max_u, max_v] = image.limit();
        let dx = V::load(&patch.offset_x, first);
        let dy = V::load(&patch.offset_y, first);
        let u =
            V::splat(self.center[0]) + dx * V::splat(self.right[0]) + dy * V::splat(self.down[0]);
        let v =
            V::splat(self.center[1]) + dx * V::splat(self.right[1]) + dy * V::splat(self.down[1]);
        let (columns, right) = u.simd_max(V::zero()).simd_min(V::splat(max_u)).floor_and_fraction();
        let (rows, down) = v.simd_max(V::zero()).simd_min(V::splat(max_v)).floor_and_fraction();
        // Positions were clamped already; this makes the indices safe whatever they were.
        let last = image.last_corner();
        let mut corners = [0; LANES];
        for l in 0..LANES {
            let row = (rows[l] as u32).wrapping_mul(image.width as u32);
            corners[l] = row.wrapping_add(columns[l] as u32).min(last);
        }
        // Not by `map`, whose closure wouldn't be compiled for this instruction set.
        let (right, down) = (V::Integers::fractions(right), V::Integers::fractions(down));
        Places { u, v, corners, right, down }
    }
}

impl<V: F32x8> Places<V> {
    /// Returns the bilinear samples of an image at four of the positions: from `FIRST` on, which is 0 or 4.
    #[inline(always)]
    fn samples<const FIRST: usize>(&self, image: &MatchingImage) -> V::Integers {
        let Self { corners, right, down, .. } = self;
        // SAFETY: no corner is after `last_corner` of this image, which is `width + 1` before its last pixel.
        unsafe {
            V::Integers::bilinear::<FIRST>(image.samples(), image.width, corners, *right, *down)
        }
    }
}

multiversion! {
    fn cost_below(
        matcher: &PatchMatcher,
        placed: &PlacedElement,
        patch: &Patch,
        limit: f32,
        costs: &mut Costs,
    ) -> f32 = cost::<V>
}

multiversion! {
    fn patch_gradients(image: &MatchingImage, footprint: &Footprint, patch: &Patch) -> [f32; 5] = gradient_sums::<V>
}

impl PatchMatcher<'_> {
    /// Fills `patch` with the pixels around pixel `(x, y)` of the pyramid level.
    #[inline]
    pub fn fill_patch(&self, x: usize, y: usize, patch: &mut Patch) {
        patch.fill(self.own, (x, y), self.level == 0);
    }

    /// Returns the matching cost of a surface element at pixel `(x, y)` of the pyramid level: the mean of the
    /// smallest costs in the observing frames. Fills `costs` with the cost in each observing frame. Returns infinity
    /// as soon as the mean is certain to exceed `limit`.
    #[inline(always)]
    pub fn cost(
        &self,
        e: &Element,
        (x, y): (usize, usize),
        patch: &Patch,
        limit: f32,
        costs: &mut Costs,
    ) -> f32 {
        cost_below(self, &self.placed(e, x, y), patch, limit, costs)
    }

    /// Returns the fraction of the observing frames that show static background at the surface element's projection.
    /// Frames with the projection outside their image are not counted.
    #[inline(always)]
    pub fn background_fraction(&self, e: &Element, (x, y): (usize, usize)) -> f32 {
        let (mut background, mut inside) = (0u32, 0u32);
        let placed = self.placed(e, x, y);
        for o in &self.observations.frames {
            let image = &o.levels[self.level];
            let [u, v] = placed.position(o, 0.0, 0.0).map(|c| c + 0.5);
            let is_inside =
                u >= 0.0 && v >= 0.0 && u < image.width as f32 && v < image.height as f32;
            if is_inside && image.films_pixel(u as usize, v as usize) {
                inside += 1;
                let shown = image.shown(u as usize, v as usize);
                background += u32::from(shown == Shown::Background);
            }
        }
        background as f32 / inside.max(1) as f32
    }

    #[inline(always)]
    fn placed<'a>(&'a self, e: &'a Element, x: usize, y: usize) -> PlacedElement<'a> {
        let s = self.scale;
        PlacedElement { element: e, x: (x as f32 + 0.5) * s, y: (y as f32 + 0.5) * s, scale: s }
    }

    /// Calls `f` for every observing frame whose matching cost is at most `max_cost`, with the frame's terms of the
    /// normal equations. The terms are sums over the patch: of products of image gradients, `[xx, xy, yy]`, and of
    /// gradient times brightness residual, `[x, y]`. Gradients are per pixel of the pyramid level.
    pub fn for_each_gradient(
        &self,
        matched: &MatchedElement,
        max_cost: f32,
        mut f: impl FnMut(&ObservingFrame, [f32; 3], [f32; 2]),
    ) {
        let &MatchedElement { element, pixel: (x, y), patch, costs, .. } = matched;
        for (o, _) in self.observations.frames.iter().zip(costs).filter(|(_, c)| **c <= max_cost) {
            let image = &o.levels[self.level];
            let footprint = self.placed(element, x, y).footprint(o);
            let [xx, xy, yy, x, y] = patch_gradients(image, &footprint, patch);
            f(o, [xx, xy, yy], [x, y]);
        }
    }

    /// Returns a distance between two surface elements at one pixel, in pixels of the pyramid level: a weighted sum
    /// of the differences in disparity, velocity, rate of disparity and acceleration.
    #[inline(always)]
    pub fn distance(&self, a: &Element, b: &Element) -> f32 {
        let change = |a: [f32; 2], b: [f32; 2]| (a[0] - b[0]).abs() + (a[1] - b[1]).abs();
        ((a.inverse_depth - b.inverse_depth).abs() * self.disparity_px
            + 0.5 * change(a.velocity, b.velocity)
            + 0.5 * (a.inverse_depth_rate - b.inverse_depth_rate).abs() * self.disparity_px
            + 0.1 * change(a.acceleration, b.acceleration))
            / self.scale
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::Random;

    #[test]
    fn costs_are_sorted_whatever_their_order() {
        let mut random = Random::new(3);
        for count in 0..=MAX_OBSERVATIONS {
            // A few values, so that some are equal.
            let costs: Vec<f32> =
                (0..count).map(|_| (random.unit() * 6.0).floor() as f32).collect();
            let mut found = SortedCosts::none_of(MAX_OBSERVATIONS);
            costs.iter().for_each(|cost| found.add(*cost));
            let mut expected = costs;
            expected.sort_by(f32::total_cmp);
            expected.resize(MAX_OBSERVATIONS, f32::INFINITY);
            assert_eq!(found.sorted.as_slice(), expected);
        }
    }

    #[test]
    fn more_than_half_of_the_costs_are_averaged() {
        let averaged = |all: usize| SortedCosts::none_of(all).averaged(all);
        let expected = [0, 1, 2, 3, 3, 3, 3, 4, 4, 5, 6, 6, 7, 7, 8, 8, 9];
        assert_eq!(std::array::from_fn(averaged), expected);
    }

    #[test]
    fn mismatches_cost_as_much_as_what_is_outside_and_only_at_the_finest_level() {
        let mut costs = SortedCosts::none_of(8);
        [0.5, 0.01, 2.0 * OUTSIDE, 0.02].into_iter().for_each(|cost| costs.add(cost));
        // Seven frames may see the element, of whose costs four are averaged; four are assumed to be 0.
        assert_eq!(costs.smallest(true), (0.0, 4, 1));
        for _ in 0..4 {
            costs.add(2.0 * OUTSIDE);
        }
        let [finest, coarser] = [true, false].map(|is_finest| costs.smallest(is_finest));
        assert_eq!((finest.1, finest.2, coarser.1, coarser.2), (3, 5, 3, 5));
        assert!((finest.0 - (0.03 + OUTSIDE_COST)).abs() < 1e-6);
        assert!((coarser.0 - 0.53).abs() < 1e-6);
    }
}
