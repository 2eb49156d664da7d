//! Which cameras are compared, and whose clock is whose.

use super::{OffsetMethod, OffsetOptions};
use crate::capture::Capture;

/// The clock of each camera, the reference's being 0, and how many there are. The reference's
/// clock is that of all cameras that share one, if it does.
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

/// The pairs to estimate: every camera with its nearest ones, and with the nearest ones that stand
/// in other directions: motion along the epipolar lines of a grid's rows runs across those of its
/// columns, and of its diagonals, which connect the columns. For the paper's rung, with the
/// reference.
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
        // Both sides of a line, and ties of a grid: as many again as lie as near.
        let reach = others
            .get(options.neighbors.saturating_sub(1).min(others.len().wrapping_sub(1)))
            .map_or(0.0, |&b| to(b).norm());
        let near = others.partition_point(|&b| to(b).norm() <= reach * (1.0 + 1e-6));
        let mut chosen = others[..near].to_vec();
        for &b in &others[near..] {
            let aside =
                |n: &usize| to(b).normalize().dot(&to(*n).normalize()).abs() < MAX_ALIGNMENT;
            if chosen.len() < near + OTHER_DIRECTIONS && chosen.iter().all(aside) {
                chosen.push(b);
            }
        }
        pairs.extend(chosen.into_iter().map(|b| [a.min(b), a.max(b)]));
    }
    pairs.sort_unstable();
    pairs.dedup();
    pairs
}

/// The cosine between two baselines beyond which one shows hardly more than the other.
const MAX_ALIGNMENT: f64 = 0.9;
/// A column, and a diagonal.
const OTHER_DIRECTIONS: usize = 2;

/// `count` of the numbers below `n` at most, evenly spread.
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
