//! Installs the missing parts of the Python environment, and shows progress.

use super::{Environment, Stamps, entry, file_error, system};
use crate::host::process::{self, Ended};
use crate::host::{ignore_absent, write_atomically};
use crate::progress::Reporter;
use crate::toolchain::ToolchainError;
use std::path::{Path, PathBuf};
use std::process::Command;

/// Python program that imports all packages in one process, to check that the module `stlfr` loads together with
/// Blender's module `bpy`.
const IMPORTS: &str = "import bpy, pycolmap, numpy, stlfr";

/// Name of the set-up step that builds the Python module, for progress and errors.
const BUILDING: &str = "building the Python module stlfr";

/// An installation of the Python environment in progress. The caller must hold the environment's lock.
pub(super) struct Installer<'a> {
    root: &'a Path,
    python: &'a Path,
    venv: PathBuf,
    /// Temporary folder for the wheel of the Python module.
    wheels: PathBuf,
    reporter: &'a Reporter,
}

impl<'a> Installer<'a> {
    pub fn new(environment: &'a Environment, reporter: &'a Reporter) -> Self {
        let Environment { project_root: root, python } = environment;
        let venv = root.join(".venv");
        Self { root, python, wheels: venv.join("wheels"), venv, reporter }
    }

    /// Installs all parts of the Python environment that lack a valid stamp. A stamp is a file that marks a part as
    /// complete.
    pub fn install(&self, stamps: &Stamps) -> Result<(), ToolchainError> {
        let wheel = if stamps.packages.found {
            self.reporter.note("Building the Python module stlfr: its sources have changed.");
            stamps.module.remove()?;
            self.build_module()?
        } else {
            self.reporter.note(
                "Setting up Python in .venv, once: Blender, COLMAP and what else it needs, 1 GB or so.",
            );
            self.make_venv()?;
            self.install_packages_and_build()?
        };
        self.install_module(&wheel)?;
        self.try_imports()?;
        stamps.module.write()?;
        self.reporter.note("The Python environment is ready.");
        Ok(())
    }

    /// Creates an empty virtual environment `.venv` of Python. An earlier one is deleted first.
    fn make_venv(&self) -> Result<(), ToolchainError> {
        let base_python = system::find_python()?;
        // The folder is created here, not by Python, so that missing write permission has its own error.
        ignore_absent(std::fs::remove_dir_all(&self.venv))
            .and_then(|()| std::fs::create_dir(&self.venv))
            .map_err(|e| file_error(&self.venv, e))?;
        let mut command = Command::new(base_python);
        command.args(["-I", "-m", "venv"]).arg(&self.venv);
        self.step("making the Python environment", &mut command)
    }

    /// Installs the build tool maturin, and then the other packages while the Python module compiles. Returns the path
    /// of the module's wheel.
    fn install_packages_and_build(&self) -> Result<PathBuf, ToolchainError> {
        let requirements = self.root.join("blender/requirements.txt");
        let mut tool = self.pip();
        tool.arg("--constraint").arg(&requirements).arg("maturin");
        self.step("installing maturin", &mut tool)?;
        std::thread::scope(|scope| {
            let build = scope.spawn(|| self.build_module());
            let mut packages = self.pip();
            packages.arg("--requirement").arg(&requirements);
            self.step("installing the Python packages", &mut packages)?;
            Stamps::read(self.root)?.packages.write()?;
            build.join().expect("building does not panic")
        })
    }

    /// Builds the wheel of the Python module from this source tree, in a temporary folder of the environment. Returns
    /// the wheel's path. The caller must remove the folder.
    pub fn build_module(&self) -> Result<PathBuf, ToolchainError> {
        ignore_absent(std::fs::remove_dir_all(&self.wheels))
            .map_err(|e| file_error(&self.wheels, e))?;
        let mut command = Command::new(self.venv.join("bin/maturin"));
        command.args(["build", "--release", "--locked", "--quiet", "--interpreter"]);
        // A separate target folder, because builds with and without the Python feature would replace each other.
        let target = self.root.join("target/python");
        command.arg(self.python).arg("--out").arg(&self.wheels).arg("--target-dir").arg(target);
        self.step(BUILDING, command.current_dir(self.root.join("blender")))?;
        let wheel = entry(&self.wheels, |name| name.ends_with(".whl"));
        wheel.ok_or_else(|| step_failed(BUILDING, "it made no wheel", &self.wheels))
    }

    fn install_module(&self, wheel: &Path) -> Result<(), ToolchainError> {
        let mut command = self.pip();
        command.args(["--no-deps", "--force-reinstall"]).arg(wheel);
        self.step("installing the Python module stlfr", &mut command)?;
        std::fs::remove_dir_all(&self.wheels).map_err(|e| file_error(&self.wheels, e))
    }

    /// Imports all packages in one Python process, to find missing system libraries.
    fn try_imports(&self) -> Result<(), ToolchainError> {
        let mut command = Command::new(self.python);
        command.args(["-I", "-c", IMPORTS]);
        self.explained_step("importing the Python packages", &mut command, |stderr| {
            system::missing_library(self.root, stderr)
        })
    }

    fn pip(&self) -> Command {
        let mut command = Command::new(self.python);
        command
            .args(["-I", "-m", "pip", "install", "--disable-pip-version-check", "--no-input"])
            // Python compiles each module when it is first imported. Compiling all of them now would take
            // longer.
            .args(["--no-compile", "--progress-bar", "off"]);
        command
    }

    fn step(&self, what: &str, command: &mut Command) -> Result<(), ToolchainError> {
        self.explained_step(what, command, |_| None)
    }

    /// Runs a command as the set-up step `what`. The names of files that the command downloads are shown as progress.
    ///
    /// # Errors
    /// If the command fails: the error that `explain` returns for the command's stderr. If `explain` returns `None`: an
    /// error with the most informative line of stderr, and with the path of a log of all output.
    fn explained_step(
        &self,
        what: &str,
        command: &mut Command,
        explain: impl Fn(&str) -> Option<ToolchainError>,
    ) -> Result<(), ToolchainError> {
        let phase = self.reporter.phase(what);
        let mut output = String::new();
        let ended = process::run(command, |line| {
            // A line such as "Downloading bpy-5.0.1-….whl (400 MB)" tells the user why this takes long.
            if let Some(file) = line.trim().strip_prefix("Downloading ") {
                let file = file.rsplit('/').next().unwrap_or(file);
                phase.describe(&format!("{what}: {}", file.chars().take(60).collect::<String>()));
            }
            output.push_str(line);
            output.push('\n');
        });
        let ended = ended.map_err(|e| {
            ToolchainError::Failure(format!("{}: {e}", Path::new(command.get_program()).display()))
        })?;
        if ended.status.success() {
            return Ok(());
        }
        Err(explain(&ended.stderr).unwrap_or_else(|| {
            let log = self.root.join(".venv.log");
            let text = format!("{command:?}\n{}\n{output}\n{}", ended.status, ended.stderr);
            // The log is optional, since the returned sentence states the error.
            let _ = write_atomically(&log, text.as_bytes());
            step_failed(what, &reason(&ended), &log)
        }))
    }
}

fn step_failed(what: &str, reason: &str, log: &Path) -> ToolchainError {
    let log = log.display();
    ToolchainError::Failure(format!("{what} failed: {reason} (all of its output is in {log})"))
}

/// Returns the most informative line of a failed command's stderr: the last line that starts with "error", or else the
/// last line. If stderr is empty, returns the exit status.
fn reason(ended: &Ended) -> String {
    let lines = || ended.stderr.lines().rev().map(str::trim).filter(|l| !l.is_empty());
    lines()
        .find(|l| l.to_lowercase().starts_with("error"))
        .or_else(|| lines().next())
        .map_or_else(|| ended.status.to_string(), str::to_owned)
}
