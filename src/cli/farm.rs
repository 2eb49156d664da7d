//! The command `stlfr farm`, which writes jobs for render farms.

use super::CliError;
use super::capture::SceneArgs;
use super::error::written;
use super::files::{CommandOutput, OptionsArgs, open_capture};
use super::print::Page;
use super::shots::{InstantArgs, ShotArgs};
use super::values::{ImageOutput, job_word};
use super::viewpoint::ViewpointArgs;
use crate::capture::Truth;
use crate::farm::{FarmChunks, FarmJob, FarmNeeds, FarmStep};
use crate::progress::Reporter;
use crate::rig::Rig;
use std::path::{Path, PathBuf, absolute};

/// Write a job for a render farm (Open Job Description, Slurm or Flamenco), which divides the work on captures among
/// machines.
///
/// The steps of the job are set-up; filming in chunks (with --rig); the calibration check; offsets; prepare; rendering
/// in chunks, into JOB/frames (with --times or --path); compare (with ground truth). Every task may be run again. All
/// machines must see the program, the captures and JOB at the same paths. JOB contains these files:
///
/// openjd.json, for AWS Deadline Cloud and other engines of Open Job Description;
/// submit.sh, which submits the other scripts to Slurm;
/// stlfr.js, a job type for the folder `scripts` of Flamenco's manager.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  \
    stlfr farm .captures/mine -o job --like cam3 --times 0.05:0.2:600\n  \
    stlfr farm .captures/mine -o job --path bullet-time --duration 10\n  \
    stlfr farm .captures/mine -o job --rig rigs/linear8.json --blend my.blend --size 1280x960\n  \
    sh job/submit.sh --partition=main")]
pub struct FarmArgs {
    /// The captures' folders.
    #[arg(required = true)]
    captures: Vec<PathBuf>,
    /// Folder of the job's files (JOB).
    #[arg(short, long, value_name = "JOB")]
    output: PathBuf,
    /// Film the capture with this rig; --scene or --blend gives the scene.
    #[arg(long, value_name = "RIG", requires = "source")]
    rig: Option<PathBuf>,
    #[command(flatten)]
    scene: SceneArgs,
    #[command(flatten)]
    viewpoint: ViewpointArgs,
    #[command(flatten)]
    instants: InstantArgs,
    /// Number of parts into which filming is divided.
    #[arg(long, value_name = "N", default_value = "100", value_parser = clap::value_parser!(u32).range(1..=100_000))]
    film_parts: u32,
    /// Number of parts that one task films.
    #[arg(long, value_name = "N", default_value = "5", value_parser = clap::value_parser!(u32).range(1..=100_000))]
    film_chunk: u32,
    /// Number of images that one task renders.
    #[arg(long, value_name = "N", default_value = "20", value_parser = clap::value_parser!(u32).range(1..=100_000))]
    render_chunk: u32,
    /// Number of processor cores that a task needs.
    #[arg(long, value_name = "N", default_value = "2", value_parser = clap::value_parser!(u32).range(1..=1024))]
    cores: u32,
    /// Memory that a task needs, in MiB.
    #[arg(long, value_name = "MIB", default_value = "4096", value_parser = clap::value_parser!(u32).range(512..=10_000_000))]
    memory: u32,
    #[command(flatten)]
    options: OptionsArgs,
}

/// Writes the files of the job. `program` is the path of the program `stlfr` on the machines of the farm.
pub fn run(
    args: &FarmArgs,
    program: &Path,
    page: &mut Page,
    reporter: &Reporter,
) -> Result<(), CliError> {
    args.options.read()?;
    let wrong = |sentence: &str| Err(CliError::BadInput(sentence.into()));
    if args.rig.is_none() && args.scene != SceneArgs::default() {
        return wrong("--rig: must be given to film a scene");
    }
    if args.rig.is_some() && args.captures.len() > 1 {
        return wrong("--rig: films one capture, and several are given");
    }
    let folder = written(&args.output, absolute(&args.output))?;
    let job = args.job(program, &folder, reporter)?;
    let files = job.files();
    let names: Vec<&str> = files.iter().map(|(name, _)| &**name).collect();
    CommandOutput::Folder(&args.output, &names).check(None)?;
    written(&args.output, job.write(&folder))?;
    page.line(args.output.display());
    Ok(())
}

impl FarmArgs {
    /// Returns the number of images that the job renders for each capture; `None` if the arguments give no view to
    /// render.
    fn rendered(&self, reporter: &Reporter) -> Result<Option<u32>, CliError> {
        let (viewpoint, instants) = (&self.viewpoint, &self.instants);
        if viewpoint.name().is_none() && viewpoint.camera.is_none() && viewpoint.path.is_none() {
            return Ok(None);
        }
        if viewpoint.path.is_none() && instants.times.is_none() {
            return Err(CliError::BadInput("--times or --path must be given".into()));
        }
        Ok(Some(ShotArgs { viewpoint, instants }.shots(reporter)?.len() as u32))
    }

    fn job(&self, program: &Path, folder: &Path, reporter: &Reporter) -> Result<FarmJob, CliError> {
        let mut steps = Steps { args: self, reporter, suffix: String::new(), steps: Vec::new() };
        steps.add("setup", vec!["setup".into()], &[], None);
        for (index, capture) in self.captures.iter().enumerate() {
            if self.captures.len() > 1 {
                steps.suffix = format!("-{}", index + 1);
            }
            steps.add_capture(&written(capture, absolute(capture))?, folder)?;
        }
        let name = self.captures.iter().filter_map(|c| c.file_name()?.to_str()).take(3);
        Ok(FarmJob {
            name: name.collect::<Vec<_>>().join(", "),
            program: job_word(program)?,
            steps: steps.steps,
        })
    }
}

/// Builder of the list of steps of a render-farm job.
struct Steps<'a> {
    args: &'a FarmArgs,
    reporter: &'a Reporter,
    /// Suffix of the names of the current capture's steps, such as `-2`; empty if the job has a single capture.
    suffix: String,
    steps: Vec<FarmStep>,
}

impl Steps<'_> {
    /// Adds a step to the job. It runs after the steps with the names `after`. All step names except `setup` get the
    /// suffix of the current capture. `chunks` divides the step into tasks; `None` for a single task.
    fn add(
        &mut self,
        name: &str,
        arguments: Vec<String>,
        after: &[&str],
        chunks: Option<FarmChunks>,
    ) {
        let name_of = |name: &str| match name {
            "setup" => name.to_owned(),
            _ => format!("{name}{}", self.suffix),
        };
        self.steps.push(FarmStep {
            name: name_of(name),
            arguments,
            after: after.iter().map(|name| name_of(name)).collect(),
            chunks,
            needs: FarmNeeds { cores: self.args.cores, memory_mib: self.args.memory },
        });
    }

    fn add_capture(&mut self, capture: &Path, job: &Path) -> Result<(), CliError> {
        let mut before = "setup";
        let (ids, has_truth) = match &self.args.rig {
            Some(rig) => {
                self.add_filming(rig, capture)?;
                before = "capture";
                let cameras = Rig::read(rig)?.cameras;
                let ids: Vec<String> = cameras.into_iter().map(|camera| camera.id).collect();
                (ids, self.args.scene.has_truth())
            }
            None => {
                let opened = open_capture(capture, None, self.reporter)?;
                let ids = opened.cameras.iter().map(|camera| camera.id.clone()).collect();
                (ids, Truth::open(capture)?.is_some())
            }
        };
        let like = self.args.viewpoint.name();
        if let Some(id) = like.filter(|like| ids.iter().all(|id| id != like)) {
            let sentence = format!("--like: no camera of {} has the id '{id}'", capture.display());
            return Err(CliError::BadInput(sentence));
        }
        let options = self.args.options.absolute_words()?;
        // A single camera has no offset to estimate.
        for name in ["check", "offsets", "prepare"] {
            if name == "offsets" && ids.len() == 1 {
                continue;
            }
            let mut arguments = vec![name.to_owned(), job_word(capture)?];
            if name != "check" {
                arguments.extend_from_slice(&options);
            }
            self.add(name, arguments, &[before], None);
            before = name;
        }
        self.add_rendering(capture, job, &options)?;
        if has_truth {
            let arguments = ["compare".into(), job_word(capture)?].into_iter().chain(options);
            self.add("compare", arguments.collect(), &[before], None);
        }
        Ok(())
    }

    /// Adds two steps to the job: `film`, which films the capture in parts, and `capture`, which completes the capture
    /// after that.
    fn add_filming(&mut self, rig: &Path, capture: &Path) -> Result<(), CliError> {
        let mut film = self.args.scene.options(rig, capture)?;
        film.make_absolute().map_err(|error| CliError::BadInput(error.to_string()))?;
        let words = film.arguments().into_iter().map(|argument| job_word(Path::new(&argument)));
        let mut arguments = words.collect::<Result<Vec<_>, _>>()?;
        arguments.insert(0, "capture".into());
        let (count, size) = (self.args.film_parts, self.args.film_chunk);
        let chunks = FarmChunks { kind: "film", count, size };
        self.add("film", arguments.clone(), &["setup"], Some(chunks));
        self.add("capture", arguments, &["film"], None);
        Ok(())
    }

    /// Adds the step that renders the images of `--times` or `--path` to the job, if the arguments give a view.
    fn add_rendering(
        &mut self,
        capture: &Path,
        job: &Path,
        options: &[String],
    ) -> Result<(), CliError> {
        let Some(count) = self.args.rendered(self.reporter)? else { return Ok(()) };
        let output = job_word(&job.join(format!("frames{}", self.suffix)).join("%06d.png"))?;
        output.parse::<ImageOutput>().map_err(|reason| {
            CliError::BadInput(format!("{}: {reason}", self.args.output.display()))
        })?;
        let mut arguments = vec!["render".into(), job_word(capture)?];
        arguments.extend(self.args.viewpoint.absolute_words()?);
        arguments.extend(self.args.instants.words());
        arguments.extend(["-o".into(), output]);
        arguments.extend_from_slice(options);
        let chunks = FarmChunks { kind: "render", count, size: self.args.render_chunk };
        self.add("render", arguments, &["prepare"], Some(chunks));
        Ok(())
    }
}
