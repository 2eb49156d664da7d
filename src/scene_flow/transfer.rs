//! Proposals for a frame's scene flow map: surface elements of other frames' maps, transferred to the frame.

use super::element::Element;
use super::frame::FlowFrame;
use super::geometry::Projection;
use super::map::ElementMap;
use super::timing::TimeBetween;
use crate::camera::Camera;

/// Maximum time between two frames that propose surface elements to each other, in frame periods of the reference
/// camera.
const MAX_PROPOSAL_DT: f32 = 1.1;
/// Cost that is added to a proposal per frame period of time between its own frame and the frame for which it is
/// proposed. Of two equally good surface elements, the one from the frame nearer in time is thus preferred.
const COST_PER_FRAME: f32 = 0.01;
/// Maximum cost of a surface element that is proposed because it is the frontmost one at a pixel. The cost is the
/// matching cost, plus [`COST_PER_FRAME`] times the time between the frames.
const MAX_NEAR_COST: f32 = 0.1;

/// Angle between two cameras, about any axis, above which a surface element's gradients are recomputed for the other camera,
/// radians. Below this angle, they are copied.
const TURNED_RAD: f64 = 0.1;
/// Ratio of the focal lengths of two cameras above which gradients are recomputed too.
const ZOOMED: f64 = 1.05;
/// Minimum area that one pixel of a surface element covers in the other frame, pixels. If the area is smaller, the
/// surface is seen edge-on, and its gradients in the other frame are set to 0.
const MIN_AREA: f32 = 0.1;

/// Surface elements of other frames' scene flow maps that project to each pixel of a frame's map: the element with
/// the lowest cost, and the frontmost element.
pub struct Proposals {
    cheapest: Vec<Option<(f32, Element)>>,
    nearest: Vec<Option<Element>>,
}

/// Transfer of a surface element at pixel `(x, y)` to another frame, `dt` frames later.
struct Transfer<'a> {
    element: &'a Element,
    x: f32,
    y: f32,
    dt: f32,
    projection: &'a Projection,
}

impl Transfer<'_> {
    /// Returns the transferred surface element `there` with gradients computed for the other frame, where its position
    /// is `pixel`. For this purpose, the element is extrapolated to the next pixel to the right and to the next pixel
    /// down, and transferred from there too.
    fn with_gradients(&self, pixel: [f32; 2], there: Element) -> Element {
        let step = |dx: f32, dy: f32| {
            let beside = self.element.at(dx, dy);
            let (at, e) = beside.transferred(self.x + dx, self.y + dy, self.dt, self.projection);
            let [du, dv] = [at[0] - pixel[0], at[1] - pixel[1]];
            let [vx, vy] = [0, 1].map(|c| e.velocity[c] - there.velocity[c]);
            ([du, dv], [e.inverse_depth - there.inverse_depth, vx, vy])
        };
        let ([a, b], right) = step(1.0, 0.0);
        let ([c, d], down) = step(0.0, 1.0);
        let area = a * d - b * c;
        if area.abs() < MIN_AREA {
            let nothing = [[0.0; 2]; 2];
            return Element {
                inverse_depth_gradient: [0.0; 2],
                velocity_gradient: nothing,
                ..there
            };
        }
        // The change along each step equals the change per pixel times the step. Solving both equations gives the
        // change per pixel.
        let per_pixel =
            |k: usize| [(d * right[k] - b * down[k]) / area, (a * down[k] - c * right[k]) / area];
        let [q, u, v] = [0, 1, 2].map(per_pixel);
        Element {
            inverse_depth_gradient: q,
            velocity_gradient: [[u[0], v[0]], [u[1], v[1]]],
            ..there
        }
    }
}

/// Returns whether two cameras differ so much in orientation or focal length that an element's gradients are recomputed.
fn have_other_axes(a: &Camera, b: &Camera) -> bool {
    let angle_rad = a.cam_from_world.rotation.angle_to(&b.cam_from_world.rotation);
    let zoom = a.focal_px() / b.focal_px(); // focal lengths are positive
    angle_rad > TURNED_RAD || zoom.max(1.0 / zoom) > ZOOMED
}

impl Proposals {
    pub fn at(&self, k: usize) -> impl Iterator<Item = Element> + '_ {
        self.cheapest[k].map(|(_, e)| e).into_iter().chain(self.nearest[k])
    }

    /// Collects the proposals of all other scene flow maps for the map of frame `to`.
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
            let needs_gradients = have_other_axes(&frames[from].view, &frames[to].view);
            for (k, element) in map.elements.iter().enumerate() {
                let [x, y] = map.center(k);
                // Elements that are given aren't proposed: where the background is unknown, they tell nothing. Those
                // that are kept were proposed at the coarser level.
                let is_proposed = !map.is_given(k) && !frames[from].keeps_element(k, map.scale);
                if !is_proposed || !frames[from].films([x, y]) {
                    continue;
                }
                let dt = time.of_element(element, (x, y), &projection);
                let (pixel, mut there) = element.transferred(x, y, dt, &projection);
                let Some(t) = target.index(pixel) else { continue };
                if needs_gradients {
                    let place = Transfer { element, x, y, dt, projection: &projection };
                    there = place.with_gradients(pixel, there);
                }
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
