//! What commands print.

use super::CliError;
use std::fmt::Display;
use std::io::{ErrorKind, Result, Write};
use stlfr::text::printable;

/// What a command has to say on stdout, line by line; it is printed once, at the command's end.
#[derive(Debug, Default)]
pub struct Page(String);

impl Page {
    /// A line, or several, of which nothing can drive a terminal.
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

    /// Prints it all.
    pub fn print(&self) -> std::result::Result<(), CliError> {
        let mut stdout = std::io::stdout().lock();
        heard(stdout.write_all(self.0.as_bytes()).and_then(|()| stdout.flush()))
    }
}

/// A reader who has closed the pipe wants no more, which is no error.
pub fn heard(printed: Result<()>) -> std::result::Result<(), CliError> {
    match printed {
        Err(error) if error.kind() != ErrorKind::BrokenPipe => {
            Err(CliError::Failure(format!("stdout: can't be written ({error})")))
        }
        _ => Ok(()),
    }
}
