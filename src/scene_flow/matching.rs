//! How well the frames of all cameras, each at its own time, agree on a surface element.

use super::element::Element;
use super::frame::{FlowFrame, MatchingImage, MatchingSample, WEIGHTS};
use super::geometry::Projection;
use crate::simd::{F32x8, LANES, multiversion};

/// Largest difference of a channel that counts: what differs more is something else.
const TRUNCATION: MatchingSample = [0.12, 0.084, 0.084, 0.084];
/// Difference of a pixel's colour from that of the patch's centre at which its weight falls to 1/e.
const PATCH_COLOR: f32 = 0.08;
/// Half-width of a patch at the finest level, and the step between its pixels; pixels.
const PATCH_FINEST: (i32, i32) = (4, 2);
/// Half-width of a patch at all other levels, and the step between its pixels; pixels of the level.
const PATCH_COARSE: (i32, i32) = (2, 1);
/// Residual of brightness at which a pixel of a patch counts half in a Gauss–Newton step.
const RESIDUAL: f32 = 0.05;
/// Largest number of pixels of a patch.
const PATCH_PIXELS: usize = 25;
/// Length of a patch's arrays: a multiple of the vectors' length.
const PADDED_PIXELS: usize = PATCH_PIXELS.next_multiple_of(LANES);
/// Fraction of the observing frames whose costs count, the smallest ones: the element may be occluded in the others.
const BEST_FRACTION: f32 = 0.55;
/// Minimum number of observing frames whose costs count.
const MIN_BEST: usize = 3;
/// A cost above that of every element inside an image, which marks elements outside.
const OUTSIDE: f32 = 1.0;
/// Cost of a frame in which the element is outside the image, where it counts: between a match and a mismatch.
const OUTSIDE_COST: f32 = 0.19;
/// Cost of an element that is outside all images. Elements that are outside some of them cost a part of it.
const OUTSIDE_PENALTY: f32 = 0.02;
/// Maximum number of frames that a frame is matched with.
pub const MAX_OBSERVATIONS: usize = 16;

/// A frame that may see what another frame sees.
pub struct ObservingFrame<'a> {
    /// Frames of the reference camera after the frame that is matched.
    pub dt: f32,
    pub projection: Projection,
    pub levels: &'a [MatchingImage],
    truncation: MatchingSample,
}

impl<'a> ObservingFrame<'a> {
    /// `None` if a camera has no inverse.
    pub fn new(of: &FlowFrame, by: &'a FlowFrame) -> Option<Self> {
        let mut truncation = TRUNCATION;
        if !(of.is_color && by.is_color) {
            truncation[1] = 0.0;
        }
        Some(Self {
            dt: (by.time - of.time) as f32,
            projection: Projection::new(&of.view, &by.view)?,
            levels: &by.levels,
            truncation,
        })
    }
}

/// The pixels around a pixel that are likely on its surface. Beyond `count`, weights are 0.
pub struct Patch {
    offset_x: [f32; PADDED_PIXELS],
    offset_y: [f32; PADDED_PIXELS],
    samples: [MatchingSample; PADDED_PIXELS],
    /// Each pixel's weight, once a channel.
    weights: [MatchingSample; PADDED_PIXELS],
    count: usize,
    /// One over the sum of all weights.
    normalization: f32,
}

impl Patch {
    pub fn empty() -> Self {
        Self {
            offset_x: [0.0; PADDED_PIXELS],
            offset_y: [0.0; PADDED_PIXELS],
            samples: [[0.0; 4]; PADDED_PIXELS],
            weights: [[0.0; 4]; PADDED_PIXELS],
            count: 0,
            normalization: 0.0,
        }
    }

    /// Sum of all weights.
    pub fn weight(&self) -> f32 {
        1.0 / self.normalization
    }
}

/// One cost an observation.
pub type Costs = [f32; MAX_OBSERVATIONS];

/// An element of a pixel, with its match.
pub struct MatchedElement<'a> {
    pub element: &'a Element,
    pub pixel: (usize, usize),
    pub patch: &'a Patch,
    /// The cost by each observation, and by those that count.
    pub costs: &'a Costs,
    pub cost: f32,
}

/// Matches one frame with others, at one level.
pub struct PatchMatcher<'a> {
    pub own: &'a MatchingImage,
    pub observations: &'a [ObservingFrame<'a>],
    pub level: usize,
    /// Pixels of the full image a pixel of the level.
    pub scale: f32,
    /// Pixels of disparity of an inverse depth of 1/m, for two cameras as far apart as the rig's are.
    pub disparity_px: f32,
}

/// The place of a patch in an observation, pixels of the level, from the first pixel's centre: that of its own
/// centre, and its change for a step of a pixel of the level to the right and down.
struct Footprint {
    center: [f32; 2],
    right: [f32; 2],
    down: [f32; 2],
}

impl Footprint {
    #[inline(always)]
    fn at(&self, [dx, dy]: [f32; 2]) -> [f32; 2] {
        [
            self.center[0] + dx * self.right[0] + dy * self.down[0],
            self.center[1] + dx * self.right[1] + dy * self.down[1],
        ]
    }
}

/// Difference of two pixels' brightnesses and colours.
#[inline(always)]
pub fn color_difference(a: &MatchingSample, b: &MatchingSample) -> f32 {
    (a[0] - b[0]).abs() + (a[1] - b[1]).abs()
}

/// Sum of the weighted, truncated differences of a patch's pixels from an image at its footprint there. Places outside
/// of the image are moved to its border.
#[inline(always)]
fn differences<V: F32x8>(
    image: &MatchingImage,
    footprint: &Footprint,
    patch: &Patch,
    truncation: &MatchingSample,
) -> f32 {
    let [max_u, max_v] = image.limit().map(V::splat);
    let [center_u, center_v] = footprint.center.map(V::splat);
    let [right_u, right_v] = footprint.right.map(V::splat);
    let [down_u, down_v] = footprint.down.map(V::splat);
    let truncation = V::from_array(&eight(&[*truncation, *truncation], 0));
    let mut sum = V::zero();
    for first in (0..patch.count).step_by(LANES) {
        let dx = V::from_array(&std::array::from_fn(|l| patch.offset_x[first + l]));
        let dy = V::from_array(&std::array::from_fn(|l| patch.offset_y[first + l]));
        let u = center_u + dx * right_u + dy * down_u;
        let v = center_v + dx * right_v + dy * down_v;
        let (columns, fx) = u.simd_max(V::zero()).simd_min(max_u).floor_and_fraction();
        let (rows, fy) = v.simd_max(V::zero()).simd_min(max_v).floor_and_fraction();
        let (fx, fy) = (fx.to_array(), fy.to_array());
        // Two pixels of four channels at a time.
        for l in (0..LANES.min(patch.count - first)).step_by(2) {
            let a = between_rows::<V>(image, [columns[l], rows[l]], fy[l]);
            let b = between_rows::<V>(image, [columns[l + 1], rows[l + 1]], fy[l + 1]);
            let left = V::from_array(&[a[0], a[1], a[2], a[3], b[0], b[1], b[2], b[3]]);
            let right = V::from_array(&[a[4], a[5], a[6], a[7], b[4], b[5], b[6], b[7]]);
            let (fa, fb) = (fx[l], fx[l + 1]);
            let fraction = V::from_array(&[fa, fa, fa, fa, fb, fb, fb, fb]);
            let sampled = left + (right - left) * fraction;
            let own = V::from_array(&eight(&patch.samples, first + l));
            let weights = V::from_array(&eight(&patch.weights, first + l));
            sum = sum + (sampled - own).abs().simd_min(truncation) * weights;
        }
    }
    sum.sum() as f32
}

/// Two horizontal neighbours, from this pixel on, at a fraction of the way to the row below.
#[inline(always)]
fn between_rows<V: F32x8>(image: &MatchingImage, [x, y]: [i32; 2], fraction: f32) -> [f32; LANES] {
    let [upper, lower] = image.quad(x as usize, y as usize);
    let (upper, lower) = (V::from_array(&eight(upper, 0)), V::from_array(&eight(lower, 0)));
    (upper + (lower - upper) * V::splat(fraction)).to_array()
}

/// Two samples, from the first on.
#[inline(always)]
fn eight(samples: &[MatchingSample], first: usize) -> [f32; LANES] {
    let [a, b] = [samples[first], samples[first + 1]];
    [a[0], a[1], a[2], a[3], b[0], b[1], b[2], b[3]]
}

multiversion! {
    fn patch_difference(
        image: &MatchingImage,
        footprint: &Footprint,
        patch: &Patch,
        truncation: &MatchingSample,
    ) -> f32 = differences::<V>
}

impl PatchMatcher<'_> {
    fn patch_shape(&self) -> (i32, i32) {
        if self.level == 0 { PATCH_FINEST } else { PATCH_COARSE }
    }

    /// The patch around a pixel.
    pub fn fill_patch(&self, x: usize, y: usize, patch: &mut Patch) {
        let (radius, step) = self.patch_shape();
        let (width, height) = (self.own.width as i32, self.own.height as i32);
        let center = self.own.pixel(x, y);
        let (mut count, mut sum) = (0, 0.0);
        for dy in (-radius..=radius).step_by(step as usize) {
            for dx in (-radius..=radius).step_by(step as usize) {
                let (u, v) = (x as i32 + dx, y as i32 + dy);
                if u < 0 || v < 0 || u >= width || v >= height {
                    continue;
                }
                let sample = self.own.pixel(u as usize, v as usize);
                let distance = (dx * dx + dy * dy) as f32 / (radius * radius) as f32;
                let difference = color_difference(&sample, &center) / PATCH_COLOR;
                let weight = (-difference - 0.5 * distance).exp();
                (patch.offset_x[count], patch.offset_y[count]) = (dx as f32, dy as f32);
                (patch.samples[count], patch.weights[count]) = (sample, [weight; 4]);
                count += 1;
                sum += weight;
            }
        }
        patch.weights[count..].fill([0.0; 4]);
        patch.count = count;
        // The centre's weight is 1.
        patch.normalization = 1.0 / sum;
    }

    #[inline(always)]
    fn footprint(&self, o: &ObservingFrame, e: &Element, x: usize, y: usize) -> Footprint {
        let s = self.scale;
        let (cx, cy) = ((x as f32 + 0.5) * s, (y as f32 + 0.5) * s);
        let place = |dx: f32, dy: f32| {
            let [mx, my, q] = e.at(dx, dy).moved(cx + dx, cy + dy, o.dt);
            let [u, v, _] = o.projection.project(mx, my, q);
            [u / s - 0.5, v / s - 0.5]
        };
        let (center, right, down) = (place(0.0, 0.0), place(s, 0.0), place(0.0, s));
        let from_center = |p: [f32; 2]| [p[0] - center[0], p[1] - center[1]];
        Footprint { center, right: from_center(right), down: from_center(down) }
    }

    /// The cost of an element: the mean of those observations that agree best. `costs` gets that of each.
    #[inline(always)]
    pub fn cost(&self, e: &Element, x: usize, y: usize, patch: &Patch, costs: &mut Costs) -> f32 {
        for (o, cost) in self.observations.iter().zip(costs.iter_mut()) {
            let image = &o.levels[self.level];
            let footprint = self.footprint(o, e, x, y);
            let [u, v] = footprint.center;
            let [max_u, max_v] = image.limit();
            if !(u > 0.0 && v > 0.0 && u < max_u && v < max_v) {
                *cost = 2.0 * OUTSIDE;
                continue;
            }
            *cost = patch_difference(image, &footprint, patch, &o.truncation) * patch.normalization;
        }
        self.best(costs)
    }

    /// The mean of the smallest costs: of a fraction of the frames in which the element is inside.
    #[inline(always)]
    fn best(&self, costs: &Costs) -> f32 {
        let n = self.observations.len();
        let inside = costs[..n].iter().filter(|c| **c < OUTSIDE).count();
        let count = ((inside as f32 * BEST_FRACTION).round() as usize).max(MIN_BEST).min(n);
        let mut sorted = [f32::MAX; MAX_OBSERVATIONS];
        for (k, &cost) in costs[..n].iter().enumerate() {
            let mut j = k;
            while j > 0 && sorted[j - 1] > cost {
                sorted[j] = sorted[j - 1];
                j -= 1;
            }
            sorted[j] = cost;
        }
        // At the finest level what matches so badly is as good as outside; at coarser ones it may still improve.
        let is_finest = self.level == 0;
        let cost = |c: &f32| if *c < OUTSIDE && !is_finest { *c } else { c.min(OUTSIDE_COST) };
        let outside = (n - inside) as f32 / n.max(1) as f32;
        sorted[..count].iter().map(cost).sum::<f32>() / count.max(1) as f32
            + OUTSIDE_PENALTY * outside
    }

    /// Calls `f` for every observation that sees the element, with its part of the normal equations: sums over the
    /// patch of the products of image gradients, `[xx, xy, yy]`, and of gradients and residuals, `[x, y]`, per pixel of
    /// the level.
    pub fn for_each_gradient(
        &self,
        matched: &MatchedElement,
        max_cost: f32,
        mut f: impl FnMut(&ObservingFrame, [f32; 3], [f32; 2]),
    ) {
        let &MatchedElement { element, pixel: (x, y), patch, costs, .. } = matched;
        for (o, _) in self.observations.iter().zip(costs).filter(|(_, c)| **c <= max_cost) {
            let image = &o.levels[self.level];
            let footprint = self.footprint(o, element, x, y);
            let limit = image.limit();
            let (mut products, mut residuals) = ([0.0f32; 3], [0.0f32; 2]);
            for k in 0..patch.count {
                let own = patch.samples[k];
                let [u, v] = footprint.at([patch.offset_x[k], patch.offset_y[k]]);
                if !(u > 0.0 && v > 0.0 && u < limit[0] && v < limit[1]) {
                    continue;
                }
                let s = image.sample(u, v);
                let residual = (s[0] - own[0]) / WEIGHTS[0];
                let gx = 0.5 * (s[2] + own[2]) / WEIGHTS[2];
                let gy = 0.5 * (s[3] + own[3]) / WEIGHTS[3];
                let weight = patch.weights[k][0] / (1.0 + (residual / RESIDUAL).powi(2));
                products[0] += weight * gx * gx;
                products[1] += weight * gx * gy;
                products[2] += weight * gy * gy;
                residuals[0] += weight * gx * residual;
                residuals[1] += weight * gy * residual;
            }
            f(o, products, residuals);
        }
    }

    /// How different two elements of one pixel are, pixels of the level.
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
