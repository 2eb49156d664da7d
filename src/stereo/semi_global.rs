//! Semi-global matching (Hirschmüller, TPAMI 2008): costs are aggregated along eight directions.

use super::cost_volume::DepthLevels;
use crate::raster::Image;
use crate::simd::multiversion;

/// Penalty of a change by one depth level between neighbouring pixels (Hirschmüller's P1), in units of the matching
/// costs.
const STEP_PENALTY: i16 = 6;
/// Penalty of a change by more than one depth level between neighbouring pixels with equal grey values (Hirschmüller's
/// P2), in units of the matching costs.
const JUMP_PENALTY: i16 = 70;
/// Minimum of Hirschmüller's penalty P2, which applies at strong image edges, in units of the matching costs.
const MIN_JUMP_PENALTY: i16 = 14;
/// Difference between neighbouring pixels' grey values, 0 to 1, at which Hirschmüller's penalty P2 is halved.
const EDGE_DIFFERENCE: f32 = 0.03;

/// Cost of depth levels outside the range of levels. It is larger than the cost of any path.
const UNREACHABLE: i16 = i16::MAX / 4;

/// Aggregates matching costs along eight directions, and returns the sum over the directions for each pixel and depth
/// level. `costs` and the result are pixel by pixel, and level by level within a pixel. `levels` is the number of depth
/// levels.
pub(super) fn aggregate(costs: &[u8], gray: &Image, levels: usize) -> Vec<i16> {
    let mut sums = vec![0_i16; costs.len()];
    for backward in [false, true] {
        sweep(costs, gray, levels, &mut sums, backward);
    }
    sums
}

multiversion! {
    /// Adds the costs that are aggregated along four directions to `sums`. The directions are from the left and from
    /// the three pixels above or, with `backward`, from the right and from the three pixels below. `n` is the number of
    /// depth levels.
    fn sweep(costs: &[u8], gray: &Image, n: usize, sums: &mut [i16], backward: bool) = sweep_by
}

#[inline(always)]
fn sweep_by(costs: &[u8], gray: &Image, n: usize, sums: &mut [i16], backward: bool) {
    let (w, h) = (gray.width(), gray.height());
    let back = if backward { 1 } else { -1 };
    // A path is stored as its costs by level, with one element of padding on both sides, followed by the minimum of its
    // costs. A row of paths has one more path at either end, with costs of 0. Paths at the image's border start there.
    let len = n + 3;
    let mut zero = vec![0; len];
    (zero[0], zero[n + 1]) = (UNREACHABLE, UNREACHABLE);
    let mut above = [0; 3].map(|_| zero.repeat(w + 2));
    let mut here = above.clone();
    let (mut left, mut next) = (zero.clone(), zero.clone());
    for row in 0..h {
        let y = if backward { h - 1 - row } else { row };
        left.copy_from_slice(&zero);
        for column in 0..w {
            let x = if backward { w - 1 - column } else { column };
            let levels = (y * w + x) * n..(y * w + x + 1) * n;
            let (cost, sum) = (&costs[levels.clone()], &mut sums[levels]);
            let jump = |dx: isize, dy: isize| {
                let from = [x.wrapping_add_signed(dx), y.wrapping_add_signed(dy)];
                jump_penalty(gray, [x, y], from)
            };
            extend(&left, jump(back, 0), cost, &mut next, sum);
            std::mem::swap(&mut left, &mut next);
            for (direction, dx) in [-1_isize, 0, 1].into_iter().enumerate() {
                let at = (x + 1).wrapping_add_signed(dx);
                let before = &above[direction][at * len..(at + 1) * len];
                let out = &mut here[direction][(x + 1) * len..(x + 2) * len];
                extend(before, jump(dx, back), cost, out, sum);
            }
        }
        std::mem::swap(&mut above, &mut here);
    }
}

/// Returns the penalty P2 of a change by more than one depth level between two neighbouring pixels, each given as [x,
/// y]. The penalty is smaller across an image edge.
#[inline(always)]
fn jump_penalty(gray: &Image, [x, y]: [usize; 2], from: [usize; 2]) -> i16 {
    if from[0] >= gray.width() || from[1] >= gray.height() {
        return JUMP_PENALTY;
    }
    let difference = (gray.pixel(from[0], from[1])[0] - gray.pixel(x, y)[0]).abs();
    ((f32::from(JUMP_PENALTY) / (1.0 + difference / EDGE_DIFFERENCE)) as i16).max(MIN_JUMP_PENALTY)
}

/// Extends a path by one pixel. `before` are the path's costs at the previous pixel, `jump` is the penalty P2, and
/// `cost` are the new pixel's matching costs by level. Writes the path's new costs and their minimum to `out`, and adds
/// the new costs to `sum`.
#[inline(always)]
fn extend(before: &[i16], jump: i16, cost: &[u8], out: &mut [i16], sum: &mut [i16]) {
    let n = cost.len();
    let before_min = before[n + 2];
    let paths = before[..n].iter().zip(&before[1..=n]).zip(&before[2..n + 2]);
    let bound = before_min + jump;
    let mut min = UNREACHABLE;
    for (((out, sum), &cost), ((&low, &same), &high)) in
        out[1..=n].iter_mut().zip(sum).zip(cost).zip(paths)
    {
        let stepped = low.min(high) + STEP_PENALTY;
        *out = i16::from(cost) + same.min(stepped).min(bound) - before_min;
        *sum += *out;
        min = min.min(*out);
    }
    out[n + 2] = min;
}

/// Returns, for every pixel, the inverse depth with the smallest sum of aggregated costs, 1/m. A parabola through the
/// sums of neighbouring levels gives fractions of a level.
pub(super) fn winner_takes_all(sums: &[i16], levels: &DepthLevels) -> Vec<f32> {
    let n = levels.count;
    let of = |sums: &[i16]| {
        // The minimum is found first, and then its first index, because both searches vectorize.
        let min = sums.iter().copied().min();
        let best = sums.iter().position(|sum| Some(*sum) == min).unwrap_or(0);
        let mut level = best as f32;
        if best > 0 && best + 1 < n {
            let [a, b, c] = [sums[best - 1], sums[best], sums[best + 1]].map(f32::from);
            // The curvature is not negative, since b is the minimum.
            let curvature = a - 2.0 * b + c;
            if curvature > 0.0 {
                level += 0.5 * (a - c) / curvature;
            }
        }
        levels.at(level)
    };
    sums.chunks_exact(n).map(of).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::Random;

    /// Checks that the sums are bit-identical with every instruction set.
    #[test]
    fn sums_depend_on_no_instruction_set() {
        let mut random = Random::new(4);
        let (w, h, n) = (23, 11, 37);
        let costs: Vec<u8> = (0..w * h * n).map(|_| (random.unit() * 72.0) as u8).collect();
        let data = (0..w * h).map(|_| random.unit() as f32).collect();
        let gray = Image::from_data(w, h, 1, data);
        let mut sums = vec![0; costs.len()];
        for backward in [false, true] {
            sweep_by(&costs, &gray, n, &mut sums, backward);
        }
        assert!(sums == aggregate(&costs, &gray, n));
    }
}
