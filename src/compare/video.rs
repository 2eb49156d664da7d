//! The review video: truth, traditional LFR and ST-LFR side by side over time, and each in a file
//! of its own, without loss, for `review.blend`.

use super::results::ViewMethod;
use super::sheet::strip;
use super::{ComparedView, Renderer, TRADITIONAL};
use crate::camera::Camera;
use crate::capture::{Capture, CaptureError, Truth, TruthVideo};
use crate::interpolation::SyncMethod;
use crate::light_field::Images;
use crate::progress::Reporter;
use crate::raster::{BitDepth, read_image};
use crate::raster::{Image, ImageFileError};
use crate::video::{Codec, VideoFormat, VideoWriter};
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// Options of the review video.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct VideoOptions {
    /// Number of frames, unless the truth has a video, whose times are used.
    pub frames: usize,
    /// Frames shown a second.
    pub rate_hz: f64,
    /// The ffmpeg to encode with; not part of the options that are written.
    #[serde(skip)]
    pub ffmpeg: PathBuf,
}

impl Default for VideoOptions {
    fn default() -> Self {
        Self { frames: 48, rate_hz: 12.0, ffmpeg: "ffmpeg".into() }
    }
}

/// Why a video can't be made: one sentence.
#[derive(Debug, thiserror::Error)]
pub enum ReviewVideoError {
    #[error(transparent)]
    File(#[from] crate::video::VideoError),
    #[error("video.{field} is {value}, must be {wanted}")]
    Option { field: &'static str, value: f64, wanted: &'static str },
    #[error("truth/truth.json: video.{reason}")]
    Field { reason: String },
    #[error("there is no time at which all cameras can give an image, so there is no video")]
    NoSpan,
    #[error(transparent)]
    Capture(#[from] CaptureError),
    #[error(transparent)]
    Image(#[from] ImageFileError),
}

/// Encoder of the video for browsers.
pub struct Encoder {
    pub ffmpeg: PathBuf,
    pub codec: Codec,
}

/// Content of the video: viewpoint, times and methods.
pub struct VideoPlan<'a> {
    renderer: &'a dyn Renderer,
    /// The sync method of ST-LFR.
    sync: SyncMethod,
    shots: Shots,
    rate_hz: f64,
}

/// One view at several times.
struct Shots {
    target: Camera,
    /// Seconds from the capture's start.
    times_s: Vec<f64>,
    /// One true image for each time, or none.
    truth: Vec<PathBuf>,
    view: String,
}

impl<'a> VideoPlan<'a> {
    /// The truth's video if it has one; else its first new view, or the reference camera's place,
    /// over the span that all cameras cover.
    pub fn new(
        renderer: &'a dyn Renderer,
        sync: SyncMethod,
        truth: Option<&Truth>,
        options: &VideoOptions,
    ) -> Result<Self, ReviewVideoError> {
        let rate_hz = options.rate_hz;
        if !(rate_hz.is_finite() && rate_hz > 0.0) {
            let wanted = "positive";
            return Err(ReviewVideoError::Option { field: "rate_hz", value: rate_hz, wanted });
        }
        if options.frames == 0 {
            return Err(ReviewVideoError::Option {
                field: "frames",
                value: 0.0,
                wanted: "1 or more",
            });
        }
        let shots = match truth.and_then(|t| Some((t, t.video.as_ref()?))) {
            Some((truth, video)) => Shots::of_truth(renderer.capture(), truth, video)?,
            None => Shots::spanning(renderer, truth, options.frames)?,
        };
        Ok(Self { renderer, sync, shots, rate_hz })
    }

    /// Renders, and encodes into the folder `out`. Views go through the most accurate proxy.
    pub fn write(
        &self,
        encoder: &Encoder,
        out: &Path,
        reporter: &Reporter,
    ) -> Result<Written, ReviewVideoError> {
        let path = out.join("review").with_extension(encoder.codec.suffix());
        let create = |path: &Path, like: &Image, depth, codec| {
            let format = VideoFormat { depth, rate_hz: self.rate_hz, codec };
            VideoWriter::create(&encoder.ffmpeg, path, like, format)
        };
        let count = self.shots.times_s.len();
        let task = reporter.task("Review video", count);
        let mut writers: Vec<(Movie, VideoWriter)> = Vec::new();
        let mut side_by_side: Option<VideoWriter> = None;
        for k in 0..count {
            let panels = self.panels(k)?;
            let strip = self.strip(k, &panels);
            if k == 0 {
                for panel in &panels {
                    let file = format!("video/{}.mkv", panel.slug);
                    let depth = self.renderer.capture().bit_depth();
                    let writer = create(&out.join(&file), &panel.image, depth, Codec::Ffv1)?;
                    writers.push((Movie { slug: panel.slug, file }, writer));
                }
                side_by_side = Some(create(&path, &strip, BitDepth::Eight, encoder.codec)?);
            }
            for ((_, writer), panel) in writers.iter_mut().zip(&panels) {
                writer.push(&panel.image)?;
            }
            if let Some(writer) = &mut side_by_side {
                writer.push(&strip)?;
            }
            task.advance(1);
        }
        let mut movies = Vec::new();
        for (movie, writer) in writers {
            writer.finish()?;
            movies.push(movie);
        }
        side_by_side.map_or(Ok(()), VideoWriter::finish)?;
        let size_px = (self.shots.target.width, self.shots.target.height);
        let view = self.shots.view.clone();
        Ok(Written { path, view, size_px, frames: count, rate_hz: self.rate_hz, movies })
    }

    /// The true image, if there is one, and the methods' images at one time.
    fn panels(&self, k: usize) -> Result<Vec<VideoPanel>, ReviewVideoError> {
        let (renderer, shots) = (self.renderer, &self.shots);
        let time_s = shots.times_s[k];
        let size = (shots.target.width, shots.target.height);
        let dark = || Image::filled(size.0, size.1, 3, 0.0);
        let fits = |image: &Image| (image.width(), image.height()) == size;
        let mut panels = Vec::new();
        if let Some(path) = shots.truth.get(k) {
            let (image, _) = read_image(path)?;
            if !fits(&image) {
                let reason = format!(
                    "images: {} is {}×{} pixels, its camera {}×{}",
                    path.display(),
                    image.width(),
                    image.height(),
                    size.0,
                    size.1
                );
                return Err(ReviewVideoError::Field { reason });
            }
            panels.push(VideoPanel { slug: "truth", title: "Truth".into(), image: image.to_rgb() });
        }
        let (target, proxy) = (&shots.target, renderer.options().proxy.method);
        let shape = Images::By(self.sync);
        for (method, sync) in
            [(ViewMethod::TraditionalLfr, TRADITIONAL), (ViewMethod::StLfr, self.sync)]
        {
            let images = Images::By(sync);
            let view = renderer.view(&ComparedView { target, time_s, proxy, images, shape });
            let view = view.ok().map(|v| v.image.to_rgb()).filter(fits);
            let none = if view.is_some() { "" } else { ": no image" };
            panels.push(VideoPanel {
                slug: method.slug(),
                title: format!("{}{none}", method.title()),
                image: view.unwrap_or_else(dark),
            });
        }
        Ok(panels)
    }

    fn strip(&self, k: usize, panels: &[VideoPanel]) -> Image {
        let origin_s = self.renderer.capture().time_origin_s;
        let time_s = self.shots.times_s[k] + origin_s;
        let heading = format!("{}   {time_s:8.4} s", self.shots.view);
        let panels: Vec<(&str, &Image)> =
            panels.iter().map(|p| (p.title.as_str(), &p.image)).collect();
        strip(&heading, &panels)
    }
}

impl Shots {
    /// The times and the images of the truth's own video.
    fn of_truth(
        capture: &Capture,
        truth: &Truth,
        video: &TruthVideo,
    ) -> Result<Self, ReviewVideoError> {
        let wrong = |reason: String| ReviewVideoError::Field { reason };
        if video.times_s.is_empty() || video.times_s.iter().any(|t| !t.is_finite()) {
            return Err(wrong("times_s must hold finite times, at least one".to_owned()));
        }
        let file = |k: usize| {
            let name = numbered(&video.images, k).ok_or_else(|| {
                wrong("images is not a sequence such as video/%04d.png".to_owned())
            })?;
            Ok(truth.file(&name)?)
        };
        Ok(Self {
            target: video.camera.camera().map_err(|e| wrong(format!("camera.{e}")))?,
            times_s: video.times_s.iter().map(|t| t - capture.time_origin_s).collect(),
            truth: (0..video.times_s.len()).map(file).collect::<Result<_, ReviewVideoError>>()?,
            view: video.view.clone(),
        })
    }

    /// Times spread evenly over the span that all cameras cover, without true images.
    fn spanning(
        renderer: &dyn Renderer,
        truth: Option<&Truth>,
        frames: usize,
    ) -> Result<Self, ReviewVideoError> {
        let capture = renderer.capture();
        let (first_s, last_s) = renderer.covered_span_s().ok_or(ReviewVideoError::NoSpan)?;
        let step_s = (last_s - first_s) / frames.saturating_sub(1).max(1) as f64;
        let free = truth.and_then(|t| t.views.iter().find(|v| v.like.is_none()));
        let camera = free.and_then(|v| Some((v.camera.camera().ok()?, v.id.clone())));
        let reference = &capture.cameras[capture.reference];
        let (target, view) =
            camera.unwrap_or_else(|| (reference.camera.clone(), reference.id.clone()));
        let times_s = (0..frames).map(|k| first_s + step_s * k as f64).collect();
        Ok(Self { target, times_s, truth: Vec::new(), view })
    }
}

/// One method's image of one time.
struct VideoPanel {
    slug: &'static str,
    title: String,
    image: Image,
}

/// The files that [`VideoPlan::write`] wrote.
pub struct Written {
    /// All side by side.
    pub path: PathBuf,
    pub view: String,
    pub size_px: (usize, usize),
    pub frames: usize,
    pub rate_hz: f64,
    pub movies: Vec<Movie>,
}

/// One method over time, without loss.
pub struct Movie {
    /// `truth`, or the method's.
    pub slug: &'static str,
    /// Relative to the review's folder.
    pub file: String,
}

/// The file of a printf pattern with one `%d` or `%0Nd`.
fn numbered(pattern: &str, index: usize) -> Option<String> {
    let (before, rest) = pattern.split_once('%')?;
    let (width, after) = rest.split_once('d')?;
    let digits: usize = if width.is_empty() { 0 } else { width.parse().ok()? };
    let valid = (width.is_empty() || width.starts_with('0')) && digits <= 18;
    (valid && !after.contains('%')).then(|| format!("{before}{index:0digits$}{after}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn patterns() {
        assert_eq!(numbered("video/%04d.png", 12).unwrap(), "video/0012.png");
        assert_eq!(numbered("%d.png", 12).unwrap(), "12.png");
        for wrong in ["a.png", "%4d", "%0999d", "%04d%d", "%s"] {
            assert_eq!(numbered(wrong, 0), None, "{wrong}");
        }
    }
}
