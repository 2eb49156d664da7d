//! The moving part of an image: the pixels whose surface point moves.

use crate::raster::max_filter;

/// Returns the row-major mask of the pixels whose motion exceeds `threshold_px`. The mask is dilated by a square that
/// reaches `dilation_px` pixels in each direction.
///
/// `motion_px` holds the ground-truth motion of each pixel's surface point, row-major, pixels: the length of its
/// displacement in the image from the previous frame or to the next frame, whichever is larger. A pixel with non-finite
/// motion counts as static.
pub fn moving_part(
    motion_px: &[f32],
    width: usize,
    threshold_px: f32,
    dilation_px: usize,
) -> Vec<bool> {
    if width == 0 {
        return Vec::new();
    }
    let moves = |m: &f32| f32::from(m.is_finite() && *m > threshold_px);
    let moving: Vec<f32> = motion_px.iter().map(moves).collect();
    max_filter(&moving, width, dilation_px).into_iter().map(|m| m > 0.0).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn motion(at: &[(usize, usize, f32)]) -> Vec<f32> {
        let mut motion = vec![0.0; 10 * 8];
        for (x, y, m) in at {
            motion[y * 10 + x] = *m;
        }
        motion
    }

    #[test]
    fn one_moving_pixel_becomes_a_square_of_five() {
        let mask = moving_part(&motion(&[(4, 3, 0.51)]), 10, 0.5, 2);
        for y in 0..8usize {
            for x in 0..10usize {
                let near = x.abs_diff(4) <= 2 && y.abs_diff(3) <= 2;
                assert_eq!(mask[y * 10 + x], near, "{x} {y}");
            }
        }
    }

    #[test]
    fn borders_cut_the_square() {
        let mask = moving_part(&motion(&[(0, 7, 3.0)]), 10, 0.5, 2);
        assert_eq!(mask.iter().filter(|m| **m).count(), 9);
        assert!(mask[7 * 10] && mask[5 * 10 + 2] && !mask[5 * 10 + 3]);
    }

    #[test]
    fn what_moves_little_or_has_no_surface_stays_out() {
        let still = motion(&[(4, 3, 0.5), (5, 5, f32::NAN), (1, 1, f32::INFINITY)]);
        assert!(!moving_part(&still, 10, 0.5, 2).contains(&true));
        assert!(moving_part(&[], 0, 0.5, 2).is_empty());
    }
}
