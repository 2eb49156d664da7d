//! How well the neighbours of a camera agree with it, at every depth.

use super::camera_image::CameraImage;
use super::census::{Descriptor, descriptors};
use super::levels::Levels;
use super::relative::Relative;
use crate::camera::Camera;
use crate::lumigraph::RayRow;
use crate::raster::Image;
use rayon::prelude::*;

/// Largest difference of grey values that counts, of 255. Larger: highlights decide; smaller: flat surfaces
/// of different grey are alike.
const MAX_GRAY: i32 = 24;
/// What one differing bit of the census codes counts, in grey values. Larger: noise decides on flat surfaces;
/// smaller: cameras must be equally bright.
const BIT: u32 = 2;
/// Cost where no neighbour sees the point: that of a poor match. Larger: surfaces avoid the image's border;
/// smaller: they seek it.
const UNSEEN: u8 = 40;

/// A camera's image, prepared.
pub(super) struct Prepared {
    camera: Camera,
    gray: Image,
    descriptors: Vec<Descriptor>,
}

impl Prepared {
    pub fn new(view: &CameraImage) -> Self {
        Self::of(view.camera.clone(), view.image.to_gray())
    }

    fn of(camera: Camera, gray: Image) -> Self {
        let descriptors = descriptors(&gray);
        Self { camera, gray, descriptors }
    }

    /// The same at half the size, without the last row or column of an odd number. `None` if nothing is left.
    pub fn halved(&self) -> Option<Self> {
        let camera = self.camera.halved().filter(|c| c.width > 1 && c.height > 1)?;
        let at = |x: usize, y: usize| self.gray.pixel(x, y)[0];
        let mean = |k: usize| {
            let (x, y) = (2 * (k % camera.width), 2 * (k / camera.width));
            0.25 * (at(x, y) + at(x + 1, y) + at(x, y + 1) + at(x + 1, y + 1))
        };
        let (w, h) = (camera.width, camera.height);
        let gray = Image::from_data(w, h, 1, (0..w * h).map(mean).collect());
        Some(Self::of(camera, gray))
    }

    pub fn camera(&self) -> &Camera {
        &self.camera
    }

    pub fn gray(&self) -> &Image {
        &self.gray
    }
}

/// The inverse depths of an image of twice the size of `coarse`: every pixel takes that of the four coarse
/// pixels around it at which it matches its partners best.
pub(super) fn upsampled(
    values: &[f32],
    coarse: &Camera,
    reference: &Prepared,
    partners: &[&Prepared],
) -> Vec<f32> {
    let camera = reference.camera();
    let w = camera.width;
    let relatives: Vec<Relative> =
        partners.iter().map(|p| Relative::new(camera, p.camera())).collect();
    let mut out = vec![f32::NAN; w * camera.height];
    let around = |v: usize, size: usize| {
        let near = (v / 2).min(size - 1);
        let other =
            if v.is_multiple_of(2) { near.saturating_sub(1) } else { (near + 1).min(size - 1) };
        [near, other]
    };
    out.par_chunks_mut(w).enumerate().for_each_init(
        || (RayRow::new(camera), Scratch::new(4, partners.len()), [0; 4]),
        |(rays, scratch, costs), (y, out)| {
            rays.set(y);
            for (x, out) in out.iter_mut().enumerate() {
                let (columns, rows) = (around(x, coarse.width), around(y, coarse.height));
                let candidate = |k: usize| values[rows[k / 2] * coarse.width + columns[k % 2]];
                let candidates = [0, 1, 2, 3].map(candidate);
                let ray = [rays.x[x] as f32, rays.y[x] as f32];
                for (k, relative) in relatives.iter().enumerate() {
                    let turned = relative.turned(ray[0], ray[1]);
                    for (n, candidate) in candidates.iter().enumerate() {
                        let point = relative.point(&turned, *candidate);
                        [scratch.x[n], scratch.y[n]] = relative.pixel(&point);
                    }
                    let own = &reference.descriptors[y * w + x];
                    scratch.compare(own, partners[k], k);
                }
                better_half(scratch, costs);
                // The first of equals is the nearest.
                let best = (0..4).min_by_key(|&n| costs[n]).unwrap_or(0);
                *out = candidates[best];
            }
        },
    );
    out
}

/// Costs of all levels at every pixel of `reference`, pixel by pixel: the mean of the better half of its
/// partners, because the others may not see the point.
pub(super) fn costs(reference: &Prepared, partners: &[&Prepared], levels: &Levels) -> Vec<u8> {
    let camera = reference.camera();
    let (w, n) = (camera.width, levels.count);
    let relatives: Vec<Relative> =
        partners.iter().map(|p| Relative::new(camera, p.camera())).collect();
    let inverses: Vec<f32> = (0..n).map(|level| levels.at(level as f32)).collect();
    let mut out = vec![UNSEEN; w * camera.height * n];
    out.par_chunks_mut(w * n).enumerate().for_each_init(
        || (RayRow::new(camera), Scratch::new(n, partners.len())),
        |(rays, scratch), (y, out)| {
            rays.set(y);
            let own = &reference.descriptors[y * w..(y + 1) * w];
            let row = Row { own, partners, relatives: &relatives, inverses: &inverses, rays };
            row.costs(scratch, out);
        },
    );
    out
}

/// One row of the reference.
struct Row<'a> {
    own: &'a [Descriptor],
    partners: &'a [&'a Prepared],
    relatives: &'a [Relative],
    /// The inverse depths of the levels, 1/m.
    inverses: &'a [f32],
    rays: &'a RayRow<'a>,
}

/// Space for one pixel.
struct Scratch {
    /// Positions, level by level.
    x: Vec<f32>,
    y: Vec<f32>,
    /// The pixels there; [`OUTSIDE`] where there is none.
    at: Vec<u32>,
    there: Vec<Descriptor>,
    /// Costs, partner by partner; 255 where the partner doesn't see the point.
    each: Vec<u8>,
    ranked: Vec<u8>,
}

impl Scratch {
    fn new(levels: usize, partners: usize) -> Self {
        let zeros = || vec![0.0; levels];
        let each = vec![0; levels * partners];
        let (at, there) = (vec![0; levels], vec![Descriptor::NOWHERE; levels]);
        Self { x: zeros(), y: zeros(), at, there, each, ranked: Vec::new() }
    }
}

impl Row<'_> {
    fn costs(&self, scratch: &mut Scratch, out: &mut [u8]) {
        #[cfg(target_arch = "x86_64")]
        if is_x86_feature_detected!("avx2") && is_x86_feature_detected!("popcnt") {
            // Safe: the processor has both.
            return unsafe { self.costs_avx2(scratch, out) };
        }
        self.costs_by(scratch, out);
    }

    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2,popcnt")]
    fn costs_avx2(&self, scratch: &mut Scratch, out: &mut [u8]) {
        self.costs_by(scratch, out);
    }

    #[inline(always)]
    fn costs_by(&self, scratch: &mut Scratch, out: &mut [u8]) {
        let n = self.inverses.len();
        for (x, out) in out.chunks_exact_mut(n).enumerate() {
            let ray = [self.rays.x[x] as f32, self.rays.y[x] as f32];
            for k in 0..self.partners.len() {
                self.relatives[k].path(ray, self.inverses, &mut scratch.x, &mut scratch.y);
                scratch.compare(&self.own[x], self.partners[k], k);
            }
            better_half(scratch, out);
        }
    }
}

/// The index of a pixel outside the image: beyond any image.
const OUTSIDE: u32 = u32::MAX;

impl Scratch {
    /// The costs of partner `k` at the positions.
    #[inline(always)]
    fn compare(&mut self, own: &Descriptor, partner: &Prepared, k: usize) {
        let (w, h) = (partner.gray.width(), partner.gray.height());
        let (wf, hf) = (w as f32, h as f32);
        for ((at, &x), &y) in self.at.iter_mut().zip(&self.x).zip(&self.y) {
            // Also false for NaN.
            let seen = (x >= 0.0) & (y >= 0.0) & (x < wf) & (y < hf);
            let (x, y) = if seen { (x, y) } else { (0.0, 0.0) };
            // Safe: both are finite and not larger than the image. A plain `as` checks that again.
            let pixel =
                unsafe { y.to_int_unchecked::<i32>() * w as i32 + x.to_int_unchecked::<i32>() };
            *at = if seen { pixel as u32 } else { OUTSIDE };
        }
        for (there, &at) in self.there.iter_mut().zip(&self.at) {
            *there = *partner.descriptors.get(at as usize).unwrap_or(&Descriptor::NOWHERE);
        }
        // Apart from the loads, so that it is vectorized.
        let n = self.at.len();
        for (cost, there) in self.each[k * n..(k + 1) * n].iter_mut().zip(&self.there) {
            *cost = own.cost(*there, BIT, MAX_GRAY);
        }
    }
}

/// The mean of the two least costs if there is the third that is named, else the least.
#[inline(always)]
fn mean_or(first: u8, second: u8, needed: u8) -> u8 {
    let both = ((u16::from(first) + u16::from(second)) / 2) as u8;
    let some = if needed == u8::MAX { first } else { both };
    if first == u8::MAX { UNSEEN } else { some }
}

/// The mean of the better half of the partners' costs, level by level.
#[inline(always)]
fn better_half(scratch: &mut Scratch, out: &mut [u8]) {
    let n = out.len();
    let Scratch { each, ranked, .. } = scratch;
    // The usual numbers without branches.
    if each.len() == 4 * n {
        let (a, rest) = each.split_at(n);
        let (b, rest) = rest.split_at(n);
        let (c, d) = rest.split_at(n);
        for (k, out) in out.iter_mut().enumerate() {
            let (low, high) = (a[k].min(b[k]), a[k].max(b[k]));
            let (low2, high2) = (c[k].min(d[k]), c[k].max(d[k]));
            let first = low.min(low2);
            let second = low.max(low2).min(high.min(high2));
            *out = mean_or(first, second, second);
        }
        return;
    }
    if each.len() == 3 * n {
        let (a, rest) = each.split_at(n);
        let (b, c) = rest.split_at(n);
        for (k, out) in out.iter_mut().enumerate() {
            let (low, high) = (a[k].min(b[k]), a[k].max(b[k]));
            let second = low.max(high.min(c[k]));
            *out = mean_or(low.min(c[k]), second, high.max(c[k]));
        }
        return;
    }
    for (level, out) in out.iter_mut().enumerate() {
        ranked.clear();
        ranked.extend(each.iter().skip(level).step_by(n).filter(|c| **c < u8::MAX));
        ranked.sort_unstable();
        let half = ranked.len().div_ceil(2);
        let sum: u32 = ranked[..half].iter().map(|&c| u32::from(c)).sum();
        *out = if half > 0 { (sum / half as u32) as u8 } else { UNSEEN };
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::CameraModel;
    use crate::camera::tests::pinhole_at;
    use crate::random::Random;

    fn noise(x: f64, random: &mut Random) -> Prepared {
        let model = CameraModel::Pinhole { fx: 60.0, fy: 60.0, cx: 20.0, cy: 15.0 };
        let camera = Camera { width: 41, height: 30, model, ..pinhole_at([x, 0.01 * x, 0.0]) };
        let data = (0..41 * 30).map(|_| random.unit() as f32).collect();
        Prepared::of(camera, Image::from_data(41, 30, 1, data))
    }

    /// The very same numbers with every instruction set.
    #[test]
    fn costs_depend_on_no_instruction_set() {
        let mut random = Random::new(5);
        let all = [0.0, 0.06, -0.06, 0.12, -0.12].map(|x| noise(x, &mut random));
        let levels = Levels::new([0.3, 2.0], 0.05);
        for count in 1..5 {
            let partners: Vec<&Prepared> = all[1..=count].iter().collect();
            let relatives: Vec<Relative> =
                partners.iter().map(|p| Relative::new(&all[0].camera, &p.camera)).collect();
            let found = costs(&all[0], &partners, &levels);
            let inverses: Vec<f32> = (0..levels.count).map(|l| levels.at(l as f32)).collect();
            let mut rays = RayRow::new(&all[0].camera);
            let mut scratch = Scratch::new(levels.count, partners.len());
            let mut row_costs = vec![0; 41 * levels.count];
            for (y, found) in found.chunks_exact(41 * levels.count).enumerate() {
                rays.set(y);
                let own = &all[0].descriptors[y * 41..(y + 1) * 41];
                let (partners, relatives) = (&partners[..], &relatives[..]);
                let row = Row { own, partners, relatives, inverses: &inverses, rays: &rays };
                row.costs_by(&mut scratch, &mut row_costs);
                assert!(row_costs == found);
            }
        }
    }

    #[test]
    fn the_mean_of_the_better_half_counts() {
        let mut scratch = Scratch::new(1, 4);
        for (each, expected) in [
            ([10, 40, 20, 60], 15),
            ([255, 40, 20, 60], 30),
            ([255, 40, 255, 255], 40),
            ([255; 4], UNSEEN),
        ] {
            scratch.each.copy_from_slice(&each);
            let mut out = [0];
            better_half(&mut scratch, &mut out);
            // Of three that see the point, two count.
            assert_eq!(out, [expected]);
        }
        for (each, expected) in
            [([40, 20, 60], 30), ([40, 255, 20], 20), ([255, 70, 255], 70), ([255; 3], UNSEEN)]
        {
            let mut three = Scratch::new(1, 3);
            three.each.copy_from_slice(&each);
            let mut out = [0];
            better_half(&mut three, &mut out);
            assert_eq!(out, [expected]);
        }
    }
}
