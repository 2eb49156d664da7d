//! Motion of a view's pixels from the previous picture of a sequence, and to the next one: that of the surfaces, and
//! that of the view itself.

use super::graph::LightField;
use crate::camera::Camera;
use crate::lumigraph::DepthMap;
use crate::scene_flow::{MotionMap, Projection, distorted, undistorted};

/// A view's depth map, and the motion of its surfaces if that is known.
#[derive(Debug)]
pub struct Layers {
    pub depths: DepthMap,
    pub surfaces: Option<MotionMap>,
}

/// A camera at an instant, seconds from the capture's start.
pub type CameraAt<'a> = (&'a Camera, f64);

/// The way from a view to the previous or the next one of a sequence.
struct Step {
    camera: Camera,
    projection: Projection,
    /// Duration in frames of the reference camera, negative for an earlier instant.
    dt: f32,
}

/// Where the points that a view shows are in the views before and after it. Points move straight and evenly, with the
/// velocity that they have at the view's instant.
pub struct ImageMotion {
    view: Camera,
    surfaces: Option<MotionMap>,
    /// To the previous and to the next view; `None` if there is none.
    steps: [Option<Step>; 2],
}

impl ImageMotion {
    /// The motion from a view to `neighbors`, the previous and the next one.
    ///
    /// `None` if it is unknown: surfaces have no motion, and time passes between the views.
    pub fn new(
        field: &LightField,
        surfaces: Option<MotionMap>,
        (view, time_s): CameraAt,
        neighbors: [Option<CameraAt>; 2],
    ) -> Option<Self> {
        let step = |(camera, at_s): CameraAt| {
            let dt = (field.in_frames(at_s) - field.in_frames(time_s)) as f32;
            let projection = Projection::new(view, camera)?;
            Some(Step { camera: camera.clone(), projection, dt })
        };
        let steps = neighbors.map(|neighbor| neighbor.and_then(step));
        let is_frozen = steps.iter().flatten().all(|step| step.dt == 0.0);
        let is_known = surfaces.is_some() || is_frozen;
        is_known.then(|| Self { view: view.clone(), surfaces, steps })
    }

    /// The displacements, pixels right and down, of the point at pixel `k`, which has this depth: to its positions in the
    /// previous and in the next view. Without one of these views, the displacement to it is the opposite of the other.
    /// 0 for a point without depth, and for one that isn't in front of the other view.
    pub fn displacements(&self, k: usize, depth_m: f32) -> [[f32; 2]; 2] {
        let width = self.view.width;
        let at = [(k % width) as f32 + 0.5, (k / width) as f32 + 0.5];
        let inverse_depth = 1.0 / depth_m;
        let Some(place) = undistorted(&self.view, at).filter(|_| inverse_depth >= 0.0) else {
            return [[0.0; 2]; 2];
        };
        let motion = self.surfaces.as_ref().map(|map| map.motion(k)).unwrap_or_default();
        let [before, after] = self.steps.each_ref().map(|step| {
            let Step { camera, projection, dt } = step.as_ref()?;
            let [x, y] = [0, 1].map(|c| place[c] + motion.velocity[c] * dt);
            let q = inverse_depth + motion.inverse_depth_rate * dt;
            let [u, v, q_there] = projection.project(x, y, q.max(0.0));
            let is_ahead = u > NOWHERE_PX && q_there >= 0.0;
            let there = is_ahead.then(|| distorted(camera, [u, v])).flatten();
            Some(there.map_or([0.0; 2], |there| [there[0] - at[0], there[1] - at[1]]))
        });
        let opposite = |d: [f32; 2]| d.map(|v| -v);
        let of = |own: Option<[f32; 2]>, other: Option<[f32; 2]>| {
            own.or(other.map(opposite)).unwrap_or_default()
        };
        [of(before, after), of(after, before)]
    }
}

/// [`Projection::project`] gives points behind a camera a position left of this one.
const NOWHERE_PX: f32 = -1e8;
