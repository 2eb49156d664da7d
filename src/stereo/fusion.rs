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

/// Farthest that a splat reaches, pixels. Larger: surfaces swell; smaller: they have holes where the view is
/// nearer than the camera.
const REACH_PX: f32 = 0.8;

/// A candidate is chosen before farther ones if this many times its votes are not fewer than the most. Larger:
/// mismatches float before surfaces; smaller: thin things that few cameras see vanish.
const ENOUGH: i32 = 2;

/// The fused depths of a view, metres. What no camera sees has the depth of what lies behind it.
pub fn fuse(target: &Camera, surfaces: &[Surface]) -> DepthMap {
    let tolerance = surfaces.iter().map(|s| s.depths.tolerance).fold(0.0, f32::max);
    let (w, h) = (target.width, target.height);
    let splats: Vec<Vec<f32>> = surfaces.par_iter().map(|s| splat(target, s, tolerance)).collect();
    let relatives: Vec<Relative> =
        surfaces.iter().map(|s| Relative::new(target, s.camera)).collect();
    let mut values = vec![f32::NAN; w * h];
    values.par_chunks_mut(w).enumerate().for_each_init(
        || RayRow::new(target),
        |rays, (y, values)| {
            rays.set(target, y);
            for (x, value) in values.iter_mut().enumerate() {
                let ray = [rays.x[x] as f32, rays.y[x] as f32];
                let mut candidates: Vec<f32> =
                    splats.iter().map(|s| s[y * w + x]).filter(|c| *c > 0.0).collect();
                // The nearest first.
                candidates.sort_by(|a, b| b.total_cmp(a));
                let vote = |c: &f32| vote(ray, *c, surfaces, &relatives, tolerance);
                let votes: Vec<i32> = candidates.iter().map(vote).collect();
                *value = elected(&candidates, &votes, tolerance);
            }
        },
    );
    fill(&mut values, w);
    DepthMap::from_data(w, h, values.iter().map(|v| 1.0 / v).collect())
}

/// The mean of the candidates that are the same surface as the elected one, 1/m; NaN without any. The nearest
/// come first.
fn elected(candidates: &[f32], votes: &[i32], tolerance: f32) -> f32 {
    let most = votes.iter().copied().max().unwrap_or(0);
    let Some(first) = votes.iter().position(|&v| v == most || v * ENOUGH >= most.max(1)) else {
        return f32::NAN;
    };
    let (mut sum, mut count) = (0.0, 0.0);
    for c in candidates.iter().filter(|c| (**c - candidates[first]).abs() <= tolerance) {
        (sum, count) = (sum + c, count + 1.0);
    }
    // The elected one itself is among them.
    sum / count
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

/// The nearest surface of a camera at every pixel of the view, 1/m; 0 where there is none.
fn splat(target: &Camera, surface: &Surface, tolerance: f32) -> Vec<f32> {
    let (w, h) = (target.width, target.height);
    let camera = surface.camera;
    let relative = Relative::new(camera, target);
    let mut rays = RayRow::new(camera);
    let mut places = Vec::with_capacity(surface.depths.values.len());
    for y in 0..camera.height {
        rays.set(camera, y);
        for x in 0..camera.width {
            let inverse = surface.depths.values[y * camera.width + x];
            let turned = relative.turned(rays.x[x] as f32, rays.y[x] as f32);
            let q = relative.point(&turned, inverse);
            let [px, py] = relative.pixel(&q);
            places.push([px, py, inverse / q.z]);
        }
    }
    let mut nearest = vec![0.0_f32; w * h];
    each_reached(&places, [w, h], |k, _, inverse| nearest[k] = nearest[k].max(inverse));
    let (mut sum, mut weight) = (vec![0.0_f32; w * h], vec![0.0_f32; w * h]);
    each_reached(&places, [w, h], |k, near, inverse| {
        if inverse >= nearest[k] - tolerance {
            sum[k] += near * inverse;
            weight[k] += near;
        }
    });
    sum.iter().zip(&weight).map(|(s, w)| if *w > 0.0 { s / w } else { 0.0 }).collect()
}

/// The pixels that each place reaches, with a weight by nearness.
fn each_reached(places: &[[f32; 3]], [w, h]: [usize; 2], mut f: impl FnMut(usize, f32, f32)) {
    for &[px, py, inverse] in places {
        let (fx, fy) = ((px - 0.5).floor(), (py - 0.5).floor());
        for (cx, cy) in [(fx, fy), (fx + 1.0, fy), (fx, fy + 1.0), (fx + 1.0, fy + 1.0)] {
            let (dx, dy) = ((px - 0.5 - cx).abs(), (py - 0.5 - cy).abs());
            let inside = cx >= 0.0 && cy >= 0.0 && cx < w as f32 && cy < h as f32;
            if inside && dx < REACH_PX && dy < REACH_PX {
                f(cy as usize * w + cx as usize, (1.0 - dx) * (1.0 - dy), inverse);
            }
        }
    }
}
