//! Splats a scene flow map into a view: the map's surface elements are placed in the view, and the frontmost ones are
//! kept.

use super::area::Area;
use super::composite::{ColorCandidate, shows_motion};
use super::placement::{PlacedRow, Placement};
use super::tile_bounds::TILE_PX;
use crate::simd::multiversion;

/// Minimum difference in disparity for a nearer surface element to occlude a farther one, pixels. Elements with a
/// smaller difference count as one surface.
const HIDING_PX: f32 = 0.5;

/// What a scene flow map shows at a part of an [`Area`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SplatPixel {
    /// Inverse depth in the view, 1/m.
    pub inverse_depth: f32,
    /// Blending weight, from confidence and expected error; 0 where the scene flow map covers nothing.
    pub weight: f32,
    /// Position in the frame from which the colour is read, pixels.
    pub source: [f32; 2],
    /// Distance between the pixel's centre and the projection of its surface element (maximum norm), pixels.
    distance: f32,
}

impl SplatPixel {
    const NOTHING: Self = Self { inverse_depth: 0.0, weight: 0.0, source: [0.0; 2], distance: 0.0 };
}

/// Scene flow map rendered into an [`Area`] of a view.
pub struct Splat {
    /// The parts of the area.
    pub pixels: Vec<SplatPixel>,
    /// Minimum difference in inverse depth for a nearer surface element to occlude a farther one, 1/m.
    hiding: f32,
}

impl Splat {
    /// Splats a scene flow map into an area of the view in which its surface elements are placed.
    pub fn new(placement: &Placement, area: &Area) -> Self {
        let map = placement.mapped.map;
        let mut splat = Self {
            pixels: vec![SplatPixel::NOTHING; area.count],
            hiding: HIDING_PX / map.disparity_px,
        };
        let mut row = PlacedRow::default();
        let [_, tile_rows] = map.tiles();
        for tile_row in 0..tile_rows {
            let runs = placement.columns(tile_row, area);
            let top = tile_row * TILE_PX[1];
            for y in top..(top + TILE_PX[1]).min(map.height) {
                for columns in &runs {
                    placement.place(&mut row, (columns.clone(), y), area);
                    add_row(&mut splat, &row, [columns.start, y], area);
                }
            }
        }
        splat
    }
}

/// Scene flow maps, splatted into one area of a view.
pub struct Splats<'a>(pub Vec<(&'a Placement<'a>, Splat)>);

impl<'a> Splats<'a> {
    pub fn new(placements: &'a [Placement<'a>], area: &Area) -> Self {
        let splat = |placement| (placement, Splat::new(placement, area));
        Splats(placements.iter().map(splat).collect())
    }

    /// Adds the surface elements that the maps show at part `k` of the area to `candidates`.
    pub fn collect(&self, k: usize, candidates: &mut Vec<ColorCandidate<'a>>) {
        for (placement, splat) in &self.0 {
            let SplatPixel { inverse_depth, source, weight, .. } = splat.pixels[k];
            if weight > 0.0 {
                let frame = placement.mapped.frame;
                let is_moving = shows_motion(frame, source);
                candidates.push(ColorCandidate { frame, inverse_depth, source, weight, is_moving });
            }
        }
    }
}

/// Adds the splats of successive surface elements of a row. `first` is the first one's position in the map. `part`
/// returns the index of the part in a column and a row of the view.
#[inline(always)]
fn add_each(
    splat: &mut Splat,
    row: &PlacedRow,
    first: [usize; 2],
    part: impl Fn(usize, usize) -> Option<usize>,
) {
    let (hiding, pixels) = (splat.hiding, &mut splat.pixels[..]);
    let n = row.covered.len();
    let (x, y, scale) = (&row.x[..n], &row.y[..n], &row.scale[..n]);
    let (inverse_depth, weight) = (&row.inverse_depth[..n], &row.weight[..n]);
    let py = first[1] as f32 + 0.5;
    for (k, &[left, right, top, bottom]) in row.covered.iter().enumerate() {
        let (cx, cy, q, px) = (x[k], y[k], inverse_depth[k], (first[0] + k) as f32 + 0.5);
        let mut show = |u: i32, v: i32| {
            let Some(part) = part(u as usize, v as usize) else { return };
            let old = &mut pixels[part];
            let (dx, dy) = (u as f32 + 0.5 - cx, v as f32 + 0.5 - cy);
            let distance = dx.abs().max(dy.abs());
            let in_front = q - old.inverse_depth;
            let is_same = (in_front > -hiding) & (distance < old.distance);
            if (old.weight == 0.0) | (in_front > hiding) | is_same {
                let inverse_scale = 1.0 / scale[k];
                let source = [px + dx * inverse_scale, py + dy * inverse_scale];
                *old = SplatPixel { inverse_depth: q, weight: weight[k], source, distance };
            }
        };
        // Most splats cover one pixel.
        if right - left == 1 && bottom - top == 1 {
            show(left, top);
            continue;
        }
        for v in top..bottom {
            for u in left..right {
                show(u, v);
            }
        }
    }
}

#[inline(always)]
fn add(splat: &mut Splat, row: &PlacedRow, first: [usize; 2], area: &Area) {
    let (width, top) = (area.view.width, area.rows.start);
    match &area.parts {
        None => add_each(splat, row, first, |u, v| Some((v - top) * width + u)),
        Some(parts) => add_each(splat, row, first, |u, v| parts.part(u, v - top, width)),
    }
}

multiversion! {
    fn add_row(splat: &mut Splat, row: &PlacedRow, first: [usize; 2], area: &Area) = add
}
