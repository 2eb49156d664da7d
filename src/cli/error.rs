//! Errors of the command line. Each error is printed as one sentence on stderr, and determines the exit code.

use crate::capture::CaptureError;
use crate::compare::CompareError;
use crate::exchange::ExchangeError;
use crate::json::JsonError;
use crate::light_field::RenderError;
use crate::publish::PublishError;
use crate::text::printable;
use crate::toolchain::ToolchainError;
use crate::tradeoff::TradeoffError;
use crate::video::VideoError;
use clap::error::ErrorKind as UsageKind;
use std::error::Error;
use std::fmt::{Display, Formatter};
use std::io::{ErrorKind, Write};
use std::path::Path;

/// The reason why a command failed. This type doesn't implement [`Error`], so that every error of the library converts
/// to it by `From`.
#[derive(Debug)]
pub enum CliError {
    /// An input is wrong. The exit code is 2.
    BadInput(String),
    /// The work failed. The exit code is 1.
    Failure(String),
}

impl Display for CliError {
    fn fmt(&self, f: &mut Formatter) -> std::fmt::Result {
        let (Self::BadInput(sentence) | Self::Failure(sentence)) = self;
        f.write_str(sentence)
    }
}

impl CliError {
    /// Returns the error with the name of a flag before its message, if the error is bad input. Other errors are
    /// unchanged.
    pub fn of_flag(self, flag: &str) -> Self {
        match self {
            Self::BadInput(sentence) => Self::BadInput(format!("{flag}: {sentence}")),
            failure => failure,
        }
    }
}

impl<E: Error + 'static> From<E> for CliError {
    fn from(error: E) -> Self {
        let sentence = error.to_string();
        if is_failure(&error) { Self::Failure(sentence) } else { Self::BadInput(sentence) }
    }
}

/// Returns whether an error means that the work failed (exit code 1). Otherwise, the input is bad (exit code 2). Bad
/// input includes a view that can't be rendered, for example because its time is outside the recording, and a file that
/// is missing or not readable.
fn is_failure(error: &(dyn Error + 'static)) -> bool {
    match error.downcast_ref() {
        Some(TradeoffError::Capture(error)) => return is_failure(error),
        Some(TradeoffError::Compare(error)) => return is_failure(error),
        Some(TradeoffError::Render(error)) => return is_failure(error),
        _ => {}
    }
    match error.downcast_ref() {
        Some(PublishError::Render(error)) => return is_failure(error),
        Some(PublishError::Encoding(_)) => return true,
        _ => {}
    }
    match error.downcast_ref() {
        Some(CompareError::Capture(error)) => return is_failure(error),
        Some(CompareError::Report(_) | CompareError::Video(_)) => return true,
        _ => {}
    }
    match error.downcast_ref() {
        Some(RenderError::Capture(error)) => return is_failure(error),
        Some(other) => return matches!(other, RenderError::Stopped),
        None => {}
    }
    match error.downcast_ref() {
        Some(CaptureError::NoFfmpeg { .. } | CaptureError::Changed { .. }) => return true,
        _ if error.is::<VideoError>() => return true,
        _ if matches!(error.downcast_ref(), Some(ExchangeError::NoFfmpeg { .. })) => return true,
        _ => {}
    }
    if let Some(error) = error.downcast_ref() {
        return matches!(error, ToolchainError::Failure(_));
    }
    let cause = error.source();
    let io = cause.and_then(|cause| match cause.downcast_ref() {
        Some(JsonError::Read(io)) => Some(io),
        _ => cause.downcast_ref(),
    });
    io.is_some_and(|io| !is_bad_input(io))
}

/// Returns whether reading or writing failed because of the input, such as a missing file, a missing permission or a
/// wrong kind of file.
fn is_bad_input(error: &std::io::Error) -> bool {
    matches!(
        error.kind(),
        ErrorKind::NotFound
            | ErrorKind::PermissionDenied
            | ErrorKind::NotADirectory
            | ErrorKind::IsADirectory
            | ErrorKind::InvalidFilename
            | ErrorKind::ReadOnlyFilesystem
            | ErrorKind::InvalidData
            | ErrorKind::InvalidInput
    )
}

/// Converts the error of a file operation to a [`CliError`] that names the file's path. `failed` describes the failure
/// in the message, such as `can't be written`.
pub fn of_io<T>(path: &Path, failed: &str, result: std::io::Result<T>) -> Result<T, CliError> {
    result.map_err(|error| {
        let sentence = format!("{}: {failed} ({error})", path.display());
        if is_bad_input(&error) {
            CliError::BadInput(sentence)
        } else {
            CliError::Failure(sentence)
        }
    })
}

/// Converts an error of writing a file to a [`CliError`] that names the file's path.
pub fn written<T>(path: &Path, result: std::io::Result<T>) -> Result<T, CliError> {
    of_io(path, "can't be written", result)
}

/// Converts the result of printing on stdout. A closed pipe counts as success, and any other error as failed work.
pub fn heard(printed: std::io::Result<()>) -> Result<(), CliError> {
    match printed {
        Err(error) if error.kind() != ErrorKind::BrokenPipe => {
            Err(CliError::Failure(format!("stdout: can't be written ({error})")))
        }
        _ => Ok(()),
    }
}

/// Prints the error, if there is one, and returns the exit code.
pub fn exit(result: Result<(), CliError>) -> u8 {
    let Err(error) = result else { return 0 };
    // If stderr can't be written, the exit code alone reports the error.
    let _ = writeln!(std::io::stderr(), "{}", printable(error.to_string().trim_end()));
    match error {
        CliError::BadInput(_) => 2,
        CliError::Failure(_) => 1,
    }
}

/// Prints help and version as clap does, and an error in the command line as one sentence. Returns the exit code.
pub fn usage(error: &clap::Error) -> u8 {
    match error.kind() {
        UsageKind::DisplayHelp | UsageKind::DisplayVersion => {
            exit(heard(error.print().and_then(|()| std::io::stdout().flush())))
        }
        UsageKind::DisplayHelpOnMissingArgumentOrSubcommand => {
            let _ = error.print();
            2
        }
        _ => exit(Err(CliError::BadInput(sentence(&error.to_string())))),
    }
}

/// Messages of Rust's number parsers, each with the message that replaces it in the output.
const OF_NUMBERS: [(&str, &str); 4] = [
    ("invalid float literal", "is no number"),
    ("cannot parse float from empty string", "is no number"),
    ("invalid digit found in string", "is no whole number"),
    ("cannot parse integer from empty string", "is no whole number"),
];

/// Returns the first paragraph of clap's message on one line, without the prefix "error: ". If clap suggests a similar
/// word, the suggestion is appended.
fn sentence(message: &str) -> String {
    let mut paragraphs = message.split("\n\n");
    let first = paragraphs.next().unwrap_or_default();
    let lines: Vec<String> = first.lines().map(|line| alternatives(line.trim())).collect();
    let joined = lines.join(" ").split_whitespace().collect::<Vec<_>>().join(" ");
    let mut joined = joined.strip_prefix("error: ").unwrap_or(&joined).to_owned();
    for (from, to) in OF_NUMBERS {
        joined = joined.replace(&format!(": {from}"), &format!(": {to}"));
    }
    let mut tips = paragraphs.flat_map(str::lines).filter_map(|l| l.trim().strip_prefix("tip: "));
    match tips.find(|tip| tip.contains(" similar ")) {
        Some(tip) => format!("{joined}; {tip} (--help says more)"),
        None => format!("{joined} (--help says more)"),
    }
}

/// Rewrites a choice of required arguments, such as `<--a <A>|--b <B>>`, as `--a <A> or --b <B>`. Returns other lines
/// unchanged.
fn alternatives(line: &str) -> String {
    let inner = line.strip_prefix('<').and_then(|line| line.strip_suffix('>'));
    match inner.filter(|inner| inner.starts_with("--")) {
        Some(inner) => inner.replace("|--", " or --"),
        None => line.to_owned(),
    }
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
            CliError::from(RenderError::from(CaptureError::Write { path: path(), source: full() })),
            CliError::from(CompareError::Write { path: path(), source: full() }),
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
        let message = "error: these were not provided:\n  <--camera <VIEW.json>|--like <NAME>>\n\nUsage: stlfr …\n";
        assert_eq!(
            sentence(message),
            "these were not provided: --camera <VIEW.json> or --like <NAME> (--help says more)"
        );
        let message = "error: unrecognized subcommand 'rendr'\n\n  tip: a similar subcommand exists: 'render'\n\nUsage: …\n";
        assert_eq!(
            sentence(message),
            "unrecognized subcommand 'rendr'; a similar subcommand exists: 'render' (--help says more)"
        );
        let message = "error: invalid value '0.1s' for '--time <SECONDS>': invalid float literal\n";
        assert_eq!(
            sentence(message),
            "invalid value '0.1s' for '--time <SECONDS>': is no number (--help says more)"
        );
    }
}
