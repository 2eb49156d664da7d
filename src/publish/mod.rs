//! Publication of a light field as a site: a folder for any static web server. On the site's page, the visitor's
//! graphics card renders the views.
//!
//! ```text
//! frames, depth, motion ── JPEG, quantized maps ── base64 in scripts ── page: WebGL 2, as in `scene_flow`
//! ```
//!
//! | file | what |
//! |---|---|
//! | `quality.rs` | quality settings of frames, depth and motion |
//! | `frame.rs` | a published frame: image, depth and motion |
//! | `flow.rs` | depth and motion of a frame, quantized and compressed |
//! | `measure.rs` | comparison of views from published frames with views from the capture |
//! | `scene.rs` | the description of the light field for the page |
//! | `site.rs` | the files of the folder |
//! | `page/` | the page; `shaders.js` and `renderer.js` implement splats, confidences and blending of `scene_flow` |
//!
//! The page loads nothing from outside its folder: its Content-Security-Policy forbids this. Frames are stored in
//! scripts, as base64, because browsers refuse to read other files beside a page that is opened from disk. Base64 makes
//! the frames a third larger. Most web servers compress scripts, which reverses this.
//!
//! Known limits: the page keeps the viewpoint among the cameras. A view is blended from at most eight cameras.

mod flow;
mod frame;
mod measure;
mod quality;
mod scene;
mod site;

pub use site::check_folder;

use crate::camera::Camera;
use crate::light_field::{LightField, RenderError};
use crate::options::RenderOptions;
use crate::progress::Reporter;
use crate::scene_flow::pinhole;
use base64::Engine;
use base64::engine::general_purpose::STANDARD as BASE64;
use frame::{Published, PublishedFrame};
use measure::measured;
use quality::Quality;
use rayon::prelude::*;
use site::SiteFiles;
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

/// Options of publishing a light field as a site.
#[derive(Clone, Copy, Debug)]
pub struct PublishOptions {
    /// First and last published instant, seconds on the reference camera's clock from the capture's start. `None`: the
    /// time in which all cameras have frames or, if there is none, the time of the reference camera's frames.
    pub span_s: Option<(f64, f64)>,
    /// Largest width and height of the published frames, pixels. Larger frames are halved in both directions until they
    /// fit. `None`: no limit.
    pub max_size: Option<[usize; 2]>,
    /// Largest size of all files in the site's folder together, bytes.
    pub max_bytes: u64,
}

/// Reason why a light field can't be published. Every message is one sentence.
#[derive(Debug, thiserror::Error)]
pub enum PublishError {
    #[error(transparent)]
    Render(#[from] RenderError),
    #[error("{path}: {reason}")]
    Folder { path: PathBuf, reason: String },
    #[error("{path}: can't be written ({source})")]
    Write { path: PathBuf, source: std::io::Error },
    #[error("a frame can't be encoded ({0})")]
    Encoding(String),
    #[error("no camera filmed within this span")]
    NoFrames,
    #[error("{:.1} MB can't hold {frames} frames even at the lowest quality: publish a shorter span", *.max_bytes as f64 / 1e6)]
    TooLarge { max_bytes: u64, frames: usize },
}

/// A summary of a published site.
#[derive(Clone, Debug)]
pub struct Publication {
    /// Number of cameras with published frames.
    pub cameras: usize,
    /// Number of published frames.
    pub frames: usize,
    /// Width and height of the reference camera's published frames, pixels.
    pub size: [usize; 2],
    /// First and last published instant, seconds on the reference camera's clock from the capture's start.
    pub span_s: (f64, f64),
    /// JPEG quality of the frames, 1 to 100.
    pub jpeg: u8,
    /// Side of the square blocks of pixels that share one value of depth and motion, pixels.
    pub block_px: usize,
    /// Quantization step of the disparity, pixels. The disparity is for a baseline of twice the distance between
    /// neighbouring cameras, or less in a wide array.
    pub disparity_step_px: f32,
    /// Size of all frames' images in the folder's files, encoded in base64, bytes.
    pub image_bytes: u64,
    /// Size of all frames' depth and motion in the folder's files, encoded in base64, bytes.
    pub flow_bytes: u64,
    /// Size of all files in the folder, bytes.
    pub bytes: u64,
    /// PSNR, decibels, of a few views from the published frames against the same views from the capture. The views are
    /// halfway between cameras, at instants between frames. A view without any difference has no value. Empty for a
    /// single camera.
    pub psnr_db: Vec<f64>,
}

/// Publishes a light field, with depth and motion of its frames, as a site in `folder`. If depth and motion aren't
/// stored on disk yet, they are computed and stored.
///
/// # Errors
/// If `folder` contains anything but an earlier site, if the scene's range of depths is unknown, or if the site is
/// larger than `max_bytes` at every quality setting.
pub fn publish(
    field: &LightField,
    options: &RenderOptions,
    wanted: &PublishOptions,
    folder: &Path,
    reporter: &Reporter,
) -> Result<Publication, PublishError> {
    check_folder(folder)?;
    let reference = field.capture().reference;
    let span_s =
        wanted.span_s.or_else(|| field.common_span_s()).or_else(|| field.span_s(reference));
    let span_s = span_s.ok_or(RenderError::NoClock)?;
    let ids = field.frames_within(span_s);
    if ids.is_empty() {
        return Err(PublishError::NoFrames);
    }
    let task = reporter.task("Preparing frames", ids.len());
    field.prepare_frames(&ids, options, |done| task.set(done.min(ids.len())))?;
    drop(task);
    let encoding = Encoding { field, options, ids: &ids, span_s };
    let EncodedSite { quality, published, site } = encoding.encoded(wanted, reporter)?;
    let psnr_db = measured(field, options, &published, &quality, span_s)?;
    site.write(folder)?;
    let in_base64 = |bytes: usize| (bytes as u64 * 4).div_ceil(3);
    let first = published.iter().find(|((c, _), _)| *c == reference).or(published.iter().next());
    let size = first.map_or([0; 2], |(_, frame)| [frame.view.width, frame.view.height]);
    let cameras: BTreeSet<usize> = ids.iter().map(|id| id.0).collect();
    Ok(Publication {
        cameras: cameras.len(),
        frames: ids.len(),
        size,
        span_s,
        jpeg: quality.jpeg,
        block_px: quality.steps.block_px,
        disparity_step_px: quality.steps.disparity_px,
        image_bytes: in_base64(published.values().map(|f| f.jpeg.len()).sum()),
        flow_bytes: in_base64(published.values().map(|f| f.flow.len()).sum()),
        bytes: site.bytes(),
        psnr_db,
    })
}

/// Inputs of the encoding of a site's frames.
struct Encoding<'a> {
    field: &'a LightField,
    options: &'a RenderOptions,
    /// Identifiers of the frames to publish, as (camera index, frame index), in order of time.
    ids: &'a [(usize, usize)],
    span_s: (f64, f64),
}

/// Encoded frames and files of a site, at the best quality setting at which the site is within its size limit.
struct EncodedSite {
    quality: Quality,
    published: Published,
    site: SiteFiles,
}

/// Number of frames that are encoded at a time. The size of the whole site at a quality setting is estimated from a
/// sample of this many frames.
const FRAMES_AT_ONCE: usize = 8;

impl Encoding<'_> {
    /// Encodes all frames at the best quality setting at which the site is within its size limit.
    fn encoded(
        &self,
        wanted: &PublishOptions,
        reporter: &Reporter,
    ) -> Result<EncodedSite, PublishError> {
        let middle = self.ids.len().saturating_sub(FRAMES_AT_ONCE) / 2;
        let sample = &self.ids[middle..(middle + FRAMES_AT_ONCE).min(self.ids.len())];
        let loaded = self.field.frames_with_flow(sample, self.options)?;
        for quality in Quality::ladder(self.halvings(wanted.max_size)) {
            let sizes = loaded.par_iter().map(|l| Ok(PublishedFrame::new(l, &quality)?.bytes()));
            let sampled = sizes.sum::<Result<usize, String>>().map_err(PublishError::Encoding)?;
            let estimated = sampled as f64 * self.ids.len() as f64 / sample.len() as f64;
            if 4.0 / 3.0 * estimated > wanted.max_bytes as f64 {
                continue;
            }
            let published = self.published(&quality, reporter)?;
            let files = scene::files(self.ids, &published);
            let scene = scene::scene(self.field, &files, &quality, self.span_s);
            let site = SiteFiles::new(&scene, files.iter().map(|file| base64(file)).collect());
            if site.bytes() <= wanted.max_bytes {
                return Ok(EncodedSite { quality, published, site });
            }
        }
        Err(PublishError::TooLarge { max_bytes: wanted.max_bytes, frames: self.ids.len() })
    }

    fn published(&self, quality: &Quality, reporter: &Reporter) -> Result<Published, PublishError> {
        let task = reporter.task("Encoding frames", self.ids.len());
        let mut published = Published::new();
        for ids in self.ids.chunks(FRAMES_AT_ONCE) {
            let loaded = self.field.frames_with_flow(ids, self.options)?;
            let encode =
                |(id, l): (&(usize, usize), _)| Ok((*id, PublishedFrame::new(l, quality)?));
            let encoded =
                ids.par_iter().zip(&loaded).map(encode).collect::<Result<Vec<_>, String>>();
            published.extend(encoded.map_err(PublishError::Encoding)?);
            task.set(published.len());
        }
        Ok(published)
    }

    /// Returns how many times frames must be halved in width and height, so that the frames of all cameras fit into
    /// `max_size`. `max_size` is a width and a height in pixels. Returns 0 if it is `None`.
    fn halvings(&self, max_size: Option<[usize; 2]>) -> usize {
        let Some([width, height]) = max_size else { return 0 };
        let cameras = self.field.capture().cameras.iter();
        let cameras: Vec<Camera> = cameras.map(|c| pinhole(&c.camera)).collect();
        let is_large =
            |n: usize| cameras.iter().any(|c| c.width >> n > width || c.height >> n > height);
        (0..).take_while(|&n| is_large(n)).count()
    }
}

/// Encodes the frames of one file as base64: for each frame its image, then its depth and motion.
fn base64(file: &[((usize, usize), &PublishedFrame)]) -> String {
    let parts = file.iter().flat_map(|(_, frame)| [&*frame.jpeg, &*frame.flow]);
    BASE64.encode(parts.collect::<Vec<_>>().concat())
}
