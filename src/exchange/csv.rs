//! Tables of text whose first line names the columns, separated by commas.

use super::{ExchangeError, content};
use crate::host::read_text;
use crate::text::short;
use std::path::Path;

/// Largest table that is read, bytes: a day of sixteen cameras at 60 Hz has some 2 GB, an hour 100 MB.
const MAX_BYTES: u64 = 256 << 20;

/// A row's number in its file, counted from 1, and its values in the order of the wanted columns.
pub(super) struct Row {
    pub line: usize,
    pub values: Vec<String>,
}

/// Reads the wanted columns of a table. Each column is given by the names that it may have; returns the names that were
/// found, and the rows. Empty lines are skipped.
///
/// # Errors
/// A missing column, a row with too few or too many values.
pub(super) fn read_columns(
    path: &Path,
    wanted: &[&[&str]],
) -> Result<(Vec<String>, Vec<Row>), ExchangeError> {
    let text = read_text(path, MAX_BYTES)
        .map_err(|source| ExchangeError::Read { path: path.to_owned(), source })?;
    columns(&text, wanted).map_err(|reason| content(path, reason))
}

fn columns(text: &str, wanted: &[&[&str]]) -> Result<(Vec<String>, Vec<Row>), String> {
    let text = text.strip_prefix('\u{feff}').unwrap_or(text);
    let mut lines = text.lines().enumerate().filter(|(_, line)| !line.trim().is_empty());
    let (_, head) = lines.next().ok_or("is empty")?;
    let head = fields(head);
    let mut at = Vec::new();
    for names in wanted {
        let found = head.iter().position(|name| names.contains(&name.to_lowercase().as_str()));
        at.push(found.ok_or_else(|| format!("has no column {}", names.join(" or ")))?);
    }
    let mut rows = Vec::new();
    for (k, line) in lines {
        let values = fields(line);
        if values.len() != head.len() {
            let (found, expected) = (values.len(), head.len());
            return Err(format!("line {}: has {found} values for {expected} columns", k + 1));
        }
        rows.push(Row { line: k + 1, values: at.iter().map(|&c| values[c].clone()).collect() });
    }
    Ok((at.iter().map(|&c| head[c].to_lowercase()).collect(), rows))
}

/// The values of a line, without blanks around them. Quotes hold a comma; two of them are one.
fn fields(line: &str) -> Vec<String> {
    let mut fields = vec![String::new()];
    let mut is_quoted = false;
    for c in line.chars() {
        match c {
            '"' => is_quoted = !is_quoted,
            ',' if !is_quoted => fields.push(String::new()),
            c => {
                if let Some(field) = fields.last_mut() {
                    field.push(c);
                }
            }
        }
    }
    fields.iter().map(|field| field.trim().to_owned()).collect()
}

/// A decimal number of some unit in nanoseconds, rounded to the nearest. `unit_digits` is 9 for seconds and 0 for
/// nanoseconds. Decimal digits are not rounded to a double before. The error is a reason.
pub(super) fn nanoseconds(text: &str, unit_digits: usize) -> Result<i64, String> {
    let wrong = || format!("'{}' is no time", short(text));
    let (sign, digits) = match text.strip_prefix('-') {
        Some(digits) => (-1, digits),
        None => (1, text.strip_prefix('+').unwrap_or(text)),
    };
    let (whole, fraction) = digits.split_once('.').unwrap_or((digits, ""));
    if whole.is_empty() && fraction.is_empty() {
        return Err(wrong());
    }
    if !(whole.chars().chain(fraction.chars())).all(|c| c.is_ascii_digit()) {
        // With an exponent: a double is as precise as such a number is meant.
        let value: f64 = text.parse().map_err(|_| wrong())?;
        let ns = value * 10_f64.powi(unit_digits as i32);
        return if ns.abs() < 9e18 { Ok(ns.round() as i64) } else { Err(wrong()) };
    }
    let mut value = 0_i64;
    let mut fraction = fraction.bytes();
    let places = std::iter::repeat_with(|| fraction.next().unwrap_or(b'0')).take(unit_digits);
    let after: Vec<u8> = places.collect();
    for digit in whole.bytes().chain(after) {
        let grown = value.checked_mul(10).and_then(|v| v.checked_add(i64::from(digit - b'0')));
        value = grown.ok_or_else(wrong)?;
    }
    let is_up = fraction.next().is_some_and(|digit| digit >= b'5');
    value.checked_add(i64::from(is_up)).map(|v| sign * v).ok_or_else(wrong)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_of_any_length_are_exact() {
        for (text, digits, expected) in [
            ("48033.00157345", 9, 48_033_001_573_450),
            ("1700000000.123456789", 9, 1_700_000_000_123_456_789),
            ("1700000000123456789", 0, 1_700_000_000_123_456_789),
            ("-0.0000000015", 9, -2),
            ("1.5", 0, 2),
            ("33.3667", 6, 33_366_700),
            (".5", 9, 500_000_000),
            ("2.", 9, 2_000_000_000),
            ("1e-3", 9, 1_000_000),
        ] {
            assert_eq!(nanoseconds(text, digits), Ok(expected), "{text}");
        }
        for wrong in ["", ".", "-", "x", "nan", "inf", "1e300", "99999999999999", "1.2.3", "1 2"] {
            assert!(nanoseconds(wrong, 9).is_err(), "{wrong}");
        }
    }

    #[test]
    fn columns_are_found_by_name() {
        let text = "\u{feff}index, Cam_ID ,\"frame_time\"\n\n1,\"a, b\",0.5\n2,c,0.75\n";
        let wanted: [&[&str]; 2] = [&["time_s", "frame_time"], &["cam_id"]];
        let (names, rows) = columns(text, &wanted).unwrap();
        assert_eq!(names, ["frame_time", "cam_id"]);
        assert_eq!((rows[0].line, &rows[0].values[..]), (3, &["0.5".into(), "a, b".into()][..]));
        for (text, words) in [
            ("", "is empty"),
            ("cam_id\n", "no column time_s or frame_time"),
            ("cam_id,time_s\na\n", "line 2: has 1 values for 2 columns"),
        ] {
            let error = columns(text, &wanted).err().unwrap();
            assert!(error.contains(words), "{error}");
        }
    }
}
