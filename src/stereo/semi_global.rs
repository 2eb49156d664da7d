//! Semi-global matching (Hirschmüller, TPAMI 2008): costs plus what neighbours along eight directions say.

use crate::raster::Image;
use crate::simd::multiversion;

/// Penalty of a step by one level, in units of the costs. Larger: slanted surfaces become stairs; smaller:
/// noise.
const SMALL_STEP: i16 = 6;
/// Penalty of a jump where the image is flat. Larger: thin things vanish; smaller: flat surfaces tear.
const JUMP: i16 = 70;
/// Smallest penalty of a jump, at strong image edges. Larger: surfaces swell over their outlines; smaller:
/// texture tears surfaces.
const MIN_JUMP: i16 = 14;
/// Difference of grey values, 0..=1, at which the penalty of a jump has fallen to half. Larger: jumps are as
/// costly at edges as elsewhere; smaller: noise counts as an edge.
const EDGE: f32 = 0.03;

/// A cost no path reaches.
const NEVER: i16 = i16::MAX / 4;

/// The sums over eight directions, pixel by pixel, level by level.
pub(super) fn aggregate(costs: &[u8], gray: &Image, levels: usize) -> Vec<i16> {
    let mut sums = vec![0_i16; costs.len()];
    for backward in [false, true] {
        sweep(costs, gray, levels, &mut sums, backward);
    }
    sums
}

multiversion! {
    fn sweep(costs: &[u8], gray: &Image, n: usize, sums: &mut [i16], backward: bool) = sweep_by
}

/// Adds four directions: those that come from the left and from above, or the opposite ones.
#[inline(always)]
fn sweep_by(costs: &[u8], gray: &Image, n: usize, sums: &mut [i16], backward: bool) {
    let (w, h) = (gray.width(), gray.height());
    // Paths are padded by a level at both ends, so that the loops need no bounds.
    let pad = n + 2;
    let mut above = [0; 3].map(|_| vec![NEVER; w * pad]);
    let mut above_least = [0; 3].map(|_| vec![0_i16; w]);
    let mut here = above.clone();
    let mut here_least = above_least.clone();
    let mut left = vec![NEVER; pad];
    let mut next = vec![NEVER; pad];
    for row in 0..h {
        let y = if backward { h - 1 - row } else { row };
        let mut left_least = 0;
        for column in 0..w {
            let x = if backward { w - 1 - column } else { column };
            let k = y * w + x;
            let cost = &costs[k * n..(k + 1) * n];
            let sum = &mut sums[k * n..(k + 1) * n];
            let value = gray.data()[k];
            let least = step(
                (column > 0).then_some((&left, left_least)),
                jump(value, gray, if backward { (x + 1, y) } else { (x.wrapping_sub(1), y) }),
                cost,
                (&mut next, sum),
            );
            std::mem::swap(&mut left, &mut next);
            left_least = least;
            for (direction, dx) in [-1_isize, 0, 1].into_iter().enumerate() {
                let from = x as isize + dx;
                let inside = row > 0 && from >= 0 && from < w as isize;
                let from_y = if backward { y + 1 } else { y.wrapping_sub(1) };
                let at = from as usize;
                let before = if inside {
                    Some((&above[direction][at * pad..(at + 1) * pad], above_least[direction][at]))
                } else {
                    None
                };
                let penalty = jump(value, gray, (at, from_y));
                let out = &mut here[direction][x * pad..(x + 1) * pad];
                here_least[direction][x] = step(before, penalty, cost, (out, sum));
            }
        }
        std::mem::swap(&mut above, &mut here);
        std::mem::swap(&mut above_least, &mut here_least);
    }
}

/// The penalty of a jump between a pixel of this value and another one.
fn jump(value: f32, gray: &Image, (x, y): (usize, usize)) -> i16 {
    if x >= gray.width() || y >= gray.height() {
        return JUMP;
    }
    let difference = (gray.pixel(x, y)[0] - value).abs();
    ((f32::from(JUMP) / (1.0 + difference / EDGE)) as i16).max(MIN_JUMP)
}

/// One step along a path: the costs of all levels, and the least of them.
#[inline(always)]
fn step<P: AsRef<[i16]> + ?Sized>(
    before: Option<(&P, i16)>,
    jump: i16,
    cost: &[u8],
    (out, sum): (&mut [i16], &mut [i16]),
) -> i16 {
    let n = cost.len();
    let out = &mut out[..n + 2];
    let mut least = NEVER;
    match before {
        None => {
            for ((out, sum), &cost) in out[1..=n].iter_mut().zip(sum).zip(cost) {
                *out = i16::from(cost);
                *sum += *out;
                least = least.min(*out);
            }
        }
        Some((before, before_least)) => {
            let before = &before.as_ref()[..n + 2];
            let bound = before_least + jump;
            let (low, same, high) = (&before[..n], &before[1..=n], &before[2..]);
            let paths = low.iter().zip(same).zip(high);
            for (((out, sum), &cost), ((&low, &same), &high)) in
                out[1..=n].iter_mut().zip(sum).zip(cost).zip(paths)
            {
                let stepped = low.min(high) + SMALL_STEP;
                let best = same.min(stepped).min(bound) - before_least;
                *out = i16::from(cost) + best;
                *sum += *out;
                least = least.min(*out);
            }
        }
    }
    least
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::Random;

    /// The very same numbers with every instruction set.
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
