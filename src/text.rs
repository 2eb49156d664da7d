//! Makes text that was read from files safe for a terminal, a chart or another program's file.

/// Regular expression for the id of a camera or a view, for JSON Schemas (ECMAScript syntax, with Unicode). It
/// excludes Hangul fillers, which are invisible letters.
pub const ID_PATTERN: &str =
    r"^(?! )(?!\.{1,2}$)(?!.*[\u115F\u1160\u3164\uFFA0])[\p{Alphabetic}\p{N}_. -]+(?<! )$";
/// Maximum number of characters of the id of a camera or a view.
pub const MAX_ID_LENGTH: usize = 100;

/// Maximum number of characters of a name that is displayed, such as the name of a scene.
pub const MAX_NAME_LENGTH: usize = 1000;
/// Maximum number of characters of a number in a message. Longer numbers are written with an exponent.
const MAX_NUMBER_LENGTH: usize = 24;

/// Checks that an id can name a file. An id has at most [`MAX_ID_LENGTH`] characters: visible letters, digits, `_`,
/// `-`, `.` and inner spaces. It must not be `.` or `..`. The error completes the sentence "The id …".
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

/// Checks a name that is displayed, such as the name of a scene: one line of at most [`MAX_NAME_LENGTH`] printable
/// characters. The error completes the sentence "The name …".
pub fn check_name(name: &str) -> Result<(), String> {
    if name.chars().count() <= MAX_NAME_LENGTH && name.chars().all(is_printable) {
        return Ok(());
    }
    Err(format!("must be a line of at most {MAX_NAME_LENGTH} printable characters"))
}

/// Returns the most similar of some names to a misspelt name; `None` if each differs from it by more than a third of its
/// letters.
pub(crate) fn most_similar<'a>(
    wrong: &str,
    names: impl Iterator<Item = &'a str>,
) -> Option<&'a str> {
    let distances = names.map(|name| (edit_distance(wrong, name), name));
    let (distance, name) = distances.min()?;
    (3 * distance <= wrong.chars().count()).then_some(name)
}

/// Returns the Levenshtein distance of two texts: the smallest number of characters that are inserted, deleted or
/// replaced to get one from the other.
fn edit_distance(a: &str, b: &str) -> usize {
    let b: Vec<char> = b.chars().collect();
    let mut row: Vec<usize> = (0..=b.len()).collect();
    for (above, from) in a.chars().enumerate() {
        let mut diagonal = std::mem::replace(&mut row[0], above + 1);
        for (k, to) in b.iter().enumerate() {
            let replaced = diagonal + usize::from(from != *to);
            diagonal = row[k + 1];
            row[k + 1] = replaced.min(diagonal + 1).min(row[k] + 1);
        }
    }
    row[b.len()]
}

/// Formats a number for a message. If it would have more than [`MAX_NUMBER_LENGTH`] characters, it is written with
/// an exponent.
pub(crate) fn number(value: impl std::fmt::Display) -> String {
    let text = value.to_string();
    match text.parse::<f64>() {
        Ok(value) if text.len() > MAX_NUMBER_LENGTH => format!("{value:e}"),
        _ => text,
    }
}

/// Formats two times, in seconds, for a message. Both have the smallest number of decimals, at least 4, that
/// distinguishes them.
pub(crate) fn distinct_s([a, b]: [f64; 2]) -> [String; 2] {
    let decimals =
        (4..MAX_NUMBER_LENGTH).find(|n| a == b || format!("{a:.n$}") != format!("{b:.n$}"));
    let decimals = decimals.unwrap_or(4);
    [a, b].map(|value| number(format!("{value:.decimals$}")))
}

/// Shortens a value for a message to its first [`MAX_ID_LENGTH`] characters. Control characters are not escaped;
/// see [`printable`].
pub(crate) fn short(value: &str) -> String {
    value.chars().take(MAX_ID_LENGTH).collect()
}

/// Escapes text for one line of a terminal. Control characters, line separators, direction marks and characters of
/// zero width are replaced by escapes such as `\u{1b}`.
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
    fn the_edit_distance_counts_changed_characters() {
        for (a, b, distance) in [
            ("", "", 0),
            ("", "ab", 2),
            ("kitten", "sitting", 3),
            ("flaw", "lawn", 2),
            ("é", "e", 1),
        ] {
            assert_eq!((edit_distance(a, b), edit_distance(b, a)), (distance, distance));
        }
        let names = ["cameras", "images"];
        let similar = |wrong| most_similar(wrong, names.into_iter());
        assert_eq!(
            (similar("camera"), similar("cmars"), similar("fog")),
            (Some("cameras"), None, None)
        );
        assert_eq!(most_similar("x", [].into_iter()), None);
    }

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
    fn names_are_printable_lines() {
        for name in ["", "Süd <3>, \"a\"", &"x".repeat(MAX_NAME_LENGTH)] {
            assert_eq!(check_name(name), Ok(()), "{name}");
        }
        for name in ["a\nb", "\u{1b}[31m", "a\u{202e}b", &"x".repeat(MAX_NAME_LENGTH + 1)] {
            assert!(check_name(name).is_err(), "{name}");
        }
    }

    #[test]
    fn numbers_are_short_and_told_apart() {
        for (value, text) in
            [(0.5, "0.5"), (1e155, "1e155"), (-1e-200, "-1e-200"), (1e6, "1000000")]
        {
            assert_eq!(number(value), text);
        }
        assert_eq!(number(u64::MAX), u64::MAX.to_string());
        assert_eq!(distinct_s([0.07391, 0.07394]), ["0.07391", "0.07394"]);
        assert_eq!(distinct_s([0.1, 0.2]), ["0.1000", "0.2000"]);
        assert_eq!(distinct_s([1e100, 0.0]), ["1e100", "0.0000"]);
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
