//! The command `stlfr render`, which renders views into images or videos.

use super::CliError;
use super::display::DisplayArgs;
use super::files::{CommandOutput, OptionsArgs, open_capture};
use super::frames::{Frames, SharedFolder};
use super::shots::{InstantArgs, ShotArgs, Shots, camera, viewpoint};
use super::values::{AUTO, ImageFile, ImageOutput, Parts, method, method_or_auto};
use super::view_writer::{RenderedView, ViewWriter};
use super::viewpoint::ViewpointArgs;
use crate::interpolation::SyncMethod;
use crate::light_field::{Context, ImageMotion, Request, render, render_with_layers};
use crate::lumigraph::BlendMethod;
use crate::options::{ProxyMethod, RenderOptions, TrailMode};
use crate::pipeline;
use crate::progress::Reporter;
use std::ops::Range;
use std::path::PathBuf;

/// Render the view of any camera at any instant, over a span of time, or along a path.
#[derive(Debug, clap::Args)]
#[command(group = clap::ArgGroup::new("view").required(true))]
#[command(after_help = "Examples:\n  \
    stlfr render .captures/demo --like between --time 0.1 -o between.png\n  \
    stlfr render .captures/demo --like cam3 --shift 0.03,0,0 --time 0.1 -o right.png\n  \
    stlfr render .captures/demo --camera view.json --times 0.05:0.25:60 -o out/%04d.png\n  \
    stlfr render .captures/demo --like cam3 --times 0.05:0.25:60 --fps 24 -o slow.mp4\n  \
    stlfr render .captures/demo --path bullet-time -o bullet.mp4\n  \
    stlfr render .captures/demo --path orbit --time 0.1 --duration 3 -o orbit.gif\n  \
    stlfr render .captures/demo --path path.json -o out/%04d.jpg\n  \
    stlfr render .captures/demo --like between --time 0.1 --quilt go -o quilt.png\n  \
    stlfr render .captures/demo --path sweep --stereo 0.06 -o eyes.mp4\n  \
    stlfr render .captures/demo --like between --time 0.1 --sync auto --proxy auto -o between.png\n  \
    stlfr render .captures/demo --like cam3 --time 0.2 --trail 0.15 --trail-instants 31 -o trail.png\n\n\
    The images of a sequence are shared by all processes that run the same command at the same time; stopped, it continues.\n\
    stlfr info prints an example for your capture. A view's file holds a camera as capture.json has it. A path's file\n\
    holds {\"format\": \"stlfr-path\", \"version\": 1, \"keys\": [{\"at_s\": 0, \"time_s\": 0.1, \"camera\": {…}}, …]}: the view\n\
    and the instant at seconds of the video, interpolated smoothly. Equal instants freeze time, falling ones reverse it;\n\
    \"rest\": true in a key eases in and out; \"constant_speed\": true moves evenly.")]
pub struct RenderArgs {
    /// The capture's folder.
    capture: PathBuf,
    #[command(flatten)]
    viewpoint: ViewpointArgs,
    #[command(flatten)]
    instants: InstantArgs,
    #[command(flatten)]
    display: DisplayArgs,
    /// Render only parts K to L of N, such as 3-6/100. Other commands, on any machine, render the other parts.
    #[arg(long, value_name = "K-L/N")]
    part: Option<Parts>,
    /// Output: an image (.png, .jpg, or .exr with depth and motion). For --times and --path: a pattern such as
    /// out/%04d.png, or a video (.mp4 and .webm for browsers and slides, .gif, .mkv without loss).
    #[arg(short, long, value_name = "FILE")]
    output: ImageOutput,
    /// Sync method, which makes each camera's image at an instant between its frames.
    #[arg(long, value_name = "METHOD", value_parser = method_or_auto::<SyncMethod>())]
    sync: Option<String>,
    /// The geometry proxy, an estimate of the scene's shape.
    #[arg(long, value_name = "METHOD", value_parser = method_or_auto::<ProxyMethod>())]
    proxy: Option<String>,
    /// Blending method, which weights the cameras that see the same point.
    #[arg(long, value_name = "METHOD", value_parser = method_or_auto::<BlendMethod>())]
    blend: Option<String>,
    /// Overlay views at several instants, from this many seconds before the image's instant on (temporal integration).
    #[arg(long, value_name = "SECONDS")]
    trail: Option<f64>,
    /// Number of instants that a trail overlays [default: 16].
    #[arg(long, value_name = "N")]
    trail_instants: Option<usize>,
    /// How the images of a trail are combined into one [default: mean].
    #[arg(long, value_name = "MODE", value_parser = method::<TrailMode>())]
    trail_mode: Option<TrailMode>,
    #[command(flatten)]
    options: OptionsArgs,
}

impl RenderArgs {
    /// Returns the options of all stages: the options of the preset, overridden by the options file, overridden by the
    /// command line.
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
        // The options of the file were checked when they were read. This check is for the options of the command line.
        options.check()?;
        Ok(options)
    }

    fn shots(&self, reporter: &Reporter) -> Result<Shots<'_>, CliError> {
        let args = ShotArgs { viewpoint: &self.viewpoint, instants: &self.instants };
        let shots = args.shots(reporter)?;
        if self.display.is_of_several() && self.output.image_file() == Some(ImageFile::Exr) {
            return Err(CliError::BadInput(
                "an .exr holds one view: for --quilt and --stereo -o must be another image or a video".into(),
            ));
        }
        match (&self.output, shots.is_sequence()) {
            (ImageOutput::Image(..), true) => Err(CliError::BadInput(
                "many images are rendered: -o must be like out/%04d.png or out.mp4".into(),
            )),
            (ImageOutput::Sequence(..) | ImageOutput::Video(..), false) => Err(CliError::BadInput(
                "--time gives one image: -o must name a .png or .jpg".into(),
            )),
            _ => Ok(shots),
        }
    }

    /// Returns the images that this process renders. `wanted` are the indices that the arguments choose. If the output
    /// is a whole sequence, the images are divided among all processes that run the same command. `key` identifies this
    /// command.
    fn frames<'a>(
        &self,
        wanted: Range<usize>,
        output: &'a ImageOutput,
        key: &str,
    ) -> Result<Frames<'a>, CliError> {
        match (output, &self.part, output.file(0)) {
            (ImageOutput::Sequence(..), None, Some(first)) => {
                let folder = first.with_file_name(format!(".stlfr-render-{key}"));
                Frames::shared(output, wanted.len(), &folder)
            }
            _ => Ok(Frames::all(output, wanted)),
        }
    }

    /// Returns the indices of the images to render among `count` images, as `--part` selects them.
    fn wanted(&self, count: usize) -> Result<Range<usize>, CliError> {
        match &self.part {
            None => Ok(0..count),
            Some(part) if matches!(self.output, ImageOutput::Sequence(..)) => Ok(part.range(count)),
            Some(_) => Err(CliError::BadInput(
                "--part gives images of a sequence: -o must be like out/%04d.png".into(),
            )),
        }
    }
}

pub fn run(args: &RenderArgs, reporter: &Reporter) -> Result<(), CliError> {
    let mut shots = args.shots(reporter)?;
    let wanted = args.wanted(shots.len())?;
    let options = args.render_options()?;
    let named = args.display.named(&args.output);
    let output = CommandOutput::Images(&named, shots.len());
    let capture = open_capture(&args.capture, Some(output), reporter)?;
    shots.place(&capture, reporter)?;
    let rate_hz = shots.rate_hz(&capture);
    let writer = ViewWriter::new(&named, &capture, rate_hz, reporter)?;

    let field = pipeline::open_field(capture, &options, reporter)?;
    shots.check(&field)?;
    let options = pipeline::resolved(&field, &options, reporter)?;
    shots.fit(&field, &options)?;
    let layout = args.display.layout(&field, &shots, &options, reporter)?;
    let parts = layout.parts(&field, &shots.get(0).view);
    let has_layers = named.image_file() == Some(ImageFile::Exr);
    let instants = options.trail.count();
    let views = parts.as_ref().map_or(1, |parts| parts.origins.len());
    let task = reporter.task("rendering", wanted.len() * views * instants);
    let name = named.file(0).unwrap_or_default();
    let more = format!("{:?} {:?}", args.display, name.file_name());
    let frames = args.frames(wanted, &named, &shots.key(&field, &options, &more))?;
    let shared = frames.shared_folder();
    let (mut done, mut has_motion) = (0, true);
    let render_all = || -> Result<(), CliError> {
        let mut writer = writer.start(parts);
        for frame in frames {
            let (frame, mut claim) = frame?;
            for (part, view) in layout.views(&field, &shots.get(frame).view).iter().enumerate() {
                let proceed = |instant, _| {
                    task.set(done + instant);
                    true
                };
                let context = &Context::new(&proceed);
                let request = Request::new(viewpoint(view), shots.get(frame).time_s, &options);
                let (rendered, layers) = if has_layers {
                    let (rendered, layers) = render_with_layers(&field, &request, context)?;
                    let here = (camera(&field, view), request.time_s);
                    let neighbors = shots.neighbors(&field, frame);
                    let motion = ImageMotion::new(&field, layers.surfaces, here, neighbors);
                    (rendered, Some((layers.depths, motion)))
                } else {
                    (render(&field, &request, context)?, None)
                };
                has_motion &= layers.as_ref().is_none_or(|(_, motion)| motion.is_some());
                let claim = claim.take_if(|_| part + 1 == views);
                writer.add(RenderedView { frame, part, rendered, layers, claim })?;
                done += instants;
            }
        }
        // If an image fails, the writer waits until the images before it are written.
        writer.finish()
    };
    render_all().inspect_err(|_| shared.iter().for_each(SharedFolder::end_unused))?;
    if !has_motion {
        reporter.note("The images have no motion, which only --proxy scene-flow finds.");
    }
    shared.map_or(Ok(()), |folder| folder.end())
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
        let shots = args.shots(&Reporter::silent()).map_err(|e| e.to_string())?;
        args.wanted(shots.len()).map_err(|e| e.to_string())?;
        Ok(shots.times_in_file_s())
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
            ("c --time 0 -o a.png", "--camera <VIEW.json>|--like <NAME>|--path <PATH>"),
            (
                "c --shift 0,0,0 --time 0 -o a.png",
                "--camera <VIEW.json>|--like <NAME>|--path <PATH>",
            ),
            ("c --like a --shift 0,0 --time 0 -o a.png", "0.03,0,0"),
            ("c --like a --camera b --time 0 -o a.png", "cannot be used with"),
            ("c --like a -o a.png", "--time"),
            ("c --like a --time 0 --times 0:1:2 -o a.png", "cannot be used with"),
            ("c --like a --time nan -o a.png", "finite"),
            ("c --like a --time 0 -o a.mkv", "must name a .png"),
            ("c --like a --time 0 -o o/%d.png", "must name a .png"),
            ("c --like a --times 0:1:2 -o a.jpg", "%04d"),
            ("c --like a --times 0:1 -o a.mkv", "0.1:0.4:30"),
            ("c --like a --time 0 -o a.bmp", ".mkv"),
            ("c --path spiral -o a.mp4", "sweep, orbit, bullet-time, dolly"),
            ("c --path sweep --times 0:1:2 -o a.mp4", "cannot be used with"),
            ("c --path sweep -o a.png", "%04d"),
            ("c --path sweep --shift 0,0,0 -o a.mp4", "cannot be used with"),
            ("c --path sweep --fps 0 -o a.mp4", "from 0.001 to 1000"),
            ("c --path sweep --duration 1e6 --fps 1000 -o a.mp4", "at most 1000000"),
            ("c --path /nowhere.json -o a.mp4", "/nowhere.json"),
            ("c --like a --time 0 --quilt glass -o a.png", "16-landscape"),
            ("c --like a --time 0 --cone 3 -o a.png", "--quilt"),
            ("c --like a --time 0 --quilt go --stereo 0.06 -o a.png", "cannot be used with"),
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
