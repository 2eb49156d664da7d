//! Scores of an image in comparison with the ground truth: error maps, and their means over sets of pixels.

use super::flip::{FlipImage, flip_map};
use super::ssim::{has_full_window, ssim_map};
use crate::raster::Image;
use serde::{Deserialize, Serialize};

/// PSNR, SSIM and FLIP over a set of pixels. In JSON files, `None` is null. No score is NaN or infinite.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Scores {
    /// Number of pixels in the measured set.
    pub pixels: usize,
    /// PSNR over all channels, 10·log₁₀(1/MSE), decibels. `None` if the set has no pixels, or if the two images are
    /// identical in the set.
    pub psnr_db: Option<f64>,
    /// Mean SSIM of the luma, in −1..=1, where 1 is best. `None` if no pixel of the set has a full SSIM window inside
    /// the image.
    pub ssim: Option<f64>,
    /// Mean FLIP, in 0..=1, where 0 is best. `None` if the set has no pixels.
    pub flip: Option<f64>,
}

/// Scores of one image over two sets of pixels: all measured pixels, and the measured pixels that show moving surfaces.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RegionScores {
    pub whole: Scores,
    pub moving: Scores,
}

/// A ground-truth image, prepared for comparison with other images: its luma and its FLIP filter responses are
/// precomputed.
pub struct ReferenceImage {
    image: Image,
    gray: Image,
    flip: FlipImage,
    pixels_per_degree: f64,
}

/// Maps of an image's errors at every pixel, row-major.
pub struct ErrorMaps {
    width: usize,
    height: usize,
    /// Squared error of every pixel: the mean over the channels.
    squared: Vec<f32>,
    ssim: Vec<f32>,
    flip: Vec<f32>,
}

impl ReferenceImage {
    /// Computes the luma and the FLIP filter responses of a ground-truth image. `pixels_per_degree` is FLIP's viewing
    /// condition: the number of pixels per degree of visual angle.
    pub fn new(image: Image, pixels_per_degree: f64) -> Self {
        let (gray, flip) = (image.to_gray(), FlipImage::new(&image, pixels_per_degree));
        Self { image, gray, flip, pixels_per_degree }
    }

    pub fn image(&self) -> &Image {
        &self.image
    }

    /// Computes the error maps of the image `test` in comparison with this ground-truth image. Both must have the same
    /// size and number of channels.
    ///
    /// # Panics
    /// If the size or the number of channels differs.
    pub fn compare(&self, test: &Image) -> ErrorMaps {
        let truth = &self.image;
        assert_eq!(
            (truth.width(), truth.height(), truth.channels()),
            (test.width(), test.height(), test.channels()),
            "an image is compared with one of its size"
        );
        let n = truth.channels();
        let pixels = truth.data().chunks_exact(n).zip(test.data().chunks_exact(n));
        let squared = pixels
            .map(|(a, b)| a.iter().zip(b).map(|(a, b)| (a - b) * (a - b)).sum::<f32>() / n as f32)
            .collect();
        ErrorMaps {
            width: truth.width(),
            height: truth.height(),
            squared,
            ssim: ssim_map(&self.gray, &test.to_gray()),
            flip: flip_map(&self.flip, &FlipImage::new(test, self.pixels_per_degree)),
        }
    }
}

impl ErrorMaps {
    /// Returns the scores over the pixels where `mask` is true, or over all pixels if `mask` is `None`. Sums are
    /// computed in row order in f64, so that they don't depend on the number of threads.
    ///
    /// # Panics
    /// If the mask's number of pixels differs from the image's.
    pub fn scores(&self, mask: Option<&[bool]>) -> Scores {
        assert!(mask.is_none_or(|m| m.len() == self.squared.len()), "a mask of the image's size");
        let (mut pixels, mut windows) = (0usize, 0usize);
        let (mut squared, mut ssim, mut flip) = (0.0f64, 0.0f64, 0.0f64);
        for k in (0..self.squared.len()).filter(|k| mask.is_none_or(|m| m[*k])) {
            pixels += 1;
            squared += f64::from(self.squared[k]);
            flip += f64::from(self.flip[k]);
            if has_full_window(k % self.width, k / self.width, self.width, self.height) {
                windows += 1;
                ssim += f64::from(self.ssim[k]);
            }
        }
        let mean = |sum: f64, n: usize| (n > 0).then(|| sum / n as f64).filter(|v| v.is_finite());
        Scores {
            pixels,
            psnr_db: mean(squared, pixels).filter(|mse| *mse > 0.0).map(|mse| -10.0 * mse.log10()),
            ssim: mean(ssim, windows),
            flip: mean(flip, pixels),
        }
    }

    /// Returns the scores over two sets of pixels: the pixels where `covered` is true, and the pixels where both
    /// `covered` and `moving` are true. `None` as `covered` stands for all pixels.
    pub fn regions(&self, covered: Option<&[bool]>, moving: &[bool]) -> RegionScores {
        let both: Option<Vec<bool>> =
            covered.map(|c| c.iter().zip(moving).map(|(c, m)| *c && *m).collect());
        RegionScores {
            whole: self.scores(covered),
            moving: self.scores(Some(both.as_deref().unwrap_or(moving))),
        }
    }
}

/// Returns the median of the values. For an even number of values, it is the mean of the middle two. `None` if there
/// are no values.
pub fn median(mut values: Vec<f64>) -> Option<f64> {
    values.sort_by(f64::total_cmp);
    let n = values.len();
    (n > 0).then(|| 0.5 * (values[(n - 1) / 2] + values[n / 2]))
}

#[cfg(test)]
mod tests {
    use super::super::flip::DEFAULT_PIXELS_PER_DEGREE;
    use super::*;

    fn textured() -> Image {
        let data = (0..16 * 12 * 3).map(|k| 0.2 + ((k * 13) % 29) as f32 / 58.0).collect();
        Image::from_data(16, 12, 3, data)
    }

    fn with_error(error: f32, at: impl Fn(usize) -> bool) -> ErrorMaps {
        let truth = textured();
        let mut test = truth.clone();
        for (k, v) in test.data_mut().iter_mut().enumerate() {
            *v += if at(k / 3) { error } else { 0.0 };
        }
        ReferenceImage::new(truth, DEFAULT_PIXELS_PER_DEGREE).compare(&test)
    }

    #[test]
    fn an_error_of_a_tenth_everywhere_is_20_db() {
        let scores = with_error(0.1, |_| true).scores(None);
        assert!((scores.psnr_db.unwrap() - 20.0).abs() < 1e-4);
        assert_eq!(scores.pixels, 192);
    }

    #[test]
    fn an_error_in_the_left_half_is_measured_there_only() {
        let maps = with_error(0.1, |k| k % 16 < 8);
        let left: Vec<bool> = (0..192).map(|k| k % 16 < 8).collect();
        let right: Vec<bool> = left.iter().map(|l| !l).collect();
        assert!((maps.scores(Some(&left)).psnr_db.unwrap() - 20.0).abs() < 1e-4);
        assert!((maps.scores(None).psnr_db.unwrap() - 20.0 - 10.0 * 2f64.log10()).abs() < 1e-4);
        let untouched = maps.scores(Some(&right));
        assert_eq!((untouched.pixels, untouched.psnr_db), (96, None));
        let regions = maps.regions(Some(&left), &right);
        assert_eq!((regions.whole.pixels, regions.moving.pixels), (96, 0));
    }

    #[test]
    fn identical_images_have_no_finite_psnr() {
        let scores = with_error(0.0, |_| true).scores(None);
        assert_eq!((scores.psnr_db, scores.flip), (None, Some(0.0)));
        assert!((scores.ssim.unwrap() - 1.0).abs() < 1e-6);
    }

    #[test]
    fn nothing_to_measure_is_null() {
        let maps = with_error(0.1, |_| true);
        assert_eq!(maps.scores(Some(&[false; 192])), Scores::default());
        let tiny = Image::filled(4, 4, 1, 0.5);
        let maps = ReferenceImage::new(tiny.clone(), 67.0).compare(&tiny);
        assert_eq!(maps.scores(None).ssim, None);
    }

    #[test]
    fn medians() {
        assert_eq!(median(vec![]), None);
        assert_eq!(median(vec![3.0, 1.0, 2.0]), Some(2.0));
        assert_eq!(median(vec![4.0, 1.0]), Some(2.5));
    }
}
