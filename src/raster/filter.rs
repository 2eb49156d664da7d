//! Means over windows.

/// The box filter of a `w`×`h` plane: the mean over a (2·radius + 1)² window, of its part inside the plane.
pub(crate) fn box_filter(values: &[f32], w: usize, h: usize, radius: usize) -> Vec<f32> {
    let span = |at: usize, size: usize| (at.saturating_sub(radius), (at + radius + 1).min(size));
    let mut across = vec![0.0_f32; values.len()];
    // Where the whole window is inside.
    let inside = radius.min(w)..w.saturating_sub(radius).max(radius.min(w));
    let share = 1.0 / (2 * radius + 1) as f32;
    for (row, out) in values.chunks_exact(w).zip(across.chunks_exact_mut(w)) {
        for x in (0..inside.start).chain(inside.end..w) {
            let (from, to) = span(x, w);
            out[x] = row[from..to].iter().sum::<f32>() / (to - from) as f32;
        }
        let n = inside.len();
        let out = &mut out[inside.clone()];
        // One column of the window after the other, over many pixels at a time.
        for first in 0..=(2 * radius).min(w - n) {
            for (out, v) in out.iter_mut().zip(&row[first..first + n]) {
                *out += share * v;
            }
        }
    }
    let mut out = vec![0.0; values.len()];
    // In f64, what is added and taken away again leaves nothing in f32.
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
