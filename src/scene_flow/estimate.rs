//! Estimates the maps of depth and motion of several frames together, from coarse to fine.

use super::background::Background;
use super::consistency::{OtherMaps, Snapshot};
use super::element::{Element, ElementErrors};
use super::frame::{FlowFrame, PyramidFrame};
use super::map::{ElementMap, FlowMap, MappedFrame};
use super::matching::{Observations, PatchMatcher};
use super::observing_frame::ObservingFrame;
use super::sweep::{COARSE_LEVEL, Limits, Pass};
use super::transfer::Proposals;
use super::variance_factor::{Estimated, scaled_errors};
use crate::random::Random;
use rayon::prelude::*;

/// Number of PatchMatch passes at each pyramid level, finest level first. The last entry is for all coarser levels.
const PASSES: [usize; 4] = [2, 2, 3, 4];
/// Number of random surface elements that are tried per pixel in each pass, by pyramid level, finest level first. The
/// last entry is for all coarser levels. The last pass at a level tries a third of this number, rounded down.
const CHANCES: [usize; 4] = [1, 2, 10, 50];
/// The same two numbers for the coarsest level of an image that is so small that this level is finer than [`COARSE_LEVEL`].
/// The search begins there.
const OF_SMALL_IMAGES: [usize; 2] = [4, 10];

/// Coarsest pyramid level at which the scene flow maps of different frames are compared with each other
/// ([`OtherMaps`]); level 0 is the finest. The comparison is part of the last pass at a level.
const COARSEST_COMPARED: usize = 1;
/// Pyramid level at which planes are extended, before and after the last pass. At coarser levels, the results of random
/// sampling would change everywhere, and views would become better or worse by chance.
const EXTENDED_LEVEL: usize = 0;

/// A frame whose scene flow map is estimated.
pub struct EstimatedFrame<'a> {
    pub frame: PyramidFrame<'a>,
    /// The frames with which the frame is matched. At most 16 of them are used.
    pub others: Vec<PyramidFrame<'a>>,
    /// Static background, whose surface elements are given. `None` if it isn't known.
    pub background: Option<Background<'a>>,
}

/// Joint estimation of the scene flow maps of several frames. Surface elements of one map are proposed for the other
/// maps.
pub struct Estimation<'a> {
    /// The frames whose scene flow maps are estimated.
    pub frames: &'a [EstimatedFrame<'a>],
    pub limits: Limits,
    /// Baseline to which all disparities refer, metres: twice the distance between neighbouring cameras.
    pub baseline_m: f64,
}

impl Estimation<'_> {
    /// Estimates the frames' scene flow maps, and returns them in the order of [`Self::frames`]. The maps do not
    /// depend on the number of threads. `proceed` is called before every pass. If it returns false, the estimation
    /// ends with an empty result.
    pub fn run(&self, proceed: &(dyn Fn() -> bool + Sync)) -> Vec<FlowMap> {
        let frames: Vec<&FlowFrame> = self.frames.iter().map(|f| f.frame.frame).collect();
        let disparities_px: Vec<f32> = frames.iter().map(|f| self.disparity_px(f)).collect();
        let observations: Vec<Observations> = self.frames.iter().map(observations).collect();
        // Images of different sizes have different numbers of pyramid levels. The smallest number is used for all.
        let levels = self.frames.iter().flat_map(|f| f.others.iter().chain([&f.frame]));
        let levels = levels.map(|f| f.levels.len()).min().unwrap_or(0);
        let mut maps: Vec<ElementMap> = Vec::new();
        for level in (0..levels).rev() {
            maps = (0..frames.len()).map(|f| self.begin(f, level, maps.get(f))).collect();
            let is_coarsest = level + 1 == levels;
            let [passes, chances] = if is_coarsest && level < COARSE_LEVEL {
                OF_SMALL_IMAGES
            } else {
                [PASSES, CHANCES].map(|of| of[level.min(of.len() - 1)])
            };
            for turn in 0..passes {
                if !proceed() {
                    return Vec::new();
                }
                let is_first = turn == 0 && is_coarsest;
                let proposals: Vec<Option<Proposals>> = (0..maps.len())
                    .into_par_iter()
                    .map(|f| (!is_first).then(|| Proposals::new(&frames, &maps, f)))
                    .collect();
                let is_last = turn + 1 == passes;
                let is_compared = is_last && level <= COARSEST_COMPARED;
                let compared = if is_compared { &maps[..] } else { &[] };
                let snapshots: Vec<Snapshot> = compared.par_iter().map(Snapshot::new).collect();
                maps.par_iter_mut().zip(&proposals).enumerate().for_each(
                    |(f, (map, proposals))| {
                        let disparity_px = disparities_px[f];
                        let matcher = self.matcher(f, level, &observations[f]);
                        if is_last {
                            matcher.smooth(map);
                        }
                        if is_last && level == EXTENDED_LEVEL && !map.has_given() {
                            matcher.extend_planes(map, self.limits.inverse_depth);
                        }
                        let others = || OtherMaps::new(&frames, &snapshots, f, disparity_px);
                        matcher.pass(
                            map,
                            &Pass {
                                limits: self.limits,
                                turn,
                                is_last,
                                is_coarsest,
                                chances: if is_last { chances / 3 } else { chances },
                                proposals: proposals.as_ref(),
                                others: is_compared.then(others),
                                seed: (f * 1000 + turn * 17 + level) as u64,
                            },
                        );
                    },
                );
            }
        }
        let finished = |(f, map): (usize, &mut ElementMap)| self.finished(f, map, &observations[f]);
        let finished: Vec<(FlowMap, Vec<ElementErrors>)> =
            maps.par_iter_mut().enumerate().map(finished).collect();
        self.with_errors(&maps, finished)
    }

    /// Completes the scene flow map of frame `f` after the last pass: smooths it and extends planes. Returns it with the
    /// standard errors from its images.
    fn finished(
        &self,
        f: usize,
        map: &mut ElementMap,
        observations: &Observations,
    ) -> (FlowMap, Vec<ElementErrors>) {
        let EstimatedFrame { frame, background, .. } = &self.frames[f];
        let matcher = self.matcher(f, 0, observations);
        matcher.smooth(map);
        let errors = matcher.errors(map);
        if !map.has_given() {
            matcher.extend_planes(map, self.limits.inverse_depth);
        }
        let range = self.range_with(background.as_ref());
        (FlowMap::new(map, range, self.disparity_px(frame.frame)), errors)
    }

    /// Returns finished maps with their standard errors, scaled by how much the maps differ from each other. `maps` are the
    /// same maps before quantization.
    fn with_errors(
        &self,
        maps: &[ElementMap],
        finished: Vec<(FlowMap, Vec<ElementErrors>)>,
    ) -> Vec<FlowMap> {
        let frames = self.frames.iter().map(|of| of.frame.frame);
        let all: Vec<Estimated> = frames
            .zip(maps)
            .zip(&finished)
            .map(|((frame, elements), (map, errors))| Estimated {
                mapped: MappedFrame { frame, map },
                elements,
                errors,
            })
            .collect();
        let scaled = |f: usize| {
            let background = self.frames[f].background.as_ref();
            with_background(scaled_errors(&all, f), &maps[f], background)
        };
        let errors: Vec<Vec<ElementErrors>> = (0..all.len()).into_par_iter().map(scaled).collect();
        finished
            .into_iter()
            .zip(errors)
            .map(|((map, _), errors)| map.with_errors(&errors))
            .collect()
    }

    /// Returns the smallest range of inverse depths, 1/m, that contains the search range and that of a background.
    fn range_with(&self, background: Option<&Background>) -> [f32; 2] {
        let [min, max] = self.limits.inverse_depth;
        background.map_or([min, max], |b| {
            let [from, to] = b.map().inverse_depth;
            [min.min(from), max.max(to)]
        })
    }

    fn matcher<'b>(
        &'b self,
        f: usize,
        level: usize,
        observations: &'b Observations<'b>,
    ) -> PatchMatcher<'b> {
        let PyramidFrame { frame, levels } = self.frames[f].frame;
        PatchMatcher {
            own: &levels[level],
            observations,
            level,
            scale: (1 << level) as f32,
            disparity_px: self.disparity_px(frame),
        }
    }

    /// Returns the disparity of a point at a depth of 1 m in a frame, pixels, at the baseline [`Self::baseline_m`].
    fn disparity_px(&self, frame: &FlowFrame) -> f32 {
        (frame.view.focal_px() * self.baseline_m) as f32
    }

    /// Returns the initial scene flow map of frame `f` at a pyramid level. Its surface elements are those of the
    /// coarser level. At the coarsest level, they have random depths and no motion. Where the frame certainly shows static
    /// background, they are those of the background.
    fn begin(&self, f: usize, level: usize, coarser: Option<&ElementMap>) -> ElementMap {
        let EstimatedFrame { frame, background, .. } = &self.frames[f];
        let image = &frame.levels[level];
        let (width, height) = (image.width, image.height);
        let scale = (1 << level) as f32;
        let mut random = Random::new(f as u64);
        let [min, max] = self.limits.inverse_depth;
        let pixels = if background.is_some() { width * height } else { 0 };
        let of_background = |k| background.as_ref()?.element(level, [k % width, k / width]);
        let given: Vec<Option<Element>> = (0..pixels).map(of_background).collect();
        let element = |k: usize| {
            if let Some(given) = given.get(k).copied().flatten() {
                return given;
            }
            let Some(coarser) = coarser else {
                let inverse_depth = min + (max - min) * random.unit() as f32;
                return Element { inverse_depth, ..Element::default() };
            };
            let (x, y) = (k % width, k / width);
            let at = parent(coarser, x, y);
            coarser.element_at(at, [(x as f32 + 0.5) * scale, (y as f32 + 0.5) * scale])
        };
        let elements: Vec<Element> = (0..width * height).map(element).collect();
        // The coarser level's costs are needed to decide which pixels already have a good surface element.
        let cost = |k: usize| coarser.map_or(0.0, |c| c.costs[parent(c, k % width, k / width)]);
        let costs = (0..width * height).map(cost).collect();
        let given = given.iter().map(Option::is_some).collect();
        ElementMap { width, height, scale, elements, costs, given }
    }
}

/// Returns standard errors of a map's surface elements, in which those of given elements are the background's.
fn with_background(
    mut errors: Vec<ElementErrors>,
    map: &ElementMap,
    background: Option<&Background>,
) -> Vec<ElementErrors> {
    if let Some(background) = background {
        let pixels = errors.iter_mut().zip(background.map().pixels()).enumerate();
        let given = pixels.filter(|(k, _)| map.is_given(*k));
        given.for_each(|(_, (errors, pixel))| *errors = pixel.errors());
    }
    errors
}

/// Returns the frames with which frame `f` is matched.
fn observations<'a>(of: &EstimatedFrame<'a>) -> Observations<'a> {
    Observations::new(of.others.iter().filter_map(|o| ObservingFrame::new(of.frame, *o)))
}

/// Returns the index of the pixel of a coarser scene flow map that contains pixel `(x, y)` of the next finer level.
fn parent(coarser: &ElementMap, x: usize, y: usize) -> usize {
    (y / 2).min(coarser.height - 1) * coarser.width + (x / 2).min(coarser.width - 1)
}
