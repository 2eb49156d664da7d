//! Computes the offset candidates of many frame triples (two frames of one camera, one frame of another) in order of
//! time, so that cached frames are reused.
//!
//! Several pairs share a camera. In order of time, a frame that is read for one pair is still cached when the other
//! pairs of its group need it. The results do not depend on the order.

use crate::capture::{CaptureError, Clock};
use crate::offset::recording::{Recording, TripleFrames};
use rayon::prelude::*;
use std::collections::BTreeSet;

/// The number of frames of a camera that are read to compute its tracks at one instant: the two frames between which
/// features are tracked, the frame before these two, and the frame after them.
pub const FRAMES_AT_ONCE: usize = 4;

/// Computes and caches the offset candidates of the frame triples (two frames of one camera, one frame of another)
/// that are not cached yet, in order of time.
///
/// `clocks_s` holds the offset of each camera's clock, seconds, with which the times of different cameras are
/// compared. `computed` is called after each triple. Returns an error if a frame cannot be read.
pub fn compute_triples(
    recording: &Recording,
    mut triples: Vec<TripleFrames>,
    clocks_s: &[f64],
    computed: &(impl Fn() + Sync),
) -> Result<(), CaptureError> {
    triples.retain(|&triple| !recording.has_triple(triple));
    let tracks = |triples: &[TripleFrames]| {
        let needed: BTreeSet<_> = triples.iter().map(|([a, _], [k, _])| (*a, *k)).collect();
        needed.into_par_iter().try_for_each(|(a, k)| recording.tracks(a, k).map(drop))
    };
    let candidates = |triples: &[TripleFrames]| {
        triples.par_iter().try_for_each(|&triple| {
            recording.triple(triple)?;
            computed();
            Ok(())
        })
    };
    // The tracks of one instant are computed in parallel with the candidates of the instant before, so that
    // no thread waits.
    let mut before = Vec::new();
    for now in instants(&recording.clocks, triples, clocks_s) {
        let (candidates, tracks) = rayon::join(|| candidates(&before), || tracks(&now));
        candidates.and(tracks)?;
        before = now;
    }
    candidates(&before)
}

/// Groups frame triples (two frames of one camera, one frame of another) by instant, in order of time. An instant is
/// an interval as long as the shortest frame period of the triples' cameras. `clocks_s` holds the offset of each
/// camera's clock, seconds.
fn instants(
    clocks: &[Clock],
    triples: Vec<TripleFrames>,
    clocks_s: &[f64],
) -> Vec<Vec<TripleFrames>> {
    let cameras: BTreeSet<usize> = triples.iter().flat_map(|(cameras, _)| *cameras).collect();
    let periods_s = cameras.into_iter().map(|c| clocks[c].frame_s()).filter(|&s| s > 0.0);
    let period_s = periods_s.fold(f64::INFINITY, f64::min);
    let timed = |triple: TripleFrames| {
        let ([a, _], [k, _]) = triple;
        let time_s = clocks[a].times_s[k] + clocks_s[a];
        // Times are often near multiples of half a frame period. A quarter period is added, so that rounding errors
        // do not put simultaneous triples into different instants.
        let instant = (time_s / period_s + 0.25).floor() as i64;
        (instant, time_s, triple)
    };
    let mut timed: Vec<_> = triples.into_iter().map(timed).collect();
    timed.sort_by(|x, y| x.0.cmp(&y.0).then(x.1.total_cmp(&y.1)).then(x.2.cmp(&y.2)));
    let instant = |timed: &[(i64, f64, TripleFrames)]| timed.iter().map(|t| t.2).collect();
    timed.chunk_by(|x, y| x.0 == y.0).map(instant).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn clocks(times_s: Vec<Vec<f64>>) -> Vec<Clock> {
        let clock = |times_s| Clock { times_s, ..Clock::default() };
        times_s.into_iter().map(clock).collect()
    }

    #[test]
    fn instants_are_as_long_as_the_shortest_frame_period() {
        let times = |n: usize, rate_hz: f64| (0..n).map(|k| k as f64 / rate_hz).collect();
        let clocks = clocks(vec![times(1, 1.0), times(3, 1.0), times(240, 120.0)]);
        let triples = (0..239).rev().map(|k| ([2, 1], [k, 0])).chain([([1, 2], [1, 0])]).collect();
        let instants = instants(&clocks, triples, &[0.0; 3]);
        assert_eq!(instants.len(), 239);
        for (k, instant) in instants.iter().enumerate() {
            let expected = [([1, 2], [1, 0]), ([2, 1], [k, 0])];
            assert_eq!(instant[..], expected[usize::from(k != 120)..]);
        }
    }

    #[test]
    fn triples_of_an_instant_are_in_order_of_time() {
        let clocks = clocks(vec![vec![0.0, 1.0, 2.0]; 3]);
        let triples = vec![([0, 1], [1, 0]), ([1, 2], [0, 0]), ([2, 0], [0, 0]), ([0, 1], [0, 0])];
        let instants = instants(&clocks, triples, &[0.3, 0.1, -0.8]);
        let first = vec![([1, 2], [0, 0]), ([0, 1], [0, 0])];
        assert_eq!(instants, [vec![([2, 0], [0, 0])], first, vec![([0, 1], [1, 0])]]);
    }

    #[test]
    fn single_frames_are_one_instant() {
        let clocks = clocks(vec![vec![5.0]; 2]);
        let triples = vec![([1, 0], [0, 0]), ([0, 1], [0, 0])];
        let sorted = vec![([0, 1], [0, 0]), ([1, 0], [0, 0])];
        assert_eq!(instants(&clocks, triples, &[0.0; 2]), [sorted]);
    }
}
