//! The images of a sequence that this process renders: all images, some parts of the sequence, or the images that no
//! other process renders.

use super::CliError;
use super::error::written;
use super::values::ImageOutput;
use crate::host::{Claim, Claims, Taken};
use std::collections::VecDeque;
use std::path::{Path, PathBuf};
use std::time::Duration;

/// Interval at which this process checks again whether other processes have finished their images. With a longer
/// interval, finished images are noticed later. With a shorter interval, there is more file access.
const LOOK: Duration = Duration::from_millis(300);

/// A folder through which several processes divide the images of a sequence among themselves.
#[derive(Clone)]
pub struct SharedFolder {
    claims: Claims,
    folder: PathBuf,
}

impl SharedFolder {
    /// Removes the shared folder. Must be called when all images of the sequence are rendered.
    pub fn end(&self) -> Result<(), CliError> {
        written(&self.folder, self.claims.end())
    }

    /// Removes the shared folder after rendering has failed. The folder is kept if some images are rendered, or if
    /// other processes use it.
    pub fn end_unused(&self) {
        // An error is ignored here, because the failure is reported, and a remaining folder does no harm.
        let _ = self.claims.end_unused();
    }
}

/// Iterator over the images that this process has to render, in order. At the end, the iterator waits for the images
/// that other processes render, and takes over the images of processes that have ended without finishing them.
pub struct Frames<'a> {
    output: &'a ImageOutput,
    claims: Option<SharedFolder>,
    left: VecDeque<usize>,
    elsewhere: Vec<usize>,
}

impl<'a> Frames<'a> {
    /// Creates the iterator over the given images for a process that renders alone.
    pub fn all(output: &'a ImageOutput, frames: impl Iterator<Item = usize>) -> Self {
        Self { output, claims: None, left: frames.collect(), elsewhere: Vec::new() }
    }

    /// Creates the iterator over the first `count` images, which are divided among all processes that use the same
    /// folder.
    pub fn shared(output: &'a ImageOutput, count: usize, folder: &Path) -> Result<Self, CliError> {
        let claims = written(folder, Claims::join(folder))?;
        let claims = Some(SharedFolder { claims, folder: folder.to_owned() });
        Ok(Self { claims, ..Self::all(output, 0..count) })
    }

    /// Returns the folder through which the images are divided among processes; `None` if this process renders alone.
    pub fn shared_folder(&self) -> Option<SharedFolder> {
        self.claims.clone()
    }
}

impl Iterator for Frames<'_> {
    type Item = Result<(usize, Option<Claim>), CliError>;

    fn next(&mut self) -> Option<Self::Item> {
        loop {
            let Some(frame) = self.left.pop_front() else {
                if self.elsewhere.is_empty() {
                    return None;
                }
                std::thread::sleep(LOOK);
                self.left.extend(self.elsewhere.drain(..));
                continue;
            };
            let Some(SharedFolder { claims, folder }) = &self.claims else {
                return Some(Ok((frame, None)));
            };
            match written(folder, claims.take(frame)) {
                Ok(Taken::Mine(claim)) => return Some(Ok((frame, Some(claim)))),
                Ok(Taken::Elsewhere) => self.elsewhere.push(frame),
                // An image that was rendered and then deleted is rendered again.
                Ok(Taken::Done) if !self.output.file(frame).is_some_and(|f| f.exists()) => {
                    return Some(Ok((frame, None)));
                }
                Ok(Taken::Done) => {}
                Err(error) => return Some(Err(error)),
            }
        }
    }
}
