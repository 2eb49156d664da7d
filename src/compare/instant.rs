//! Compares the images of one instant with the ground truth: interpolates each camera's image at the instant, measures
//! its error, and writes the pictures. `views.rs` blends views from these images.

use super::results::{StageTimes, SyncResult, ViewResult};
use super::sheet::{Panel, sheet};
use super::truths::{TrueImage, TrueInstant, TrueView, as_written};
use super::viewer::{Figure, SheetFile};
use super::{CompareError, CompareOptions, Renderer, TRADITIONAL};
use crate::capture::Truth;
use crate::host::beneath;
use crate::interpolation::{SyncMethod, Synchronized};
use crate::method::Method;
use crate::metrics::ReferenceImage;
use crate::raster::{Image, write_image, write_webp};
use rayon::prelude::*;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Inputs of a comparison that are the same for all instants.
pub(super) struct Comparison<'a> {
    pub renderer: &'a dyn Renderer,
    pub truth: &'a Truth,
    pub options: &'a CompareOptions,
    pub out: &'a Path,
}

/// The results of the comparison, for the instants compared so far.
#[derive(Default)]
pub(super) struct Results {
    pub sync: Vec<SyncResult>,
    pub views: Vec<ViewResult>,
    /// The ground-truth images that the report's viewer shows, each with its comparison sheets.
    pub figures: Vec<Figure>,
}

/// A ground-truth image, with its view and its instant, that rendered images are compared with.
pub(super) struct ComparedTarget<'a> {
    pub instant: &'a TrueInstant,
    pub view: &'a TrueView,
    pub truth: &'a TrueImage,
}

/// An image, or a sentence that says why the image is missing.
pub(super) type ImageOrReason = Result<Image, String>;

/// A synchronization method, which is a method of temporal interpolation, and the image that it interpolated for each
/// camera at one instant, in the capture's order. A sentence with the reason replaces a missing image.
pub(super) type SynchronizedBy = (SyncMethod, Vec<Result<Arc<Synchronized>, String>>);

const RENDERING: &str = "synchronized images";
const BLENDING: &str = "views";
const MEASURING: &str = "truth, metrics, sheets and files";

impl Comparison<'_> {
    /// Compares rendered images with all ground-truth images of one instant. Appends the scores to `results`, and adds
    /// the run times to `stages`.
    pub fn compare(
        &self,
        instant: &TrueInstant,
        results: &mut Results,
        stages: &mut StageTimes,
    ) -> Result<(), CompareError> {
        let capture = self.renderer.field().capture();
        let read = |view: &TrueView| view.read(self.truth, capture, self.options);
        let truths: Vec<TrueImage> = stages
            .time(MEASURING, || instant.views.par_iter().map(read).collect::<Result<_, _>>())?;
        let images = stages.time(RENDERING, || self.synchronize(instant));

        let target = |(view, truth)| ComparedTarget { instant, view, truth };
        let targets = instant.views.iter().zip(&truths).map(target);
        let (filmed, free): (Vec<_>, Vec<_>) = targets.partition(|t| t.view.like.is_some());
        let measure = |target| self.measure_sync(target, &images);
        let measured: Vec<_> =
            stages.time(MEASURING, || filmed.par_iter().map(measure).collect::<Result<_, _>>())?;
        for (rows, figure) in measured {
            results.sync.extend(rows);
            results.figures.push(figure);
        }

        for target in free {
            let blends = stages.time(BLENDING, || self.blend(&target, &truths, &images));
            let (rows, figure) = stages.time(MEASURING, || self.measure_view(&target, blends))?;
            results.views.extend(rows);
            results.figures.push(figure);
        }
        Ok(())
    }

    /// Interpolates the cameras' images at an instant. Returns the images by synchronization method and camera. If the
    /// ground truth has a view that is no camera's, `nearest` and the chosen method interpolate the images of all
    /// cameras, because the view is blended from them. Otherwise, and by the other methods, only the images of cameras
    /// with a ground-truth image are interpolated.
    fn synchronize(&self, instant: &TrueInstant) -> Vec<SynchronizedBy> {
        let blends = instant.views.iter().any(|v| v.like.is_none());
        let cameras = self.renderer.field().capture().cameras.len();
        let one = |method: SyncMethod, camera: usize| {
            let like = instant.views.iter().any(|v| v.like == Some(camera));
            let feeds_views = blends && [TRADITIONAL, self.options.sync].contains(&method);
            if like || feeds_views {
                self.renderer.synchronized(method, camera, instant.inner_s)
            } else {
                Err("was not asked for".into())
            }
        };
        let all = |method| (method, (0..cameras).map(|camera| one(method, camera)).collect());
        self.options.methods().into_iter().map(all).collect()
    }

    /// Measures the errors of a camera's synchronized images, one image per synchronization method, against the
    /// camera's ground-truth image. Writes the images and a comparison sheet. Returns the scores, and the viewer's
    /// figure.
    fn measure_sync(
        &self,
        target: &ComparedTarget,
        synchronized: &[SynchronizedBy],
    ) -> Result<(Vec<SyncResult>, Figure), CompareError> {
        let ComparedTarget { instant, view, truth } = target;
        let capture = self.renderer.field().capture();
        let camera = view.like.unwrap_or_default();
        let id = &capture.cameras[camera].id;
        let reference = ReferenceImage::new(truth.image.clone(), self.options.pixels_per_degree);
        let mut rows = Vec::new();
        let mut images = Vec::new();
        for (method, cameras) in synchronized {
            let image = cameras[camera].as_ref().map(|s| &s.image);
            let image = self.checked(image, &truth.image);
            let file =
                image.as_ref().ok().map(|image| self.write(target, method.name(), image, None));
            let scores = |image: &Image| reference.compare(image).regions(None, &truth.moving);
            rows.push(SyncResult {
                view: self.truth.views[view.index].id.clone(),
                camera: id.clone(),
                time_s: instant.time_s,
                method: *method,
                scores: image.as_ref().ok().map(scores),
                image: file.transpose()?,
                reason: image.as_ref().err().cloned(),
            });
            images.push(image);
        }
        let true_file = self.write(target, "truth", &truth.image, None)?;
        let shown = images.iter().map(Result::as_ref).zip(&rows);
        let panels: Vec<Panel> = shown
            .map(|(image, row)| Panel {
                title: row.method.name().to_owned(),
                image,
                scores: row.scores,
            })
            .collect();
        let title = format!("{id} at {:.4} s, synchronized", instant.time_s);
        let sheets = vec![self.write_sheet(title, &view.stem, truth, &panels)?];
        let first = images.iter().find_map(|image| image.as_ref().ok());
        Ok((rows, Figure::new(&self.truth.views[view.index].id, true_file, sheets, truth, first)))
    }

    /// Returns the path of a file in the comparison's folder. Returns an error if the path contains a symbolic link.
    pub(super) fn file(&self, name: &str) -> Result<PathBuf, CompareError> {
        let failed = |source| CompareError::Write { path: self.out.join(name), source };
        beneath(self.out, name).map_err(failed)
    }

    /// Writes an image in the capture's bit depth. `coverage` marks the rendered pixels; all others become transparent.
    /// Returns the file's path relative to the comparison's folder.
    pub(super) fn write(
        &self,
        target: &ComparedTarget,
        name: &str,
        image: &Image,
        coverage: Option<&[bool]>,
    ) -> Result<String, CompareError> {
        let name = format!("images/{}/{name}.png", target.view.stem);
        let depth = self.renderer.field().capture().bit_depth();
        write_image(&self.file(&name)?, image, coverage, depth)?;
        Ok(name)
    }

    pub(super) fn write_sheet(
        &self,
        title: String,
        stem: &str,
        truth: &TrueImage,
        panels: &[Panel],
    ) -> Result<SheetFile, CompareError> {
        let heading = format!("{}: {title}", self.renderer.field().capture().name);
        let sheet = sheet(&heading, truth, panels, self.options.difference_gain);
        let file = format!("sheets/{stem}.webp");
        write_webp(&self.file(&file)?, &sheet)?;
        Ok(SheetFile { file, title })
    }

    /// Returns the image as it will be read from its file: clamped to 0..=1, and rounded to the bit depth. Returns an
    /// error if the image's size differs from the size of the ground-truth image `truth`.
    pub(super) fn checked(&self, image: Result<&Image, &String>, truth: &Image) -> ImageOrReason {
        let image = image.map_err(Clone::clone)?;
        if (image.width(), image.height()) != (truth.width(), truth.height()) {
            let [is, wanted] = [image, truth].map(|i| format!("{}×{}", i.width(), i.height()));
            return Err(format!("is {is} pixels, the truth {wanted}"));
        }
        Ok(as_written(image, truth.channels(), self.renderer.field().capture().bit_depth()))
    }
}
