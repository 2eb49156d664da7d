//! Runs a Python script of the folder `blender/`. A line of JSON `{"done", "total", "what"}` on the script's stdout
//! reports progress, and may have a `note` for the user. Other lines of stdout are output. An error is one sentence on
//! stderr. The exit code is 2 for invalid input.

use super::ToolchainError;
use super::setup::Environment;
use crate::host::process::{self, Ended};
use crate::host::temporary::Temporary;
use crate::progress::{Reporter, Task};
use serde::Deserialize;
use std::process::Command;

#[derive(Deserialize)]
struct Progress {
    done: usize,
    total: usize,
    what: String,
    /// Sentence that is shown to the user; `None` if there is nothing to say.
    #[serde(default)]
    note: Option<String>,
}

/// Returns the command that runs a Python script of the folder `blender/`. Python's isolated mode is used, so that the
/// user's own packages and Python's environment variables have no effect.
pub(super) fn command(environment: &Environment, script: &str) -> Command {
    let mut command = Command::new(&environment.python);
    command.arg("-I").arg(environment.project_root.join("blender").join(script));
    command
}

/// Runs a script to its end, with a progress bar. Calls `on_text` with each line of output that doesn't report
/// progress.
pub(super) fn run(
    command: &mut Command,
    label: &str,
    reporter: &Reporter,
    mut on_text: impl FnMut(&str),
) -> Result<(), ToolchainError> {
    let waiting = reporter.phase(label);
    let mut bar: Option<Task> = None;
    let ended = ended(command, |line| match serde_json::from_str::<Progress>(line) {
        Ok(progress) => {
            progress.note.iter().for_each(|note| reporter.note(note));
            let bar = bar.get_or_insert_with(|| {
                waiting.hide();
                let bar = reporter.task(label, progress.total);
                bar.resume_at(progress.done);
                bar
            });
            bar.describe(&format!("{label}: {}", progress.what));
            bar.set(progress.done);
        }
        Err(_) => on_text(line),
    });
    drop(bar);
    drop(waiting);
    let name = command.get_args().nth(1).unwrap_or_default().to_string_lossy().into_owned();
    let ended = ended.map_err(|e| ToolchainError::Failure(format!("{name}: {e}")))?;
    verdict(&name, &ended)
}

/// Runs a script to its end, and calls `on_line` with every line of its stdout. Then removes the script's temporary
/// folder, in which Blender leaves files if it is killed.
pub(super) fn ended(command: &mut Command, on_line: impl FnMut(&str)) -> std::io::Result<Ended> {
    let temporary = Temporary::inside(&std::env::temp_dir())?;
    process::run(command.env("TMPDIR", temporary.path()), on_line)
}

/// Returns the error of a finished script: the last line of its stderr. Returns success if its exit code is 0. `name`
/// is the script's name.
pub(super) fn verdict(name: &str, ended: &Ended) -> Result<(), ToolchainError> {
    let sentence = || ended.stderr.lines().rev().find(|l| !l.trim().is_empty()).map(str::to_owned);
    match ended.status.code() {
        Some(0) => Ok(()),
        Some(2) => Err(ToolchainError::BadInput(
            sentence().unwrap_or_else(|| format!("{name}: bad input")),
        )),
        Some(code) => Err(ToolchainError::Failure(
            sentence().unwrap_or_else(|| format!("{name}: ended with status {code}")),
        )),
        None => Err(ToolchainError::Failure(format!("{name}: was stopped ({})", ended.status))),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(script: &str) -> (Result<(), ToolchainError>, Vec<String>) {
        let mut text = Vec::new();
        let result =
            run(Command::new("sh").arg("-c").arg(script), "test", &Reporter::silent(), |l| {
                text.push(l.to_owned());
            });
        (result, text)
    }

    #[test]
    fn progress_is_told_from_text() {
        let (result, text) =
            of(r#"echo '{"done": 1, "total": 2, "what": "x"}'; echo table; echo '{"done": 2}'"#);
        result.unwrap();
        assert_eq!(text, ["table", r#"{"done": 2}"#]);
    }

    #[test]
    fn errors_are_the_scripts_sentence_and_kind() {
        let bad = of("echo traceback >&2; echo 'rig.json: no cameras' >&2; exit 2").0.unwrap_err();
        assert!(
            matches!(&bad, ToolchainError::BadInput(s) if s == "rig.json: no cameras"),
            "{bad}"
        );
        let failed = of("echo 'disk is full' >&2; exit 1").0.unwrap_err();
        assert!(matches!(&failed, ToolchainError::Failure(s) if s == "disk is full"), "{failed}");
        assert!(of("exit 7").0.unwrap_err().to_string().contains("status 7"));
        assert!(of("kill -9 $$").0.unwrap_err().to_string().contains("was stopped"));
    }

    #[test]
    fn a_killed_script_leaves_no_temporary_folder() {
        let (_, text) = of("echo $TMPDIR; mkdir $TMPDIR/blender_a; kill -9 $$");
        assert!(text[0].ends_with(".tmp") && !std::path::Path::new(&text[0]).exists(), "{text:?}");
    }
}
