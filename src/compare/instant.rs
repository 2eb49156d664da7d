//! One instant of the truth: synchronize the cameras, measure them, write the pictures. The views
//! that are blended from them are in `views.rs`.

use super::report::{Figure, Picture};
use super::results::{SyncResult, ViewResult};
use super::sheet::{Panel, Sheet};
use super::stage_times::StageTimes;
use super::truths::{TrueImage, TrueInstant, TrueView, as_written};
use super::{CompareError, CompareOptions, Renderer, TRADITIONAL};
use crate::capture::Truth;
use crate::interpolation::SyncMethod;
use crate::method::Method;
use crate::metrics::{Reference, RegionScores};
use crate::raster::Image;
use crate::raster::{BitDepth, write_image};
use rayon::prelude::*;
use std::path::Path;

/// What all instants share.
pub(super) struct Work<'a> {
    pub renderer: &'a dyn Renderer,
    pub truth: &'a Truth,
    pub options: &'a CompareOptions,
    pub out: &'a Path,
    /// The sync methods to measure, cheapest first.
    pub methods: &'a [SyncMethod],
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
pub(super) type Made = Result<Image, String>;

const RENDERING: &str = "synchronized images";
const BLENDING: &str = "views";
const MEASURING: &str = "truth, metrics, sheets and files";

impl Work<'_> {
    /// Compares everything that the truth has of one instant.
    pub fn compare(
        &self,
        instant: &TrueInstant,
        found: &mut Found,
        stages: &mut StageTimes,
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

    /// `[method][camera]`: all cameras where a view is blended from them, else those that the truth
    /// has an image of.
    fn synchronize(&self, instant: &TrueInstant) -> Vec<Vec<Made>> {
        let blends = instant.views.iter().any(|v| v.like.is_none());
        let cameras = self.renderer.capture().cameras.len();
        let one = |method: SyncMethod, camera: usize| {
            let like = instant.views.iter().any(|v| v.like == Some(camera));
            let feeds_views = blends && [TRADITIONAL, self.options.sync].contains(&method);
            if like || feeds_views {
                self.renderer.synchronized(method, camera, instant.inner_s)
            } else {
                Err("was not asked for".into())
            }
        };
        self.methods.iter().map(|&m| (0..cameras).map(|c| one(m, c)).collect()).collect()
    }

    /// All sync methods of one filming camera, and if it is to be `shown` the report's pictures of it.
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
        for (&method, of_method) in self.methods.iter().zip(images) {
            let made = self.checked(&of_method[camera], &truth.image, depth);
            let scores =
                made.as_ref().ok().map(|i| reference.compare(i).regions(None, &truth.moving));
            let image = match &made {
                Ok(image) => {
                    let name = format!("images/{}/{}.png", view.stem, method.name());
                    write_image(&self.out.join(&name), image, None, depth)?;
                    Some(name)
                }
                Err(_) => None,
            };
            rows.push(SyncResult {
                view: id.clone(),
                camera: capture.cameras[camera].id.clone(),
                time_s: instant.time_s,
                method,
                scores,
                image,
                reason: made.as_ref().err().cloned(),
            });
            written.push(made);
        }
        let name = format!("images/{}/truth.png", view.stem);
        write_image(&self.out.join(name), &truth.image, None, depth)?;
        let panels: Vec<Shown> = self
            .methods
            .iter()
            .zip(&written)
            .zip(&rows)
            .map(|((method, made), row)| Shown {
                title: method.name().to_owned(),
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

    pub(super) fn write_sheet(
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
    pub(super) fn checked(&self, made: &Made, truth: &Image, depth: BitDepth) -> Made {
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
}

/// A result as sheets and figures show it.
pub(super) struct Shown<'a> {
    pub title: String,
    pub made: Result<&'a Image, &'a String>,
    pub scores: Option<RegionScores>,
}

/// The truth and what the methods made, for the report.
pub(super) fn figure(title: String, is_view: bool, truth: &TrueImage, shown: &[Shown]) -> Figure {
    let mut pictures = vec![Picture::new("Truth", &truth.image, None)];
    pictures
        .extend(shown.iter().filter_map(|s| Some(Picture::new(&s.title, s.made.ok()?, s.scores))));
    Figure { title, is_view, pictures }
}
