//! File names of a camera's frames, inside the capture's folder.

use std::io::ErrorKind;
use std::path::{Component, Path, PathBuf};

/// Names of the files and folders in a capture's folder that the program itself writes. The path of a camera's frames
/// must not start with any of these names.
const RESERVED: [&str; 5] = [super::CAPTURE_FILE, "offsets.json", "offsets.svg", ".stlfr", ".film"];

/// A printf pattern with one integer field, split around the field: `cam0/%04d.png` becomes `cam0/`, 4 and `.png`.
#[derive(Debug, PartialEq)]
struct Pattern<'a> {
    before: &'a str,
    digits: usize,
    after: &'a str,
}

/// Splits a pattern around its integer field. Returns the text before the field, the field's width, and the text after
/// it. `None` for a pattern without such a field.
fn split(pattern: &str) -> Option<(&str, &str, &str)> {
    let (before, rest) = pattern.split_once('%')?;
    let (width, after) = rest.split_once('d')?;
    Some((before, width, after))
}

/// Returns the digits of a file name between the texts `before` and `after`. `None` if the name has another form.
fn number<'a>(name: &'a str, before: &str, after: &str) -> Option<&'a str> {
    let number = name.strip_prefix(before)?.strip_suffix(after)?;
    (!number.is_empty() && number.bytes().all(|b| b.is_ascii_digit())).then_some(number)
}

/// Returns whether a file name matches a pattern. A pattern without an integer field is the name of a video.
pub(super) fn is_named(pattern: &str, name: &str) -> bool {
    match split(pattern) {
        Some((before, _, after)) => number(name, before, after).is_some(),
        None => name == pattern,
    }
}

impl<'a> Pattern<'a> {
    fn parse(text: &'a str) -> Result<Self, String> {
        let parsed = split(text).and_then(|(before, width, after)| {
            let padded = width.is_empty() || width.starts_with('0');
            let digits = if width.is_empty() { 0 } else { width.parse().ok()? };
            let is_legal = padded && digits <= 18 && !after.contains('%');
            is_legal.then_some(Self { before, digits, after })
        });
        parsed.ok_or_else(|| {
            format!(
                "'{text}' is neither an image sequence such as cam0/%04d.png nor a video such as cam0.mkv"
            )
        })
    }

    fn name(&self, index: usize) -> String {
        format!("{}{index:0digits$}{}", self.before, self.after, digits = self.digits)
    }
}

/// Finds the files of an image sequence, numbered from 0 without gaps. `root` is the canonical path of the capture's
/// folder. The caller adds the name of `capture.json` to the error message.
pub(super) fn find(root: &Path, pattern: &str) -> Result<Vec<PathBuf>, String> {
    let parsed = Pattern::parse(pattern)?;
    must_be_relative(pattern)?;
    let mut files = Vec::new();
    while let Some(file) = file(root, &parsed.name(files.len()))? {
        files.push(file);
    }
    if files.is_empty() {
        return Err(format!("'{}' does not exist", parsed.name(0)));
    }
    if let Some(beyond) = number_beyond(root, &parsed, files.len()) {
        return Err(format!(
            "'{}' is missing although '{}' exists",
            parsed.name(files.len()),
            parsed.name(beyond)
        ));
    }
    Ok(files)
}

/// Finds the video that a camera's `frames` field names. `None` if the field names an image sequence. The caller adds
/// the name of `capture.json` to the error message.
pub(super) fn video(root: &Path, name: &str) -> Result<Option<PathBuf>, String> {
    if name.contains('%') {
        return Ok(None);
    }
    must_be_relative(name)?;
    let real = file(root, name)?.ok_or_else(|| format!("'{name}' does not exist"))?;
    if image::ImageFormat::from_path(&real).is_ok() {
        return Err(format!(
            "'{name}' is one image; a sequence is named like cam0/%04d.png, from 0 on"
        ));
    }
    Ok(Some(real))
}

/// Returns the canonical path of a regular file inside the folder `root`. `None` if the file doesn't exist. Returns an
/// error, with the reason, for a folder and for a symbolic link that leads out of `root`.
fn file(root: &Path, name: &str) -> Result<Option<PathBuf>, String> {
    let real = match root.join(name).canonicalize() {
        Ok(real) => real,
        Err(error) if matches!(error.kind(), ErrorKind::NotFound | ErrorKind::NotADirectory) => {
            return Ok(None);
        }
        Err(error) => return Err(format!("'{name}' can't be read ({error})")),
    };
    if !real.starts_with(root) {
        return Err(format!("'{name}' leads out of the capture"));
    }
    if !real.is_file() {
        return Err(format!("'{name}' is not a file"));
    }
    Ok(Some(real))
}

fn must_be_relative(name: &str) -> Result<(), String> {
    let inside = |c: Component| matches!(c, Component::Normal(_) | Component::CurDir);
    if !Path::new(name).components().all(inside) || name.is_empty() {
        return Err(format!("'{name}' must be relative to the capture and stay inside it"));
    }
    let mut parts = Path::new(name).components().filter(|c| *c != Component::CurDir);
    let first = parts.next().and_then(|first| first.as_os_str().to_str()).unwrap_or_default();
    if RESERVED.contains(&first) {
        return Err(format!("'{name}' is where the program writes {first}"));
    }
    Ok(())
}

/// Finds the smallest file number after a gap in an image sequence. `missing` is the first missing number. `None` if no
/// later file exists.
fn number_beyond(root: &Path, pattern: &Pattern, missing: usize) -> Option<usize> {
    let sample = root.join(pattern.name(0));
    let before = pattern.before.rsplit('/').next().unwrap_or_default();
    std::fs::read_dir(sample.parent()?)
        .ok()?
        .filter_map(|entry| {
            let name = entry.ok()?.file_name().into_string().ok()?;
            let number: usize = number(&name, before, pattern.after)?.parse().ok()?;
            (number > missing && root.join(pattern.name(number)).exists()).then_some(number)
        })
        .min()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn patterns() {
        let p = Pattern::parse("a/b%04d.png").unwrap();
        assert_eq!((p.name(7), p.name(12345)), ("a/b0007.png".into(), "a/b12345.png".into()));
        assert_eq!(Pattern::parse("%d.png").unwrap().name(3), "3.png");
        for wrong in ["cam0.mkv", "%04x.png", "%s", "%4d.png", "%04d/%04d.png", "%0999d"] {
            assert!(Pattern::parse(wrong).is_err(), "{wrong}");
        }
    }

    #[test]
    fn gaps_and_ways_out_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        let root = folder.path().canonicalize().unwrap();
        std::fs::create_dir(root.join("c")).unwrap();
        for k in [0, 1, 3] {
            std::fs::write(root.join(format!("c/f{k}.png")), "").unwrap();
        }
        assert!(find(&root, "c/f%d.png").unwrap_err().contains("'c/f2.png' is missing"));
        std::fs::remove_file(root.join("c/f3.png")).unwrap();
        assert_eq!(find(&root, "c/f%d.png").unwrap().len(), 2);
        assert!(find(&root, "../x%d.png").unwrap_err().contains("stay inside"));
        assert!(find(&root, "/x%d.png").unwrap_err().contains("stay inside"));
        assert!(find(&root, "d/%d.png").unwrap_err().contains("does not exist"));

        for name in ["offsets.json/%04d.png", "./.stlfr/%d.png"] {
            assert!(find(&root, name).unwrap_err().contains("where the program writes"), "{name}");
        }

        let outside = tempfile::NamedTempFile::new().unwrap();
        std::os::unix::fs::symlink(outside.path(), root.join("c/f2.png")).unwrap();
        assert!(find(&root, "c/f%d.png").unwrap_err().contains("leads out"));
    }
}
