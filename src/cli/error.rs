//! Errors of the command line: one sentence on stderr, and an exit code.

use super::print::heard;
use clap::error::ErrorKind as UsageKind;
use std::io::{ErrorKind, Write};
use std::process::ExitCode;
use stlfr::capture::{CaptureError, TruthError};
use stlfr::compare::CompareError;
use stlfr::json::JsonError;
use stlfr::light_field::RenderError;
use stlfr::raster::ImageFileError;
use stlfr::rig::RigError;
use stlfr::text::printable;
use stlfr::toolchain::{ExtensionError, ScriptError, SetupError};
use stlfr::tradeoff::TradeoffError;
use stlfr::video::VideoError;

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

impl From<ExtensionError> for CliError {
    fn from(error: ExtensionError) -> Self {
        match error {
            ExtensionError::Wheel(error) => error.into(),
            ExtensionError::Package(error) => error.into(),
        }
    }
}

/// What is missing, may not be read or is no file was given wrongly; what fails otherwise while it
/// is read or written is a failure.
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

impl From<CaptureError> for CliError {
    fn from(error: CaptureError) -> Self {
        let sentence = error.to_string();
        match &error {
            CaptureError::Read { source, .. }
            | CaptureError::Write { source, .. }
            | CaptureError::Json { source: JsonError::Read(source), .. } => of_io(sentence, source),
            CaptureError::ImageFile(ImageFileError::Read { source, .. })
            | CaptureError::ImageFile(ImageFileError::Write { source, .. }) => {
                of_io(sentence, source)
            }
            CaptureError::NoFfmpeg { .. } | CaptureError::Changed { .. } => Self::Failure(sentence),
            _ => Self::BadInput(sentence),
        }
    }
}

impl From<ImageFileError> for CliError {
    fn from(error: ImageFileError) -> Self {
        CaptureError::from(error).into()
    }
}

impl From<RigError> for CliError {
    fn from(error: RigError) -> Self {
        let sentence = error.to_string();
        match &error {
            RigError::Json { source: JsonError::Read(source), .. } => of_io(sentence, source),
            _ => Self::BadInput(sentence),
        }
    }
}

impl From<TruthError> for CliError {
    fn from(error: TruthError) -> Self {
        let sentence = error.to_string();
        match &error {
            TruthError::Read { source, .. }
            | TruthError::Json { source: JsonError::Read(source), .. } => of_io(sentence, source),
            _ => Self::BadInput(sentence),
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
            CompareError::Truth(error) => error.into(),
            CompareError::ImageFile(error) => error.into(),
            CompareError::Write { ref source, .. } => of_io(error.to_string(), source),
            CompareError::Report(_) | CompareError::Video(_) => Self::Failure(error.to_string()),
            _ => Self::BadInput(error.to_string()),
        }
    }
}

impl From<TradeoffError> for CliError {
    fn from(error: TradeoffError) -> Self {
        match error {
            TradeoffError::Capture(error) => error.into(),
            TradeoffError::Truth(error) => error.into(),
            TradeoffError::Compare(error) => error.into(),
            TradeoffError::Render(error) => error.into(),
            TradeoffError::Write { ref source, .. } => of_io(error.to_string(), source),
            _ => Self::BadInput(error.to_string()),
        }
    }
}

/// Says what went wrong, if anything did.
pub fn exit(result: Result<(), CliError>) -> ExitCode {
    let Err(error) = result else { return ExitCode::SUCCESS };
    // Where stderr can't be written, the exit code has to say it.
    let _ = writeln!(std::io::stderr(), "{}", printable(error.to_string().trim_end()));
    ExitCode::from(match error {
        CliError::BadInput(_) => 2,
        CliError::Failure(_) => 1,
    })
}

/// Help and version as clap prints them; a wrong command line in one sentence.
pub fn usage(error: &clap::Error) -> ExitCode {
    match error.kind() {
        UsageKind::DisplayHelp | UsageKind::DisplayVersion => {
            exit(heard(error.print().and_then(|()| std::io::stdout().flush())))
        }
        UsageKind::DisplayHelpOnMissingArgumentOrSubcommand => {
            // On stderr, of which the exit code says as much.
            let _ = error.print();
            ExitCode::from(2)
        }
        _ => exit(Err(CliError::BadInput(sentence(&error.to_string())))),
    }
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
    use stlfr::exchange::ExchangeError;

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
