//! Output of commands on stdout.

use super::CliError;
use super::error::heard;
use crate::text::printable;
use std::fmt::Display;
use std::io::Write;

/// The output of a command, which is collected and printed when the command ends.
#[derive(Debug, Default)]
pub struct Page(String);

impl Page {
    /// Adds lines to the output. Control characters are escaped.
    pub fn line(&mut self, line: impl Display) {
        let line = line.to_string();
        let lines: Vec<String> = line.split('\n').map(printable).collect();
        self.text(format_args!("{}\n", lines.join("\n")));
    }

    pub fn text(&mut self, text: impl Display) {
        self.0 += &text.to_string();
    }

    pub fn json(&mut self, value: &impl serde::Serialize) -> Result<(), CliError> {
        let json = serde_json::to_string_pretty(value);
        let json = json.map_err(|e| CliError::Failure(e.to_string()))?;
        self.text(format_args!("{json}\n"));
        Ok(())
    }

    /// Prints the collected output.
    pub fn print(&self) -> Result<(), CliError> {
        let mut stdout = std::io::stdout().lock();
        heard(stdout.write_all(self.0.as_bytes()).and_then(|()| stdout.flush()))
    }
}

/// Returns the number of decimal places at which two digits of a standard error are visible, from 0 to 4. Returns 4 if
/// there is no positive standard error.
pub fn decimals(std_err: Option<f64>) -> usize {
    let digits = |error: f64| (1.0 - error.log10().floor()).clamp(0.0, 4.0) as usize;
    std_err.filter(|error| *error > 0.0).map_or(4, digits)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn as_many_decimals_as_the_error_has_digits() {
        for (error, wanted) in [(0.4, 2), (0.0012, 4), (1e-9, 4), (0.0, 4), (2.5, 1), (70.0, 0)] {
            assert_eq!(decimals(Some(error)), wanted, "{error}");
        }
        assert_eq!((decimals(None), decimals(Some(f64::NAN))), (4, 4));
    }
}
