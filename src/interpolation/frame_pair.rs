//! Interpolates the image of a camera at an instant between two of its frames, by any [`PairMethod`].

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

/// Half-width, in pixels, of the neighbourhood over which the maximum of the interpolation error is taken. An outline
/// may be misplaced by this distance, so that a pixel may show any surface in its neighbourhood.
const OUTLINE_PX: usize = 4;
/// Factor, in pixels, from the difference between the two warped frames to the expected interpolation error. Pixel
/// values are 0 to 1. Only the part of the difference above [`MIN_DISAGREEMENT`] counts. For refined images, the cost
/// (the last of the [`MOTION_CHANNELS`]) takes the place of this difference.
const DISAGREEMENT_PX: f32 = 200.0;
/// Mean absolute difference, for pixel values of 0 to 1, up to which the two warped frames count as equal. Such a
/// difference adds nothing to the interpolation error.
const MIN_DISAGREEMENT: f32 = 0.03;
/// Half-width of the window over which the difference of the two warped frames is averaged, in pixels. The refined
/// method uses [`InterpolationOptions::window_radius_px`] instead.
const DISAGREEMENT_RADIUS_PX: usize = 2;
/// Weight, in the interpolation error, of the change of a pixel's motion from one frame interval to the next. The
/// motion itself has the weight 1. The change weighs more, because bodies that rotate or bounce deviate from the
/// interpolated trajectory.
const CHANGE_WEIGHT: f32 = 4.0;

/// A camera's image at an instant, and its expected error.
#[derive(Clone, Debug, PartialEq)]
pub struct Synchronized {
    /// Image at the instant.
    pub image: Image,
    /// Expected error of each pixel's position due to interpolation, in pixels, row by row. `None` for images that are
    /// not interpolated along motion, and if [`FramePair::with_interpolation_error`] is false.
    ///
    /// The error is 4s(1 − s)(m + 4c + d). s is the position of the instant in the frame interval, from 0 to 1. m is
    /// the length of the pixel's motion between the two frames, and c is the change of this motion from one frame
    /// interval to the next. d increases with the difference of the two frames after they are warped to the instant. It
    /// is 0 where they agree. m, c and d are in pixels. Each pixel gets the maximum of this error over a neighbourhood.
    pub interpolation_error_px: Option<Vec<f32>>,
}

impl Synchronized {
    /// Creates the result for an image that is a frame as filmed or a cross-fade of two frames. Such an image is not
    /// interpolated along motion, so its interpolation error is `None`.
    pub fn filmed(image: Image) -> Self {
        Self { image, interpolation_error_px: None }
    }
}

/// Method that interpolates between two frames. It holds the inputs that are the same for all instants between the
/// frames.
#[derive(Clone, Copy)]
pub enum PairMethod<'a> {
    /// The frame nearest in time.
    Nearest,
    /// The cross-fade of the two frames.
    Crossfade,
    /// Direct triangulation (Fig. 10 (b)), with the Delaunay triangles of the pair's tracks.
    Triangulation(&'a Triangles),
    /// The morph of §5.3. If `boosted`, real edges have the weights of eq. (8).
    Morph { boosted: bool },
    /// Triangulation, with motion and visibility estimated per pixel at moving outlines.
    Refined {
        triangles: &'a Triangles,
        costs: &'a PairCosts,
        /// The frame before the pair's earlier frame, and the frame after the pair's later frame. `None` if a frame
        /// does not exist.
        around: [Option<&'a Frame>; 2],
    },
}

/// Two consecutive frames of one camera, with the tracks between them. All images have the same size and channels.
pub struct FramePair<'a> {
    /// The pair's earlier frame, at the time t.
    pub earlier: &'a Frame,
    /// The pair's later frame, at the time t + Δt.
    pub later: &'a Frame,
    /// Tracks between the two frames.
    pub tracked: TrackedPair<'a>,
    /// Tiles of the image that are needed; `None` for the whole image. Pixels outside these tiles may be black.
    pub parts: Option<&'a Tiles>,
    /// Whether [`Synchronized::interpolation_error_px`] is computed. This takes about as long as a warp. For refined
    /// images it is faster, because their motions are already known.
    pub with_interpolation_error: bool,
}

impl FramePair<'_> {
    /// Returns the camera's image at `time_s`, in seconds. The time is clamped to the interval between the two frames.
    /// At the time of a frame, the image is this frame, up to resampling. Values are clamped to 0..=1, except by
    /// [`PairMethod::Nearest`] and [`PairMethod::Crossfade`].
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
        // The error is a maximum over a neighbourhood of half-width OUTLINE_PX. It therefore also needs pixels around
        // the needed tiles.
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

    /// Returns the backward warps from the image at `time_s` (seconds) to the earlier and to the later frame. The
    /// closure `warp(n, features, size)` computes one of the two warps. `n` is 0 for the earlier and 1 for the later
    /// frame, `features` are the features of this frame, and `size` is its width and height.
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

/// Returns the motion of each pixel between the two frames, as the two warps give it. The image has the
/// [`MOTION_CHANNELS`] channels of [`warp_motions`]. The last channel, the cost, is the mean difference of the two
/// warped frames over a window around the pixel.
fn motions_of(images: [&Image; 2], warps: [&Warp; 2]) -> Image {
    let (w, h) = (warps[0].width, warps[0].height);
    let differences =
        difference(&warped(images[0], warps[0], None), &warped(images[1], warps[1], None));
    warp_motions(warps, &box_filter(&differences, w, h, DISAGREEMENT_RADIUS_PX))
}

/// Returns the expected error of each pixel's position, in pixels, row by row
/// ([`Synchronized::interpolation_error_px`]). `motions` is an image with [`MOTION_CHANNELS`] channels, which holds
/// each pixel's motion, change of motion and cost.
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
