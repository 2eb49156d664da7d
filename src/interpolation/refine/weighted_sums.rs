//! The weighted mean of a block's hypotheses, pixel by pixel.

use super::PixelMotion;

/// The weighted sums.
pub struct WeightedSums {
    channels: usize,
    colors: Vec<f32>,
    motions: Option<Vec<PixelMotion>>,
    weights: Vec<f32>,
}

/// A refined block, row by row. Pixels outside the image have no meaning.
pub struct RefinedBlock {
    pub colors: Vec<f32>,
    /// `None` where the warped frames agree, whose motion holds, or nobody asked.
    pub motions: Option<Vec<PixelMotion>>,
}

impl WeightedSums {
    /// Nothing yet, of this many pixels.
    pub fn new(pixels: usize, channels: usize, with_motions: bool) -> Self {
        let motions = with_motions.then(|| vec![PixelMotion::default(); pixels]);
        Self { channels, colors: vec![0.0; pixels * channels], motions, weights: vec![0.0; pixels] }
    }

    /// Adds a hypothesis: each pixel's weight and colour.
    pub fn add(&mut self, weights: &[f32], colors: &[f32]) {
        let pixels = self.colors.chunks_exact_mut(self.channels).zip(weights);
        for ((sum, weight), color) in pixels.zip(colors.chunks_exact(self.channels)) {
            sum.iter_mut().zip(color).for_each(|(sum, c)| *sum += weight * c);
        }
        self.weights.iter_mut().zip(weights).for_each(|(sum, weight)| *sum += weight);
    }

    /// Adds its motions, if motions are wanted.
    pub fn add_motions(&mut self, weights: &[f32], motions: Vec<PixelMotion>) {
        let sums = self.motions.iter_mut().flatten();
        sums.zip(weights).zip(motions).for_each(|((sum, weight), motion)| sum.add(*weight, motion));
    }

    /// The weighted mean at every pixel. The sum of weights must be positive.
    pub fn mean(mut self) -> RefinedBlock {
        let pixels = self.colors.chunks_exact_mut(self.channels).zip(&self.weights);
        pixels.for_each(|(color, weight)| color.iter_mut().for_each(|c| *c /= weight));
        for (motion, &weight) in self.motions.iter_mut().flatten().zip(&self.weights) {
            *motion = motion.times(1.0 / weight);
        }
        RefinedBlock { colors: self.colors, motions: self.motions }
    }
}
