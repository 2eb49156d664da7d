//! Selects the features to track: mostly corners around which the image changes between two frames.
//!
//! Static features give no candidate for the temporal offset (eq. (10)). In a scene with a textured background, the
//! strongest corners may all be static.

use crate::registration::{Frame, PyramidLevel};
use nalgebra::Point2;

/// The minimum motion around a feature that counts as a change, pixels. The motion is estimated from image gradients.
const MIN_MOTION_PX: f32 = 0.3;
/// The half-width of the window around a feature in which its motion is estimated, pixels.
const RADIUS: usize = 4;
/// The maximum number of static corners that are tracked besides the moving ones. Static corners only serve to
/// distinguish a recording without motion from a recording without features.
const MAX_STATIC: usize = 64;

/// Selects at most `count` corners to track: first the strongest corners around which the image changes from `frame`
/// to `next`, then up to 64 static corners.
///
/// `corners` are pixels inside the image, strongest first. Both groups keep this order.
pub fn changing(
    frame: &Frame,
    next: &Frame,
    corners: &[Point2<f64>],
    count: usize,
) -> Vec<Point2<f64>> {
    let [current, next] = [frame, next].map(|frame| &frame.pyramid.levels[0]);
    let (mut selected, mut static_corners) = (Vec::new(), Vec::new());
    for p in corners {
        if selected.len() == count {
            break;
        }
        let changes = motion_px([current, next], p) >= MIN_MOTION_PX;
        if changes { &mut selected } else { &mut static_corners }.push(*p);
    }
    let remaining = MAX_STATIC.min(count - selected.len());
    selected.extend(static_corners.into_iter().take(remaining));
    selected
}

/// Estimates the length of the motion between two frames in the window around the corner p (half-width [`RADIUS`]),
/// pixels; 0 if there is no gradient. The length is the square root of the summed squared temporal change divided by
/// the summed squared gradient.
fn motion_px([current, next]: [&PyramidLevel; 2], p: &Point2<f64>) -> f32 {
    // The corner is inside the image. The window is clipped so that its central differences stay inside too.
    let range = |at: f64, size: usize| {
        let middle = at as usize;
        middle.saturating_sub(RADIUS).max(1)..(middle + RADIUS + 1).min(size.saturating_sub(1))
    };
    let columns = range(p.x, current.width);
    let (mut change, mut gradient) = (0.0, 0.0);
    for y in range(p.y, current.height) {
        let [above, row, below] = [y - 1, y, y + 1].map(|y| current.row(y));
        let later = next.row(y);
        for x in columns.clone() {
            change += (later[x] - row[x]).powi(2);
            let (dx, dy) = (row[x + 1] - row[x - 1], below[x] - above[x]);
            // The factor is 1/4, since central differences span two pixels, times 1/2, since only one of two
            // directions is along the gradient.
            gradient += 0.125 * (dx * dx + dy * dy);
        }
    }
    if gradient > 0.0 { (change / gradient).sqrt() } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::raster::Image;
    use crate::registration::RegistrationOptions;

    /// Returns a textured frame. The texture of its right half is shifted by `dx` pixels to the right.
    fn frame(dx: f64) -> Frame {
        let value = |x: usize, y: usize| {
            let shift = if x >= 64 { dx } else { 0.0 };
            let (x, y) = (x as f64 - shift, y as f64);
            (0.5 + 0.2 * (0.9 * x).sin() * (0.7 * y).cos() + 0.1 * (0.31 * x + 0.47 * y).sin())
                as f32
        };
        let data = (0..128 * 96).map(|k| value(k % 128, k / 128)).collect();
        Frame::new(Image::from_data(128, 96, 1, data), &RegistrationOptions::default())
    }

    #[test]
    fn moving_corners_come_first_and_some_static_ones_follow() {
        let options = RegistrationOptions::default();
        let (current, next) = (frame(0.0), frame(1.5));
        let corners = current.corners(&options);
        let right = corners.iter().filter(|p| p.x > 70.0).count();
        let left = corners.iter().filter(|p| p.x < 58.0).count();
        assert!(right > 80 && left > MAX_STATIC);
        let selected = changing(&current, &next, corners, 4000);
        assert!(selected.iter().filter(|p| p.x > 70.0).count() == right);
        assert!(selected[..right].iter().all(|p| p.x > 58.0));
        assert!(selected.iter().filter(|p| p.x < 58.0).count() <= MAX_STATIC);
        assert_eq!(changing(&current, &next, corners, 10)[..], selected[..10]);
        assert_eq!(changing(&current, &current, corners, 4000).len(), MAX_STATIC);
    }
}
