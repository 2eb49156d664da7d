//! Unstructured lumigraph rendering (Buehler, Bosse, McMillan, Gortler, Cohen, SIGGRAPH 2001). Every pixel of the view
//! shows a point of the proxy. The pixel's colour is the weighted mean of the cameras' images at that point.
//!
//! The penalty of camera i at the pixel's point X, seen from the view's centre C, is
//!
//! `p_i = 2 tan(θ_i / 2) · (1 + coarseness_i) / (border_i · visible_i)`
//!
//! Here θ_i is the angle at X between the directions to C and to the camera's centre C_i. The term coarseness_i is the
//! loss of resolution: the size of the camera's pixels at X, divided by the size of the view's pixels at X, minus 1;
//! negative values are set to 0. The term border_i falls from 1 inside the camera's image to 0 at the image's border.
//! The term visible_i is 1 if X is not occluded, falls to 1e-3 if X is behind the surface that the camera sees, and is
//! 1/4 beside the outline of a nearer surface.
//!
//! Buehler et al. add the terms for angle, resolution and field of view. Here they are multiplied. The penalty is then
//! 0 if the camera stands at the view's centre, so that its image is reproduced exactly. The penalty is infinite if X
//! is outside the camera's image. [`super::weights`] turns penalties into weights.
//!
//! With [`BlendMethod::SpaceTime`], the penalty is `√(p_i² + (λ·m_i / (border_i · visible_i))²)`. Here m_i is the
//! expected interpolation error of the camera's pixel, and λ is [`BlendOptions::error_angle_rad`]. The squares are
//! added because the errors of the proxy and of interpolation are independent.
//!
//! If some cameras are grey and others coloured, luminance is blended from all cameras. Chrominance is blended from the
//! coloured cameras, with separate weights. Chrominance fades out where no coloured camera sees the point.
//!
//! Known limit: a camera without [`Source::depth`] also contributes to points that are occluded in this camera.

use super::depth_map::DepthMap;
use super::inpaint::{PointVisibility, inpaint};
use super::penalties::{OCCLUSION_FRACTION, Reprojection};
use super::source::{BlendOptions, Rendered, Source};
use super::span::SpanBlender;
use crate::camera::Camera;
use crate::raster::{Image, Tiles};
use rayon::prelude::*;

/// Number of rows of the view that one parallel task blends.
const BAND_ROWS: usize = 16;

/// Renders the view `target` from the sources' images. `depth` is the depth map of the view.
///
/// Only cameras at the view's centre contribute to pixels without depth. The rendered image has 3 channels if any
/// source's image has 3, else 1.
///
/// # Panics
/// If the size of `depth` is not the view's, or if a source's image, depth map or list of errors doesn't have its
/// camera's size.
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
    let mut visibility = vec![PointVisibility::OutOfView; w * h];
    image
        .data_mut()
        .par_chunks_mut(BAND_ROWS * w * channels)
        .zip(visibility.par_chunks_mut(BAND_ROWS * w))
        .enumerate()
        .for_each_init(
            || SpanBlender::new(sources, &reprojections, target, options),
            |span, (band, (pixels, visibility))| {
                let rows = pixels.chunks_exact_mut(w * channels);
                let rows = rows.zip(visibility.chunks_exact_mut(w));
                for (row, (pixels, visibility)) in rows.enumerate() {
                    span.set_row(band * BAND_ROWS + row, depth);
                    for columns in span.columns() {
                        span.weigh(columns.clone());
                        span.set_visibility(&mut visibility[columns.clone()]);
                        let pixels = &mut pixels[channels * columns.start..channels * columns.end];
                        match (channels, colored == sources.len()) {
                            (1, _) => span.blend::<1>(pixels),
                            (_, true) => span.blend::<3>(pixels),
                            (_, false) => span.blend_mixed(pixels),
                        }
                    }
                }
            },
        );
    // Without depth maps of the sources, no point counts as occluded.
    if sources.iter().any(|s| s.depth.is_some()) {
        inpaint(&mut image, &visibility, depth, OCCLUSION_FRACTION);
    }
    let coverage = visibility.iter().map(|v| *v != PointVisibility::OutOfView).collect();
    Rendered { image, coverage }
}

/// Returns the tiles of each source's image that [`blend`] reads, in the order of the sources. Tiles that are not
/// returned may show anything, but their sources must still be passed to [`blend`], since the weights depend on all
/// sources.
///
/// # Panics
/// If the depth map, or any source's image, depth map or list of errors, has a wrong size, as for [`blend`].
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
        || (SpanBlender::new(sources, &reprojections, target, options), nothing()),
        |(mut span, mut tiles), y| {
            span.set_row(y, depth);
            for columns in span.columns() {
                span.weigh(columns);
                span.mark(&mut tiles);
            }
            (span, tiles)
        },
    );
    rows.map(|(_, tiles)| tiles).reduce(nothing, |mut all, more| {
        all.iter_mut().zip(&more).for_each(|(all, more)| all.add(more));
        all
    })
}

/// Panics if the view's depth map, or any image, depth map or list of errors of a source, has a wrong size.
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
