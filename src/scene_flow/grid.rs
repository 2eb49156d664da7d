//! Pixels of an image in one list, row by row.

/// Returns the indices of the pixels to the left and right of pixel `k`, above and below, that lie in the image. Its width
/// is `width`, and it has `count` pixels.
#[inline(always)]
pub fn neighbors(k: usize, width: usize, count: usize) -> impl Iterator<Item = usize> {
    let x = k % width;
    let horizontal = [(x > 0).then(|| k - 1), (x + 1 < width).then_some(k + 1)];
    let vertical = [k.checked_sub(width), Some(k + width).filter(|&below| below < count)];
    horizontal.into_iter().chain(vertical).flatten()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn at_borders_there_are_fewer_neighbors() {
        let of = |k: usize| neighbors(k, 3, 6).collect::<Vec<_>>();
        assert_eq!((of(0), of(1), of(5)), (vec![1, 3], vec![0, 2, 4], vec![4, 2]));
    }
}
