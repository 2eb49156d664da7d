//! What tests draw besides [`Random`]'s own numbers.

use stlfr::random::Random;

/// A whole number below `n`, all equally likely; 0 if there is none.
pub fn below(random: &mut Random, n: usize) -> usize {
    (random.unit() * n as f64) as usize
}

/// One of these, all equally likely.
pub fn pick<T: Copy>(random: &mut Random, from: &[T]) -> T {
    from[below(random, from.len())]
}
