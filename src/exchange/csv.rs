//! Reading of tables with comma-separated values (CSV). The first line has the names of the columns.

use super::{ExchangeError, content};
use crate::host::read_text;
use crate::text::short;
use std::path::Path;

/// Size limit of a CSV table, in bytes. A table with the frame times of sixteen cameras at 60 Hz takes about 80 MB per
/// hour.
const MAX_BYTES: u64 = 128 << 20;

/// Reads some columns of a CSV table. For each column to read, `wanted` lists its accepted names. `row` is called for
/// each line after the first one. Its arguments are the names of the columns that were found, in lower case, and the
/// values of the line, both in the order of `wanted`. Empty lines are skipped.
///
/// # Errors
/// A missing column, a line with too few or too many values, or an error of `row`.
pub(super) fn read_columns<const N: usize>(
    path: &Path,
    wanted: [&[&str]; N],
    row: impl FnMut(&[String; N], [&str; N]) -> Result<(), String>,
) -> Result<(), ExchangeError> {
    let text = read_text(path, MAX_BYTES)
        .map_err(|source| ExchangeError::Read { path: path.to_owned(), source })?;
    columns(&text, wanted, row).map_err(|reason| content(path, reason))
}

fn columns<const N: usize>(
    text: &str,
    wanted: [&[&str]; N],
    mut row: impl FnMut(&[String; N], [&str; N]) -> Result<(), String>,
) -> Result<(), String> {
    let text = text.strip_prefix('\u{feff}').unwrap_or(text);
    let mut lines = text.lines().enumerate().filter(|(_, line)| !line.trim().is_empty());
    let (_, head) = lines.next().ok_or("is empty")?;
    let head: Vec<String> = fields(head).iter().map(|name| name.to_lowercase()).collect();
    let mut at = [0; N];
    for (at, names) in at.iter_mut().zip(wanted) {
        let found = head.iter().position(|name| names.contains(&name.as_str()));
        *at = found.ok_or_else(|| format!("has no column {}", names.join(" or ")))?;
    }
    let names = at.map(|c| head[c].clone());
    for (k, line) in lines {
        let values = fields(line);
        let wrong = |reason: String| format!("line {}: {reason}", k + 1);
        if values.len() != head.len() {
            let (found, expected) = (values.len(), head.len());
            return Err(wrong(format!("has {found} values for {expected} columns")));
        }
        row(&names, at.map(|c| values[c].as_str())).map_err(wrong)?;
    }
    Ok(())
}

/// Splits a line of a CSV table into its values, without surrounding blanks. A comma between quotes belongs to the
/// value. The quotes are removed.
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

/// Parses a decimal number and converts it to nanoseconds, rounded to the nearest. `unit_digits` gives the unit of the
/// number: 9 for seconds, 6 for milliseconds, 3 for microseconds, 0 for nanoseconds. The digits are not rounded to a
/// double first, because a double can't hold a Unix time to the nanosecond. The caller adds the file's name to the
/// error message.
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
        // A number with an exponent has so few digits that a double keeps all of them.
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
        let mut rows = Vec::new();
        let read = columns(text, wanted, |names, values| {
            assert_eq!(names, &["frame_time", "cam_id"]);
            rows.push(values.map(str::to_owned));
            Ok(())
        });
        assert_eq!((read, rows.len()), (Ok(()), 2));
        assert_eq!(rows[0], ["0.5", "a, b"]);
        for (text, words) in [
            ("", "is empty"),
            ("cam_id\n", "no column time_s or frame_time"),
            ("cam_id,time_s\na\n", "line 2: has 1 values for 2 columns"),
            ("cam_id,time_s\n\na,1\n", "line 3: no"),
        ] {
            let error = columns(text, wanted, |_, _| Err("no".into())).unwrap_err();
            assert!(error.contains(words), "{error}");
        }
    }
}
