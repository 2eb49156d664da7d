//! Sets up the pinned Python environment `.venv` of the project. The environment is created once. Its module `stlfr` is
//! built again when the library's sources change.
//!
//! The environment has two parts, the packages and the module. Each has a stamp file, which is written after the part
//! is complete. The stamp of the packages is a hash of the pinned versions, the Python version and the folder's path.
//! The stamp of the module is a hash of its sources. A part whose installation was interrupted has no stamp, and is
//! installed again. If another process is setting up the environment, a file lock makes this process wait.

mod install;
mod stamp;
mod system;

use super::ToolchainError;
use crate::progress::Reporter;
use crate::video::ffmpeg_on_path;
use install::Installer;
use stamp::Stamps;
use std::fs::File;
use std::io::{Error, ErrorKind};
use std::path::{Path, PathBuf};

/// The Python environment of the project.
#[derive(Clone, Debug)]
pub struct Environment {
    /// Folder of stlfr's sources, which contains the environment.
    pub project_root: PathBuf,
    /// Path of the environment's Python interpreter.
    pub python: PathBuf,
}

/// Returns the error of a failed file operation. If write permission is missing, the error's sentence has the command
/// that gives it.
fn file_error(path: &Path, source: Error) -> ToolchainError {
    ToolchainError::Failure(match source.kind() {
        ErrorKind::PermissionDenied | ErrorKind::ReadOnlyFilesystem => {
            let folder = path.parent().unwrap_or(path).display();
            format!(
                "{folder} can't be written to; make it yours with: sudo chown -R \"$USER\" '{folder}'"
            )
        }
        _ => format!("{}: {source}", path.display()),
    })
}

/// Returns the path of the first entry of a folder whose name passes a test. `None` if there is no such entry.
fn entry(folder: &Path, passes: impl Fn(&str) -> bool) -> Option<PathBuf> {
    let mut paths = std::fs::read_dir(folder).ok()?.filter_map(|entry| Some(entry.ok()?.path()));
    paths.find(|path| path.file_name().is_some_and(|name| passes(&name.to_string_lossy())))
}

impl Environment {
    /// Returns the Python environment of the project in this folder if its packages are installed, otherwise `None`.
    /// Nothing is installed.
    pub fn find(project_root: &Path) -> Option<Self> {
        let stamps = Stamps::read(project_root).ok()?;
        stamps.packages.found.then(|| Self::inside(project_root))
    }

    /// Returns the paths of the project's Python environment, whether it is installed or not.
    fn inside(project_root: &Path) -> Self {
        let python = project_root.join(".venv/bin/python");
        Self { project_root: project_root.to_owned(), python }
    }
}

/// Returns the folder of stlfr's sources: the value of `STLFR_HOME` if it is set, otherwise the folder in which this
/// program was built. A program that was built with the feature `portable` needs `STLFR_HOME`.
///
/// # Errors
/// If the folder is unknown, or doesn't contain stlfr's sources.
pub fn project_root() -> Result<PathBuf, ToolchainError> {
    let built_in = (!cfg!(feature = "portable")).then(|| env!("CARGO_MANIFEST_DIR").into());
    let Some(root) = std::env::var_os("STLFR_HOME").or(built_in).map(PathBuf::from) else {
        return Err(ToolchainError::Failure(
            "this command needs stlfr's source folder; set STLFR_HOME to where it is".into(),
        ));
    };
    match root.canonicalize() {
        Ok(real) if real.join("blender/requirements.txt").is_file() => Ok(real),
        _ => Err(ToolchainError::Failure(format!(
            "{} is not stlfr's source folder; set STLFR_HOME to where it is",
            root.display()
        ))),
    }
}

/// Returns the path of the system's ffmpeg, or else of the ffmpeg in the project's environment. `None` if there is
/// neither.
pub fn find_ffmpeg() -> Option<PathBuf> {
    ffmpeg_on_path().or_else(|| {
        let binaries = ".venv/lib/python3.11/site-packages/imageio_ffmpeg/binaries";
        entry(&project_root().ok()?.join(binaries), |name| name.starts_with("ffmpeg-"))
    })
}

/// Creates the Python environment, or installs its missing parts. If the environment is complete, the call takes
/// milliseconds and does not start Python.
pub fn ensure_environment(
    project_root: &Path,
    reporter: &Reporter,
) -> Result<Environment, ToolchainError> {
    let environment = Environment::inside(project_root);
    if Stamps::read(project_root)?.is_whole() {
        return Ok(environment);
    }
    let _lock = lock(project_root, reporter)?;
    let stamps = Stamps::read(project_root)?; // another process may have installed the parts meanwhile
    if !stamps.is_whole() {
        Installer::new(&environment, reporter).install(&stamps)?;
    }
    Ok(environment)
}

/// Builds a wheel of the Python module, calls a function with the wheel's path, and removes the wheel. Returns the
/// function's result.
pub(super) fn with_wheel<T>(
    environment: &Environment,
    reporter: &Reporter,
    call: impl FnOnce(&Path) -> Result<T, ToolchainError>,
) -> Result<T, ToolchainError> {
    let _lock = lock(&environment.project_root, reporter)?;
    let wheel = Installer::new(environment, reporter).build_module()?;
    let result = call(&wheel);
    // If removal fails, the next build replaces the files.
    let _ = wheel.parent().map(std::fs::remove_dir_all);
    result
}

/// Locks the environment for this process until the returned file is dropped. Waits if another process holds the lock.
fn lock(project_root: &Path, reporter: &Reporter) -> Result<File, ToolchainError> {
    let path = project_root.join(".venv.lock");
    let file = File::create(&path).map_err(|e| file_error(&path, e))?;
    if file.try_lock().is_err() {
        reporter.note("Another command sets up Python in this folder; this one waits for it.");
        let _phase = reporter.phase("waiting for another set-up");
        file.lock().map_err(|e| file_error(&path, e))?;
    }
    Ok(file)
}
