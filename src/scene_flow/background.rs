//! Depth of the static background, found once for a whole recording. Pixels of a frame that certainly show the background
//! have its depth, and aren't estimated again in every frame.

use super::element::Element;
use super::frame::{FlowFrame, PyramidFrame};
use super::grid::neighbors;
use super::map::FlowMap;
use super::silhouette::Shown;
use super::still::{CompactImage, Rgb8, StillImage};
use crate::raster::Image;

/// Minimum distance of a background pixel from the pixels that show something else, pixels (maximum norm). Smaller: mixed
/// colours at a body's outline count as background. Larger: more pixels are estimated in every frame.
const MARGIN_PX: usize = 4;
/// Maximum difference in each channel between two neighbouring pixels of one plain surface, in steps of 1/255. Larger: slow
/// changes of brightness count as plain, and less counts as background. Smaller: the inside of a plain body counts as
/// background.
const PLAIN: u8 = 2;

/// What is known of the static background in a frame.
pub struct Background<'a> {
    map: &'a FlowMap,
    /// For each pixel, whether it certainly shows the background.
    is_shown: Vec<bool>,
}

impl<'a> Background<'a> {
    /// Finds the pixels of a frame that certainly show the static background of its camera. They keep a distance from moving
    /// bodies. The frame's pyramid is that of [`FlowFrame::pyramid_before`]. `map` has the depth of the background. If the
    /// frame has no mask of the background, a plain surface that borders on something moving isn't certain, since a plain
    /// body may move without a change inside its outline.
    pub fn new(PyramidFrame { frame, levels }: PyramidFrame, map: &'a FlowMap) -> Self {
        let (width, pixels) = (map.width, map.pixels().len());
        let shows = |k: usize| levels[0].shown(k % width, k / width) == Shown::Background;
        let shown: Vec<bool> = (0..pixels).map(shows).collect();
        let mut is_shown = eroded(&shown, width, MARGIN_PX);
        if frame.still.is_none() {
            remove_plain(&mut is_shown, &CompactImage::new(&frame.image).pixels, width);
        }
        Self { map, is_shown }
    }

    pub fn map(&self) -> &FlowMap {
        self.map
    }

    /// Returns the surface element of the background at pixel `[x, y]` of a pyramid level; level 0 is the finest. `None` if
    /// a part of the pixel doesn't certainly show the background, or if the background's depth isn't known there.
    pub fn element(&self, level: usize, [x, y]: [usize; 2]) -> Option<Element> {
        let FlowMap { width, height, .. } = *self.map;
        let side = 1 << level;
        // The frame's last pixels may have no pixel of the level, but every pixel of the level has pixels of the frame.
        let middle =
            (y * side + side / 2).min(height - 1) * width + (x * side + side / 2).min(width - 1);
        let pixel = &self.map.pixels()[middle];
        let rows = y * side..((y + 1) * side).min(height);
        let row = |v: usize| &self.is_shown[v * width..][x * side..((x + 1) * side).min(width)];
        let is_shown = pixel.is_known() && rows.into_iter().all(|v| row(v).iter().all(|s| *s));
        is_shown.then(|| self.map.element(pixel))
    }
}

impl StillImage {
    /// Returns the static background as a frame of its camera, at time 0. `of` is any frame of the camera. Pixels whose
    /// background is unknown count as not filmed. They have the colour of a pixel nearby. If `of` has a mask of the
    /// background, so has the result.
    pub fn frame(&self, of: &FlowFrame) -> FlowFrame {
        let mut colors = self.colors.clone();
        let mut known: Vec<usize> = (0..colors.len()).filter(|&k| colors[k].is_some()).collect();
        let mut next = 0;
        while let Some(&k) = known.get(next) {
            next += 1;
            for n in neighbors(k, self.width, colors.len()) {
                if colors[n].is_none() {
                    colors[n] = colors[k];
                    known.push(n);
                }
            }
        }
        let value = |color: Option<Rgb8>| color.unwrap_or_default().map(|c| f32::from(c) / 255.0);
        let data = colors.into_iter().flat_map(value).collect();
        let FlowFrame { view, is_color, .. } = of;
        let image = Image::from_data(view.width, view.height, 3, data);
        let is_filmed = |k: usize| of.is_filmed.as_ref().is_none_or(|filmed| filmed[k]);
        let known = (0..self.colors.len()).map(|k| self.colors[k].is_some() && is_filmed(k));
        let known: Vec<bool> = known.collect();
        FlowFrame {
            is_color: *is_color,
            still: of.still.is_some().then(|| known.clone()),
            is_filmed: Some(known),
            ..FlowFrame::new(view, &image, 0.0)
        }
    }
}

/// Returns a mask of the pixels that are at least `margin` pixels away (maximum norm) from those that aren't in a mask. The
/// image's border is no such pixel.
fn eroded(mask: &[bool], width: usize, margin: usize) -> Vec<bool> {
    let along = |mask: &[bool], step: usize, position: &dyn Fn(usize) -> (usize, usize)| {
        let is_inside = |k: usize| {
            let (at, size) = position(k);
            let first = k - at.min(margin) * step;
            let count = at.min(margin) + margin.min(size - 1 - at) + 1;
            (0..count).all(|n| mask[first + n * step])
        };
        (0..mask.len()).map(is_inside).collect::<Vec<bool>>()
    };
    let height = mask.len() / width.max(1);
    let rows = along(mask, 1, &|k| (k % width, width));
    along(&rows, width, &|k| (k / width, height))
}

/// Removes from a mask the plain surfaces that border on pixels outside of it.
fn remove_plain(mask: &mut [bool], colors: &[Rgb8], width: usize) {
    let is_plain =
        |a: usize, b: usize| (0..3).all(|c| colors[a][c].abs_diff(colors[b][c]) <= PLAIN);
    let mut removed: Vec<usize> = (0..mask.len()).filter(|&k| !mask[k]).collect();
    while let Some(k) = removed.pop() {
        for n in neighbors(k, width, mask.len()) {
            if mask[n] && is_plain(k, n) {
                mask[n] = false;
                removed.push(n);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_margin_is_as_wide_on_all_sides() {
        let (width, height) = (12, 9);
        let is_far = |k: usize| {
            let (x, y) = (k % width, k / width);
            x.abs_diff(5).max(y.abs_diff(4)) > 2
        };
        let mask: Vec<bool> = (0..width * height).map(|k| k != 4 * width + 5).collect();
        let expected: Vec<bool> = (0..width * height).map(is_far).collect();
        assert_eq!(eroded(&mask, width, 2), expected);
        assert!(eroded(&vec![true; width * height], width, 2).iter().all(|m| *m));
    }

    #[test]
    fn plain_surfaces_beside_something_moving_are_removed_up_to_the_next_edge() {
        // A row: two pixels that move, a plain surface with a gradient, an edge, and another plain surface.
        let values = [90, 90, 92, 94, 96, 120, 120, 120];
        let colors: Vec<Rgb8> = values.iter().map(|v| [*v; 3]).collect();
        let mut mask = vec![false, false, true, true, true, true, true, true];
        remove_plain(&mut mask, &colors, 8);
        assert_eq!(mask, [false, false, false, false, false, true, true, true]);
    }
}
