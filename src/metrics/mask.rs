//! The moving part: pixels at which an unsynchronized camera differs from the truth.

/// Row-major mask of pixels whose surface point moves by more than `threshold_px` within ±1 frame,
/// dilated by a square of radius `dilation_px`.
///
/// `motion_px` is the truth's motion. Pixels with non-finite motion have no surface, and don't move.
pub fn moving_part(
    motion_px: &[f32],
    width: usize,
    threshold_px: f32,
    dilation_px: usize,
) -> Vec<bool> {
    let moves: Vec<bool> = motion_px.iter().map(|m| m.is_finite() && *m > threshold_px).collect();
    if width == 0 {
        return moves;
    }
    let along_rows: Vec<bool> = moves
        .chunks(width)
        .flat_map(|row| {
            (0..row.len()).map(|x| {
                let end = (x + dilation_px + 1).min(row.len());
                row[x.saturating_sub(dilation_px)..end].contains(&true)
            })
        })
        .collect();
    let height = moves.len() / width;
    (0..moves.len())
        .map(|k| {
            let (x, y) = (k % width, k / width);
            let end = (y + dilation_px + 1).min(height);
            (y.saturating_sub(dilation_px)..end).any(|y| along_rows[y * width + x])
        })
        .collect()
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
