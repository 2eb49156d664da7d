//! Blending of a span, which is a range of neighbouring pixels in one row of the view. The steps are the reprojection
//! of the pixels' points into the sources, the computation of weights, and the weighted mean of colours.

use super::depth_map::DepthMap;
use super::inpaint::PointVisibility;
use super::penalties::{RayCone, Reprojection, TargetRow};
use super::rays::RayRow;
use super::source::{BlendOptions, Source};
use super::weight_grid::WeightGrid;
use super::weights::{BlendMethod, SPAN_PX, WeighedSpan, normalize, weigh_between};
use crate::camera::Camera;
use crate::raster::{Sampling, Tiles, gray_from_rgb, sample, sample_each};
use crate::simd::multiversion;
use std::ops::Range;

/// Number of neighbouring pixels of the view for which the needed tiles of a source image are marked together.
const MARKED_PX: usize = 8;
/// Maximum side of the bounding box of several pixels' positions in a source image, pixels. Up to this size, all tiles
/// of the box are marked as needed. For a larger box, the tiles of each pixel are marked separately.
const MARKED_SIDE_PX: f32 = 12.0;
/// Minimum inverse depth of a pixel with depth, 1/m. Smaller inverse depths, such as 0 of the sky, are raised to this
/// minimum. At the inverse depth 0, the angles to all cameras would be 0, and all penalties would be equal.
const MIN_INVERSE_DEPTH: f32 = 1e-8;

/// Splits `count` pixels into successive ranges of at most `width` pixels.
fn ranges(count: usize, width: usize) -> impl Iterator<Item = Range<usize>> {
    (0..count).step_by(width).map(move |from| from..(from + width).min(count))
}

/// Blends the rows of a view, one span of pixels at a time.
pub(super) struct SpanBlender<'a> {
    sources: &'a [Source<'a>],
    reprojections: &'a [Reprojection],
    options: &'a BlendOptions,
    row: RowRays<'a>,
    /// Grid of nodes between which weights are interpolated. `None` if weights are computed at every pixel.
    grid: Option<WeightGrid>,
    span: WeighedSpan,
    /// For each pixel of the span, whether any source sees the pixel's surface point.
    visible: [bool; SPAN_PX],
    /// Indices of all sources, ordered by distance from the view, the nearest first.
    order: Vec<usize>,
    /// Whether some sources are grey and others are coloured.
    is_mixed: bool,
    /// Whether the view's camera is a pinhole.
    is_pinhole: bool,
}

/// A row of the view: the rays (x, y, 1) of its pixels, the lengths of the rays, and the pixels' inverse depths.
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

    /// Computes the rays and the inverse depths of row `y` of the view. `depths` are the row's depths, metres.
    fn set(&mut self, y: usize, depths: &[f32]) {
        self.rays.set(y);
        set_rays(self, depths);
    }

    /// Moves the values at the columns `columns` to the front of each vector. The columns must be in ascending order.
    fn keep(&mut self, columns: &[usize]) {
        for (k, &column) in columns.iter().enumerate() {
            for values in [&mut self.x, &mut self.y, &mut self.length, &mut self.inverse_depth] {
                values[k] = values[column];
            }
        }
    }

    /// Returns the rays, their lengths, and the inverse depths in a range of the row's columns.
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
    /// Sets a row's rays, their lengths, and the inverse depths. `depths` are the row's depths, metres.
    fn set_rays(row: &mut RowRays, depths: &[f32]) = set_rays_by
}

#[inline(always)]
fn set_rays_by(row: &mut RowRays, depths: &[f32]) {
    let n = depths.len();
    // Slices of one length let the loop run without bounds checks.
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
        // With occlusion, interpolation errors or grey cameras, weights change abruptly between pixels.
        let is_smooth = !is_mixed && reprojections.iter().zip(sources).all(|(r, s)| r.is_smooth(s));
        let grid = WeightGrid::new(target, sources.len(), options.weight_step_px.clamp(1, SPAN_PX));
        Self {
            sources,
            reprojections,
            options,
            row: RowRays::new(target),
            grid: grid.filter(|_| is_smooth),
            span: WeighedSpan::new(sources.len()),
            visible: [false; SPAN_PX],
            order,
            is_mixed,
            is_pinhole: target.model.is_pinhole(),
        }
    }

    /// Prepares row `y` of the view for blending. `depth` is the view's depth map.
    pub fn set_row(&mut self, y: usize, depth: &DepthMap) {
        if let Some(mut grid) = self.grid.take() {
            let step = grid.step;
            grid.set_row(y, |row, columns, weights| {
                // The last row of nodes lies on the view's last row.
                let y = (row * step).min(depth.height() - 1);
                self.row.set(y, depth.row(y));
                self.weigh_nodes(columns, weights);
            });
            self.grid = Some(grid);
        }
        self.row.set(y, depth.row(y));
    }

    /// Computes the weights of all sources at the given columns of the current row. Writes them to `weights`: the first
    /// source's weights at all columns, then the second source's, and so on.
    fn weigh_nodes(&mut self, columns: &[usize], weights: &mut [f32]) {
        self.row.keep(columns);
        for nodes in ranges(columns.len(), SPAN_PX) {
            self.measure(nodes.clone());
            self.weigh_measured();
            for (i, weights) in weights.chunks_exact_mut(columns.len()).enumerate() {
                let own = &mut weights[nodes.clone()];
                match self.span.active.contains(&i) {
                    true => own.copy_from_slice(&self.span.of_source[i].weight[..nodes.len()]),
                    false => own.fill(0.0),
                }
            }
        }
    }

    /// Divides the columns of the current row into spans, and returns the range of columns of each span.
    pub fn columns(&self) -> impl Iterator<Item = Range<usize>> + use<> {
        // A span consists of whole cells of the grid of nodes.
        let step = self.grid.as_ref().map_or(1, |grid| grid.step);
        ranges(self.row.x.len(), SPAN_PX / step * step)
    }

    /// Computes the weights of all sources at a range of the row's pixels.
    pub fn weigh(&mut self, columns: Range<usize>) {
        if !self.weigh_between_nodes(columns.clone()) {
            self.measure(columns);
            self.weigh_measured();
        }
    }

    /// Interpolates the weights of a range of pixels between the grid's nodes, and multiplies them by the confidences.
    /// Returns false if there is no grid, or if a pixel has the weight 0 in all sources. A pixel that a source sees may
    /// get the weight 0 in all sources because no source sees the points at the surrounding nodes.
    fn weigh_between_nodes(&mut self, columns: Range<usize>) -> bool {
        let Some(grid) = &self.grid else { return false };
        self.span.count = columns.len();
        self.span.active.clear();
        self.visible.fill(true);
        let row = self.row.of(columns.clone());
        for (i, own) in self.span.of_source.iter_mut().enumerate() {
            if let Some(at_nodes) = grid.around(i, columns.clone()) {
                self.span.active.push(i);
                self.reprojections[i].place(&row, own);
                weigh_between(at_nodes, grid.step, own);
            }
        }
        normalize(&mut self.span)
    }

    /// Reprojects the points of a range of the row's pixels into the sources, and computes penalties and confidences.
    /// The nearest k+1 sources are always used, where k is the number of blended sources. A farther source is skipped
    /// if a lower bound of its penalties shows that its weight is 0 at all pixels of the range.
    fn measure(&mut self, columns: Range<usize>) {
        self.span.count = columns.len();
        self.span.active.clear();
        self.visible.fill(false);
        let first = match self.options.method {
            BlendMethod::Uniform => self.order.len(),
            BlendMethod::Lumigraph | BlendMethod::SpaceTime => self.options.cameras.max(1) + 1,
        };
        let row = self.row.of(columns);
        let mut cone_and_limit = None;
        for (rank, &i) in self.order.iter().enumerate() {
            if rank == first && !self.is_mixed {
                let limit = self.span.max_threshold(&self.order[..first]);
                // A threshold of 0 means that several sources stand at the view's centre. All of them are blended.
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
            self.span.active.push(i);
            let own = &mut self.span.of_source[i];
            reprojection.measure(&row, &self.sources[i], own, &mut self.visible);
        }
        // The sources are sorted, so that rounding in sums over sources doesn't depend on which sources were culled.
        self.span.active.sort_unstable();
    }

    /// Computes the weights of the span's pixels from the sources' penalties or, with the uniform method, from their
    /// confidences.
    fn weigh_measured(&mut self) {
        match self.options.method {
            BlendMethod::Uniform => self.span.weigh_uniformly(),
            BlendMethod::Lumigraph | BlendMethod::SpaceTime => {
                self.span.weigh_best(self.options.cameras);
            }
        }
    }

    /// Computes the weights of the span's pixels again, for the coloured sources alone.
    fn weigh_colored(&mut self) {
        for (source, own) in self.sources.iter().zip(&mut self.span.of_source) {
            if source.image.channels() == 1 {
                own.penalty.fill(f32::INFINITY);
                own.confidence.fill(0.0);
            }
        }
        self.weigh_measured();
    }

    /// Marks the tiles of the sources' images from which the span is blended. `tiles` has one mask per source.
    pub fn mark(&mut self, tiles: &mut [Tiles]) {
        self.mark_weighed(tiles);
        if self.is_mixed {
            self.weigh_colored();
            self.mark_weighed(tiles);
        }
    }

    /// Marks the tiles of each source's image that are sampled at the pixels where the source has a positive weight.
    fn mark_weighed(&self, tiles: &mut [Tiles]) {
        for &i in &self.span.active {
            let own = &self.span.of_source[i];
            for pixels in ranges(self.span.count, MARKED_PX) {
                let weighed = pixels.filter(|x| own.weight[*x] > 0.0);
                let positions = weighed.map(|x| [own.x[x], own.y[x]]);
                let (mut low, mut high) = ([f32::INFINITY; 2], [f32::NEG_INFINITY; 2]);
                for position in positions.clone() {
                    for ((low, high), v) in low.iter_mut().zip(&mut high).zip(position) {
                        (*low, *high) = (low.min(v), high.max(v));
                    }
                }
                // Across a depth edge, the bounding box would contain tiles that no sample needs.
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

    /// Blends the span into `pixels`, whose C channels are interleaved. All sources must have C channels.
    pub fn blend<const C: usize>(&mut self, pixels: &mut [f32]) {
        for &i in &self.span.active {
            let own = &self.span.of_source[i];
            let weighed = own.x.iter().zip(&own.y).zip(&own.weight).zip(pixels.chunks_exact_mut(C));
            let samples = weighed
                .filter(|((_, weight), _)| **weight > 0.0)
                .map(|(((&x, &y), &weight), pixel)| ([x, y], (weight, pixel)));
            let image = self.sources[i].image;
            sample_each::<C, _>(image, samples, Sampling::Cubic, |(weight, pixel), value| {
                for (out, v) in pixel.iter_mut().zip(value) {
                    *out += weight * v;
                }
            });
        }
        // Cubic interpolation can overshoot the range from 0 to 1.
        pixels.iter_mut().for_each(|v| *v = v.clamp(0.0, 1.0));
    }

    /// Blends the span into `pixels`, interleaved RGB, from grey and coloured sources. Luminance comes from all
    /// sources, and chrominance from the coloured sources. Sets the confidence of grey sources to 0.
    pub fn blend_mixed(&mut self, pixels: &mut [f32]) {
        let sources = self.sources;
        let is_colored = |i: usize| sources[i].image.channels() == 3;
        let mut colored_weight = [0.0; SPAN_PX];
        for &i in &self.span.active {
            for (x, pixel) in pixels.as_chunks_mut::<3>().0.iter_mut().enumerate() {
                let weight = self.span.of_source[i].weight[x];
                if weight > 0.0 {
                    let gray = gray_from_rgb(self.sample_rgb(i, x));
                    pixel.iter_mut().for_each(|v| *v += weight * gray);
                    colored_weight[x] += if is_colored(i) { weight } else { 0.0 };
                }
            }
        }
        let best_of_any = self.best_confidence();
        self.weigh_colored();
        let best_of_colored = self.best_confidence();
        for &i in self.span.active.iter().filter(|&&i| is_colored(i)) {
            for (x, pixel) in pixels.as_chunks_mut::<3>().0.iter_mut().enumerate() {
                // Chrominance fades out where grey cameras see a point better than coloured cameras do, unless the
                // luminance comes from coloured cameras too. `best_of_any` is positive wherever a weight is positive.
                let fade = colored_weight[x].max(best_of_colored[x] / best_of_any[x]);
                let weight = self.span.of_source[i].weight[x];
                if weight > 0.0 {
                    let value = self.sample_rgb(i, x);
                    let gray = gray_from_rgb(value);
                    for (out, v) in pixel.iter_mut().zip(value) {
                        *out += weight * fade * (v - gray);
                    }
                }
            }
        }
        pixels.iter_mut().for_each(|v| *v = v.clamp(0.0, 1.0));
    }

    /// Returns the largest confidence of any source at each pixel of the span.
    fn best_confidence(&self) -> [f32; SPAN_PX] {
        let mut best = [0.0_f32; SPAN_PX];
        for &i in &self.span.active {
            for (best, c) in best.iter_mut().zip(&self.span.of_source[i].confidence) {
                *best = best.max(*c);
            }
        }
        best
    }

    /// Samples a source's image, grey or coloured, at a pixel of the span. Returns RGB.
    fn sample_rgb(&self, source: usize, pixel: usize) -> [f32; 3] {
        let (image, own) = (self.sources[source].image, &self.span.of_source[source]);
        let (x, y) = (own.x[pixel], own.y[pixel]);
        if image.channels() == 3 {
            return sample(image, x, y, Sampling::Cubic);
        }
        let [gray] = sample(image, x, y, Sampling::Cubic);
        [gray; 3]
    }

    /// Writes the visibility of the span's surface points into `visibility`. Must be called before
    /// [`Self::blend_mixed`], which changes confidences.
    pub fn set_visibility(&self, visibility: &mut [PointVisibility]) {
        let best = self.best_confidence();
        for ((visibility, best), is_visible) in visibility.iter_mut().zip(best).zip(self.visible) {
            *visibility = match (best > 0.0, is_visible) {
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
