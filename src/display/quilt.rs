//! Quilts, the pictures of Looking Glass displays: a grid of views. The leftmost view is at the bottom left, and the
//! rightmost view at the top right. The name of a quilt's file ends in `_qsCxRaA`, with the number of columns C, the
//! number of rows R, and the aspect ratio A of the views.
//!
//! Sizes are from <https://docs.lookingglassfactory.com/keyconcepts/quilts>. View cones are from the vendor's
//! LKG-Toolkit, or else are the documentation's standard of 35°. Two copies of this page differ for the 16-inch
//! landscape display. The copy that also lists 27-inch displays has 8×6 views in 7680×4320 pixels, here `16-landscape`.
//! The other copy has 7×7 views in 5999×5999 pixels, here `16-landscape-7x7`. The copy with the 27-inch displays is
//! assumed to be newer, but the vendor doesn't confirm this. The name of a quilt's file gives the layout, so that the
//! vendor's programs show either layout correctly.

use super::sheared;
use crate::camera::{Camera, CameraModel};
use std::str::FromStr;

/// Layout of a quilt, which is a grid of views in one picture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct QuiltLayout {
    /// Number of views in each row.
    pub columns: usize,
    /// Number of rows of views.
    pub rows: usize,
    /// Width and height of the whole quilt, pixels.
    pub size_px: [usize; 2],
    /// Width of the display divided by its height. Each view has this aspect ratio, and is stretched to its tile.
    pub aspect: f64,
    /// Angle between the directions to the first and to the last view's camera, seen from the middle of the plane of
    /// convergence, in degrees.
    pub cone_deg: f64,
}

/// Reason why a text doesn't describe a quilt's layout. The message continues a sentence that begins with this text,
/// such as "is no display".
#[derive(Debug, thiserror::Error, PartialEq)]
pub enum QuiltLayoutError {
    #[error("is no display ({}) and no layout like 8x6:3360x3360", names())]
    Unknown,
    #[error(
        "must have from 2 to {MAX_VIEWS} views, of at least {MIN_TILE_PX} pixels a side, in at most {MAX_SIDE_PX}"
    )]
    Size,
}

const MAX_VIEWS: usize = 1024;
const MIN_TILE_PX: usize = 8;
const MAX_SIDE_PX: usize = 8192;

/// Standard view cone in the vendor's documentation, used for displays without a view cone of their own, degrees.
const STANDARD_CONE_DEG: f64 = 35.0;

const fn device(
    columns: usize,
    rows: usize,
    size_px: [usize; 2],
    aspect: f64,
    cone_deg: f64,
) -> QuiltLayout {
    QuiltLayout { columns, rows, size_px, aspect, cone_deg }
}

const LANDSCAPE: f64 = 16.0 / 9.0;
const PORTRAIT: f64 = 9.0 / 16.0;

/// Quilt layouts of Looking Glass displays, each with the display's name.
static DEVICES: [(&str, QuiltLayout); 10] = [
    ("go", device(11, 6, [4092, 4092], PORTRAIT, 54.0)),
    ("portrait", device(8, 6, [3360, 3360], 0.75, 40.0)),
    ("16-landscape", device(8, 6, [7680, 4320], LANDSCAPE, 50.0)),
    ("16-landscape-7x7", device(7, 7, [5999, 5999], LANDSCAPE, 50.0)),
    ("16-portrait", device(11, 6, [5995, 6000], PORTRAIT, 50.0)),
    ("27-landscape", device(8, 6, [7680, 4320], LANDSCAPE, STANDARD_CONE_DEG)),
    ("27-portrait", device(12, 4, [7680, 4320], PORTRAIT, STANDARD_CONE_DEG)),
    ("32-landscape", device(7, 7, [8190, 8190], LANDSCAPE, 50.0)),
    ("32-portrait", device(11, 6, [8184, 8184], PORTRAIT, 54.0)),
    ("65", device(8, 9, [8192, 8192], LANDSCAPE, 40.0)),
];

fn names() -> String {
    DEVICES.map(|(name, _)| name).join(", ")
}

/// Parses the name of a known display, or the form `COLUMNSxROWS:WIDTHxHEIGHT` with the quilt's size in pixels. In the
/// second form, the views have the aspect ratio of their tiles.
impl FromStr for QuiltLayout {
    type Err = QuiltLayoutError;

    fn from_str(text: &str) -> Result<Self, QuiltLayoutError> {
        if let Some((_, layout)) = DEVICES.iter().find(|(name, _)| *name == text) {
            return Ok(*layout);
        }
        let pair = |text: &str| -> Option<[usize; 2]> {
            let (a, b) = text.split_once('x')?;
            Some([a.parse().ok()?, b.parse().ok()?])
        };
        let parsed = text.split_once(':').and_then(|(grid, size)| Some((pair(grid)?, pair(size)?)));
        let ([columns, rows], size_px) = parsed.ok_or(QuiltLayoutError::Unknown)?;
        let views = columns.saturating_mul(rows);
        if !(2..=MAX_VIEWS).contains(&views) || size_px.iter().any(|side| *side > MAX_SIDE_PX) {
            return Err(QuiltLayoutError::Size);
        }
        let tile = [size_px[0] / columns, size_px[1] / rows];
        if tile.iter().any(|side| *side < MIN_TILE_PX) {
            return Err(QuiltLayoutError::Size);
        }
        let aspect = tile[0] as f64 / tile[1] as f64;
        Ok(Self { columns, rows, size_px, aspect, cone_deg: STANDARD_CONE_DEG })
    }
}

impl QuiltLayout {
    /// Returns the layouts of all known displays, each with the display's name.
    pub fn of_displays() -> &'static [(&'static str, Self)] {
        &DEVICES
    }

    /// Returns the number of views in the quilt.
    pub fn views(&self) -> usize {
        self.columns * self.rows
    }

    /// Returns the width and height of a view's tile, pixels. Pixels of the quilt outside all tiles are black. They are
    /// at the right and at the top.
    pub fn tile_px(&self) -> [usize; 2] {
        [self.size_px[0] / self.columns, self.size_px[1] / self.rows]
    }

    /// Returns the column and the row of the top left pixel of a view's tile, counted from the quilt's top left corner.
    /// View 0 is the leftmost view, whose tile is at the bottom left.
    pub fn tile_origin(&self, view: usize) -> [usize; 2] {
        let [width, height] = self.tile_px();
        let (column, row) = (view % self.columns, view / self.columns);
        [column * width, self.size_px[1] - (row + 1) * height]
    }

    /// Returns the text that describes the layout in the name of a quilt's file, such as `_qs8x6a0.75`. The text stands
    /// at the end of the name, before the extension.
    pub fn name(&self) -> String {
        let aspect = format!("{:.5}", self.aspect);
        let aspect = aspect.trim_end_matches('0').trim_end_matches('.');
        format!("_qs{}x{}a{aspect}", self.columns, self.rows)
    }

    /// Returns the cameras of all views of a quilt, the leftmost first. `view` is in their middle. The first and the
    /// last camera are `cone_deg` degrees apart, seen from the point `convergence_m` metres ahead of `view`. All views
    /// show the largest centred part of `view` that has the display's aspect ratio.
    pub fn cameras(&self, view: &Camera, cone_deg: f64, convergence_m: f64) -> Vec<Camera> {
        let framed = self.framed(view);
        let last = (self.views() - 1) as f64;
        let offset_m =
            |k: usize| convergence_m * ((k as f64 / last - 0.5) * cone_deg.to_radians()).tan();
        (0..self.views()).map(|k| sheared(&framed, offset_m(k), convergence_m)).collect()
    }

    /// Returns the camera of the largest centred part of a view that has the display's aspect ratio, at the resolution
    /// of a tile. Its pixels are not square if the tile's aspect ratio differs from the display's.
    fn framed(&self, view: &Camera) -> Camera {
        let (fx, fy, cx, cy) = view.model.intrinsics();
        let [width, height] = [view.width, view.height].map(|side| side as f64);
        // Width and height of the whole view on the plane z = 1.
        let [whole_x, whole_y] = [width / fx, height / fy];
        let (x, y) = match whole_x / whole_y > self.aspect {
            true => (whole_y * self.aspect, whole_y),
            false => (whole_x, whole_x / self.aspect),
        };
        let tile = self.tile_px();
        let [fx_tile, fy_tile] = [tile[0] as f64 / x, tile[1] as f64 / y];
        let model = CameraModel::Pinhole {
            fx: fx_tile,
            fy: fy_tile,
            cx: 0.5 * tile[0] as f64 + (cx - 0.5 * width) / fx * fx_tile,
            cy: 0.5 * tile[1] as f64 + (cy - 0.5 * height) / fy * fy_tile,
        };
        Camera { width: tile[0], height: tile[1], model, ..view.clone() }
    }
}
