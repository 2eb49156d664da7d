//! Ratios of light between the images of two cameras, at pixels that are known to show the same surfaces.

use super::gain_ratios::USABLE;
use super::gains::luminance;
use crate::raster::linear_from_encoded;

/// Lower bound of the linear light whose logarithm is taken. It keeps the contrast of texture beside black finite.
const MIN_LIGHT: f64 = 0.0025;
/// Minimum standard deviation of the logarithm of linear light in the 3×3 pixels around a pixel. A pixel with less has
/// no texture. Smaller: noise and shading count as texture.
const MIN_CONTRAST: f64 = 0.04;
/// Minimum correlation of the two images' textures in the 3×3 pixels around a pixel. Smaller: false matches are used.
const MIN_CORRELATION: f64 = 0.8;
/// Distance (maximum norm) up to which all pixels around a used pixel must have texture, pixels. Smaller: plain surfaces
/// beside the outline of a textured body are used, which are matched at the wrong depth. Larger: thin bodies aren't used.
const TEXTURED_PX: usize = 2;
/// Step between used pixels along rows and columns. Neighbouring pixels aren't independent samples, since their errors are
/// nearly the same.
const STEP_PX: usize = 2;

/// The colours that two cameras' images show of the same surfaces.
pub(crate) struct MatchedLight {
    pub width: usize,
    /// For each pixel of the first image, row by row: its gamma-encoded colour, and the colour of the same surface in the
    /// second image. `None` if the second image is not known to show the surface.
    pub colors: Vec<Option<[[f32; 3]; 2]>>,
    /// Whether one of the cameras is grey, so that only luminance is compared.
    pub is_gray: bool,
}

/// Logarithms of linear light around a pixel in both images, by channel.
type Patch = [[[f64; 3]; 2]; 9];

impl MatchedLight {
    /// Returns the natural logarithms of the ratio of light in the second image to light in the first, by channel. There is
    /// one for each sampled pixel that lies within texture, and whose textures in both images are correlated.
    pub fn log_ratios(&self) -> Vec<[f64; 3]> {
        let logs: Vec<_> = self.colors.iter().map(|c| c.map(|c| self.log_of(c))).collect();
        let height = logs.len() / self.width.max(1);
        let patches: Vec<Option<PatchStatistics>> = (0..logs.len())
            .map(|k| Some(PatchStatistics::of(&patch(&logs, self.width, k)?)))
            .collect();
        let is_textured = |x: usize, y: usize| {
            let patch = &patches[y * self.width + x];
            patch.as_ref().is_some_and(|patch| patch.contrast >= MIN_CONTRAST)
        };
        let around = |at: usize| at - TEXTURED_PX..at + TEXTURED_PX + 1;
        let inner = |size: usize| (TEXTURED_PX..size.saturating_sub(TEXTURED_PX)).step_by(STEP_PX);
        let mut ratios = Vec::new();
        for (y, x) in inner(height).flat_map(|y| inner(self.width).map(move |x| (y, x))) {
            let k = y * self.width + x;
            let (Some(patch), Some(colors)) = (&patches[k], self.colors[k]) else { continue };
            let is_usable = colors.iter().flatten().all(|v| USABLE.contains(v));
            if is_usable
                && patch.correlation >= MIN_CORRELATION
                && around(y).all(|y| around(x).all(|x| is_textured(x, y)))
            {
                let [a, b] = self.log_of(colors);
                ratios.push([0, 1, 2].map(|c| b[c] - a[c]));
            }
        }
        ratios
    }

    fn log_of(&self, colors: [[f32; 3]; 2]) -> [[f64; 3]; 2] {
        colors.map(|color| {
            let light = color.map(|v| linear_from_encoded(f64::from(v)));
            let light = if self.is_gray { luminance(light) } else { light };
            light.map(|v| v.max(MIN_LIGHT).ln())
        })
    }
}

/// Returns the logarithms around pixel `k`. `None` at the image's border, or if one of the pixels isn't matched.
fn patch(logs: &[Option<[[f64; 3]; 2]>], width: usize, k: usize) -> Option<Patch> {
    let x = k % width;
    if x == 0 || x + 1 == width || k < width || k + width >= logs.len() {
        return None;
    }
    let mut patch = [[[0.0; 3]; 2]; 9];
    for (n, of_pixel) in patch.iter_mut().enumerate() {
        *of_pixel = logs[k + (n / 3) * width + n % 3 - width - 1]?;
    }
    Some(patch)
}

struct PatchStatistics {
    /// Standard deviation of the logarithms within the patch, in the image that has less.
    contrast: f64,
    /// Correlation of both images' logarithms, after subtraction of each channel's mean. 0 for a plain patch.
    correlation: f64,
}

impl PatchStatistics {
    fn of(patch: &Patch) -> Self {
        let n = patch.len() as f64;
        let (mut squares, mut products) = ([0.0; 2], 0.0);
        for c in 0..3 {
            let means = [0, 1].map(|i| patch.iter().map(|p| p[i][c]).sum::<f64>() / n);
            for pixel in patch {
                let [a, b] = [0, 1].map(|i| pixel[i][c] - means[i]);
                squares = [squares[0] + a * a, squares[1] + b * b];
                products += a * b;
            }
        }
        let norm = (squares[0] * squares[1]).sqrt();
        Self {
            contrast: (squares[0].min(squares[1]) / (3.0 * n)).sqrt(),
            correlation: if norm > 0.0 { products / norm } else { 0.0 },
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::gain_ratios::median;
    use super::*;
    use crate::random::Random;
    use crate::raster::encoded_from_linear;

    const WIDTH: usize = 40;
    const GAINS: [f64; 3] = [1.3, 0.9, 1.1];

    /// Two images of random light. The left half of the second shows the same as the first with other gains, the right
    /// half shows something else. `contrast` is the texture's contrast.
    fn images(contrast: f64, is_gray: bool) -> MatchedLight {
        let mut random = Random::new(3);
        let color = |k: usize| {
            let mut light = || [0; 3].map(|_| 0.3 * (1.0 + contrast * random.signed()));
            let (a, other) = (light(), light());
            let b = if k % WIDTH < WIDTH / 2 { a } else { other };
            let encode = |v: f64| encoded_from_linear(v) as f32;
            Some([a.map(encode), [0, 1, 2].map(|c| encode(GAINS[c] * b[c]))])
        };
        MatchedLight { width: WIDTH, colors: (0..30 * WIDTH).map(color).collect(), is_gray }
    }

    #[test]
    fn matched_texture_has_the_ratio_of_the_gains() {
        let ratios = images(0.5, false).log_ratios();
        // The left half has 9 columns of samples and 13 rows.
        assert!((90..=117).contains(&ratios.len()), "{}", ratios.len());
        for ratio in &ratios {
            (0..3).for_each(|c| assert!((ratio[c] - GAINS[c].ln()).abs() < 1e-4, "{ratio:?}"));
        }
    }

    #[test]
    fn plain_and_unmatched_pixels_are_left_out() {
        assert!(images(0.02, false).log_ratios().is_empty());
        let mut holed = images(0.5, false);
        holed.colors.iter_mut().step_by(5).for_each(|color| *color = None);
        assert!(holed.log_ratios().is_empty());
        let mut dark = images(0.5, false);
        for color in dark.colors.iter_mut().flatten().flatten().flatten() {
            *color *= 0.05;
        }
        assert!(dark.log_ratios().is_empty());
        assert!(
            MatchedLight { width: 0, colors: Vec::new(), is_gray: false }.log_ratios().is_empty()
        );
    }

    /// Luminance alone is correlated by chance in a few patches. The median isn't affected.
    #[test]
    fn of_a_gray_camera_only_luminance_is_compared() {
        let ratios = images(0.5, true).log_ratios();
        assert!(ratios.iter().all(|ratio| ratio[0] == ratio[1] && ratio[1] == ratio[2]));
        let median = median(ratios.iter().map(|ratio| ratio[0]).collect());
        assert!((GAINS[1].ln()..GAINS[0].ln()).contains(&median), "{median}");
    }
}
