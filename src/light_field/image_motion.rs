//! Motion of a view's pixels to the previous and to the next picture of a sequence. It results from the motion of the
//! scene's surfaces and from the motion of the view's camera.

use super::graph::LightField;
use crate::camera::Camera;
use crate::lumigraph::DepthMap;
use crate::scene_flow::{MotionMap, Projection, distorted, undistorted};

/// Depth map of a view, and the motion of the view's surfaces if the motion is known.
#[derive(Debug)]
pub struct Layers {
    pub depths: DepthMap,
    pub surfaces: Option<MotionMap>,
}

/// A camera, and an instant in seconds from the capture's start.
pub type CameraAt<'a> = (&'a Camera, f64);

/// Step from a view to the previous or to the next view of a sequence.
struct Step {
    camera: Camera,
    projection: Projection,
    /// Time from the view to its neighbour, in frame intervals of the reference camera; negative for the previous view.
    dt: f32,
}

/// Positions of a view's points in the previous and in the next view of a sequence. Each point moves in a straight
/// line, with the constant velocity that it has at the view's instant.
pub struct ImageMotion {
    view: Camera,
    surfaces: Option<MotionMap>,
    /// Steps to the previous and to the next view; `None` if there is no such view.
    steps: [Option<Step>; 2],
}

impl ImageMotion {
    /// Prepares the computation of pixel motion from a view to its `neighbors`, the previous and the next view. Each
    /// view is given with its instant. `surfaces` is the motion of the view's surfaces, if known.
    ///
    /// `None` if the motion is unknown: time passes between the views, and `surfaces` is `None`.
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

    /// Returns two displacements of the point at pixel `k`, whose depth is `depth_m`: to its position in the previous
    /// view, and to its position in the next view. Each is in pixels, right and down. If one of the two views doesn't
    /// exist, its displacement is the opposite of the other view's. A displacement is 0 if the point has no depth, or
    /// if the point isn't in front of the neighbouring view.
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

/// Horizontal position, pixels, that is left of all projections of points before a camera. [`Projection::project`]
/// gives points behind a camera this position or one further left.
const NOWHERE_PX: f32 = -1e8;
