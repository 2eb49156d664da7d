//! One view at an instant: blended by every method through every proxy, then measured.

use super::instant::{
    ComparedTarget, Comparison, ImageOrReason, Shown, SynchronizedOrReason, figure,
};
use super::report::Figure;
use super::results::{ExcludedCamera, ViewMethod, ViewResult};
use super::truths::TrueImage;
use super::{CompareError, ComparedView, TRADITIONAL};
use crate::interpolation::{SyncMethod, Synchronized};
use crate::light_field::{GivenImages, Images};
use crate::lumigraph::Rendered;
use crate::method::Method;
use crate::metrics::ReferenceImage;
use crate::options::ProxyMethod;
use crate::raster::Image;
use rayon::prelude::*;
use std::sync::Arc;

/// A blended view for one proxy and one method, before it is measured.
pub(super) struct Blend {
    proxy: ProxyMethod,
    method: ViewMethod,
    /// How many cameras gave an image.
    cameras: usize,
    excluded: Vec<ExcludedCamera>,
    rendered: Result<Rendered, String>,
}

impl Comparison<'_> {
    /// Blends a view by every method with every proxy.
    pub(super) fn blend(
        &self,
        target: &ComparedTarget,
        truths: &[TrueImage],
        images: &[Vec<SynchronizedOrReason>],
    ) -> Vec<Blend> {
        let capture = self.renderer.capture();
        let by = |method: SyncMethod| {
            let row = self.methods.iter().position(|m| *m == method);
            row.map_or_else(Vec::new, |k| images[k].clone())
        };
        let true_image = |camera: usize| {
            let at = target.instant.views.iter().position(|v| v.like == Some(camera));
            at.map(|k| Arc::new(Synchronized::filmed(truths[k].image.clone())))
                .ok_or_else(|| "the truth has no image of it at this instant".to_owned())
        };
        let true_images: Vec<_> = (0..capture.cameras.len()).map(true_image).collect();
        let given = true_images.iter().map(|image| image.as_ref().ok().cloned()).collect();
        let given = GivenImages::filmed(given);
        let synchronized = Images::By(self.options.sync);
        let mut blends = Vec::new();
        for method in ViewMethod::ALL {
            // Images of other instants than the view's show no shape.
            let (made, images, shape) = match method {
                ViewMethod::TraditionalLfr => {
                    (by(TRADITIONAL), Images::By(TRADITIONAL), synchronized)
                }
                ViewMethod::StLfr => (by(self.options.sync), synchronized, synchronized),
                ViewMethod::PerfectSync => {
                    (true_images.clone(), Images::Given(&given), Images::Given(&given))
                }
            };
            let cameras = made.iter().flatten().count();
            let excluded: Vec<ExcludedCamera> = made
                .iter()
                .zip(&capture.cameras)
                .filter_map(|(image, camera)| {
                    let reason = image.as_ref().err()?.clone();
                    Some(ExcludedCamera { camera: camera.id.clone(), reason })
                })
                .collect();
            for &proxy in ProxyMethod::ALL {
                let rendered = if cameras == 0 {
                    Err("no camera has an image at this instant".to_owned())
                } else {
                    let (target, time_s) = (&target.view.camera, target.instant.inner_s);
                    self.renderer.view(&ComparedView { target, time_s, proxy, images, shape })
                };
                let excluded = excluded.clone();
                blends.push(Blend { proxy, method, cameras, excluded, rendered });
            }
        }
        blends.sort_by_key(|b| ProxyMethod::ALL.iter().position(|p| *p == b.proxy));
        blends
    }

    /// Measures all blends of one view on the pixels that all of them cover; with the report's
    /// pictures if it is `in_report`.
    pub(super) fn measure_view(
        &self,
        target: &ComparedTarget,
        blends: &[Blend],
        in_report: bool,
    ) -> Result<(Vec<ViewResult>, Option<Figure>), CompareError> {
        let ComparedTarget { instant, view, truth } = target;
        let images: Vec<ImageOrReason> = blends
            .iter()
            .map(|b| self.checked(b.rendered.as_ref().map(|r| &r.image), &truth.image))
            .collect();
        let rows = self.view_results(target, blends, &images)?;
        self.write(target, "truth", &truth.image, None)?;

        let shown = |proxy: Option<ProxyMethod>| -> Vec<Shown> {
            let all = blends.iter().zip(&images).zip(&rows);
            all.filter(|((b, _), _)| proxy.is_none_or(|p| b.proxy == p))
                .map(|((b, image), row)| Shown {
                    title: format!("{}, {}", b.method.title(), b.proxy.name()),
                    image: image.as_ref(),
                    scores: row.scores,
                })
                .collect()
        };
        let (capture, id) = (&self.renderer.capture().name, &self.truth.views[view.index].id);
        for &proxy in ProxyMethod::ALL {
            let name = proxy.name();
            let title = format!("{capture}: view {id} at {:.4} s, proxy {name}", instant.time_s);
            let stem = format!("{}-{name}", view.stem);
            self.write_sheet(&title, &stem, truth, &shown(Some(proxy)))?;
        }
        let title = format!("View {id} at {:.4} s", instant.time_s);
        let figure = in_report.then(|| figure(title, true, truth, &shown(None)));
        Ok((rows, figure))
    }

    /// Results of all blends; writes their images.
    fn view_results(
        &self,
        target: &ComparedTarget,
        blends: &[Blend],
        images: &[ImageOrReason],
    ) -> Result<Vec<ViewResult>, CompareError> {
        let ComparedTarget { instant, view, truth } = target;
        let covered = common_coverage(blends, images, truth.moving.len());
        let fraction = covered.iter().filter(|c| **c).count() as f64 / covered.len() as f64;
        let reference = ReferenceImage::new(truth.image.clone(), self.options.pixels_per_degree);
        let result = |(blend, image): (&Blend, &ImageOrReason)| {
            let mut row = ViewResult {
                view: self.truth.views[view.index].id.clone(),
                time_s: instant.time_s,
                proxy: blend.proxy,
                method: blend.method,
                cameras: blend.cameras,
                excluded: blend.excluded.clone(),
                measured: None,
                scores: None,
                image: None,
                reason: image.as_ref().err().cloned(),
            };
            if let (Ok(image), Ok(rendered)) = (image, &blend.rendered) {
                let filled = filled_with(&truth.image, image, &covered);
                let maps = reference.compare(&filled);
                row.scores = Some(maps.regions(Some(&covered), &truth.moving));
                row.measured = Some(fraction);
                let name = format!("{}-{}", blend.proxy.name(), blend.method.slug());
                let is_whole = rendered.coverage.iter().all(|c| *c);
                let alpha = (!is_whole).then_some(rendered.coverage.as_slice());
                row.image = Some(self.write(target, &name, image, alpha)?);
            }
            Ok(row)
        };
        blends.par_iter().zip(images).map(result).collect()
    }
}

/// Pixels that all methods cover with all proxies, on which all are measured.
fn common_coverage(blends: &[Blend], images: &[ImageOrReason], pixels: usize) -> Vec<bool> {
    let mut covered = vec![true; pixels];
    for blend in blends.iter().zip(images).filter(|(_, image)| image.is_ok()).map(|(b, _)| b) {
        if let Ok(view) = &blend.rendered {
            for (c, own) in covered.iter_mut().zip(&view.coverage) {
                *c &= own;
            }
        }
    }
    covered
}

/// Fills unmeasured pixels with the truth, so that windows of metrics see no black.
fn filled_with(truth: &Image, image: &Image, covered: &[bool]) -> Image {
    let n = image.channels();
    let mut filled = image.clone();
    for (k, pixel) in filled.data_mut().chunks_exact_mut(n).enumerate() {
        if !covered[k] {
            pixel.copy_from_slice(&truth.data()[k * n..(k + 1) * n]);
        }
    }
    filled
}
