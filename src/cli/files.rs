//! Files that the command line names: checked before long work, in one sentence each.

use super::CliError;
use super::values::method;
use std::path::{Path, PathBuf};
use stlfr::camera::{Camera, CameraFormat};
use stlfr::capture::{CAPTURE_FILE, Capture, FilmedCamera, Opening};
use stlfr::json;
use stlfr::options::{Preset, RenderOptions};
use stlfr::progress::Reporter;
use stlfr::toolchain::find_ffmpeg;

/// Refuses what is no readable file.
pub fn must_be_a_file(path: &Path) -> Result<(), CliError> {
    match std::fs::metadata(path) {
        Ok(metadata) if metadata.is_file() => Ok(()),
        Ok(_) => Err(CliError::BadInput(format!("{}: is no file", path.display()))),
        Err(error) => Err(wrong(path, error)),
    }
}

/// Refuses an output whose folder, or the nearest one above that exists, can't be written to.
pub fn must_be_writable(output: &Path) -> Result<(), CliError> {
    let absolute = std::path::absolute(output).map_err(|e| wrong(output, e))?;
    // The output itself counts where it is a folder already. What is there and is no folder can't
    // have the output in it.
    let nearest = absolute.ancestors().find(|p| p.is_dir() || (p.exists() && *p != absolute));
    let Some(folder) = nearest.filter(|p| p.is_dir()) else {
        return Err(CliError::BadInput(format!("{}: has no folder to be in", output.display())));
    };
    let probe = folder.join(format!(".stlfr-{}.tmp", std::process::id()));
    let result = std::fs::File::create(&probe).and_then(|_| std::fs::remove_file(&probe));
    result.map_err(|error| {
        CliError::BadInput(format!("{}: can't be written ({error})", output.display()))
    })
}

/// Refuses a file that can't be written, or that would take the place of a frame of the capture or
/// of its description.
pub fn must_be_writable_beside(output: &Path, capture: &Capture) -> Result<(), CliError> {
    must_be_writable(output)?;
    if output.is_dir() {
        return Err(CliError::BadInput(format!("{}: is a folder", output.display())));
    }
    let there = output.canonicalize().ok();
    let is_frame = |path: &PathBuf| {
        let of = |c: &FilmedCamera| {
            c.frames.contains(path) || c.video.as_ref().is_some_and(|v| v.path == *path)
        };
        capture.cameras.iter().any(of)
    };
    let description = capture.folder.join(CAPTURE_FILE).canonicalize().ok();
    if there.is_some() && there == description {
        return Err(CliError::BadInput(format!(
            "{}: describes the capture, and is not written over",
            output.display()
        )));
    }
    if there.is_some_and(|path| is_frame(&path)) {
        return Err(CliError::BadInput(format!(
            "{}: is a frame of the capture, which is not written over",
            output.display()
        )));
    }
    Ok(())
}

/// Opens a capture, whose cameras may be videos.
pub fn open_capture(folder: &Path, reporter: &Reporter) -> Result<Capture, CliError> {
    let ffmpeg = find_ffmpeg();
    Ok(Capture::open_with(folder, &Opening { ffmpeg: ffmpeg.as_deref(), reporter })?)
}

/// What every stage's options start from.
#[derive(Debug, clap::Args)]
pub struct OptionsArgs {
    /// Named options of all stages: a point of the trade of speed for accuracy.
    #[arg(long, value_name = "NAME", value_parser = method::<Preset>())]
    preset: Option<Preset>,
    /// Options of all stages, a JSON file; what it has goes before the preset.
    #[arg(long, value_name = "FILE")]
    options: Option<PathBuf>,
}

impl OptionsArgs {
    /// The file's options, those of the preset where it has none, checked.
    pub fn read(&self) -> Result<RenderOptions, CliError> {
        match &self.options {
            Some(path) => read_options(path, self.preset),
            None => Ok(self.preset.map_or_else(RenderOptions::default, Preset::options)),
        }
    }
}

/// A JSON file of options, checked; the defaults without one.
pub fn options_or_default(path: Option<&Path>) -> Result<RenderOptions, CliError> {
    path.map_or_else(|| Ok(RenderOptions::default()), |path| read_options(path, None))
}

fn read_options(path: &Path, preset: Option<Preset>) -> Result<RenderOptions, CliError> {
    let text = json::read_text(path).map_err(|error| wrong(path, error))?;
    let options = RenderOptions::parse(&text, preset).map_err(|error| wrong(path, error))?;
    options.check().map_err(|error| wrong(path, error))?;
    Ok(options)
}

/// A view to render.
pub fn read_view(path: &Path) -> Result<Camera, CliError> {
    let format: CameraFormat = json::read(path).map_err(|error| wrong(path, error))?;
    format.camera().map_err(|error| wrong(path, error))
}

fn wrong(path: &Path, error: impl std::fmt::Display) -> CliError {
    CliError::BadInput(format!("{}: {error}", path.display()))
}

#[cfg(test)]
mod tests {
    use super::*;

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
        for (result, field) in
            [(view("FISHEYE", ""), "model"), (view("PINHOLE", r#", "fov": 1"#), "fov")]
        {
            let message = result.unwrap_err().to_string();
            assert!(message.contains("view.json") && message.contains(field), "{message}");
        }
        assert!(read_view(Path::new("/nowhere.json")).is_err());
    }

    #[test]
    fn outputs_are_tried() {
        let folder = tempfile::tempdir().unwrap();
        must_be_writable(&folder.path().join("a/b/c.png")).unwrap();
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
        assert!(must_be_writable(Path::new("/proc/none/c.png")).is_err());
        std::fs::write(folder.path().join("file"), "").unwrap();
        must_be_writable(&folder.path().join("file")).unwrap();
        assert!(must_be_writable(&folder.path().join("file/c.png")).is_err());
    }
}
