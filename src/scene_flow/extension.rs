//! Extends planes of static surfaces over pixels whose depth the images hardly tell: near the border and beside bodies,
//! where one camera alone films a surface, on plain surfaces, and where image edges are parallel to the line of cameras.
//!
//! An uncertain pixel probably belongs to the surface to which it is connected without a change of colour. If this
//! surface is a plane, the pixel gets its depth from the plane, unless this contradicts the images, or the plane is less
//! certain there than the pixel's own depth.
//!
//! Planes are found among certain depths. Where there are none, as on a plain wall, they are found among all depths of which the
//! images tell something: many uncertain depths make a certain plane.

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
/// Standard error of the disparity up to which a pixel can be used to find a plane if no certain pixels around are on a plane,
/// pixels of the pyramid level.
const USABLE_PX: f32 = 0.6;
/// Standard error of a plane's disparity up to which it is used where no element matches, pixels of the pyramid level.
const MAX_ERROR_PX: f32 = 1.0;
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
    /// Static surface beside a strong edge, whose depth the images tell by gradients near this edge alone. The depth may be that
    /// of the other side.
    Beside,
    /// Static surface whose depth the images hardly tell.
    Uncertain,
    /// No element matches.
    Unmatched,
    /// Moving surface, or a pixel that was not filmed.
    Other,
}

/// Role of a pixel when planes are continued from pixel to pixel.
#[derive(Clone, Copy, PartialEq)]
enum Role {
    /// Its value is continued, also if it is `None`.
    Source,
    /// It gets the value of a source.
    Open,
    /// It has no value, and none passes it.
    Closed,
}

/// What is known of the depths of all pixels of a map.
struct Depths<'a> {
    map: &'a ElementMap,
    states: Vec<Knowledge>,
    /// Standard errors from the textures of surfaces, without the gradients at strong edges and beside them.
    errors: Vec<ElementErrors>,
    disparity_px: f32,
}

impl Depths<'_> {
    fn is_certain(&self, k: usize) -> bool {
        self.states[k] == Knowledge::Certain
    }

    /// Returns whether the depth of a pixel can be used to find a plane where no depths are certain.
    fn is_usable(&self, k: usize) -> bool {
        let is_usable = self.errors[k].disparity_px < USABLE_PX * self.map.scale;
        self.is_certain(k) || self.states[k] == Knowledge::Uncertain && is_usable
    }

    fn position(&self, k: usize) -> [f64; 2] {
        self.map.center(k).map(f64::from)
    }

    fn disparity(&self, k: usize) -> f64 {
        f64::from(self.map.elements[k].inverse_depth * self.disparity_px)
    }

    fn tolerance(&self) -> f64 {
        PLANE_TOLERANCE_PX * f64::from(self.map.scale)
    }

    /// Returns the planes of the map's tiles, found among `used` pixels.
    fn tiles(&self, used: impl Fn(usize) -> bool) -> TilePlanes {
        let map = self.map;
        let sample = |[x, y]: [f64; 2]| {
            let k = map.index([x as f32, y as f32]).filter(|&k| used(k))?;
            let error = f64::from(self.errors[k].disparity_px).max(MIN_ERROR_PX);
            Some(DisparitySample {
                position: self.position(k),
                disparity: self.disparity(k),
                error,
            })
        };
        let sides = [map.width, map.height].map(|side| side as f64 * f64::from(map.scale));
        TilePlanes::new(sides, self.tolerance(), sample)
    }

    /// Returns the planes of certain depths, and those of all usable ones.
    fn planes(&self) -> [TilePlanes; 2] {
        [self.tiles(|k| self.is_certain(k)), self.tiles(|k| self.is_usable(k))]
    }

    /// Returns, for each pixel of the map, the plane on which its depth lies: a plane of certain depths, or of all usable ones in
    /// tiles without such a plane. `None` if it lies on none, or its own depth is less certain than those of its tile's planes.
    fn on_planes<'p>(&self, [certain, usable]: &'p [TilePlanes; 2]) -> Vec<Option<&'p Plane>> {
        let plane = |k: usize| {
            let at = self.position(k);
            let of_certain = certain.around(at);
            let (planes, is_used) = match of_certain.is_empty() {
                true => (usable.around(at), self.is_usable(k)),
                false => (of_certain, self.is_certain(k)),
            };
            let off = |plane: &&Plane| (plane.at(at) - self.disparity(k)).abs();
            let nearest =
                planes.iter().filter(|_| is_used).min_by(|a, b| off(a).total_cmp(&off(b)));
            nearest.filter(|plane| off(plane) < SAME_PLANE * self.tolerance())
        };
        (0..self.states.len()).map(plane).collect()
    }

    /// Returns the role of pixel `k`. `plane` is the plane on which it lies; `None` if it lies on none.
    fn role(&self, k: usize, plane: Option<&Plane>) -> Role {
        match self.states[k] {
            Knowledge::Uncertain | Knowledge::Unmatched if plane.is_none() => Role::Open,
            Knowledge::Beside => Role::Closed,
            _ => Role::Source,
        }
    }

    /// Returns the maximum standard error of a plane's disparity with which it may replace the depth of pixel `k`, pixels.
    fn max_error(&self, k: usize) -> f64 {
        match self.states[k] {
            Knowledge::Unmatched => f64::from(MAX_ERROR_PX * self.map.scale),
            _ => self.errors[k].disparity_px.into(),
        }
    }
}

impl PatchMatcher<'_> {
    /// Replaces uncertain surface elements by static elements of the plane to which their pixels are connected, where these
    /// match as well. `inverse_depths` is the search range, 1/m.
    pub fn extend_planes(&self, map: &mut ElementMap, inverse_depths: [f32; 2]) {
        let depths = self.depths(map);
        let tiles = depths.planes();
        let planes = depths.on_planes(&tiles);
        let roles: Vec<Role> = planes.iter().enumerate().map(|(k, p)| depths.role(k, *p)).collect();
        let step = |k: usize, n: usize| self.step_length(map, k, n);
        let planes = continued(planes, map.width, &roles, step);
        let is_open = |k: usize| roles[k] == Role::Open;
        let is_accurate =
            |k: usize, plane: &Plane| plane.error_at(depths.position(k)) <= depths.max_error(k);
        let [min, max] = inverse_depths;
        let mut found: Vec<(usize, Element, bool)> = Vec::new();
        for (k, plane) in planes.iter().enumerate() {
            let Some(plane) = plane.filter(|plane| is_open(k) && is_accurate(k, plane)) else {
                continue;
            };
            let per_px = |disparity: f64| disparity as f32 / self.disparity_px;
            let element = Element {
                inverse_depth: per_px(plane.at(depths.position(k))),
                inverse_depth_gradient: plane.gradient.map(per_px),
                ..Element::default()
            };
            let is_new = self.distance(&element, &map.elements[k]) >= SAME_PX;
            if is_new && (min..=max).contains(&element.inverse_depth) {
                found.push((k, element, depths.states[k] == Knowledge::Unmatched));
            }
        }
        let mut patch = Patch::empty();
        for (k, element, must_rest) in found {
            if let Some(cost) = self.cost_as_good(map, k, &element, must_rest, &mut patch) {
                (map.elements[k], map.costs[k]) = (element, cost);
            }
        }
    }

    /// Returns what is known of the depths of a map's pixels.
    fn depths<'a>(&self, map: &'a ElementMap) -> Depths<'a> {
        let [errors, inner] = [0, 1].map(|margin| self.surface_errors(map, margin));
        let is_certain = |errors: &ElementErrors| errors.disparity_px < UNCERTAIN_PX * self.scale;
        let state = |k: usize| match (self.is_unmatched(map, k), self.is_static(map, k)) {
            _ if !self.own.films_pixel(k % map.width, k / map.width) => Knowledge::Other,
            (true, _) => Knowledge::Unmatched,
            (false, false) => Knowledge::Other,
            (false, true) if is_certain(&inner[k]) => Knowledge::Certain,
            (false, true) if is_certain(&errors[k]) => Knowledge::Beside,
            (false, true) => Knowledge::Uncertain,
        };
        let states = (0..map.elements.len()).map(state).collect();
        Depths { map, states, errors: inner, disparity_px: self.disparity_px }
    }

    /// Returns the standard errors of the surface elements from the textures of their surfaces. The gradients at strong
    /// edges, and up to `margin` pixels from them, are left out: beside an outline, the depth of the nearer surface would be
    /// certain on the farther one.
    pub fn surface_errors(&self, map: &ElementMap, margin: usize) -> Vec<ElementErrors> {
        let count = map.elements.len();
        let around = |k: usize| neighbors(k, map.width, count);
        let pixel = |k: usize| self.own.pixel(k % map.width, k / map.width);
        let is_edge = |k| around(k).any(|n| color_difference(&pixel(n), &pixel(k)) > EDGE);
        let mut is_edge: Vec<bool> = (0..count).map(is_edge).collect();
        for _ in 0..margin {
            is_edge = (0..count).map(|k| is_edge[k] || around(k).any(|n| is_edge[n])).collect();
        }
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

/// Continues the values of an image's sources into open pixels. Each open pixel gets the value of the nearest source, along the
/// shortest path over open pixels (Dijkstra's algorithm). `step` returns the length of the step between two neighbouring
/// pixels, which must not be negative.
fn continued<T: Copy>(
    mut values: Vec<Option<T>>,
    width: usize,
    roles: &[Role],
    step: impl Fn(usize, usize) -> f32,
) -> Vec<Option<T>> {
    let is_source = |k: usize| roles[k] == Role::Source;
    let mut distances: Vec<f32> =
        (0..roles.len()).map(|k| if is_source(k) { 0.0 } else { f32::INFINITY }).collect();
    let around = |k: usize| neighbors(k, width, roles.len()).filter(|&n| roles[n] == Role::Open);
    let first = (0..roles.len()).filter(|&k| is_source(k) && around(k).next().is_some());
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

    /// Returns roles by letters: `s` source, `.` open, `x` closed.
    fn roles(letters: &str) -> Vec<Role> {
        let role = |letter: char| match letter {
            's' => Role::Source,
            '.' => Role::Open,
            _ => Role::Closed,
        };
        letters.chars().map(role).collect()
    }

    #[test]
    fn many_uncertain_depths_give_a_plane_where_none_is_certain() {
        let (width, height) = (64, 64);
        let element = |k: usize| {
            let noise = 0.1 * (k as f32 * 1.7).sin();
            Element { inverse_depth: (5.0 + noise) / 100.0, ..Element::default() }
        };
        let elements: Vec<Element> = (0..width * height).map(element).collect();
        let costs = vec![0.0; elements.len()];
        let map = ElementMap { width, height, scale: 1.0, elements, costs, given: Vec::new() };
        let on_plane = |disparity_px: f32, corner: Knowledge| {
            let errors = vec![ElementErrors { disparity_px, velocity_px: 0.0 }; width * height];
            let is_corner = |k: usize| k % width < 40 && k / width < 40;
            let state = |k: usize| if is_corner(k) { corner } else { Knowledge::Uncertain };
            let states = (0..width * height).map(state).collect();
            let depths = Depths { map: &map, states, errors, disparity_px: 100.0 };
            depths.on_planes(&depths.planes()).iter().flatten().count()
        };
        assert_eq!(on_plane(0.3, Knowledge::Uncertain), width * height);
        assert_eq!(on_plane(0.8, Knowledge::Uncertain), 0);
        // Certain depths give the plane, and uncertain pixels get it when it is continued.
        assert_eq!(on_plane(0.3, Knowledge::Certain), 40 * 40);
    }

    #[test]
    fn values_continue_to_the_next_change_of_colour() {
        let colors = [0, 0, 0, 1, 1, 1];
        let step = |k: usize, n: usize| if colors[k] == colors[n] { 0.1 } else { 10.0 };
        let values = vec![Some('a'), None, None, None, None, Some('b')];
        let expected = ['a', 'a', 'a', 'b', 'b', 'b'].map(Some);
        assert_eq!(continued(values, 6, &roles("s....s"), step), expected);
    }

    #[test]
    fn a_source_without_value_gives_none_and_nothing_passes_an_infinite_step() {
        let all = roles("s...s");
        let step = |k: usize, n: usize| if [k, n].contains(&3) { f32::INFINITY } else { 1.0 };
        let values = vec![None, None, None, None, Some('b')];
        assert_eq!(continued(values, 5, &all, step), [None, None, None, None, Some('b')]);
        let beside = continued(vec![Some('a'), None, None, None, None], 5, &all, step);
        assert_eq!(beside, [Some('a'), Some('a'), Some('a'), None, None]);
    }

    #[test]
    fn a_closed_pixel_gives_nothing_and_lets_nothing_pass() {
        let values = vec![Some('a'), None, Some('c'), None, None];
        let found = continued(values, 5, &roles("s.x.."), |_, _| 1.0);
        assert_eq!(found, [Some('a'), Some('a'), Some('c'), None, None]);
    }

    #[test]
    fn a_path_may_turn_around_what_is_known() {
        // In the second row, the pixel in the middle is known, and has another value.
        let values = vec![Some('a'), None, None, None, Some('b'), None];
        let step = |k: usize, n: usize| if [k, n].contains(&4) { 5.0 } else { 1.0 };
        let expected = ['a', 'a', 'a', 'a', 'b', 'a'].map(Some);
        assert_eq!(continued(values, 3, &roles("s...s."), step), expected);
    }
}
