//! Smooths a scene flow map where the images say little. A plain surface matches with many depths and motions. If a
//! region of it has a wrong element, PatchMatch can't correct this pixel by pixel: inside the region, each pixel agrees
//! with its neighbours. Here, the elements of all pixels change together. The smooth map minimizes
//!
//! ```text
//! Σ (v_i − e_i)ᵀ I_i (v_i − e_i) + Σ w_ij |v_i − v_j|²
//! ```
//!
//! over the disparities and velocities `v` of all pixels `i` and of neighbours `i`, `j`. `e` are the present values,
//! `I` their information matrices, and `w` weights that decrease with the difference in colour. Textured pixels
//! thus keep their values, and those of plain pixels are interpolated between them. At the finest level, only moving
//! bodies are smoothed: the motion along a thin body is as uncertain as that of a plain surface.

use super::element::Element;
use super::map::ElementMap;
use super::matching::{MAX_OBSERVATIONS, PatchMatcher};
use super::matching_image::color_difference;
use super::patch::Patch;
use super::silhouette::Shown;
use nalgebra::{Matrix3, Vector3};

/// Standard deviation of the difference between two neighbouring pixels of one colour, pixels of the pyramid level: of
/// the disparity, and of each component of the velocity.
const DIFFERENCE_PX: f64 = 0.5;
/// Colour difference of two neighbouring pixels at which their weight falls to 1/e.
const COLOR: f32 = 0.04;
/// Number of Gauss–Seidel iterations. They don't converge in regions wider than some ten pixels of the pyramid level; the
/// coarser levels have smoothed these before.
const ITERATIONS: usize = 30;
/// Minimum information about each unknown, 1/px². It makes the information matrices positive definite.
const MIN_INFORMATION: f64 = 1e-6;
/// Information about each unknown of an element that is given, 1/px².
const GIVEN_INFORMATION: f64 = 1e4;
/// Minimum distance ([`PatchMatcher::distance`]) between a pixel's element and the smooth one for a replacement, pixels
/// of the pyramid level.
const MIN_CHANGE_PX: f32 = 0.5;
/// Maximum increase of the matching cost in a replacement.
const TOLERANCE: f32 = 0.004;
/// Maximum further increase of the matching cost in a replacement at the finest level, as a fraction of the cost. A patch of
/// a thin body contains mostly background, so that its cost is large for any element. Without this
/// tolerance, pieces of a thin body move along it by different amounts. It applies only to changes that the images hardly
/// show ([`Known::is_unseen`]).
const RELATIVE_TOLERANCE: f32 = 0.5;
/// Maximum information about a change that the images hardly show, as a fraction of the information about the change that
/// they show best. Larger: small textured bodies take on the motion of their surroundings.
const MAX_UNSEEN: f64 = 0.05;

/// Unknowns of a pixel, in pixels and pixels per frame. `motion` is the disparity and the velocity. `rates` are their
/// rates of change.
#[derive(Clone, Copy)]
struct Unknowns {
    motion: Vector3<f64>,
    rates: Vector3<f64>,
}

impl Unknowns {
    fn of(e: &Element, disparity_px: f32) -> Self {
        let vector = |by_depth: f32, [x, y]: [f32; 2]| {
            Vector3::new(by_depth * disparity_px, x, y).map(f64::from)
        };
        Self {
            motion: vector(e.inverse_depth, e.velocity),
            rates: vector(e.inverse_depth_rate, e.acceleration),
        }
    }

    /// Returns the surface element with these values and without gradients.
    fn element(&self, disparity_px: f32) -> Element {
        let Self { motion, rates } = self;
        let [motion, rates] = [motion, rates].map(|v| v.map(|value| value as f32));
        Element {
            inverse_depth: motion.x / disparity_px,
            velocity: [motion.y, motion.z],
            inverse_depth_rate: rates.x / disparity_px,
            acceleration: [rates.y, rates.z],
            ..Element::default()
        }
    }
}

/// What is known about a pixel before smoothing.
struct Known {
    /// Index of the pixel in the map.
    pixel: usize,
    present: Unknowns,
    information: Matrix3<f64>,
    /// Neighbouring pixels that are smoothed too, by their index in the list of such pixels, with the weights of the
    /// differences from them, 1/px². A weight is 0 where there is no such pixel.
    neighbors: [(f64, usize); 4],
}

impl Known {
    /// Returns whether the images hardly show a change of disparity and velocity from the present values. An example is a
    /// change of the motion along a thin body. If they show nothing at all, the result is false.
    fn is_unseen(&self, change: &Vector3<f64>) -> bool {
        let shown = change.dot(&(self.information * change));
        shown <= MAX_UNSEEN * self.information.symmetric_eigenvalues().max() * change.norm_squared()
    }
}

impl PatchMatcher<'_> {
    /// Replaces surface elements of a scene flow map by those of the smooth map, where these match about as well. At the
    /// finest level, only pixels of bodies are smoothed.
    pub fn smooth(&self, map: &mut ElementMap) {
        let known = self.known(map);
        let mut patch = Patch::empty();
        let mut costs = [0.0; MAX_OBSERVATIONS];
        for (known, smooth) in known.iter().zip(smoothed(&known)) {
            let k = known.pixel;
            let element = smooth.element(self.disparity_px);
            if map.is_given(k) || self.distance(&element, &map.elements[k]) < MIN_CHANGE_PX {
                continue;
            }
            let pixel = (k % map.width, k / map.width);
            self.fill_patch(pixel.0, pixel.1, &mut patch);
            let is_tolerant =
                self.level == 0 && known.is_unseen(&(smooth.motion - known.present.motion));
            let relative = if is_tolerant { RELATIVE_TOLERANCE } else { 0.0 };
            let limit = map.costs[k] * (1.0 + relative) + TOLERANCE;
            let cost = self.cost(&element, pixel, &patch, limit, &mut costs);
            if cost <= limit {
                (map.elements[k], map.costs[k]) = (element, cost);
            }
        }
    }

    /// Returns the pixels that are smoothed, row by row.
    fn known(&self, map: &ElementMap) -> Vec<Known> {
        let position = |k: usize| (k % map.width, k / map.width);
        let is_smoothed = |k: &usize| {
            let (x, y) = position(*k);
            self.level > 0 || self.own.shown(x, y) == Shown::Body
        };
        let pixels: Vec<usize> = (0..map.elements.len()).filter(is_smoothed).collect();
        let mut places = vec![None; map.elements.len()];
        pixels.iter().enumerate().for_each(|(place, &k)| places[k] = Some(place));
        let mut patch = Patch::empty();
        let known = |&k: &usize| {
            let pixel @ (x, y) = position(k);
            let information = match map.is_given(k) {
                true => Matrix3::from_diagonal_element(GIVEN_INFORMATION),
                false => self.information(map, pixel, &mut patch),
            };
            // To the left of the first column and above the first row, the coordinates wrap to large numbers.
            let around = [(x.wrapping_sub(1), y), (x, y.wrapping_sub(1)), (x + 1, y), (x, y + 1)];
            let neighbor = |beside: (usize, usize)| {
                let weight = self.smoothness(pixel, beside);
                let place =
                    if weight > 0.0 { places[beside.1 * map.width + beside.0] } else { None };
                place.map_or((0.0, 0), |place| (weight, place))
            };
            Known {
                pixel: k,
                present: Unknowns::of(&map.elements[k], self.disparity_px),
                information: information + Matrix3::from_diagonal_element(MIN_INFORMATION),
                neighbors: around.map(neighbor),
            }
        };
        pixels.iter().map(known).collect()
    }

    /// Returns the weight of the difference between two neighbouring pixels, 1/px²: 0 if the second is outside the map, if
    /// one of them was not filmed, or if only one of them shows static background.
    fn smoothness(&self, (x, y): (usize, usize), (u, v): (usize, usize)) -> f64 {
        let is_inside = u < self.own.width && v < self.own.height;
        let is_filmed = |x: usize, y: usize| self.own.films_pixel(x, y);
        if !(is_inside && is_filmed(x, y) && is_filmed(u, v))
            || self.own.is_still(x, y) != self.own.is_still(u, v)
        {
            return 0.0;
        }
        let difference = color_difference(&self.own.pixel(x, y), &self.own.pixel(u, v));
        let deviation = DIFFERENCE_PX * f64::from(self.scale);
        f64::from((-difference / COLOR).exp()) / (deviation * deviation)
    }
}

/// Returns the smooth map's unknowns of each pixel of the list, by Gauss–Seidel iterations in alternating directions.
fn smoothed(known: &[Known]) -> Vec<Unknowns> {
    let mut values: Vec<Unknowns> = known.iter().map(|k| k.present).collect();
    for turn in 0..ITERATIONS {
        for k in 0..values.len() {
            let k = if turn % 2 == 1 { values.len() - 1 - k } else { k };
            values[k] = relaxed(&known[k], &values);
        }
    }
    values
}

/// Returns the unknowns of a pixel that minimize the sum while all other pixels keep theirs.
fn relaxed(known: &Known, values: &[Unknowns]) -> Unknowns {
    let Known { present, information, neighbors, .. } = known;
    let diagonal = information.diagonal();
    let (mut motion, mut rates) =
        (information * present.motion, diagonal.component_mul(&present.rates));
    let mut sum = 0.0;
    for &(weight, neighbor) in neighbors {
        motion += weight * values[neighbor].motion;
        rates += weight * values[neighbor].rates;
        sum += weight;
    }
    let normal = information + Matrix3::from_diagonal_element(sum);
    // The diagonal is at least `MIN_INFORMATION`. The matrix is singular only by rounding errors.
    let rates = rates.component_div(&diagonal.add_scalar(sum));
    normal.try_inverse().map_or(*present, |inverse| Unknowns { motion: inverse * motion, rates })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns pixels in a row. The weight of a difference is 1, or 0 between two `parts`.
    fn known(values: &[f64], information: &[f64], parts: &[usize]) -> Vec<Known> {
        let weight = |k: usize, neighbor: usize| match parts.get(neighbor) {
            Some(part) if *part == parts[k] => (1.0, neighbor),
            _ => (0.0, 0),
        };
        let pixel = |k: usize| Known {
            pixel: k,
            present: Unknowns { motion: Vector3::repeat(values[k]), rates: Vector3::zeros() },
            information: Matrix3::from_diagonal_element(information[k]),
            neighbors: [weight(k, k.wrapping_sub(1)), weight(k, k + 1), (0.0, 0), (0.0, 0)],
        };
        (0..values.len()).map(pixel).collect()
    }

    #[test]
    fn values_without_information_are_interpolated_between_their_surroundings() {
        let smooth = smoothed(&known(&[0.0, 50.0, 50.0, 4.5], &[1e6, 0.0, 0.0, 1e6], &[0; 4]));
        for (k, expected) in [0.0, 1.5, 3.0, 4.5].into_iter().enumerate() {
            let motion = smooth[k].motion;
            assert!((motion - Vector3::repeat(expected)).amax() < 1e-4, "{k}: {motion}");
        }
    }

    #[test]
    fn motion_along_a_line_is_unseen_and_motion_across_it_is_not() {
        let mut pixel = known(&[0.0], &[1.0], &[0]).remove(0);
        pixel.information = Matrix3::from_diagonal(&Vector3::new(50.0, 100.0, 1.0));
        let is_unseen = |x, y, z| pixel.is_unseen(&Vector3::new(x, y, z));
        assert!(is_unseen(0.0, 0.0, 9.0) && is_unseen(0.0, -1.0, 9.0));
        assert!(
            !is_unseen(1.0, 0.0, 0.0) && !is_unseen(0.0, 0.1, 0.0) && !is_unseen(0.0, 3.0, 9.0)
        );
        pixel.information = Matrix3::from_diagonal_element(MIN_INFORMATION);
        assert!(!pixel.is_unseen(&Vector3::new(0.0, 0.0, 9.0)), "nothing is known");
    }

    #[test]
    fn a_weight_of_zero_separates_two_surfaces() {
        let smooth = smoothed(&known(&[1.0, 1.0, 8.0, 8.0], &[1e6, 0.0, 0.0, 1e6], &[0, 0, 1, 1]));
        assert!((smooth[1].motion.x - 1.0).abs() < 1e-4 && (smooth[2].motion.x - 8.0).abs() < 1e-4);
    }
}
