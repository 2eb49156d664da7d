//! Temporal integration (Fig. 1): a motion trail shows the paths of moving objects in one picture.
//!
//! The paper overlays the images of every camera's sequence, and then blends the overlays. Here, a view is rendered at
//! each instant with the geometry proxy of that instant, and the views are overlaid. With a static plane as proxy, the
//! two orders give equal results. With a proxy that changes over time, only the order used here is correct.

use crate::lumigraph::Rendered;
use crate::options::TrailMode;
use crate::raster::{Image, encoded_from_linear, linear_from_encoded};

/// Accumulator that overlays the views at the instants of a motion trail.
pub(super) struct Overlay {
    mode: TrailMode,
    size: (usize, usize, usize),
    /// For each pixel and channel, the sum of linear light or the largest display-encoded value, depending on the mode.
    values: Vec<f64>,
    /// For each pixel, the number of instants whose views cover the pixel.
    counts: Vec<u32>,
}

impl Overlay {
    pub fn like(rendered: &Rendered, mode: TrailMode) -> Self {
        let image = &rendered.image;
        Self {
            mode,
            size: (image.width(), image.height(), image.channels()),
            values: vec![0.0; image.data().len()],
            counts: vec![0; rendered.coverage.len()],
        }
    }

    /// Adds the view at one instant. All views must have the same size and number of channels.
    pub fn add(&mut self, rendered: &Rendered) {
        let channels = self.size.2;
        let pixels = rendered.image.data().chunks_exact(channels);
        for ((k, pixel), sums) in pixels.enumerate().zip(self.values.chunks_exact_mut(channels)) {
            if !rendered.coverage[k] {
                continue;
            }
            self.counts[k] += 1;
            for (sum, &value) in sums.iter_mut().zip(pixel) {
                match self.mode {
                    TrailMode::Mean => *sum += linear_from_encoded(f64::from(value)),
                    TrailMode::Lighten => *sum = sum.max(f64::from(value)),
                }
            }
        }
    }

    pub fn finish(self) -> Rendered {
        let (width, height, channels) = self.size;
        let value = |k: usize, sum: f64| match (self.mode, self.counts[k / channels]) {
            (_, 0) => 0.0,
            (TrailMode::Mean, count) => encoded_from_linear(sum / f64::from(count)) as f32,
            (TrailMode::Lighten, _) => sum as f32,
        };
        let data = self.values.iter().enumerate().map(|(k, &sum)| value(k, sum)).collect();
        let coverage = self.counts.iter().map(|&count| count > 0).collect();
        Rendered { image: Image::from_data(width, height, channels, data), coverage }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rendered(values: &[f32], coverage: &[bool]) -> Rendered {
        let image = Image::from_data(coverage.len(), 1, 1, values.to_vec());
        Rendered { image, coverage: coverage.to_vec() }
    }

    fn overlaid(mode: TrailMode, all: &[Rendered]) -> Rendered {
        let mut overlay = Overlay::like(&all[0], mode);
        all.iter().for_each(|r| overlay.add(r));
        overlay.finish()
    }

    /// The mean of a black and a white view has half of white's linear light. In sRGB, this is the value 0.735, not
    /// 0.5.
    #[test]
    fn the_mean_is_of_light() {
        let all = [rendered(&[0.0, 0.25], &[true; 2]), rendered(&[1.0, 0.25], &[true; 2])];
        let mean = overlaid(TrailMode::Mean, &all);
        assert!((mean.image.data()[0] - 0.735_357).abs() < 1e-5, "{mean:?}");
        assert!((mean.image.data()[1] - 0.25).abs() < 1e-6);
        let brightest = overlaid(TrailMode::Lighten, &all);
        assert_eq!(brightest.image.data(), [1.0, 0.25]);
    }

    #[test]
    fn a_pixel_integrates_over_the_instants_that_cover_it() {
        let all = [
            rendered(&[0.5, 0.0, 0.0], &[true, false, false]),
            rendered(&[0.5, 0.7, 0.0], &[true, true, false]),
        ];
        for mode in [TrailMode::Mean, TrailMode::Lighten] {
            let result = overlaid(mode, &all);
            assert_eq!(result.coverage, [true, true, false]);
            for (found, expected) in result.image.data().iter().zip([0.5, 0.7, 0.0]) {
                assert!((found - expected).abs() < 1e-6, "{mode:?}");
            }
        }
    }
}
