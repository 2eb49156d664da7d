//! Matching cost of a surface element: how well the element agrees with the frames of all cameras, each at its own
//! time.

use super::element::Element;
use super::frame::{MatchingImage, MatchingSample, PyramidFrame, WEIGHTS};
use super::geometry::Projection;
use super::patch::Patch;
use super::timing::TimeBetween;
use crate::simd::{F32x8, LANES, multiversion};

/// Maximum absolute difference in each channel between two [`MatchingSample`]s. Larger differences, which occlusions
/// cause, are truncated.
const TRUNCATION: MatchingSample = [0.12, 0.084, 0.084, 0.084];
/// Brightness residual at which a pixel's weight in a Gauss–Newton step falls to one half.
const RESIDUAL: f32 = 0.05;
/// Fraction of the observing frames whose costs are averaged. The frames with the smallest costs are used. In the
/// others, the surface element may be occluded.
const BEST_FRACTION: f32 = 0.55;
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
/// Maximum number of observing frames for each matched frame.
pub const MAX_OBSERVATIONS: usize = 16;

/// Another frame, in which surface elements of the matched frame are observed.
pub struct ObservingFrame<'a> {
    /// Time from a pixel of the matched frame to a pixel of this frame.
    pub time: TimeBetween,
    pub projection: Projection,
    pub levels: &'a [MatchingImage],
    truncation: MatchingSample,
}

impl<'a> ObservingFrame<'a> {
    /// Creates the observing frame `by` for the matched frame `of`. `None` if the intrinsic matrix of `of` is
    /// singular.
    pub fn new(of: PyramidFrame, by: PyramidFrame<'a>) -> Option<Self> {
        let mut truncation = TRUNCATION;
        if !(of.frame.is_color && by.frame.is_color) {
            truncation[1] = 0.0;
        }
        Some(Self {
            time: TimeBetween::new(of.frame, by.frame),
            projection: Projection::new(&of.frame.view, &by.frame.view)?,
            levels: by.levels,
            truncation,
        })
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
    pub observations: &'a [ObservingFrame<'a>],
    pub level: usize,
    /// Side of a pixel of the pyramid level, in pixels of the full-resolution image.
    pub scale: f32,
    /// Disparity of a point at a depth of 1 m, pixels, at a baseline of twice the distance between neighbouring
    /// cameras. It is the factor from an inverse depth, 1/m, to a disparity.
    pub disparity_px: f32,
}

/// Position of a patch in an observing frame, in pixels of the pyramid level; (0, 0) is the centre of the first
/// pixel. `right` and `down` are the changes of this position for a step of one pixel of the level to the right, and
/// down, in the matched frame.
struct Footprint {
    center: [f32; 2],
    right: [f32; 2],
    down: [f32; 2],
}

/// A surface element at a position `(x, y)` of the matched frame, in pixels of the full-resolution image.
struct PlacedElement<'a> {
    matcher: &'a PatchMatcher<'a>,
    element: &'a Element,
    x: f32,
    y: f32,
}

impl PlacedElement<'_> {
    #[inline(always)]
    fn footprint(&self, o: &ObservingFrame) -> Footprint {
        let s = self.matcher.scale;
        let inverse = 1.0 / s; // a power of two
        let center = self.place(o, 0.0, 0.0, inverse);
        let [right, down] = [self.place(o, s, 0.0, inverse), self.place(o, 0.0, s, inverse)];
        Footprint {
            center,
            right: [right[0] - center[0], right[1] - center[1]],
            down: [down[0] - center[0], down[1] - center[1]],
        }
    }

    #[inline(always)]
    fn place(&self, o: &ObservingFrame, dx: f32, dy: f32, inverse: f32) -> [f32; 2] {
        let (x, y) = (self.x + dx, self.y + dy);
        let element = self.element.at(dx, dy);
        let dt = o.time.of_element(&element, (x, y), &o.projection);
        let [mx, my, q] = element.moved(x, y, dt);
        let [u, v, _] = o.projection.project(mx, my, q);
        [u * inverse - 0.5, v * inverse - 0.5]
    }
}

/// Matching costs of a surface element in the observing frames evaluated so far, ascending.
struct SortedCosts {
    sorted: [f32; MAX_OBSERVATIONS],
    count: usize,
    /// Number of observing frames evaluated so far whose image contains the surface element.
    inside: usize,
}

impl SortedCosts {
    #[inline(always)]
    fn add(&mut self, cost: f32) {
        let mut j = self.count;
        while j > 0 && self.sorted[j - 1] > cost {
            self.sorted[j] = self.sorted[j - 1];
            j -= 1;
        }
        self.sorted[j] = cost;
        self.count += 1;
        self.inside += usize::from(cost < OUTSIDE);
    }

    /// Returns the mean of the smallest costs among all `n` observing frames, plus the cost [`OUTSIDE_PENALTY`] for
    /// frames with the element outside their image. The costs of such frames are replaced by [`OUTSIDE_COST`]. At the
    /// finest level, all other costs are truncated to this value. Frames that are not evaluated yet are assumed to cost
    /// 0, so that the result is a lower bound.
    #[inline(always)]
    fn mean(&self, n: usize, is_finest: bool) -> f32 {
        let free = n - self.count;
        let inside = self.inside + free;
        let best = ((inside as f32 * BEST_FRACTION).round() as usize).max(MIN_BEST).min(n);
        let mut sum = 0.0;
        let mut k = 0;
        while k + free < best {
            let cost = self.sorted[k];
            // At the finest level, a mismatch costs at most as much as an element outside the image. At coarser
            // levels it may cost more, since finer levels may still improve it.
            let counts = cost < OUTSIDE && !is_finest;
            sum += if counts { cost } else { cost.min(OUTSIDE_COST) };
            k += 1;
        }
        let outside = (n - inside) as f32 / n.max(1) as f32;
        sum / best.max(1) as f32 + OUTSIDE_PENALTY * outside
    }
}

/// Computes the matching cost of a surface element, as [`PatchMatcher::cost`] does.
#[inline(always)]
fn cost<V: F32x8>(placed: &PlacedElement, patch: &Patch, limit: f32, costs: &mut Costs) -> f32 {
    let matcher = placed.matcher;
    let (n, is_finest) = (matcher.observations.len(), matcher.level == 0);
    let mut sorted = SortedCosts { sorted: [0.0; MAX_OBSERVATIONS], count: 0, inside: 0 };
    let mut k = 0;
    while k < n {
        let o = &matcher.observations[k];
        let image = &o.levels[matcher.level];
        let footprint = placed.footprint(o);
        costs[k] = if image.films(footprint.center) {
            differences::<V>(image, &footprint, patch, &o.truncation) * patch.normalization
        } else {
            2.0 * OUTSIDE
        };
        sorted.add(costs[k]);
        k += 1;
        if 2 * k > n && k < n && sorted.mean(n, is_finest) > limit {
            return f32::INFINITY;
        }
    }
    sorted.mean(n, is_finest)
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
    let truncation = V::from_array(&eight(&[*truncation, *truncation], 0));
    let mut sum = V::zero();
    for first in (0..patch.count).step_by(LANES) {
        let places = footprint.places::<V>(image, patch, first);
        for l in (0..LANES.min(patch.count - first)).step_by(2) {
            let sampled = places.two_samples(image, l);
            let own = V::from_array(&eight(&patch.samples, first + l));
            let weights = V::from_array(&eight(&patch.weights, first + l));
            sum = sum + (sampled - own).abs().simd_min(truncation) * weights;
        }
    }
    sum.sum() as f32
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
        let mut sampled = [[0.0f32; LANES]; 4];
        for l in (0..LANES.min(patch.count - first)).step_by(2) {
            let two = places.two_samples(image, l).to_array();
            for c in 0..4 {
                (sampled[c][l], sampled[c][l + 1]) = (two[c], two[4 + c]);
            }
        }
        let mut own = [[0.0f32; LANES]; 4];
        for (l, sample) in patch.samples[first..first + LANES].iter().enumerate() {
            for (channel, value) in own.iter_mut().zip(sample) {
                channel[l] = *value;
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

/// Positions of eight pixels of a patch in an image. `u` and `v` are the positions. `columns`, `rows`, `fx` and `fy`
/// are their integer and fractional parts after clamping to the image.
struct Places<V> {
    u: V,
    v: V,
    columns: [i32; LANES],
    rows: [i32; LANES],
    fx: [f32; LANES],
    fy: [f32; LANES],
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
        let (columns, fx) = u.simd_max(V::zero()).simd_min(V::splat(max_u)).floor_and_fraction();
        let (rows, fy) = v.simd_max(V::zero()).simd_min(V::splat(max_v)).floor_and_fraction();
        Places { u, v, columns, rows, fx: fx.to_array(), fy: fy.to_array() }
    }
}

impl<V: F32x8> Places<V> {
    /// Returns the bilinear samples of an image at the positions `l` and `l + 1`, four channels each.
    #[inline(always)]
    fn two_samples(&self, image: &MatchingImage, l: usize) -> V {
        let Self { columns, rows, fx, fy, .. } = self;
        let a = between_rows::<V>(image, [columns[l], rows[l]], fy[l]);
        let b = between_rows::<V>(image, [columns[l + 1], rows[l + 1]], fy[l + 1]);
        let left = V::from_array(&[a[0], a[1], a[2], a[3], b[0], b[1], b[2], b[3]]);
        let right = V::from_array(&[a[4], a[5], a[6], a[7], b[4], b[5], b[6], b[7]]);
        let (fa, fb) = (fx[l], fx[l + 1]);
        let fraction = V::from_array(&[fa, fa, fa, fa, fb, fb, fb, fb]);
        left + (right - left) * fraction
    }
}

/// Returns the samples of pixel `(x, y)` and of its right neighbour, four channels each. They are interpolated by
/// `fraction` towards the row below.
#[inline(always)]
fn between_rows<V: F32x8>(image: &MatchingImage, [x, y]: [i32; 2], fraction: f32) -> [f32; LANES] {
    let [upper, lower] = image.quad(x as usize, y as usize);
    let (upper, lower) = (V::from_array(&eight(upper, 0)), V::from_array(&eight(lower, 0)));
    (upper + (lower - upper) * V::splat(fraction)).to_array()
}

/// Returns eight channels: the four of the sample `first`, then the four of the next sample.
#[inline(always)]
fn eight(samples: &[MatchingSample], first: usize) -> [f32; LANES] {
    let [a, b] = [samples[first], samples[first + 1]];
    [a[0], a[1], a[2], a[3], b[0], b[1], b[2], b[3]]
}

multiversion! {
    fn cost_below(placed: &PlacedElement, patch: &Patch, limit: f32, costs: &mut Costs) -> f32 = cost::<V>
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
        cost_below(&self.placed(e, x, y), patch, limit, costs)
    }

    /// Returns the fraction of the observing frames that show static background at the surface element's projection.
    /// Frames with the projection outside their image are not counted.
    #[inline(always)]
    pub fn still_fraction(&self, e: &Element, (x, y): (usize, usize)) -> f32 {
        let (mut still, mut inside) = (0u32, 0u32);
        let placed = self.placed(e, x, y);
        for o in self.observations {
            let image = &o.levels[self.level];
            let [u, v] = placed.place(o, 0.0, 0.0, 1.0 / self.scale).map(|c| c + 0.5);
            let is_inside =
                u >= 0.0 && v >= 0.0 && u < image.width as f32 && v < image.height as f32;
            if is_inside && image.films_pixel(u as usize, v as usize) {
                inside += 1;
                still += u32::from(image.is_still(u as usize, v as usize) == Some(true));
            }
        }
        still as f32 / inside.max(1) as f32
    }

    #[inline(always)]
    fn placed<'a>(&'a self, e: &'a Element, x: usize, y: usize) -> PlacedElement<'a> {
        let s = self.scale;
        PlacedElement {
            matcher: self,
            element: e,
            x: (x as f32 + 0.5) * s,
            y: (y as f32 + 0.5) * s,
        }
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
        for (o, _) in self.observations.iter().zip(costs).filter(|(_, c)| **c <= max_cost) {
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
