//! A uniform grid over line segments, which finds those whose bounding boxes meet.

use nalgebra::Point2;

/// Cells along the longest segment.
const CELLS_PER_SEGMENT: f64 = 3.0;
/// Maximum number of cells along a side of the grid.
const MAX_CELLS: f64 = 256.0;

/// Cells of the plane, row by row, each with the segments whose bounding boxes reach it.
pub struct SegmentCells {
    area: Bounds,
    cell_px: f64,
    across: usize,
    cells: Vec<Vec<(Bounds, usize)>>,
}

/// The bounding box of a segment, pixels.
#[derive(Clone, Copy)]
struct Bounds {
    min: Point2<f64>,
    max: Point2<f64>,
}

impl Bounds {
    fn of([a, b]: &[Point2<f64>; 2]) -> Self {
        Self { min: a.inf(b), max: a.sup(b) }
    }

    fn meet(&self, other: &Self) -> bool {
        (0..2).all(|k| self.min[k] <= other.max[k] && other.min[k] <= self.max[k])
    }
}

impl SegmentCells {
    /// An empty grid for these segments, whose ends are finite.
    pub fn new(segments: &[[Point2<f64>; 2]]) -> Self {
        let none = Bounds { min: Point2::origin(), max: Point2::origin() };
        let all = segments.iter().map(Bounds::of);
        let area = all.reduce(|a, b| Bounds { min: a.min.inf(&b.min), max: a.max.sup(&b.max) });
        let area = area.unwrap_or(none);
        let longest = segments.iter().map(|[a, b]| (b - a).norm()).fold(0.0, f64::max);
        let cell_px =
            (longest / CELLS_PER_SEGMENT).max((area.max - area.min).max() / MAX_CELLS).max(1.0);
        let [across, down] =
            [0, 1].map(|k| ((area.max[k] - area.min[k]) / cell_px).floor() as usize + 1);
        Self { area, cell_px, across, cells: vec![Vec::new(); across * down] }
    }

    /// The cells that a bounding box reaches. Positions outside the grid belong to its border cells.
    fn reached(&self, bounds: &Bounds) -> impl Iterator<Item = usize> + use<> {
        let down = self.cells.len() / self.across;
        let cell = |p: Point2<f64>, k: usize| {
            let number = ((p[k] - self.area.min[k]) / self.cell_px).max(0.0) as usize;
            number.min([self.across, down][k] - 1)
        };
        let columns = cell(bounds.min, 0)..=cell(bounds.max, 0);
        let rows = cell(bounds.min, 1)..=cell(bounds.max, 1);
        let across = self.across;
        rows.flat_map(move |y| columns.clone().map(move |x| y * across + x))
    }

    /// Adds a segment under an index.
    pub fn insert(&mut self, segment: &[Point2<f64>; 2], index: usize) {
        let bounds = Bounds::of(segment);
        for cell in self.reached(&bounds) {
            self.cells[cell].push((bounds, index));
        }
    }

    /// Finds the segments whose bounding boxes meet that of `segment`: their indices, ascending and unique.
    pub fn near(&self, segment: &[Point2<f64>; 2], found: &mut Vec<usize>) {
        found.clear();
        let bounds = Bounds::of(segment);
        let there = self.reached(&bounds).flat_map(|cell| &self.cells[cell]);
        found.extend(there.filter(|(other, _)| other.meet(&bounds)).map(|(_, index)| index));
        found.sort_unstable();
        found.dedup();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::Random;

    #[test]
    fn those_near_are_those_whose_bounding_boxes_meet() {
        let mut random = Random::new(3);
        let mut point =
            |size: f64| Point2::new(size * (random.unit() - 0.3), size * (random.unit() - 0.3));
        let segments: Vec<_> = (0..200)
            .map(|_| {
                let a = point(200.0);
                [a, a + point(60.0).coords]
            })
            .collect();
        // Some of those that are sought are outside the area.
        let mut cells = SegmentCells::new(&segments[..100]);
        for (k, segment) in segments[..100].iter().enumerate() {
            cells.insert(segment, k);
        }
        let mut found = Vec::new();
        for segment in &segments {
            cells.near(segment, &mut found);
            let [min, max] = [segment[0].inf(&segment[1]), segment[0].sup(&segment[1])];
            let meets = |[a, b]: &[Point2<f64>; 2]| {
                (0..2).all(|k| a[k].min(b[k]) <= max[k] && a[k].max(b[k]) >= min[k])
            };
            let all: Vec<usize> = (0..100).filter(|&k| meets(&segments[k])).collect();
            assert_eq!(found, all);
        }
    }
}
