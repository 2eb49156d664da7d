//! One instant of the truth: synchronize the cameras, blend the views, measure both, write the
//! pictures.

use super::metrics::{Reference, RegionScores};
use super::report::{Figure, Picture};
use super::results::{LeftOut, Method, SyncResult, ViewResult};
use super::sheet::{Panel, Sheet};
use super::truths::{TrueImage, TrueInstant, TrueView, as_written, slug};
use super::{CompareError, CompareOptions, NEAREST, RenderedView, Renderer, Stages};
use crate::capture::{BitDepth, Truth, write_image};
use crate::raster::Image;
use rayon::prelude::*;
use std::path::Path;

/// What all instants share.
pub(super) struct Work<'a> {
    pub renderer: &'a dyn Renderer,
    pub truth: &'a Truth,
    pub options: &'a CompareOptions,
    pub out: &'a Path,
    /// The sync rungs to measure, cheapest first.
    pub rungs: &'a [String],
}

/// What was found so far.
#[derive(Default)]
pub(super) struct Found {
    pub sync: Vec<SyncResult>,
    pub views: Vec<ViewResult>,
    /// The pictures of the report, and how many of them are of filming cameras and of views.
    pub figures: Vec<Figure>,
    pub sync_figures: usize,
    pub view_figures: usize,
}

/// An image or the sentence that says why there is none.
type Made = Result<Image, String>;
type ViewMade = Result<RenderedView, String>;

/// One view through one proxy by one method, before it is measured.
struct Blend {
    proxy: usize,
    method: Method,
    cameras: usize,
    left_out: Vec<LeftOut>,
    made: ViewMade,
}

const RENDERING: &str = "synchronized images";
const BLENDING: &str = "views";
const MEASURING: &str = "truth, metrics, sheets and files";

impl Work<'_> {
    /// Compares everything that the truth has of one instant.
    pub fn compare(
        &self,
        instant: &TrueInstant,
        found: &mut Found,
        stages: &mut Stages,
    ) -> Result<(), CompareError> {
        let capture = self.renderer.capture();
        let read = |view: &TrueView| view.read(self.truth, capture, self.options);
        let truths: Vec<TrueImage> = stages
            .time(MEASURING, || instant.views.par_iter().map(read).collect::<Result<_, _>>())?;
        let images = stages.time(RENDERING, || self.synchronize(instant));

        let (like, free): (Vec<_>, Vec<_>) =
            instant.views.iter().zip(&truths).partition(|(view, _)| view.like.is_some());
        let most_moving = like.iter().map(|(_, truth)| truth.moving_pixels()).max();
        let shown = like.iter().position(|(_, t)| Some(t.moving_pixels()) == most_moving);
        let shown = shown.filter(|_| found.sync_figures < self.options.report_views);
        let measured: Vec<_> = stages.time(MEASURING, || {
            like.par_iter()
                .enumerate()
                .map(|(k, (view, truth))| {
                    self.measure_sync(instant, view, truth, &images, Some(k) == shown)
                })
                .collect::<Result<_, _>>()
        })?;
        for (rows, figure) in measured {
            found.sync.extend(rows);
            found.sync_figures += usize::from(figure.is_some());
            found.figures.extend(figure);
        }

        for (view, truth) in free {
            let blends = stages.time(BLENDING, || self.blend(instant, view, &truths, &images));
            let shown = found.view_figures < self.options.report_views;
            let (rows, figure) = stages
                .time(MEASURING, || self.measure_view(instant, view, truth, blends, shown))?;
            found.views.extend(rows);
            found.view_figures += usize::from(figure.is_some());
            found.figures.extend(figure);
        }
        Ok(())
    }

    /// `[rung][camera]`: all cameras where a view is blended from them, else those that the truth
    /// has an image of.
    fn synchronize(&self, instant: &TrueInstant) -> Vec<Vec<Made>> {
        let blends = instant.views.iter().any(|v| v.like.is_none());
        let cameras = self.renderer.capture().cameras.len();
        let one = |rung: &String, camera: usize| {
            let like = instant.views.iter().any(|v| v.like == Some(camera));
            let feeds_views = blends && (*rung == NEAREST || *rung == self.options.sync);
            if like || feeds_views {
                self.renderer.synchronized(rung, camera, instant.inner_s)
            } else {
                Err("was not asked for".into())
            }
        };
        self.rungs.iter().map(|rung| (0..cameras).map(|c| one(rung, c)).collect()).collect()
    }

    /// All rungs of one filming camera, and if it is to be `shown` the report's pictures of it.
    fn measure_sync(
        &self,
        instant: &TrueInstant,
        view: &TrueView,
        truth: &TrueImage,
        images: &[Vec<Made>],
        shown: bool,
    ) -> Result<(Vec<SyncResult>, Option<Figure>), CompareError> {
        let capture = self.renderer.capture();
        let (camera, depth) = (view.like.unwrap_or_default(), capture.bit_depth());
        let id = &self.truth.views[view.index].id;
        let reference = Reference::new(truth.image.clone(), self.options.pixels_per_degree);
        let mut rows = Vec::new();
        let mut written = Vec::new();
        for (rung, of_rung) in self.rungs.iter().zip(images) {
            let made = self.checked(&of_rung[camera], &truth.image, depth);
            let scores =
                made.as_ref().ok().map(|i| reference.compare(i).regions(None, &truth.moving));
            let image = match &made {
                Ok(image) => {
                    let name = format!("images/{}/{}.png", view.stem, slug(rung));
                    write_image(&self.out.join(&name), image, None, depth)?;
                    Some(name)
                }
                Err(_) => None,
            };
            rows.push(SyncResult {
                view: id.clone(),
                camera: capture.cameras[camera].id.clone(),
                time_s: instant.time_s,
                rung: rung.clone(),
                scores,
                image,
                reason: made.as_ref().err().cloned(),
            });
            written.push(made);
        }
        let panels: Vec<Shown> = self
            .rungs
            .iter()
            .zip(&written)
            .zip(&rows)
            .map(|((rung, made), row)| Shown {
                title: rung.clone(),
                made: made.as_ref(),
                scores: row.scores,
            })
            .collect();
        let title = format!(
            "{}: {} at {:.4} s, synchronized",
            capture.name, capture.cameras[camera].id, instant.time_s
        );
        self.write_sheet(&title, &view.stem, truth, &panels)?;
        let title = format!("Camera {} at {:.4} s", capture.cameras[camera].id, instant.time_s);
        let figure = shown.then(|| figure(title, false, truth, &panels));
        Ok((rows, figure))
    }

    /// One view through every proxy, by every method.
    fn blend(
        &self,
        instant: &TrueInstant,
        view: &TrueView,
        truths: &[TrueImage],
        images: &[Vec<Made>],
    ) -> Vec<Blend> {
        let capture = self.renderer.capture();
        let of_rung = |rung: &str| match self.rungs.iter().position(|r| r == rung) {
            Some(k) => images[k].clone(),
            None => vec![Err(format!("there is no sync rung '{rung}'")); capture.cameras.len()],
        };
        let true_image = |camera: usize| {
            let at = instant.views.iter().position(|v| v.like == Some(camera));
            at.map(|k| truths[k].image.clone())
                .ok_or_else(|| "the truth has no image of it at this instant".to_owned())
        };
        let mut blends = Vec::new();
        for method in Method::ALL {
            let made: Vec<Made> = match method {
                Method::TraditionalLfr => of_rung(NEAREST),
                Method::StLfr => of_rung(&self.options.sync),
                Method::PerfectSync => (0..capture.cameras.len()).map(true_image).collect(),
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
            for proxy in 0..self.renderer.proxies().len() {
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
        blends.sort_by_key(|b| b.proxy);
        blends
    }

    fn measure_view(
        &self,
        instant: &TrueInstant,
        view: &TrueView,
        truth: &TrueImage,
        blends: Vec<Blend>,
        in_report: bool,
    ) -> Result<(Vec<ViewResult>, Option<Figure>), CompareError> {
        let depth = self.renderer.capture().bit_depth();
        let id = &self.truth.views[view.index].id;
        let names = self.renderer.proxies();
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
                let proxy = &names[blend.proxy];
                let mut row = ViewResult {
                    view: id.clone(),
                    time_s: instant.time_s,
                    proxy: proxy.clone(),
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
                    let file = format!("{}-{}.png", slug(proxy), blend.method.slug());
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

        let shown = |proxy: Option<usize>| -> Vec<Shown> {
            let all = blends.iter().zip(&made).zip(&rows);
            all.filter(|((b, _), _)| proxy.is_none_or(|p| b.proxy == p))
                .map(|((b, made), row)| Shown {
                    title: format!("{}, {}", b.method.title(), names[b.proxy]),
                    made: made.as_ref(),
                    scores: row.scores,
                })
                .collect()
        };
        for (proxy, name) in names.iter().enumerate() {
            let title = format!(
                "{}: view {id} at {:.4} s, proxy {name}",
                self.renderer.capture().name,
                instant.time_s
            );
            let stem = format!("{}-{}", view.stem, slug(name));
            self.write_sheet(&title, &stem, truth, &shown(Some(proxy)))?;
        }
        let title = format!("View {id} at {:.4} s", instant.time_s);
        let figure = in_report.then(|| figure(title, true, truth, &shown(None)));
        Ok((rows, figure))
    }

    fn write_sheet(
        &self,
        title: &str,
        stem: &str,
        truth: &TrueImage,
        shown: &[Shown],
    ) -> Result<(), CompareError> {
        let panels: Vec<Panel> = shown
            .iter()
            .map(|s| Panel {
                title: &s.title,
                image: s.made.ok(),
                scores: s.scores.as_ref(),
                note: s.made.err().map_or("", String::as_str),
            })
            .collect();
        let sheet = Sheet {
            title,
            truth: &truth.image,
            moving: &truth.moving,
            panels: &panels,
            gain: self.options.difference_gain,
        };
        let path = self.out.join(format!("sheets/{stem}.png"));
        Ok(write_image(&path, &sheet.draw(), None, BitDepth::Eight)?)
    }

    /// An image as its file holds it, if it has the truth's size.
    fn checked(&self, made: &Made, truth: &Image, depth: BitDepth) -> Made {
        let image = made.as_ref().map_err(Clone::clone)?;
        if (image.width(), image.height()) != (truth.width(), truth.height()) {
            return Err(format!(
                "is {}×{} pixels, the truth {}×{}",
                image.width(),
                image.height(),
                truth.width(),
                truth.height()
            ));
        }
        Ok(as_written(image, truth.channels(), depth))
    }

    fn checked_view(
        &self,
        made: Result<&RenderedView, &String>,
        truth: &Image,
        depth: BitDepth,
    ) -> Made {
        let view = made.map_err(Clone::clone)?;
        self.checked(&Ok(view.image.clone()), truth, depth)
    }
}

/// A result as sheets and figures show it.
struct Shown<'a> {
    title: String,
    made: Result<&'a Image, &'a String>,
    scores: Option<RegionScores>,
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

fn figure(title: String, is_view: bool, truth: &TrueImage, shown: &[Shown]) -> Figure {
    let mut pictures = vec![Picture::new("Truth", &truth.image, None)];
    pictures
        .extend(shown.iter().filter_map(|s| Some(Picture::new(&s.title, s.made.ok()?, s.scores))));
    Figure { title, is_view, pictures }
}
