//! Errors of the command line: one sentence on stderr, and an exit code.

use super::print::heard;
use clap::error::ErrorKind as UsageKind;
use std::error::Error;
use std::io::{ErrorKind, Write};
use std::path::Path;
use std::process::ExitCode;
use stlfr::capture::CaptureError;
use stlfr::compare::CompareError;
use stlfr::exchange::ExchangeError;
use stlfr::json::JsonError;
use stlfr::light_field::RenderError;
use stlfr::raster::ImageFileError;
use stlfr::rig::RigError;
use stlfr::text::printable;
use stlfr::toolchain::ToolchainError;
use stlfr::tradeoff::TradeoffError;
use stlfr::video::VideoError;

/// Why a command failed.
#[derive(Debug, thiserror::Error)]
pub enum CliError {
    /// An input is wrong: exit code 2.
    #[error("{0}")]
    BadInput(String),
    /// The work failed: exit code 1.
    #[error("{0}")]
    Failure(String),
}

impl From<ToolchainError> for CliError {
    fn from(error: ToolchainError) -> Self {
        match error {
            ToolchainError::BadInput(sentence) => Self::BadInput(sentence),
            ToolchainError::Failure(sentence) => Self::Failure(sentence),
        }
    }
}

/// Classifies a failed read or write: missing files, permissions and wrong kinds of files are bad input.
pub(super) fn of_io(sentence: String, source: &std::io::Error) -> CliError {
    match source.kind() {
        ErrorKind::NotFound
        | ErrorKind::PermissionDenied
        | ErrorKind::NotADirectory
        | ErrorKind::IsADirectory
        | ErrorKind::InvalidFilename
        | ErrorKind::ReadOnlyFilesystem
        | ErrorKind::InvalidData
        | ErrorKind::InvalidInput => CliError::BadInput(sentence),
        _ => CliError::Failure(sentence),
    }
}

/// The result of writing a file.
pub(super) fn written(path: &Path, result: std::io::Result<()>) -> Result<(), CliError> {
    result.map_err(|error| of_io(format!("{}: can't be written ({error})", path.display()), &error))
}

/// Classifies an error by its cause: by [`of_io`] if it is a failed read or write, else as bad input.
fn by_cause(error: &dyn Error) -> CliError {
    let cause = error.source();
    let io = cause.and_then(|cause| match cause.downcast_ref() {
        Some(JsonError::Read(io)) => Some(io),
        _ => cause.downcast_ref(),
    });
    io.map_or_else(|| CliError::BadInput(error.to_string()), |io| of_io(error.to_string(), io))
}

macro_rules! classified_by_cause {
    ($($error:ty),+) => {
        $(impl From<$error> for CliError {
            fn from(error: $error) -> Self {
                by_cause(&error)
            }
        })+
    };
}
classified_by_cause!(ImageFileError, RigError, ExchangeError);

impl From<CaptureError> for CliError {
    fn from(error: CaptureError) -> Self {
        match error {
            CaptureError::NoFfmpeg { .. } | CaptureError::Changed { .. } => {
                Self::Failure(error.to_string())
            }
            _ => by_cause(&error),
        }
    }
}

/// A view that can't be rendered is bad input: a time outside the recording, a view of nothing.
impl From<RenderError> for CliError {
    fn from(error: RenderError) -> Self {
        match error {
            RenderError::Capture(error) => error.into(),
            RenderError::Stopped => Self::Failure(error.to_string()),
            _ => Self::BadInput(error.to_string()),
        }
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
            CompareError::Capture(error) => error.into(),
            CompareError::Report(_) | CompareError::Video(_) => Self::Failure(error.to_string()),
            _ => by_cause(&error),
        }
    }
}

impl From<TradeoffError> for CliError {
    fn from(error: TradeoffError) -> Self {
        match error {
            TradeoffError::Capture(error) => error.into(),
            TradeoffError::Compare(error) => error.into(),
            TradeoffError::Render(error) => error.into(),
            _ => by_cause(&error),
        }
    }
}

/// Prints the error, if any, and returns the exit code.
pub fn exit(result: Result<(), CliError>) -> ExitCode {
    let Err(error) = result else { return ExitCode::SUCCESS };
    // Without stderr, the exit code alone reports the error.
    let _ = writeln!(std::io::stderr(), "{}", printable(error.to_string().trim_end()));
    ExitCode::from(match error {
        CliError::BadInput(_) => 2,
        CliError::Failure(_) => 1,
    })
}

/// Prints help and version as clap does, and an error in the command line as one sentence.
pub fn usage(error: &clap::Error) -> ExitCode {
    match error.kind() {
        UsageKind::DisplayHelp | UsageKind::DisplayVersion => {
            exit(heard(error.print().and_then(|()| std::io::stdout().flush())))
        }
        UsageKind::DisplayHelpOnMissingArgumentOrSubcommand => {
            let _ = error.print();
            ExitCode::from(2)
        }
        _ => exit(Err(CliError::BadInput(sentence(&error.to_string())))),
    }
}

/// The first paragraph of clap's message on one line, without the prefix "error: ".
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
    fn what_fails_in_mid_work_is_no_bad_input() {
        let path = || std::path::PathBuf::from("a");
        let full = || std::io::Error::from(ErrorKind::StorageFull);
        let refused = || std::io::Error::from(ErrorKind::PermissionDenied);
        for failed in [
            CliError::from(CaptureError::Write { path: path(), source: full() }),
            CliError::from(ExchangeError::Write { path: path(), source: full() }),
        ] {
            assert!(matches!(failed, CliError::Failure(_)), "{failed:?}");
        }
        for wrong in [
            CliError::from(CaptureError::Write { path: path(), source: refused() }),
            CliError::from(ExchangeError::Read { path: path(), source: refused() }),
        ] {
            assert!(matches!(wrong, CliError::BadInput(_)), "{wrong:?}");
        }
    }

    #[test]
    fn usage_errors_are_one_line() {
        let message = "error: the following required arguments were not provided:\n  <RIG>\n  -o <CAPTURE>\n\nUsage: stlfr …\n";
        assert_eq!(
            sentence(message),
            "the following required arguments were not provided: <RIG> -o <CAPTURE> (--help says more)"
        );
    }
}
