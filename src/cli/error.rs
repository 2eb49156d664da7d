//! Errors of the command line: one sentence on stderr, and an exit code.

use clap::error::ErrorKind;
use std::process::ExitCode;
use stlfr::capture::{CaptureError, TruthError};
use stlfr::compare::CompareError;
use stlfr::render::RenderError;
use stlfr::toolchain::{ScriptError, SetupError, VideoError};

/// What ends a command.
#[derive(Debug, thiserror::Error)]
pub enum CliError {
    /// Something given is wrong: exit code 2.
    #[error("{0}")]
    BadInput(String),
    /// The work failed: exit code 1.
    #[error("{0}")]
    Failure(String),
}

impl From<SetupError> for CliError {
    fn from(error: SetupError) -> Self {
        Self::Failure(error.to_string())
    }
}

impl From<ScriptError> for CliError {
    fn from(error: ScriptError) -> Self {
        match error {
            ScriptError::BadInput(sentence) => Self::BadInput(sentence),
            ScriptError::Failure(sentence) => Self::Failure(sentence),
        }
    }
}

impl From<CaptureError> for CliError {
    fn from(error: CaptureError) -> Self {
        Self::BadInput(error.to_string())
    }
}

impl From<TruthError> for CliError {
    fn from(error: TruthError) -> Self {
        Self::BadInput(error.to_string())
    }
}

/// What can't be rendered was asked for wrongly: a time outside, a view of nothing.
impl From<RenderError> for CliError {
    fn from(error: RenderError) -> Self {
        Self::BadInput(error.to_string())
    }
}

impl From<VideoError> for CliError {
    fn from(error: VideoError) -> Self {
        Self::Failure(error.to_string())
    }
}

impl From<CompareError> for CliError {
    fn from(error: CompareError) -> Self {
        match error {
            CompareError::Report(_) | CompareError::Video(_) => Self::Failure(error.to_string()),
            _ => Self::BadInput(error.to_string()),
        }
    }
}

/// Says what went wrong, if anything did.
pub fn exit(result: Result<(), CliError>) -> ExitCode {
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("{error}");
            ExitCode::from(match error {
                CliError::BadInput(_) => 2,
                CliError::Failure(_) => 1,
            })
        }
    }
}

/// Help and version as clap prints them; a wrong command line in one sentence.
pub fn usage(error: &clap::Error) -> ExitCode {
    let wrong = !matches!(
        error.kind(),
        ErrorKind::DisplayHelp
            | ErrorKind::DisplayVersion
            | ErrorKind::DisplayHelpOnMissingArgumentOrSubcommand
    );
    if wrong {
        eprintln!("{}", sentence(&error.to_string()));
        return ExitCode::from(2);
    }
    // Where the help can't be printed (a closed pipe), there is no one to tell.
    let _ = error.print();
    ExitCode::from(u8::try_from(error.exit_code()).unwrap_or(2))
}

/// The first paragraph of clap's message on one line, without its "error: ".
fn sentence(message: &str) -> String {
    let first = message.split("\n\n").next().unwrap_or_default();
    let words: Vec<&str> = first.split_whitespace().collect();
    let joined = words.join(" ");
    let joined = joined.strip_prefix("error: ").unwrap_or(&joined);
    format!("{joined} (--help says more)")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn usage_errors_are_one_line() {
        let message = "error: the following required arguments were not provided:\n  <RIG>\n  -o <CAPTURE>\n\nUsage: stlfr …\n";
        assert_eq!(
            sentence(message),
            "the following required arguments were not provided: <RIG> -o <CAPTURE> (--help says more)"
        );
    }
}
