//! Sliding-window filters: maximum and mean.

/// Slides a window over `values`, and combines the values in it by a commutative and associative operation, such as the
/// sum. A window has `count` values, at indices `stride` apart. Returns one result per window position. A window is
/// combined from windows of half the length, so the time per value is logarithmic in `count`.
///
/// # Panics
/// If `count` is 0, or if no window fits into the values.
fn sliding(
    values: &[f32],
    count: usize,
    stride: usize,
    combine: impl Fn(f32, f32) -> f32,
) -> Vec<f32> {
    let out_len = values.len() - (count - 1) * stride;
    let pairs = |a: &[f32], b: &[f32]| a.iter().zip(b).map(|(a, b)| combine(*a, *b)).collect();
    // Each element of `doubled` is the result of a window of `power` values.
    let mut doubled = values.to_vec();
    let (mut power, mut done) = (1, 0);
    let mut out: Option<Vec<f32>> = None;
    loop {
        if count & power != 0 {
            let rest = &doubled[done * stride..][..out_len];
            out = Some(out.map_or_else(|| rest.to_vec(), |out| pairs(&out, rest)));
            done += power;
        }
        if done == count {
            return out.expect("the count is not 0");
        }
        doubled = pairs(&doubled, &doubled[power * stride..]);
        power *= 2;
    }
}

/// Adds `count` copies of `value` to both ends of each row of a plane. Rows are `w` values long.
pub(crate) fn padded(values: &[f32], w: usize, count: usize, value: f32) -> Vec<f32> {
    let mut out = vec![value; values.len() / w * (w + 2 * count)];
    for (row, out) in values.chunks_exact(w).zip(out.chunks_exact_mut(w + 2 * count)) {
        out[count..count + w].copy_from_slice(row);
    }
    out
}

/// Computes the maximum filter of a plane of width `w`: the maximum over a (2·radius + 1)² window, clipped at the
/// borders.
pub(crate) fn max_filter(values: &[f32], w: usize, radius: usize) -> Vec<f32> {
    let side = 2 * radius + 1;
    let along_rows = sliding(&padded(values, w, radius, f32::NEG_INFINITY), side, 1, f32::max);
    let mut padded_rows = vec![f32::NEG_INFINITY; values.len() + 2 * radius * w];
    let rows = padded_rows[radius * w..].chunks_exact_mut(w);
    for (row, out) in along_rows.chunks(w + 2 * radius).zip(rows) {
        out.copy_from_slice(&row[..w]);
    }
    sliding(&padded_rows, side, w, f32::max)
}

/// Computes the box filter of a `w`×`h` plane: the mean over a (2·radius + 1)² window, clipped at the borders.
pub(crate) fn box_filter(values: &[f32], w: usize, h: usize, radius: usize) -> Vec<f32> {
    let span = |at: usize, size: usize| (at.saturating_sub(radius), (at + radius + 1).min(size));
    let shares: Vec<f32> = (0..w)
        .map(|x| {
            let (from, to) = span(x, w);
            1.0 / (to - from) as f32
        })
        .collect();
    // All rows are filtered at once. Sums over windows that reach from one row into the next are ignored.
    let sums = sliding(&padded(values, w, radius, 0.0), 2 * radius + 1, 1, |a, b| a + b);
    let mut across = Vec::with_capacity(values.len());
    for row in sums.chunks(w + 2 * radius) {
        across.extend(row.iter().zip(&shares).map(|(sum, share)| sum * share));
    }
    let mut out = vec![0.0; values.len()];
    // The sums are f64, so that adding a value and later subtracting it leaves no rounding error in f32.
    let mut column = vec![0.0_f64; w];
    let (mut from, mut to) = (0, 0);
    for y in 0..h {
        let (first, end) = span(y, h);
        for (y, sign) in (to..end).map(|y| (y, 1.0)).chain((from..first).map(|y| (y, -1.0))) {
            for (sum, v) in column.iter_mut().zip(&across[y * w..]) {
                *sum += sign * f64::from(*v);
            }
        }
        (from, to) = (first, end);
        let share = 1.0 / (end - first) as f64;
        for (out, sum) in out[y * w..(y + 1) * w].iter_mut().zip(&column) {
            *out = (share * sum) as f32;
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_maximum_filter_equals_a_search() {
        for (w, h, radius) in [(1, 1, 0), (1, 1, 3), (7, 5, 1), (16, 9, 2), (5, 12, 20)] {
            let values: Vec<f32> = (0..w * h).map(|k| ((k * 37) % 101) as f32).collect();
            for (k, largest) in max_filter(&values, w, radius).iter().enumerate() {
                let near = |a: usize, b: usize| a.abs_diff(b) <= radius;
                let inside = (0..w * h).filter(|n| near(n % w, k % w) && near(n / w, k / w));
                let direct = inside.map(|n| values[n]).fold(0.0, f32::max);
                assert!(*largest == direct, "{w}×{h}, {radius}: {largest} {direct}");
            }
        }
    }

    #[test]
    fn sliding_combines_successive_values() {
        let values: Vec<f32> = (0..60).map(|k| ((k * 37) % 101) as f32).collect();
        for (count, stride) in [(1, 1), (2, 1), (5, 1), (7, 3), (9, 5), (20, 3)] {
            let window = |k: usize| (0..count).map(move |n| k + n * stride);
            let starts = 0..60 - (count - 1) * stride;
            let sums: Vec<f32> =
                starts.clone().map(|k| window(k).map(|k| values[k]).sum()).collect();
            assert_eq!(sliding(&values, count, stride, |a, b| a + b), sums);
            let largest: Vec<f32> =
                starts.map(|k| window(k).map(|k| values[k]).fold(0.0, f32::max)).collect();
            assert_eq!(sliding(&values, count, stride, f32::max), largest);
        }
    }

    #[test]
    fn the_box_filter_equals_direct_means() {
        for (w, h, radius) in [(1, 1, 0), (1, 1, 3), (7, 5, 1), (16, 9, 2), (5, 12, 20)] {
            let values: Vec<f32> = (0..w * h).map(|k| ((k * 37) % 101) as f32 / 101.0).collect();
            let means = box_filter(&values, w, h, radius);
            for (k, mean) in means.iter().enumerate() {
                let near = |a: usize, b: usize| a.abs_diff(b) <= radius;
                let inside: Vec<f32> = (0..w * h)
                    .filter(|n| near(n % w, k % w) && near(n / w, k / w))
                    .map(|n| values[n])
                    .collect();
                let direct = inside.iter().sum::<f32>() / inside.len() as f32;
                assert!((mean - direct).abs() < 1e-6, "{w}×{h}, {radius}: {mean} {direct}");
            }
        }
    }
}
