//! Footprints: where the observing frames see the patch of a surface element.

use super::element::Element;
use super::geometry::{BEHIND_PX, MIN_RATIO};
use super::observing_frame::ObservingFrame;
use crate::simd::{F32x8, LANES};

/// Position of a patch in an observing frame, in pixels of the pyramid level; (0, 0) is the centre of the first
/// pixel. `right` and `down` are the changes of this position for a step of one pixel of the level to the right, and
/// down, in the matched frame.
pub struct Footprint {
    pub center: [f32; 2],
    pub right: [f32; 2],
    pub down: [f32; 2],
}

/// A surface element at a position `(x, y)` of the matched frame, in pixels of the full-resolution image.
pub struct PlacedElement<'a> {
    pub element: &'a Element,
    pub x: f32,
    pub y: f32,
    /// Side of a pixel of the pyramid level, in pixels of the full-resolution image.
    pub scale: f32,
}

impl PlacedElement<'_> {
    #[inline(always)]
    pub fn footprint(&self, o: &ObservingFrame) -> Footprint {
        let s = self.scale;
        let center = self.position(o, 0.0, 0.0);
        let [right, down] = [self.position(o, s, 0.0), self.position(o, 0.0, s)];
        let change = |to: [f32; 2]| [to[0] - center[0], to[1] - center[1]];
        Footprint { center, right: change(right), down: change(down) }
    }

    /// Returns where the observing frame sees the surface that is `(dx, dy)` beside the element. These are in pixels of
    /// the full-resolution image; the result is in pixels of the level, and (0, 0) is the centre of the first pixel.
    #[inline(always)]
    pub fn position(&self, o: &ObservingFrame, dx: f32, dy: f32) -> [f32; 2] {
        let (x, y) = (self.x + dx, self.y + dy);
        let inverse = 1.0 / self.scale; // a power of two
        let element = self.element.at(dx, dy);
        let dt = o.time.of_element(&element, (x, y), &o.projection);
        let [mx, my, q] = element.moved(x, y, dt);
        let [u, v, _] = o.projection.project(mx, my, q);
        [u * inverse - 0.5, v * inverse - 0.5]
    }
}

/// Projections into up to eight observing frames with global shutters, side by side for SIMD.
pub struct ProjectionLanes {
    a: [[[f32; LANES]; 3]; 3],
    b: [[f32; LANES]; 3],
    /// Time from the matched frame, in frame periods of the reference camera.
    time: [f32; LANES],
}

/// Footprints in up to eight observing frames, side by side.
pub struct Footprints {
    center: [[f32; LANES]; 2],
    right: [[f32; LANES]; 2],
    down: [[f32; LANES]; 2],
}

impl Footprints {
    #[inline(always)]
    pub fn lane(&self, l: usize) -> Footprint {
        let Self { center, right, down } = self;
        Footprint {
            center: [center[0][l], center[1][l]],
            right: [right[0][l], right[1][l]],
            down: [down[0][l], down[1][l]],
        }
    }
}

impl ProjectionLanes {
    /// Returns the projections into these frames, eight by eight. Empty if a shutter is rolling: then the time depends
    /// on the position.
    pub fn all(observations: &[ObservingFrame]) -> Vec<Self> {
        if observations.iter().any(|o| !o.time.is_global()) {
            return Vec::new();
        }
        observations.chunks(LANES).map(Self::new).collect()
    }

    fn new(observations: &[ObservingFrame]) -> Self {
        // Lanes beyond the last frame are never read, and hold the first frame's values.
        let of = |f: &dyn Fn(&ObservingFrame) -> f32| -> [f32; LANES] {
            std::array::from_fn(|l| f(observations.get(l).unwrap_or(&observations[0])))
        };
        Self {
            a: [0, 1, 2].map(|i| [0, 1, 2].map(|j| of(&|o| o.projection.a[i][j]))),
            b: [0, 1, 2].map(|i| of(&|o| o.projection.b[i])),
            time: of(&|o| o.time.frames()),
        }
    }

    /// Returns [`PlacedElement::footprint`] in each frame, bit by bit the same.
    #[inline(always)]
    pub fn footprints<V: F32x8>(&self, placed: &PlacedElement) -> Footprints {
        let s = placed.scale;
        let [cx, cy] = self.positions::<V>(placed, 0.0, 0.0);
        let [rx, ry] = self.positions::<V>(placed, s, 0.0);
        let [dx, dy] = self.positions::<V>(placed, 0.0, s);
        Footprints {
            center: [cx.to_array(), cy.to_array()],
            right: [(rx - cx).to_array(), (ry - cy).to_array()],
            down: [(dx - cx).to_array(), (dy - cy).to_array()],
        }
    }

    #[inline(always)]
    fn positions<V: F32x8>(&self, placed: &PlacedElement, dx: f32, dy: f32) -> [V; 2] {
        let e = placed.element.at(dx, dy);
        let dt = V::from_array(&self.time);
        let half = V::splat(0.5) * dt * dt;
        let [vx, vy] = V::splats(e.velocity);
        let [ax, ay] = V::splats(e.acceleration);
        let x = V::splat(placed.x + dx) + vx * dt + ax * half;
        let y = V::splat(placed.y + dy) + vy * dt + ay * half;
        let q = V::splat(e.inverse_depth) + V::splat(e.inverse_depth_rate) * dt;
        let mut rows = [V::zero(); 3];
        for (row, (a, b)) in rows.iter_mut().zip(self.a.iter().zip(&self.b)) {
            let (ax, by) = (V::from_array(&a[0]) * x, V::from_array(&a[1]) * y);
            *row = ax + by + V::from_array(&a[2]) + q * V::from_array(b);
        }
        let [u, v, w] = rows;
        // Where the ratio is too small for a division, the quotient isn't used.
        let inverse = V::splat(1.0) / w;
        let (behind, min) = (V::splat(BEHIND_PX), V::splat(MIN_RATIO));
        let level = V::splat(1.0 / placed.scale); // a power of two
        let u = w.if_below(min, behind, u * inverse);
        let v = w.if_below(min, behind, v * inverse);
        [u * level - V::splat(0.5), v * level - V::splat(0.5)]
    }
}

#[cfg(test)]
mod tests {
    use super::super::frame::{FlowFrame, PyramidFrame};
    use super::super::matching_image::MatchingImage;
    use super::*;
    use crate::camera::{Camera, CameraModel};
    use crate::random::Random;
    use crate::raster::Image;
    use crate::simd::multiversion;
    use nalgebra::{Isometry3, Vector3};

    fn frame(place: [f64; 3], turn: f64, time: f64) -> FlowFrame {
        let rotation = Vector3::new(0.3 * turn, turn, -0.2 * turn);
        let camera = Camera {
            width: 96,
            height: 72,
            model: CameraModel::Pinhole { fx: 90.0, fy: 91.0, cx: 47.0, cy: 36.5 },
            cam_from_world: Isometry3::new(Vector3::from(place), rotation),
        };
        FlowFrame::new(&camera, &Image::filled(96, 72, 3, 0.5), time)
    }

    multiversion! {
        fn side_by_side(lanes: &ProjectionLanes, placed: &PlacedElement) -> Footprints = footprints_of::<V>
    }

    #[inline(always)]
    fn footprints_of<V: F32x8>(lanes: &ProjectionLanes, placed: &PlacedElement) -> Footprints {
        lanes.footprints::<V>(placed)
    }

    #[test]
    fn footprints_side_by_side_are_those_of_each_frame() {
        let mut random = Random::new(5);
        let mut signed = |size: f64| size * random.signed();
        let own = frame([0.0; 3], 0.0, 0.0);
        let others: Vec<FlowFrame> = (0..11)
            .map(|_| {
                let place = [signed(0.3), signed(0.1), signed(0.4)];
                frame(place, signed(0.2), signed(1.0))
            })
            .collect();
        let levels: [MatchingImage; 0] = [];
        let pyramid = |frame| PyramidFrame { frame, levels: &levels };
        let observe = |o| ObservingFrame::new(pyramid(&own), pyramid(o)).unwrap();
        let observations: Vec<ObservingFrame> = others.iter().map(observe).collect();
        let lanes = ProjectionLanes::all(&observations);
        assert_eq!(lanes.len(), 2);
        let mut behind = 0;
        for _ in 0..50 {
            let mut one = |size: f64| signed(size) as f32;
            let element = Element {
                inverse_depth: 0.5 + one(4.0),
                velocity: [one(20.0), one(20.0)],
                acceleration: [one(5.0), one(5.0)],
                inverse_depth_rate: one(0.1),
                inverse_depth_gradient: [one(0.01), one(0.01)],
                velocity_gradient: [[one(0.1), one(0.1)], [one(0.1), one(0.1)]],
            };
            let placed =
                PlacedElement { element: &element, x: 48.0 + one(40.0), y: 30.0, scale: 2.0 };
            for (k, o) in observations.iter().enumerate() {
                let expected = placed.footprint(o);
                for eight in [
                    lanes[k / LANES].footprints::<crate::simd::Scalar>(&placed),
                    side_by_side(&lanes[k / LANES], &placed),
                ] {
                    let found = eight.lane(k % LANES);
                    assert_eq!(found.center, expected.center);
                    assert_eq!((found.right, found.down), (expected.right, expected.down));
                }
                behind += usize::from(expected.center[0] < -1e6);
            }
        }
        assert!(behind > 0, "no element was behind a camera");
    }
}
