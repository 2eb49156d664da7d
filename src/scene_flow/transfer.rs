//! Elements that the maps of other frames propose for a frame.

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
