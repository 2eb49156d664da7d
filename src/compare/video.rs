//! The review video: ground-truth images, traditional light field rendering and space-time light field rendering side
//! by side over time. For `review.blend`, each of the three is also written as a separate lossless video.

use super::instant::Comparison;
use super::results::ViewMethod;
use super::sheet::strip;
use super::{ComparedView, TRADITIONAL};
use crate::camera::Camera;
use crate::capture::{CaptureError, TruthVideo};
use crate::host::beneath;
use crate::light_field::Images;
use crate::method::Method;
use crate::progress::Reporter;
use crate::raster::{BitDepth, Image, ImageFileError, read_image};
use crate::video::{Codec, VideoError, VideoFormat, VideoWriter};
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// Options of the review video.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct VideoOptions {
    /// Number of frames. It is ignored if the ground truth has a video, whose times are then used.
    pub frames: usize,
    /// Frame rate at which the review video is shown, hertz.
    pub rate_hz: f64,
    /// Path of the ffmpeg program that encodes the videos. It is not written into the results.
    #[serde(skip)]
    pub ffmpeg: PathBuf,
}

impl Default for VideoOptions {
    fn default() -> Self {
        Self { frames: 48, rate_hz: 12.0, ffmpeg: "ffmpeg".into() }
    }
}

/// Reason why the review video can't be made. The message is one sentence.
#[derive(Debug, thiserror::Error)]
pub enum ReviewVideoError {
    #[error(transparent)]
    File(#[from] crate::video::VideoError),
    #[error("truth/truth.json: video.{0}")]
    Field(String),
    #[error("there is no time at which all cameras can give an image, so there is no video")]
    NoSpan,
    #[error(transparent)]
    Capture(#[from] CaptureError),
    #[error(transparent)]
    Image(#[from] ImageFileError),
}

/// The files of a review video.
pub(super) struct ReviewVideo {
    /// Path of the side-by-side video.
    pub path: PathBuf,
    /// Id of the view that the videos show.
    pub view: String,
    pub frames: usize,
    pub rate_hz: f64,
    /// Lossless videos of the ground-truth images and of each method. Each entry is a name (`truth` or the method's
    /// name) and a path relative to the comparison's folder.
    pub movies: Vec<(&'static str, String)>,
}

impl ReviewVideo {
    /// Renders and writes the videos. They show the view and the times of the video in the ground truth. If the ground
    /// truth has no video, the times cover the span in which an image of every camera can be interpolated. The view is
    /// then the first view of the ground truth whose pose is not that of a camera, or else the reference camera's view.
    ///
    /// The proxy geometry is the one in the renderer's options. `codec` encodes the side-by-side video.
    pub fn write(
        comparison: &Comparison,
        codec: Codec,
        reporter: &Reporter,
    ) -> Result<Self, ReviewVideoError> {
        let options = comparison.options.video.clone().unwrap_or_default();
        let shots = match &comparison.truth.video {
            Some(video) => VideoInstants::of_truth(comparison, video)?,
            None => VideoInstants::spanning(comparison, options.frames)?,
        };
        let Comparison { renderer, out, .. } = comparison;
        let path = out.join("review").with_extension(codec.suffix());
        let create = |path: &Path, like: &Image, depth, codec| {
            let format = VideoFormat { depth, rate_hz: options.rate_hz, codec };
            VideoWriter::create(&options.ffmpeg, path, like, format)
        };
        let frames = shots.times_s.len();
        let task = reporter.task("Review video", frames);
        let (mut movies, mut writers) = (Vec::new(), Vec::new());
        for k in 0..frames {
            let panels = shots.panels(comparison, k)?;
            let origin_s = renderer.field().capture().time_origin_s;
            let heading = format!("{}   {:8.4} s", shots.view, shots.times_s[k] + origin_s);
            let titled: Vec<(&str, &Image)> =
                panels.iter().map(|p| (p.title.as_str(), &p.image)).collect();
            let strip = strip(&heading, &titled);
            if k == 0 {
                for panel in &panels {
                    let file = format!("video/{}.mkv", panel.name);
                    let depth = renderer.field().capture().bit_depth();
                    let failed = |source| VideoError::File { path: out.join(&file), source };
                    let movie = beneath(out, &file).map_err(failed)?;
                    writers.push(create(&movie, &panel.image, depth, Codec::Ffv1)?);
                    movies.push((panel.name, file));
                }
                writers.push(create(&path, &strip, BitDepth::Eight, codec)?);
            }
            let images = panels.iter().map(|panel| &panel.image).chain([&strip]);
            for (writer, image) in writers.iter_mut().zip(images) {
                writer.push(image)?;
            }
            task.advance(1);
        }
        writers.into_iter().try_for_each(VideoWriter::finish)?;
        Ok(Self { path, view: shots.view, frames, rate_hz: options.rate_hz, movies })
    }
}

/// A view at several times, with its ground-truth images, if there are any.
struct VideoInstants {
    target: Camera,
    /// Times from the capture's start, in seconds on the reference camera's clock.
    times_s: Vec<f64>,
    /// Files of the ground-truth images, one per time. Empty if there are none.
    truth: Vec<PathBuf>,
    view: String,
}

impl VideoInstants {
    /// Takes the view, the times and the images from the video in the ground truth.
    fn of_truth(comparison: &Comparison, video: &TruthVideo) -> Result<Self, ReviewVideoError> {
        let wrong = |reason: &str| ReviewVideoError::Field(reason.to_owned());
        if video.times_s.is_empty() || video.times_s.iter().any(|t| !t.is_finite()) {
            return Err(wrong("times_s must hold finite times, at least one"));
        }
        let file = |k: usize| {
            let name = numbered(&video.images, k)
                .ok_or_else(|| wrong("images is not a sequence such as video/%04d.png"))?;
            Ok(comparison.truth.file(&name)?)
        };
        let origin_s = comparison.renderer.field().capture().time_origin_s;
        Ok(Self {
            target: video.camera.camera().map_err(|e| wrong(&format!("camera.{e}")))?,
            times_s: video.times_s.iter().map(|t| t - origin_s).collect(),
            truth: (0..video.times_s.len()).map(file).collect::<Result<_, ReviewVideoError>>()?,
            view: video.view.clone(),
        })
    }

    /// Chooses a view, and `frames` times that are evenly spaced over the span in which an image of every camera can be
    /// interpolated. There are no ground-truth images. [`ReviewVideo::write`] describes how the view is chosen.
    fn spanning(comparison: &Comparison, frames: usize) -> Result<Self, ReviewVideoError> {
        let capture = comparison.renderer.field().capture();
        let span_s = comparison.renderer.field().common_span_s();
        let (first_s, last_s) = span_s.ok_or(ReviewVideoError::NoSpan)?;
        let step_s = (last_s - first_s) / frames.saturating_sub(1).max(1) as f64;
        let free = comparison.truth.views.iter().find(|v| v.like.is_none());
        let camera = free.and_then(|v| Some((v.camera.camera().ok()?, v.id.clone())));
        let reference = &capture.cameras[capture.reference];
        let (target, view) =
            camera.unwrap_or_else(|| (reference.camera.clone(), reference.id.clone()));
        let times_s = (0..frames).map(|k| first_s + step_s * k as f64).collect();
        Ok(Self { target, times_s, truth: Vec::new(), view })
    }

    /// Returns the images at the time with index `k`: the ground-truth image, if there is one, and one rendered image
    /// per method.
    fn panels(
        &self,
        comparison: &Comparison,
        k: usize,
    ) -> Result<Vec<VideoPanel>, ReviewVideoError> {
        let (width, height) = (self.target.width, self.target.height);
        let fits = |image: &Image| (image.width(), image.height()) == (width, height);
        let mut panels = Vec::new();
        if let Some(path) = self.truth.get(k) {
            let (image, _) = read_image(path)?;
            if !fits(&image) {
                let (path, w, h) = (path.display(), image.width(), image.height());
                return Err(ReviewVideoError::Field(format!(
                    "images: {path} is {w}×{h} pixels, its camera {width}×{height}"
                )));
            }
            panels.push(VideoPanel { name: "truth", title: "Truth".into(), image: image.to_rgb() });
        }
        let (renderer, sync) = (comparison.renderer, comparison.options.sync);
        let proxy = renderer.options().proxy.method;
        let (target, time_s, shape) = (&self.target, self.times_s[k], Images::By(sync));
        for (method, sync) in [(ViewMethod::TraditionalLfr, TRADITIONAL), (ViewMethod::StLfr, sync)]
        {
            let images = Images::By(sync);
            let view = renderer.view(&ComparedView { target, time_s, proxy, images, shape });
            let view = view.ok().map(|v| v.image.to_rgb()).filter(fits);
            let none = if view.is_some() { "" } else { ": no image" };
            panels.push(VideoPanel {
                name: method.name(),
                title: format!("{}{none}", method.help()),
                image: view.unwrap_or_else(|| Image::filled(width, height, 3, 0.0)),
            });
        }
        Ok(panels)
    }
}

/// An image of the review video at one time: the ground-truth image, or the image of a method.
struct VideoPanel {
    name: &'static str,
    title: String,
    image: Image,
}

/// Returns the name of the `index`-th file of a printf pattern with one `%d` or `%0Nd`. `None` for any other pattern.
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
