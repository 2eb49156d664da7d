//! Composites a pixel of a view from the surface elements that several scene flow maps show there.

use super::frame::FlowFrame;
use super::robust_mean::WeightedColors;

/// Weight above which a cluster occludes a cluster of larger weight behind it, as a fraction of the weight of all
/// surface elements at the pixel.
const FRONT: f32 = 0.12;
/// Weight from which a cluster is opaque, as a fraction of the weight of all surface elements at the pixel. The
/// opacity rises linearly with the weight, from 0 at [`FRONT`] to 1 at this weight.
const OPAQUE: f32 = 0.25;
/// Factor on the thresholds [`FRONT`] and [`OPAQUE`] for a cluster that is known to move. A smaller weight suffices for
/// such a cluster, since its source pixels are known not to show static background.
const MOVING: f32 = 0.25;
/// Weight above which a cluster is visible through a transparent cluster in front of it, as a fraction of the weight
/// of all surface elements at the pixel.
const BEHIND: f32 = 0.05;
/// Minimum weight of a candidate (surface element of one scene flow map) in the mean of its cluster, as a fraction of
/// the largest weight in the cluster.
const MIN_FRACTION: f32 = 0.02;

/// Colour and depth of the surface that a pixel of the view shows.
#[derive(Clone, Copy)]
pub struct Pixel {
    pub color: [f32; 3],
    /// Inverse depth of the surface, 1/m.
    pub inverse_depth: f32,
    /// Whether the surface is known to move.
    pub is_moving: bool,
}

/// Surface element that one scene flow map shows at a pixel of the view, with the source of its colour.
pub struct ColorCandidate<'a> {
    pub frame: &'a FlowFrame,
    pub inverse_depth: f32,
    pub source: [f32; 2],
    pub weight: f32,
    /// Whether the source pixel is known to show a moving body.
    pub is_moving: bool,
}

impl ColorCandidate<'_> {
    /// Returns the factor on the weight threshold [`FRONT`] for this candidate: [`MOVING`] if it shows a moving body,
    /// else 1.
    fn front_factor(&self) -> f32 {
        if self.is_moving { MOVING } else { 1.0 }
    }
}

/// Returns whether a position in a frame, pixels, is known to show a moving body.
pub fn shows_motion(frame: &FlowFrame, [x, y]: [f32; 2]) -> bool {
    let (width, height) = (frame.view.width, frame.view.height);
    let inside = |at: f32, size: usize| (at as usize).min(size - 1); // saturates at 0
    frame.is_moving(inside(y, height) * width + inside(x, width))
}

/// Returns colour and depth of a pixel: the means of the frontmost cluster of candidates with a sufficient weight
/// ([`FRONT`]), or else of the cluster with the largest weight. If this cluster isn't opaque ([`OPAQUE`]), its colour
/// is composited over the colour of the cluster behind it. `reach` is the half-width of a cluster in inverse depth,
/// 1/m. `colors` is a reusable buffer. `None` without candidates.
pub fn pixel_of(
    candidates: &[ColorCandidate],
    reach: f32,
    colors: &mut WeightedColors,
) -> Option<Pixel> {
    let depths = || candidates.iter().map(|c| c.inverse_depth);
    let nearest = depths().fold(f32::NEG_INFINITY, f32::max);
    if nearest - depths().fold(f32::INFINITY, f32::min) < reach {
        return mean_of(candidates, nearest, reach, colors);
    }
    let total: f32 = candidates.iter().map(|c| c.weight).sum();
    let support = |q: f32| -> f32 {
        let near = candidates.iter().filter(|c| (c.inverse_depth - q).abs() < reach);
        near.map(|c| c.weight).sum()
    };
    let heaviest = |min: f32, max: f32| {
        let supports = depths().filter(|q| *q > min && *q < max).map(|q| (q, support(q)));
        supports.fold((0.0, 0.0), |best, new| if new.1 > best.1 { new } else { best })
    };
    let (mut q, mut weight) = heaviest(f32::NEG_INFINITY, f32::INFINITY);
    let is_front = |c: &&ColorCandidate| {
        c.inverse_depth > q && support(c.inverse_depth) > c.front_factor() * FRONT * total
    };
    let front = candidates.iter().filter(is_front).map(|c| c.inverse_depth).fold(q, f32::max);
    if front > q {
        (q, weight) = heaviest(front - reach, front + reach);
    }
    let mut pixel = mean_of(candidates, q, reach, colors)?;
    let (behind, weight_behind) = heaviest(f32::NEG_INFINITY, q - 2.0 * reach);
    if weight_behind > BEHIND * total {
        let factor = if pixel.is_moving { MOVING } else { 1.0 };
        let [transparent, opaque] = [factor * FRONT, factor * OPAQUE];
        let opacity = ((weight / total - transparent) / (opaque - transparent)).clamp(0.0, 1.0);
        if opacity < 1.0
            && let Some(back) = mean_of(candidates, behind, reach, colors)
        {
            for (color, back) in pixel.color.iter_mut().zip(back.color) {
                *color = opacity * *color + (1.0 - opacity) * back;
            }
        }
    }
    Some(pixel)
}

/// Returns the mean colour and inverse depth of the candidates whose inverse depths differ from `q` by less than
/// `reach`, both in 1/m. The mean of the colours is robust ([`WeightedColors::robust_mean`]). `colors` is a reusable buffer.
/// `None` if there are no such candidates.
fn mean_of(
    candidates: &[ColorCandidate],
    q: f32,
    reach: f32,
    colors: &mut WeightedColors,
) -> Option<Pixel> {
    let cluster = || candidates.iter().filter(|c| (c.inverse_depth - q).abs() < reach);
    // Grey cameras are left out if a colour camera contributes.
    let has_color = cluster().any(|c| c.frame.is_color);
    let cluster = || cluster().filter(|c| c.frame.is_color == has_color);
    let most = cluster().map(|c| c.weight).fold(0.0, f32::max);
    let (mut depths, mut weights, mut moving) = (0.0, 0.0, 0.0);
    colors.clear();
    for c in cluster().filter(|c| c.weight >= MIN_FRACTION * most) {
        colors.push(c.frame.color(c.source), c.weight);
        depths += c.weight * c.inverse_depth;
        weights += c.weight;
        moving += if c.is_moving { c.weight } else { 0.0 };
    }
    if colors.is_empty() {
        return None;
    }
    let color = colors.robust_mean().map(|c| c.clamp(0.0, 1.0));
    Some(Pixel { color, inverse_depth: depths / weights, is_moving: 2.0 * moving > weights })
}
