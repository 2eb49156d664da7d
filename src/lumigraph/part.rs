//! A part of a row of the view: where the sources show its points, their weights, and the colours.

use super::DepthMap;
use super::hidden::Shown;
use super::nodes::Nodes;
use super::rays::RayRow;
use super::reproject::{Cone, Hits, Reprojection, TargetRow};
use super::source::{BlendOptions, Source};
use super::weights::{BlendMethod, Penalties, SOFT, Weights, divide, weigh_between};
use crate::camera::Camera;
use crate::raster::{Sampling, Tiles, gray_from_rgb, sample, sample_each};
use crate::simd::multiversion;
use std::ops::Range;

/// Neighbouring pixels of a row that are measured, weighed and blended together. Larger: depths differ more within a
/// part, so that fewer sources are culled; smaller: deciding takes longer than it saves.
const PART_PX: usize = 64;

/// Neighbouring pixels whose tiles are marked together. Larger: more tiles than are needed. Smaller: slower.
const MARKED_PX: usize = 8;
/// Largest side of their rectangle in a source, pixels.
const MARKED_SIDE_PX: f32 = 12.0;

/// Smallest inverse depth, 1/m. Larger: at 1e8 m, images of cameras a kilometre apart differ by a
/// hundredth of a pixel, and nearer points by more. Smaller: the angles of the sky's points round to 0,
/// and all cameras tie.
const MIN_INVERSE_DEPTH: f32 = 1e-8;

/// Parts of `width` neighbours, of which there are `count`.
fn parts(count: usize, width: usize) -> impl Iterator<Item = Range<usize>> {
    (0..count).step_by(width).map(move |from| from..(from + width).min(count))
}

/// A part of a row in the sources that may have weight there, and scratch space. Values of every pixel in every source
/// are stored source by source.
pub(super) struct Part<'a> {
    sources: &'a [Source<'a>],
    reprojections: &'a [Reprojection],
    options: &'a BlendOptions,
    row: RowRays<'a>,
    /// Where weights are computed, if not at every pixel.
    nodes: Option<Nodes>,
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

impl<'a> RowRays<'a> {
    fn new(target: &'a Camera) -> Self {
        let row = || vec![0.0; target.width];
        let rays = RayRow::new(target);
        Self { rays, x: row(), y: row(), length: row(), inverse_depth: row() }
    }

    fn set(&mut self, y: usize, depths: &[f32]) {
        self.rays.set(y);
        set_rays(self, depths);
    }

    /// Moves the values of some columns, which ascend, to the front.
    fn keep(&mut self, columns: impl Iterator<Item = usize>) {
        for (k, column) in columns.enumerate() {
            for values in [&mut self.x, &mut self.y, &mut self.length, &mut self.inverse_depth] {
                values[k] = values[column];
            }
        }
    }

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
    pub fn new(
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
        let is_mixed = gray > 0 && gray < sources.len();
        // What is hidden, interpolated or grey changes from pixel to pixel.
        let is_smooth = !is_mixed && reprojections.iter().zip(sources).all(|(r, s)| r.is_smooth(s));
        let nodes = Nodes::new(target, sources.len(), options.weight_step_px.clamp(1, PART_PX));
        Self {
            sources,
            reprojections,
            options,
            row: RowRays::new(target),
            nodes: nodes.filter(|_| is_smooth),
            count: 0,
            active: Vec::new(),
            x: zeros(),
            y: zeros(),
            penalty: zeros(),
            trust: zeros(),
            seen: [false; PART_PX],
            weights: Weights::of(sources.len() * PART_PX),
            order,
            is_mixed,
            is_pinhole: target.model.is_pinhole(),
        }
    }

    /// Makes the next parts those of a row.
    pub fn set_row(&mut self, y: usize, depth: &DepthMap) {
        if let Some(mut nodes) = self.nodes.take() {
            for row in nodes.missing(y) {
                self.weigh_nodes(&mut nodes, row, depth);
            }
            nodes.set_row(y);
            self.nodes = Some(nodes);
        }
        self.row.set(y, depth.row(y));
    }

    fn weigh_nodes(&mut self, nodes: &mut Nodes, row: usize, depth: &DepthMap) {
        let y = nodes.pixel_row(row);
        self.row.set(y, depth.row(y));
        self.row.keep(nodes.pixel_columns());
        for columns in parts(nodes.columns(), PART_PX) {
            self.measure(columns.clone());
            self.weigh_measured();
            for i in 0..self.sources.len() {
                let own = nodes.weights_mut(row, i, columns.clone());
                match self.active.contains(&i) {
                    true => own.copy_from_slice(&self.weights.weights[self.of(i)]),
                    false => own.fill(0.0),
                }
            }
        }
    }

    /// The columns of a row's parts.
    pub fn columns(&self) -> impl Iterator<Item = Range<usize>> + use<> {
        // Whole cells between nodes.
        let step = self.nodes.as_ref().map_or(1, Nodes::step);
        parts(self.row.x.len(), PART_PX / step * step)
    }

    /// Computes the weights of all sources at some of the row's pixels.
    pub fn weigh(&mut self, columns: Range<usize>) {
        if !self.weigh_between_nodes(columns.clone()) {
            self.measure(columns);
            self.weigh_measured();
        }
    }

    /// Interpolates weights between nodes. Towards the border of a source's image they fall pixel by pixel. Whether
    /// every pixel has one: there may be sources that none of the nodes around a pixel are seen by.
    fn weigh_between_nodes(&mut self, columns: Range<usize>) -> bool {
        let Some(nodes) = &self.nodes else { return false };
        self.count = columns.len();
        self.active.clear();
        let row = self.row.of(columns.clone());
        let sum = &mut [0.0; PART_PX][..columns.len()];
        for i in 0..self.sources.len() {
            let Some(at_nodes) = nodes.around(i, columns.clone()) else { continue };
            self.active.push(i);
            let own = i * PART_PX..i * PART_PX + self.count;
            let (x, y) = (&mut self.x[own.clone()], &mut self.y[own.clone()]);
            self.reprojections[i].place(&row, [x, y, &mut self.trust[own.clone()]]);
            weigh_between(
                at_nodes,
                nodes.step(),
                &self.trust[own.clone()],
                &mut self.weights.weights[own],
                sum,
            );
        }
        if sum.iter().any(|sum| !(*sum > 0.0)) {
            return false;
        }
        self.seen.fill(true);
        for &i in &self.active {
            let own = i * PART_PX..i * PART_PX + self.count;
            divide(&mut self.weights.weights[own], sum);
        }
        true
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
        let row = self.row.of(columns);
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

    fn weigh_measured(&mut self) {
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
        self.weigh_measured();
    }

    /// Marks the tiles that this part is blended from, source by source.
    pub fn mark(&mut self, tiles: &mut [Tiles]) {
        self.mark_weighed(tiles);
        if self.is_mixed {
            self.weigh_colored();
            self.mark_weighed(tiles);
        }
    }

    fn mark_weighed(&self, tiles: &mut [Tiles]) {
        for &i in &self.active {
            let own = self.of(i);
            let at =
                self.x[own.clone()].chunks(MARKED_PX).zip(self.y[own.clone()].chunks(MARKED_PX));
            for ((x, y), weights) in at.zip(self.weights.weights[own].chunks(MARKED_PX)) {
                let places = x.iter().zip(y).zip(weights).filter(|(_, weight)| **weight > 0.0);
                let places = places.map(|((&x, &y), _)| [x, y]);
                let (mut low, mut high) = ([f32::INFINITY; 2], [f32::NEG_INFINITY; 2]);
                for place in places.clone() {
                    for ((low, high), v) in low.iter_mut().zip(&mut high).zip(place) {
                        (*low, *high) = (low.min(v), high.max(v));
                    }
                }
                // Where a surface ends, the rectangle would hold tiles that no sample depends on.
                if high[0] - low[0] < MARKED_SIDE_PX && high[1] - low[1] < MARKED_SIDE_PX {
                    if low[0] <= high[0] {
                        tiles[i].mark_samples(low, high);
                    }
                } else {
                    places.for_each(|[x, y]| tiles[i].mark_sample(x, y));
                }
            }
        }
    }

    /// Blends the part from sources that all have C channels.
    pub fn blend<const C: usize>(&mut self, pixels: &mut [f32]) {
        for &i in &self.active {
            let own = self.of(i);
            let at = self.x[own.clone()].iter().zip(&self.y[own.clone()]);
            let weighted = at.zip(&self.weights.weights[own]).zip(pixels.chunks_exact_mut(C));
            let places = weighted
                .filter(|((_, weight), _)| **weight > 0.0)
                .map(|(((&x, &y), &weight), pixel)| ([x, y], (weight, pixel)));
            let image = self.sources[i].image;
            sample_each::<C, _>(image, places, Sampling::Cubic, |(weight, pixel), value| {
                for (out, v) in pixel.iter_mut().zip(value) {
                    *out += weight * v;
                }
            });
        }
        // Cubic lobes overshoot.
        pixels.iter_mut().for_each(|v| *v = v.clamp(0.0, 1.0));
    }

    /// Blends the part where some sources are grey: luminance from all sources, colour from the others.
    pub fn blend_mixed(&mut self, pixels: &mut [f32]) {
        let sources = self.sources;
        let is_colored = |i: usize| sources[i].image.channels() == 3;
        let (mut colored_weight, mut trust_of_by) = ([0.0; PART_PX], [0.0_f32; PART_PX]);
        for &i in &self.active {
            for (x, k) in self.of(i).enumerate() {
                let weight = self.weights.weights[k];
                trust_of_by[x] = trust_of_by[x].max(self.trust[k]);
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
                let fade = colored_weight[x].max(trust_of_colored[x] / trust_of_by[x]);
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
            return sample(image, x, y, Sampling::Cubic);
        }
        let [gray] = sample(image, x, y, Sampling::Cubic);
        [gray; 3]
    }

    /// Which pixels some camera has in its image, and whether one shows their points.
    pub fn cover(&self, covered: &mut [bool], shown: &mut [Shown]) {
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
