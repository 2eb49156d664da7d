//! Estimates the maps of depth and motion of several frames together, from coarse to fine.

use super::consistency::{OtherMaps, Snapshot};
use super::element::Element;
use super::frame::{FlowFrame, PyramidFrame};
use super::map::{ElementMap, FlowMap};
use super::matching::{Observations, PatchMatcher};
use super::observing_frame::ObservingFrame;
use super::sweep::{Limits, Pass};
use super::transfer::Proposals;
use crate::random::Random;
use rayon::prelude::*;

/// Number of PatchMatch passes at each pyramid level, finest level first. The last entry is for all coarser levels.
const PASSES: [usize; 4] = [2, 2, 3, 4];
/// Number of random surface elements that are tried per pixel in each pass, by pyramid level, finest level first. The
/// last entry is for all coarser levels. The last pass at a level tries a third of this number, rounded down.
const CHANCES: [usize; 4] = [1, 2, 10, 50];

/// Coarsest pyramid level at which the scene flow maps of different frames are compared with each other
/// ([`OtherMaps`]); level 0 is the finest. The comparison is part of the last pass at a level.
const COARSEST_COMPARED: usize = 1;
/// Finest pyramid level at which the scene flow maps are smoothed, before the last pass.
const FINEST_SMOOTHED: usize = 1;
/// Pyramid level at which planes are extended, before and after the last pass. At coarser levels, the results of random
/// sampling would change everywhere, and views would become better or worse by chance.
const EXTENDED_LEVEL: usize = 0;

/// Joint estimation of the scene flow maps of several frames. Surface elements of one map are proposed for the other
/// maps.
pub struct Estimation<'a> {
    /// The frames whose scene flow maps are estimated. Each is paired with the frames with which it is matched. At most
    /// 16 of these are used.
    pub frames: &'a [(PyramidFrame<'a>, Vec<PyramidFrame<'a>>)],
    pub limits: Limits,
    /// Baseline to which all disparities refer, metres: twice the distance between neighbouring cameras.
    pub baseline_m: f64,
}

impl Estimation<'_> {
    /// Estimates the frames' scene flow maps, and returns them in the order of [`Self::frames`]. The maps do not
    /// depend on the number of threads. `proceed` is called before every pass. If it returns false, the estimation
    /// ends with an empty result.
    pub fn run(&self, proceed: &(dyn Fn() -> bool + Sync)) -> Vec<FlowMap> {
        let frames: Vec<&FlowFrame> = self.frames.iter().map(|(f, _)| f.frame).collect();
        let disparities_px: Vec<f32> = frames.iter().map(|f| self.disparity_px(f)).collect();
        let observations: Vec<Observations> = self.frames.iter().map(observations).collect();
        // Images of different sizes have different numbers of pyramid levels. The smallest number is used for all.
        let levels = self.frames.iter().flat_map(|(f, others)| others.iter().chain([f]));
        let levels = levels.map(|f| f.levels.len()).min().unwrap_or(0);
        let mut maps: Vec<ElementMap> = Vec::new();
        for level in (0..levels).rev() {
            maps = (0..frames.len()).map(|f| self.begin(f, level, maps.get(f))).collect();
            let [passes, chances] = [PASSES, CHANCES].map(|of| of[level.min(of.len() - 1)]);
            for turn in 0..passes {
                if !proceed() {
                    return Vec::new();
                }
                let is_first = turn == 0 && level + 1 == levels;
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
                        if is_last && level >= FINEST_SMOOTHED {
                            matcher.smooth(map);
                        }
                        if is_last && level == EXTENDED_LEVEL {
                            matcher.extend_planes(map, self.limits.inverse_depth);
                        }
                        let others = || OtherMaps::new(&frames, &snapshots, f, disparity_px);
                        matcher.pass(
                            map,
                            &Pass {
                                limits: self.limits,
                                turn,
                                is_last,
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
        let packed = |(f, map): (usize, &mut ElementMap)| {
            let matcher = self.matcher(f, 0, &observations[f]);
            let errors = matcher.errors(map);
            matcher.extend_planes(map, self.limits.inverse_depth);
            FlowMap::new(map, self.limits.inverse_depth, disparities_px[f]).with_errors(&errors)
        };
        maps.par_iter_mut().enumerate().map(packed).collect()
    }

    fn matcher<'b>(
        &'b self,
        f: usize,
        level: usize,
        observations: &'b Observations<'b>,
    ) -> PatchMatcher<'b> {
        let PyramidFrame { frame, levels } = self.frames[f].0;
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
    /// coarser level. At the coarsest level, they have random depths and no motion.
    fn begin(&self, f: usize, level: usize, coarser: Option<&ElementMap>) -> ElementMap {
        let image = &self.frames[f].0.levels[level];
        let (width, height) = (image.width, image.height);
        let scale = (1 << level) as f32;
        let mut random = Random::new(f as u64);
        let [min, max] = self.limits.inverse_depth;
        let element = |k: usize| {
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
        ElementMap { width, height, scale, elements, costs }
    }
}

/// Returns the frames with which frame `f` is matched.
fn observations<'a>((f, others): &(PyramidFrame<'a>, Vec<PyramidFrame<'a>>)) -> Observations<'a> {
    Observations::new(others.iter().filter_map(|o| ObservingFrame::new(*f, *o)))
}

/// Returns the index of the pixel of a coarser scene flow map that contains pixel `(x, y)` of the next finer level.
fn parent(coarser: &ElementMap, x: usize, y: usize) -> usize {
    (y / 2).min(coarser.height - 1) * coarser.width + (x / 2).min(coarser.width - 1)
}
