//! What is hidden from every camera: its colour comes from the surfaces around it that it may be a part of.

use super::DepthMap;
use crate::raster::Image;

/// The nearest pixel before another one along a line that is seen, and is no nearer to the view.
#[derive(Clone, Copy)]
struct Seen {
    pixel: usize,
    distance_px: f32,
}

/// What a camera shows of a pixel's point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Shown {
    /// The point itself.
    Seen,
    /// What hides it.
    Hidden,
    /// Nothing: no camera has it in its image.
    Nothing,
}

/// Fills the hidden pixels of an image with the mean of the nearest seen pixels to the left, to the right, above
/// and below, weighted by nearness. A pixel of a surface that is nearer to the view by more than a fraction of its
/// depth counts for none: it is what hides. Where there is none, pixels stay as they are.
pub(super) fn fill(image: &mut Image, shown: &[Shown], depth: &DepthMap, fraction: f32) {
    if !shown.contains(&Shown::Hidden) {
        return;
    }
    let (w, h, channels) = (image.width(), image.height(), image.channels());
    let mut sums = vec![[0.0_f32; 4]; w * h];
    let mut run = |line: &mut dyn Iterator<Item = usize>| {
        let mut last: Option<Seen> = None;
        for k in line {
            if shown[k] == Shown::Seen {
                last = Some(Seen { pixel: k, distance_px: 0.0 });
                continue;
            }
            let Some(seen) = &mut last else { continue };
            seen.distance_px += 1.0;
            let [own, other] = [k, seen.pixel].map(|k| depth.data()[k]);
            // Also false where one of them has no depth.
            if other >= own * (1.0 - fraction) {
                let weight = 1.0 / seen.distance_px;
                for (sum, v) in
                    sums[k].iter_mut().zip(image.data()[seen.pixel * channels..][..channels].iter())
                {
                    *sum += weight * v;
                }
                sums[k][3] += weight;
            }
        }
    };
    for y in 0..h {
        run(&mut (0..w).map(|x| y * w + x));
        run(&mut (0..w).rev().map(|x| y * w + x));
    }
    for x in 0..w {
        run(&mut (0..h).map(|y| y * w + x));
        run(&mut (0..h).rev().map(|y| y * w + x));
    }
    for ((pixel, sum), of) in image.data_mut().chunks_exact_mut(channels).zip(&sums).zip(shown) {
        if *of == Shown::Hidden && sum[3] > 0.0 {
            for (out, sum_of_channel) in pixel.iter_mut().zip(sum) {
                *out = sum_of_channel / sum[3];
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A body at 1 m before a wall at 2 m; right of it, a band of the wall that no camera sees.
    #[test]
    fn what_is_hidden_is_filled_from_behind() {
        let (w, h) = (12, 5);
        let is_body = |x: usize| (3..6).contains(&x);
        let is_hidden = |x: usize| (6..8).contains(&x);
        let depth = (0..w * h).map(|k| if is_body(k % w) { 1.0 } else { 2.0 }).collect();
        let depth = DepthMap::from_data(w, h, depth);
        let of = |x: usize| if is_hidden(x) { Shown::Hidden } else { Shown::Seen };
        let shown: Vec<Shown> = (0..w * h).map(|k| of(k % w)).collect();
        let value = |x: usize| if is_body(x) || is_hidden(x) { 0.9 } else { 0.2 };
        let data: Vec<f32> = (0..w * h * 3).map(|k| value(k / 3 % w)).collect();
        let mut image = Image::from_data(w, h, 3, data);
        fill(&mut image, &shown, &depth, 0.03);
        for (k, v) in image.data().iter().enumerate() {
            let expected = if is_body(k / 3 % w) { 0.9 } else { 0.2 };
            assert!((v - expected).abs() < 1e-6, "{k}: {v}");
        }
    }

    #[test]
    fn what_has_nothing_behind_it_stays() {
        let depth = DepthMap::from_data(3, 1, vec![1.0, f32::NAN, 1.0]);
        let mut image = Image::from_data(3, 1, 1, vec![0.1, 0.5, 0.3]);
        fill(&mut image, &[Shown::Seen, Shown::Hidden, Shown::Seen], &depth, 0.03);
        assert_eq!(image.data(), [0.1, 0.5, 0.3]);
        fill(&mut image, &[Shown::Hidden; 3], &depth, 0.03);
        assert_eq!(image.data(), [0.1, 0.5, 0.3]);
    }

    /// A pixel that no camera shows is black, whatever its depth.
    #[test]
    fn nothing_comes_from_pixels_that_no_camera_shows() {
        let depth = DepthMap::from_data(4, 1, vec![2.0; 4]);
        let mut image = Image::from_data(4, 1, 1, vec![0.0, 0.9, 0.9, 0.4]);
        fill(
            &mut image,
            &[Shown::Nothing, Shown::Hidden, Shown::Hidden, Shown::Seen],
            &depth,
            0.03,
        );
        assert_eq!(image.data(), [0.0, 0.4, 0.4, 0.4]);
    }
}
