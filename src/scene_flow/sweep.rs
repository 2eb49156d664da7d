//! One pass of PatchMatch (Barnes et al. 2009; Bleyer et al. 2011) over a scene flow map. At each pixel, the current
//! surface element is compared with proposals from neighbouring pixels, from the maps of other frames, from random
//! sampling, from an affine fit and from a Gauss–Newton step. The element with the lowest cost becomes the new one.

use super::consistency::OtherMaps;
use super::element::Element;
use super::map::ElementMap;
use super::matching::{Costs, MAX_OBSERVATIONS, MatchedElement, PatchMatcher};
use super::matching_image::similarity;
use super::patch::Patch;
use super::silhouette::Shown;
use super::transfer::Proposals;
use crate::random::Random;

/// Smoothness cost per pixel of distance ([`PatchMatcher::distance`]) between the surface elements of two
/// neighbouring pixels.
const SMOOTHNESS: f32 = 0.004;
/// Value at which the distance ([`PatchMatcher::distance`]) between the surface elements of two neighbouring pixels is
/// truncated in the smoothness cost, pixels of the pyramid level.
const MAX_ROUGHNESS_PX: f32 = 2.0;
/// Constant that is added to the colour term of the smoothness weight, so that neighbours of any colour have some
/// smoothness.
const MIN_COLOR_WEIGHT: f32 = 0.1;
/// Matching cost, beside that of noise, below which a pixel's surface element is good. For such a pixel, no random elements
/// are tried. If the element is also static and the neighbours have nearly the same element, later passes at the two finest
/// levels skip the pixel.
const MATCHED: f32 = 0.012;
/// Distance ([`PatchMatcher::distance`]) below which two surface elements count as equal, pixels of the pyramid
/// level.
const SAME_PX: f32 = 0.08;
/// Speed below which a surface element counts as static, pixels per frame. It is also the distance, in pixels of the
/// pyramid level, below which the elements of two neighbouring pixels count as nearly the same.
const STILL_PX: f32 = 0.3;
/// Maximum speed, pixels per frame, of a surface element whose copy without motion is tried at the finest level.
const MAX_SPEED_TO_REST_PX: f32 = 4.0;
/// Fraction of the random surface elements that are drawn from the whole search range, at [`COARSE_LEVEL`] and coarser
/// levels. The other random elements are near the current element.
const ANYWHERE: f32 = 0.7;
/// Fraction of the random surface elements from the whole search range that have no motion.
const AT_REST: f32 = 0.15;
/// Fraction of the random surface elements from the whole search range that keep the pixel's current depth.
const KEEP_DEPTH: f32 = 0.3;
/// Maximum size of a random change of a surface element's disparity, pixels of the pyramid level. The velocity
/// changes by up to twice this size.
const MAX_CHANCE_PX: f32 = 4.0;
/// Finest pyramid level at which random surface elements are drawn from the whole search range. If a small image has no such
/// level, its coarsest one is meant.
pub const COARSE_LEVEL: usize = 2;

/// Cost per pixel of difference between a surface element and the other frames' scene flow maps
/// ([`OtherMaps::difference`]).
const INCONSISTENCY: f32 = 0.02;
/// Maximum difference ([`OtherMaps::difference`]) between a pixel's surface element and the other frames' scene flow
/// maps at which the element counts as consistent with them, pixels. No consistency cost is then added at this pixel.
const CONSISTENT_PX: f32 = 1.5;

/// Cost of a body's surface element that projects onto static background in all observing frames. If it does so in
/// some of them, the same fraction of this cost is added.
const SILHOUETTE: f32 = 0.3;
/// Increase of a body's matching cost for each pixel per frame of speed, as a fraction of the cost. Motion along a thin body
/// matches at many speeds; the slowest of them counts.
const BY_SPEED: f32 = 0.004;
/// Number of other pixels of bodies whose surface elements are tried at a pixel of a body without a good element. A thin
/// body is missing at coarse levels, so that no adjacent pixel may have its depth and motion.
const OF_BODIES: usize = 4;
/// Maximum distance to these pixels along each axis, pixels, at the finest level. At other levels, it is larger by the
/// square root of the level's [`PatchMatcher::scale`].
const OF_BODIES_PX: f32 = 24.0;

/// Cost of the nearest depth for a pixel that shows static background. The cost is linear in the inverse depth, and 0
/// at the farthest depth. Textureless background that matches at many depths is thus placed behind all bodies.
const NEARNESS: f32 = 0.01;

/// Search range of depths and speeds.
#[derive(Clone, Copy, Debug)]
pub struct Limits {
    /// Minimum and maximum of the inverse depth, 1/m.
    pub inverse_depth: [f32; 2],
    /// Maximum speed, pixels per frame. If it is 0, nothing moves.
    pub max_speed: f32,
}

impl Limits {
    fn contain(&self, e: &Element) -> bool {
        let [min, max] = self.inverse_depth;
        (min..=max).contains(&e.inverse_depth) && e.speed() <= 1.2 * self.max_speed
    }
}

/// Parameters of one pass of PatchMatch over a scene flow map.
pub struct Pass<'a> {
    pub limits: Limits,
    /// Number of passes already done at this pyramid level.
    pub turn: usize,
    pub is_last: bool,
    /// Whether the pyramid level is the coarsest one.
    pub is_coarsest: bool,
    /// Number of random surface elements that are tried per pixel.
    pub chances: usize,
    pub proposals: Option<&'a Proposals>,
    /// Scene flow maps of the other frames; `None` if this pass has no consistency cost.
    pub others: Option<OtherMaps<'a>>,
    pub seed: u64,
}

impl Pass<'_> {
    fn is_backward(&self) -> bool {
        self.turn % 2 == 1
    }
}

/// Surface elements of up to four neighbouring pixels, extrapolated to a pixel, with their weights in its smoothness
/// cost. A neighbour's weight decreases with its colour difference.
struct Surroundings {
    neighbors: [(f32, Element); 4],
    count: usize,
}

/// Best surface element found so far for a pixel, with its costs.
struct Best<'a, 'b> {
    matcher: &'a PatchMatcher<'b>,
    map: &'a ElementMap,
    limits: Limits,
    pixel: (usize, usize),
    patch: &'a Patch,
    around: Surroundings,
    element: Element,
    match_cost: f32,
    cost: f32,
    costs: Costs,
    /// Scene flow maps of the other frames, if they disagree with the pixel's initial surface element. Otherwise
    /// `None`, and the pixel has no consistency cost.
    others: Option<&'a OtherMaps<'a>>,
    /// Whether the pixel shows static background, by the frame's mask; `None` if it has none.
    is_still: Option<bool>,
    /// What the pixel shows, by the mask or by silhouettes.
    shown: Shown,
}

impl Best<'_, '_> {
    /// Evaluates a proposal for the pixel's surface element. Replaces the element by the proposal if this lowers the
    /// total cost: the sum of the costs of matching, smoothness, consistency and static background.
    #[inline(always)]
    fn consider(&mut self, proposal: Element) {
        let is_static = self.is_still == Some(true) || self.limits.max_speed == 0.0;
        let proposal = if is_static { proposal.still() } else { proposal };
        if !self.limits.contain(&proposal) {
            return;
        }
        let (x, y) = self.pixel;
        let roughness = self.matcher.roughness(&self.around, &proposal);
        let center = self.map.center(y * self.map.width + x);
        let inconsistency = |o: &OtherMaps| INCONSISTENCY * o.difference(&proposal, center);
        let roughness = roughness + self.others.map_or(0.0, inconsistency);
        let roughness = roughness + self.still_cost(&proposal);
        if roughness >= self.cost {
            return;
        }
        let mut costs = [0.0; MAX_OBSERVATIONS];
        let factor = self.speed_factor(&proposal);
        let limit = (self.cost - roughness) / factor;
        let match_cost = self.matcher.cost(&proposal, (x, y), self.patch, limit, &mut costs);
        let cost = factor * match_cost + roughness;
        if cost < self.cost {
            self.element = proposal;
            (self.match_cost, self.cost) = (match_cost, cost);
            self.costs = costs;
        }
    }

    /// Returns the factor of the matching cost due to a body's speed, at least 1.
    #[inline(always)]
    fn speed_factor(&self, e: &Element) -> f32 {
        if self.shown == Shown::Body { 1.0 + BY_SPEED * e.speed() } else { 1.0 }
    }

    /// Returns the cost of a surface element due to static background. An element of a body has a cost if it projects
    /// onto background in other frames. With a mask of the background, an element of the background has a cost that
    /// increases with its nearness. Otherwise, the cost is 0.
    #[inline(always)]
    fn still_cost(&self, e: &Element) -> f32 {
        let [min, max] = self.limits.inverse_depth;
        match (self.shown, self.is_still) {
            (Shown::Body, _) => SILHOUETTE * self.matcher.background_fraction(e, self.pixel),
            (_, Some(true)) => {
                NEARNESS * (e.inverse_depth - min) / (max - min).max(f32::MIN_POSITIVE)
            }
            _ => 0.0,
        }
    }

    /// Evaluates, as proposals, the surface elements of two adjacent pixels that this pass has already visited. At all
    /// levels except the finest, it also evaluates those of two pixels farther away.
    fn consider_neighbors(&mut self, pass: &Pass) {
        let (x, y) = self.pixel;
        let sign = if pass.is_backward() { 1 } else { -1 };
        let steps = [(sign, 0), (0, sign), (3 * sign, 2 * sign), (-2 * sign, 3 * sign)];
        let count = if self.matcher.level == 0 { 2 } else { 4 };
        for &step in &steps[..count] {
            let Some(at) = self.matcher.neighbor(x, y, step) else { continue };
            let proposal = self.matcher.continued(self.map, at, step);
            if self.differs(&proposal) {
                self.consider(proposal);
            }
        }
    }

    /// Evaluates, as a proposal, the current surface element without its motion. At the finest level, this is skipped
    /// for a fast element, because its true motion can't be 0.
    fn consider_rest(&mut self) {
        let speed = self.element.speed();
        if speed > 0.0 && (self.matcher.level > 0 || speed < MAX_SPEED_TO_REST_PX) {
            self.consider(self.element.still());
        }
    }

    /// Evaluates the surface elements that other frames' scene flow maps propose for pixel `k`.
    fn consider_proposals(&mut self, pass: &Pass, k: usize) {
        for proposal in pass.proposals.iter().flat_map(|p| p.at(k)) {
            if self.differs(&proposal) {
                self.consider(proposal);
            }
        }
    }

    /// Evaluates, as proposals, the surface elements of random pixels of bodies nearby, with or without extrapolation to the
    /// pixel. In frames with a mask of the background this is skipped: its effect there isn't known.
    fn consider_bodies(&mut self, random: &mut Random) {
        let is_body = self.shown == Shown::Body && self.is_still.is_none();
        if !is_body || self.matcher.is_matched(self.match_cost) {
            return;
        }
        let (x, y) = self.pixel;
        let reach = OF_BODIES_PX / self.matcher.scale.sqrt(); // pixels of the level; the scale is at least 1
        for _ in 0..OF_BODIES {
            let [dx, dy] = [random.signed(), random.signed()].map(|r| (r as f32 * reach) as i32);
            let Some((u, v)) = self.matcher.neighbor(x, y, (dx, dy)) else { continue };
            if self.matcher.own.shown(u, v) != Shown::Body {
                continue;
            }
            let proposal = if random.unit() < 0.5 {
                self.matcher.continued(self.map, (u, v), (dx, dy))
            } else {
                self.map.elements[v * self.map.width + u]
            };
            if self.differs(&proposal) {
                self.consider(proposal);
            }
        }
    }

    /// Evaluates, as proposals, random surface elements, unless the pixel has a good element.
    fn consider_chances(&mut self, pass: &Pass, random: &mut Random) {
        let chances = if self.matcher.is_matched(self.match_cost) { 0 } else { pass.chances };
        for _ in 0..chances {
            self.consider(self.matcher.chance(&self.element, pass, random));
        }
    }

    /// Evaluates, as a proposal, the affine fit to the neighbouring surface elements, except in the first pass at a
    /// level.
    fn consider_fit(&mut self, pass: &Pass) {
        let (x, y) = self.pixel;
        if pass.turn > 0
            && let Some(fit) = self.matcher.affine_fit(self.map, x, y)
            && self.matcher.changes_patch(&fit, &self.element)
        {
            self.consider(fit);
        }
    }

    /// Evaluates, as a proposal, the surface element after a Gauss–Newton step from the current element.
    fn consider_step(&mut self) {
        if let Some(step) = self.matcher.step(&self.matched())
            && self.matcher.distance(&step, &self.element) > 0.1 * SAME_PX
        {
            self.consider(step);
        }
    }

    /// Evaluates a Gauss–Newton step in three cases: in the last pass; if this pass has changed the surface element
    /// from `before`; and in the first pass, for a settled pixel. A settled pixel is well matched and static, and later
    /// passes skip it.
    fn step_if_due(&mut self, before: &Element, is_settled: bool, pass: &Pass) {
        let has_changed = self.matcher.distance(before, &self.element) > 0.0;
        if !(pass.is_last || has_changed || (is_settled && pass.turn == 0)) {
            return;
        }
        if pass.turn > 0 && !has_changed {
            // The costs in the single observing frames are unknown, since the previous pass stored only their mean.
            let element = self.element;
            self.matcher.cost(&element, self.pixel, self.patch, f32::INFINITY, &mut self.costs);
        }
        self.consider_step();
    }

    fn matched(&self) -> MatchedElement<'_> {
        let Self { element, pixel, patch, costs, match_cost, .. } = self;
        MatchedElement { element, pixel: *pixel, patch, costs, cost: *match_cost }
    }

    fn differs(&self, proposal: &Element) -> bool {
        self.matcher.distance(proposal, &self.element) > SAME_PX
    }
}

impl PatchMatcher<'_> {
    /// Returns the surface elements of the four neighbouring pixels, extrapolated to the pixel. A neighbour is skipped if
    /// only one of the two pixels shows static background.
    #[inline(always)]
    fn surroundings(&self, map: &ElementMap, x: usize, y: usize) -> Surroundings {
        let center = self.own.pixel(x, y);
        let mut around = Surroundings { neighbors: [Default::default(); 4], count: 0 };
        for step @ (dx, dy) in [(-1, 0), (1, 0), (0, -1), (0, 1)] {
            let Some((u, v)) = self.neighbor(x, y, (dx, dy)) else { continue };
            if self.own.is_still(u, v) != self.own.is_still(x, y) {
                continue;
            }
            let weight = similarity(&self.own.pixel(u, v), &center) + MIN_COLOR_WEIGHT;
            around.neighbors[around.count] = (weight, self.continued(map, (u, v), step));
            around.count += 1;
        }
        around
    }

    /// Returns the smoothness cost of a surface element: the weighted sum of its truncated distances from those of
    /// the neighbouring pixels.
    #[inline(always)]
    fn roughness(&self, around: &Surroundings, e: &Element) -> f32 {
        let mut sum = 0.0;
        for (weight, here) in &around.neighbors[..around.count] {
            sum += weight * self.distance(e, here).min(MAX_ROUGHNESS_PX);
        }
        SMOOTHNESS * sum
    }

    #[inline(always)]
    fn neighbor(&self, x: usize, y: usize, (dx, dy): (i32, i32)) -> Option<(usize, usize)> {
        let (u, v) = (x.checked_add_signed(dx as isize)?, y.checked_add_signed(dy as isize)?);
        let is_inside = u < self.own.width && v < self.own.height;
        (is_inside && self.own.films_pixel(u, v)).then_some((u, v))
    }

    /// Returns the surface element of the neighbour `(u, v)`, which is `(dx, dy)` away from the pixel, extrapolated
    /// to the pixel.
    #[inline(always)]
    fn continued(&self, map: &ElementMap, (u, v): (usize, usize), (dx, dy): (i32, i32)) -> Element {
        let element = &map.elements[v * self.own.width + u];
        element.at(-dx as f32 * self.scale, -dy as f32 * self.scale)
    }

    /// Returns whether a matching cost is that of a good surface element.
    fn is_matched(&self, cost: f32) -> bool {
        cost < MATCHED + self.own.noise_cost()
    }

    /// Returns whether a pixel is settled: its surface element is well matched and static, and its neighbours have
    /// nearly the same element.
    fn is_settled(&self, map: &ElementMap, x: usize, y: usize) -> bool {
        let k = y * self.own.width + x;
        let own = &map.elements[k];
        self.is_matched(map.costs[k])
            && own.speed() < STILL_PX
            && [(-1, 0), (1, 0), (0, -1), (0, 1)].iter().all(|&step| {
                let neighbor = self.neighbor(x, y, step);
                neighbor.is_none_or(|(u, v)| {
                    self.distance(&map.elements[v * self.own.width + u], own) < STILL_PX
                })
            })
    }

    /// Copies the surface element of the top-left pixel of a 2×2 block to pixel `(x, y)` of the block, if the top-left
    /// pixel is settled ([`Self::is_settled`]). Returns whether the element was copied. All four pixels of a block
    /// began with the same element of the coarser level. The pass must be forward, so that it has already visited the
    /// top-left pixel.
    fn is_copied(&self, map: &mut ElementMap, x: usize, y: usize) -> bool {
        let (dx, dy) = (x % 2, y % 2);
        let first = (y - dy) * self.own.width + x - dx;
        let is_copied = (dx, dy) != (0, 0)
            && self.own.films_pixel(x - dx, y - dy)
            && self.own.is_still(x - dx, y - dy) == self.own.is_still(x, y)
            && self.is_settled(map, x - dx, y - dy);
        if is_copied {
            let k = y * self.own.width + x;
            map.elements[k] =
                map.elements[first].at(dx as f32 * self.scale, dy as f32 * self.scale);
            map.costs[k] = map.costs[first];
        }
        is_copied
    }

    /// Returns whether all pixels of the 2×2 block that contains pixel `(x, y)` show static background. If so, the
    /// pixels keep the surface element of the coarser level.
    fn is_inherited(&self, x: usize, y: usize) -> bool {
        let (u, v) = (x - x % 2, y - y % 2);
        let block = [(u, v), (u + 1, v), (u, v + 1), (u + 1, v + 1)];
        let inside = |&(u, v): &(usize, usize)| u < self.own.width && v < self.own.height;
        block.iter().filter(|at| inside(at)).all(|&(u, v)| self.own.is_still(u, v) == Some(true))
    }

    fn chance(&self, own: &Element, pass: &Pass, random: &mut Random) -> Element {
        if (pass.is_coarsest || self.level >= COARSE_LEVEL) && (random.unit() as f32) < ANYWHERE {
            let Limits { inverse_depth: [min, max], max_speed } = pass.limits;
            let speed = max_speed * (random.unit() as f32).sqrt();
            let angle = std::f32::consts::TAU * random.unit() as f32;
            let inverse_depth = min + (max - min) * random.unit() as f32;
            let is_still = (random.unit() as f32) < AT_REST;
            let keeps_depth = (random.unit() as f32) < KEEP_DEPTH;
            return Element {
                inverse_depth: if keeps_depth { own.inverse_depth } else { inverse_depth },
                velocity: if is_still {
                    [0.0; 2]
                } else {
                    [speed * angle.cos(), speed * angle.sin()]
                },
                ..Element::default()
            };
        }
        let size = self.scale * MAX_CHANCE_PX * 0.5f32.powf(4.0 * random.unit() as f32);
        Element {
            inverse_depth: own.inverse_depth + random.signed() as f32 * size / self.disparity_px,
            velocity: own.velocity.map(|v| v + 2.0 * random.signed() as f32 * size),
            ..*own
        }
    }

    /// Runs one pass of PatchMatch over a scene flow map, in place. A pass with an odd `turn` visits the pixels in
    /// reverse order.
    pub fn pass(&self, map: &mut ElementMap, pass: &Pass) {
        let (width, pixels) = (map.width, map.elements.len());
        let mut random = Random::new(pass.seed);
        let mut patch = Patch::empty();
        for k in 0..pixels {
            let k = if pass.is_backward() { pixels - 1 - k } else { k };
            let (x, y) = (k % width, k / width);
            let is_skipped = map.is_given(k) || self.level == 0 && self.is_inherited(x, y);
            if is_skipped || !self.own.films_pixel(x, y) {
                continue;
            }
            let difference =
                pass.others.as_ref().map_or(0.0, |o| o.difference(&map.elements[k], map.center(k)));
            let others = pass.others.as_ref().filter(|_| difference > CONSISTENT_PX);
            let is_settled = self.level <= 1 && others.is_none() && self.is_settled(map, x, y);
            if is_settled && (pass.turn > 0 || self.is_copied(map, x, y)) {
                continue;
            }
            self.fill_patch(x, y, &mut patch);
            let is_still = self.own.is_still(x, y);
            let before = map.elements[k];
            let element = if is_still == Some(true) { before.still() } else { before };
            let mut costs = [0.0; MAX_OBSERVATIONS];
            // After the first pass at a level, the matching cost is known from the previous pass.
            let match_cost = if pass.turn > 0 {
                map.costs[k]
            } else {
                self.cost(&element, (x, y), &patch, f32::INFINITY, &mut costs)
            };
            let inconsistency = if others.is_some() { INCONSISTENCY * difference } else { 0.0 };
            let around = self.surroundings(map, x, y);
            let cost = self.roughness(&around, &element) + inconsistency;
            let mut best = Best {
                matcher: self,
                map,
                limits: pass.limits,
                pixel: (x, y),
                patch: &patch,
                around,
                element,
                match_cost,
                cost,
                costs,
                others,
                is_still,
                shown: self.own.shown(x, y),
            };
            best.cost += match_cost * best.speed_factor(&element) + best.still_cost(&element);
            if !is_settled {
                best.consider_neighbors(pass);
            }
            best.consider_rest();
            if !is_settled {
                best.consider_proposals(pass, k);
            }
            best.consider_bodies(&mut random);
            best.consider_chances(pass, &mut random);
            best.consider_fit(pass);
            best.step_if_due(&element, is_settled, pass);
            (map.elements[k], map.costs[k]) = (best.element, best.match_cost);
        }
    }

    /// Returns whether two surface elements of one pixel differ noticeably, either at the pixel or at one of two
    /// corners of its patch. At the corners, the elements extrapolated by their gradients are compared.
    fn changes_patch(&self, a: &Element, b: &Element) -> bool {
        let r = 3.0 * self.scale;
        self.distance(a, b) > 0.4 * SAME_PX
            || self.distance(&a.at(r, r), &b.at(r, r)) > SAME_PX
            || self.distance(&a.at(r, -r), &b.at(r, -r)) > SAME_PX
    }
}
