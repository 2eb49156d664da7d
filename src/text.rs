//! Makes text from files safe for a terminal, a chart or another program's file.

/// Regular expression of the id of a camera or a view in JSON Schemas (ECMAScript, with Unicode). It excludes Hangul
/// fillers, which are invisible letters.
pub const ID_PATTERN: &str =
    r"^(?! )(?!\.{1,2}$)(?!.*[\u115F\u1160\u3164\uFFA0])[\p{Alphabetic}\p{N}_. -]+(?<! )$";
/// Largest number of characters of an id.
pub const MAX_ID_LENGTH: usize = 100;

/// Checks that an id can name a file: at most [`MAX_ID_LENGTH`] visible letters, digits, `_`, `-`, `.`
/// and inner spaces, and neither `.` nor `..`. The error completes the sentence "The id …".
pub fn check_id(id: &str) -> Result<(), String> {
    let is_legal = |c: char| c.is_alphanumeric() || matches!(c, '_' | '-' | '.' | ' ');
    let length = id.chars().count();
    let reason = if id.is_empty() {
        "is empty"
    } else if length > MAX_ID_LENGTH {
        return Err(format!("has {length} characters, at most {MAX_ID_LENGTH} are allowed"));
    } else if !id.chars().all(is_legal) {
        "holds other characters than letters, digits, '_', '-', '.' and spaces"
    } else if !id.chars().all(is_printable) {
        "holds a letter that is not seen"
    } else if id != id.trim() {
        "starts or ends with a space"
    } else if id == "." || id == ".." {
        "names a folder"
    } else {
        return Ok(());
    };
    Err(format!("'{}' {reason}", printable(id)))
}

/// Shortens a value for a message, to [`MAX_ID_LENGTH`] characters. Control characters are not escaped:
/// see [`printable`].
pub(crate) fn short(value: &str) -> String {
    value.chars().take(MAX_ID_LENGTH).collect()
}

/// Escapes text for one line of a terminal: control characters, line separators, direction marks and
/// characters without width become `\u{1b}` and the like.
pub fn printable(text: &str) -> String {
    let shown = |c: char| if is_printable(c) { c.into() } else { c.escape_default().to_string() };
    text.chars().map(shown).collect()
}

fn is_printable(c: char) -> bool {
    let hidden = matches!(c,
        '\u{ad}' | '\u{34f}' | '\u{61c}' | '\u{115f}' | '\u{1160}' | '\u{17b4}' | '\u{17b5}' | '\u{180e}'
        | '\u{200b}'..='\u{200f}' | '\u{2028}'..='\u{202e}' | '\u{2060}'..='\u{206f}' | '\u{3164}'
        | '\u{fe00}'..='\u{fe0f}' | '\u{feff}' | '\u{ffa0}' | '\u{fff9}'..='\u{fffb}'
        | '\u{e0000}'..='\u{e007f}');
    !c.is_control() && !hidden
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ids_are_names() {
        for id in ["cam0", "Camera 1", "a-b_c.d", "Kamera süd", "カメラ3", "...", &"x".repeat(100)]
        {
            assert_eq!(check_id(id), Ok(()), "{id}");
        }
        for id in [
            "",
            ".",
            "..",
            " a",
            "a ",
            "a\u{1b}[31m",
            "a\u{7}",
            "a\nb",
            "a\tb",
            "a\u{a0}b",
            "a\u{202e}b",
            "a\u{200b}b",
            "\u{3164}",
            "a\u{ffa0}b",
            "a\u{fe0f}",
            "a/b",
            "a\\b",
            "<b>",
            "a&b",
            "a\"b",
            "a'b",
            "\u{301}",
            &"x".repeat(101),
        ] {
            let reason = check_id(id).expect_err(id);
            assert!(reason.chars().all(is_printable) && reason.len() < 600, "{reason}");
        }
    }

    #[test]
    fn the_pattern_names_every_letter_that_is_not_seen() {
        let hidden = ('\0'..=char::MAX).filter(|c| c.is_alphanumeric() && !is_printable(*c));
        let named: String = hidden.map(|c| format!(r"\u{:04X}", c as u32)).collect();
        assert!(ID_PATTERN.contains(&format!("(?!.*[{named}])")), "{named}");
    }

    #[test]
    fn what_a_message_quotes_is_no_longer_than_an_id() {
        assert_eq!(short("カメラ"), "カメラ");
        assert_eq!(short(&"カ".repeat(1000)), "カ".repeat(MAX_ID_LENGTH));
    }

    #[test]
    fn what_drives_a_terminal_is_escaped() {
        assert_eq!(printable("a\n\u{1b}[0m\u{7}"), r"a\n\u{1b}[0m\u{7}");
        assert_eq!(printable("x\u{202e}y\u{2066}\u{9b}z"), r"x\u{202e}y\u{2066}\u{9b}z");
        assert_eq!(printable("\u{3164}\u{34f}\u{fe00}"), r"\u{3164}\u{34f}\u{fe00}");
        assert_eq!(printable("'Süd 3', 0.5 ± 0.1 é カ"), "'Süd 3', 0.5 ± 0.1 é カ");
    }
}
