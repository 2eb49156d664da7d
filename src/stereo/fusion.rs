//! Depth map of any view, fused from the depths of several cameras (Merrell et al., ICCV 2007). The cameras' depths are
//! splatted into the view. At each pixel of the view, each camera thus gives one candidate depth. Of the candidates
//! that enough cameras confirm, the nearest is taken.

use super::InverseDepths;
use super::relative_pose::RelativePose;
use crate::camera::Camera;
use crate::lumigraph::{DepthMap, RayRow};
use rayon::prelude::*;
use std::ops::Range;

/// A camera, and the inverse depths of its pixels.
#[derive(Clone, Copy, Debug)]
pub struct Surface<'a> {
    /// Lens and pose of the camera.
    pub camera: &'a Camera,
    /// Inverse depths of the camera's pixels.
    pub depths: &'a InverseDepths,
}

/// Number of pixels of the view that are fused at once, to limit memory. For eight cameras, about 60 MB are needed.
const BAND_PIXELS: usize = 1 << 20;
/// Radius of a splat, pixels of the view. Where the view magnifies the splatted camera's image, the radius is this
/// number of that camera's pixels instead.
const RADIUS_PX: f32 = 0.8;
/// Maximum ratio of the largest number of votes at a pixel to the number of votes of the accepted candidate depth. The
/// votes of a candidate are the cameras that confirm it, minus the cameras that contradict it ([`votes_of`]). The
/// nearest candidate within this ratio is accepted.
const MAX_VOTE_RATIO: i32 = 2;
/// Minimum number of votes ([`votes_of`]) of the best candidate depth at a pixel. If it has fewer, no candidate is
/// accepted, since mismatches beside outlines have few votes.
const MIN_VOTES: i32 = 1;

/// Computes the depth map of the view `target`, metres, from the depths of several cameras. Pixels that no camera sees
/// get the depth of the background around them.
pub fn fuse(target: &Camera, surfaces: &[Surface]) -> DepthMap {
    let tolerance = surfaces.iter().map(|s| s.depths.tolerance).fold(0.0, f32::max);
    let (w, h) = (target.width, target.height);
    let mut fused = vec![f32::NAN; w * h];
    let rows_at_once = (BAND_PIXELS / w.max(1)).max(1);
    for first in (0..h).step_by(rows_at_once) {
        let rows = first..(first + rows_at_once).min(h);
        let band = &mut fused[rows.start * w..rows.end * w];
        fuse_rows(target, surfaces, rows, tolerance, band);
    }
    let filled = filled_from_background(&fused, w);
    DepthMap::from_data(w, h, filled.iter().map(|v| 1.0 / v).collect())
}

/// Fuses the rows `rows` of the view. Writes inverse depths, 1/m, to `fused`, and NaN where no camera sees a surface.
/// `tolerance` is the maximum difference between two measurements of one surface, 1/m.
fn fuse_rows(
    target: &Camera,
    surfaces: &[Surface],
    rows: Range<usize>,
    tolerance: f32,
    fused: &mut [f32],
) {
    let poses: Vec<_> = surfaces.iter().map(|s| RelativePose::new(target, s.camera)).collect();
    let splat = |s: &Surface| splat(target, s, rows.clone(), tolerance);
    let splats: Vec<Vec<f32>> = surfaces.par_iter().map(splat).collect();
    let w = target.width;
    fused.par_chunks_mut(w).enumerate().for_each_init(
        || (RayRow::new(target), Vec::new(), Vec::new()),
        |(rays, candidates, votes), (y, fused)| {
            rays.set(rows.start + y);
            for (x, fused) in fused.iter_mut().enumerate() {
                candidates.clear();
                let splats = splats.iter().map(|s| s[y * w + x]);
                candidates.extend(splats.filter(|c| *c > 0.0));
                if are_one_surface(candidates, surfaces.len(), tolerance) {
                    *fused = mean_of(candidates, candidates[0], tolerance);
                    continue;
                }
                // The candidates are sorted by descending inverse depth, so that the nearest is first.
                candidates.sort_by(|a, b| b.total_cmp(a));
                let ray = [rays.x[x] as f32, rays.y[x] as f32];
                votes.clear();
                let own = candidates.iter().map(|c| votes_of(surfaces, &poses, tolerance, ray, *c));
                votes.extend(own);
                *fused = elect(candidates, votes, tolerance);
            }
        },
    );
}

/// Returns the number of votes for a surface at a point: the number of cameras that measure a surface at this depth,
/// minus the number of cameras that measure a farther surface behind the point. The point is on the view's ray (x, y,
/// 1), at the inverse depth `inverse`, 1/m. `poses` are the poses of the surfaces' cameras relative to the view.
fn votes_of(
    surfaces: &[Surface],
    poses: &[RelativePose],
    tolerance: f32,
    [x, y]: [f32; 2],
    inverse: f32,
) -> i32 {
    let vote = |(surface, pose): (&Surface, &RelativePose)| {
        let q = pose.point(&pose.rotated(x, y), inverse);
        let [px, py] = pose.pixel(&q);
        let (w, h) = (surface.camera.width, surface.camera.height);
        if !(px >= 0.0 && py >= 0.0 && px < w as f32 && py < h as f32) {
            return 0;
        }
        let seen = surface.depths.values[py as usize * w + px as usize];
        let difference = inverse / q.z - seen;
        i32::from(difference.abs() <= tolerance) - i32::from(difference > tolerance)
    };
    surfaces.iter().zip(poses).map(vote).sum()
}

/// Returns whether a pixel's candidates (inverse depths, 1/m) are clearly one surface, so that they are not compared
/// with the cameras' depths. This is the case if more than half of the cameras have a candidate, and all candidates
/// agree within the tolerance, 1/m.
fn are_one_surface(candidates: &[f32], cameras: usize, tolerance: f32) -> bool {
    let (low, high) =
        candidates.iter().fold((f32::INFINITY, 0.0_f32), |(l, h), v| (l.min(*v), h.max(*v)));
    2 * candidates.len() > cameras && high - low <= tolerance
}

/// Chooses the inverse depth of a pixel, 1/m, from its candidates, which are sorted with the nearest first. `votes` are
/// the numbers of votes of the candidates ([`votes_of`]). Takes the nearest candidate with sufficient votes
/// ([`MAX_VOTE_RATIO`]), and returns the mean of all candidates that differ from it by at most `tolerance`, 1/m. NaN if
/// no candidate has [`MIN_VOTES`].
fn elect(candidates: &[f32], votes: &[i32], tolerance: f32) -> f32 {
    let most = votes.iter().copied().max().unwrap_or(0);
    match votes.iter().position(|&v| v * MAX_VOTE_RATIO >= most) {
        Some(first) if most >= MIN_VOTES => mean_of(candidates, candidates[first], tolerance),
        _ => f32::NAN,
    }
}

/// Returns the mean of the candidates that differ from the value `first` by at most the tolerance. All are inverse
/// depths, 1/m.
fn mean_of(candidates: &[f32], first: f32, tolerance: f32) -> f32 {
    let (mut sum, mut count) = (0.0, 0.0);
    for c in candidates.iter().filter(|c| (*c - first).abs() <= tolerance) {
        (sum, count) = (sum + (c - first), count + 1.0);
    }
    first + sum / count
}

/// Fills holes: replaces each NaN by an inverse depth of the background. This is the smallest of the nearest known
/// values to the left, to the right, above and below. Surfaces that no camera sees are assumed to be background.
/// `width` is the length of a row.
fn filled_from_background(values: &[f32], width: usize) -> Vec<f32> {
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
    for row in 0..values.len() / width {
        fill_along(&mut (row * width..(row + 1) * width));
        fill_along(&mut (row * width..(row + 1) * width).rev());
    }
    for column in 0..width {
        fill_along(&mut (column..values.len()).step_by(width));
        fill_along(&mut (column..values.len()).step_by(width).rev());
    }
    filled
}

/// Surface point of a camera's pixel, projected into the view.
struct DepthSplat {
    /// Horizontal position of the surface point in the view, pixels; NaN if the view doesn't see the point.
    x: f32,
    y: f32,
    /// Side of a pixel of the view at the depth of the surface point, measured in pixels of the camera; at most 1.
    step: f32,
    /// Inverse depth of the surface point in the view, 1/m.
    inverse: f32,
}

/// Splats a camera's surface into the rows `rows` of the view, with a depth buffer. Returns the inverse depth of the
/// nearest part of the surface at every pixel, 1/m, row by row; 0 without a surface.
fn splat(target: &Camera, surface: &Surface, rows: Range<usize>, tolerance: f32) -> Vec<f32> {
    let (w, h) = (target.width, target.height);
    let camera = surface.camera;
    let pose = RelativePose::new(camera, target);
    let focal_ratio = (camera.focal_px() / target.focal_px()) as f32;
    let mut rays = RayRow::new(camera);
    let mut splats = Vec::with_capacity(surface.depths.values.len());
    for y in 0..camera.height {
        rays.set(y);
        for x in 0..camera.width {
            let inverse = surface.depths.values[y * camera.width + x];
            let rotated = pose.rotated(rays.x[x] as f32, rays.y[x] as f32);
            let q = pose.point(&rotated, inverse);
            let [x, y] = pose.pixel(&q);
            // Behind the view, q.z is not positive, and the pixel is NaN. Close in front of the view, a pixel of the
            // camera would fill the view, so that the size of a splat is bounded.
            let step = (q.z * focal_ratio).clamp(1.0 / w.max(h) as f32, 1.0);
            splats.push(DepthSplat { x, y, step, inverse: inverse * (1.0 / q.z) });
        }
    }
    let mut nearest = vec![0.0_f32; w * rows.len()];
    for_each_pixel(&splats, w, &rows, |k, _, splat| nearest[k] = nearest[k].max(splat.inverse));
    let mut sums = vec![[0.0_f32; 2]; w * rows.len()];
    for_each_pixel(&splats, w, &rows, |k, weight, splat| {
        if splat.inverse >= nearest[k] - tolerance {
            let [sum, total] = sums[k];
            sums[k] = [sum + weight * splat.inverse, total + weight];
        }
    });
    sums.iter().map(|[sum, weight]| if *weight > 0.0 { sum / weight } else { 0.0 }).collect()
}

/// Calls `visit` for all pixels within the radius of each splat, in the rows `rows` of a view with the width `w`.
/// Arguments of `visit` are the pixel's index in these rows, a weight, and the splat. The weight is bilinear: it falls
/// linearly with the horizontal and with the vertical distance from the splat's centre.
fn for_each_pixel(
    splats: &[DepthSplat],
    w: usize,
    rows: &Range<usize>,
    mut visit: impl FnMut(usize, f32, &DepthSplat),
) {
    for splat in splats {
        let radius = RADIUS_PX / splat.step;
        // The range contains the pixels whose centres are within the radius. Casts round down, saturate, and give 0 for
        // NaN.
        let span = |at: f32, range: &Range<usize>| {
            let first = (at + 0.5 - radius) as usize;
            first.max(range.start)..((at + 0.5 + radius) as usize).min(range.end)
        };
        let weight = |at: f32, k: usize| 1.0 - (k as f32 + 0.5 - at).abs() * splat.step;
        let columns = span(splat.x, &(0..w));
        for v in span(splat.y, rows) {
            let row_weight = weight(splat.y, v);
            for u in columns.clone() {
                visit((v - rows.start) * w + u, weight(splat.x, u) * row_weight, splat);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Checks that a candidate is rejected if only one camera measures it and another camera sees through it. The
    /// background's depth takes its place.
    #[test]
    fn a_mismatch_where_no_camera_sees_anything_is_no_surface() {
        let [near, far] = [1.0, 0.5];
        assert!(elect(&[near], &[0], 0.1).is_nan());
        assert!(elect(&[], &[], 0.1).is_nan());
        assert_eq!(elect(&[near], &[1], 0.1), 1.0);
        assert_eq!(elect(&[near, far], &[-1, 2], 0.1), 0.5);
        let values = vec![0.5, f32::NAN, 1.0];
        let values = filled_from_background(&values, 3);
        assert_eq!(values, [0.5, 0.5, 1.0]);
    }
}
