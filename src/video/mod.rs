//! Video files, through an ffmpeg that runs as a child process: never through a shell, and with
//! nothing of a file's name taken for an option.

mod reader;
mod writer;

pub(crate) use reader::frame_name;
pub use reader::{Decoded, decode};
pub use writer::{Codec, VideoFormat, VideoWriter};

use std::path::PathBuf;

/// Why a video was not read or written. Every message is one sentence.
#[derive(Debug, thiserror::Error)]
pub enum VideoError {
    /// ffmpeg's own words.
    #[error("{path}: can't be written ({reason})")]
    Encode { path: PathBuf, reason: String },
    /// What is wrong with a file that should be a video.
    #[error("{reason}")]
    Decode { reason: String },
    #[error("{path}: {source}")]
    File { path: PathBuf, source: std::io::Error },
}

/// The system's ffmpeg: the first one on `PATH`.
pub fn ffmpeg_on_path() -> Option<PathBuf> {
    let paths = std::env::var_os("PATH")?;
    std::env::split_paths(&paths).map(|p| p.join("ffmpeg")).find(|p| p.is_file())
}
