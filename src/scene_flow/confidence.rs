//! Whether the maps of a view's frames agree.

use super::geometry::Projection;
use super::map::MappedFrame;
use rayon::prelude::*;

/// Frames farther away in time confirm nothing.
const MAX_CONFIRMING_DT: f32 = 0.8;
/// Largest difference in disparity between an element and the one that confirms it, pixels.
const MAX_DISPARITY_ERROR_PX: f32 = 1.5;
/// Largest difference of their velocities, pixels a frame, without the part by [`MAX_MOTION_ERROR`].
const MAX_MOTION_ERROR_PX: f32 = 2.0;
/// The part of the largest difference of velocities that grows with the speed, as a fraction of it.
const MAX_MOTION_ERROR: f32 = 0.15;
/// Weight of a map in which something is in front of the element, where a map that contradicts the element has weight 1.
const HIDDEN: f32 = 0.3;
/// Number of confirming maps that is added to those found, so that an element that no map could confirm has a confidence.
const PRIOR_CONFIRMED: f32 = 0.1;
/// Number of all maps that is added to those found.
const PRIOR_ALL: f32 = 0.5;

/// For each pixel of each map, the fraction of the other maps near in time that confirm it, of those that could: 1 to 255,
/// which is all of them.
///
/// Frames on both sides of an instant must agree on what lies between them. So a set of frames around an instant gives
/// better confidences than all frames near one of them, by 1 dB.
pub fn confidences(mapped: &[MappedFrame]) -> Vec<Vec<u8>> {
    (0..mapped.len()).into_par_iter().map(|of| confidence(mapped, of)).collect()
}

fn confidence(mapped: &[MappedFrame], of: usize) -> Vec<u8> {
    let MappedFrame { frame, map: own } = mapped[of];
    let (mut confirmed, mut all) =
        (vec![0.0f32; own.pixels().len()], vec![0.0f32; own.pixels().len()]);
    for (other, MappedFrame { frame: by, map }) in mapped.iter().enumerate() {
        let dt = (by.time - frame.time) as f32;
        let projection = Projection::new(&frame.view, &by.view);
        let Some(projection) = projection.filter(|_| other != of && dt.abs() <= MAX_CONFIRMING_DT)
        else {
            continue;
        };
        for (k, pixel) in own.pixels().iter().enumerate() {
            let [x, y] = own.center(k);
            let ([u, v], here) = own.element(pixel).transferred(x, y, dt, &projection);
            let is_inside = u >= 0.0 && v >= 0.0 && u < map.width as f32 && v < map.height as f32;
            if !is_inside {
                continue;
            }
            let there = map.element(&map.pixels()[v as usize * map.width + u as usize]);
            let disparity = (there.inverse_depth - here.inverse_depth) * own.disparity_px;
            let [du, dv] = [0, 1].map(|c| there.velocity[c] - here.velocity[c]);
            let motion = (du * du + dv * dv).sqrt();
            let max_motion = MAX_MOTION_ERROR_PX + MAX_MOTION_ERROR * here.speed();
            if disparity.abs() < MAX_DISPARITY_ERROR_PX && motion < max_motion {
                confirmed[k] += 1.0;
                all[k] += 1.0;
            } else if disparity < MAX_DISPARITY_ERROR_PX {
                all[k] += 1.0;
            } else {
                all[k] += HIDDEN;
            }
        }
    }
    let fraction = |(c, a): (&f32, &f32)| (c + PRIOR_CONFIRMED) / (a + PRIOR_ALL);
    let rounded = |f: f32| (255.0 * f).round().clamp(1.0, 255.0) as u8;
    confirmed.iter().zip(&all).map(fraction).map(rounded).collect()
}
