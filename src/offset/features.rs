//! Which features are worth following: those whose surroundings change from frame to frame. What
//! rests says nothing about time, and in front of a textured wall it would be all that is chosen.

use crate::raster::Image;
use crate::registration::Frame;
use nalgebra::Point2;

/// The least motion that counts as change, pixels, by the gradient's measure: what noise makes of
/// good texture stays below it.
const MIN_MOTION_PX: f32 = 0.3;
/// Half the side of the window that is looked at, pixels.
const RADIUS: usize = 4;
/// Corners that are kept whether something changes there or not: so that a film in which nothing
/// moves is told from one without features.
const AT_REST: usize = 64;

/// Of an image's corners, `count` at most, strongest first, of those around which the image changes;
/// and a few of the others.
pub fn changing(
    frame: &Frame,
    next: &Frame,
    corners: &[Point2<f64>],
    count: usize,
) -> Vec<Point2<f64>> {
    let change = Change { now: frame.image.to_gray(), then: next.image.to_gray() };
    let (mut chosen, rest): (Vec<_>, Vec<_>) =
        corners.iter().copied().partition(|p| change.motion_px(p) >= MIN_MOTION_PX);
    chosen.truncate(count);
    let others = AT_REST.min(count - chosen.len());
    chosen.extend(rest.into_iter().take(others));
    chosen
}

struct Change {
    now: Image,
    then: Image,
}

impl Change {
    /// The root of the window's mean squared change over its mean squared gradient: what a motion
    /// along the gradients would be, if it is small; 0 without a gradient.
    fn motion_px(&self, p: &Point2<f64>) -> f32 {
        let (w, h) = (self.now.width(), self.now.height());
        // A corner is inside the image, its neighbours are made to be.
        let range = |at: f64, size: usize| {
            let middle = at as usize;
            middle.saturating_sub(RADIUS).max(1)..(middle + RADIUS + 1).min(size.saturating_sub(1))
        };
        let (mut change, mut gradient) = (0.0, 0.0);
        let now = self.now.data();
        let then = self.then.data();
        for y in range(p.y, h) {
            for x in range(p.x, w) {
                let at = y * w + x;
                change += (then[at] - now[at]).powi(2);
                let (dx, dy) = (now[at + 1] - now[at - 1], now[at + w] - now[at - w]);
                // Central differences are over two pixels, and a motion has one direction of two.
                gradient += 0.125 * (dx * dx + dy * dy);
            }
        }
        if gradient > 0.0 { (change / gradient).sqrt() } else { 0.0 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::registration::RegistrationOptions;

    /// Texture whose right half moves by `dx`.
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
    fn what_moves_comes_first_and_some_of_the_rest_follows() {
        let options = RegistrationOptions::default();
        let (now, then) = (frame(0.0), frame(1.5));
        let corners = now.corners(&options);
        let right = corners.iter().filter(|p| p.x > 70.0).count();
        let left = corners.iter().filter(|p| p.x < 58.0).count();
        assert!(right > 80 && left > AT_REST);
        let chosen = changing(&now, &then, corners, 4000);
        assert!(chosen.iter().filter(|p| p.x > 70.0).count() == right);
        assert!(chosen[..right].iter().all(|p| p.x > 58.0));
        assert!(chosen.iter().filter(|p| p.x < 58.0).count() <= AT_REST);
        assert_eq!(changing(&now, &then, corners, 10)[..], chosen[..10]);
        assert_eq!(changing(&now, &now, corners, 4000).len(), AT_REST);
    }
}
