//! Video files, read and written by ffmpeg as a child process, without a shell. File names are passed in a form that
//! ffmpeg can't mistake for an option.

mod intact;
mod packets;
mod reader;
mod writer;

pub use intact::{DamagedVideo, decode_intact, find_intact};
pub(crate) use reader::frame_name;
pub use reader::{VideoFacts, VideoLimits, decode, inspect};
pub use writer::{Codec, VideoFormat, VideoWriter};

use std::path::PathBuf;

/// Error of reading or writing a video file. Every message is one sentence.
#[derive(Debug, thiserror::Error)]
pub enum VideoError {
    /// ffmpeg failed to write the video. The reason is ffmpeg's own message.
    #[error("{path}: can't be written ({reason})")]
    Encode { path: PathBuf, reason: String },
    /// ffmpeg was built without the encoder that the video file's format needs.
    #[error(
        "{ffmpeg}: has no encoder {encoder}, which .{suffix} needs; install an ffmpeg with it, or write .mkv"
    )]
    NoEncoder { ffmpeg: PathBuf, encoder: &'static str, suffix: &'static str },
    /// A video can't be used. `reason` is like "has no frames". The caller puts the video's name before it.
    #[error("{reason}")]
    Decode { reason: String },
    /// A video can't be decoded without an error. The caller puts the video's name before `reason`.
    #[error("{reason}")]
    Damaged { reason: String },
    /// A file can't be read or written, or ffmpeg can't be started.
    #[error("{path}: {source}")]
    File { path: PathBuf, source: std::io::Error },
}

/// Returns the path of the first ffmpeg on `PATH`. `None` if there is no ffmpeg.
pub fn ffmpeg_on_path() -> Option<PathBuf> {
    let paths = std::env::var_os("PATH")?;
    std::env::split_paths(&paths).map(|p| p.join("ffmpeg")).find(|p| p.is_file())
}

/// Strips prefixes such as "[name @ address]" from an ffmpeg message.
fn without_address(line: &str) -> &str {
    let mut line = line.trim();
    while let Some((_, rest)) = line.strip_prefix('[').and_then(|l| l.split_once("] ")) {
        line = rest;
    }
    line
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn messages_have_no_addresses() {
        assert_eq!(
            without_address("[in#0 @ 0x5] [enc:png @ 0x6] Duplicate element"),
            "Duplicate element"
        );
        assert_eq!(without_address("Truncating packet"), "Truncating packet");
    }
}
