//! Pseudo-random numbers that are identical on every platform, by SplitMix64 (Steele, Lea, Flood 2014).

/// A pseudo-random number generator.
#[derive(Clone, Debug)]
pub struct Random(u64);

impl Random {
    pub fn new(seed: u64) -> Self {
        Self(seed)
    }

    /// Creates a generator from a seed and a purpose, which is any string. Generators with the same seed and different
    /// purposes give independent numbers.
    pub fn stream(seed: u64, purpose: &str) -> Self {
        let mut hasher = blake3::Hasher::new();
        hasher.update(&seed.to_le_bytes());
        hasher.update(purpose.as_bytes());
        let hash = hasher.finalize();
        let first = hash.as_bytes().first_chunk().copied().unwrap_or_default();
        Self(u64::from_le_bytes(first))
    }

    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    /// Returns a uniformly distributed number in [0, 1).
    pub fn unit(&mut self) -> f64 {
        (self.next() >> 11) as f64 / (1u64 << 53) as f64
    }

    /// Returns a uniformly distributed number in [`low`, `high`).
    pub fn in_range(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.unit()
    }

    /// Returns a uniformly distributed number in [−1, 1).
    pub fn signed(&mut self) -> f64 {
        self.in_range(-1.0, 1.0)
    }

    /// Returns a normally distributed number with mean 0 and standard deviation 1 (Box–Muller transform).
    pub fn gaussian(&mut self) -> f64 {
        let radius = (-2.0 * (1.0 - self.unit()).ln()).sqrt();
        radius * (std::f64::consts::TAU * self.unit()).cos()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn means_and_spreads_are_as_told() {
        let random = &mut Random::stream(1, "test");
        let moments = |mut next: Box<dyn FnMut() -> f64 + '_>| {
            let values: Vec<f64> = (0..20_000).map(|_| next()).collect();
            let mean = values.iter().sum::<f64>() / 2e4;
            (mean, (values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / 2e4).sqrt())
        };
        let (mean, deviation) = moments(Box::new(|| random.gaussian()));
        assert!(mean.abs() < 0.03 && (deviation - 1.0).abs() < 0.03, "{mean} {deviation}");
        let (mean, deviation) = moments(Box::new(|| random.signed()));
        assert!(mean.abs() < 0.02 && (deviation - 3f64.sqrt().recip()).abs() < 0.02);
        assert_ne!(Random::stream(1, "a").unit(), Random::stream(1, "b").unit());
        assert_eq!(Random::new(5).unit(), Random::new(5).unit());
    }
}
