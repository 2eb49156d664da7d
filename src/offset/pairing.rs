//! Which cameras form pairs, and which cameras share a clock.

use super::{OffsetMethod, OffsetOptions};
use crate::capture::Capture;

/// The index of each camera's clock, and the number of clocks.
///
/// The reference camera has clock 0. All cameras whose clock is marked as shared have the same one,
/// that of the reference if its clock is shared too; every other camera has a clock of its own.
pub fn clocks(capture: &Capture) -> (Vec<usize>, usize) {
    let reference_shares = capture.cameras[capture.reference].clock.shared;
    let mut next = 1;
    let mut shared = reference_shares.then_some(0);
    let mut clock = Vec::with_capacity(capture.cameras.len());
    for (c, camera) in capture.cameras.iter().enumerate() {
        let mut fresh = || {
            next += 1;
            next - 1
        };
        clock.push(if c == capture.reference {
            0
        } else if camera.clock.shared {
            *shared.get_or_insert_with(fresh)
        } else {
            fresh()
        });
    }
    (clock, next)
}

/// The pairs of cameras to estimate, as ascending pairs of indices in ascending order.
///
/// Every camera is paired with its `neighbors` nearest cameras, those at equal distances included, and
/// with the nearest ones in other directions: motion along the epipolar lines of a grid's rows runs
/// across those of its columns and of its diagonals, which connect the columns. For
/// [`OffsetMethod::Pairwise`] every camera is paired with the reference alone (§7). Cameras that share
/// a clock or a centre form no pair.
pub fn pairs(capture: &Capture, clock: &[usize], options: &OffsetOptions) -> Vec<[usize; 2]> {
    let centers: Vec<_> = capture.cameras.iter().map(|c| c.camera.center()).collect();
    let mut pairs: Vec<[usize; 2]> = Vec::new();
    for a in 0..centers.len() {
        let to = |b: usize| centers[b] - centers[a];
        let mut others: Vec<usize> =
            (0..centers.len()).filter(|&b| clock[a] != clock[b] && to(b).norm() > 0.0).collect();
        if options.method == OffsetMethod::Pairwise {
            others.retain(|&b| b == capture.reference);
        }
        others.sort_by(|&x, &y| to(x).norm().total_cmp(&to(y).norm()).then(x.cmp(&y)));
        // Ties count once: both sides of a line, all diagonals of a grid.
        let reach = others
            .get(options.neighbors.saturating_sub(1).min(others.len().wrapping_sub(1)))
            .map_or(0.0, |&b| to(b).norm());
        let near = others.partition_point(|&b| to(b).norm() <= reach * (1.0 + 1e-6));
        let mut chosen = others[..near].to_vec();
        for &b in &others[near..] {
            let is_other_direction =
                |n: &usize| to(b).normalize().dot(&to(*n).normalize()).abs() < MAX_ALIGNMENT;
            if chosen.len() < near + OTHER_DIRECTIONS && chosen.iter().all(is_other_direction) {
                chosen.push(b);
            }
        }
        pairs.extend(chosen.into_iter().map(|b| [a.min(b), a.max(b)]));
    }
    pairs.sort_unstable();
    pairs.dedup();
    pairs
}

/// The cosine between two baselines above which their epipolar lines count as parallel. Larger adds
/// pairs that see hardly more motion; smaller leaves a grid's diagonals out.
const MAX_ALIGNMENT: f64 = 0.9;
/// The number of further directions: a column and a diagonal. Larger costs time; smaller leaves the
/// columns of a grid unconnected where motion runs along the rows.
const OTHER_DIRECTIONS: usize = 2;

/// At most `count` of the numbers below `n`, ascending and evenly spread; all of them if there are no
/// more.
pub fn spread(n: usize, count: usize) -> Vec<usize> {
    if n <= count {
        return (0..n).collect();
    }
    (0..count).map(|k| (2 * k + 1) * n / (2 * count)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_are_spread_evenly() {
        assert_eq!(spread(3, 5), [0, 1, 2]);
        assert_eq!(spread(10, 5), [1, 3, 5, 7, 9]);
        assert!(spread(0, 5).is_empty() && spread(5, 0).is_empty());
    }
}
