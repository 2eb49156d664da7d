//! Folder of a published site. It is written atomically, and replaces nothing but an earlier site.

use super::PublishError;
use crate::host::temporary::Temporary;
use std::io::{Error, ErrorKind};
use std::path::{Path, PathBuf};

/// Files of a published site that don't depend on the light field, each as (name, contents).
const PAGE: [(&str, &str); 9] = [
    ("index.html", include_str!("page/index.html")),
    ("icon.svg", include_str!("../live/page/icon.svg")),
    ("style.css", include_str!("page/style.css")),
    ("shaders.js", include_str!("page/shaders.js")),
    ("frames.js", include_str!("page/frames.js")),
    ("renderer.js", include_str!("page/renderer.js")),
    ("viewpoint.js", include_str!("page/viewpoint.js")),
    ("input.js", include_str!("page/input.js")),
    ("main.js", include_str!("page/main.js")),
];
/// Name of a published site's file with the light field's description.
const SCENE: &str = "scene.js";
/// Name of a published site's folder that contains the files of frames.
const FRAMES: &str = "frames";
/// Text in the `index.html` of every site, by which a folder is recognized as an earlier site.
const MARK: &str = "<meta name=\"generator\" content=\"stlfr publish\">";
/// Maximum size of an `index.html` that is read to recognize an earlier site, bytes.
const MAX_INDEX_BYTES: u64 = 1 << 20;

/// Returns the path of a file of frames, relative to the site's folder. `index` is the file's number, from 0.
fn frames_file(index: usize) -> String {
    format!("{FRAMES}/{index:04}.js")
}

/// Files of a published site that depend on the light field, as (relative path, text). They contain the light field's
/// description, and the frames.
pub(super) struct SiteFiles {
    files: Vec<(String, String)>,
}

impl SiteFiles {
    /// Creates the site's files from a light field's description and its frames. `frames` has one text in base64 per
    /// file.
    pub fn new(scene: &serde_json::Value, frames: Vec<String>) -> Self {
        let mut files = vec![(SCENE.to_owned(), format!("stlfr.scene({scene});\n"))];
        let frames = frames.into_iter().enumerate();
        files.extend(
            frames.map(|(k, text)| (frames_file(k), format!("stlfr.frames({k}, \"{text}\");\n"))),
        );
        Self { files }
    }

    /// Returns the size of all files of the site together, bytes. It includes the page's own files.
    pub fn bytes(&self) -> u64 {
        let page: usize = PAGE.iter().map(|(_, text)| text.len()).sum();
        self.files.iter().map(|(_, text)| text.len() as u64).sum::<u64>() + page as u64
    }

    /// Writes the site's folder. An earlier site in the folder is replaced. An error if the folder has any other
    /// content ([`check_folder`]).
    pub fn write(&self, folder: &Path) -> Result<(), PublishError> {
        let failed = |source| PublishError::Write { path: folder.to_owned(), source };
        check_folder(folder)?;
        self.replace(folder).map_err(failed)
    }

    fn replace(&self, folder: &Path) -> std::io::Result<()> {
        let absolute = std::path::absolute(folder)?;
        let parent = absolute.parent().ok_or_else(|| Error::from(ErrorKind::InvalidFilename))?;
        let temporary = Temporary::inside(parent)?;
        let [new, old] = ["new", "old"].map(|name| temporary.path().join(name));
        std::fs::create_dir_all(new.join(FRAMES))?;
        let page = PAGE.iter().map(|(name, text)| (*name, *text));
        for (name, text) in page.chain(self.files.iter().map(|(n, t)| (&**n, &**t))) {
            std::fs::write(new.join(name), text)?;
        }
        if !absolute.is_dir() {
            return temporary.place("new", &absolute);
        }
        // The earlier site is moved into the temporary folder, and is removed with it.
        std::fs::rename(&absolute, &old)?;
        temporary.place("new", &absolute).inspect_err(|_| {
            // If the earlier site can't be moved back either, the first error is still reported.
            let _ = std::fs::rename(&old, &absolute);
        })
    }
}

/// Returns an error unless a site can be written to `folder`: the folder is missing, is empty, or contains an earlier
/// site and nothing else.
pub fn check_folder(folder: &Path) -> Result<(), PublishError> {
    let refused = |reason: String| Err(PublishError::Folder { path: folder.to_owned(), reason });
    let Ok(found) = folder.symlink_metadata() else { return Ok(()) };
    if found.is_symlink() {
        return refused("is a link, which is not written through".into());
    }
    if !found.is_dir() {
        return refused("is no folder".into());
    }
    let failed = |source| PublishError::Write { path: folder.to_owned(), source };
    let names = names(folder).map_err(failed)?;
    if names.is_empty() {
        return Ok(());
    }
    let index = crate::host::read_text(&folder.join("index.html"), MAX_INDEX_BYTES);
    if !index.is_ok_and(|text| text.contains(MARK)) {
        return refused("holds other files, and a site needs a folder of its own".into());
    }
    let is_ours = |name: &PathBuf| {
        let name = name.to_string_lossy();
        let number = name.strip_prefix("frames/").and_then(|n| n.strip_suffix(".js"));
        PAGE.iter().any(|(ours, _)| *ours == name)
            || [SCENE, FRAMES].contains(&&*name)
            || number.is_some_and(|n| n.len() >= 4 && n.bytes().all(|b| b.is_ascii_digit()))
    };
    match names.iter().find(|name| !is_ours(name)) {
        Some(name) => refused(format!(
            "holds {}, which is no part of a site and would be lost",
            name.display()
        )),
        None => Ok(()),
    }
}

/// Returns the relative paths of the files in a folder and in its subfolder of frames.
fn names(folder: &Path) -> std::io::Result<Vec<PathBuf>> {
    let mut names = Vec::new();
    for inside in ["", FRAMES] {
        let path = folder.join(inside);
        if inside.is_empty() || path.symlink_metadata().is_ok_and(|found| found.is_dir()) {
            for entry in std::fs::read_dir(&path)? {
                names.push(Path::new(inside).join(entry?.file_name()));
            }
        }
    }
    Ok(names)
}
