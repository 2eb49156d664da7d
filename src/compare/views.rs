//! One view at an instant: blended by every method with every proxy geometry, then measured.

use super::instant::{ComparedTarget, Comparison, ImageOrReason, SynchronizedBy};
use super::results::{ExcludedCamera, ViewMethod, ViewResult};
use super::sheet::Panel;
use super::truths::{TrueImage, filled_with};
use super::viewer::Figure;
use super::{CompareError, ComparedView, TRADITIONAL};
use crate::interpolation::{SyncMethod, Synchronized};
use crate::light_field::{GivenImages, Images};
use crate::lumigraph::Rendered;
use crate::method::Method;
use crate::metrics::ReferenceImage;
use crate::options::ProxyMethod;
use rayon::prelude::*;
use std::sync::Arc;

/// A blended view for one proxy geometry and one method, before its scores are measured.
pub(super) struct Blend {
    result: ViewResult,
    rendered: Result<Rendered, String>,
}

impl Comparison<'_> {
    /// Renders a view by every [`ViewMethod`] with every proxy geometry. `truths` are the instant's ground-truth
    /// images, and `images` the synchronized images of the cameras, from which the view is blended.
    pub(super) fn blend(
        &self,
        target: &ComparedTarget,
        truths: &[TrueImage],
        images: &[SynchronizedBy],
    ) -> Vec<Blend> {
        let capture = self.renderer.field().capture();
        let by = |method: SyncMethod| {
            let found = images.iter().find(|(m, _)| *m == method);
            found.map_or_else(Vec::new, |(_, images)| images.clone())
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
        for &method in ViewMethod::ALL {
            // Nearest frames show different instants, so no depth can be estimated from them.
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
            let failed = made.iter().zip(&capture.cameras).filter_map(|(image, camera)| {
                let reason = image.as_ref().err()?.clone();
                Some(ExcludedCamera { camera: camera.id.clone(), reason })
            });
            let excluded: Vec<ExcludedCamera> = failed.collect();
            for proxy in self.proxies() {
                let (camera, time_s) = (&target.view.camera, target.instant.inner_s);
                let view = ComparedView { target: camera, time_s, proxy, images, shape };
                let rendered = match cameras {
                    0 => Err("no camera has an image at this instant".to_owned()),
                    _ => self.renderer.view(&view),
                };
                let result = ViewResult {
                    view: self.truth.views[target.view.index].id.clone(),
                    time_s: target.instant.time_s,
                    proxy,
                    method,
                    cameras,
                    excluded: excluded.clone(),
                    measured: None,
                    scores: None,
                    image: None,
                    reason: None,
                };
                blends.push(Blend { result, rendered });
            }
        }
        blends.sort_by_key(|b| ProxyMethod::ALL.iter().position(|p| *p == b.result.proxy));
        blends
    }

    /// Returns the proxy geometries that are compared, cheapest first. Scene flow takes minutes, so it is included only
    /// if the options select it.
    fn proxies(&self) -> impl Iterator<Item = ProxyMethod> + use<> {
        let asked = self.renderer.options().proxy.method;
        let is_compared = move |p: &ProxyMethod| *p != ProxyMethod::SceneFlow || *p == asked;
        ProxyMethod::ALL.iter().copied().filter(is_compared)
    }

    /// Measures the errors of all blended images of one view, on the pixels that every one of them covers. Writes the
    /// images and the comparison sheets. Returns the results, and the viewer's figure.
    pub(super) fn measure_view(
        &self,
        target: &ComparedTarget,
        blends: Vec<Blend>,
    ) -> Result<(Vec<ViewResult>, Figure), CompareError> {
        let ComparedTarget { instant, view, truth } = target;
        let images: Vec<ImageOrReason> = blends
            .iter()
            .map(|b| self.checked(b.rendered.as_ref().map(|r| &r.image), &truth.image))
            .collect();
        let rows = self.view_results(target, blends, &images)?;
        let true_file = self.write(target, "truth", &truth.image, None)?;

        let shown = images.iter().map(Result::as_ref).zip(&rows);
        let panels: Vec<Panel> = shown
            .map(|(image, row)| {
                let title = format!("{}, {}", row.method.help(), row.proxy.name());
                Panel { title, image, scores: row.scores }
            })
            .collect();
        let id = &self.truth.views[view.index].id;
        let mut sheets = Vec::new();
        // The panels are sorted by proxy, so each proxy's panels are one chunk.
        for (proxy, panels) in self.proxies().zip(panels.chunks(ViewMethod::ALL.len())) {
            let name = proxy.name();
            let title = format!("View {id} at {:.4} s, proxy {name}", instant.time_s);
            sheets.push(self.write_sheet(
                title,
                &format!("{}-{name}", view.stem),
                truth,
                panels,
            )?);
        }
        let first = images.iter().find_map(|image| image.as_ref().ok());
        Ok((rows, Figure::new(id, true_file, sheets, truth, first)))
    }

    /// Measures the errors of all blended images of a view, writes the images to files, and returns the results.
    fn view_results(
        &self,
        target: &ComparedTarget,
        blends: Vec<Blend>,
        images: &[ImageOrReason],
    ) -> Result<Vec<ViewResult>, CompareError> {
        let truth = target.truth;
        let covered = common_coverage(&blends, images, truth.moving.len());
        let fraction = covered.iter().filter(|c| **c).count() as f64 / covered.len() as f64;
        let reference = ReferenceImage::new(truth.image.clone(), self.options.pixels_per_degree);
        let result = |(Blend { mut result, rendered }, image): (Blend, &ImageOrReason)| {
            result.reason = image.as_ref().err().cloned();
            if let (Ok(image), Ok(rendered)) = (image, rendered) {
                let maps = reference.compare(&filled_with(&truth.image, image, &covered));
                result.scores = Some(maps.regions(Some(&covered), &truth.moving));
                result.measured = Some(fraction);
                let name = format!("{}-{}", result.proxy.name(), result.method.name());
                let is_whole = rendered.coverage.iter().all(|c| *c);
                let alpha = (!is_whole).then_some(rendered.coverage.as_slice());
                result.image = Some(self.write(target, &name, image, alpha)?);
            }
            Ok(result)
        };
        blends.into_par_iter().zip(images).map(result).collect()
    }
}

/// Returns the row-major mask of the pixels that all rendered blended images of a view cover.
fn common_coverage(blends: &[Blend], images: &[ImageOrReason], pixels: usize) -> Vec<bool> {
    let mut covered = vec![true; pixels];
    let with_image = blends.iter().zip(images).filter(|(_, image)| image.is_ok());
    for view in with_image.filter_map(|(blend, _)| blend.rendered.as_ref().ok()) {
        covered.iter_mut().zip(&view.coverage).for_each(|(c, own)| *c &= own);
    }
    covered
}
