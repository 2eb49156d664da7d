//! What the maps of other frames say about a frame: elements to try, and whether they agree.

use super::element::Element;
use super::frame::FlowFrame;
use super::geometry::Projection;
use super::map::ElementMap;

/// Frames farther away in time propose nothing.
const MAX_PROPOSAL_DT: f32 = 1.1;
/// Cost of a frame's distance in time, so that of equal matches the nearer frame proposes.
const COST_PER_FRAME: f32 = 0.01;
/// Largest cost of an element that is proposed because it is the nearest.
const MAX_NEAR_COST: f32 = 0.1;
/// Frames farther away in time confirm nothing.
const MAX_CONFIRMING_DT: f32 = 0.8;
/// Largest difference in disparity between an element and the one that confirms it, pixels.
const MAX_DISPARITY_ERROR_PX: f32 = 1.5;
/// Largest difference of their velocities, pixels a frame, without the part by [`MAX_MOTION_ERROR`].
const MAX_MOTION_ERROR_PX: f32 = 2.0;
/// The part of the largest difference of velocities that grows with the speed, as a fraction of it.
const MAX_MOTION_ERROR: f32 = 0.15;
/// Weight of a map in which something is in front of the element, where a map that contradicts the element has weight 1.
const HIDDEN: f32 = 0.3;
/// Number of confirming maps that is added to those found, so that an element that no map could confirm has a confidence.
const PRIOR_CONFIRMED: f32 = 0.1;
/// Number of all maps that is added to those found.
const PRIOR_ALL: f32 = 0.5;

/// Elements that other frames' maps propose for a map's pixels: the cheapest, and the nearest.
pub struct Proposals {
    cheapest: Vec<Option<(f32, Element)>>,
    nearest: Vec<Option<Element>>,
}

impl Proposals {
    pub fn at(&self, k: usize) -> impl Iterator<Item = Element> + '_ {
        self.cheapest[k].map(|(_, e)| e).into_iter().chain(self.nearest[k])
    }

    /// What all other maps propose for one of them.
    pub fn new(frames: &[&FlowFrame], maps: &[ElementMap], to: usize) -> Self {
        let target = &maps[to];
        let pixels = target.elements.len();
        let mut proposals = Self { cheapest: vec![None; pixels], nearest: vec![None; pixels] };
        for (from, map) in maps.iter().enumerate() {
            let dt = (frames[to].time - frames[from].time) as f32;
            let projection = Projection::new(&frames[from].view, &frames[to].view);
            let Some(projection) = projection.filter(|_| from != to && dt.abs() <= MAX_PROPOSAL_DT)
            else {
                continue;
            };
            for (k, element) in map.elements.iter().enumerate() {
                let [x, y] = map.center(k);
                let (pixel, there) = element.transferred(x, y, dt, &projection);
                let Some(t) = target.index(pixel) else { continue };
                let [cx, cy] = target.center(t);
                let there = there.at(cx - pixel[0], cy - pixel[1]);
                let cost = map.costs[k] + COST_PER_FRAME * dt.abs();
                if proposals.cheapest[t].is_none_or(|(c, _)| cost < c) {
                    proposals.cheapest[t] = Some((cost, there));
                }
                let is_nearer = |n: Element| there.inverse_depth > n.inverse_depth;
                if cost < MAX_NEAR_COST && proposals.nearest[t].is_none_or(is_nearer) {
                    proposals.nearest[t] = Some(there);
                }
            }
        }
        proposals
    }
}

/// For each pixel of a map, the fraction of the other maps near in time that confirm it, of those that could.
pub fn confidence(
    frames: &[&FlowFrame],
    maps: &[ElementMap],
    of: usize,
    disparity_px: f32,
) -> Vec<f32> {
    let own = &maps[of];
    let (mut confirmed, mut all) =
        (vec![0.0f32; own.elements.len()], vec![0.0f32; own.elements.len()]);
    for (other, map) in maps.iter().enumerate() {
        let dt = (frames[other].time - frames[of].time) as f32;
        let projection = Projection::new(&frames[of].view, &frames[other].view);
        let Some(projection) = projection.filter(|_| other != of && dt.abs() <= MAX_CONFIRMING_DT)
        else {
            continue;
        };
        for (k, element) in own.elements.iter().enumerate() {
            let [x, y] = own.center(k);
            let (pixel, here) = element.transferred(x, y, dt, &projection);
            let Some(t) = map.index(pixel) else { continue };
            let there = map.element_at(t, pixel);
            let disparity = (there.inverse_depth - here.inverse_depth) * disparity_px;
            let motion =
                (there.velocity[0] - here.velocity[0]).hypot(there.velocity[1] - here.velocity[1]);
            let max_motion = MAX_MOTION_ERROR_PX + MAX_MOTION_ERROR * here.speed();
            if disparity.abs() < MAX_DISPARITY_ERROR_PX && motion < max_motion {
                confirmed[k] += 1.0;
                all[k] += 1.0;
            } else if disparity < MAX_DISPARITY_ERROR_PX {
                all[k] += 1.0;
            } else {
                all[k] += HIDDEN;
            }
        }
    }
    let fraction = |(c, a): (&f32, &f32)| (c + PRIOR_CONFIRMED) / (a + PRIOR_ALL);
    confirmed.iter().zip(&all).map(fraction).collect()
}
