//! Depths of any view, from those of all cameras (Merrell et al., ICCV 2007): the cameras' depths are splatted
//! into the view, and the nearest that enough cameras confirm is taken.

use super::InverseDepths;
use super::relative_pose::RelativePose;
use crate::camera::Camera;
use crate::lumigraph::{DepthMap, RayRow};
use rayon::prelude::*;

/// A camera and its depths.
#[derive(Clone, Copy, Debug)]
pub struct Surface<'a> {
    /// Lens and pose.
    pub camera: &'a Camera,
    /// Depths of its pixels.
    pub depths: &'a InverseDepths,
}

/// Radius of a splat, pixels of the view, or of the camera where those are larger.
const RADIUS_PX: f32 = 0.8;
/// A candidate is taken before farther ones if this many times its votes are not fewer than the most.
const ENOUGH: i32 = 2;
/// Smallest number of votes of a surface: mismatches beside outlines have fewer.
const MIN_VOTES: i32 = 1;
/// Standard error beside a depth edge, as a fraction of the jump: the pixel may belong to either surface.
const EDGE_STD_ERR: f32 = 0.5;
/// Half-width of the neighbourhood of a depth edge, pixels.
const OUTLINE_PX: usize = 2;

/// A depth hypothesis of one of the view's pixels.
#[derive(Clone, Copy, Default)]
struct FusionCandidate {
    /// Inverse depth, 1/m; 0 if there is no hypothesis.
    inverse: f32,
    /// Standard error, 1/m.
    std_err: f32,
}

/// A pixel that no camera sees.
const NOT_SEEN: FusionCandidate = FusionCandidate { inverse: f32::NAN, std_err: f32::INFINITY };

/// The cameras' surfaces relative to a view.
struct SurfacesInView<'a> {
    surfaces: &'a [Surface<'a>],
    /// Poses of the cameras relative to the view.
    poses: Vec<RelativePose>,
    /// Largest difference of two measurements of one surface, 1/m.
    tolerance: f32,
}

/// Fuses the depths of a view, metres, with their standard errors. Pixels that no camera sees have the depth of
/// the background around them, and an infinite standard error.
pub fn fuse(target: &Camera, surfaces: &[Surface]) -> DepthMap {
    let tolerance = surfaces.iter().map(|s| s.depths.tolerance).fold(0.0, f32::max);
    let poses = surfaces.iter().map(|s| RelativePose::new(target, s.camera)).collect();
    let in_view = SurfacesInView { surfaces, poses, tolerance };
    let (w, h) = (target.width, target.height);
    let splats: Vec<Vec<FusionCandidate>> =
        surfaces.par_iter().map(|s| splat(target, s, tolerance)).collect();
    let mut fused = vec![NOT_SEEN; w * h];
    fused.par_chunks_mut(w).enumerate().for_each_init(
        || (RayRow::new(target), Vec::new(), Vec::new()),
        |(rays, candidates, votes), (y, fused)| {
            rays.set(y);
            for (x, fused) in fused.iter_mut().enumerate() {
                candidates.clear();
                let splats = splats.iter().map(|s| s[y * w + x]);
                candidates.extend(splats.filter(|c| c.inverse > 0.0));
                if are_one_surface(candidates, surfaces.len(), tolerance) {
                    *fused = mean_of(candidates, candidates.first().copied(), tolerance);
                    continue;
                }
                // The nearest first.
                candidates.sort_by(|a, b| b.inverse.total_cmp(&a.inverse));
                let ray = [rays.x[x] as f32, rays.y[x] as f32];
                votes.clear();
                votes.extend(candidates.iter().map(|c| in_view.votes(ray, c.inverse)));
                *fused = elected(candidates, votes, tolerance);
            }
        },
    );
    let mut values: Vec<f32> = fused.iter().map(|c| c.inverse).collect();
    fill_from_background(&mut values, w);
    let jumps = depth_jumps(&values, w);
    let relative = |((c, value), jump): ((&FusionCandidate, &f32), &f32)| {
        let std_err =
            if *jump > tolerance { c.std_err.hypot(EDGE_STD_ERR * jump) } else { c.std_err };
        // Values are positive or NaN.
        std_err / value
    };
    let errors = fused.iter().zip(&values).zip(&jumps).map(relative).collect();
    DepthMap::from_data(w, h, values.iter().map(|v| 1.0 / v).collect())
        .with_relative_std_err(errors)
}

impl SurfacesInView<'_> {
    /// Number of cameras that see a surface at a point, less that of those that see through it.
    fn votes(&self, [x, y]: [f32; 2], inverse: f32) -> i32 {
        let mut votes = 0;
        for (surface, pose) in self.surfaces.iter().zip(&self.poses) {
            let q = pose.point(&pose.rotated(x, y), inverse);
            let [px, py] = pose.pixel(&q);
            let (w, h) = (surface.camera.width, surface.camera.height);
            if !(px >= 0.0 && py >= 0.0 && px < w as f32 && py < h as f32) {
                continue;
            }
            let seen = surface.depths.values[py as usize * w + px as usize];
            let difference = inverse / q.z - seen;
            if difference.abs() <= self.tolerance {
                votes += 1;
            } else if difference > self.tolerance {
                votes -= 1;
            }
        }
        votes
    }
}

/// Whether more than half of the cameras have candidates, and all candidates are one surface: then no vote is
/// needed.
fn are_one_surface(candidates: &[FusionCandidate], cameras: usize, tolerance: f32) -> bool {
    let inverse = candidates.iter().map(|c| c.inverse);
    let (low, high) = inverse.fold((f32::INFINITY, 0.0_f32), |(l, h), v| (l.min(v), h.max(v)));
    2 * candidates.len() > cameras && high - low <= tolerance
}

/// Fuses candidates, the nearest first, on the nearest surface with enough votes.
fn elected(candidates: &[FusionCandidate], votes: &[i32], tolerance: f32) -> FusionCandidate {
    let most = votes.iter().copied().max().unwrap_or(0);
    if most < MIN_VOTES {
        return NOT_SEEN;
    }
    let first = votes.iter().position(|&v| v * ENOUGH >= most);
    mean_of(candidates, first.map(|first| candidates[first]), tolerance)
}

/// The mean of the candidates on the surface of `first`. Their errors are averaged as if fully correlated, since
/// they come from the same images.
fn mean_of(
    candidates: &[FusionCandidate],
    first: Option<FusionCandidate>,
    tolerance: f32,
) -> FusionCandidate {
    let Some(first) = first else { return NOT_SEEN };
    let (mut sum, mut squares, mut errors, mut count) = (0.0, 0.0, 0.0, 0.0);
    for c in candidates {
        let from_first = c.inverse - first.inverse;
        if from_first.abs() <= tolerance {
            (sum, squares) = (sum + from_first, squares + from_first * from_first);
            (errors, count) = (errors + c.std_err * c.std_err, count + 1.0);
        }
    }
    // `first` is one of the candidates, so the count is not 0.
    let mean = sum / count;
    let variance = (squares / count - mean * mean).max(0.0) + errors / count;
    FusionCandidate { inverse: first.inverse + mean, std_err: variance.sqrt() }
}

/// Fills NaN with the farthest of the nearest values to the left, to the right, above and below: what the cameras
/// don't see lies behind.
fn fill_from_background(values: &mut [f32], width: usize) {
    let height = values.len() / width;
    let mut filled = values.to_vec();
    let mut fill_along = |line: &mut dyn Iterator<Item = usize>| {
        let mut last = f32::NAN;
        for k in line {
            if values[k].is_nan() {
                // `min` ignores NaN.
                filled[k] = filled[k].min(last);
            } else {
                last = values[k];
            }
        }
    };
    for y in 0..height {
        let row = y * width..(y + 1) * width;
        fill_along(&mut row.clone());
        fill_along(&mut row.rev());
    }
    for x in 0..width {
        let column = (x..x + height * width).step_by(width);
        fill_along(&mut column.clone());
        fill_along(&mut column.rev());
    }
    values.copy_from_slice(&filled);
}

/// At every pixel, the largest difference to a pixel within [`OUTLINE_PX`].
fn depth_jumps(values: &[f32], width: usize) -> Vec<f32> {
    let height = values.len() / width;
    let around =
        |k: usize, size: usize| k.saturating_sub(OUTLINE_PX)..(k + OUTLINE_PX + 1).min(size);
    let of = |k: usize| {
        let (x, y) = (k % width, k / width);
        let mut largest = 0.0_f32;
        for v in around(y, height) {
            for u in around(x, width) {
                // `max` ignores NaN.
                largest = largest.max((values[v * width + u] - values[k]).abs());
            }
        }
        largest
    };
    (0..values.len()).into_par_iter().map(of).collect()
}

/// A camera's pixel, projected into the view.
struct Splat {
    /// Position in the view, pixels; NaN where the view doesn't see it.
    x: f32,
    y: f32,
    /// Size of a pixel of the view in pixels of the camera; at most 1.
    step: f32,
    /// Inverse depth in the view, 1/m.
    inverse: f32,
    /// Standard error, 1/m.
    std_err: f32,
}

/// The nearest surface of a camera at every pixel of the view, by splatting with a depth buffer.
fn splat(target: &Camera, surface: &Surface, tolerance: f32) -> Vec<FusionCandidate> {
    let (w, h) = (target.width, target.height);
    let camera = surface.camera;
    let pose = RelativePose::new(camera, target);
    let focal_ratio = (camera.focal_px() / target.focal_px()) as f32;
    let mut rays = RayRow::new(camera);
    let mut splats = Vec::with_capacity(surface.depths.values.len());
    for y in 0..camera.height {
        rays.set(y);
        for x in 0..camera.width {
            let k = y * camera.width + x;
            let (inverse, std_err) = (surface.depths.values[k], surface.depths.std_err[k]);
            let rotated = pose.rotated(rays.x[x] as f32, rays.y[x] as f32);
            let q = pose.point(&rotated, inverse);
            let [x, y] = pose.pixel(&q);
            // Behind the view q.z is not positive, and the pixel is NaN. Just before it, a pixel fills the view.
            let step = (q.z * focal_ratio).clamp(1.0 / w.max(h) as f32, 1.0);
            let scale = 1.0 / q.z;
            splats.push(Splat { x, y, step, inverse: inverse * scale, std_err: std_err * scale });
        }
    }
    let mut nearest = vec![0.0_f32; w * h];
    for_each_pixel(&splats, [w, h], |k, _, splat| nearest[k] = nearest[k].max(splat.inverse));
    let mut sums = vec![[0.0_f32; 3]; w * h];
    for_each_pixel(&splats, [w, h], |k, weight, splat| {
        if splat.inverse >= nearest[k] - tolerance {
            let [sum, errors, total] = sums[k];
            sums[k] =
                [sum + weight * splat.inverse, errors + weight * splat.std_err, total + weight];
        }
    });
    let mean = |[sum, errors, weight]: &[f32; 3]| {
        if *weight > 0.0 {
            FusionCandidate { inverse: sum / weight, std_err: errors / weight }
        } else {
            FusionCandidate::default()
        }
    };
    sums.iter().map(mean).collect()
}

/// Visits the pixels within the radius of each splat, with weights that fall bilinearly with distance.
fn for_each_pixel(splats: &[Splat], [w, h]: [usize; 2], mut visit: impl FnMut(usize, f32, &Splat)) {
    for splat in splats {
        let radius = RADIUS_PX / splat.step;
        // Pixels whose centres are within the radius. Casts round down, saturate, and give 0 for NaN.
        let span = |at: f32, size: usize| {
            (at + 0.5 - radius) as usize..((at + 0.5 + radius) as usize).min(size)
        };
        let weight = |at: f32, k: usize| 1.0 - (k as f32 + 0.5 - at).abs() * splat.step;
        let columns = span(splat.x, w);
        for v in span(splat.y, h) {
            let row_weight = weight(splat.y, v);
            for u in columns.clone() {
                visit(v * w + u, weight(splat.x, u) * row_weight, splat);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A point that one camera alone claims and another sees through is no surface: what is behind fills it.
    #[test]
    fn a_mismatch_where_no_camera_sees_anything_is_no_surface() {
        let [near, far] = [1.0, 0.5].map(|inverse| FusionCandidate { inverse, std_err: 0.01 });
        assert!(elected(&[near], &[0], 0.1).inverse.is_nan());
        assert!(elected(&[], &[], 0.1).inverse.is_nan());
        assert_eq!(elected(&[near], &[1], 0.1).inverse, 1.0);
        assert_eq!(elected(&[near, far], &[-1, 2], 0.1).inverse, 0.5);
        let mut values = vec![0.5, f32::NAN, 1.0];
        fill_from_background(&mut values, 3);
        assert_eq!(values, [0.5, 0.5, 1.0]);
    }
}
