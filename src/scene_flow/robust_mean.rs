//! Robust mean of the colours that several frames show at a pixel.

use crate::simd::{F32x8, LANES, multiversion};

/// Distance of a colour from the mean at which the colour's weight falls to a quarter. Colours are RGB from 0 to 1.
const COLOR: f32 = 0.06;
/// Number of times that the colours are reweighted.
const REWEIGHTINGS: usize = 2;

/// Weighted colours, eight at a time: red, green and blue from 0 to 1, and the weight. Unused places have the weight 0.
#[derive(Default)]
pub struct WeightedColors {
    lanes: Vec<[[f32; LANES]; 4]>,
    count: usize,
}

impl WeightedColors {
    pub fn clear(&mut self) {
        self.lanes.clear();
        self.count = 0;
    }

    pub fn push(&mut self, [red, green, blue]: [f32; 3], weight: f32) {
        let at = self.count % LANES;
        if at == 0 {
            self.lanes.push([[0.0; LANES]; 4]);
        }
        if let Some(lanes) = self.lanes.last_mut() {
            let values = [red, green, blue, weight];
            lanes.iter_mut().zip(values).for_each(|(lane, value)| lane[at] = value);
        }
        self.count += 1;
    }

    pub fn is_empty(&self) -> bool {
        self.count == 0
    }

    /// Returns the weighted mean of the colours, after two steps that reduce the weight of outlying ones. The weights
    /// must be positive.
    pub fn robust_mean(&self) -> [f32; 3] {
        robust_mean_of(&self.lanes)
    }
}

#[inline(always)]
fn robust_mean<V: F32x8>(all: &[[[f32; LANES]; 4]]) -> [f32; 3] {
    let mut mean = [0.0; 3];
    let narrowing = V::splat(1.0 / (COLOR * COLOR));
    for step in 0..=REWEIGHTINGS {
        let means = V::splats(mean);
        let mut sums = [V::zero(); 4];
        for lanes in all {
            let colors = [0, 1, 2].map(|c| V::from_array(&lanes[c]));
            let mut weight = V::from_array(&lanes[3]);
            if step > 0 {
                let mut distance = V::zero();
                for c in 0..3 {
                    let difference = colors[c] - means[c];
                    distance = distance + difference * difference;
                }
                let kept = V::splat(1.0) / (V::splat(1.0) + distance * narrowing);
                weight = weight * kept * kept;
            }
            for c in 0..3 {
                sums[c] = sums[c] + weight * colors[c];
            }
            sums[3] = sums[3] + weight;
        }
        let [red, green, blue, weight] = V::sums(&sums);
        // The sum of positive weights is positive. Reweighting leaves a colour at least 1e-6 of its weight.
        let inverse = 1.0 / weight;
        mean = [red, green, blue].map(|sum| (sum * inverse) as f32);
    }
    mean
}

multiversion! {
    fn robust_mean_of(all: &[[[f32; LANES]; 4]]) -> [f32; 3] = robust_mean::<V>
}

#[cfg(test)]
mod tests {
    use super::*;

    fn mean(colors: &[([f32; 3], f32)]) -> [f32; 3] {
        let mut all = WeightedColors::default();
        colors.iter().for_each(|(color, weight)| all.push(*color, *weight));
        all.robust_mean()
    }

    /// The definition, one colour after the other.
    fn defined(colors: &[([f32; 3], f32)]) -> [f64; 3] {
        let mut mean = [0.0; 3];
        for step in 0..=REWEIGHTINGS {
            let (mut sums, mut weights) = ([0.0; 3], 0.0);
            for (color, weight) in colors {
                let color = color.map(f64::from);
                let distance: f64 = (0..3).map(|c| (color[c] - mean[c]).powi(2)).sum();
                let kept = 1.0 / (1.0 + distance / f64::from(COLOR * COLOR));
                let weight = f64::from(*weight) * if step > 0 { kept * kept } else { 1.0 };
                (0..3).for_each(|c| sums[c] += weight * color[c]);
                weights += weight;
            }
            mean = sums.map(|sum| sum / weights);
        }
        mean
    }

    #[test]
    fn any_number_of_colors_has_the_mean_of_the_definition() {
        let color = |k: usize| {
            let value = |c: usize| ((7 * k + 3 * c) % 11) as f32 / 11.0;
            ([value(0), value(1), value(2)], 0.1 + (k % 5) as f32)
        };
        for count in [1, 2, 7, 8, 9, 20] {
            let colors: Vec<_> = (0..count).map(color).collect();
            let (found, expected) = (mean(&colors), defined(&colors));
            for c in 0..3 {
                assert!((f64::from(found[c]) - expected[c]).abs() < 1e-5, "{count}: {found:?}");
            }
        }
    }

    #[test]
    fn an_outlier_hardly_counts() {
        let [red, ..] =
            mean(&[([0.2; 3], 1.0), ([0.21; 3], 1.0), ([0.2; 3], 1.0), ([0.9; 3], 1.0)]);
        assert!((red - 0.203).abs() < 0.03, "{red}");
    }
}
