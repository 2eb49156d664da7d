//! §4.1: sparse flow between two frames, of one camera (temporal) or two (spatial), by the same
//! code; and the bidirectional temporal flow with its two labelled sets.

use super::{Frame, FrameStore, Guide, Neighbors, RegistrationOptions, Tracker, Trajectory};
use crate::capture::CaptureError;
use nalgebra::{Point2, Vector2};
use rayon::prelude::*;

/// A correspondence between two frames, pixels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Match {
    pub source: Point2<f64>,
    pub target: Point2<f64>,
    /// Mean absolute difference of the windows, values 0..=1.
    pub residual: f64,
    /// Distance from the source to where the target is tracked back to.
    pub back_error_px: f64,
}

/// Which run of the bidirectional flow found a correspondence. Eq. (9) warps the earlier frame
/// with what the forward run found, and the later one with what the backward run found.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Run {
    Forward,
    Backward,
    /// Both did, within the merging distance at both ends.
    Both,
}

/// A temporal correspondence of one camera between its frames k and k + 1, with the positions in
/// the frames around, where the feature could be followed.
#[derive(Clone, Debug, PartialEq)]
pub struct Track {
    pub run: Run,
    /// In frame k − 1.
    pub before: Option<Point2<f64>>,
    /// In frame k.
    pub earlier: Point2<f64>,
    /// In frame k + 1.
    pub later: Point2<f64>,
    /// In frame k + 2.
    pub after: Option<Point2<f64>>,
    pub residual: f64,
    pub back_error_px: f64,
}

impl Track {
    pub fn in_forward_set(&self) -> bool {
        self.run != Run::Backward
    }

    pub fn in_backward_set(&self) -> bool {
        self.run != Run::Forward
    }

    /// The motion from frame k to k + 1, pixels.
    pub fn motion(&self) -> Vector2<f64> {
        self.later - self.earlier
    }

    /// The track's path; `times_s` are the camera's frame times and `k` the earlier frame.
    pub fn path(&self, times_s: &[f64], k: usize) -> Option<Trajectory> {
        let before = self.before.zip(k.checked_sub(1)).map(|(p, k)| (times_s[k], p));
        let after = self.after.filter(|_| k + 2 < times_s.len()).map(|p| (times_s[k + 2], p));
        Trajectory::new(
            before
                .into_iter()
                .chain([(times_s[k], self.earlier), (times_s[k + 1], self.later)])
                .chain(after),
        )
    }
}

/// Pyramid levels on the way back, whose answer should be where it started: the coarse levels
/// would cost as much again and only help a track that is wrong.
const BACK_LEVELS: usize = 2;
/// Pyramid levels, there and back, where the neighbours tell where to look. More: small things in
/// large motion are pulled away by what is behind them; fewer: the neighbours must be nearer.
const GUIDED_LEVELS: [usize; 2] = [2, 2];
/// Guesses this near lead to the same place.
const SAME_GUESS_PX: f64 = 1.0;
/// How often those that are lost are sought again: each time, more neighbours are known.
const GUIDED_ROUNDS: usize = 2;
/// Pyramid levels of one frame further, where the motion tells where to look, and on the way back.
const NEXT_LEVELS: [usize; 2] = [2, 1];
/// Points are tracked in bands of this height, pixels. Larger: their windows don't fit the cache;
/// smaller: neither do those above and below.
const BAND_PX: f64 = 24.0;
/// Points tracked by one worker at a time.
const CHUNK: usize = 128;

/// Where a point is in the source, and where to look for it in the target; pixels.
pub type Start = (Point2<f64>, Point2<f64>);

/// Tracks points from one frame to another, each from its own starting guess, and back again;
/// `None` where a point is lost or does not come back to where it started.
pub fn flow(
    source: &Frame,
    target: &Frame,
    starts: &[Start],
    options: &RegistrationOptions,
) -> Vec<Option<Match>> {
    flow_over(source, target, starts, [options.klt.levels, BACK_LEVELS], options)
}

/// As [`flow`], on so many of the finest levels only, there and back.
pub(super) fn flow_over(
    source: &Frame,
    target: &Frame,
    starts: &[Start],
    [levels, back_levels]: [usize; 2],
    options: &RegistrationOptions,
) -> Vec<Option<Match>> {
    // Band by band, so that the windows of one point are still at hand for the next.
    let mut order: Vec<u32> = (0..starts.len() as u32).collect();
    order.sort_by_cached_key(|&k| {
        let p = starts[k as usize].0;
        ((p.y / BAND_PX) as i32, p.x as i32)
    });
    let found: Vec<Option<Match>> = order
        .par_chunks(CHUNK)
        .flat_map_iter(|chunk| {
            let mut tracker = Tracker::new(&options.klt);
            chunk
                .iter()
                .map(|&k| {
                    let (from, guess) = starts[k as usize];
                    let [source, target] = [&source.pyramid, &target.pyramid];
                    let found = tracker.track_over(source, target, from, guess, levels)?;
                    let to = found.position;
                    let back = tracker.track_levels(target, source, to, from, back_levels)?;
                    let back_error_px = (back.position - from).norm();
                    (back_error_px <= options.max_back_error_px).then_some(Match {
                        source: from,
                        target: found.position,
                        residual: found.residual,
                        back_error_px,
                    })
                })
                .collect::<Vec<_>>()
        })
        .collect();
    let mut in_order = vec![None; starts.len()];
    for (k, found) in order.into_iter().zip(found) {
        in_order[k as usize] = found;
    }
    in_order
}

/// §4.1: the bidirectional flow between frames `k` and `k + 1` of a camera, correspondences that
/// both runs found merged, each followed one frame further at both ends.
pub fn temporal_flow(
    frames: &FrameStore,
    camera: usize,
    k: usize,
) -> Result<Vec<Track>, CaptureError> {
    let options = frames.options();
    let (earlier, later) = (frames.get(camera, k)?, frames.get(camera, k + 1)?);
    let (of_earlier, of_later) =
        rayon::join(|| earlier.corners(options), || later.corners(options));
    temporal_flow_of(frames, camera, k, [of_earlier, of_later])
}

/// As [`temporal_flow`], of given points instead of corners: of frame `k`, and of frame `k + 1`.
pub fn temporal_flow_of(
    frames: &FrameStore,
    camera: usize,
    k: usize,
    [of_earlier, of_later]: [&[Point2<f64>]; 2],
) -> Result<Vec<Track>, CaptureError> {
    let options = frames.options();
    let (earlier, later) = (frames.get(camera, k)?, frames.get(camera, k + 1)?);
    let forward = run(&earlier, &later, of_earlier, options);
    let backward = run(&later, &earlier, of_later, options);
    let mut tracks = merged(&forward, &backward, options.merge_distance_px);
    let mut agreeing = agreeing(&tracks, options).into_iter();
    tracks.retain(|_| agreeing.next().unwrap_or(true));

    let count = frames.capture().cameras[camera].frames.len();
    if let Some(before) = k.checked_sub(1) {
        let frame = frames.get(camera, before)?;
        let guess = |t: &Track| t.earlier - t.motion();
        for (track, p) in extended(&tracks, &earlier, &frame, |t| t.earlier, guess, options) {
            tracks[track].before = Some(p);
        }
    }
    if k + 2 < count {
        let frame = frames.get(camera, k + 2)?;
        let guess = |t: &Track| t.later + t.motion();
        for (track, p) in extended(&tracks, &later, &frame, |t| t.later, guess, options) {
            tracks[track].after = Some(p);
        }
    }
    Ok(tracks)
}

/// One run of the bidirectional flow: the source's points, sought where they are, and then, those
/// that were lost or move like none of their neighbours, where their neighbours went.
fn run(
    source: &Frame,
    target: &Frame,
    corners: &[Point2<f64>],
    options: &RegistrationOptions,
) -> Vec<Match> {
    let starts: Vec<_> = corners.iter().map(|&p| (p, p)).collect();
    let mut found = flow(source, target, &starts, options);
    let mut tried = vec![None; corners.len()];
    for _ in 0..GUIDED_ROUNDS {
        let mut again = guided_by_neighbors(corners, &found, options);
        again.retain(|(k, start)| is_new(&mut tried[*k], start.1));
        if again.is_empty() {
            break;
        }
        let starts: Vec<_> = again.iter().map(|(_, start)| *start).collect();
        let retried = flow_over(source, target, &starts, GUIDED_LEVELS, options);
        for ((k, _), retried) in again.iter().zip(retried) {
            let Some(retried) = retried else { continue };
            if found[*k].is_none_or(|first| retried.residual < first.residual) {
                found[*k] = Some(retried);
            }
        }
    }
    found.into_iter().flatten().collect()
}

/// Whether a guess is not the one that was tried before, which would find the same; keeps it.
pub(super) fn is_new(tried: &mut Option<Point2<f64>>, guess: Point2<f64>) -> bool {
    let before = tried.replace(guess);
    before.is_none_or(|before| (guess - before).norm() > SAME_GUESS_PX)
}

/// Where to look for the points that were lost, or that move like none of their neighbours; those
/// that no neighbour tells of are left out.
fn guided_by_neighbors(
    corners: &[Point2<f64>],
    found: &[Option<Match>],
    options: &RegistrationOptions,
) -> Vec<(usize, Start)> {
    let motions: Vec<_> = found.iter().flatten().map(|m| (m.source, m.target - m.source)).collect();
    let agrees = votes(&motions, options);
    let trusted: Vec<_> = motions
        .iter()
        .zip(&agrees)
        .filter_map(|(motion, agrees)| agrees.then_some(*motion))
        .collect();
    let guide = Guide::new(&trusted);
    let mut agrees = agrees.into_iter();
    (0..corners.len())
        .filter(|&k| found[k].is_none() || !agrees.next().unwrap_or(true))
        .filter_map(|k| {
            let motion = guide.near(&corners[k], Guide::RADIUS_PX)?;
            Some((k, (corners[k], corners[k] + motion)))
        })
        .collect()
}

/// Where tracks go one frame further, as (track, position); only where the change of motion is
/// one that a body makes, not a mismatch.
fn extended(
    tracks: &[Track],
    source: &Frame,
    target: &Frame,
    from: impl Fn(&Track) -> Point2<f64>,
    guess: impl Fn(&Track) -> Point2<f64>,
    options: &RegistrationOptions,
) -> Vec<(usize, Point2<f64>)> {
    let starts: Vec<_> = tracks.iter().map(|t| (from(t), guess(t))).collect();
    flow_over(source, target, &starts, NEXT_LEVELS, options)
        .into_iter()
        .enumerate()
        .filter_map(|(k, found)| {
            let position = found?.target;
            let change = (position - starts[k].1).norm();
            let limit = options.max_motion_change_px
                + options.max_motion_change_share * tracks[k].motion().norm();
            (change <= limit).then_some((k, position))
        })
        .collect()
}

/// Both runs' correspondences, those found twice kept once.
fn merged(forward: &[Match], backward: &[Match], distance_px: f64) -> Vec<Track> {
    let track = |run, m: &Match| {
        let (earlier, later) =
            if run == Run::Backward { (m.target, m.source) } else { (m.source, m.target) };
        Track {
            run,
            before: None,
            earlier,
            later,
            after: None,
            residual: m.residual,
            back_error_px: m.back_error_px,
        }
    };
    let mut tracks: Vec<Track> = forward.iter().map(|m| track(Run::Forward, m)).collect();
    let at_earlier = Neighbors::new(forward.iter().map(|m| m.source));
    for m in backward {
        let twin = at_earlier
            .within(&m.target, distance_px)
            .into_iter()
            .filter(|&k| (forward[k].target - m.source).norm() <= distance_px)
            .min_by(|&a, &b| {
                let gap = |k: usize| (forward[k].source - m.target).norm();
                gap(a).total_cmp(&gap(b))
            });
        match twin {
            Some(k) => tracks[k].run = Run::Both,
            None => tracks.push(track(Run::Backward, m)),
        }
    }
    tracks
}

/// For each track, whether it moves like some of its neighbours: a body has more than one feature.
/// True where there are too few to ask.
pub fn agreeing(tracks: &[Track], options: &RegistrationOptions) -> Vec<bool> {
    votes(&tracks.iter().map(|t| (t.earlier, t.motion())).collect::<Vec<_>>(), options)
}

/// The same of places and their motions.
fn votes(motions: &[(Point2<f64>, Vector2<f64>)], options: &RegistrationOptions) -> Vec<bool> {
    let neighbors = Neighbors::new(motions.iter().map(|(p, _)| *p));
    motions
        .par_iter()
        .enumerate()
        .map(|(k, (p, motion))| {
            let limit = options.support_px + options.support_share * motion.norm();
            let near = neighbors.unsorted_within(p, options.support_radius_px);
            let agreeing = near
                .iter()
                .filter(|&&n| n != k && (motions[n].1 - motion).norm() <= limit)
                .take(options.min_support)
                .count();
            near.len().saturating_sub(1) < options.min_support || agreeing >= options.min_support
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn a_match(x: f64, dx: f64) -> Match {
        Match {
            source: Point2::new(x, 10.0),
            target: Point2::new(x + dx, 10.0),
            residual: 0.01,
            back_error_px: 0.1,
        }
    }

    #[test]
    fn found_twice_is_kept_once_and_labelled() {
        let forward = [a_match(10.0, 3.0), a_match(20.0, 3.0)];
        // The first is the forward one reversed; the second starts there but goes elsewhere.
        let backward = [a_match(13.2, -3.1), a_match(23.1, -9.0)];
        let tracks = merged(&forward, &backward, 1.0);
        let runs: Vec<Run> = tracks.iter().map(|t| t.run).collect();
        assert_eq!(runs, [Run::Both, Run::Forward, Run::Backward]);
        assert!((tracks[2].earlier - Point2::new(14.1, 10.0)).norm() < 1e-9);
        assert!(tracks[0].in_backward_set() && !tracks[1].in_backward_set());
    }

    #[test]
    fn a_track_unlike_its_neighbours_is_dropped() {
        let matches: Vec<Match> =
            (0..9).map(|k| a_match(f64::from(k) * 4.0, if k == 4 { 30.0 } else { 5.0 })).collect();
        let mut tracks = merged(&matches, &[], 1.0);
        let mut keep = agreeing(&tracks, &RegistrationOptions::default()).into_iter();
        tracks.retain(|_| keep.next().unwrap());
        assert_eq!(tracks.len(), 8);
        assert!(tracks.iter().all(|t| (t.motion().x - 5.0).abs() < 1e-9));
    }

    #[test]
    fn paths_use_the_samples_that_exist() {
        let mut track = merged(&[a_match(10.0, 3.0)], &[], 1.0).remove(0);
        track.before = Some(Point2::new(8.0, 10.0));
        let times = [0.0, 1.0, 2.0];
        let curved = track.path(&times, 1).unwrap();
        assert!((curved.at(1.5).x - 11.375).abs() < 1e-12);
        // Frame 0 has no frame before it, whatever the track says.
        assert!((track.path(&times, 0).unwrap().at(0.5).x - 11.5).abs() < 1e-12);
    }
}
