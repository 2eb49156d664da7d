//! The inverse depths that are tried.

/// Largest number of levels. Larger: a single wrong point near a camera costs time; smaller: deep scenes have
/// too few.
const MAX_COUNT: usize = 1024;

/// Evenly spaced inverse depths, 1/m. Even in inverse depth is even in disparity.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Levels {
    /// The smallest, of the farthest surface.
    pub first: f32,
    /// The distance between two.
    pub step: f32,
    /// How many; at least 1.
    pub count: usize,
}

impl Levels {
    /// Levels from `low` to `high`, 1/m, at most `step` apart, unless these would be too many.
    pub fn new([low, high]: [f64; 2], step: f64) -> Self {
        // The step is positive, so the quotient is finite; a span of nothing has one level.
        let count = ((high - low) / step).ceil().clamp(0.0, (MAX_COUNT - 1) as f64) as usize + 1;
        let step = if count > 1 { (high - low) / (count - 1) as f64 } else { step };
        Self { first: low as f32, step: step as f32, count }
    }

    /// The inverse depth of a level, which may lie between two.
    pub fn at(&self, level: f32) -> f32 {
        self.first + self.step * level
    }
}
