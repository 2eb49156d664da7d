//! The proxy as one view sees it: a depth for every pixel.

/// Depth of every pixel's centre along the camera's +z, metres; NaN where the proxy isn't.
#[derive(Clone, Debug, PartialEq)]
pub struct DepthMap {
    width: usize,
    height: usize,
    data: Vec<f32>,
}

impl DepthMap {
    /// From depths row by row. What is not positive (0 and NaN included) becomes NaN: nothing
    /// there. +∞ stays: the sky.
    ///
    /// # Panics
    /// If the number of depths is not `width * height`.
    pub fn from_data(width: usize, height: usize, mut data: Vec<f32>) -> Self {
        assert_eq!(data.len(), width * height, "depths of a {width}×{height} view");
        for z in &mut data {
            if !(*z > 0.0) {
                *z = f32::NAN;
            }
        }
        Self { width, height, data }
    }

    /// A view in which the proxy is nowhere.
    pub fn empty(width: usize, height: usize) -> Self {
        Self { width, height, data: vec![f32::NAN; width * height] }
    }

    pub fn width(&self) -> usize {
        self.width
    }

    pub fn height(&self) -> usize {
        self.height
    }

    /// All depths, row by row.
    pub fn data(&self) -> &[f32] {
        &self.data
    }

    /// The depths of one row.
    pub fn row(&self, y: usize) -> &[f32] {
        &self.data[y * self.width..(y + 1) * self.width]
    }

    /// The farthest depth of the (up to) four pixels around a position in pixels; positions
    /// outside take the border's. NaN if any of the four has none. What is nearer than this is
    /// in front of everything around it.
    pub(super) fn farthest_around(&self, x: f32, y: f32) -> f32 {
        let cell = |v: f32, size: usize| {
            let floor = (v - 0.5).max(0.0).min((size - 1) as f32) as usize;
            (floor, (floor + 1).min(size - 1))
        };
        let (x0, x1) = cell(x, self.width);
        let (y0, y1) = cell(y, self.height);
        let at = |x: usize, y: usize| self.data[y * self.width + x];
        let (a, b, c, d) = (at(x0, y0), at(x1, y0), at(x0, y1), at(x1, y1));
        // The sum is NaN exactly if one of four positive depths is.
        if (a + b + c + d).is_nan() { f32::NAN } else { a.max(b).max(c).max(d) }
    }
}
