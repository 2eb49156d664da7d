//! `stlfr render`

use super::CliError;
use super::files::{CommandOutput, OptionsArgs, ffmpeg_for, open_capture};
use super::values::{AUTO, ImageOutput, Parts, Times, method, method_or_auto};
use super::viewpoint::{ViewpointArgs, far_outside};
use std::ops::Range;
use std::panic::resume_unwind;
use std::path::PathBuf;
use std::sync::mpsc::sync_channel;
use stlfr::capture::{Capture, NamedView};
use stlfr::interpolation::SyncMethod;
use stlfr::light_field::{
    Context, RenderError, Request, Viewpoint, check_times_before_offsets, render,
};
use stlfr::lumigraph::{BlendMethod, Rendered};
use stlfr::options::{ProxyMethod, RenderOptions, TrailMode};
use stlfr::pipeline;
use stlfr::progress::Reporter;
use stlfr::raster::write_image;
use stlfr::video::{Codec, VideoFormat, VideoWriter};

/// Render the view of any camera at any instant, or over a span of time.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  \
    stlfr render .captures/demo --like between --time 0.1 -o between.png\n  \
    stlfr render .captures/demo --like cam3 --shift 0.03,0,0 --time 0.1 -o right.png\n  \
    stlfr render .captures/demo --camera view.json --time 0.1 -o view.png\n  \
    stlfr render .captures/demo --camera view.json --times 0.05:0.25:60 -o out/%04d.png\n  \
    stlfr render .captures/demo --like cam3 --times 0.05:0.25:60 -o slow.mkv\n  \
    stlfr render .captures/demo --like between --time 0.1 --preset draft -o between.png\n  \
    stlfr render .captures/demo --like between --time 0.1 --sync auto --proxy auto -o between.png\n  \
    stlfr render .captures/demo --like cam3 --time 0.2 --trail 0.15 --trail-instants 31 -o trail.png\n\n\
    stlfr info prints an example for your capture. A view's file holds a camera as capture.json has it.")]
pub struct RenderArgs {
    /// The capture's folder.
    capture: PathBuf,
    #[command(flatten)]
    viewpoint: ViewpointArgs,
    /// The instant, seconds on the reference camera's clock.
    #[arg(
        long,
        value_name = "SECONDS",
        allow_negative_numbers = true,
        required_unless_present = "times",
        conflicts_with = "times"
    )]
    time: Option<f64>,
    /// N instants evenly from START to END, both included: slow motion in one run.
    #[arg(long, value_name = "START:END:N", allow_hyphen_values = true)]
    times: Option<Times>,
    /// Only parts K to L of N, such as 3-6/100: other commands, on any machine, render the others.
    #[arg(long, value_name = "K-L/N", requires = "times")]
    part: Option<Parts>,
    /// The image, for --times a pattern such as out/%04d.png or a video such as out.mkv.
    #[arg(short, long, value_name = "FILE")]
    output: ImageOutput,
    /// How each camera's image is synchronized to the instant.
    #[arg(long, value_name = "METHOD", value_parser = method_or_auto::<SyncMethod>())]
    sync: Option<String>,
    /// The geometry proxy, an estimate of the scene's shape.
    #[arg(long, value_name = "METHOD", value_parser = method_or_auto::<ProxyMethod>())]
    proxy: Option<String>,
    /// How cameras are weighted where they see the same point.
    #[arg(long, value_name = "METHOD", value_parser = method_or_auto::<BlendMethod>())]
    blend: Option<String>,
    /// Overlay what moved in this many seconds before the instant: temporal integration.
    #[arg(long, value_name = "SECONDS")]
    trail: Option<f64>,
    /// Instants that a trail overlays [default: 16].
    #[arg(long, value_name = "N")]
    trail_instants: Option<usize>,
    /// How a trail overlays its instants [default: mean].
    #[arg(long, value_name = "MODE", value_parser = method::<TrailMode>())]
    trail_mode: Option<TrailMode>,
    #[command(flatten)]
    options: OptionsArgs,
}

impl RenderArgs {
    /// The preset's options, overridden by the file's, overridden by the command line's.
    fn render_options(&self) -> Result<RenderOptions, CliError> {
        let mut options = self.options.read()?;
        for (method, auto, option) in [
            (&self.sync, "auto.sync", "sync"),
            (&self.proxy, "auto.proxy", "proxy.method"),
            (&self.blend, "auto.blend", "blend.method"),
        ] {
            let Some(method) = method else { continue };
            let (name, value) = if method == AUTO { (auto, "true") } else { (option, &**method) };
            options.set(auto, "false").map_err(CliError::BadInput)?;
            options.set(name, value).map_err(CliError::BadInput)?;
        }
        let trail = &mut options.trail;
        trail.duration_s = self.trail.unwrap_or(trail.duration_s);
        trail.instants = self.trail_instants.unwrap_or(trail.instants);
        trail.mode = self.trail_mode.unwrap_or(trail.mode);
        // The file's options were checked when they were read; those of the command line are not yet.
        options.check()?;
        Ok(options)
    }

    /// The instants, checked: seconds on the reference's clock as its file has it, without the capture's origin.
    fn times_s(&self) -> Result<Vec<f64>, CliError> {
        let wrong = |sentence: &str| Err(CliError::BadInput(sentence.to_owned()));
        Ok(match (self.time, &self.times, &self.output) {
            (Some(time_s), _, _) if !time_s.is_finite() => return wrong("--time: must be finite"),
            (Some(time_s), _, ImageOutput::Image(_)) => vec![time_s],
            (Some(_), ..) => return wrong("--time gives one image: -o must name a .png"),
            (None, Some(_), ImageOutput::Image(_)) => {
                return wrong("--times gives many images: -o must be like out/%04d.png or out.mkv");
            }
            (None, Some(Times(times_s)), _) => times_s.clone(),
            (None, None, _) => return wrong("--time or --times must be given"),
        })
    }

    /// Indices of the times whose views are rendered now, of this many.
    fn wanted(&self, count: usize) -> Result<Range<usize>, CliError> {
        match &self.part {
            None => Ok(0..count),
            Some(part) if matches!(self.output, ImageOutput::Sequence(_)) => Ok(part.range(count)),
            Some(_) => Err(CliError::BadInput(
                "--part gives images of a sequence: -o must be like out/%04d.png".into(),
            )),
        }
    }
}

pub fn run(args: &RenderArgs, reporter: &Reporter) -> Result<(), CliError> {
    let times_s = args.times_s()?;
    let wanted = args.wanted(times_s.len())?;
    let given = args.viewpoint.camera()?;
    let options = args.render_options()?;
    let output = CommandOutput::Images(&args.output, times_s.len());
    let capture = open_capture(&args.capture, Some(output), reporter)?;
    let view = args.viewpoint.view(given, &capture)?;
    let times_s: Vec<f64> = times_s.iter().map(|t| t - capture.time_origin_s).collect();
    let (from, filming) = match &view {
        NamedView::Filming(index) => (Viewpoint::Like(*index), Some(*index)),
        NamedView::Free(camera) => (Viewpoint::View(camera), None),
    };
    check_times_before_offsets(&capture, filming, &times_s)?;
    if let Viewpoint::View(camera) = from {
        far_outside(camera, &capture).inspect(|note| reporter.note(note));
    }
    let writer = Writer::new(&args.output, &capture, wanted.start, reporter)?;

    let field = pipeline::open_field(capture, &options, reporter)?;
    field.check_times(from, &times_s)?;
    let options = pipeline::resolved(&field, &options, reporter)?;
    let instants = options.trail.count();
    let times_s = &times_s[wanted];
    let task = reporter.task("rendering", times_s.len() * instants);
    writer.write_all(times_s.iter().enumerate().map(|(index, &time_s)| {
        let proceed = |done, _| {
            task.set(index * instants + done);
            true
        };
        render(&field, &Request::new(from, time_s, &options), &Context::new(&proceed))
    }))
}

/// Finished views that may wait to be written. More: memory; fewer: rendering waits for a file that takes longer
/// than others.
const WAITING_VIEWS: usize = 2;

/// Where finished images go.
struct Writer<'a> {
    output: &'a ImageOutput,
    /// Index of the first image.
    first: usize,
    format: VideoFormat,
    /// The encoder; `None` if the output is no video.
    ffmpeg: Option<PathBuf>,
    /// The video, from its first frame on.
    video: Option<VideoWriter>,
    /// The smallest fraction of a view's pixels that cameras see.
    seen_fraction: f64,
    reporter: &'a Reporter,
}

/// Fraction of a view's pixels that cameras must see, or else a note says how few they see.
const MIN_SEEN_FRACTION: f64 = 0.5;

impl<'a> Writer<'a> {
    fn new(
        output: &'a ImageOutput,
        capture: &Capture,
        first: usize,
        reporter: &'a Reporter,
    ) -> Result<Self, CliError> {
        let is_video = matches!(output, ImageOutput::Video(_));
        let ffmpeg = is_video.then(|| ffmpeg_for("a video")).transpose()?;
        let frame_s = capture.frame_s();
        let rate_hz = if frame_s > 0.0 { 1.0 / frame_s } else { 30.0 };
        let format = VideoFormat { depth: capture.bit_depth(), rate_hz, codec: Codec::Ffv1 };
        Ok(Self { output, first, format, ffmpeg, video: None, seen_fraction: 1.0, reporter })
    }

    /// Writes views while the next ones are rendered. Views before an error are written, but no video is finished then.
    fn write_all(
        mut self,
        views: impl Iterator<Item = Result<Rendered, RenderError>>,
    ) -> Result<(), CliError> {
        let (send, received) = sync_channel(WAITING_VIEWS);
        std::thread::scope(|scope| {
            // ffmpeg ends with the thread that started it, which therefore finishes the video.
            let writing = scope.spawn(move || {
                for (index, view) in received.into_iter().enumerate() {
                    self.write(index, &view?)?;
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

    fn write(&mut self, index: usize, view: &Rendered) -> Result<(), CliError> {
        let path = self.output.file(self.first + index).unwrap_or_default();
        let seen = view.coverage.iter().filter(|is_seen| **is_seen).count();
        self.seen_fraction = self.seen_fraction.min(seen as f64 / view.coverage.len() as f64);
        let Some(ffmpeg) = &self.ffmpeg else {
            let coverage = view.coverage.contains(&false).then_some(view.coverage.as_slice());
            return Ok(write_image(&path, &view.image, coverage, self.format.depth)?);
        };
        let video = match &mut self.video {
            Some(video) => video,
            video => video.insert(VideoWriter::create(ffmpeg, &path, &view.image, self.format)?),
        };
        Ok(video.push(&view.image)?)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Parser;

    #[derive(Debug, Parser)]
    struct Program {
        #[command(flatten)]
        args: RenderArgs,
    }

    fn parsed(line: &str) -> Result<RenderArgs, String> {
        let words = std::iter::once("render").chain(line.split(' '));
        Ok(Program::try_parse_from(words).map_err(|e| e.to_string())?.args)
    }

    fn times_s(line: &str) -> Result<Vec<f64>, String> {
        let args = parsed(line)?;
        let times_s = args.viewpoint.camera().and_then(|_| args.times_s());
        let checked = times_s.and_then(|s| args.wanted(s.len()).map(|_| s));
        checked.map_err(|e| e.to_string())
    }

    #[test]
    fn one_image_or_many() {
        assert_eq!(times_s("c --like cam3 --time -0.1 -o a.png").unwrap(), [-0.1]);
        assert_eq!(times_s("c --like a --times -1:1:3 -o o/%d.png").unwrap(), [-1.0, 0.0, 1.0]);
        assert_eq!(times_s("c --like a --times 0:1:2 -o o.mkv").unwrap(), [0.0, 1.0]);
        assert!(times_s("c --like a --shift -0.1,0,0 --time 0 -o a.png").is_ok());
        let args = parsed("c --like a --times 0:1:9 --part 2/3 -o o/%d.png").unwrap();
        assert_eq!(args.wanted(9).unwrap(), 3..6);
    }

    #[test]
    fn what_does_not_go_together_is_refused() {
        for (line, words) in [
            ("c --time 0 -o a.png", "--camera <VIEW.json>|--like <NAME>"),
            ("c --shift 0,0,0 --time 0 -o a.png", "--camera <VIEW.json>|--like <NAME>"),
            ("c --like a --shift 0,0 --time 0 -o a.png", "0.03,0,0"),
            ("c --like a --camera b --time 0 -o a.png", "cannot be used with"),
            ("c --like a -o a.png", "--time"),
            ("c --like a --time 0 --times 0:1:2 -o a.png", "cannot be used with"),
            ("c --like a --time nan -o a.png", "finite"),
            ("c --like a --time 0 -o a.mkv", "must name a .png"),
            ("c --like a --times 0:1:2 -o a.png", "%04d"),
            ("c --like a --times 0:1 -o a.mkv", "0.1:0.4:30"),
            ("c --like a --time 0 -o a.jpg", ".mkv"),
            ("c --like a --times 0:1:2 --part 1/2 -o a.mkv", "must be like out/%04d.png"),
            ("c --like a --times 0:1:2 --part 3/2 -o o/%d.png", "3-6/100"),
            ("c --like a --time 0 --part 1/2 -o a.png", "of a sequence"),
            ("c --camera /nowhere.json --time 0 -o a.png", "/nowhere.json"),
        ] {
            let message = times_s(line).unwrap_err();
            assert!(message.contains(words), "{line}: {message}");
        }
    }
}
