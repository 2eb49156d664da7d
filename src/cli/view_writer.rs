//! Writes finished views: images, sequences, videos; each of one view, or of several beside each other.

use super::CliError;
use super::display::PictureParts;
use super::files::ffmpeg_for;
use super::values::{ImageFile, ImageOutput};
use crate::capture::Capture;
use crate::host::Claim;
use crate::lumigraph::{DepthMap, Rendered};
use crate::progress::Reporter;
use crate::raster::{BitDepth, Quantized, StillFormat, write_exr, write_still};
use crate::video::{Codec, VideoFormat, VideoWriter};
use std::panic::resume_unwind;
use std::path::PathBuf;
use std::sync::mpsc::sync_channel;

/// Finished views that may wait to be written. More: memory; fewer: rendering waits for a file that takes longer
/// than others.
const WAITING_VIEWS: usize = 2;

/// Fraction of a view's pixels that cameras must see, or else a note says how few they see.
const MIN_SEEN_FRACTION: f64 = 0.5;

/// A finished view.
pub struct View {
    /// Index of its picture.
    pub frame: usize,
    /// Its place among the picture's views.
    pub part: usize,
    pub rendered: Rendered,
    /// Its depths, where the output has them.
    pub depths: Option<DepthMap>,
    /// What says that the picture is done, with its last view.
    pub claim: Option<Claim>,
}

/// Where finished views go.
pub struct ViewWriter<'a> {
    output: &'a ImageOutput,
    /// Where the views of a picture are; `None` for one view a picture.
    pub parts: Option<PictureParts>,
    /// The picture whose views are not all there yet.
    picture: Option<Quantized>,
    depth: BitDepth,
    rate_hz: f64,
    /// ffmpeg and the codec; `None` if the output is no video.
    encoder: Option<(PathBuf, Codec)>,
    /// The video, from its first frame on.
    video: Option<VideoWriter>,
    /// The smallest fraction of a view's pixels that cameras see.
    seen_fraction: f64,
    reporter: &'a Reporter,
}

impl<'a> ViewWriter<'a> {
    /// A writer of single views. For a video, an encoder is found and tried.
    pub fn new(
        output: &'a ImageOutput,
        capture: &Capture,
        rate_hz: f64,
        reporter: &'a Reporter,
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
            output,
            parts: None,
            picture: None,
            depth,
            rate_hz,
            encoder,
            video: None,
            seen_fraction: 1.0,
            reporter,
        })
    }

    /// Writes views while the next ones are rendered. Views before an error are written, but no video is finished then.
    pub fn write_all(
        mut self,
        views: impl Iterator<Item = Result<View, CliError>>,
    ) -> Result<(), CliError> {
        let (send, received) = sync_channel(WAITING_VIEWS);
        std::thread::scope(|scope| {
            // ffmpeg ends with the thread that started it, which therefore finishes the video.
            let writing = scope.spawn(move || {
                for view in received {
                    let view: View = view?;
                    self.add(&view)?;
                    view.claim.map_or(Ok(()), Claim::finish)?;
                }
                if self.seen_fraction < MIN_SEEN_FRACTION {
                    self.reporter.note(&format!(
                        "Cameras see only {:.0} % of the view; stlfr info prints one that they see.",
                        100.0 * self.seen_fraction
                    ));
                }
                self.video.map_or(Ok(()), |video| Ok(video.finish()?))
            });
            for view in views {
                let failed = view.is_err();
                // Without a receiver, writing has failed, and says why.
                if send.send(view).is_err() || failed {
                    break;
                }
            }
            drop(send);
            writing.join().unwrap_or_else(|panic| resume_unwind(panic))
        })
    }

    /// Adds a view to its picture, and writes the picture if it is whole.
    fn add(&mut self, view: &View) -> Result<(), CliError> {
        let Rendered { image, coverage } = &view.rendered;
        let seen = coverage.iter().filter(|is_seen| **is_seen).count();
        self.seen_fraction = self.seen_fraction.min(seen as f64 / coverage.len() as f64);
        if let Some(depths) = &view.depths {
            let path = self.output.file(view.frame).unwrap_or_default();
            return Ok(write_exr(&path, image, coverage, depths.data())?);
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

    /// Whether files tell which pixels no camera sees.
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
