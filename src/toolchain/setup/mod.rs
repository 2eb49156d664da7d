//! The pinned Python environment `.venv` of the project: created once; its `stlfr` module is built
//! again when the library's sources change.
//!
//! Two stamp files record what is complete, each written last. The packages' stamp is a hash of the
//! pinned versions, the Python and the folder; the module's stamp is a hash of its sources. A part that
//! was interrupted has no stamp, and is done again. A file lock makes a second set-up wait.

mod install;
mod interpreter;
mod module;
mod stamp;
mod system;

use crate::progress::Reporter;
use crate::video::ffmpeg_on_path;
use stamp::Stamps;
use std::fs::File;
use std::path::{Path, PathBuf};

/// A complete environment.
#[derive(Clone, Debug)]
pub struct Environment {
    pub project_root: PathBuf,
    /// Its Python interpreter.
    pub python: PathBuf,
}

/// Why the set-up failed: one sentence, with the command that helps if there is one.
#[derive(Debug, thiserror::Error)]
pub enum SetupError {
    #[error("{0} is not stlfr's source folder; set STLFR_HOME to where it is")]
    NoProject(PathBuf),
    #[error("Python 3.11 is not installed; on Debian: {0}")]
    NoPython(String),
    #[error("{python} can't make environments; on Debian: {line}")]
    NoVenv { python: String, line: String },
    #[error("{0} can't be written to; make it yours with: sudo chown -R \"$USER\" '{0}'")]
    NotWritable(PathBuf),
    #[error("{path}: {source}")]
    File { path: PathBuf, source: std::io::Error },
    #[error("Blender needs {library}, which this system lacks; on Debian: {line}")]
    NoLibrary { library: String, line: String },
    #[error("{what} failed: {reason} (all of its output is in {log})")]
    Step { what: &'static str, reason: String, log: PathBuf },
}

impl SetupError {
    /// A failed file operation; missing write permission is a variant of its own.
    fn file(path: &Path, source: std::io::Error) -> Self {
        use std::io::ErrorKind::{PermissionDenied, ReadOnlyFilesystem};
        match source.kind() {
            PermissionDenied | ReadOnlyFilesystem => {
                Self::NotWritable(path.parent().unwrap_or(path).to_owned())
            }
            _ => Self::File { path: path.to_owned(), source },
        }
    }
}

impl Environment {
    /// The environment if its packages are installed. This installs nothing.
    pub fn find(project_root: &Path) -> Option<Self> {
        let stamps = Stamps::read(project_root).ok()?;
        stamps.has_packages().then(|| Self {
            project_root: project_root.to_owned(),
            python: project_root.join(".venv/bin/python"),
        })
    }
}

/// The folder of stlfr's sources: `STLFR_HOME`, or where this program was built.
pub fn project_root() -> Result<PathBuf, SetupError> {
    let root = std::env::var_os("STLFR_HOME")
        .map_or_else(|| PathBuf::from(env!("CARGO_MANIFEST_DIR")), PathBuf::from);
    match root.canonicalize() {
        Ok(real) if real.join("blender/requirements.txt").is_file() => Ok(real),
        _ => Err(SetupError::NoProject(root)),
    }
}

/// The system's ffmpeg, else that of the project's environment.
pub fn find_ffmpeg() -> Option<PathBuf> {
    ffmpeg_on_path().or_else(|| environment_ffmpeg(&project_root().ok()?))
}

/// The ffmpeg of the package `imageio-ffmpeg`.
fn environment_ffmpeg(project_root: &Path) -> Option<PathBuf> {
    let folder = project_root.join(".venv/lib/python3.11/site-packages/imageio_ffmpeg/binaries");
    std::fs::read_dir(folder).ok()?.filter_map(|entry| Some(entry.ok()?.path())).find(|path| {
        path.file_name().is_some_and(|name| name.to_string_lossy().starts_with("ffmpeg-"))
    })
}

/// Creates the environment, or its missing parts. If it is complete, this takes milliseconds and starts
/// no Python.
pub fn ensure_environment(
    project_root: &Path,
    reporter: &Reporter,
) -> Result<Environment, SetupError> {
    let environment = Environment {
        project_root: project_root.to_owned(),
        python: project_root.join(".venv/bin/python"),
    };
    if Stamps::read(project_root)?.is_whole() {
        return Ok(environment);
    }
    let _lock = lock(project_root, reporter)?;
    let stamps = Stamps::read(project_root)?; // the one who held the lock may have done it
    if !stamps.is_whole() {
        install::install(&environment, &stamps, reporter)?;
    }
    Ok(environment)
}

/// A built wheel of the Python module; dropping it removes the file.
pub(super) struct Wheel {
    pub path: PathBuf,
    _lock: File,
}

impl Wheel {
    pub fn build(environment: &Environment, reporter: &Reporter) -> Result<Self, SetupError> {
        let lock = lock(&environment.project_root, reporter)?;
        Ok(Self { path: install::build_wheel(environment, reporter)?, _lock: lock })
    }
}

impl Drop for Wheel {
    fn drop(&mut self) {
        // What is left is made anew by the next build.
        let _ = self.path.parent().map(std::fs::remove_dir_all);
    }
}

/// Locks the environment for one process, until the file is dropped.
fn lock(project_root: &Path, reporter: &Reporter) -> Result<File, SetupError> {
    let path = project_root.join(".venv.lock");
    let file = File::create(&path).map_err(|e| SetupError::file(&path, e))?;
    if file.try_lock().is_err() {
        let _phase = reporter.phase("waiting for another set-up");
        file.lock().map_err(|e| SetupError::file(&path, e))?;
    }
    Ok(file)
}
