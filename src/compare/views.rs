//! One view at an instant: blended by every method through every proxy, then measured.

use super::CompareError;
use super::TRADITIONAL;
use super::instant::{Made, Shown, Work, figure};
use super::report::Figure;
use super::results::{LeftOut, ViewMethod, ViewResult};
use super::truths::{TrueImage, TrueInstant, TrueView};
use crate::interpolation::SyncMethod;
use crate::lumigraph::Rendered;
use crate::method::Method;
use crate::metrics::Reference;
use crate::options::ProxyMethod;
use crate::raster::Image;
use crate::raster::{BitDepth, write_image};
use rayon::prelude::*;

type ViewMade = Result<Rendered, String>;

/// One view through one proxy by one method, before it is measured.
pub(super) struct Blend {
    proxy: ProxyMethod,
    method: ViewMethod,
    cameras: usize,
    left_out: Vec<LeftOut>,
    made: ViewMade,
}

impl Work<'_> {
    /// One view through every proxy, by every method.
    pub(super) fn blend(
        &self,
        instant: &TrueInstant,
        view: &TrueView,
        truths: &[TrueImage],
        images: &[Vec<Made>],
    ) -> Vec<Blend> {
        let capture = self.renderer.capture();
        let by = |method: SyncMethod| {
            let row = self.methods.iter().position(|m| *m == method);
            row.map_or_else(Vec::new, |k| images[k].clone())
        };
        let true_image = |camera: usize| {
            let at = instant.views.iter().position(|v| v.like == Some(camera));
            at.map(|k| truths[k].image.clone())
                .ok_or_else(|| "the truth has no image of it at this instant".to_owned())
        };
        let mut blends = Vec::new();
        for method in ViewMethod::ALL {
            let made: Vec<Made> = match method {
                ViewMethod::TraditionalLfr => by(TRADITIONAL),
                ViewMethod::StLfr => by(self.options.sync),
                ViewMethod::PerfectSync => (0..capture.cameras.len()).map(true_image).collect(),
            };
            let left_out: Vec<LeftOut> = made
                .iter()
                .zip(&capture.cameras)
                .filter_map(|(m, camera)| {
                    let reason = m.as_ref().err()?.clone();
                    Some(LeftOut { camera: camera.id.clone(), reason })
                })
                .collect();
            let made: Vec<Option<Image>> = made.into_iter().map(Result::ok).collect();
            for &proxy in ProxyMethod::ALL {
                let cameras = made.iter().flatten().count();
                let rendered = if cameras == 0 {
                    Err("no camera has an image at this instant".to_owned())
                } else {
                    self.renderer.view(&made, proxy, &view.camera, instant.inner_s)
                };
                let left_out = left_out.clone();
                blends.push(Blend { proxy, method, cameras, left_out, made: rendered });
            }
        }
        blends.sort_by_key(|b| ProxyMethod::ALL.iter().position(|p| *p == b.proxy));
        blends
    }

    /// Measures all blends of one view on the pixels that all of them cover; with the report's
    /// pictures if it is `in_report`.
    pub(super) fn measure_view(
        &self,
        instant: &TrueInstant,
        view: &TrueView,
        truth: &TrueImage,
        blends: Vec<Blend>,
        in_report: bool,
    ) -> Result<(Vec<ViewResult>, Option<Figure>), CompareError> {
        let depth = self.renderer.capture().bit_depth();
        let id = &self.truth.views[view.index].id;
        let made: Vec<Made> = blends
            .iter()
            .map(|b| self.checked_view(b.made.as_ref(), &truth.image, depth))
            .collect();
        let covered = common_coverage(&blends, &made, truth.moving.len());
        let share = covered.iter().filter(|c| **c).count() as f64 / covered.len() as f64;
        let reference = Reference::new(truth.image.clone(), self.options.pixels_per_degree);
        let rows: Vec<ViewResult> = blends
            .par_iter()
            .zip(&made)
            .map(|(blend, made)| {
                let mut row = ViewResult {
                    view: id.clone(),
                    time_s: instant.time_s,
                    proxy: blend.proxy,
                    method: blend.method,
                    cameras: blend.cameras,
                    left_out: blend.left_out.clone(),
                    measured: None,
                    scores: None,
                    image: None,
                    reason: made.as_ref().err().cloned(),
                };
                if let (Ok(image), Ok(rendered)) = (made, &blend.made) {
                    let filled = filled_with(&truth.image, image, &covered);
                    let maps = reference.compare(&filled);
                    row.scores = Some(maps.regions(Some(&covered), &truth.moving));
                    row.measured = Some(share);
                    let file = format!("{}-{}.png", blend.proxy.name(), blend.method.slug());
                    let name = format!("images/{}/{file}", view.stem);
                    let all = rendered.coverage.iter().all(|c| *c);
                    let alpha = (!all).then_some(rendered.coverage.as_slice());
                    write_image(&self.out.join(&name), image, alpha, depth)?;
                    row.image = Some(name);
                }
                Ok(row)
            })
            .collect::<Result<_, CompareError>>()?;
        let name = format!("images/{}/truth.png", view.stem);
        write_image(&self.out.join(name), &truth.image, None, depth)?;

        let shown = |proxy: Option<ProxyMethod>| -> Vec<Shown> {
            let all = blends.iter().zip(&made).zip(&rows);
            all.filter(|((b, _), _)| proxy.is_none_or(|p| b.proxy == p))
                .map(|((b, made), row)| Shown {
                    title: format!("{}, {}", b.method.title(), b.proxy.name()),
                    made: made.as_ref(),
                    scores: row.scores,
                })
                .collect()
        };
        for &proxy in ProxyMethod::ALL {
            let name = proxy.name();
            let title = format!(
                "{}: view {id} at {:.4} s, proxy {name}",
                self.renderer.capture().name,
                instant.time_s
            );
            let stem = format!("{}-{name}", view.stem);
            self.write_sheet(&title, &stem, truth, &shown(Some(proxy)))?;
        }
        let title = format!("View {id} at {:.4} s", instant.time_s);
        let figure = in_report.then(|| figure(title, true, truth, &shown(None)));
        Ok((rows, figure))
    }

    fn checked_view(
        &self,
        made: Result<&Rendered, &String>,
        truth: &Image,
        depth: BitDepth,
    ) -> Made {
        let view = made.map_err(Clone::clone)?;
        self.checked(&Ok(view.image.clone()), truth, depth)
    }
}

/// The pixels that every method covers through every proxy, so that all are measured on the same.
fn common_coverage(blends: &[Blend], made: &[Made], pixels: usize) -> Vec<bool> {
    let mut covered = vec![true; pixels];
    for blend in blends.iter().zip(made).filter(|(_, m)| m.is_ok()).map(|(b, _)| b) {
        if let Ok(view) = &blend.made {
            for (c, own) in covered.iter_mut().zip(&view.coverage) {
                *c &= own;
            }
        }
    }
    covered
}

/// The truth where a pixel isn't measured, so that the metrics' windows see no black there.
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
