//! Cost volume: the matching cost of every pixel of a reference camera at every depth hypothesis. The costs come from
//! the images of the camera's partners, which are the cameras that it is matched with.

use super::census::{CensusImage, Descriptor};
use super::relative_pose::RelativePose;
use crate::camera::Camera;
use crate::lumigraph::RayRow;
use crate::simd::multiversion;
use rayon::prelude::*;

/// Maximum number of depth hypotheses, called levels, at a pixel.
const MAX_LEVELS: usize = 1024;
/// Matching cost of a point that is outside the images of all partner cameras. It is equal to the cost of a poor match.
const UNSEEN_COST: u8 = 40;

/// Depth hypotheses, called levels: evenly spaced inverse depths, 1/m. They correspond to even steps of disparity.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct DepthLevels {
    /// Smallest inverse depth of the levels, 1/m.
    pub first: f32,
    /// Difference between the inverse depths of two successive levels, 1/m.
    pub step: f32,
    /// Number of levels, at least 1.
    pub count: usize,
}

impl DepthLevels {
    /// Creates levels from the inverse depth `low` to `high`, 1/m. Successive levels are at most `step` apart, unless
    /// this takes more than [`MAX_LEVELS`] levels.
    pub fn new([low, high]: [f64; 2], step: f64) -> Self {
        // The step is positive, so that the quotient is finite. An empty range has one level.
        let count = ((high - low) / step).ceil().clamp(0.0, (MAX_LEVELS - 1) as f64) as usize + 1;
        let step = if count > 1 { (high - low) / (count - 1) as f64 } else { step };
        Self { first: low as f32, step: step as f32, count }
    }

    /// Returns the inverse depth of a level, 1/m. The level may be fractional.
    pub fn at(&self, level: f32) -> f32 {
        self.first + self.step * level
    }
}

/// A reference image, and its partners: the images that it is matched with.
pub(super) struct StereoSet<'a> {
    pub image: &'a CensusImage,
    pub partners: Vec<Partner<'a>>,
}

/// Image of a partner camera (a camera that the reference camera is matched with), and its pose relative to the
/// reference camera.
pub(super) struct Partner<'a> {
    pub image: &'a CensusImage,
    pub pose: RelativePose,
}

impl<'a> StereoSet<'a> {
    pub fn new(image: &'a CensusImage, partners: impl Iterator<Item = &'a CensusImage>) -> Self {
        let pose = |p: &CensusImage| RelativePose::new(&image.camera, &p.camera);
        let partners = partners.map(|image| Partner { image, pose: pose(image) }).collect();
        Self { image, partners }
    }
}

/// Computes the matching costs of all levels at every pixel of the reference image, pixel by pixel.
///
/// The cost of a point is a mean over the partners (the images that the reference image is matched with) that contain
/// the point. Only the half of them with the smaller costs counts, since the point may be occluded in the other half.
pub(super) fn cost_volume(set: &StereoSet, levels: &DepthLevels) -> Vec<u8> {
    let camera = &set.image.camera;
    let (w, n) = (camera.width, levels.count);
    let inverses: Vec<f32> = (0..n).map(|level| levels.at(level as f32)).collect();
    let mut out = vec![UNSEEN_COST; w * camera.height * n];
    out.par_chunks_mut(w * n).enumerate().for_each_init(
        || MatchScratch::new(set, n),
        |scratch, (y, out)| {
            scratch.rays.set(y);
            row_costs(set, y, &inverses, scratch, out);
        },
    );
    out
}

/// Upsamples the inverse depths `values`, 1/m, from the resolution of the camera `coarse` to twice that resolution,
/// which is the resolution of `set`. For each pixel, the values of the four nearest coarse pixels are compared. The
/// value with the smallest matching cost is taken.
pub(super) fn upsampled(values: &[f32], coarse: &Camera, set: &StereoSet) -> Vec<f32> {
    let camera = &set.image.camera;
    let w = camera.width;
    let mut out = vec![f32::NAN; w * camera.height];
    let around = |v: usize, size: usize| {
        let near = (v / 2).min(size - 1);
        let other =
            if v.is_multiple_of(2) { near.saturating_sub(1) } else { (near + 1).min(size - 1) };
        [near, other]
    };
    out.par_chunks_mut(w).enumerate().for_each_init(
        || (MatchScratch::new(set, 4), [0; 4]),
        |(scratch, costs), (y, out)| {
            scratch.rays.set(y);
            for (x, out) in out.iter_mut().enumerate() {
                let (columns, rows) = (around(x, coarse.width), around(y, coarse.height));
                let candidate = |k: usize| values[rows[k / 2] * coarse.width + columns[k % 2]];
                let candidates = [0, 1, 2, 3].map(candidate);
                for (k, Partner { image, pose }) in set.partners.iter().enumerate() {
                    let rotated = pose.rotated(scratch.rays.x[x] as f32, scratch.rays.y[x] as f32);
                    for (n, candidate) in candidates.iter().enumerate() {
                        let point = pose.point(&rotated, *candidate);
                        [scratch.x[n], scratch.y[n]] = pose.pixel(&point);
                    }
                    scratch.compare(&set.image.descriptors[y * w + x], image, k);
                }
                scratch.better_half(costs);
                // The first candidate is from the nearest coarse pixel. It is taken if costs are equal.
                let best = (0..4).min_by_key(|&n| costs[n]).unwrap_or(0);
                *out = candidates[best];
            }
        },
    );
    out
}

multiversion! {
    /// Computes the matching costs of all levels at every pixel of row `y` of the reference image. `inverses` are the
    /// levels' inverse depths, 1/m.
    fn row_costs(
        set: &StereoSet,
        y: usize,
        inverses: &[f32],
        scratch: &mut MatchScratch,
        out: &mut [u8],
    ) = row_costs_by
}

#[inline(always)]
fn row_costs_by(
    set: &StereoSet,
    y: usize,
    inverses: &[f32],
    scratch: &mut MatchScratch,
    out: &mut [u8],
) {
    let own = &set.image.descriptors[y * set.image.camera.width..];
    for ((x, out), own) in out.chunks_exact_mut(inverses.len()).enumerate().zip(own) {
        let ray = [scratch.rays.x[x] as f32, scratch.rays.y[x] as f32];
        for (k, Partner { image, pose }) in set.partners.iter().enumerate() {
            pose.path(ray, inverses, &mut scratch.x, &mut scratch.y);
            scratch.compare(own, image, k);
        }
        scratch.better_half(out);
    }
}

/// Buffers for matching the pixels of one row at several inverse depths, called levels.
struct MatchScratch<'a> {
    /// Rays of the row's pixels.
    rays: RayRow<'a>,
    /// Horizontal position in a partner's image for each level, pixels.
    x: Vec<f32>,
    /// Vertical position in a partner's image for each level, pixels.
    y: Vec<f32>,
    /// Index of the partner's pixel for each level; [`OUTSIDE`] if the position is outside the partner's image.
    at: Vec<u32>,
    descriptors: Vec<Descriptor>,
    partners: usize,
    /// Matching costs by level, partner by partner; 255 where the point is outside the partner's image. For three
    /// partners, there is a fourth row of 255, so that the code for four partners is used.
    costs: Vec<u8>,
    sorted: Vec<u8>,
}

/// Pixel index that stands for a position outside the image.
const OUTSIDE: u32 = u32::MAX;

impl<'a> MatchScratch<'a> {
    fn new(set: &StereoSet<'a>, levels: usize) -> Self {
        let partners = set.partners.len();
        let rows = if partners == 3 { 4 } else { partners };
        Self {
            rays: RayRow::new(&set.image.camera),
            x: vec![0.0; levels],
            y: vec![0.0; levels],
            at: vec![0; levels],
            descriptors: vec![Descriptor::OUTSIDE; levels],
            partners,
            costs: vec![u8::MAX; levels * rows],
            sorted: Vec::new(),
        }
    }

    /// Computes the matching costs of a pixel at the positions `self.x`, `self.y` in the image `partner` of partner
    /// number `k`. `own` is the pixel's descriptor.
    #[inline(always)]
    fn compare(&mut self, own: &Descriptor, partner: &CensusImage, k: usize) {
        let (w, h) = (partner.gray.width(), partner.gray.height());
        let (wf, hf) = (w as f32, h as f32);
        for ((at, &x), &y) in self.at.iter_mut().zip(&self.x).zip(&self.y) {
            // The comparisons are also false for NaN.
            let is_seen = (x >= 0.0) & (y >= 0.0) & (x < wf) & (y < hf);
            let (x, y) = if is_seen { (x, y) } else { (0.0, 0.0) };
            // SAFETY: x and y are finite and inside the image. `as` would check this again.
            let pixel =
                unsafe { y.to_int_unchecked::<i32>() * w as i32 + x.to_int_unchecked::<i32>() };
            *at = if is_seen { pixel as u32 } else { OUTSIDE };
        }
        for (descriptor, &at) in self.descriptors.iter_mut().zip(&self.at) {
            *descriptor = *partner.descriptors.get(at as usize).unwrap_or(&Descriptor::OUTSIDE);
        }
        // This loop is separate from the loads, so that it vectorizes.
        let n = self.at.len();
        for (cost, other) in self.costs[k * n..(k + 1) * n].iter_mut().zip(&self.descriptors) {
            *cost = own.cost(*other);
        }
    }

    /// Writes the cost of each level to `out`: the mean cost of the point in the partners' images that contain it. Only
    /// the half of these images with the smaller costs counts; of three, two count.
    #[inline(always)]
    fn better_half(&mut self, out: &mut [u8]) {
        let n = out.len();
        // Three and four partners, the usual numbers, are computed without branches.
        if self.costs.len() == 4 * n {
            let (a, rest) = self.costs.split_at(n);
            let (b, rest) = rest.split_at(n);
            let (c, d) = rest.split_at(n);
            for (k, out) in out.iter_mut().enumerate() {
                let (low, high) = (a[k].min(b[k]), a[k].max(b[k]));
                let (low2, high2) = (c[k].min(d[k]), c[k].max(d[k]));
                let first = low.min(low2);
                let (middle, middle2) = (low.max(low2), high.min(high2));
                let second = middle.min(middle2);
                let needed = if self.partners == 4 { second } else { middle.max(middle2) };
                let mean = ((u16::from(first) + u16::from(second)) / 2) as u8;
                let seen = if needed == u8::MAX { first } else { mean };
                *out = if first == u8::MAX { UNSEEN_COST } else { seen };
            }
            return;
        }
        for (level, out) in out.iter_mut().enumerate() {
            self.sorted.clear();
            let costs = self.costs.iter().skip(level).step_by(n);
            self.sorted.extend(costs.filter(|c| **c < u8::MAX));
            self.sorted.sort_unstable();
            let half = self.sorted.len().div_ceil(2);
            let sum: u32 = self.sorted[..half].iter().map(|&c| u32::from(c)).sum();
            *out = if half > 0 { (sum / half as u32) as u8 } else { UNSEEN_COST };
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::CameraModel;
    use crate::camera::tests::pinhole_at;
    use crate::random::Random;
    use crate::raster::Image;

    fn noise(x: f64, random: &mut Random) -> CensusImage {
        let model = CameraModel::Pinhole { fx: 60.0, fy: 60.0, cx: 20.0, cy: 15.0 };
        let camera = Camera { width: 41, height: 30, model, ..pinhole_at([x, 0.01 * x, 0.0]) };
        let data = (0..41 * 30).map(|_| random.unit() as f32).collect();
        CensusImage::new(camera, Image::from_data(41, 30, 1, data))
    }

    /// Checks that the costs are bit-identical with every instruction set.
    #[test]
    fn costs_depend_on_no_instruction_set() {
        let mut random = Random::new(5);
        let all = [0.0, 0.06, -0.06, 0.12, -0.12].map(|x| noise(x, &mut random));
        let levels = DepthLevels::new([0.3, 2.0], 0.05);
        for count in 1..5 {
            let set = StereoSet::new(&all[0], all[1..=count].iter());
            let found = cost_volume(&set, &levels);
            let inverses: Vec<f32> = (0..levels.count).map(|l| levels.at(l as f32)).collect();
            let mut scratch = MatchScratch::new(&set, levels.count);
            let mut costs = vec![0; 41 * levels.count];
            for (y, found) in found.chunks_exact(41 * levels.count).enumerate() {
                scratch.rays.set(y);
                row_costs_by(&set, y, &inverses, &mut scratch, &mut costs);
                assert!(costs == found);
            }
        }
    }

    #[test]
    fn the_mean_of_the_better_half_counts() {
        let cases: [(&[u8], u8); 8] = [
            (&[10, 40, 20, 60], 15),
            (&[255, 40, 20, 60], 30),
            (&[255, 40, 255, 255], 40),
            (&[255; 4], UNSEEN_COST),
            // If three partners see the point, the two smaller costs count.
            (&[40, 20, 60], 30),
            (&[40, 255, 20], 20),
            (&[255, 70, 255], 70),
            (&[255; 3], UNSEEN_COST),
        ];
        let image = noise(0.0, &mut Random::new(1));
        for (costs, expected) in cases {
            let set = StereoSet::new(&image, std::iter::repeat_n(&image, costs.len()));
            let mut scratch = MatchScratch::new(&set, 1);
            scratch.costs[..costs.len()].copy_from_slice(costs);
            let mut out = [0];
            scratch.better_half(&mut out);
            assert_eq!(out, [expected]);
        }
    }
}
