//! Stamps: files that mark the parts of the Python environment as complete. A stamp contains a hash of everything from
//! which its part of the environment was built.

use super::file_error;
use crate::host::{hash_file, ignore_absent, read_bytes, read_text, write_atomically};
use crate::toolchain::ToolchainError;
use std::path::{Path, PathBuf};

/// Maximum size of a stamp file or a `pyvenv.cfg`, bytes.
const MAX_STAMP_BYTES: u64 = 64 << 10;

/// The stamps of a source tree's Python environment: one for its packages, and one for its module `stlfr`.
pub(super) struct Stamps {
    pub packages: Stamp,
    pub module: Stamp,
}

/// A stamp: a file that marks a part of the Python environment as complete. A valid stamp contains the hash of
/// everything from which this part is built.
pub(super) struct Stamp {
    path: PathBuf,
    expected: String,
    /// Whether the stamp's file contains the expected hash. If so, this part of the environment is complete.
    pub found: bool,
}

impl Stamp {
    fn new(path: PathBuf, hasher: &blake3::Hasher) -> Self {
        let expected = hasher.finalize().to_string();
        let found = read_text(&path, MAX_STAMP_BYTES).is_ok_and(|text| text == expected);
        Self { path, expected, found }
    }

    pub fn write(&self) -> Result<(), ToolchainError> {
        write_atomically(&self.path, self.expected.as_bytes())
            .map_err(|e| file_error(&self.path, e))
    }

    /// Removes the file that marks a part of the Python environment as complete. This must be done before the part is
    /// replaced.
    pub fn remove(&self) -> Result<(), ToolchainError> {
        ignore_absent(std::fs::remove_file(&self.path)).map_err(|e| file_error(&self.path, e))
    }
}

impl Stamps {
    pub fn read(root: &Path) -> Result<Self, ToolchainError> {
        let venv = root.join(".venv");
        // `pyvenv.cfg` identifies the environment's Python. The environment's scripts contain the path of its
        // folder.
        let python = read_bytes(&venv.join("pyvenv.cfg"), MAX_STAMP_BYTES).unwrap_or_default();
        let mut packages = blake3::Hasher::new();
        add(&mut packages, root.as_os_str().as_encoded_bytes());
        add(&mut packages, &python);
        add_file(&mut packages, &root.join("blender/requirements.txt"))?;

        // The hash doesn't include the packages. When the packages are installed again, the environment's folder is
        // replaced, and with it the module's stamp.
        let mut module = blake3::Hasher::new();
        for file in module_sources(root)? {
            add(&mut module, file.as_os_str().as_encoded_bytes());
            add_file(&mut module, &file)?;
        }
        let mut stamps = Self {
            packages: Stamp::new(venv.join(".stlfr-packages"), &packages),
            module: Stamp::new(venv.join(".stlfr-module"), &module),
        };
        // The interpreter is a link to the system's Python, which may have been removed.
        stamps.packages.found &= venv.join("bin/python").exists();
        Ok(stamps)
    }

    pub fn is_whole(&self) -> bool {
        self.packages.found && self.module.found
    }
}

/// Returns the files from which the Python module is built, in a fixed order: the files of `src` except `main.rs`, the
/// files of `blender/module`, and the files of Cargo and `pyproject.toml`.
fn module_sources(root: &Path) -> Result<Vec<PathBuf>, ToolchainError> {
    let mut files: Vec<PathBuf> =
        ["Cargo.toml", "Cargo.lock", "blender/pyproject.toml"].map(|f| root.join(f)).into();
    walk(&root.join("src"), &mut files)?;
    walk(&root.join("blender/module"), &mut files)?;
    let program = root.join("src/main.rs");
    files.retain(|file| *file != program);
    files.sort();
    Ok(files)
}

fn walk(folder: &Path, files: &mut Vec<PathBuf>) -> Result<(), ToolchainError> {
    let failed = |e| file_error(folder, e);
    for entry in std::fs::read_dir(folder).map_err(failed)? {
        let path = entry.map_err(failed)?.path();
        if path.is_dir() {
            if path.file_name().is_some_and(|name| name != "__pycache__") {
                walk(&path, files)?;
            }
        } else {
            files.push(path);
        }
    }
    Ok(())
}

fn add(hasher: &mut blake3::Hasher, bytes: &[u8]) {
    hasher.update(&(bytes.len() as u64).to_le_bytes());
    hasher.update(bytes);
}

fn add_file(hasher: &mut blake3::Hasher, path: &Path) -> Result<(), ToolchainError> {
    hash_file(hasher, path).map_err(|e| file_error(path, e))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns a source tree with a complete Python environment.
    fn finished() -> tempfile::TempDir {
        let folder = tempfile::tempdir().unwrap();
        for file in [
            "Cargo.toml",
            "Cargo.lock",
            "src/lib.rs",
            "src/main.rs",
            "blender/pyproject.toml",
            "blender/requirements.txt",
            "blender/module/stlfr/__init__.py",
            ".venv/pyvenv.cfg",
            ".venv/bin/python",
        ] {
            write_atomically(&folder.path().join(file), file.as_bytes()).unwrap();
        }
        let stamps = Stamps::read(folder.path()).unwrap();
        assert!(!stamps.packages.found && !stamps.is_whole());
        stamps.packages.write().unwrap();
        stamps.module.write().unwrap();
        folder
    }

    /// Changes the file `file` of a source tree with a complete environment. Returns whether the environment's
    /// packages, and whether the whole environment, still count as complete.
    fn after(file: &str) -> (bool, bool) {
        let folder = finished();
        std::fs::write(folder.path().join(file), "changed").unwrap();
        let stamps = Stamps::read(folder.path()).unwrap();
        (stamps.packages.found, stamps.is_whole())
    }

    #[test]
    fn what_is_finished_stays_so() {
        assert_eq!(after("README.md"), (true, true));
        assert_eq!(after("src/main.rs"), (true, true));
    }

    #[test]
    fn sources_need_the_module_anew() {
        for file in ["src/lib.rs", "Cargo.lock", "blender/pyproject.toml", "blender/module/x.pyi"] {
            assert_eq!(after(file), (true, false), "{file}");
        }
    }

    #[test]
    fn pins_and_python_need_all_anew() {
        assert_eq!(after("blender/requirements.txt"), (false, false));
        assert_eq!(after(".venv/pyvenv.cfg"), (false, false));
        let folder = finished();
        std::fs::remove_file(folder.path().join(".venv/bin/python")).unwrap();
        assert!(!Stamps::read(folder.path()).unwrap().is_whole());
    }

    #[test]
    fn no_changed_bit_of_a_stamp_is_believed() {
        let folder = finished();
        for name in [".venv/.stlfr-packages", ".venv/.stlfr-module"] {
            let path = folder.path().join(name);
            let whole = std::fs::read(&path).unwrap();
            for at in 0..whole.len() {
                let mut changed = whole.clone();
                changed[at] ^= 1 << (at % 8);
                for bytes in [changed.as_slice(), &whole[..at]] {
                    std::fs::write(&path, bytes).unwrap();
                    assert!(!Stamps::read(folder.path()).unwrap().is_whole(), "{name} {at}");
                }
            }
            std::fs::write(&path, whole).unwrap();
        }
        assert!(Stamps::read(folder.path()).unwrap().is_whole());
    }

    #[test]
    fn half_written_stamps_do_not_count() {
        assert_eq!(after(".venv/.stlfr-packages"), (false, false));
        assert_eq!(after(".venv/.stlfr-module"), (true, false));
    }
}
