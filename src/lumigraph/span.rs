//! Blending of a span of neighbouring pixels: their points in the sources, the sources' weights, and the colours.

use super::depth_map::DepthMap;
use super::inpaint::PointVisibility;
use super::penalties::{RayCone, Reprojection, SourceHits, TargetRow};
use super::rays::RayRow;
use super::source::{BlendOptions, Source};
use super::weight_grid::WeightGrid;
use super::weights::{BlendMethod, Penalties, THRESHOLD_MARGIN, Weights, divide, weigh_between};
use crate::camera::Camera;
use crate::raster::{Sampling, Tiles, gray_from_rgb, sample, sample_each};
use crate::simd::multiversion;
use std::ops::Range;

/// Largest number of pixels of a span.
const SPAN_PX: usize = 64;
/// Number of neighbouring pixels whose tiles are marked together.
const MARKED_PX: usize = 8;
/// Largest side of their bounding box in a source, pixels; beyond it, every pixel is marked alone.
const MARKED_SIDE_PX: f32 = 12.0;
/// Smallest inverse depth, 1/m: the sky's. At 0, the angles to all cameras would be 0, and all would tie.
const MIN_INVERSE_DEPTH: f32 = 1e-8;

/// Ranges of `width` that cover `count` pixels.
fn ranges(count: usize, width: usize) -> impl Iterator<Item = Range<usize>> {
    (0..count).step_by(width).map(move |from| from..(from + width).min(count))
}

/// Blends one span of a row at a time. Values of every pixel in every source are stored source by source.
pub(super) struct SpanBlender<'a> {
    sources: &'a [Source<'a>],
    reprojections: &'a [Reprojection],
    options: &'a BlendOptions,
    row: RowRays<'a>,
    /// Nodes between which weights are interpolated. `None`: every pixel is weighed.
    grid: Option<WeightGrid>,
    /// Number of pixels of the span.
    count: usize,
    /// Sources that may have weight, ascending; the others have no values.
    active: Vec<usize>,
    values: SpanValues,
    weights: Weights,
    /// All sources, nearest to the view first.
    order: Vec<usize>,
    /// Whether some sources are grey and others coloured.
    is_mixed: bool,
    /// Whether the view has a pinhole.
    is_pinhole: bool,
}

/// The points of a span in all sources, as in [`SourceHits`].
struct SpanValues {
    x: Vec<f32>,
    y: Vec<f32>,
    penalty: Vec<f32>,
    confidence: Vec<f32>,
    visible: [bool; SPAN_PX],
}

impl SpanValues {
    fn new(sources: usize) -> Self {
        let zeros = || vec![0.0; sources * SPAN_PX];
        let (x, y, penalty, confidence) = (zeros(), zeros(), zeros(), zeros());
        Self { x, y, penalty, confidence, visible: [false; SPAN_PX] }
    }

    /// The values of one source, which are at these indices.
    fn hits(&mut self, own: Range<usize>) -> SourceHits<'_> {
        SourceHits {
            visible: &mut self.visible[..own.len()],
            x: &mut self.x[own.clone()],
            y: &mut self.y[own.clone()],
            penalty: &mut self.penalty[own.clone()],
            confidence: &mut self.confidence[own],
        }
    }
}

/// Rays of a row of the view, their lengths, and inverse depths.
struct RowRays<'a> {
    rays: RayRow<'a>,
    x: Vec<f32>,
    y: Vec<f32>,
    length: Vec<f32>,
    inverse_depth: Vec<f32>,
}

impl<'a> RowRays<'a> {
    fn new(target: &'a Camera) -> Self {
        let row = || vec![0.0; target.width];
        let rays = RayRow::new(target);
        Self { rays, x: row(), y: row(), length: row(), inverse_depth: row() }
    }

    /// Moves to row `y`.
    fn set(&mut self, y: usize, depths: &[f32]) {
        self.rays.set(y);
        set_rays(self, depths);
    }

    /// Moves the values of some columns, given in ascending order, to the front.
    fn keep(&mut self, columns: impl Iterator<Item = usize>) {
        for (k, column) in columns.enumerate() {
            for values in [&mut self.x, &mut self.y, &mut self.length, &mut self.inverse_depth] {
                values[k] = values[column];
            }
        }
    }

    /// The values of some columns.
    fn of(&self, columns: Range<usize>) -> TargetRow<'_> {
        TargetRow {
            x: &self.x[columns.clone()],
            y: &self.y[columns.clone()],
            length: &self.length[columns.clone()],
            inverse_depth: &self.inverse_depth[columns],
        }
    }
}

multiversion! {
    /// Sets a row's rays, lengths and inverse depths.
    fn set_rays(row: &mut RowRays, depths: &[f32]) = set_rays_by
}

#[inline(always)]
fn set_rays_by(row: &mut RowRays, depths: &[f32]) {
    let n = depths.len();
    // One length for all slices lets the loop run without bounds checks.
    let (from_x, from_y) = (&row.rays.x[..n], &row.rays.y[..n]);
    let (to_x, to_y) = (&mut row.x[..n], &mut row.y[..n]);
    let (length, inverse_depth) = (&mut row.length[..n], &mut row.inverse_depth[..n]);
    for k in 0..n {
        let (x, y, z) = (from_x[k] as f32, from_y[k] as f32, depths[k]);
        (to_x[k], to_y[k]) = (x, y);
        length[k] = (x * x + y * y + 1.0).sqrt();
        let inverse = 1.0 / z;
        let bounded = if inverse > MIN_INVERSE_DEPTH { inverse } else { MIN_INVERSE_DEPTH };
        inverse_depth[k] = if z.is_nan() { 0.0 } else { bounded };
    }
}

/// The largest threshold of the weights ([`super::weights`]) over a span, from the penalties of k+1 sources.
fn max_threshold<'a>(penalties: impl Iterator<Item = &'a [f32]>, count: usize) -> f32 {
    let (mut best, mut worst) = ([f32::INFINITY; SPAN_PX], [0.0_f32; SPAN_PX]);
    for row in penalties {
        for ((best, worst), &p) in best.iter_mut().zip(&mut worst).zip(row) {
            *best = best.min(p);
            *worst = worst.max(p);
        }
    }
    let thresholds =
        best.iter().zip(&worst).map(|(best, worst)| worst.max(best * (1.0 + THRESHOLD_MARGIN)));
    thresholds.take(count).fold(0.0, f32::max)
}

impl<'a> SpanBlender<'a> {
    pub fn new(
        sources: &'a [Source],
        reprojections: &'a [Reprojection],
        target: &'a Camera,
        options: &'a BlendOptions,
    ) -> Self {
        let gray = sources.iter().filter(|s| s.image.channels() == 1).count();
        let mut order: Vec<usize> = (0..sources.len()).collect();
        let distance = |i: &usize| (sources[*i].camera.center() - target.center()).norm();
        order.sort_by(|a, b| distance(a).total_cmp(&distance(b)));
        let is_mixed = gray > 0 && gray < sources.len();
        // Occlusion, interpolation errors and grey cameras change weights from pixel to pixel.
        let is_smooth = !is_mixed && reprojections.iter().zip(sources).all(|(r, s)| r.is_smooth(s));
        let grid = WeightGrid::new(target, sources.len(), options.weight_step_px.clamp(1, SPAN_PX));
        Self {
            sources,
            reprojections,
            options,
            row: RowRays::new(target),
            grid: grid.filter(|_| is_smooth),
            count: 0,
            active: Vec::new(),
            values: SpanValues::new(sources.len()),
            weights: Weights::with_room(sources.len() * SPAN_PX),
            order,
            is_mixed,
            is_pinhole: target.model.is_pinhole(),
        }
    }

    /// Moves to a row of the view.
    pub fn set_row(&mut self, y: usize, depth: &DepthMap) {
        if let Some(mut grid) = self.grid.take() {
            for row in grid.missing(y) {
                self.weigh_nodes(&mut grid, row, depth);
            }
            grid.set_row(y);
            self.grid = Some(grid);
        }
        self.row.set(y, depth.row(y));
    }

    /// Fills a row of nodes.
    fn weigh_nodes(&mut self, grid: &mut WeightGrid, row: usize, depth: &DepthMap) {
        let y = grid.pixel_row(row);
        self.row.set(y, depth.row(y));
        self.row.keep(grid.pixel_columns());
        for columns in ranges(grid.columns, SPAN_PX) {
            self.measure(columns.clone());
            self.weigh_measured();
            for i in 0..self.sources.len() {
                let own = grid.weights_mut(row, i, columns.clone());
                match self.active.contains(&i) {
                    true => own.copy_from_slice(&self.weights.weights[self.indices(i)]),
                    false => own.fill(0.0),
                }
            }
        }
    }

    /// The columns of the row's spans.
    pub fn columns(&self) -> impl Iterator<Item = Range<usize>> + use<> {
        // Whole cells between nodes.
        let step = self.grid.as_ref().map_or(1, |grid| grid.step);
        ranges(self.row.x.len(), SPAN_PX / step * step)
    }

    /// Computes the weights of all sources at some of the row's pixels.
    pub fn weigh(&mut self, columns: Range<usize>) {
        if !self.weigh_between_nodes(columns.clone()) {
            self.measure(columns);
            self.weigh_measured();
        }
    }

    /// Interpolates weights between nodes, times the confidence. False if a pixel has none: a source may see it but no
    /// node around it.
    fn weigh_between_nodes(&mut self, columns: Range<usize>) -> bool {
        let Some(grid) = &self.grid else { return false };
        self.count = columns.len();
        self.active.clear();
        let row = self.row.of(columns.clone());
        let sum = &mut [0.0; SPAN_PX][..columns.len()];
        for i in 0..self.sources.len() {
            let Some(at_nodes) = grid.around(i, columns.clone()) else { continue };
            self.active.push(i);
            let own = i * SPAN_PX..i * SPAN_PX + self.count;
            let mut hits = self.values.hits(own.clone());
            self.reprojections[i].place(&row, &mut hits);
            let weights = &mut self.weights.weights[own];
            weigh_between(at_nodes, grid.step, hits.confidence, weights, sum);
        }
        if sum.iter().any(|sum| !(*sum > 0.0)) {
            return false;
        }
        self.values.visible.fill(true);
        for &i in &self.active {
            let own = i * SPAN_PX..i * SPAN_PX + self.count;
            divide(&mut self.weights.weights[own], sum);
        }
        true
    }

    /// The indices of the span's values in a source.
    fn indices(&self, source: usize) -> Range<usize> {
        source * SPAN_PX..source * SPAN_PX + self.count
    }

    /// Reprojects the points of some of the row's pixels, first into the nearest sources. A further source is culled if
    /// the lower bound of its penalties is not below the largest threshold of the weights.
    fn measure(&mut self, columns: Range<usize>) {
        self.count = columns.len();
        self.values.visible.fill(false);
        self.active.clear();
        let first = match self.options.method {
            BlendMethod::Uniform => self.order.len(),
            BlendMethod::Lumigraph | BlendMethod::SpaceTime => self.options.cameras.max(1) + 1,
        };
        let row = self.row.of(columns);
        let mut cone_and_limit = None;
        for (rank, &i) in self.order.iter().enumerate() {
            if rank == first && !self.is_mixed {
                let penalties = |&i: &usize| &self.values.penalty[self.indices(i)];
                let limit = max_threshold(self.order[..first].iter().map(penalties), self.count);
                // At 0, sources at the view's own centre tie.
                let may_cull = limit > 0.0 && limit < f32::INFINITY;
                cone_and_limit = may_cull.then(|| (RayCone::around(&row, self.is_pinhole), limit));
            }
            let reprojection = &self.reprojections[i];
            if cone_and_limit
                .as_ref()
                .is_some_and(|(cone, limit)| reprojection.min_angle(cone) >= *limit)
            {
                continue;
            }
            self.active.push(i);
            let own = self.indices(i);
            reprojection.measure(&row, &self.sources[i], &mut self.values.hits(own));
        }
        // Sums over sources don't depend on which were culled.
        self.active.sort_unstable();
    }

    /// Computes weights from the penalties.
    fn weigh_measured(&mut self) {
        let penalties = Penalties {
            sources: &self.active,
            penalty: &self.values.penalty,
            confidence: &self.values.confidence,
            width: SPAN_PX,
            count: self.count,
        };
        match self.options.method {
            BlendMethod::Uniform => self.weights.uniform(&penalties),
            BlendMethod::Lumigraph | BlendMethod::SpaceTime => {
                self.weights.lumigraph(&penalties, self.options.cameras);
            }
        }
    }

    /// Computes weights of the coloured sources alone.
    fn weigh_colored(&mut self) {
        for (i, source) in self.sources.iter().enumerate() {
            if source.image.channels() == 1 {
                let own = self.indices(i);
                self.values.penalty[own.clone()].fill(f32::INFINITY);
                self.values.confidence[own].fill(0.0);
            }
        }
        self.weigh_measured();
    }

    /// Marks the tiles that the span is blended from, source by source.
    pub fn mark(&mut self, tiles: &mut [Tiles]) {
        self.mark_weighed(tiles);
        if self.is_mixed {
            self.weigh_colored();
            self.mark_weighed(tiles);
        }
    }

    /// Marks the tiles that have weight.
    fn mark_weighed(&self, tiles: &mut [Tiles]) {
        for &i in &self.active {
            let own = self.indices(i);
            let xs = self.values.x[own.clone()].chunks(MARKED_PX);
            let ys = self.values.y[own.clone()].chunks(MARKED_PX);
            let weights = self.weights.weights[own].chunks(MARKED_PX);
            for ((x, y), weights) in xs.zip(ys).zip(weights) {
                let positions = x.iter().zip(y).zip(weights).filter(|(_, weight)| **weight > 0.0);
                let positions = positions.map(|((&x, &y), _)| [x, y]);
                let (mut low, mut high) = ([f32::INFINITY; 2], [f32::NEG_INFINITY; 2]);
                for position in positions.clone() {
                    for ((low, high), v) in low.iter_mut().zip(&mut high).zip(position) {
                        (*low, *high) = (low.min(v), high.max(v));
                    }
                }
                // At a depth edge, a common bounding box would hold tiles that no sample needs.
                if high[0] - low[0] < MARKED_SIDE_PX && high[1] - low[1] < MARKED_SIDE_PX {
                    if low[0] <= high[0] {
                        tiles[i].mark_samples(low, high);
                    }
                } else {
                    positions.for_each(|[x, y]| tiles[i].mark_sample(x, y));
                }
            }
        }
    }

    /// Blends the span from sources that all have C channels.
    pub fn blend<const C: usize>(&mut self, pixels: &mut [f32]) {
        for &i in &self.active {
            let own = self.indices(i);
            let at = self.values.x[own.clone()].iter().zip(&self.values.y[own.clone()]);
            let weighted = at.zip(&self.weights.weights[own]).zip(pixels.chunks_exact_mut(C));
            let samples = weighted
                .filter(|((_, weight), _)| **weight > 0.0)
                .map(|(((&x, &y), &weight), pixel)| ([x, y], (weight, pixel)));
            let image = self.sources[i].image;
            sample_each::<C, _>(image, samples, Sampling::Cubic, |(weight, pixel), value| {
                for (out, v) in pixel.iter_mut().zip(value) {
                    *out += weight * v;
                }
            });
        }
        // Cubic lobes overshoot.
        pixels.iter_mut().for_each(|v| *v = v.clamp(0.0, 1.0));
    }

    /// Blends the span where some sources are grey: luminance from all sources, chrominance from the coloured ones.
    pub fn blend_mixed(&mut self, pixels: &mut [f32]) {
        let sources = self.sources;
        let is_colored = |i: usize| sources[i].image.channels() == 3;
        let mut colored_weight = [0.0; SPAN_PX];
        for &i in &self.active {
            for (x, k) in self.indices(i).enumerate() {
                let weight = self.weights.weights[k];
                if weight > 0.0 {
                    let gray = gray_from_rgb(self.sample_rgb(k, i));
                    pixels[3 * x..3 * x + 3].iter_mut().for_each(|v| *v += weight * gray);
                    colored_weight[x] += if is_colored(i) { weight } else { 0.0 };
                }
            }
        }
        let best_of_any = self.best_confidence();
        let confidence = self.values.confidence.clone();
        self.weigh_colored();
        let best_of_colored = self.best_confidence();
        for &i in self.active.iter().filter(|&&i| is_colored(i)) {
            for (x, k) in self.indices(i).enumerate() {
                // Chrominance fades as the last coloured camera loses a point that others see, unless
                // the luminance is that camera's too. Where a weight is positive, a confidence is.
                let fade = colored_weight[x].max(best_of_colored[x] / best_of_any[x]);
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
        self.values.confidence = confidence;
        pixels.iter_mut().for_each(|v| *v = v.clamp(0.0, 1.0));
    }

    /// The largest confidence of any source, pixel by pixel.
    fn best_confidence(&self) -> [f32; SPAN_PX] {
        let mut best = [0.0_f32; SPAN_PX];
        for &i in &self.active {
            for (best, c) in best.iter_mut().zip(&self.values.confidence[self.indices(i)]) {
                *best = best.max(*c);
            }
        }
        best
    }

    /// Samples a source, grey or coloured, at value `k`.
    fn sample_rgb(&self, k: usize, source: usize) -> [f32; 3] {
        let (image, x, y) = (self.sources[source].image, self.values.x[k], self.values.y[k]);
        if image.channels() == 3 {
            return sample(image, x, y, Sampling::Cubic);
        }
        let [gray] = sample(image, x, y, Sampling::Cubic);
        [gray; 3]
    }

    /// Adds which pixels some camera has in its image, and sets the visibility of their points.
    pub fn cover(&self, covered: &mut [bool], visibility: &mut [PointVisibility]) {
        for &i in &self.active {
            for (covered, &c) in covered.iter_mut().zip(&self.values.confidence[self.indices(i)]) {
                *covered |= c > 0.0;
            }
        }
        for ((visibility, covered), visible) in
            visibility.iter_mut().zip(covered).zip(&self.values.visible)
        {
            *visibility = match (*covered, visible) {
                (false, _) => PointVisibility::OutOfView,
                (true, false) => PointVisibility::Occluded,
                (true, true) => PointVisibility::Visible,
            };
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::tests::pinhole_at;

    #[test]
    fn rays_are_set_alike_with_and_without_avx2() {
        let camera = pinhole_at([0.0; 3]);
        let depths: Vec<f32> = (0..camera.width)
            .map(|k| match k % 7 {
                0 => f32::NAN,
                1 => f32::INFINITY,
                _ => 0.01 * k as f32,
            })
            .collect();
        let [a, b] = [set_rays, set_rays_by].map(|set| {
            let mut row = RowRays::new(&camera);
            row.rays.set(7);
            set(&mut row, &depths);
            [row.x, row.y, row.length, row.inverse_depth]
        });
        assert_eq!(a, b);
        assert_eq!(a[3][..2], [0.0, MIN_INVERSE_DEPTH]);
    }
}
