//! Unstructured lumigraph rendering (Buehler, Bosse, McMillan, Gortler, Cohen, SIGGRAPH 2001):
//! every pixel of the view is a weighted mean of the cameras' images of its point of the proxy.
//!
//! The penalty of camera i at the pixel's point X, seen from the view's centre C:
//!
//! `p_i = 2 tan(θ_i / 2) · (1 + coarseness_i) / (border_i · visible_i)`
//!
//! with θ_i the angle at X between C and C_i. Buehler adds the three parts; multiplied, the
//! penalty is exactly 0 where the view's centre is the camera's, so that this camera alone
//! contributes, up to its border, or to the last node before it where weights are interpolated
//! ([`BlendOptions::weight_step_px`]). It is infinite outside the image, so that ranks change smoothly there.
//! [`super::weights`] turns penalties into weights.
//!
//! A grey camera among coloured ones gives its luminance: luminance is blended from all cameras, and
//! the difference between colour and luminance from the coloured ones alone (with weights of their
//! own), fading to grey where none of them sees the point. A coloured camera's luminance is what a
//! grey one would have recorded in its place: summed before it is encoded.
//!
//! With [`BlendMethod::SpaceTime`] the penalty is `√(p_i² + (λ·m_i)²)`, with m_i the
//! interpolation error of the camera's pixel ([`Source::interpolation_error_px`]) and λ the angle that a pixel counts as: the errors
//! of the proxy and of interpolation are independent. At a camera's place and at the time of its frame
//! it is still 0.
//!
//! Where a point is hidden from every camera, its colour comes from the surfaces around it that are not nearer
//! ([`hidden`]).
//!
//! Known limit: where a point of the proxy is occluded in a camera by another part of the proxy, the
//! camera still contributes unless its own [`Source::depth`] is given.

use super::DepthMap;
use super::hidden::{self, Shown};
use super::part::Part;
use super::reproject::{OCCLUSION_FRACTION, Reprojection};
use super::source::{BlendOptions, Rendered, Source};
use crate::camera::Camera;
use crate::raster::{Image, Tiles};
use rayon::prelude::*;

/// Rows that one task blends. Larger: cores are idle at the end. Smaller: more rows of nodes are weighed twice.
const BAND_ROWS: usize = 16;

/// Renders the view `target` from the sources' images, over the proxy's depths in the view
/// ([`Proxy::depth_map`](super::Proxy::depth_map)).
///
/// Only cameras at the view's centre contribute to pixels without depth. Without sources there is no
/// coverage. The image has 3 channels if any source has, else 1.
///
/// # Panics
/// If the size of the depth map is not the view's, or that of an image or of a source's depth
/// map not its camera's.
pub fn blend(
    sources: &[Source],
    depth: &DepthMap,
    target: &Camera,
    options: &BlendOptions,
) -> Rendered {
    check(sources, depth, target);
    let (w, h) = (target.width, target.height);
    let reprojections = Reprojection::of_all(sources, target, options);
    let colored = sources.iter().filter(|s| s.image.channels() == 3).count();
    let channels = if colored > 0 { 3 } else { 1 };
    let mut image = Image::filled(w, h, channels, 0.0);
    let mut coverage = vec![false; w * h];
    let mut shown = vec![Shown::Nothing; w * h];
    image
        .data_mut()
        .par_chunks_mut(BAND_ROWS * w * channels)
        .zip(coverage.par_chunks_mut(BAND_ROWS * w))
        .zip(shown.par_chunks_mut(BAND_ROWS * w))
        .enumerate()
        .for_each_init(
            || Part::new(sources, &reprojections, target, options),
            |part, (band, ((pixels, covered), shown))| {
                let rows = pixels.chunks_exact_mut(w * channels);
                let rows = rows.zip(covered.chunks_exact_mut(w)).zip(shown.chunks_exact_mut(w));
                for (row, ((pixels, covered), shown)) in rows.enumerate() {
                    part.set_row(band * BAND_ROWS + row, depth);
                    for columns in part.columns() {
                        part.weigh(columns.clone());
                        let pixels = &mut pixels[channels * columns.start..channels * columns.end];
                        match (channels, colored == sources.len()) {
                            (1, _) => part.blend::<1>(pixels),
                            (_, true) => part.blend::<3>(pixels),
                            (_, false) => part.blend_mixed(pixels),
                        }
                        part.cover(&mut covered[columns.clone()], &mut shown[columns]);
                    }
                }
            },
        );
    // Without depths, no camera's point is hidden.
    if sources.iter().any(|s| s.depth.is_some()) {
        hidden::fill(&mut image, &shown, depth, OCCLUSION_FRACTION);
    }
    Rendered { image, coverage }
}

/// The tiles of each source's image that the view depends on, in the sources' order; most sources of a
/// large rig have none.
///
/// The pixels of the other tiles have no influence on [`blend`]. Their cameras have: they end the
/// weights of nearer ones.
///
/// # Panics
/// As [`blend`].
pub fn contributing(
    sources: &[Source],
    depth: &DepthMap,
    target: &Camera,
    options: &BlendOptions,
) -> Vec<Tiles> {
    check(sources, depth, target);
    let reprojections = Reprojection::of_all(sources, target, options);
    let nothing = || -> Vec<Tiles> {
        sources.iter().map(|s| Tiles::none(s.camera.width, s.camera.height)).collect()
    };
    let rows = (0..target.height).into_par_iter().fold(
        || (Part::new(sources, &reprojections, target, options), nothing()),
        |(mut part, mut tiles), y| {
            part.set_row(y, depth);
            for columns in part.columns() {
                part.weigh(columns);
                part.mark(&mut tiles);
            }
            (part, tiles)
        },
    );
    rows.map(|(_, tiles)| tiles).reduce(nothing, |mut all, more| {
        all.iter_mut().zip(&more).for_each(|(all, more)| all.add(more));
        all
    })
}

fn check(sources: &[Source], depth: &DepthMap, target: &Camera) {
    let size = (target.width, target.height);
    assert_eq!((depth.width(), depth.height()), size, "size of the view's depths");
    for source in sources {
        let size = (source.camera.width, source.camera.height);
        assert_eq!((source.image.width(), source.image.height()), size, "size of an image");
        if let Some(error_px) = source.interpolation_error_px {
            assert_eq!(error_px.len(), size.0 * size.1, "size of a source's interpolation errors");
        }
        if let Some(d) = source.depth {
            assert_eq!((d.width(), d.height()), size, "size of a source's depths");
        }
    }
}
