//! Calls the Python programs that film a capture, lay out the review of a comparison in Blender, and package the
//! Blender extension as a file to install.

use super::setup::{self, Environment};
use super::{ToolchainError, script};
use crate::host::read_text;
use crate::host::temporary::Temporary;
use crate::json;
use crate::progress::Reporter;
use std::ffi::OsString;
use std::path::{Path, PathBuf};

/// Options for filming a scene in Blender with a simulated rig. If an option is `None`, the filming script's default is
/// used.
#[derive(Clone, Debug)]
pub struct FilmOptions {
    /// Path of the rig file.
    pub rig: PathBuf,
    pub scene: FilmedScene,
    /// Folder of the capture. If filming was interrupted, it is resumed there, provided that the options are the same.
    pub capture: PathBuf,
    /// Width and height of all cameras' images, pixels. `None` for the sizes in the rig file.
    pub size_px: Option<(u32, u32)>,
    /// Number of frames that the reference camera films. `None` for the filming script's default.
    pub frames: Option<u32>,
    /// Number of render samples per pixel. `None` for the filming script's default.
    pub samples: Option<u32>,
    /// Blender's render engine: `cycles` or `workbench`. `None` for the filming script's default.
    pub engine: Option<String>,
    /// Number of instants at which ground truth is rendered. `None` for the filming script's default.
    pub instants: Option<u32>,
    /// Instants at which ground truth is rendered, seconds on the reference camera's clock. If empty, `instants` evenly
    /// spaced instants are chosen.
    pub instants_s: Vec<f64>,
    /// Number of scene points whose true tracks are written into the ground truth. `None` for no tracks.
    pub tracks: Option<u32>,
    /// Number of frames of the ground truth's slow-motion video. `None` for no video.
    pub truth_video: Option<u32>,
    /// Whether to write ground truth into the capture's folder `truth/`.
    pub truth: bool,
    /// Whether to store the frames of each camera as one lossless video.
    pub video: bool,
    /// Part of the images to film, such as `3-6/100` for the parts 3 to 6 of 100. If it is `None`, all images are
    /// filmed, and then the files that complete the capture are written.
    pub part: Option<String>,
    /// Time without activity, in seconds, after which another filming process counts as ended. The images that the
    /// other process had begun are then filmed by this process. `None` for the filming script's default.
    pub silence_s: Option<u32>,
}

impl FilmOptions {
    /// Makes all paths absolute, so that they don't depend on the working folder.
    pub fn make_absolute(&mut self) -> std::io::Result<()> {
        let mut paths = vec![&mut self.rig, &mut self.capture];
        if let FilmedScene::Blend(file) = &mut self.scene {
            paths.push(file);
        }
        for path in paths {
            *path = std::path::absolute(&*path)?;
        }
        Ok(())
    }

    /// Returns these options as command-line arguments of `stlfr capture`. The filming script takes the same arguments.
    pub fn arguments(&self) -> Vec<OsString> {
        let mut arguments =
            vec![self.rig.clone().into(), "-o".into(), self.capture.clone().into_os_string()];
        arguments.extend(match &self.scene {
            FilmedScene::Named(name) => ["--scene".into(), name.into()],
            FilmedScene::Blend(file) => ["--blend".into(), file.into()],
        });
        let text = |number: Option<u32>| number.map(|number| number.to_string());
        let times: Vec<String> = self.instants_s.iter().map(f64::to_string).collect();
        for (flag, value) in [
            ("--size", self.size_px.map(|(width, height)| format!("{width}x{height}"))),
            ("--frames", text(self.frames)),
            ("--samples", text(self.samples)),
            ("--instants", text(self.instants)),
            ("--truth-video", text(self.truth_video)),
            ("--tracks", text(self.tracks)),
            ("--engine", self.engine.clone()),
            ("--instants-s", (!times.is_empty()).then(|| times.join(","))),
            ("--part", self.part.clone()),
            ("--silence", text(self.silence_s)),
        ] {
            // A flag and its value are one argument, so that a negative value isn't read as a flag.
            arguments.extend(value.map(|value| format!("{flag}={value}").into()));
        }
        for (flag, is_given) in [("--no-truth", !self.truth), ("--video", self.video)] {
            arguments.extend(is_given.then(|| flag.into()));
        }
        arguments
    }
}

/// Scene to film.
#[derive(Clone, Debug)]
pub enum FilmedScene {
    /// Name of a scene in `blender/scenes`.
    Named(String),
    /// Path of a `.blend` file.
    Blend(PathBuf),
}

/// Films a capture in Blender: renders the images that it lacks. A complete capture is not changed.
pub fn film(
    environment: &Environment,
    options: &FilmOptions,
    reporter: &Reporter,
) -> Result<(), ToolchainError> {
    let mut command = script::command(environment, "capture.py");
    command.args(options.arguments());
    script::run(&mut command, "filming", reporter, |line| reporter.note(line))
}

/// Lays out the pictures of a comparison in Blender's video sequence editor: writes `review.blend` beside the file
/// `layout`, the comparison's `review.json`. Returns the path of `review.blend`.
pub fn review(
    environment: &Environment,
    layout: &Path,
    reporter: &Reporter,
) -> Result<PathBuf, ToolchainError> {
    let mut command = script::command(environment, "review.py");
    command.arg(layout);
    script::run(&mut command, "review.blend", reporter, |_| ())?;
    Ok(layout.with_file_name("review.blend"))
}

/// Name of the JSON file, inside a temporary folder, to which the script writes a `.blend` file's camera path.
const PATH_FILE: &str = "path.json";

/// Reads the animated scene camera of a `.blend` file as a camera path. Returns the camera path in JSON, in the format
/// of `stlfr render --path`.
pub fn blend_path(
    environment: &Environment,
    blend: &Path,
    reporter: &Reporter,
) -> Result<String, ToolchainError> {
    let failed = |error| ToolchainError::Failure(format!("path.py: {error}"));
    let temporary = Temporary::inside(&std::env::temp_dir()).map_err(failed)?;
    let file = temporary.path().join(PATH_FILE);
    let mut command = script::command(environment, "path.py");
    command.arg(std::path::absolute(blend).map_err(failed)?).arg(&file);
    script::run(&mut command, "reading the camera's path", reporter, |_| ())?;
    read_text(&file, json::MAX_BYTES).map_err(failed)
}

/// Name of the Blender extension's zip file inside its temporary folder.
const EXTENSION_FILE: &str = "extension.zip";

/// Packages the Blender extension for this platform as the file `zip`, which contains the wheel of the Python module
/// `stlfr`. Blender's own tool validates the file.
pub fn build_extension(
    environment: &Environment,
    zip: &Path,
    reporter: &Reporter,
) -> Result<(), ToolchainError> {
    let failed =
        |error| ToolchainError::Failure(format!("{}: can't be written ({error})", zip.display()));
    setup::with_wheel(environment, reporter, |wheel| {
        let temporary = Temporary::for_file(zip).map_err(failed)?;
        let whole = temporary.path().join(EXTENSION_FILE);
        let mut command = script::command(environment, "package.py");
        command.arg(wheel).arg("-o").arg(&whole);
        let _phase = reporter.phase("packing the extension");
        let ended = script::ended(&mut command, |_| {});
        let ended = ended.map_err(|e| ToolchainError::Failure(format!("package.py: {e}")))?;
        script::verdict("package.py", &ended).map_err(|error| match error {
            // Blender's message contains the zip file's temporary path.
            ToolchainError::Failure(sentence) => ToolchainError::Failure(
                sentence.replace(&*whole.to_string_lossy(), &zip.to_string_lossy()),
            ),
            error => error,
        })?;
        temporary.place(EXTENSION_FILE, zip).map_err(failed)
    })
}
