//! Unstructured lumigraph rendering (Buehler, Bosse, McMillan, Gortler, Cohen, SIGGRAPH 2001):
//! every pixel of the view is a weighted mean of the cameras' images of its point of the proxy.
//!
//! The penalty of camera i at the pixel's point X, seen from the view's centre C:
//!
//! `p_i = 2 tan(θ_i / 2) · (1 + β · coarseness_i) / (border_i · visible_i)`
//!
//! with θ_i the angle at X between C and C_i. Buehler adds the three parts; multiplied, the
//! penalty is exactly 0 where the view's centre is the camera's, so that this camera alone
//! contributes, up to its border. It is infinite outside the image, so that ranks change smoothly
//! there.
//! [`super::weights`] turns penalties into weights.
//!
//! A grey camera among coloured ones gives its luminance: luminance is blended from all cameras, and
//! the difference between colour and luminance from the coloured ones alone (with weights of their
//! own), fading to grey where none of them sees the point. A coloured camera's luminance is what a
//! grey one would have recorded in its place: summed before it is encoded.
//!
//! With [`BlendMethod::SpaceTime`] the penalty is `√(p_i² + (λ·m_i)²)`, with m_i how far the camera's
//! pixel was bridged in time ([`Source::bridged_px`]) and λ the angle that a pixel counts as: the errors
//! of the proxy and of interpolation are independent. At a camera's place and at the time of its frame
//! it is still 0.
//!
//! Where a point is hidden from every camera, its colour comes from the surfaces around it that are not nearer
//! ([`hidden`]).
//!
//! Known limit: where a point of the proxy is occluded in a camera by another part of the proxy, the
//! camera still contributes unless its own [`Source::depth`] is given.

use super::DepthMap;
use super::hidden::{self, Shown};
use super::rays::RayRow;
use super::reproject::{Cone, Hits, Reprojection, TargetRow};
use super::source::{BlendOptions, Rendered, Source};
use super::weights::{BlendMethod, Penalties, SOFT, Weights};
use crate::camera::Camera;
use crate::raster::{Image, Tiles, gray_from_rgb, sample, sample_each};
use rayon::prelude::*;
use std::ops::Range;

/// Smallest inverse depth, 1/m. Larger: at 1e8 m, images of cameras a kilometre apart differ by a
/// hundredth of a pixel, and nearer points by more. Smaller: the angles of the sky's points round to 0,
/// and all cameras tie.
const MIN_INVERSE_DEPTH: f32 = 1e-8;

/// Renders the view `target` from the sources' images, over the proxy's depths in the view
/// ([`Proxy::depth_map`](super::Proxy::depth_map)).
///
/// Only cameras at the view's centre contribute to pixels without depth. Without sources there is no
/// coverage. The image has 3 channels if any source has, else 1.
///
/// # Panics
/// If the size of the depth map is not the view's, or that of an image or of a source's depth
/// map not its camera's.
pub fn blend(
    sources: &[Source],
    depth: &DepthMap,
    target: &Camera,
    options: &BlendOptions,
) -> Rendered {
    check(sources, depth, target);
    let (w, h) = (target.width, target.height);
    let reprojections = Reprojection::of_all(sources, target, options);
    let colored = sources.iter().filter(|s| s.image.channels() == 3).count();
    let channels = if colored > 0 { 3 } else { 1 };
    let mut image = Image::filled(w, h, channels, 0.0);
    let mut coverage = vec![false; w * h];
    let mut shown = vec![Shown::Nothing; w * h];
    image
        .data_mut()
        .par_chunks_exact_mut(w * channels)
        .zip(coverage.par_chunks_exact_mut(w))
        .zip(shown.par_chunks_exact_mut(w))
        .enumerate()
        .for_each_init(
            || Part::new(sources, &reprojections, target, options),
            |part, (y, ((pixels, covered), shown))| {
                part.set_row(y, depth.row(y));
                for columns in parts(w) {
                    part.measure(columns.clone());
                    let pixels = &mut pixels[channels * columns.start..channels * columns.end];
                    match (channels, colored == sources.len()) {
                        (1, _) => part.blend::<1>(pixels),
                        (_, true) => part.blend::<3>(pixels),
                        (_, false) => part.blend_mixed(pixels),
                    }
                    part.cover(&mut covered[columns.clone()], &mut shown[columns]);
                }
            },
        );
    hidden::fill(&mut image, &shown, depth, options.hidden_share as f32);
    Rendered { image, coverage }
}

/// The tiles of each source's image that the view depends on, in the sources' order; most sources of a
/// large rig have none.
///
/// The pixels of the other tiles have no influence on [`blend`]. Their cameras have: they end the
/// weights of nearer ones.
///
/// # Panics
/// As [`blend`].
pub fn contributing(
    sources: &[Source],
    depth: &DepthMap,
    target: &Camera,
    options: &BlendOptions,
) -> Vec<Tiles> {
    check(sources, depth, target);
    let reprojections = Reprojection::of_all(sources, target, options);
    let nothing = || -> Vec<Tiles> {
        sources.iter().map(|s| Tiles::none(s.camera.width, s.camera.height)).collect()
    };
    let rows = (0..target.height).into_par_iter().fold(
        || (Part::new(sources, &reprojections, target, options), nothing()),
        |(mut part, mut tiles), y| {
            part.set_row(y, depth.row(y));
            for columns in parts(target.width) {
                part.measure(columns);
                part.contributing(&mut tiles);
            }
            (part, tiles)
        },
    );
    rows.map(|(_, tiles)| tiles).reduce(nothing, |mut all, more| {
        all.iter_mut().zip(&more).for_each(|(all, more)| all.add(more));
        all
    })
}

fn check(sources: &[Source], depth: &DepthMap, target: &Camera) {
    let size = (target.width, target.height);
    assert_eq!((depth.width(), depth.height()), size, "size of the view's depths");
    for source in sources {
        let size = (source.camera.width, source.camera.height);
        assert_eq!((source.image.width(), source.image.height()), size, "size of an image");
        if let Some(bridged) = source.bridged_px {
            assert_eq!(bridged.len(), size.0 * size.1, "size of a source's bridged pixels");
        }
        if let Some(d) = source.depth {
            assert_eq!((d.width(), d.height()), size, "size of a source's depths");
        }
    }
}

/// Neighbouring pixels of a row that are measured, weighed and blended together. Larger: depths differ more within a
/// part, so that fewer sources are culled; smaller: deciding takes longer than it saves.
const PART_PX: usize = 64;

/// The columns of a row's parts.
fn parts(width: usize) -> impl Iterator<Item = Range<usize>> {
    (0..width).step_by(PART_PX).map(move |from| from..(from + PART_PX).min(width))
}

/// A part of a row in the sources that may have weight there, and scratch space. Values of every pixel in every source
/// are stored source by source.
struct Part<'a> {
    sources: &'a [Source<'a>],
    reprojections: &'a [Reprojection],
    options: &'a BlendOptions,
    row: RowRays<'a>,
    /// How many pixels it has.
    count: usize,
    /// The sources that may have weight; the others have no values.
    active: Vec<usize>,
    x: Vec<f32>,
    y: Vec<f32>,
    penalty: Vec<f32>,
    trust: Vec<f32>,
    /// Whether some source shows the pixel's point.
    seen: [bool; PART_PX],
    weights: Weights,
    /// The sources, nearest to the view first.
    order: Vec<usize>,
    /// Whether some sources are grey and others coloured.
    is_mixed: bool,
    /// Whether the view is a pinhole's.
    is_pinhole: bool,
}

/// The rays of a row of the view, and its inverse depths.
struct RowRays<'a> {
    rays: RayRow<'a>,
    x: Vec<f32>,
    y: Vec<f32>,
    length: Vec<f32>,
    inverse_depth: Vec<f32>,
}

/// The largest penalty at which weights end, of the pixels of a part of a row: that of the worst of these sources,
/// or a little above the best.
fn worst_end<'a>(penalties: impl Iterator<Item = &'a [f32]>, count: usize) -> f32 {
    let (mut best, mut worst) = ([f32::INFINITY; PART_PX], [0.0_f32; PART_PX]);
    for row in penalties {
        for ((best, worst), &p) in best.iter_mut().zip(&mut worst).zip(row) {
            *best = best.min(p);
            *worst = worst.max(p);
        }
    }
    let ends = best.iter().zip(&worst).map(|(best, worst)| worst.max(best * (1.0 + SOFT)));
    ends.take(count).fold(0.0, f32::max)
}

impl<'a> Part<'a> {
    fn new(
        sources: &'a [Source],
        reprojections: &'a [Reprojection],
        target: &'a Camera,
        options: &'a BlendOptions,
    ) -> Self {
        let zeros = || vec![0.0; sources.len() * PART_PX];
        let gray = sources.iter().filter(|s| s.image.channels() == 1).count();
        let mut order: Vec<usize> = (0..sources.len()).collect();
        let distance = |i: &usize| (sources[*i].camera.center() - target.center()).norm();
        order.sort_by(|a, b| distance(a).total_cmp(&distance(b)));
        let row = || vec![0.0; target.width];
        Self {
            sources,
            reprojections,
            options,
            row: RowRays {
                rays: RayRow::new(target),
                x: row(),
                y: row(),
                length: row(),
                inverse_depth: row(),
            },
            count: 0,
            active: Vec::new(),
            x: zeros(),
            y: zeros(),
            penalty: zeros(),
            trust: zeros(),
            seen: [false; PART_PX],
            weights: Weights::default(),
            order,
            is_mixed: gray > 0 && gray < sources.len(),
            is_pinhole: target.model.is_pinhole(),
        }
    }

    /// Makes the next parts those of a row.
    fn set_row(&mut self, y: usize, depths: &[f32]) {
        let row = &mut self.row;
        row.rays.set(y);
        for (k, &z) in depths.iter().enumerate() {
            let (x, y) = (row.rays.x[k] as f32, row.rays.y[k] as f32);
            (row.x[k], row.y[k]) = (x, y);
            row.length[k] = (x * x + y * y + 1.0).sqrt();
            row.inverse_depth[k] = if z.is_nan() { 0.0 } else { (1.0 / z).max(MIN_INVERSE_DEPTH) };
        }
    }

    /// The indices of the part's values in a source.
    fn of(&self, source: usize) -> Range<usize> {
        source * PART_PX..source * PART_PX + self.count
    }

    /// Reprojects the points of some of the row's pixels, first into the nearest sources. Further ones are culled where
    /// they have no weight: the best penalty that they may have is no better than that at which weights end.
    fn measure(&mut self, columns: Range<usize>) {
        self.count = columns.len();
        self.seen.fill(false);
        self.active.clear();
        let first = match self.options.method {
            BlendMethod::Uniform => self.order.len(),
            BlendMethod::Lumigraph | BlendMethod::SpaceTime => self.options.cameras.max(1) + 1,
        };
        let row = TargetRow {
            x: &self.row.x[columns.clone()],
            y: &self.row.y[columns.clone()],
            length: &self.row.length[columns.clone()],
            inverse_depth: &self.row.inverse_depth[columns],
        };
        let mut cone_and_limit = None;
        for (rank, &i) in self.order.iter().enumerate() {
            if rank == first && !self.is_mixed {
                let at = |&i: &usize| &self.penalty[self.of(i)];
                let limit = worst_end(self.order[..first].iter().map(at), self.count);
                // At 0, sources at the view's own centre tie.
                let may_cull = limit > 0.0 && limit < f32::INFINITY;
                cone_and_limit = may_cull.then(|| (Cone::around(&row, self.is_pinhole), limit));
            }
            let own = self.of(i);
            let reprojection = &self.reprojections[i];
            if cone_and_limit
                .as_ref()
                .is_some_and(|(cone, limit)| reprojection.min_angle(cone) >= *limit)
            {
                continue;
            }
            self.active.push(i);
            let mut hits = Hits {
                x: &mut self.x[own.clone()],
                y: &mut self.y[own.clone()],
                penalty: &mut self.penalty[own.clone()],
                trust: &mut self.trust[own],
                seen: &mut self.seen[..self.count],
            };
            reprojection.row(&row, &self.sources[i], &mut hits);
        }
        // Sums over sources don't depend on which were culled.
        self.active.sort_unstable();
    }

    fn weigh(&mut self) {
        let penalties = Penalties {
            sources: &self.active,
            penalty: &self.penalty,
            trust: &self.trust,
            width: PART_PX,
            count: self.count,
        };
        match self.options.method {
            BlendMethod::Uniform => self.weights.uniform(&penalties),
            BlendMethod::Lumigraph | BlendMethod::SpaceTime => {
                self.weights.lumigraph(&penalties, self.options.cameras);
            }
        }
    }

    /// Computes the weights of the coloured sources, as if there were no others.
    fn weigh_colored(&mut self) {
        for (i, source) in self.sources.iter().enumerate() {
            if source.image.channels() == 1 {
                let own = self.of(i);
                self.penalty[own.clone()].fill(f32::INFINITY);
                self.trust[own].fill(0.0);
            }
        }
        self.weigh();
    }

    /// Marks the tiles that this part is blended from, source by source.
    fn contributing(&mut self, tiles: &mut [Tiles]) {
        self.weigh();
        self.mark(tiles);
        if self.is_mixed {
            self.weigh_colored();
            self.mark(tiles);
        }
    }

    fn mark(&self, tiles: &mut [Tiles]) {
        for &i in &self.active {
            for k in self.of(i) {
                if self.weights.weights[k] > 0.0 {
                    tiles[i].mark_sample(self.x[k], self.y[k]);
                }
            }
        }
    }

    /// Blends the part from sources that all have C channels.
    fn blend<const C: usize>(&mut self, pixels: &mut [f32]) {
        self.weigh();
        for &i in &self.active {
            let own = self.of(i);
            let at = self.x[own.clone()].iter().zip(&self.y[own.clone()]);
            let weighted = at.zip(&self.weights.weights[own]).zip(pixels.chunks_exact_mut(C));
            let places = weighted
                .filter(|((_, weight), _)| **weight > 0.0)
                .map(|(((&x, &y), &weight), pixel)| ([x, y], (weight, pixel)));
            let (image, sampling) = (self.sources[i].image, self.options.sampling);
            sample_each::<C, _>(image, places, sampling, |(weight, pixel), value| {
                for (out, v) in pixel.iter_mut().zip(value) {
                    *out += weight * v;
                }
            });
        }
        // Cubic lobes overshoot.
        pixels.iter_mut().for_each(|v| *v = v.clamp(0.0, 1.0));
    }

    /// Blends the part where some sources are grey: luminance from all sources, colour from the others.
    fn blend_mixed(&mut self, pixels: &mut [f32]) {
        let sources = self.sources;
        let is_colored = |i: usize| sources[i].image.channels() == 3;
        self.weigh();
        let (mut colored_weight, mut trust_of_any) = ([0.0; PART_PX], [0.0_f32; PART_PX]);
        for &i in &self.active {
            for (x, k) in self.of(i).enumerate() {
                let weight = self.weights.weights[k];
                trust_of_any[x] = trust_of_any[x].max(self.trust[k]);
                if weight > 0.0 {
                    let gray = gray_from_rgb(self.sample_rgb(k, i));
                    pixels[3 * x..3 * x + 3].iter_mut().for_each(|v| *v += weight * gray);
                    colored_weight[x] += if is_colored(i) { weight } else { 0.0 };
                }
            }
        }
        let trust = self.trust.clone();
        self.weigh_colored();
        let mut trust_of_colored = [0.0_f32; PART_PX];
        for &i in &self.active {
            for (best, t) in trust_of_colored.iter_mut().zip(&self.trust[self.of(i)]) {
                *best = best.max(*t);
            }
        }
        for &i in self.active.iter().filter(|&&i| is_colored(i)) {
            for (x, k) in self.of(i).enumerate() {
                // Colour fades as the last coloured camera loses the point that others see, unless
                // the luminance is that camera's too. Where a weight is positive, some trust is.
                let fade = colored_weight[x].max(trust_of_colored[x] / trust_of_any[x]);
                let weight = self.weights.weights[k];
                if weight > 0.0 {
                    let value = self.sample_rgb(k, i);
                    let gray = gray_from_rgb(value);
                    for (out, v) in pixels[3 * x..3 * x + 3].iter_mut().zip(value) {
                        *out += weight * fade * (v - gray);
                    }
                }
            }
        }
        self.trust = trust;
        pixels.iter_mut().for_each(|v| *v = v.clamp(0.0, 1.0));
    }

    fn sample_rgb(&self, k: usize, source: usize) -> [f32; 3] {
        let (image, x, y) = (self.sources[source].image, self.x[k], self.y[k]);
        if image.channels() == 3 {
            return sample(image, x, y, self.options.sampling);
        }
        let [gray] = sample(image, x, y, self.options.sampling);
        [gray; 3]
    }

    /// Which pixels some camera has in its image, and whether one shows their points.
    fn cover(&self, covered: &mut [bool], shown: &mut [Shown]) {
        for &i in &self.active {
            for (covered, &t) in covered.iter_mut().zip(&self.trust[self.of(i)]) {
                *covered |= t > 0.0;
            }
        }
        for ((shown, covered), seen) in shown.iter_mut().zip(covered).zip(&self.seen) {
            *shown = match (*covered, seen) {
                (false, _) => Shown::Nothing,
                (true, false) => Shown::Hidden,
                (true, true) => Shown::Seen,
            };
        }
    }
}
