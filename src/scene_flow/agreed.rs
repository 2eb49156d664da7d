//! Quick views: the pixels of a band at which a few scene flow maps agree are means of what these maps show.

use super::composite::{Pixel, shows_motion};
use super::frame::FlowFrame;
use super::pixels::Band;
use super::splat::{SplatPixel, Splats};

/// Minimum number of scene flow maps that must show a pixel of a quick view for the others to be left out.
const MIN_AGREEING: usize = 2;

/// Which maps contribute to a pixel.
#[derive(Clone, Copy, PartialEq)]
enum Contributing {
    /// The maps don't agree.
    None,
    /// Those of grey cameras.
    Gray,
    /// Those of colour cameras. Grey cameras are left out if a colour camera contributes.
    Color,
}

/// Sums over the contributing maps at a pixel. All but the weights are weighted.
#[derive(Clone, Copy)]
struct Sums {
    contributing: Contributing,
    /// Minimum weight of a contributing map: the second largest one. Interpolation of a third colour takes more time than
    /// it gains.
    min_weight: f32,
    color: [f32; 3],
    weights: f32,
    inverse_depths: f32,
    /// The weights of maps that show a moving body.
    moving: f32,
}

impl Sums {
    /// Sums without any map yet. Elements of one surface differ by less than `reach` in inverse depth, 1/m.
    #[inline(always)]
    fn new(splats: &Splats, k: usize, reach: f32) -> Self {
        let (mut min, mut max, mut count) = (f32::INFINITY, f32::NEG_INFINITY, 0);
        // The two largest weights, of grey and of colour cameras.
        let mut heaviest = [[0.0f32; 2]; 2];
        for (placement, splat) in &splats.0 {
            let pixel = &splat.pixels[k];
            // A subnormal weight has no reciprocal.
            if pixel.weight >= f32::MIN_POSITIVE {
                (min, max) = (min.min(pixel.inverse_depth), max.max(pixel.inverse_depth));
                let [first, second] = &mut heaviest[usize::from(placement.mapped.frame.is_color)];
                *second = second.max(pixel.weight.min(*first));
                *first = first.max(pixel.weight);
                count += 1;
            }
        }
        let contributing = match count >= MIN_AGREEING && max - min < reach {
            false => Contributing::None,
            true if heaviest[1][0] > 0.0 => Contributing::Color,
            true => Contributing::Gray,
        };
        let of = heaviest[usize::from(contributing == Contributing::Color)];
        let min_weight = of[1].max(f32::MIN_POSITIVE);
        Self {
            contributing,
            min_weight,
            color: [0.0; 3],
            weights: 0.0,
            inverse_depths: 0.0,
            moving: 0.0,
        }
    }

    /// Returns the means. At least one map with a positive weight must have contributed.
    #[inline(always)]
    fn mean(&self) -> Pixel {
        let inverse = 1.0 / self.weights;
        Pixel {
            color: self.color.map(|c| (c * inverse).clamp(0.0, 1.0)),
            inverse_depth: self.inverse_depths * inverse,
            is_moving: 2.0 * self.moving > self.weights,
        }
    }
}

/// Adds what a frame's map shows at successive pixels to their sums.
fn add(sums: &mut [Sums], frame: &FlowFrame, shown: &[SplatPixel]) {
    let own = if frame.is_color { Contributing::Color } else { Contributing::Gray };
    let contributing = sums
        .iter_mut()
        .zip(shown)
        .filter(|(sums, pixel)| pixel.weight >= sums.min_weight && sums.contributing == own);
    let places = contributing.map(|(sums, pixel)| (pixel.source, (sums, pixel)));
    frame.colors(places, |(sums, pixel), color| {
        let weight = pixel.weight;
        (0..3).for_each(|c| sums.color[c] += weight * color[c]);
        sums.weights += weight;
        sums.inverse_depths += weight * pixel.inverse_depth;
        sums.moving += if shows_motion(frame, pixel.source) { weight } else { 0.0 };
    });
}

/// Blends the pixels of a band at which the splatted maps agree: what they show belongs to one surface, and sufficiently
/// many show something. Returns the indices of the other pixels. `width` is the width of the view, pixels. Elements of one
/// surface differ by less than `reach` in inverse depth, 1/m.
///
/// It is faster than [`pixel_of`](super::composite::pixel_of), and not robust. All pixels of a row are interpolated in one
/// image before the next one, so that the processor's nearest cache holds what is read.
pub fn blend_agreed(band: &mut Band, splats: &Splats, width: usize, reach: f32) -> Vec<u32> {
    let mut open = Vec::new();
    let mut row = Vec::with_capacity(width);
    for first in (0..band.colors.len()).step_by(width.max(1)) {
        row.clear();
        row.extend((first..first + width).map(|k| Sums::new(splats, k, reach)));
        for (placement, splat) in &splats.0 {
            add(&mut row, placement.mapped.frame, &splat.pixels[first..first + width]);
        }
        for (k, sums) in (first..).zip(&row) {
            if sums.contributing == Contributing::None {
                // A band has less than 2³² pixels.
                open.push(k as u32);
            } else {
                band.set(k, &sums.mean());
            }
        }
    }
    open
}
