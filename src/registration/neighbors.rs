//! Points near a point, by a grid.

use nalgebra::{Point2, Vector2};
use std::ops::ControlFlow;

/// A set of points of the image plane to ask for neighbours.
pub struct Neighbors {
    points: Vec<Point2<f64>>,
    origin: Point2<f64>,
    cell: f64,
    columns: usize,
    rows: usize,
    /// The points cell by cell, and where each cell starts in there; one more at the end.
    order: Vec<u32>,
    starts: Vec<u32>,
}

/// Points a cell on average. More: too many are looked at; fewer: too many cells are.
const PER_CELL: f64 = 4.0;

impl Neighbors {
    /// Points that are not finite are nobody's neighbours, and must not be given.
    pub fn new(points: impl IntoIterator<Item = Point2<f64>>) -> Self {
        let points: Vec<Point2<f64>> = points.into_iter().collect();
        let first = points.first().copied().unwrap_or_default();
        let least = points.iter().fold(first, |a, p| a.inf(p));
        let extent: Vector2<f64> = points.iter().fold(first, |a, p| a.sup(p)) - least;
        // The second keeps the number of cells in proportion where all lie along a line.
        let share = PER_CELL / points.len().max(1) as f64;
        let cell = (extent.x * extent.y * share).sqrt().max(extent.max() * share);
        let cell = if cell > 0.0 { cell } else { 1.0 };
        let [columns, rows] = [extent.x, extent.y].map(|v| (v / cell) as usize + 1);
        let mut grid = Self {
            points,
            origin: least,
            cell,
            columns,
            rows,
            order: Vec::new(),
            starts: vec![0; columns * rows + 1],
        };
        let cells: Vec<usize> = grid.points.iter().map(|p| grid.cell_of(p)).collect();
        for &cell in &cells {
            grid.starts[cell + 1] += 1;
        }
        for k in 1..grid.starts.len() {
            grid.starts[k] += grid.starts[k - 1];
        }
        let mut next = grid.starts.clone();
        grid.order = vec![0; cells.len()];
        for (k, &cell) in cells.iter().enumerate() {
            grid.order[next[cell] as usize] = k as u32;
            next[cell] += 1;
        }
        grid
    }

    /// The column or row of a coordinate; the nearest one for what is outside.
    fn index(&self, v: f64, origin: f64, count: usize) -> usize {
        (((v - origin) / self.cell) as usize).min(count - 1)
    }

    fn cell_of(&self, p: &Point2<f64>) -> usize {
        self.index(p.y, self.origin.y, self.rows) * self.columns
            + self.index(p.x, self.origin.x, self.columns)
    }

    /// Calls for every point within a radius, in no particular order, until told to break.
    pub fn each_within(
        &self,
        p: &Point2<f64>,
        radius: f64,
        mut call: impl FnMut(usize) -> ControlFlow<()>,
    ) {
        let [left, right] =
            [-radius, radius].map(|r| self.index(p.x + r, self.origin.x, self.columns));
        let [top, bottom] =
            [-radius, radius].map(|r| self.index(p.y + r, self.origin.y, self.rows));
        for row in top..=bottom {
            let [from, to] =
                [left, right + 1].map(|column| self.starts[row * self.columns + column]);
            for &k in &self.order[from as usize..to as usize] {
                let near = (self.points[k as usize] - p).norm_squared() <= radius * radius;
                if near && call(k as usize).is_break() {
                    return;
                }
            }
        }
    }

    /// Indices of the points within a radius, ascending.
    pub fn within(&self, p: &Point2<f64>, radius: f64) -> Vec<usize> {
        let mut found = Vec::new();
        self.each_within(p, radius, |k| {
            found.push(k);
            ControlFlow::Continue(())
        });
        found.sort_unstable();
        found
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_same_points_as_by_looking_at_all() {
        let points: Vec<Point2<f64>> = (0..300)
            .map(|k| {
                let k = f64::from(k);
                Point2::new((k * 12.9898).sin() * 50.0, (k * 78.233).sin() * 50.0)
            })
            .collect();
        let neighbors = Neighbors::new(points.iter().copied());
        for p in &points[..40] {
            let all: Vec<usize> =
                (0..points.len()).filter(|&k| (points[k] - p).norm() <= 9.0).collect();
            assert_eq!(neighbors.within(p, 9.0), all);
        }
    }

    #[test]
    fn points_along_a_line_and_far_apart() {
        let line: Vec<Point2<f64>> = (0..200).map(|k| Point2::new(f64::from(k), 7.0)).collect();
        let far = line.iter().copied().chain([Point2::new(-1e9, 1e9), Point2::new(3.5, 7.5)]);
        assert_eq!(Neighbors::new(line.clone()).within(&Point2::new(50.2, 7.0), 1.0), [50, 51]);
        assert_eq!(Neighbors::new(far).within(&Point2::new(3.5, 7.0), 0.6), [3, 4, 201]);
        assert!(Neighbors::new(line).within(&Point2::new(-5.0, 900.0), 100.0).is_empty());
    }

    #[test]
    fn none_and_many_duplicates() {
        assert!(Neighbors::new([]).within(&Point2::origin(), 1.0).is_empty());
        let same = Neighbors::new((0..1000).map(|_| Point2::new(1.0, 2.0)));
        assert_eq!(same.within(&Point2::new(1.0, 2.5), 1.0).len(), 1000);
    }
}
