//! Checking and reading of files whose paths are given on the command line. Files are checked before long work starts.

use super::CliError;
use super::error::written;
use super::values::{ImageOutput, job_word, method};
use crate::camera::{Camera, ViewFormat};
use crate::capture::{Capture, Opening, OutputGuard};
use crate::host::{open_file, read_text, try_folder};
use crate::json;
use crate::method::Method;
use crate::options::{Preset, RenderOptions};
use crate::path::{CameraPath, PathFormat};
use crate::progress::Reporter;
use crate::text::printable;
use crate::toolchain::{Environment, blend_path, find_ffmpeg, project_root};
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Size limit of options files and view files, in bytes.
const MAX_BYTES: u64 = 1 << 20;

/// Returns an error unless `path` is a readable regular file.
pub fn must_be_a_file(path: &Path) -> Result<(), CliError> {
    open_file(path).map(drop).map_err(|error| wrong(path, error))
}

/// Opens a capture. The path of the command's output is checked first, because opening may decode videos for minutes.
/// `output` is `None` for a command without an output.
pub fn open_capture(
    folder: &Path,
    output: Option<CommandOutput>,
    reporter: &Reporter,
) -> Result<Arc<Capture>, CliError> {
    if let Some(output) = output {
        output.check(Some(folder))?;
    }
    let ffmpeg = find_ffmpeg();
    let opening = Opening { ffmpeg: ffmpeg.as_deref(), reporter };
    Ok(Arc::new(Capture::open_with(folder, &opening)?))
}

/// Returns the path of ffmpeg. `what` is the feature that needs ffmpeg, such as a flag; it is named in the error if
/// ffmpeg is not installed.
pub fn ffmpeg_for(what: &str) -> Result<PathBuf, CliError> {
    find_ffmpeg().ok_or_else(|| {
        CliError::Failure(format!("{what} needs ffmpeg: install it, or run stlfr setup"))
    })
}

/// Options of all stages: a preset, overridden by an options file, overridden by single options.
#[derive(Clone, Debug, clap::Args)]
pub struct OptionsArgs {
    /// Named options of all stages, from fast to accurate [default: best].
    #[arg(long, value_name = "NAME", value_parser = method::<Preset>())]
    preset: Option<Preset>,
    /// JSON file with options of all stages; it overrides the preset.
    #[arg(long, value_name = "FILE")]
    options: Option<PathBuf>,
    /// One option, such as blend.cameras=4; it overrides the file. See stlfr options.
    #[arg(long, value_name = "NAME=VALUE")]
    set: Vec<String>,
}

impl OptionsArgs {
    /// Returns the flags that give these options, as words of a command line.
    pub fn words(&self) -> Vec<String> {
        let preset = self.preset.iter().flat_map(|p| ["--preset".into(), p.name().into()]);
        let file = self.options.iter().flat_map(|f| ["--options".into(), f.display().to_string()]);
        let set = self.set.iter().flat_map(|s| ["--set".into(), s.clone()]);
        preset.chain(file).chain(set).collect()
    }

    /// Returns the flags that give these options, as words of a command line in a render-farm job. Paths are absolute,
    /// because the job runs in another folder.
    pub fn absolute_words(&self) -> Result<Vec<String>, CliError> {
        let mut options = self.clone();
        if let Some(file) = &mut options.options {
            *file = written(file, std::path::absolute(&*file))?;
            job_word(file)?;
        }
        Ok(options.words())
    }

    /// Returns whether no option is given, so that the default preset applies.
    pub fn are_default(&self) -> bool {
        self.words().is_empty()
    }

    /// Reads and checks the options.
    pub fn read(&self) -> Result<RenderOptions, CliError> {
        let mut options = match &self.options {
            Some(path) => {
                let text = read_text(path, MAX_BYTES).map_err(|error| wrong(path, error))?;
                RenderOptions::parse(&text, self.preset).map_err(|error| wrong(path, error))?
            }
            None => self.preset.unwrap_or_default().options(),
        };
        for set in &self.set {
            let (name, value) = set.split_once('=').unwrap_or((set, ""));
            let result = options.set(name.trim(), value.trim());
            result.map_err(|error| CliError::BadInput(format!("--set: {error}")))?;
        }
        Ok(options)
    }
}

/// Reads the camera of a view from a JSON file.
pub fn read_view(path: &Path) -> Result<Camera, CliError> {
    let text = read_text(path, MAX_BYTES).map_err(|error| wrong(path, error))?;
    let Named { format } = json::parse(&text).unwrap_or_default();
    if let Some(format) = format {
        let format = printable(&format);
        let error = format!("has the format {format}; a view is a camera, as in a capture.json");
        return Err(wrong(path, error));
    }
    let view: ViewFormat = json::parse(&text).map_err(|error| wrong(path, error))?;
    view.camera().map_err(|error| wrong(path, error))
}

/// The field `format` of a file of stlfr, such as a rig or a capture. A view has no such field.
#[derive(Default, serde::Deserialize)]
struct Named {
    #[serde(default)]
    format: Option<String>,
}

/// Reads a camera path from a JSON file.
pub fn read_path(path: &Path) -> Result<CameraPath, CliError> {
    let format: PathFormat = json::read(path).map_err(|error| wrong(path, error))?;
    format.path().map_err(|error| wrong(path, error))
}

/// Reads the path of the animated camera of a `.blend` file.
pub fn read_blend_path(path: &Path, reporter: &Reporter) -> Result<CameraPath, CliError> {
    must_be_a_file(path)?;
    let environment = project_root().ok().and_then(|root| Environment::find(&root));
    let environment = environment.ok_or_else(|| {
        CliError::Failure("a .blend needs Blender's Python package: run stlfr setup".into())
    })?;
    let text = blend_path(&environment, path, reporter)?;
    let format: PathFormat = json::parse(&text).map_err(|error| wrong(path, error))?;
    format.path().map_err(|error| wrong(path, error))
}

fn wrong(path: &Path, error: impl std::fmt::Display) -> CliError {
    CliError::BadInput(format!("{}: {error}", path.display()))
}

/// The files that a command writes, for the check before long work starts.
#[derive(Clone, Copy)]
pub enum CommandOutput<'a> {
    File(&'a Path),
    /// The path of one image or the pattern of a sequence, and the number of images.
    Images(&'a ImageOutput, usize),
    /// A folder, and the names of the files that the command writes into this folder.
    Folder(&'a Path, &'a [&'a str]),
    /// A folder that is a capture or becomes one.
    Capture(&'a Path),
}

impl CommandOutput<'_> {
    /// Returns an error if the output can't be written, would replace a part of a capture, or would replace anything
    /// but a regular file. `own` is the folder of the capture that the command reads.
    pub fn check(self, own: Option<&Path>) -> Result<(), CliError> {
        let mut guard = OutputGuard::new(own);
        let path = match self {
            Self::File(path) => guard.check_file(path).map(|()| path)?,
            Self::Folder(path, files) => guard.check_folder(path, files).map(|()| path)?,
            Self::Capture(path) => guard.check_capture(path).map(|()| path)?,
            Self::Images(output, images) => {
                let mut tried = None;
                for file in output.files(images) {
                    guard.check_file(&file)?;
                    let folder = file.parent().map(Path::to_owned);
                    if folder != tried {
                        must_be_writable(&file)?;
                        tried = folder;
                    }
                }
                return Ok(());
            }
        };
        must_be_writable(path)
    }
}

/// Returns an error if the nearest existing folder of the output isn't writable.
fn must_be_writable(output: &Path) -> Result<(), CliError> {
    let absolute = written(output, std::path::absolute(output))?;
    // The output may be an existing folder. A regular file in place of a parent folder is an error.
    let nearest = absolute.ancestors().find(|p| p.is_dir() || (p.exists() && *p != absolute));
    let Some(folder) = nearest.filter(|p| p.is_dir()) else {
        return Err(CliError::BadInput(format!("{}: has no folder to be in", output.display())));
    };
    written(output, try_folder(folder))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cli::values::ImageFile;

    #[test]
    fn views_name_file_and_field() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("view.json");
        let view = |model: &str, more: &str| {
            let json = format!(
                r#"{{"width": 64, "height": 48, "model": "{model}", "params": [64, 64, 32, 24],
                "cam_from_world": {{"rotation_wxyz": [1, 0, 0, 0], "translation": [0, 0, 0]}}{more}}}"#
            );
            std::fs::write(&path, json).unwrap();
            read_view(&path)
        };
        assert_eq!(view("PINHOLE", "").unwrap().width, 64);
        let filming =
            r#", "id": "a", "frames": "a/%d.png", "color": "rgb", "clock": {"shared": true}"#;
        assert_eq!(view("PINHOLE", filming).unwrap(), view("PINHOLE", "").unwrap());
        for (result, field) in
            [(view("FISH", ""), "model"), (view("PINHOLE", r#", "fov": 1"#), "fov")]
        {
            let message = result.unwrap_err().to_string();
            assert!(message.contains("view.json") && message.contains(field), "{message}");
        }
        assert!(read_view(Path::new("/nowhere.json")).is_err());
    }

    #[test]
    fn outputs_are_tried() {
        let folder = tempfile::tempdir().unwrap();
        let check = |path: &Path| CommandOutput::File(path).check(None);
        check(&folder.path().join("a/b/c.png")).unwrap();
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
        assert!(check(Path::new("/proc/none/c.png")).is_err());
        std::fs::write(folder.path().join("file"), "").unwrap();
        check(&folder.path().join("file")).unwrap();
        assert!(check(&folder.path().join("file/c.png")).is_err());
        assert!(CommandOutput::Folder(&folder.path().join("file"), &[]).check(None).is_err());
        let many = ImageOutput::Sequence(folder.path().join("many/%d.exr"), ImageFile::Exr);
        CommandOutput::Images(&many, 2).check(None).unwrap();
    }
}
