//! Files that the command line names: checked before long work, in one sentence each.

use super::CliError;
use serde::de::DeserializeOwned;
use std::path::Path;
use stlfr::camera::{Camera, CameraFormat};

/// Refuses what is no readable file.
pub fn must_be_a_file(path: &Path) -> Result<(), CliError> {
    match std::fs::metadata(path) {
        Ok(metadata) if metadata.is_file() => Ok(()),
        Ok(_) => Err(CliError::BadInput(format!("{}: is no file", path.display()))),
        Err(error) => Err(wrong(path, error)),
    }
}

/// Refuses an output whose folder, or the nearest one above that exists, can't be written to.
pub fn must_be_writable(output: &Path) -> Result<(), CliError> {
    let absolute = std::path::absolute(output).map_err(|e| wrong(output, e))?;
    // The output itself counts where it is a folder already.
    let Some(folder) = absolute.ancestors().find(|p| p.is_dir()) else {
        return Err(CliError::BadInput(format!("{}: has no folder to be in", output.display())));
    };
    let probe = folder.join(format!(".stlfr-{}.tmp", std::process::id()));
    let result = std::fs::File::create(&probe).and_then(|_| std::fs::remove_file(&probe));
    result.map_err(|error| {
        CliError::BadInput(format!("{}: can't be written ({error})", output.display()))
    })
}

/// A JSON file of options; the defaults without one.
pub fn options_or_default<T: DeserializeOwned + Default>(
    path: Option<&Path>,
) -> Result<T, CliError> {
    path.map_or_else(|| Ok(T::default()), read_json)
}

/// A view to render.
pub fn read_view(path: &Path) -> Result<Camera, CliError> {
    read_json::<CameraFormat>(path)?.camera().map_err(|error| wrong(path, error))
}

fn read_json<T: DeserializeOwned>(path: &Path) -> Result<T, CliError> {
    let text = std::fs::read_to_string(path).map_err(|error| wrong(path, error))?;
    serde_json::from_str(&text).map_err(|error| wrong(path, error))
}

fn wrong(path: &Path, error: impl std::fmt::Display) -> CliError {
    CliError::BadInput(format!("{}: {error}", path.display()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn views_name_file_and_field() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("view.json");
        let view = |model: &str, more: &str| {
            let json = format!(
                r#"{{"width": 64, "height": 48, "model": "{model}", "params": [64, 64, 32, 24],
                "cam_from_world": {{"rotation_wxyz": [1, 0, 0, 0], "translation": [0, 0, 0]}}{more}}}"#
            );
            std::fs::write(&path, json).unwrap();
            read_view(&path)
        };
        assert_eq!(view("PINHOLE", "").unwrap().width, 64);
        for (result, field) in
            [(view("FISHEYE", ""), "model"), (view("PINHOLE", r#", "fov": 1"#), "fov")]
        {
            let message = result.unwrap_err().to_string();
            assert!(message.contains("view.json") && message.contains(field), "{message}");
        }
        assert!(read_view(Path::new("/nowhere.json")).is_err());
    }

    #[test]
    fn outputs_are_tried() {
        let folder = tempfile::tempdir().unwrap();
        must_be_writable(&folder.path().join("a/b/c.png")).unwrap();
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
        assert!(must_be_writable(Path::new("/proc/none/c.png")).is_err());
    }
}
