//! Writing of rendered views into images, sequences or videos. A picture has one view, or several views side by side.

use super::CliError;
use super::display::PictureParts;
use super::files::ffmpeg_for;
use super::values::{ImageFile, ImageOutput};
use crate::capture::Capture;
use crate::host::Claim;
use crate::light_field::ImageMotion;
use crate::lumigraph::{DepthMap, Rendered};
use crate::progress::Reporter;
use crate::raster::{
    BitDepth, Displacements, ExrLayers, Quantized, StillFormat, write_exr, write_still,
};
use crate::video::{Codec, VideoFormat, VideoWriter};
use std::panic::resume_unwind;
use std::path::PathBuf;
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::thread::JoinHandle;

/// Largest number of rendered views that wait to be written. A larger number takes more memory. With a smaller number,
/// rendering stalls when a file takes long to write.
const WAITING_VIEWS: usize = 2;

/// Fraction of a view's pixels that at least one camera should see. If any view is below this fraction, a note to the
/// user states the smallest fraction of all views.
const MIN_SEEN_FRACTION: f64 = 0.5;

/// A rendered view that is to be written.
pub struct RenderedView {
    /// Index of the picture that contains the view.
    pub frame: usize,
    /// Index of the view inside its picture.
    pub part: usize,
    pub rendered: Rendered,
    /// Depth of the pixels, and their motion if it is known; `None` if the output format has no such layers.
    pub layers: Option<(DepthMap, Option<ImageMotion>)>,
    /// Claim with which the picture is marked as done for other processes. Only the last view of a picture has one, and
    /// only if the sequence is divided among several processes.
    pub claim: Option<Claim>,
}

/// Writer of rendered views into images, an image sequence or a video.
pub struct ViewWriter {
    output: ImageOutput,
    /// Positions of the views inside a picture; `None` if every picture is a single view.
    parts: Option<PictureParts>,
    /// The picture to which some views have been added, but not all; `None` if no picture has been begun.
    picture: Option<Quantized>,
    depth: BitDepth,
    rate_hz: f64,
    /// Path of ffmpeg, and codec of the video; `None` if the output isn't a video.
    encoder: Option<(PathBuf, Codec)>,
    /// The video that is being written; `None` before its first frame.
    video: Option<VideoWriter>,
    /// Fraction of a view's pixels that at least one camera sees: the smallest over all views so far.
    seen_fraction: f64,
    reporter: Reporter,
}

/// A thread that writes views while the next views are rendered. If the value is dropped before [`Self::finish`], as
/// after an error, the thread writes the views that it has received, but doesn't finish a video.
pub struct WritingThread {
    /// Channel that sends the views to the thread, and then `None` as the end mark. The field itself is `None` after
    /// the channel is closed.
    views: Option<SyncSender<Option<RenderedView>>>,
    thread: Option<JoinHandle<Result<(), CliError>>>,
}

impl WritingThread {
    /// Sends a view to the thread, which writes the view.
    ///
    /// # Errors
    /// The error of an earlier view that couldn't be written.
    pub fn add(&mut self, view: RenderedView) -> Result<(), CliError> {
        match self.views.as_ref().is_some_and(|views| views.send(Some(view)).is_ok()) {
            true => Ok(()),
            false => self.join(),
        }
    }

    /// Waits until all views are written, and the video is finished if there is one.
    pub fn finish(mut self) -> Result<(), CliError> {
        if let Some(views) = &self.views {
            // Sending fails if the thread has failed. Joining then returns the error of the thread.
            let _ = views.send(None);
        }
        self.join()
    }

    fn join(&mut self) -> Result<(), CliError> {
        self.views = None;
        match self.thread.take().map(JoinHandle::join) {
            None => Ok(()),
            Some(Ok(result)) => result,
            Some(Err(panic)) => resume_unwind(panic),
        }
    }
}

impl Drop for WritingThread {
    fn drop(&mut self) {
        self.views = None;
        // After an error, the caller reports this error, and the result of the thread is ignored.
        let _ = self.thread.take().map(JoinHandle::join);
    }
}

impl ViewWriter {
    /// Creates a writer of pictures with one view. For a video, finds an encoder and tests it.
    pub fn new(
        output: &ImageOutput,
        capture: &Capture,
        rate_hz: f64,
        reporter: &Reporter,
    ) -> Result<Self, CliError> {
        let (encoder, is_deep) = match output {
            ImageOutput::Video(_, codec) => {
                let ffmpeg = ffmpeg_for("a video")?;
                codec.require(&ffmpeg)?;
                (Some((ffmpeg, *codec)), codec.is_deep())
            }
            _ => (None, output.image_file() != Some(ImageFile::Still(StillFormat::Jpeg))),
        };
        let depth = if is_deep { capture.bit_depth() } else { BitDepth::Eight };
        Ok(Self {
            output: output.clone(),
            parts: None,
            picture: None,
            depth,
            rate_hz,
            encoder,
            video: None,
            seen_fraction: 1.0,
            reporter: *reporter,
        })
    }

    /// Starts the thread that writes the views. `parts` are the positions of the views inside a picture; `None` for
    /// pictures of one view.
    pub fn start(self, parts: Option<PictureParts>) -> WritingThread {
        let (views, received) = sync_channel(WAITING_VIEWS);
        let writer = Self { parts, ..self };
        // The thread that starts ffmpeg must also finish the video, because ffmpeg ends with this thread.
        let thread = std::thread::spawn(move || writer.write_all(&received));
        WritingThread { views: Some(views), thread: Some(thread) }
    }

    fn write_all(mut self, views: &Receiver<Option<RenderedView>>) -> Result<(), CliError> {
        while let Ok(view) = views.recv() {
            let Some(view) = view else { return self.finish() };
            self.add(&view)?;
            view.claim.map_or(Ok(()), Claim::finish)?;
        }
        Ok(())
    }

    fn finish(self) -> Result<(), CliError> {
        if self.seen_fraction < MIN_SEEN_FRACTION {
            self.reporter.note(&format!(
                "Cameras see only {:.0} % of the view; stlfr info prints one that they see.",
                100.0 * self.seen_fraction
            ));
        }
        self.video.map_or(Ok(()), |video| Ok(video.finish()?))
    }

    /// Adds a view to the picture that contains it. Writes the picture when its last view has been added.
    fn add(&mut self, view: &RenderedView) -> Result<(), CliError> {
        let Rendered { image, coverage } = &view.rendered;
        let seen = coverage.iter().filter(|is_seen| **is_seen).count();
        self.seen_fraction = self.seen_fraction.min(seen as f64 / coverage.len() as f64);
        if let Some((depths, motion)) = &view.layers {
            let depths_m = depths.data();
            let motion = motion.as_ref().map(|m| move |k: usize| m.displacements(k, depths_m[k]));
            let motion = motion.as_ref().map(|m| m as &Displacements);
            let path = self.output.file(view.frame).unwrap_or_default();
            return Ok(write_exr(&path, &ExrLayers { image, coverage, depths_m, motion })?);
        }
        let coverage = coverage.contains(&false).then_some(coverage.as_slice());
        let blank = |size_px| Quantized::blank(size_px, image.channels(), self.depth);
        let Some(PictureParts { size_px, origins }) = &self.parts else {
            let is_opaque = coverage.is_none() || self.has_alpha();
            let picture = if is_opaque {
                Quantized::new(image, coverage, self.depth)
            } else {
                let mut picture = blank([image.width(), image.height()]);
                picture.place(image, coverage, [0, 0]);
                picture
            };
            return self.write(view.frame, &picture);
        };
        let mut picture = self.picture.take().unwrap_or_else(|| blank(*size_px));
        picture.place(image, coverage, origins[view.part]);
        if view.part + 1 == origins.len() {
            return self.write(view.frame, &picture);
        }
        self.picture = Some(picture);
        Ok(())
    }

    /// Returns whether the output is an image format with an alpha channel, which marks pixels that no camera sees.
    fn has_alpha(&self) -> bool {
        matches!(self.output.image_file(), Some(ImageFile::Still(format)) if format.is_lossless())
    }

    fn write(&mut self, frame: usize, picture: &Quantized) -> Result<(), CliError> {
        let path = self.output.file(frame).unwrap_or_default();
        if let Some(ImageFile::Still(format)) = self.output.image_file() {
            return Ok(write_still(&path, picture, format)?);
        }
        let video = match (&mut self.video, &self.encoder) {
            (Some(video), _) => video,
            (video, Some((ffmpeg, codec))) => {
                let format =
                    VideoFormat { depth: self.depth, rate_hz: self.rate_hz, codec: *codec };
                let size = (picture.width, picture.height, picture.channels);
                video.insert(VideoWriter::sized(ffmpeg, &path, size, format)?)
            }
            (None, None) => return Ok(()),
        };
        Ok(video.push_quantized(picture)?)
    }
}
