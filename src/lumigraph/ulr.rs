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
use super::reproject::{Hits, Reprojection, TargetRow};
use super::source::{BlendOptions, Rendered, Source};
use super::weights::{BlendMethod, SOFT, WeightRow};
use crate::camera::Camera;
use crate::raster::{Image, Tiles, gray_from_rgb, sample};
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
            || Row::new(sources, &reprojections, target, options),
            |row, (y, ((pixels, covered), shown))| {
                row.measure(y, depth.row(y));
                match (channels, colored == sources.len()) {
                    (1, _) => row.blend::<1>(pixels),
                    (_, true) => row.blend::<3>(pixels),
                    (_, false) => row.blend_mixed(pixels),
                }
                row.cover(covered, shown);
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
        || (Row::new(sources, &reprojections, target, options), nothing()),
        |(mut row, mut tiles), y| {
            row.measure(y, depth.row(y));
            row.contributing(&mut tiles);
            (row, tiles)
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

/// One row's geometry in all sources, and scratch space. Values of every pixel in every source are
/// stored source by source.
struct Row<'a> {
    sources: &'a [Source<'a>],
    reprojections: &'a [Reprojection],
    target: &'a Camera,
    options: &'a BlendOptions,
    rays: RayRow<'a>,
    x: Vec<f32>,
    y: Vec<f32>,
    penalty: Vec<f32>,
    trust: Vec<f32>,
    /// Whether some source shows the pixel's point.
    seen: Vec<bool>,
    weights: WeightRow,
    /// The sources, nearest to the view first.
    order: Vec<usize>,
    /// Whether some sources are grey and others coloured.
    is_mixed: bool,
}

/// The pixels of a row that sources are culled for together. Larger: depths differ more within a part, so that
/// fewer are; smaller: deciding takes longer than it saves.
const PART_PX: usize = 64;

/// The largest penalty at which weights end, of the pixels of a part of a row: that of the worst of these sources,
/// or a little above the best.
fn worst_end<'a>(penalties: impl Iterator<Item = &'a [f32]>, count: usize) -> f32 {
    let (mut best, mut worst) = (vec![f32::INFINITY; count], vec![0.0_f32; count]);
    for row in penalties {
        for ((best, worst), &p) in best.iter_mut().zip(&mut worst).zip(row) {
            *best = best.min(p);
            *worst = worst.max(p);
        }
    }
    let ends = best.iter().zip(&worst).map(|(best, worst)| worst.max(best * (1.0 + SOFT)));
    ends.fold(0.0, f32::max)
}

impl<'a> Row<'a> {
    fn new(
        sources: &'a [Source],
        reprojections: &'a [Reprojection],
        target: &'a Camera,
        options: &'a BlendOptions,
    ) -> Self {
        let size = sources.len() * target.width;
        let zeros = || vec![0.0; size];
        let gray = sources.iter().filter(|s| s.image.channels() == 1).count();
        let mut order: Vec<usize> = (0..sources.len()).collect();
        let distance = |i: &usize| (sources[*i].camera.center() - target.center()).norm();
        order.sort_by(|a, b| distance(a).total_cmp(&distance(b)));
        Self {
            sources,
            reprojections,
            target,
            options,
            rays: RayRow::new(target),
            x: zeros(),
            y: zeros(),
            penalty: zeros(),
            trust: zeros(),
            seen: vec![false; target.width],
            weights: WeightRow::new(target.width, sources.len()),
            order,
            is_mixed: gray > 0 && gray < sources.len(),
        }
    }

    /// Reprojects the row's points into all sources that may have weight there.
    fn measure(&mut self, y: usize, depths: &[f32]) {
        self.rays.set(y);
        let narrow = |v: &[f64]| v.iter().map(|&v| v as f32).collect::<Vec<f32>>();
        let (x, y) = (narrow(&self.rays.x), narrow(&self.rays.y));
        let length: Vec<f32> =
            x.iter().zip(&y).map(|(x, y)| (x * x + y * y + 1.0).sqrt()).collect();
        let inverse = |z: &f32| if z.is_nan() { 0.0 } else { (1.0 / z).max(MIN_INVERSE_DEPTH) };
        let inverse_depth: Vec<f32> = depths.iter().map(inverse).collect();
        let row = TargetRow { x: &x, y: &y, length: &length, inverse_depth: &inverse_depth };
        let width = self.target.width;
        self.seen.fill(false);
        for from in (0..width).step_by(PART_PX) {
            let columns = from..(from + PART_PX).min(width);
            self.measure_part(&row.part(columns.clone()), &columns);
        }
    }

    /// Reprojects some of the row's points, first into the nearest sources. Further ones are culled where they
    /// have no weight: the best penalty that they may have is no better than that at which weights end.
    fn measure_part(&mut self, row: &TargetRow, columns: &Range<usize>) {
        let width = self.target.width;
        let order = std::mem::take(&mut self.order);
        let first = match self.options.method {
            BlendMethod::Uniform => order.len(),
            BlendMethod::Lumigraph | BlendMethod::SpaceTime => self.options.cameras.max(1) + 1,
        };
        let mut limit = f32::INFINITY;
        for (rank, &i) in order.iter().enumerate() {
            if rank == first && !self.is_mixed {
                let at = |&i: &usize| &self.penalty[i * width..(i + 1) * width][columns.clone()];
                limit = worst_end(order[..first].iter().map(at), columns.len());
            }
            let own = i * width + columns.start..i * width + columns.end;
            let reprojection = &self.reprojections[i];
            // At 0, sources at the view's own centre tie.
            let may_cull = limit > 0.0 && limit < f32::INFINITY;
            if may_cull && reprojection.min_angle(row) >= limit {
                self.penalty[own.clone()].fill(f32::INFINITY);
                self.trust[own].fill(0.0);
                continue;
            }
            let mut hits = Hits {
                x: &mut self.x[own.clone()],
                y: &mut self.y[own.clone()],
                penalty: &mut self.penalty[own.clone()],
                trust: &mut self.trust[own],
                seen: &mut self.seen[columns.clone()],
            };
            reprojection.row(row, &self.sources[i], &mut hits);
        }
        self.order = order;
    }

    fn weigh(&mut self) {
        match self.options.method {
            BlendMethod::Uniform => self.weights.uniform(&self.trust),
            BlendMethod::Lumigraph | BlendMethod::SpaceTime => {
                self.weights.lumigraph(&self.penalty, &self.trust, self.options.cameras);
            }
        }
    }

    /// Computes the weights of the coloured sources, as if there were no others.
    fn weigh_colored(&mut self) {
        let width = self.target.width;
        let gray = |s: &Source| s.image.channels() == 1;
        for (i, _) in self.sources.iter().enumerate().filter(|(_, s)| gray(s)) {
            self.penalty[i * width..(i + 1) * width].fill(f32::INFINITY);
            self.trust[i * width..(i + 1) * width].fill(0.0);
        }
        self.weigh();
    }

    /// Marks the tiles that this row is blended from, source by source.
    fn contributing(&mut self, tiles: &mut [Tiles]) {
        self.weigh();
        self.mark(tiles);
        let colored = self.sources.iter().filter(|s| s.image.channels() == 3).count();
        if colored > 0 && colored < self.sources.len() {
            self.weigh_colored();
            self.mark(tiles);
        }
    }

    fn mark(&self, tiles: &mut [Tiles]) {
        let width = self.target.width;
        let places = self.x.chunks_exact(width).zip(self.y.chunks_exact(width));
        let weighted = places.zip(self.weights.weights.chunks_exact(width));
        for (tiles, ((x, y), weights)) in tiles.iter_mut().zip(weighted) {
            for ((&x, &y), &weight) in x.iter().zip(y).zip(weights) {
                if weight > 0.0 {
                    tiles.mark_sample(x, y);
                }
            }
        }
    }

    /// Blends the row from sources that all have C channels.
    fn blend<const C: usize>(&mut self, pixels: &mut [f32]) {
        self.weigh();
        let width = self.target.width;
        for (i, source) in self.sources.iter().enumerate() {
            let row = i * width..(i + 1) * width;
            let at = self.x[row.clone()].iter().zip(&self.y[row.clone()]);
            let weights = &self.weights.weights[row];
            for ((pixel, &weight), (&x, &y)) in pixels.chunks_exact_mut(C).zip(weights).zip(at) {
                if weight > 0.0 {
                    let value: [f32; C] = sample(source.image, x, y, self.options.sampling);
                    for (out, v) in pixel.iter_mut().zip(value) {
                        *out += weight * v;
                    }
                }
            }
        }
        // Cubic lobes overshoot.
        pixels.iter_mut().for_each(|v| *v = v.clamp(0.0, 1.0));
    }

    /// Blends the row where some sources are grey: luminance from all sources, colour from the others.
    fn blend_mixed(&mut self, pixels: &mut [f32]) {
        let width = self.target.width;
        let sources = self.sources;
        let is_colored = |i: usize| sources[i].image.channels() == 3;
        self.weigh();
        let (mut colored_weight, mut trust_of_any) = (vec![0.0; width], vec![0.0_f32; width]);
        for i in 0..sources.len() {
            for x in 0..width {
                let (k, weight) = (i * width + x, self.weights.weights[i * width + x]);
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
        let mut trust_of_colored = vec![0.0_f32; width];
        for row in self.trust.chunks_exact(width) {
            for (best, t) in trust_of_colored.iter_mut().zip(row) {
                *best = best.max(*t);
            }
        }
        for i in (0..sources.len()).filter(|&i| is_colored(i)) {
            for x in 0..width {
                // Colour fades as the last coloured camera loses the point that others see, unless
                // the luminance is that camera's too. Where a weight is positive, some trust is.
                let fade = colored_weight[x].max(trust_of_colored[x] / trust_of_any[x]);
                let weight = self.weights.weights[i * width + x];
                if weight > 0.0 {
                    let value = self.sample_rgb(i * width + x, i);
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
        for trust in self.trust.chunks_exact(covered.len()) {
            for (covered, &t) in covered.iter_mut().zip(trust) {
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
