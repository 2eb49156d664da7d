//! Lookup of views by name: a camera of the capture, or a view of its ground truth.

use super::{CAPTURE_FILE, Capture, CaptureError, Truth, TruthView};
use crate::camera::Camera;
use crate::text::short;
use std::collections::BTreeSet;

/// A view that was found by its name.
#[derive(Clone, Debug)]
pub enum NamedView {
    /// A camera of the capture, as an index into [`Capture::cameras`].
    Filming(usize),
    /// A view that no camera of the capture has: its image size, lens and pose.
    Free(Camera),
}

/// Largest number of names that the error message for an unknown name lists.
const LISTED: usize = 12;

impl TruthView {
    /// Returns the part of the view's id after the instant: `between` for `t0-between`.
    fn place(&self) -> &str {
        self.id.split_once('-').map_or(&self.id, |(_, place)| place)
    }
}

impl Capture {
    /// Finds a camera of the capture by its id. If there is none, finds a view of the ground truth by its id
    /// (`t0-between`) or by the part of its id after the instant (`between`).
    ///
    /// # Errors
    /// If no camera and no view has the name, or if the ground truth can't be read. The message for an unknown name
    /// lists the known names.
    pub fn named_view(&self, name: &str) -> Result<NamedView, CaptureError> {
        if let Some(index) = self.camera_index(name) {
            return Ok(NamedView::Filming(index));
        }
        let views = Truth::open(&self.folder)?.map_or_else(Vec::new, |truth| truth.views);
        let path = self.folder.join(CAPTURE_FILE);
        let Some(view) = views.iter().find(|view| view.id == name || view.place() == name) else {
            let reason = self.unknown_name(name, &views);
            return Err(CaptureError::content(&path, reason));
        };
        if let Some(index) = view.like.as_ref().and_then(|id| self.camera_index(id)) {
            return Ok(NamedView::Filming(index));
        }
        let camera = view.camera.camera();
        Ok(NamedView::Free(
            camera.map_err(|error| CaptureError::content(&path, error.to_string()))?,
        ))
    }

    fn unknown_name(&self, name: &str, views: &[TruthView]) -> String {
        let places: BTreeSet<&str> =
            views.iter().filter(|view| view.like.is_none()).map(TruthView::place).collect();
        let names: Vec<&str> = self.cameras.iter().map(|c| c.id.as_str()).chain(places).collect();
        let more = match names.len().saturating_sub(LISTED) {
            0 => String::new(),
            more => format!(" and {more} more"),
        };
        let listed = names[..names.len().min(LISTED)].join(", ");
        format!("no camera and no true view is called '{}'; there are {listed}{more}", short(name))
    }
}
