//! Installs the missing parts of the environment, with progress.

use super::{Environment, SetupError, Stamps, interpreter, module, system};
use crate::host::process::{self, Ended};
use crate::host::write_atomically;
use crate::progress::Reporter;
use std::path::{Path, PathBuf};
use std::process::Command;

/// All packages in one process: the module must load beside Blender.
const IMPORTS: &str = "import bpy, pycolmap, numpy, stlfr";

/// An installation in progress. The caller holds the lock.
struct Installer<'a> {
    root: &'a Path,
    python: &'a Path,
    venv: PathBuf,
    requirements: PathBuf,
    /// Temporary folder of the built wheel.
    wheels: PathBuf,
    reporter: &'a Reporter,
}

/// Completes the environment. The caller holds the lock.
pub(super) fn install(
    environment: &Environment,
    stamps: &Stamps,
    reporter: &Reporter,
) -> Result<(), SetupError> {
    let installer = Installer::new(environment, reporter);
    if stamps.has_packages() {
        reporter.note("Building the Python module stlfr: its sources have changed.");
        stamps.remove_module()?;
        installer.build_module()?;
    } else {
        reporter.note(
            "Setting up Python in .venv, once: Blender, COLMAP and what else it needs, 1 GB or so.",
        );
        installer.make_venv()?;
        installer.install_packages_and_build()?;
    }
    installer.install_module()?;
    installer.try_imports()?;
    stamps.write_module()?;
    reporter.note("The Python environment is ready.");
    Ok(())
}

/// Builds the wheel of the Python module into a folder of the environment, which the caller removes. The
/// caller holds the lock.
pub(super) fn build_wheel(
    environment: &Environment,
    reporter: &Reporter,
) -> Result<PathBuf, SetupError> {
    let installer = Installer::new(environment, reporter);
    installer.build_module()?;
    installer.wheel()
}

impl<'a> Installer<'a> {
    fn new(environment: &'a Environment, reporter: &'a Reporter) -> Self {
        let root = environment.project_root.as_path();
        let venv = root.join(".venv");
        Self {
            root,
            python: &environment.python,
            wheels: venv.join("wheels"),
            venv,
            requirements: root.join("blender/requirements.txt"),
            reporter,
        }
    }

    /// The wheel that was built.
    fn wheel(&self) -> Result<PathBuf, SetupError> {
        module::wheel_in(&self.wheels).ok_or_else(|| SetupError::Step {
            what: "building the Python module stlfr",
            reason: "it made no wheel".into(),
            log: self.wheels.clone(),
        })
    }

    /// Creates an empty environment in place of an earlier one.
    fn make_venv(&self) -> Result<(), SetupError> {
        let base_python = interpreter::find()?;
        match std::fs::remove_dir_all(&self.venv) {
            Err(e) if e.kind() != std::io::ErrorKind::NotFound => {
                return Err(SetupError::file(&self.venv, e));
            }
            _ => {}
        }
        // By hand, so that the right to write is told from a Python that fails.
        std::fs::create_dir(&self.venv).map_err(|e| SetupError::file(&self.venv, e))?;
        let mut command = Command::new(base_python);
        command.args(["-I", "-m", "venv"]).arg(&self.venv);
        self.step("making the Python environment", &mut command).map(drop)
    }

    /// Installs the build tool, then the other packages while the module compiles.
    fn install_packages_and_build(&self) -> Result<(), SetupError> {
        let mut tool = self.pip();
        tool.arg("--constraint").arg(&self.requirements).arg("maturin");
        self.step("installing maturin", &mut tool)?;
        std::thread::scope(|scope| {
            let build = scope.spawn(|| self.build_module());
            let mut packages = self.pip();
            packages.arg("--requirement").arg(&self.requirements);
            self.step("installing the Python packages", &mut packages)?;
            Stamps::read(self.root)?.write_packages()?;
            build.join().expect("building does not panic")
        })
    }

    fn build_module(&self) -> Result<(), SetupError> {
        let mut command = module::build_command(self.root, self.python, &self.wheels);
        if self.wheels.exists() {
            std::fs::remove_dir_all(&self.wheels).map_err(|e| SetupError::file(&self.wheels, e))?;
        }
        self.step("building the Python module stlfr", &mut command).map(drop)
    }

    fn install_module(&self) -> Result<(), SetupError> {
        let wheel = self.wheel()?;
        let mut command = self.pip();
        command.args(["--no-deps", "--force-reinstall"]).arg(wheel);
        self.step("installing the Python module stlfr", &mut command)?;
        std::fs::remove_dir_all(&self.wheels).map_err(|e| SetupError::file(&self.wheels, e))
    }

    /// Imports all packages in one process, which finds missing system libraries.
    fn try_imports(&self) -> Result<(), SetupError> {
        let mut command = Command::new(self.python);
        command.args(["-I", "-c", IMPORTS]);
        let what = "importing the Python packages";
        let (ended, output) = self.run(what, &mut command)?;
        if ended.status.success() {
            return Ok(());
        }
        Err(system::missing_library(self.root, &ended.stderr)
            .unwrap_or_else(|| self.failed(what, &command, &ended, &output)))
    }

    fn pip(&self) -> Command {
        let mut command = Command::new(self.python);
        command
            .args(["-I", "-m", "pip", "install", "--disable-pip-version-check", "--no-input"])
            // Compiled when first imported; all at once takes longer than all that is ever used.
            .args(["--no-compile", "--progress-bar", "off"]);
        command
    }

    /// Runs a command; its failure is an error.
    fn step(&self, what: &'static str, command: &mut Command) -> Result<Ended, SetupError> {
        let (ended, output) = self.run(what, command)?;
        if ended.status.success() {
            Ok(ended)
        } else {
            Err(self.failed(what, command, &ended, &output))
        }
    }

    /// Runs a command, with its last line of output shown as progress.
    fn run(
        &self,
        what: &'static str,
        command: &mut Command,
    ) -> Result<(Ended, String), SetupError> {
        let phase = self.reporter.phase(what);
        let mut output = String::new();
        let ended = process::run(command, |line| {
            // "Downloading bpy-5.0.1-….whl (400 MB)" says what takes so long.
            if let Some(file) = line.trim().strip_prefix("Downloading ") {
                let file = file.rsplit('/').next().unwrap_or(file);
                phase.describe(&format!("{what}: {}", file.chars().take(60).collect::<String>()));
            }
            output.push_str(line);
            output.push('\n');
        });
        match ended {
            Ok(ended) => Ok((ended, output)),
            Err(source) => {
                Err(SetupError::File { path: PathBuf::from(command.get_program()), source })
            }
        }
    }

    fn failed(
        &self,
        what: &'static str,
        command: &Command,
        ended: &Ended,
        output: &str,
    ) -> SetupError {
        let log = self.root.join(".venv.log");
        let text = format!("{command:?}\n{}\n{output}\n{}", ended.status, ended.stderr);
        // The log only adds to the sentence that is returned.
        let _ = write_atomically(&log, text.as_bytes());
        SetupError::Step { what, reason: reason(ended), log }
    }
}

/// The most informative line of stderr: the last that names an error, else the last. Without output,
/// the exit status.
fn reason(ended: &Ended) -> String {
    let lines = || ended.stderr.lines().rev().map(str::trim).filter(|l| !l.is_empty());
    lines()
        .find(|l| l.to_lowercase().starts_with("error"))
        .or_else(|| lines().next())
        .map_or_else(|| ended.status.to_string(), str::to_owned)
}
