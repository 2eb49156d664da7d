//! A map's elements moved to an instant and projected into a view.

use super::geometry::Projection;
use super::map::MappedFrame;
use crate::camera::Camera;
use nalgebra::Point2;

/// Half-width of a splat, pixels of the frame: neighbours overlap a little.
const HALF_WIDTH: f32 = 0.55;
/// Half-width towards a neighbour on another surface.
const HALF_WIDTH_AT_EDGE: f32 = 0.5;
/// Smallest and largest size of a splat, as multiples of its size in the frame.
const SCALES: [f32; 2] = [0.8, 8.0];
/// Disparity by which an element must be nearer to hide another, pixels.
const HIDING_PX: f32 = 0.5;

/// What a map has at a pixel of the view.
#[derive(Clone, Copy, Default)]
pub struct SplatPixel {
    /// In the view, 1/m.
    pub inverse_depth: f32,
    /// Where the frame shows it, pixels.
    pub source: [f32; 2],
    /// 0 where the map has nothing.
    pub confidence: f32,
    /// Pixels a frame.
    pub speed: f32,
    /// Distance from the splat's centre, pixels.
    distance: f32,
}

/// A map, with its confidences, in a view at an instant, frames of the reference since the capture's start: one candidate
/// a pixel of the view. `None` if the frame's camera has no inverse.
pub fn splat(
    mapped: MappedFrame,
    confidences: &[u8],
    view: &Camera,
    time: f64,
) -> Option<Vec<SplatPixel>> {
    let MappedFrame { frame, map } = mapped;
    let projection = Projection::new(&frame.view, view)?;
    let (width, height) = (view.width, view.height);
    let mut candidates = vec![SplatPixel::default(); width * height];
    let dt = (time - frame.time) as f32;
    let zoom = (view.focal_px() / frame.view.focal_px()) as f32;
    let hiding = HIDING_PX / map.disparity_px;
    let is_pinhole = view.model.is_pinhole();
    for (k, pixel) in map.pixels().iter().enumerate() {
        if frame.is_filmed.as_ref().is_some_and(|is_filmed| !is_filmed[k]) {
            continue;
        }
        let element = map.element(pixel);
        let (px, py) = ((k % map.width) as f32 + 0.5, (k / map.width) as f32 + 0.5);
        let [mx, my, q] = element.moved(px, py, dt);
        let [mut cx, mut cy, inverse_depth] = projection.project(mx, my, q);
        if !is_pinhole {
            let Some([x, y]) = distorted(view, [cx, cy]) else { continue };
            (cx, cy) = (x, y);
        }
        // Inverse depths that a rate has made negative are behind the camera.
        let nearing = inverse_depth / q.max(f32::MIN_POSITIVE);
        let scale = zoom * nearing.clamp(SCALES[0], SCALES[1]);
        let is_near =
            cx > -scale && cy > -scale && cx < width as f32 + scale && cy < height as f32 + scale;
        if !is_near || inverse_depth <= 0.0 {
            continue;
        }
        let half =
            |side: usize| scale * if pixel.is_edge(side) { HALF_WIDTH_AT_EDGE } else { HALF_WIDTH };
        let columns = pixels_between(cx - half(0), cx + half(1), width);
        let rows = pixels_between(cy - half(2), cy + half(3), height);
        for v in rows {
            for u in columns.clone() {
                let (dx, dy) = (u as f32 + 0.5 - cx, v as f32 + 0.5 - cy);
                let distance = dx.abs().max(dy.abs());
                let old = &mut candidates[v * width + u];
                let is_same = inverse_depth > old.inverse_depth - hiding && distance < old.distance;
                if old.confidence == 0.0 || inverse_depth > old.inverse_depth + hiding || is_same {
                    *old = SplatPixel {
                        inverse_depth,
                        source: [px + dx / scale, py + dy / scale],
                        confidence: f32::from(confidences[k]) / 255.0,
                        speed: element.speed(),
                        distance,
                    };
                }
            }
        }
    }
    Some(candidates)
}

/// A pixel of a pinhole camera as the view's lens distorts it. `None` beyond the fold of its model.
fn distorted(view: &Camera, [x, y]: [f32; 2]) -> Option<[f32; 2]> {
    let (fx, fy, cx, cy) = view.model.intrinsics();
    let ideal = Point2::new((f64::from(x) - cx) / fx, (f64::from(y) - cy) / fy);
    if !view.model.is_short_of_fold(&ideal) {
        return None;
    }
    let pixel = view.model.pixel_from_normalized(&ideal);
    Some([pixel.x as f32, pixel.y as f32])
}

/// The pixels whose centres lie between two positions, or on the second.
#[inline(always)]
fn pixels_between(from: f32, to: f32, size: usize) -> std::ops::Range<usize> {
    // Casts saturate: what is left of the image begins and ends at 0.
    (from + 0.5) as usize..((to + 0.5) as usize).min(size)
}
