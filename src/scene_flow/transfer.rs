//! Proposals: elements of other frames' maps, transferred to a frame.

use super::element::Element;
use super::frame::FlowFrame;
use super::geometry::Projection;
use super::map::ElementMap;
use super::timing::TimeBetween;

/// Maximum time between two frames that propose elements to each other, frames of the reference camera.
const MAX_PROPOSAL_DT: f32 = 1.1;
/// Cost that is added per frame of time between the two frames, so that the nearer of two equally good
/// frames is preferred.
const COST_PER_FRAME: f32 = 0.01;
/// Upper bound of the cost of an element that is proposed because it is the frontmost.
const MAX_NEAR_COST: f32 = 0.1;

/// The elements of other frames' maps that project to each pixel of a map: the one of least cost, and the
/// frontmost one.
pub struct Proposals {
    cheapest: Vec<Option<(f32, Element)>>,
    nearest: Vec<Option<Element>>,
}

impl Proposals {
    pub fn at(&self, k: usize) -> impl Iterator<Item = Element> + '_ {
        self.cheapest[k].map(|(_, e)| e).into_iter().chain(self.nearest[k])
    }

    /// The proposals of all other maps for the map of frame `to`.
    pub fn new(frames: &[&FlowFrame], maps: &[ElementMap], to: usize) -> Self {
        let target = &maps[to];
        let pixels = target.elements.len();
        let mut proposals = Self { cheapest: vec![None; pixels], nearest: vec![None; pixels] };
        for (from, map) in maps.iter().enumerate() {
            let time = TimeBetween::new(frames[from], frames[to]);
            let projection = Projection::new(&frames[from].view, &frames[to].view);
            let Some(projection) =
                projection.filter(|_| from != to && time.frames().abs() <= MAX_PROPOSAL_DT)
            else {
                continue;
            };
            for (k, element) in map.elements.iter().enumerate() {
                let [x, y] = map.center(k);
                let dt = time.of_element(element, (x, y), &projection);
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
