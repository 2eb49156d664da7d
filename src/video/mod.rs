//! Video files, through an ffmpeg that runs as a child process: never through a shell, and with
//! nothing of a file's name taken for an option.

mod reader;
mod writer;

pub(crate) use reader::frame_name;
pub use reader::{Decoded, decode};
pub use writer::{Codec, VideoWriter};

use std::path::{Path, PathBuf};

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

/// An ffmpeg to run: the system's, else the one that comes with the project's environment.
pub fn find_ffmpeg(project_root: &Path) -> Option<PathBuf> {
    let on_path = std::env::var_os("PATH").and_then(|paths| {
        std::env::split_paths(&paths).map(|p| p.join("ffmpeg")).find(|p| p.is_file())
    });
    on_path.or_else(|| {
        let lib = project_root.join(".venv/lib/python3.11/site-packages/imageio_ffmpeg/binaries");
        std::fs::read_dir(lib).ok()?.filter_map(|entry| Some(entry.ok()?.path())).find(|path| {
            path.file_name().is_some_and(|name| name.to_string_lossy().starts_with("ffmpeg-"))
        })
    })
}
