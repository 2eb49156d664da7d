//! Outputs that the command line names: checked before long work, in one sentence each.

use super::CliError;
use super::error::of_io;
use std::path::{Path, PathBuf};
use stlfr::capture::{OutputError, OutputGuard};
use stlfr::host::try_folder;

/// What a command is to write.
#[derive(Clone, Copy)]
pub enum CommandOutput<'a> {
    File(&'a Path),
    /// A folder, and the files in it whose names are known.
    Folder(&'a Path, &'a [&'a str]),
    /// A folder that is a capture or becomes one.
    Capture(&'a Path),
}

impl From<OutputError> for CliError {
    fn from(error: OutputError) -> Self {
        Self::BadInput(error.to_string())
    }
}

impl CommandOutput<'_> {
    /// Refuses an output that can't be written, or that would take the place of something that is no
    /// regular file or belongs to a capture. The capture in the folder `own`, which the command reads,
    /// need not be around it.
    pub fn check(self, own: Option<&Path>) -> Result<(), CliError> {
        let mut guard = OutputGuard::new(own);
        match self {
            Self::File(path) => guard.check_file(path)?,
            Self::Folder(path, files) => guard.check_folder(path, files)?,
            Self::Capture(path) => guard.check_capture(path)?,
        }
        let (Self::File(path) | Self::Folder(path, _) | Self::Capture(path)) = self;
        must_be_writable(path)
    }
}

/// As [`CommandOutput::check`], for many files.
pub fn check_files(
    files: impl Iterator<Item = PathBuf>,
    own: Option<&Path>,
) -> Result<(), CliError> {
    let mut guard = OutputGuard::new(own);
    let mut tried = None;
    for file in files {
        guard.check_file(&file)?;
        let folder = file.parent().map(Path::to_owned);
        if folder != tried {
            must_be_writable(&file)?;
            tried = folder;
        }
    }
    Ok(())
}

/// An error if the output's folder, or the nearest one above that exists, can't be written to.
fn must_be_writable(output: &Path) -> Result<(), CliError> {
    let failed = |error: std::io::Error| {
        of_io(format!("{}: can't be written ({error})", output.display()), &error)
    };
    let absolute = std::path::absolute(output).map_err(failed)?;
    // The output itself counts where it is a folder already. What is there and is no folder can't
    // have the output in it.
    let nearest = absolute.ancestors().find(|p| p.is_dir() || (p.exists() && *p != absolute));
    let Some(folder) = nearest.filter(|p| p.is_dir()) else {
        return Err(CliError::BadInput(format!("{}: has no folder to be in", output.display())));
    };
    try_folder(folder).map_err(failed)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn outputs_are_tried() {
        let folder = tempfile::tempdir().unwrap();
        let check = |path: &Path| CommandOutput::File(path).check(None);
        check(&folder.path().join("a/b/c.png")).unwrap();
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
        assert!(check(Path::new("/proc/none/c.png")).is_err());
        std::fs::write(folder.path().join("file"), "").unwrap();
        check(&folder.path().join("file")).unwrap();
        assert!(check(&folder.path().join("file/c.png")).is_err());
        assert!(CommandOutput::Folder(&folder.path().join("file"), &[]).check(None).is_err());
        let many = ["0.png", "1.png"].map(|name| folder.path().join("many").join(name));
        check_files(many.into_iter(), None).unwrap();
    }
}
