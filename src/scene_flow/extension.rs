//! Extends planes of static surfaces over pixels whose depth the images hardly tell: near the border and beside bodies,
//! where one camera alone films a surface, on plain surfaces, and where image edges are parallel to the line of cameras.
//!
//! An uncertain pixel probably belongs to the surface to which it is connected without a change of colour. If this
//! surface is a plane, the pixel gets its depth from the plane, unless this contradicts the images.

use super::element::{Element, ElementErrors};
use super::grid::neighbors;
use super::map::ElementMap;
use super::matching::{MAX_OBSERVATIONS, PatchMatcher};
use super::matching_image::color_difference;
use super::observing_frame::ObservingFrame;
use super::patch::Patch;
use super::planes::{DisparitySample, Plane, TilePlanes};
use std::cmp::Reverse;
use std::collections::BinaryHeap;

/// Standard error of the disparity from which on a pixel's depth is uncertain, pixels of the pyramid level.
const UNCERTAIN_PX: f32 = 0.1;
/// Side of the blocks of pixels that share the standard errors by which pixels are certain or uncertain, pixels.
/// Larger: less time, but thin parts are missed.
const ERROR_BLOCK: usize = 2;
/// Colour difference of neighbouring pixels above which there is a strong edge between them. Larger: beside outlines,
/// plain background takes the depth of the body.
const EDGE: f32 = 0.1;
/// Minimum standard error of a disparity from which a plane is found, pixels. It keeps weights finite.
const MIN_ERROR_PX: f64 = 1e-3;
/// Maximum distance between a plane and the disparities from which it is found, pixels of the pyramid level.
const PLANE_TOLERANCE_PX: f64 = 0.15;
/// Maximum distance between a plane and the disparity of a pixel that belongs to it, as a multiple of
/// [`PLANE_TOLERANCE_PX`].
const SAME_PLANE: f64 = 1.5;
/// Maximum speed, acceleration and rate of disparity of a static surface element, pixels per frame and per squared
/// frame.
const STATIC_PX: f32 = 0.3;
/// Colour difference of two neighbouring pixels that counts as a distance of 1.
const COLOR: f32 = 0.04;
/// Distance of two neighbouring pixels of one colour.
const STEP: f32 = 0.05;
/// Maximum increase of the matching cost if a pixel's depth is replaced.
const TOLERANCE: f32 = 0.004;
/// Matching cost, beside that of noise, above which no surface element was found. The surface may be visible to one camera
/// alone, beside a body that hides it from the others.
const UNMATCHED: f32 = 0.03;
/// Matching cost, beside that of noise, below which a frame of the same camera shows a static surface unchanged.
const UNCHANGED: f32 = 0.015;
/// Distance of two surface elements below which they are the same, pixels of the pyramid level.
const SAME_PX: f32 = 0.02;
/// Distance of two frames' cameras below which they are the same camera, as a fraction of the baseline to which disparities
/// refer.
const SAME_PLACE: f32 = 1e-3;

/// What is known of a pixel's depth.
#[derive(Clone, Copy, PartialEq)]
enum Knowledge {
    /// Static surface whose depth the images tell.
    Certain,
    /// Static surface whose depth the images hardly tell.
    Uncertain,
    /// No element matches.
    Unmatched,
    /// Moving surface, or a pixel that was not filmed.
    Other,
}

impl Knowledge {
    /// Returns whether the pixel may get its depth from a plane.
    fn is_open(&self) -> bool {
        matches!(self, Self::Uncertain | Self::Unmatched)
    }
}

impl PatchMatcher<'_> {
    /// Replaces uncertain surface elements by static elements of the plane to which their pixels are connected, where these
    /// match as well. `inverse_depths` is the search range, 1/m.
    pub fn extend_planes(&self, map: &mut ElementMap, inverse_depths: [f32; 2]) {
        let errors = self.surface_errors(map);
        let is_certain = |k: usize| errors[k].disparity_px < UNCERTAIN_PX * self.scale;
        let states: Vec<Knowledge> = (0..map.elements.len())
            .map(|k| match (self.is_unmatched(map, k), self.is_static(map, k)) {
                _ if !self.own.films_pixel(k % map.width, k / map.width) => Knowledge::Other,
                (true, _) => Knowledge::Unmatched,
                (false, false) => Knowledge::Other,
                (false, true) if is_certain(k) => Knowledge::Certain,
                (false, true) => Knowledge::Uncertain,
            })
            .collect();
        let planes = self.planes(map, &errors, |k| states[k] == Knowledge::Certain);
        let is_open: Vec<bool> = states.iter().map(Knowledge::is_open).collect();
        let step = |k: usize, n: usize| self.step_length(map, k, n);
        let planes = continued(planes, map.width, &is_open, step);
        let [min, max] = inverse_depths;
        let mut patch = Patch::empty();
        for (k, plane) in planes.iter().enumerate() {
            let Some(plane) = plane.filter(|_| is_open[k]) else { continue };
            let disparity = plane.at(map.center(k).map(f64::from));
            let per_px = |disparity: f64| disparity as f32 / self.disparity_px;
            let element = Element {
                inverse_depth: per_px(disparity),
                inverse_depth_gradient: plane.gradient.map(per_px),
                ..Element::default()
            };
            if !(min..=max).contains(&element.inverse_depth) {
                continue;
            }
            if self.distance(&element, &map.elements[k]) < SAME_PX {
                continue;
            }
            let must_rest = states[k] == Knowledge::Unmatched;
            if let Some(cost) = self.cost_as_good(map, k, &element, must_rest, &mut patch) {
                (map.elements[k], map.costs[k]) = (element, cost);
            }
        }
    }

    /// Returns the standard errors of the surface elements from the textures of their surfaces. The gradients at strong
    /// edges are left out: beside an outline, the depth of the nearer surface would be certain on the farther one.
    pub fn surface_errors(&self, map: &ElementMap) -> Vec<ElementErrors> {
        let is_edge: Vec<bool> = (0..map.elements.len())
            .map(|k| {
                let pixel = |k: usize| self.own.pixel(k % map.width, k / map.width);
                let mut around = neighbors(k, map.width, map.elements.len());
                around.any(|n| color_difference(&pixel(n), &pixel(k)) > EDGE)
            })
            .collect();
        self.errors_by_block(map, ERROR_BLOCK, &|k| !is_edge[k])
    }

    /// Returns the matching cost of a static element at pixel `k` if it is about as good as the present element. With
    /// `must_rest`, the same camera must also show the pixel unchanged in an earlier or later frame. `patch` is a reusable
    /// buffer.
    fn cost_as_good(
        &self,
        map: &ElementMap,
        k: usize,
        element: &Element,
        must_rest: bool,
        patch: &mut Patch,
    ) -> Option<f32> {
        let pixel @ (x, y) = (k % map.width, k / map.width);
        self.fill_patch(x, y, patch);
        let mut costs = [0.0; MAX_OBSERVATIONS];
        let limit = map.costs[k] + TOLERANCE;
        let cost = self.cost(element, pixel, patch, limit, &mut costs);
        let is_own = |o: &ObservingFrame| {
            let [a, b] = self.by_inverse_depth(element, map.center(k), o);
            a.abs() + b.abs() < SAME_PLACE * self.disparity_px
        };
        let rests = || {
            let all = self.observations.frames.iter().zip(&costs);
            let mut own = all.filter(|(o, _)| is_own(o)).map(|(_, cost)| *cost);
            own.any(|cost| cost < UNCHANGED + self.own.noise_cost())
        };
        (cost <= limit && (!must_rest || rests())).then_some(cost)
    }

    /// Returns, for each pixel of the map that `is_known`, the plane on which it lies; `None` if it lies on none.
    fn planes(
        &self,
        map: &ElementMap,
        errors: &[ElementErrors],
        is_known: impl Fn(usize) -> bool,
    ) -> Vec<Option<Plane>> {
        let position = |k: usize| map.center(k).map(f64::from);
        let disparity = |k: usize| f64::from(map.elements[k].inverse_depth * self.disparity_px);
        let sample = |[x, y]: [f64; 2]| {
            let k = map.index([x as f32, y as f32]).filter(|&k| is_known(k))?;
            let error = f64::from(errors[k].disparity_px).max(MIN_ERROR_PX);
            Some(DisparitySample { position: position(k), disparity: disparity(k), error })
        };
        let sides = [map.width, map.height].map(|side| side as f64 * f64::from(self.scale));
        let tolerance = PLANE_TOLERANCE_PX * f64::from(self.scale);
        let tiles = TilePlanes::new(sides, tolerance, sample);
        let nearest = |k: usize| {
            let at = position(k);
            let off = |plane: &&Plane| (plane.at(at) - disparity(k)).abs();
            let nearest = tiles.around(at).iter().min_by(|a, b| off(a).total_cmp(&off(b)));
            nearest.filter(|plane| off(plane) < SAME_PLANE * tolerance).copied()
        };
        (0..map.elements.len()).map(|k| is_known(k).then(|| nearest(k)).flatten()).collect()
    }

    /// Returns whether no element was found that matches at pixel `k`.
    fn is_unmatched(&self, map: &ElementMap, k: usize) -> bool {
        map.costs[k] > UNMATCHED + self.own.noise_cost()
    }

    /// Returns whether the surface element at pixel `k` has no motion.
    fn is_static(&self, map: &ElementMap, k: usize) -> bool {
        let element = &map.elements[k];
        let [a, b] = element.acceleration;
        element.speed() < STATIC_PX
            && a.abs().max(b.abs()) < STATIC_PX
            && element.inverse_depth_rate.abs() * self.disparity_px < STATIC_PX
    }

    /// Returns the distance between the neighbouring pixels `k` and `n`, by their colours. Infinite if one of them was not
    /// filmed, or if only one of them shows static background.
    fn step_length(&self, map: &ElementMap, k: usize, n: usize) -> f32 {
        let [(x, y), (u, v)] = [k, n].map(|k| (k % map.width, k / map.width));
        let is_filmed = self.own.films_pixel(x, y) && self.own.films_pixel(u, v);
        if !is_filmed || self.own.is_still(x, y) != self.own.is_still(u, v) {
            return f32::INFINITY;
        }
        STEP + color_difference(&self.own.pixel(x, y), &self.own.pixel(u, v)) / COLOR
    }
}

/// Continues the values of an image's pixels into open pixels. Each open pixel gets the value of the nearest pixel that
/// isn't open, along the shortest path over open pixels (Dijkstra's algorithm). `step` returns the length of the step
/// between two neighbouring pixels, which must not be negative.
fn continued<T: Copy>(
    mut values: Vec<Option<T>>,
    width: usize,
    is_open: &[bool],
    step: impl Fn(usize, usize) -> f32,
) -> Vec<Option<T>> {
    let mut distances: Vec<f32> =
        is_open.iter().map(|open| if *open { f32::INFINITY } else { 0.0 }).collect();
    let around = |k: usize| neighbors(k, width, is_open.len()).filter(|&n| is_open[n]);
    let first = (0..is_open.len()).filter(|&k| !is_open[k] && around(k).next().is_some());
    // Numbers that are not negative have the order of their bits.
    let mut queue: BinaryHeap<Reverse<(u32, usize)>> = first.map(|k| Reverse((0, k))).collect();
    while let Some(Reverse((bits, k))) = queue.pop() {
        let distance = f32::from_bits(bits);
        if distance > distances[k] {
            continue; // a shorter path was found since
        }
        for n in around(k) {
            let beyond = distance + step(k, n);
            if beyond < distances[n] {
                (distances[n], values[n]) = (beyond, values[k]);
                queue.push(Reverse((beyond.to_bits(), n)));
            }
        }
    }
    values
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_continue_to_the_next_change_of_colour() {
        let colors = [0, 0, 0, 1, 1, 1];
        let is_open = [false, true, true, true, true, false];
        let step = |k: usize, n: usize| if colors[k] == colors[n] { 0.1 } else { 10.0 };
        let values = vec![Some('a'), None, None, None, None, Some('b')];
        let expected = ['a', 'a', 'a', 'b', 'b', 'b'].map(Some);
        assert_eq!(continued(values, 6, &is_open, step), expected);
    }

    #[test]
    fn a_known_pixel_without_value_gives_none_and_nothing_passes_an_infinite_step() {
        let is_open = [false, true, true, true, false];
        let step = |k: usize, n: usize| if [k, n].contains(&3) { f32::INFINITY } else { 1.0 };
        let values = vec![None, None, None, None, Some('b')];
        assert_eq!(continued(values, 5, &is_open, step), [None, None, None, None, Some('b')]);
        let beside = continued(vec![Some('a'), None, None, None, None], 5, &is_open, step);
        assert_eq!(beside, [Some('a'), Some('a'), Some('a'), None, None]);
    }

    #[test]
    fn a_path_may_turn_around_what_is_known() {
        // In the second row, the pixel in the middle is known, and has another value.
        let is_open = [false, true, true, true, false, true];
        let values = vec![Some('a'), None, None, None, Some('b'), None];
        let step = |k: usize, n: usize| if [k, n].contains(&4) { 5.0 } else { 1.0 };
        let expected = ['a', 'a', 'a', 'a', 'b', 'a'].map(Some);
        assert_eq!(continued(values, 3, &is_open, step), expected);
    }
}
