//! The review video: truth, traditional LFR and ST-LFR side by side over time.
//!
//! The file has a temporary name until it is whole.

pub use super::encoder::Encoder;
use super::results::Method;
use super::sheet::strip;
use super::{NEAREST, Renderer};
use crate::camera::Camera;
use crate::capture::{Truth, TruthError, read_image};
use crate::progress::Reporter;
use crate::raster::Image;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// What video is made.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct VideoOptions {
    /// Frames, where the truth has no video whose times are taken.
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

/// Why there is no video. Every message is one sentence.
#[derive(Debug, thiserror::Error)]
pub enum VideoError {
    #[error("{program}: {source}")]
    Start { program: PathBuf, source: std::io::Error },
    #[error("{program} could not write {path}: {reason}")]
    Encode { program: PathBuf, path: PathBuf, reason: String },
    #[error("{path}: {source}")]
    Write { path: PathBuf, source: std::io::Error },
    #[error("video.{field} is {value}, must be {wanted}")]
    Option { field: &'static str, value: f64, wanted: &'static str },
    #[error("truth/truth.json: video.{reason}")]
    Field { reason: String },
    #[error("there is no time at which all cameras can give an image, so there is no video")]
    NoSpan,
    #[error(transparent)]
    Truth(#[from] TruthError),
    #[error(transparent)]
    Capture(#[from] crate::capture::CaptureError),
}

/// What is shown, and when.
pub struct Plan {
    target: Camera,
    /// Seconds from the capture's start.
    times_s: Vec<f64>,
    /// The times as the reader knows them minus `times_s`.
    origin_s: f64,
    /// One true image a time, or none at all.
    truth: Vec<PathBuf>,
    view: String,
    rate_hz: f64,
}

impl Plan {
    /// The truth's video if it has one; else its first new view, or the reference camera's place,
    /// over the span that all cameras cover.
    pub fn new(
        renderer: &dyn Renderer,
        truth: Option<&Truth>,
        options: &VideoOptions,
    ) -> Result<Self, VideoError> {
        let (rate_hz, frames) = (options.rate_hz, options.frames);
        if !(rate_hz.is_finite() && rate_hz > 0.0) {
            return Err(VideoError::Option {
                field: "rate_hz",
                value: rate_hz,
                wanted: "positive",
            });
        }
        if frames == 0 {
            return Err(VideoError::Option { field: "frames", value: 0.0, wanted: "1 or more" });
        }
        let capture = renderer.capture();
        let origin_s = capture.time_origin_s;
        if let Some((truth, video)) = truth.and_then(|t| Some((t, t.video.as_ref()?))) {
            if video.times_s.is_empty() || video.times_s.iter().any(|t| !t.is_finite()) {
                let reason = "times_s must hold finite times, at least one".to_owned();
                return Err(VideoError::Field { reason });
            }
            let files = (0..video.times_s.len())
                .map(|k| {
                    let name = numbered(&video.images, k).ok_or_else(|| VideoError::Field {
                        reason: "images is not a sequence such as video/%04d.png".into(),
                    })?;
                    Ok(truth.file(&name)?)
                })
                .collect::<Result<_, VideoError>>()?;
            return Ok(Self {
                target: video
                    .camera
                    .camera()
                    .map_err(|e| VideoError::Field { reason: format!("camera.{e}") })?,
                times_s: video.times_s.iter().map(|t| t - origin_s).collect(),
                origin_s,
                truth: files,
                view: video.view.clone(),
                rate_hz,
            });
        }
        let (first_s, last_s) = renderer.covered_span_s().ok_or(VideoError::NoSpan)?;
        let step_s = (last_s - first_s) / frames.saturating_sub(1).max(1) as f64;
        let free = truth.and_then(|t| t.views.iter().find(|v| v.like.is_none()));
        let camera = free.and_then(|v| Some((v.camera().ok()?, v.id.clone())));
        let reference = &capture.cameras[capture.reference];
        let (target, view) =
            camera.unwrap_or_else(|| (reference.camera.clone(), reference.id.clone()));
        Ok(Self {
            target,
            times_s: (0..frames).map(|k| first_s + step_s * k as f64).collect(),
            origin_s,
            truth: Vec::new(),
            view,
            rate_hz,
        })
    }

    /// Renders and encodes; `stem` is the file without its suffix, which the encoder decides.
    /// Views go through the best proxy, the renderer's last.
    pub fn write(
        &self,
        renderer: &dyn Renderer,
        sync: &str,
        encoder: &Encoder,
        stem: &Path,
        reporter: &Reporter,
    ) -> Result<PathBuf, VideoError> {
        let path = stem.with_extension(encoder.suffix());
        let failed = |source| VideoError::Write { path: path.clone(), source };
        let folder = path.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
        std::fs::create_dir_all(folder).map_err(failed)?;
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        let temporary = folder.join(format!(".{name}.{}.tmp", std::process::id()));
        let result = self.encode(renderer, sync, encoder, &temporary, reporter);
        match result.and_then(|()| std::fs::rename(&temporary, &path).map_err(failed)) {
            Ok(()) => Ok(path),
            Err(error) => {
                let _ = std::fs::remove_file(&temporary);
                Err(error)
            }
        }
    }

    fn encode(
        &self,
        renderer: &dyn Renderer,
        sync: &str,
        encoder: &Encoder,
        path: &Path,
        reporter: &Reporter,
    ) -> Result<(), VideoError> {
        let task = reporter.task("Review video", self.times_s.len());
        let first = self.frame(renderer, sync, 0)?;
        let mut encoding = encoder.start((first.width(), first.height()), self.rate_hz, path)?;
        let mut fed = encoding.feed(&first);
        task.advance(1);
        for k in 1..self.times_s.len() {
            if !fed {
                break;
            }
            fed = encoding.feed(&self.frame(renderer, sync, k)?);
            task.advance(1);
        }
        encoding.finish()
    }

    fn frame(&self, renderer: &dyn Renderer, sync: &str, k: usize) -> Result<Image, VideoError> {
        let time_s = self.times_s[k];
        let size = (self.target.width, self.target.height);
        let dark = || Image::filled(size.0, size.1, 3, 0.0);
        let fits = |image: &Image| (image.width(), image.height()) == size;
        let mut panels: Vec<(String, Image)> = Vec::new();
        if let Some(path) = self.truth.get(k) {
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
                return Err(VideoError::Field { reason });
            }
            panels.push(("Truth".into(), image));
        }
        for (method, rung) in [(Method::TraditionalLfr, NEAREST), (Method::StLfr, sync)] {
            let cameras = renderer.capture().cameras.len();
            let images: Vec<Option<Image>> =
                (0..cameras).map(|c| renderer.synchronized(rung, c, time_s).ok()).collect();
            let proxy = renderer.proxies().len().saturating_sub(1);
            let view = renderer.view(&images, proxy, &self.target, time_s);
            let view = view.ok().map(|v| v.image).filter(fits);
            let none = if view.is_some() { "" } else { ": no image" };
            panels.push((format!("{}{none}", method.title()), view.unwrap_or_else(dark)));
        }
        let heading = format!("{}   {:8.4} s", self.view, time_s + self.origin_s);
        let panels: Vec<(&str, &Image)> = panels.iter().map(|(t, i)| (t.as_str(), i)).collect();
        Ok(strip(&heading, &panels))
    }
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

    #[test]
    fn a_missing_ffmpeg_is_one_sentence() {
        let options = VideoOptions { ffmpeg: "/no/such/ffmpeg".into(), ..Default::default() };
        let message = Encoder::find(&options).err().unwrap().to_string();
        assert!(message.starts_with("/no/such/ffmpeg: ") && !message.contains('\n'));
    }
}
