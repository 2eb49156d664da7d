//! The candidates of many frame triples, computed in order of time.
//!
//! Pairs share cameras. In order of time, a frame that is read for one pair is still cached for the
//! other pairs of its group. Results do not depend on the order.

use super::pair::TripleFrames;
use super::recording::Recording;
use super::timeline::Timelines;
use crate::capture::CaptureError;
use rayon::prelude::*;
use std::collections::BTreeSet;

/// The frames of a camera that the tracks of an instant need: two of a track, and one before and one
/// after. Candidates of the instant before are computed at the same time. They need two more frames
/// where instants are not successive frames; such a frame may be decoded again. Larger splits rigs into
/// more groups, which decodes more frames again; smaller drops frames of an instant that is in work.
pub const FRAMES_AT_ONCE: usize = 4;

/// Computes the candidates of these triples, which the recording caches, in order of time by the
/// cameras' clocks. `computed` is called after each. Triples that are cached already are skipped.
pub fn compute_triples(
    recording: &Recording,
    mut triples: Vec<TripleFrames>,
    clocks_s: &[f64],
    computed: &(impl Fn() + Sync),
) -> Result<(), CaptureError> {
    triples.retain(|&(cameras, frames)| !recording.has_triple(cameras, frames));
    let tracks = |triples: &[TripleFrames]| {
        let needed: BTreeSet<_> = triples.iter().map(|([a, _], [k, _])| (*a, *k)).collect();
        needed.into_par_iter().try_for_each(|(a, k)| recording.tracks(a, k).map(drop))
    };
    let candidates = |triples: &[TripleFrames]| {
        triples.par_iter().try_for_each(|&(cameras, frames)| {
            recording.triple(cameras, frames)?;
            computed();
            Ok(())
        })
    };
    // The tracks of one instant beside the candidates of the one before, so that no thread waits.
    let mut before = Vec::new();
    for now in instants(&recording.timelines, triples, clocks_s) {
        let (candidates, tracks) = rayon::join(|| candidates(&before), || tracks(&now));
        candidates.and(tracks)?;
        before = now;
    }
    candidates(&before)
}

/// The triples by instant, in order of time: an instant is as long as the shortest frame period of
/// their cameras.
fn instants(
    timelines: &Timelines,
    triples: Vec<TripleFrames>,
    clocks_s: &[f64],
) -> Vec<Vec<TripleFrames>> {
    let cameras: BTreeSet<usize> = triples.iter().flat_map(|(cameras, _)| *cameras).collect();
    let periods_s = cameras.into_iter().map(|c| timelines.frame_s(c)).filter(|&s| s > 0.0);
    let period_s = periods_s.fold(f64::INFINITY, f64::min);
    let timed = |triple: TripleFrames| {
        let ([a, _], [k, _]) = triple;
        let time_s = timelines.times_s[a][k] + clocks_s[a];
        // Off the multiples of half a frame, near which rounding would split an instant.
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

    fn timelines(times_s: Vec<Vec<f64>>) -> Timelines {
        let lost_before = vec![Vec::new(); times_s.len()];
        Timelines { times_s, lost_before }
    }

    #[test]
    fn instants_are_as_long_as_the_shortest_frame_period() {
        let times = |n: usize, rate_hz: f64| (0..n).map(|k| k as f64 / rate_hz).collect();
        let timelines = timelines(vec![times(1, 1.0), times(3, 1.0), times(240, 120.0)]);
        let triples = (0..239).rev().map(|k| ([2, 1], [k, 0])).chain([([1, 2], [1, 0])]).collect();
        let instants = instants(&timelines, triples, &[0.0; 3]);
        assert_eq!(instants.len(), 239);
        for (k, instant) in instants.iter().enumerate() {
            let expected = [([1, 2], [1, 0]), ([2, 1], [k, 0])];
            assert_eq!(instant[..], expected[usize::from(k != 120)..]);
        }
    }

    #[test]
    fn triples_of_an_instant_are_in_order_of_time() {
        let timelines = timelines(vec![vec![0.0, 1.0, 2.0]; 3]);
        let triples = vec![([0, 1], [1, 0]), ([1, 2], [0, 0]), ([2, 0], [0, 0]), ([0, 1], [0, 0])];
        let instants = instants(&timelines, triples, &[0.3, 0.1, -0.8]);
        let first = vec![([1, 2], [0, 0]), ([0, 1], [0, 0])];
        assert_eq!(instants, [vec![([2, 0], [0, 0])], first, vec![([0, 1], [1, 0])]]);
    }

    #[test]
    fn single_frames_are_one_instant() {
        let timelines = timelines(vec![vec![5.0]; 2]);
        let triples = vec![([1, 0], [0, 0]), ([0, 1], [0, 0])];
        let sorted = vec![([0, 1], [0, 0]), ([1, 0], [0, 0])];
        assert_eq!(instants(&timelines, triples, &[0.0; 2]), [sorted]);
    }
}
