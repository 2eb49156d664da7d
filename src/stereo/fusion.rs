//! The one surface that all cameras agree on, in any view (Merrell et al., ICCV 2007).

use super::estimate::InverseDepths;
use super::relative::Relative;
use crate::camera::Camera;
use crate::lumigraph::{DepthMap, RayRow};
use rayon::prelude::*;

/// A camera and its depths.
#[derive(Clone, Copy, Debug)]
pub struct Surface<'a> {
    /// Lens and pose.
    pub camera: &'a Camera,
    /// Of its pixels.
    pub depths: &'a InverseDepths,
}

/// Farthest that a splat reaches, pixels: of the view, or of the camera where those are larger. Larger: surfaces
/// swell; smaller: slanted ones have holes.
const REACH_PX: f32 = 0.8;

/// A candidate is chosen before farther ones if this many times its votes are not fewer than the most. Larger:
/// mismatches float before surfaces; smaller: thin things that few cameras see vanish.
const ENOUGH: i32 = 2;

/// The fewest votes of a surface. Larger: what few cameras see is lost; smaller: mismatches beside outlines float
/// where no camera sees anything.
const MIN_VOTES: i32 = 1;

/// A surface of a view's pixel.
#[derive(Clone, Copy, Default)]
struct Candidate {
    /// 1/m; 0 where there is none.
    inverse: f32,
    /// Standard error, 1/m.
    std_err: f32,
}

/// The fused depths of a view, metres, with their standard errors. What no camera sees has the depth of what lies
/// behind it, and an infinite standard error.
pub fn fuse(target: &Camera, surfaces: &[Surface]) -> DepthMap {
    let tolerance = surfaces.iter().map(|s| s.depths.tolerance).fold(0.0, f32::max);
    let (w, h) = (target.width, target.height);
    let splats: Vec<Vec<Candidate>> =
        surfaces.par_iter().map(|s| splat(target, s, tolerance)).collect();
    let relatives: Vec<Relative> =
        surfaces.iter().map(|s| Relative::new(target, s.camera)).collect();
    let mut fused = vec![UNSEEN; w * h];
    fused.par_chunks_mut(w).enumerate().for_each_init(
        || (RayRow::new(target), Vec::new(), Vec::new()),
        |(rays, candidates, votes), (y, fused)| {
            rays.set(y);
            for (x, fused) in fused.iter_mut().enumerate() {
                let ray = [rays.x[x] as f32, rays.y[x] as f32];
                let at = splats.iter().map(|s| s[y * w + x]);
                candidates.clear();
                candidates.extend(at.filter(|c| c.inverse > 0.0));
                if are_one_surface(candidates, surfaces.len(), tolerance) {
                    *fused = mean_of(candidates, candidates.first().copied(), tolerance);
                    continue;
                }
                // The nearest first.
                candidates.sort_by(|a, b| b.inverse.total_cmp(&a.inverse));
                votes.clear();
                let vote = |c: &Candidate| vote(ray, c.inverse, surfaces, &relatives, tolerance);
                votes.extend(candidates.iter().map(vote));
                *fused = elected(candidates, votes, tolerance);
            }
        },
    );
    let mut values: Vec<f32> = fused.iter().map(|c| c.inverse).collect();
    fill(&mut values, w);
    let jumps = jumps(&values, w);
    let relative = |((c, value), jump): ((&Candidate, &f32), &f32)| {
        // Values are positive or NaN.
        if *jump > tolerance { c.std_err.hypot(OF_JUMP * jump) / value } else { c.std_err / value }
    };
    let errors = fused.iter().zip(&values).zip(&jumps).map(relative).collect();
    DepthMap::from_data(w, h, values.iter().map(|v| 1.0 / v).collect())
        .with_relative_std_err(errors)
}

/// What no camera sees.
const UNSEEN: Candidate = Candidate { inverse: f32::NAN, std_err: f32::INFINITY };

/// Standard error beside a jump, as a fraction of it: the pixel may belong to either surface. Larger and smaller:
/// standard errors at outlines are too large and too small.
const OF_JUMP: f32 = 0.5;

/// How far an outline may be off, pixels. Larger and smaller: as [`OF_JUMP`].
const OUTLINE_PX: usize = 2;

/// The largest difference to any pixel within [`OUTLINE_PX`], at every pixel.
fn jumps(values: &[f32], width: usize) -> Vec<f32> {
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

/// The mean of the candidates that are the same surface as the elected one. The nearest come first. Their
/// errors are not independent: they are of the same images.
fn elected(candidates: &[Candidate], votes: &[i32], tolerance: f32) -> Candidate {
    let most = votes.iter().copied().max().unwrap_or(0);
    if most < MIN_VOTES {
        return UNSEEN;
    }
    let first = votes.iter().position(|&v| v * ENOUGH >= most);
    mean_of(candidates, first.map(|first| candidates[first]), tolerance)
}

/// Whether the candidates of most of the cameras are one surface: then no vote decides anything.
fn are_one_surface(candidates: &[Candidate], cameras: usize, tolerance: f32) -> bool {
    let inverse = candidates.iter().map(|c| c.inverse);
    let (low, high) = inverse.fold((f32::INFINITY, 0.0_f32), |(l, h), v| (l.min(v), h.max(v)));
    2 * candidates.len() > cameras && high - low <= tolerance
}

/// The mean of the candidates that are the same surface as `first`.
fn mean_of(candidates: &[Candidate], first: Option<Candidate>, tolerance: f32) -> Candidate {
    let Some(first) = first else { return UNSEEN };
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
    Candidate { inverse: first.inverse + mean, std_err: variance.sqrt() }
}

/// Fills what no camera sees with the farther of the surfaces to the left and to the right, or above and
/// below: what is hidden lies behind.
fn fill(values: &mut [f32], width: usize) {
    let height = values.len() / width;
    let mut filled = values.to_vec();
    let mut run = |line: Vec<usize>| {
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
        run((0..width).map(|x| y * width + x).collect());
        run((0..width).rev().map(|x| y * width + x).collect());
    }
    for x in 0..width {
        run((0..height).map(|y| y * width + x).collect());
        run((0..height).rev().map(|y| y * width + x).collect());
    }
    values.copy_from_slice(&filled);
}

/// How many cameras see a surface at this point, less those that see through it.
fn vote(
    [x, y]: [f32; 2],
    inverse: f32,
    surfaces: &[Surface],
    relatives: &[Relative],
    tolerance: f32,
) -> i32 {
    let mut votes = 0;
    for (surface, relative) in surfaces.iter().zip(relatives) {
        let q = relative.point(&relative.turned(x, y), inverse);
        let [px, py] = relative.pixel(&q);
        let (w, h) = (surface.camera.width, surface.camera.height);
        if !(px >= 0.0 && py >= 0.0 && px < w as f32 && py < h as f32) {
            continue;
        }
        let seen = surface.depths.values[py as usize * w + px as usize];
        let difference = inverse / q.z - seen;
        if difference.abs() <= tolerance {
            votes += 1;
        } else if difference > tolerance {
            votes -= 1;
        }
    }
    votes
}

/// Where a pixel of a camera is in the view.
struct Place {
    /// Pixels; NaN where the view doesn't see it.
    x: f32,
    y: f32,
    /// Pixels of the camera that a pixel of the view is wide; at most 1.
    step: f32,
    /// In the view, 1/m.
    inverse: f32,
    /// 1/m.
    std_err: f32,
}

/// The nearest surface of a camera at every pixel of the view.
fn splat(target: &Camera, surface: &Surface, tolerance: f32) -> Vec<Candidate> {
    let (w, h) = (target.width, target.height);
    let camera = surface.camera;
    let relative = Relative::new(camera, target);
    let reduced = (camera.focal_px() / target.focal_px()) as f32;
    let mut rays = RayRow::new(camera);
    let mut places = Vec::with_capacity(surface.depths.values.len());
    for y in 0..camera.height {
        rays.set(y);
        for x in 0..camera.width {
            let k = y * camera.width + x;
            let (inverse, std_err) = (surface.depths.values[k], surface.depths.std_err[k]);
            let turned = relative.turned(rays.x[x] as f32, rays.y[x] as f32);
            let q = relative.point(&turned, inverse);
            let [px, py] = relative.pixel(&q);
            // Behind the view q.z is not positive, and the pixel is NaN. Just before it, a pixel fills the view.
            let (step, scale) = ((q.z * reduced).clamp(1.0 / w.max(h) as f32, 1.0), 1.0 / q.z);
            let (inverse, std_err) = (inverse * scale, std_err * scale);
            places.push(Place { x: px, y: py, step, inverse, std_err });
        }
    }
    let mut nearest = vec![0.0_f32; w * h];
    each_reached(&places, [w, h], |k, _, place| nearest[k] = nearest[k].max(place.inverse));
    let mut sums = vec![[0.0_f32; 3]; w * h];
    each_reached(&places, [w, h], |k, near, place| {
        if place.inverse >= nearest[k] - tolerance {
            let [sum, errors, weight] = sums[k];
            sums[k] = [sum + near * place.inverse, errors + near * place.std_err, weight + near];
        }
    });
    let mean = |[sum, errors, weight]: &[f32; 3]| {
        if *weight > 0.0 {
            Candidate { inverse: sum / weight, std_err: errors / weight }
        } else {
            Candidate::default()
        }
    };
    sums.iter().map(mean).collect()
}

/// The pixels that each place reaches, with a weight by nearness.
fn each_reached(places: &[Place], [w, h]: [usize; 2], mut act: impl FnMut(usize, f32, &Place)) {
    for place in places {
        let reach = REACH_PX / place.step;
        // Pixels whose centres are nearer than that. Casts round down, saturate, and give 0 for NaN.
        let span = |at: f32, size: usize| {
            (at + 0.5 - reach) as usize..((at + 0.5 + reach) as usize).min(size)
        };
        let near = |at: f32, k: usize| 1.0 - (k as f32 + 0.5 - at).abs() * place.step;
        let columns = span(place.x, w);
        for v in span(place.y, h) {
            let near_row = near(place.y, v);
            for u in columns.clone() {
                act(v * w + u, near(place.x, u) * near_row, place);
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
        let [near, far] = [1.0, 0.5].map(|inverse| Candidate { inverse, std_err: 0.01 });
        assert!(elected(&[near], &[0], 0.1).inverse.is_nan());
        assert!(elected(&[], &[], 0.1).inverse.is_nan());
        assert_eq!(elected(&[near], &[1], 0.1).inverse, 1.0);
        assert_eq!(elected(&[near, far], &[-1, 2], 0.1).inverse, 0.5);
        let mut values = vec![0.5, f32::NAN, 1.0];
        fill(&mut values, 3);
        assert_eq!(values, [0.5, 0.5, 1.0]);
    }
}
