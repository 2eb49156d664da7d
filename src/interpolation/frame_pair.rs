//! The image of a camera at an instant between two of its frames, by any [`SyncMethod`].

use super::edge_set::edge_set;
use super::edges::{Feature, real_edges};
use super::local_motion::Motion;
use super::morph::morph_warp;
use super::refine::{FourFrames, PairCosts, PixelMotion, motion_px, refined};
use super::triangulation::{delaunay, warp_by};
use super::warp::{Warp, cross_dissolve_in, warped};
use super::windows::{cross_fade, difference, largest_around};
use super::{InterpolationOptions, MorphOptions, SyncMethod};
use crate::raster::{Image, Tiles, box_filter};
use crate::registration::{Frame, Track, Trajectory};
use nalgebra::{Point2, Vector2};

/// Reach of motion beyond its place, pixels: beside an outline, a pixel may be of either surface. Larger: still
/// surfaces near moving ones lose weight; smaller: outlines count as still.
const OUTLINE_PX: usize = 4;
/// The motion, pixels, that a difference of 1 between the two warped frames counts as: where they disagree, the
/// motion was not found. Larger: frames near in time replace others where only highlights change; smaller: what
/// was not followed is believed.
const DISAGREEMENT_PX: f32 = 200.0;
/// Weight of the change of a motion beside the motion: a body that turns or bounces between two frames leaves the
/// path through its places in them. Larger: other cameras replace what turns slowly; smaller: a bounce is believed.
const CHANGE_WEIGHT: f32 = 4.0;
/// The mean difference of the warped frames, 0..=1, up to which they agree. Larger and smaller: as of
/// [`DISAGREEMENT_PX`], the other way round.
const MIN_DISAGREEMENT: f32 = 0.03;
/// Half the side of the window that the warped frames' difference is averaged over, pixels; for refined images it is
/// [`super::RefineOptions::window_radius_px`]. Larger: outlines are not believed over more of their surroundings;
/// smaller: noise counts.
const DISAGREEMENT_RADIUS_PX: usize = 2;

/// A camera's image at an instant between its frames.
#[derive(Clone, Debug, PartialEq)]
pub struct Synchronized {
    /// The image.
    pub image: Image,
    /// Expected error of interpolation per pixel, row by row, in pixels of motion: the motion between the two frames, and more where it
    /// changes or the frames disagree about it, times 4s(1 − s) with s the instant's place between them.
    /// Interpolation's error grows with it; it is 0 at a frame. `None` where nothing was interpolated, or
    /// nobody asked.
    pub interpolation_error_px: Option<Vec<f32>>,
}

impl Synchronized {
    /// An image that is not interpolated along motion: a frame as filmed, or a cross-fade of two.
    pub fn filmed(image: Image) -> Self {
        Self { image, interpolation_error_px: None }
    }
}

/// Two consecutive frames of one camera, with their tracks: the input of temporal interpolation (§5). All
/// images have the same size and channels.
pub struct FramePair<'a> {
    /// The frame before the earlier one and the frame after the later one, if they exist. Only
    /// [`SyncMethod::Refined`] uses them.
    pub around: [Option<&'a Frame>; 2],
    /// The frame at t.
    pub earlier: &'a Frame,
    /// The frame at t + Δt.
    pub later: &'a Frame,
    /// The tracks between the two; empty is valid, and gives a cross-fade.
    pub tracks: &'a [Track],
    /// Their triangles, if they are known already: [`Triangles::new`] of the same tracks and image size.
    pub triangles: Option<&'a Triangles>,
    /// What refinement needs of the pair alone, if it is known already: [`Self::pair_costs`].
    pub pair_costs: Option<&'a PairCosts>,
    /// All frame times of the camera in seconds, strictly ascending.
    pub times_s: &'a [f64],
    /// Index of the earlier frame.
    pub index: usize,
    /// The tiles of the image that are needed, `None` for all. The others may be made by a cheaper
    /// method, or black.
    pub parts: Option<&'a Tiles>,
    /// Whether [`Synchronized::interpolation_error_px`] is wanted. It takes as long as a warp, but for refined images.
    pub with_interpolation_error: bool,
}

/// The [`delaunay`] triangles of tracks in the earlier frame and in the later one, the same at all instants.
#[derive(Clone, Debug, PartialEq)]
pub struct Triangles([Vec<[usize; 3]>; 2]);

impl Triangles {
    /// Those of the tracks of a frame pair of this size in pixels.
    pub fn new(tracks: &[Track], width: usize, height: usize) -> Self {
        Self([true, false].map(|forward| {
            let places: Vec<_> = in_set(tracks, forward)
                .map(|track| if forward { track.earlier } else { track.later })
                .collect();
            delaunay(&places, width, height)
        }))
    }

    /// How many there are.
    pub fn count(&self) -> usize {
        self.0.iter().map(Vec::len).sum()
    }
}

/// The tracks of the forward or of the backward flow.
fn in_set(tracks: &[Track], forward: bool) -> impl Iterator<Item = &Track> {
    tracks.iter().filter(move |t| if forward { t.in_forward_set() } else { t.in_backward_set() })
}

impl FramePair<'_> {
    /// The camera's image, from its own frames alone ([`SyncMethod::of_one_camera`]), at a time between the
    /// two frames, seconds; at another time, that of the nearer frame's. At a frame's time it is the frame, up to
    /// resampling. Values are in 0..=1, but for those that [`SyncMethod::Nearest`] and [`SyncMethod::Crossfade`]
    /// take over from the frames.
    ///
    /// # Panics
    /// If `times_s` has no entry for the later frame.
    pub fn interpolate(
        &self,
        time_s: f64,
        sync: SyncMethod,
        options: &InterpolationOptions,
    ) -> Synchronized {
        let sync = sync.of_one_camera();
        let [start, end] = [self.times_s[self.index], self.times_s[self.index + 1]];
        // Times ascend strictly, so the interval is positive.
        let fraction = ((time_s - start) / (end - start)).clamp(0.0, 1.0);
        let images = [&self.earlier.image, &self.later.image];
        match sync {
            SyncMethod::Nearest => {
                return Synchronized::filmed(images[usize::from(fraction > 0.5)].clone());
            }
            SyncMethod::Crossfade => {
                let image = cross_fade(images[0], images[1], fraction as f32);
                return Synchronized::filmed(image);
            }
            _ => {}
        }
        let warps = [true, false].map(|forward| self.warp(time_s, forward, sync, options));
        let warps = [&warps[0], &warps[1]];
        if sync != SyncMethod::Refined {
            let interpolation_error_px = self
                .with_interpolation_error
                .then(|| interpolation_error_px(&motions_of(images, warps), images[0], fraction));
            let image = cross_dissolve_in(images, warps, fraction as f32, self.parts);
            return Synchronized { image, interpolation_error_px };
        }
        // `interpolation_error_px` takes the maximum within OUTLINE_PX.
        let grown = self
            .parts
            .filter(|_| self.with_interpolation_error)
            .map(|parts| parts.grown(OUTLINE_PX));
        let frames = FourFrames {
            before: self.around[0].map(|f| &f.image),
            earlier: images[0],
            later: images[1],
            after: self.around[1].map(|f| &f.image),
            fraction: fraction as f32,
            parts: grown.as_ref().or(self.parts),
            with_motions: self.with_interpolation_error,
        };
        let motions = self.motions(options.curved, |trajectory, _| trajectory.at(time_s));
        let own;
        let pair_costs = match self.pair_costs {
            Some(pair_costs) => pair_costs,
            None => {
                own = self.pair_costs(options);
                &own
            }
        };
        let (image, motions) = refined(&frames, warps, &motions, pair_costs, &options.refine);
        let interpolation_error_px =
            motions.map(|motions| interpolation_error_px(&motions, &image, fraction));
        Synchronized { image, interpolation_error_px }
    }

    /// What [`SyncMethod::Refined`] needs of the pair alone, the same at all instants.
    pub fn pair_costs(&self, options: &InterpolationOptions) -> PairCosts {
        let motions = [
            self.motions(options.curved, |_, track| track.earlier),
            self.motions(options.curved, |_, track| track.later),
        ];
        let size = [self.earlier.image.width(), self.earlier.image.height()];
        PairCosts::new(size, motions, &options.refine)
    }

    /// The motions of all tracks to the four frames, from where they are `at` some instant.
    fn motions(
        &self,
        curved: bool,
        at: impl Fn(&Trajectory, &Track) -> Point2<f64>,
    ) -> Vec<Motion> {
        let time = |frame: Option<usize>| frame.and_then(|k| self.times_s.get(k)).copied();
        let (before, after) = (time(self.index.checked_sub(1)), time(Some(self.index + 2)));
        self.tracks
            .iter()
            .filter_map(|track| {
                let trajectory = self.trajectory(track, curved)?;
                let at = at(&trajectory, track);
                // The trajectory extrapolates a track that was not extended to a frame.
                let displacement = |tracked: Option<Point2<f64>>, time: Option<f64>| {
                    tracked
                        .or_else(|| Some(trajectory.at(time?)))
                        .map_or(Vector2::zeros(), |p| p - at)
                };
                let to = [
                    displacement(track.before, before),
                    track.earlier - at,
                    track.later - at,
                    displacement(track.after, after),
                ];
                Some(Motion { at, to, deformation: track.deformation })
            })
            .collect()
    }

    /// The track's trajectory, on the straight line of eq. (2) unless `curved`.
    fn trajectory(&self, track: &Track, curved: bool) -> Option<Trajectory> {
        if curved {
            track.trajectory(self.times_s, self.index)
        } else {
            Track { before: None, after: None, ..track.clone() }
                .trajectory(self.times_s, self.index)
        }
    }

    /// The warp of the earlier frame (`forward`) or of the later one to the instant.
    fn warp(
        &self,
        time_s: f64,
        forward: bool,
        sync: SyncMethod,
        options: &InterpolationOptions,
    ) -> Warp {
        let (source, other) =
            if forward { (self.earlier, self.later) } else { (self.later, self.earlier) };
        let (w, h) = (source.image.width(), source.image.height());
        let features = self.features(time_s, forward, options.curved);
        if matches!(sync, SyncMethod::Triangulation | SyncMethod::Refined) {
            let own;
            let triangles = match self.triangles {
                Some(triangles) => triangles,
                None => {
                    own = Triangles::new(self.tracks, w, h);
                    &own
                }
            };
            return warp_by(&triangles.0[usize::from(!forward)], &features, w, h);
        }
        let [source, other] = [source, other].map(|f| &f.pyramid.levels()[0]);
        let real = real_edges(&features, source, other, &options.edges);
        let edges = edge_set(&features, &real, options.edges.all_features, w, h);
        let tau = if sync == SyncMethod::Morph { 0.0 } else { options.morph.tau };
        morph_warp(&edges, w, h, &MorphOptions { tau, ..options.morph.clone() })
    }

    /// The features of the forward or of the backward flow, with their positions at the instant.
    fn features(&self, time_s: f64, forward: bool, curved: bool) -> Vec<Feature> {
        in_set(self.tracks, forward)
            .map(|t| {
                let (source, other) =
                    if forward { (t.earlier, t.later) } else { (t.later, t.earlier) };
                // Times ascend strictly, so that every track has a trajectory.
                let target = self.trajectory(t, curved).map_or(source, |t| t.at(time_s));
                Feature { source, other, target }
            })
            .collect()
    }
}

/// How each pixel moves by two warps, row by row.
fn motions_of(images: [&Image; 2], warps: [&Warp; 2]) -> Vec<PixelMotion> {
    let (w, h) = (warps[0].width, warps[0].height);
    let apart = difference(&warped(images[0], warps[0], None), &warped(images[1], warps[1], None));
    let apart = box_filter(&apart, w, h, DISAGREEMENT_RADIUS_PX);
    let pixel_motion = |(motion_px, cost)| PixelMotion { motion_px, change_px: 0.0, cost };
    motion_px(warps).into_iter().zip(apart).map(pixel_motion).collect()
}

/// [`Synchronized::interpolation_error_px`] of an image at a fraction of the interval: the largest around each pixel.
fn interpolation_error_px(motions: &[PixelMotion], image: &Image, fraction: f64) -> Vec<f32> {
    let share = (4.0 * fraction * (1.0 - fraction)) as f32;
    let px = |motion: &PixelMotion| {
        let unknown = DISAGREEMENT_PX * (motion.cost - MIN_DISAGREEMENT).max(0.0);
        share * (motion.motion_px + CHANGE_WEIGHT * motion.change_px + unknown)
    };
    let px: Vec<f32> = motions.iter().map(px).collect();
    largest_around(&px, image.width(), OUTLINE_PX)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_moves_may_be_wrong_as_far_as_its_outline() {
        let (w, h) = (30, 20);
        let mut warps = [Warp::identity(w, h), Warp::identity(w, h)];
        // One pixel comes from 3 px to the left, and 5 px to the right.
        let at = 10 * w + 15;
        warps[0].source[at][0] -= 3.0;
        warps[1].source[at][0] += 5.0;
        let flat = Image::filled(w, h, 1, 0.5);
        let found = interpolation_error_px(
            &motions_of([&flat, &flat], [&warps[0], &warps[1]]),
            &flat,
            0.25,
        );
        for (k, px) in found.iter().enumerate() {
            let near = (k % w).abs_diff(15) <= OUTLINE_PX && (k / w).abs_diff(10) <= OUTLINE_PX;
            assert!((px - if near { 6.0 } else { 0.0 }).abs() < 1e-5, "{k}: {px}");
        }
    }

    #[test]
    fn where_the_frames_disagree_motion_is_unknown() {
        let still = Warp::identity(30, 20);
        let images = [0.2, 0.6].map(|value| Image::filled(30, 20, 1, value));
        let found = interpolation_error_px(
            &motions_of(images.each_ref(), [&still, &still]),
            &images[0],
            0.5,
        );
        assert!(found.iter().all(|px| (px - 200.0 * 0.37).abs() < 1e-3), "{found:?}");
    }
}
