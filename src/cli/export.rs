//! The command `stlfr export`, which writes a capture for other programs.

use super::CliError;
use super::files::{CommandOutput, OptionsArgs, ffmpeg_for, open_capture};
use super::values::Times;
use crate::camera::Camera;
use crate::capture::Capture;
use crate::exchange::{self, Dataset, DatasetFormat, NamedCamera, Undistortion};
use crate::light_field::{Context, LightField};
use crate::pipeline;
use crate::progress::Reporter;
use std::path::PathBuf;
use std::sync::Arc;

/// Write a capture's calibration for another program, optionally with synchronized images or with the filmed frames.
///
/// Without --synchronized and --frames, only the calibration is written. --synchronized renders every camera's image at
/// common instants, to train Gaussian splatting or NeRF. --frames writes the frames as filmed, with their times on the
/// reference camera's clock.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  \
    stlfr export .captures/demo --format colmap -o sparse/0\n  \
    stlfr export .captures/demo --format llff --near 1 --far 6 -o poses_bounds.npy\n  \
    stlfr export .captures/demo --format colmap --synchronized --undistort -o train\n  \
    stlfr export .captures/demo --format nerf --synchronized --times 0.1:0.3:13 -o train\n  \
    stlfr export .captures/demo --format colmap --frames -o colmap4d\n\n\
    In a folder: images/ and sparse/0 (colmap, with colmap4d's times), images/ and transforms.json (nerf),\n\
    cam00.mp4 and so on without loss, and poses_bounds.npy (llff).")]
pub struct ExportArgs {
    /// The capture's folder.
    capture: PathBuf,
    #[arg(long)]
    format: Format,
    /// Render all cameras' images at common instants.
    #[arg(long, conflicts_with = "frames")]
    synchronized: bool,
    /// Write the filmed frames with their times.
    #[arg(long)]
    frames: bool,
    /// N evenly spaced instants from START to END [default: the reference camera's frame times at which all cameras
    /// film].
    #[arg(long, value_name = "START:END:N", allow_hyphen_values = true, requires = "synchronized")]
    times: Option<Times>,
    /// Undistort the images. The cameras become pinhole cameras with the same focal lengths.
    #[arg(long)]
    undistort: bool,
    /// Nearest depth of the scene, in metres (llff only).
    #[arg(long, value_name = "METRES", required_if_eq("format", "llff"))]
    near: Option<f64>,
    /// Farthest depth of the scene, in metres (llff only).
    #[arg(long, value_name = "METRES", required_if_eq("format", "llff"))]
    far: Option<f64>,
    #[command(flatten)]
    options: OptionsArgs,
    /// The folder for COLMAP's files or for images, or the file of another format.
    #[arg(short, long, value_name = "PATH")]
    output: PathBuf,
}

#[derive(Clone, Copy, Debug, PartialEq, clap::ValueEnum)]
enum Format {
    /// COLMAP's model as binary files.
    Colmap,
    /// COLMAP's model as text files.
    ColmapText,
    /// LLFF's poses_bounds.npy; the cameras are in the order of the numbers in their ids.
    Llff,
    /// NeRF's transforms.json.
    Nerf,
}

pub fn run(args: &ExportArgs, reporter: &Reporter) -> Result<(), CliError> {
    let bounds_m = (args.near.unwrap_or(0.0), args.far.unwrap_or(0.0));
    if args.format == Format::Llff
        && !(bounds_m.0 > 0.0 && bounds_m.1 > bounds_m.0 && bounds_m.1.is_finite())
    {
        return Err(CliError::BadInput("--near must be positive and --far larger".into()));
    }
    if args.synchronized || args.frames {
        return run_dataset(args, bounds_m, reporter);
    }
    if args.undistort {
        let sentence = "--undistort is of images: give --synchronized or --frames";
        return Err(CliError::BadInput(sentence.into()));
    }
    let output = &args.output;
    let written = match args.format {
        Format::Colmap => CommandOutput::Folder(output, &exchange::COLMAP_BINARY_FILES),
        Format::ColmapText => CommandOutput::Folder(output, &exchange::COLMAP_TEXT_FILES),
        Format::Llff | Format::Nerf => CommandOutput::File(output),
    };
    let capture = open_capture(&args.capture, Some(written), reporter)?;
    let named = |c: &crate::capture::FilmedCamera| NamedCamera {
        name: format!("{}/0000.png", c.id),
        time_ns: None,
        camera: c.camera.clone(),
    };
    let cameras: Vec<NamedCamera> = capture.cameras.iter().map(named).collect();
    match args.format {
        Format::Colmap => exchange::write_colmap_binary(output, &cameras)?,
        Format::ColmapText => exchange::write_colmap_text(output, &cameras)?,
        Format::Llff => exchange::write_llff(output, &cameras, bounds_m)?,
        Format::Nerf => exchange::write_nerf(output, &cameras)?,
    }
    Ok(())
}

/// Writes a dataset, which is a folder of images with their calibration.
fn run_dataset(
    args: &ExportArgs,
    bounds_m: (f64, f64),
    reporter: &Reporter,
) -> Result<(), CliError> {
    let wrong = |sentence: &str| Err(CliError::BadInput(sentence.into()));
    match args.format {
        Format::ColmapText => return wrong("images come with --format colmap"),
        Format::Llff if args.frames => return wrong("llff has no times: give --synchronized"),
        _ => {}
    }
    let options = args.options.read()?;
    let capture = open_capture(
        &args.capture,
        Some(CommandOutput::Folder(&args.output, &["images/", "sparse/"])),
        reporter,
    )?;
    let field = pipeline::open_field(capture.clone(), &options, reporter)?;
    let options = pipeline::resolved(&field, &options, reporter)?;
    let is_known = |&c: &usize| capture.is_static() || field.span_s(c).is_some();
    let chosen: Vec<usize> = by_reference(&capture).into_iter().filter(is_known).collect();
    let instants_s = if args.frames { Vec::new() } else { instants_s(args, &field, &chosen)? };
    let format = match args.format {
        Format::Nerf => DatasetFormat::Nerf,
        Format::Llff => {
            let rate_hz = even_rate_hz(&instants_s)?;
            DatasetFormat::Llff { bounds_m, rate_hz, ffmpeg: ffmpeg_for("a video")? }
        }
        _ => DatasetFormat::Colmap { is_synchronized: args.synchronized },
    };
    let lens = |&c: &usize| {
        let is_centered = args.format == Format::Llff;
        args.undistort.then(|| Undistortion::new(&capture.cameras[c].camera, is_centered))
    };
    let lenses: Vec<Option<Undistortion>> = chosen.iter().map(lens).collect();
    let camera = |(&c, lens): (&usize, &Option<Undistortion>)| -> (String, Camera) {
        let filmed = &capture.cameras[c];
        (filmed.id.clone(), lens.as_ref().map_or(&filmed.camera, |lens| &lens.camera).clone())
    };
    let cameras = chosen.iter().zip(&lenses).map(camera).collect();
    let dataset = Dataset::create(&args.output, format, cameras)?;
    let mut writing = Writing { capture: &capture, dataset, chosen, lenses };
    if args.frames {
        writing.frames(&field, reporter)?;
    } else {
        let task = reporter.task("rendering", instants_s.len());
        for &time_s in &instants_s {
            let images = field.synchronized_all(time_s, &options, &Context::unattended())?;
            for k in 0..writing.chosen.len() {
                if let Some(image) = &images[writing.chosen[k]] {
                    writing.image(k, time_s, &image.image)?;
                }
            }
            task.advance(1);
        }
    }
    Ok(writing.dataset.finish()?)
}

/// Returns the indices of all cameras of the capture, the reference camera first. The first exported camera becomes the
/// reference sensor of COLMAP's rig.
fn by_reference(capture: &Capture) -> Vec<usize> {
    let mut cameras: Vec<usize> = (0..capture.cameras.len()).collect();
    cameras.sort_by_key(|&c| c != capture.reference);
    cameras
}

/// A dataset for another program that is being written, with the exported cameras.
struct Writing<'a> {
    capture: &'a Arc<Capture>,
    dataset: Dataset,
    chosen: Vec<usize>,
    lenses: Vec<Option<Undistortion>>,
}

impl Writing<'_> {
    /// Appends an image. `k` is the index of the image's camera in `chosen`, the exported cameras. `time_s` is the
    /// image's time in seconds from the capture's start.
    fn image(
        &mut self,
        k: usize,
        time_s: f64,
        image: &crate::raster::Image,
    ) -> Result<(), CliError> {
        let origin_ns = (1e9 * self.capture.time_origin_s).round() as i64;
        let time_ns = origin_ns.saturating_add((1e9 * time_s).round() as i64);
        let depth = self.capture.cameras[self.chosen[k]].bit_depth;
        let undistorted = self.lenses[k].as_ref().map(|lens| lens.apply(image));
        Ok(self.dataset.push(k, time_ns, undistorted.as_ref().unwrap_or(image), depth)?)
    }

    /// Appends all frames of the chosen cameras as they were filmed.
    fn frames(&mut self, field: &LightField, reporter: &Reporter) -> Result<(), CliError> {
        let times_s = field.offsets().common_times_s(self.capture);
        let frames = self.chosen.iter().map(|&c| self.capture.cameras[c].frames.len()).sum();
        let task = reporter.task("writing", frames);
        for k in 0..self.chosen.len() {
            let camera = self.chosen[k];
            for (frame, &time_s) in times_s[camera].iter().flatten().enumerate() {
                let image = self.capture.read_frame(camera, frame)?;
                self.image(k, time_s, &image)?;
                task.advance(1);
            }
        }
        Ok(())
    }
}

/// Returns the instants to render, in seconds from the capture's start. `chosen` has the indices of the exported
/// cameras. The instants are those of `--times`, or else the frame times of the first chosen camera at which all chosen
/// cameras film. An instant of `--times` at which a camera doesn't film is an error.
fn instants_s(
    args: &ExportArgs,
    field: &LightField,
    chosen: &[usize],
) -> Result<Vec<f64>, CliError> {
    let capture = field.capture();
    let Some(Times(given_s)) = &args.times else {
        let times_s = field.offsets().common_times_s(capture);
        let own = times_s[chosen[0]].iter().flatten().copied();
        let common: Vec<f64> = own.filter(|t| field.usable(*t).len() == chosen.len()).collect();
        if common.is_empty() {
            let sentence = "at no frame of the reference camera do all cameras film: give --times";
            return Err(CliError::BadInput(sentence.into()));
        }
        return Ok(common);
    };
    let instants: Vec<f64> = given_s.iter().map(|t| t - capture.time_origin_s).collect();
    let Some(outside) = instants.iter().find(|t| field.usable(**t).len() < chosen.len()) else {
        return Ok(instants);
    };
    let at = outside + capture.time_origin_s;
    let span = field.common_span_s().map(|(a, b)| [a, b].map(|t| t + capture.time_origin_s));
    Err(CliError::BadInput(match span {
        Some([first, last]) => format!(
            "--times: not all cameras film at {at:.4} s; all do from {first:.4} to {last:.4} s"
        ),
        None => "--times: the cameras' recordings have no time in common".into(),
    }))
}

/// Largest deviation of the time between two successive instants from the mean, as a fraction of the mean. Instants
/// with a larger deviation can't become the frames of a video.
const MAX_UNEVENNESS: f64 = 1e-3;

/// Returns the frame rate of evenly spaced instants, in hertz; 30 for a single instant. Uneven instants are an error.
fn even_rate_hz(instants_s: &[f64]) -> Result<f64, CliError> {
    let steps = instants_s.len() - 1;
    if steps == 0 {
        return Ok(30.0);
    }
    let step_s = (instants_s[steps] - instants_s[0]) / steps as f64;
    let is_even = |w: &[f64]| ((w[1] - w[0]) - step_s).abs() <= MAX_UNEVENNESS * step_s;
    if step_s > 0.0 && instants_s.windows(2).all(is_even) {
        // Removes the rounding error: a video's rate is 30, not 29.999999999999996.
        let rate_hz = 1.0 / step_s;
        let whole = rate_hz.round();
        return Ok(if (rate_hz / whole - 1.0).abs() < 1e-9 { whole } else { rate_hz });
    }
    Err(CliError::BadInput("a video's instants must be even: give --times".into()))
}
