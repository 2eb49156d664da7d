//! The image of a camera at an instant between two of its frames, by any [`PairMethod`].

use super::InterpolationOptions;
use super::edge_set::edge_set;
use super::edges::{EdgeFeature, real_edges};
use super::morph::{EDGE_BOOST, morph_warp};
use super::refine::{FourFrames, MOTION_CHANNELS, PairCosts, refined, warp_motions};
use super::tracked_pair::{RowFractions, TrackedPair};
use super::triangulation::{Triangles, triangulation_warp};
use super::warp::{Warp, cross_dissolve, cross_fade_rows, difference, warped};
use crate::raster::{Image, Tiles, box_filter, max_filter};
use crate::registration::Frame;

/// Half-width of the neighbourhood of an outline, pixels: outlines may be wrong by this much, so that a pixel
/// may show any surface within it.
const OUTLINE_PX: usize = 4;
/// Interpolation error, pixels, that is added per unit of the warped frames' difference above [`MIN_DISAGREEMENT`].
const DISAGREEMENT_PX: f32 = 200.0;
/// Mean absolute difference of the warped frames up to which they agree, for pixel values of 0 to 1.
const MIN_DISAGREEMENT: f32 = 0.03;
/// Half-width of the window over which the warped frames' difference is averaged, pixels. The refined method
/// uses [`InterpolationOptions::window_radius_px`] instead.
const DISAGREEMENT_RADIUS_PX: usize = 2;
/// Weight of the motion's change per frame in the interpolation error, relative to that of the motion. Bodies
/// that rotate or bounce deviate from the interpolated trajectory.
const CHANGE_WEIGHT: f32 = 4.0;

/// A camera's image at an instant between its frames.
#[derive(Clone, Debug, PartialEq)]
pub struct Synchronized {
    /// The image.
    pub image: Image,
    /// Expected error of each pixel's position due to interpolation, pixels, row by row. `None` for images
    /// that are not interpolated along motion, and if [`FramePair::with_interpolation_error`] is false.
    ///
    /// The error is 4s(1 − s)(m + 4c + d), with s the instant's fraction of the interval, m the motion
    /// between the two frames, c its change per frame, and d a term for disagreement of the warped frames;
    /// then the maximum over a neighbourhood.
    pub interpolation_error_px: Option<Vec<f32>>,
}

impl Synchronized {
    /// An image without interpolation along motion, and so without an error: a frame as filmed, or a
    /// cross-fade of two.
    pub fn filmed(image: Image) -> Self {
        Self { image, interpolation_error_px: None }
    }
}

/// A method of interpolation, with those inputs that are the same at all instants between two frames.
#[derive(Clone, Copy)]
pub enum PairMethod<'a> {
    /// The frame nearest in time.
    Nearest,
    /// The cross-fade of the two frames.
    Crossfade,
    /// Direct triangulation (Fig. 10 (b)), by the triangles of the pair's tracks.
    Triangulation(&'a Triangles),
    /// The morph of §5.3. If `boosted`, real edges have the weights of eq. (8).
    Morph { boosted: bool },
    /// Triangulation, with motion and visibility estimated per pixel at moving outlines.
    Refined {
        triangles: &'a Triangles,
        costs: &'a PairCosts,
        /// The frame before the earlier one and the frame after the later one, if they exist.
        around: [Option<&'a Frame>; 2],
    },
}

/// Two consecutive frames of one camera. All images have the same size and channels.
pub struct FramePair<'a> {
    /// The frame at t.
    pub earlier: &'a Frame,
    /// The frame at t + Δt.
    pub later: &'a Frame,
    /// The tracks between the two.
    pub tracked: TrackedPair<'a>,
    /// The tiles of the image that are needed; `None` for all. The others may be black.
    pub parts: Option<&'a Tiles>,
    /// Whether [`Synchronized::interpolation_error_px`] is wanted. Computing it takes as long as a warp, except for
    /// refined images.
    pub with_interpolation_error: bool,
}

impl FramePair<'_> {
    /// The camera's image at `time_s`, seconds, clamped to the interval between the two frames. At a frame's
    /// time it is the frame, up to resampling. Values are clamped to 0..=1, except by [`PairMethod::Nearest`]
    /// and [`PairMethod::Crossfade`].
    ///
    /// # Panics
    /// If [`TrackedPair::times`] has no entry for the later frame.
    pub fn interpolate(
        &self,
        time_s: f64,
        method: PairMethod,
        options: &InterpolationOptions,
    ) -> Synchronized {
        let fraction = self.tracked.fraction(time_s);
        let fractions = self.tracked.row_fractions(time_s);
        let images = [&self.earlier.image, &self.later.image];
        let warps = match method {
            PairMethod::Nearest => {
                return Synchronized::filmed(images[usize::from(fraction > 0.5)].clone());
            }
            PairMethod::Crossfade => {
                return Synchronized::filmed(cross_fade_rows(images[0], images[1], fractions));
            }
            PairMethod::Triangulation(triangles) | PairMethod::Refined { triangles, .. } => self
                .warps(time_s, options, |n, features, [w, h]| {
                    triangulation_warp(&triangles.0[n], features, w, h)
                }),
            PairMethod::Morph { boosted } => self.warps(time_s, options, |n, features, [w, h]| {
                let frames = [self.earlier, self.later];
                let [source, other] =
                    [frames[n], frames[1 - n]].map(|frame| &frame.pyramid.levels[0]);
                let real = real_edges(features, source, other, options.max_edge_length_px);
                let edges = edge_set(features, &real, w, h);
                let boost = if boosted { EDGE_BOOST } else { 0.0 };
                morph_warp(&edges, [w, h], boost, options.grid_px)
            }),
        };
        let warps = [&warps[0], &warps[1]];
        let PairMethod::Refined { costs, around, .. } = method else {
            let image = cross_dissolve(images, warps, fractions, self.parts);
            let error_px = || error_px(&motions_of(images, warps), fractions);
            let interpolation_error_px = self.with_interpolation_error.then(error_px);
            return Synchronized { image, interpolation_error_px };
        };
        // The error is a maximum within OUTLINE_PX, so that it needs pixels around the needed tiles.
        let grown =
            self.parts.filter(|_| self.with_interpolation_error).map(|p| p.grown(OUTLINE_PX));
        let frames = FourFrames {
            before: around[0].map(|f| &f.image),
            earlier: images[0],
            later: images[1],
            after: around[1].map(|f| &f.image),
            fractions,
            parts: grown.as_ref().or(self.parts),
        };
        let motions = self.tracked.motions(options.curved, |trajectory, _| trajectory.at(time_s));
        let (image, motions) = refined(&frames, warps, motions, costs, options);
        let interpolation_error_px =
            self.with_interpolation_error.then(|| error_px(&motions, fractions));
        Synchronized { image, interpolation_error_px }
    }

    /// The warps of the earlier and the later frame to an instant. `warp(n, features, size)` computes the
    /// warp of frame `n`, 0 earlier or 1 later, from its features and its width and height.
    fn warps(
        &self,
        time_s: f64,
        options: &InterpolationOptions,
        warp: impl Fn(usize, &[EdgeFeature], [usize; 2]) -> Warp,
    ) -> [Warp; 2] {
        let size = [self.earlier.image.width(), self.earlier.image.height()];
        [0, 1].map(|n| warp(n, &self.tracked.features(time_s, n == 0, options.curved), size))
    }
}

/// The motion of each pixel between the two frames, by their warps, as [`warp_motions`]. The cost is the
/// local mean difference of the warped frames.
fn motions_of(images: [&Image; 2], warps: [&Warp; 2]) -> Image {
    let (w, h) = (warps[0].width, warps[0].height);
    let differences =
        difference(&warped(images[0], warps[0], None), &warped(images[1], warps[1], None));
    warp_motions(warps, &box_filter(&differences, w, h, DISAGREEMENT_RADIUS_PX))
}

/// [`Synchronized::interpolation_error_px`] from the pixels' motions ([`MOTION_CHANNELS`]).
fn error_px(motions: &Image, fractions: RowFractions) -> Vec<f32> {
    let of_pixel = |weight: f32, &[motion_px, change_px, cost]: &[f32; MOTION_CHANNELS]| {
        let unknown = DISAGREEMENT_PX * (cost - MIN_DISAGREEMENT).max(0.0);
        weight * (motion_px + CHANGE_WEIGHT * change_px + unknown)
    };
    let pixels = motions.data().as_chunks::<MOTION_CHANNELS>().0;
    let mut errors = Vec::with_capacity(pixels.len());
    for (y, row) in pixels.chunks(motions.width()).enumerate() {
        let fraction = fractions.at(y as f64 + 0.5);
        let weight = (4.0 * fraction * (1.0 - fraction)) as f32;
        errors.extend(row.iter().map(|pixel| of_pixel(weight, pixel)));
    }
    max_filter(&errors, motions.width(), OUTLINE_PX)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_moves_may_be_wrong_as_far_as_its_outline() {
        let (w, h) = (30, 20);
        let mut warps = [Warp::identity(w, h), Warp::identity(w, h)];
        // The source of one pixel is 3 px to its left in the first frame, and 5 px to its right in the
        // second.
        let at = 10 * w + 15;
        warps[0].source[at][0] -= 3.0;
        warps[1].source[at][0] += 5.0;
        let flat = Image::filled(w, h, 1, 0.5);
        let found = error_px(
            &motions_of([&flat, &flat], [&warps[0], &warps[1]]),
            RowFractions::constant(0.25),
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
        let found =
            error_px(&motions_of(images.each_ref(), [&still, &still]), RowFractions::constant(0.5));
        assert!(found.iter().all(|px| (px - 200.0 * 0.37).abs() < 1e-3), "{found:?}");
    }
}
