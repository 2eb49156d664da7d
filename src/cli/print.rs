//! Output of commands on stdout.

use super::CliError;
use std::fmt::Display;
use std::io::{ErrorKind, Result, Write};
use stlfr::text::printable;

/// The output of a command, printed at its end.
#[derive(Debug, Default)]
pub struct Page(String);

impl Page {
    /// Adds lines, with control characters escaped.
    pub fn line(&mut self, line: impl Display) {
        let line = line.to_string();
        let lines: Vec<String> = line.split('\n').map(printable).collect();
        self.text(format_args!("{}\n", lines.join("\n")));
    }

    pub fn text(&mut self, text: impl Display) {
        self.0 += &text.to_string();
    }

    pub fn json(&mut self, value: &impl serde::Serialize) -> std::result::Result<(), CliError> {
        let json = serde_json::to_string_pretty(value);
        let json = json.map_err(|e| CliError::Failure(e.to_string()))?;
        self.text(format_args!("{json}\n"));
        Ok(())
    }

    /// Prints the output.
    pub fn print(&self) -> std::result::Result<(), CliError> {
        let mut stdout = std::io::stdout().lock();
        heard(stdout.write_all(self.0.as_bytes()).and_then(|()| stdout.flush()))
    }
}

/// The result of printing; a closed pipe is not an error.
pub fn heard(printed: Result<()>) -> std::result::Result<(), CliError> {
    match printed {
        Err(error) if error.kind() != ErrorKind::BrokenPipe => {
            Err(CliError::Failure(format!("stdout: can't be written ({error})")))
        }
        _ => Ok(()),
    }
}
