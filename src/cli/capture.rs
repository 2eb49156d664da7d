//! The command `stlfr capture`, which films a scene in Blender with a simulated camera rig.

use super::CliError;
use super::files::{CommandOutput, must_be_a_file};
use super::print::Page;
use super::values::{Parts, image_size};
use crate::capture::MAX_FRAMES;
use crate::host::open_file;
use crate::progress::Reporter;
use crate::rig::Rig;
use crate::toolchain::{FilmOptions, FilmedScene, ensure_environment, film, project_root};
use std::io::Read;
use std::path::{Path, PathBuf};

/// Film a scene in Blender with a simulated camera rig. After an interruption, the same command continues.
///
/// Other machines that share the folder may run the same command to help. Each image is filmed once, even if the
/// machines' clocks are wrong. Images that a failed machine had begun are filmed again after the time of --silence.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  \
    stlfr capture rigs/linear8.json --scene magazine -o .captures/magazine --size 320x240\n  \
    stlfr capture rigs/linear8.json --blend my-scene.blend -o .captures/mine --frames 30\n\n\
    In a .blend, an object named `rig` (or else the scene's camera) says where the rig stands.")]
pub struct CaptureArgs {
    /// Rig file, such as rigs/linear8.json.
    #[arg(requires = "source")]
    rig: PathBuf,
    /// The capture's folder.
    #[arg(short, long = "output", value_name = "CAPTURE")]
    output: PathBuf,
    #[command(flatten)]
    scene: SceneArgs,
    /// Film only parts K to L of N equal parts of the images, such as 3-6/100. When all parts are filmed, run the
    /// command without --part to complete the capture.
    #[arg(long, value_name = "K-L/N")]
    part: Option<Parts>,
    /// Seconds without activity after which another process counts as failed and its images are filmed here [default:
    /// 60].
    #[arg(long, value_name = "SECONDS", value_parser = clap::value_parser!(u32).range(5..=100_000))]
    silence: Option<u32>,
}

/// Arguments that choose a scene, and how the scene is filmed.
#[derive(Debug, Default, PartialEq, clap::Args)]
#[command(group = clap::ArgGroup::new("source"))]
pub struct SceneArgs {
    /// Name of a scene in blender/scenes.
    #[arg(long, value_name = "NAME", group = "source")]
    scene: Option<String>,
    /// A .blend file of your own.
    #[arg(long, value_name = "FILE", group = "source")]
    blend: Option<PathBuf>,
    /// Image size of all cameras, with the rig's aspect ratio [default: the rig's size].
    #[arg(long, value_name = "WxH", value_parser = image_size)]
    size: Option<(u32, u32)>,
    /// Number of frames of the reference camera; the other cameras film for the same time [default: 9].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=MAX_FRAMES as i64))]
    frames: Option<u32>,
    /// Samples per pixel; by Cycles, ground-truth images have four times as many [default: 16].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=100_000))]
    samples: Option<u32>,
    /// Blender's render engine. Workbench is many times faster, and lacks shadows, highlights and
    /// procedural textures [default: cycles].
    #[arg(long, value_name = "ENGINE", value_parser = ["cycles", "workbench"])]
    engine: Option<String>,
    /// Number of instants at which the ground truth is rendered [default: 3].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(0..=100_000))]
    instants: Option<u32>,
    /// Instants of the ground truth, in seconds on the reference camera's clock, such as 0.1,0.15.
    #[arg(
        long,
        value_name = "T,T",
        value_delimiter = ',',
        conflicts_with = "instants",
        allow_hyphen_values = true
    )]
    instants_s: Vec<f64>,
    /// Number of surface points whose tracks are written into the ground truth [default: 0].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(0..=100_000))]
    tracks: Option<u32>,
    /// Number of frames of a slow motion that is rendered as ground truth, from the rig's first view [default: 0].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(0..=MAX_FRAMES as i64))]
    truth_video: Option<u32>,
    /// Render no ground truth.
    #[arg(long)]
    no_truth: bool,
    /// Store each camera's frames as one lossless video (FFV1 in Matroska) in place of images.
    #[arg(long)]
    video: bool,
}

pub fn run(args: &CaptureArgs, page: &mut Page, reporter: &Reporter) -> Result<(), CliError> {
    // Invalid arguments are reported before the set-up of the Python environment, which may take minutes.
    let mut options = args.scene.options(&args.rig, &args.output)?;
    options.part = args.part.as_ref().map(Parts::to_string);
    options.silence_s = args.silence;
    let root = project_root()?;
    if let FilmedScene::Named(name) = &options.scene {
        must_be_a_scene(name, &root)?;
    }
    let environment = ensure_environment(&root, reporter)?;
    film(&environment, &options, reporter)?;
    page.line(args.output.display());
    Ok(())
}

/// Returns an error that lists the available scenes, if no scene has this name. A scene is a module of `blender/scenes`
/// with a function `build`.
fn must_be_a_scene(name: &str, root: &Path) -> Result<(), CliError> {
    let is_scene = |file: &Path| {
        let is_module = file.extension().is_some_and(|extension| extension == "py");
        is_module && std::fs::read_to_string(file).is_ok_and(|text| text.contains("\ndef build("))
    };
    let folder = std::fs::read_dir(root.join("blender/scenes"));
    let files = folder.into_iter().flatten().flatten().map(|entry| entry.path());
    let scenes = files.filter(|file| is_scene(file));
    let mut names: Vec<String> =
        scenes.filter_map(|file| Some(file.file_stem()?.to_str()?.to_owned())).collect();
    if names.iter().any(|scene| scene == name) {
        return Ok(());
    }
    names.sort();
    let names = names.join(", ");
    Err(CliError::BadInput(format!("--scene {name}: no such scene; there are: {names}")))
}

/// Returns an error unless a file starts like a `.blend`: with the word BLENDER, or compressed by Zstandard or gzip.
fn must_be_a_blend(file: &Path) -> Result<(), CliError> {
    let mut start = Vec::new();
    let read = open_file(file).and_then(|opened| opened.take(7).read_to_end(&mut start));
    read.map_err(|e| CliError::BadInput(format!("--blend {}: {e}", file.display())))?;
    let starts: [&[u8]; 3] = [b"BLENDER", b"\x28\xb5\x2f\xfd", b"\x1f\x8b"];
    if starts.iter().any(|known| start.starts_with(known)) {
        return Ok(());
    }
    Err(CliError::BadInput(format!("--blend {}: is not a file of Blender", file.display())))
}

/// Returns an error unless all cameras and views of a rig have the aspect ratio of `--size`.
fn must_have_the_aspect((width, height): (u32, u32), rig: &Rig) -> Result<(), CliError> {
    let cameras = rig.cameras.iter().map(|c| (&c.id, c.width, c.height));
    let views = rig.views.iter().map(|v| (&v.id, v.width, v.height));
    let is_other =
        |w: u32, h: u32| u64::from(w) * u64::from(height) != u64::from(h) * u64::from(width);
    let Some((id, w, h)) = cameras.chain(views).find(|&(_, w, h)| is_other(w, h)) else {
        return Ok(());
    };
    let name = &rig.name;
    Err(CliError::BadInput(format!(
        "--size {width}x{height} has another aspect than {id} of rig {name} ({w}x{h})"
    )))
}

impl SceneArgs {
    /// Returns whether ground truth is rendered.
    pub fn has_truth(&self) -> bool {
        !self.no_truth
    }

    /// Returns the options for filming the scene with the rig file `rig` into the folder `capture`. Checks all files
    /// that the options name.
    pub fn options(&self, rig: &Path, capture: &Path) -> Result<FilmOptions, CliError> {
        for file in std::iter::once(rig).chain(self.blend.as_deref()) {
            must_be_a_file(file)?;
        }
        if let Some(file) = &self.blend {
            must_be_a_blend(file)?;
        }
        let read = Rig::read(rig)?;
        if let Some(size_px) = self.size {
            must_have_the_aspect(size_px, &read)?;
        }
        CommandOutput::Capture(capture).check(None)?;
        Ok(FilmOptions {
            rig: rig.to_owned(),
            scene: match (&self.scene, &self.blend) {
                (_, Some(file)) => FilmedScene::Blend(file.clone()),
                (name, None) => FilmedScene::Named(name.clone().unwrap_or_default()),
            },
            capture: capture.to_owned(),
            size_px: self.size,
            frames: self.frames,
            samples: self.samples,
            engine: self.engine.clone(),
            instants: self.instants,
            instants_s: self.instants_s.clone(),
            tracks: self.tracks,
            truth_video: self.truth_video,
            truth: self.has_truth(),
            video: self.video,
            part: None,
            silence_s: None,
        })
    }
}
