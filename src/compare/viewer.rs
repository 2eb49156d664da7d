//! Data of the report's viewer: the picture files of every view, by proxy geometry and method.

use super::results::{Metrics, SyncResult, ViewMethod, ViewResult, used};
use super::truths::TrueImage;
use crate::method::Method;
use crate::metrics::RegionScores;
use crate::raster::Image;
use serde::Serialize;

/// Number of columns and rows of the grid of image cells that is searched for the magnifier's initial position.
const GRID: [usize; 2] = [16, 12];

/// File and title of a comparison sheet.
#[derive(Clone, Debug, Serialize)]
pub(super) struct SheetFile {
    pub file: String,
    pub title: String,
}

/// A ground-truth image that the viewer shows next to the rendered images.
#[derive(Clone, Debug)]
pub(super) struct Figure {
    /// Id of the view in the ground truth.
    view: String,
    /// File of the ground-truth image, relative to the comparison's folder.
    truth: String,
    pub sheets: Vec<SheetFile>,
    size_px: [usize; 2],
    /// Initial centre of the magnifier, as fractions of the image's width and height.
    focus: [f64; 2],
}

impl Figure {
    /// Makes a figure. Its magnifier is initially where the first rendered image differs most from the ground-truth
    /// image. If any surface moves, only pixels of moving surfaces count. Without a rendered image, the magnifier is in
    /// the middle.
    pub fn new(
        view: &str,
        file: String,
        sheets: Vec<SheetFile>,
        truth: &TrueImage,
        first: Option<&Image>,
    ) -> Self {
        let size_px = [truth.image.width(), truth.image.height()];
        let focus = first.map_or([0.5; 2], |image| focus(truth, image));
        Self { view: view.to_owned(), truth: file, sheets, size_px, focus }
    }
}

/// Finds the block of 2×2 cells of [`GRID`] in which `image` differs most from the ground-truth image, by the sum of
/// absolute differences. Returns the block's centre, as fractions of the image's width and height. If any surface
/// moves, only pixels of moving surfaces count.
fn focus(truth: &TrueImage, image: &Image) -> [f64; 2] {
    let [columns, rows] = GRID;
    let (width, height, channels) =
        (truth.image.width(), truth.image.height(), truth.image.channels());
    let is_still = !truth.moving.contains(&true);
    let mut sums = vec![0.0; columns * rows];
    let pixels = truth.image.data().chunks(channels).zip(image.data().chunks(channels));
    for (k, (a, b)) in pixels.enumerate().filter(|(k, _)| is_still || truth.moving[*k]) {
        let cell = (k / width * rows / height) * columns + k % width * columns / width;
        sums[cell] += a.iter().zip(b).map(|(a, b)| f64::from((a - b).abs())).sum::<f64>();
    }
    let sum = |(column, row): &(usize, usize)| {
        let at = row * columns + column;
        sums[at] + sums[at + 1] + sums[at + columns] + sums[at + columns + 1]
    };
    let corners = (0..rows - 1).flat_map(|row| (0..columns - 1).map(move |column| (column, row)));
    let best = corners.max_by(|a, b| sum(a).total_cmp(&sum(b))).unwrap_or_default();
    [(best.0 + 1) as f64 / columns as f64, (best.1 + 1) as f64 / rows as f64]
}

/// A group of views in the report's viewer. The pictures of each view are arranged in a table; all views of the group
/// have the same rows and columns.
#[derive(Debug, Serialize)]
pub(super) struct ViewerGroup {
    title: &'static str,
    /// Titles of the table's rows. If there is only one row, its title may be empty.
    rows: Vec<&'static str>,
    columns: Vec<&'static str>,
    /// Row and column of the picture that the viewer shows first.
    start: [usize; 2],
    views: Vec<ViewerView>,
}

#[derive(Debug, Serialize)]
struct ViewerView {
    title: String,
    /// File of the ground-truth image, relative to the comparison's folder.
    truth: String,
    size_px: [usize; 2],
    focus: [f64; 2],
    /// The view's pictures, indexed by the row and the column of the group's table.
    cells: Vec<Vec<ViewerCell>>,
}

#[derive(Debug, Default, Serialize)]
struct ViewerCell {
    file: Option<String>,
    scores: Option<RegionScores>,
    /// Sentence that says why the picture is missing. `None` if there is a picture.
    reason: Option<String>,
}

/// Returns the views of a comparison in two groups: first the new views, then the views of the capture's cameras. A
/// group without views is left out.
pub(super) fn groups(metrics: &Metrics, figures: &[Figure]) -> Vec<ViewerGroup> {
    let mut groups = vec![new_views(metrics, figures), filming_cameras(metrics, figures)];
    groups.retain(|group| !group.views.is_empty());
    groups
}

fn new_views(metrics: &Metrics, figures: &[Figure]) -> ViewerGroup {
    let proxies = used(metrics.views.iter().map(|row| row.proxy));
    let rendered = metrics.headline.methods.iter().find(|m| m.is_rendered).map(|m| m.proxy);
    let row = proxies.iter().position(|proxy| Some(*proxy) == rendered).unwrap_or(0);
    let column = ViewMethod::ALL.iter().position(|method| *method == ViewMethod::StLfr);
    let view = |figure: &Figure| {
        let own = || metrics.views.iter().filter(|row| row.view == figure.view);
        let time_s = own().next()?.time_s;
        let cell = |proxy, method| {
            let found = own().find(|row| row.proxy == proxy && row.method == method);
            found.map_or_else(ViewerCell::default, ViewerCell::of_view)
        };
        let cells = proxies.iter().map(|proxy| {
            ViewMethod::ALL.iter().map(|method| cell(*proxy, *method)).collect::<Vec<_>>()
        });
        Some(figure.view(format!("{} at {time_s:.4} s", figure.view), cells.collect()))
    };
    ViewerGroup {
        title: "New views",
        rows: proxies.iter().map(|proxy| proxy.name()).collect(),
        columns: ViewMethod::ALL.iter().map(|method| method.help()).collect(),
        start: [row, column.unwrap_or(0)],
        views: figures.iter().filter_map(view).collect(),
    }
}

fn filming_cameras(metrics: &Metrics, figures: &[Figure]) -> ViewerGroup {
    let methods = used(metrics.sync.iter().map(|row| row.method));
    let column = methods.iter().position(|method| *method == metrics.options.sync);
    let view = |figure: &Figure| {
        let own = || metrics.sync.iter().filter(|row| row.view == figure.view);
        let first = own().next()?;
        let cell = |method| {
            let found = own().find(|row| row.method == method);
            found.map_or_else(ViewerCell::default, ViewerCell::of_camera)
        };
        let cells = methods.iter().map(|method| cell(*method)).collect();
        Some(figure.view(format!("{} at {:.4} s", first.camera, first.time_s), vec![cells]))
    };
    ViewerGroup {
        title: "Filming cameras, synchronized",
        rows: vec![""],
        columns: methods.iter().map(|method| method.name()).collect(),
        start: [0, column.unwrap_or(0)],
        views: figures.iter().filter_map(view).collect(),
    }
}

impl Figure {
    fn view(&self, title: String, cells: Vec<Vec<ViewerCell>>) -> ViewerView {
        let truth = self.truth.clone();
        ViewerView { title, truth, size_px: self.size_px, focus: self.focus, cells }
    }
}

impl ViewerCell {
    fn of_view(row: &ViewResult) -> Self {
        Self { file: row.image.clone(), scores: row.scores, reason: row.reason.clone() }
    }

    fn of_camera(row: &SyncResult) -> Self {
        Self { file: row.image.clone(), scores: row.scores, reason: row.reason.clone() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_loupe_is_where_the_moving_part_differs_most() {
        let mut image = Image::filled(64, 48, 1, 0.5);
        let truth = |moving| TrueImage { image: Image::filled(64, 48, 1, 0.5), moving };
        image.data_mut()[40 * 64 + 10] = 0.9;
        image.data_mut()[12 * 64 + 50] = 0.6;
        let near = |[x, y]: [f64; 2], at: [f64; 2]| {
            (64.0 * x - at[0]).abs() <= 4.0 && (48.0 * y - at[1]).abs() <= 4.0
        };
        assert!(near(focus(&truth(vec![false; 64 * 48]), &image), [10.0, 40.0]));
        let moving = (0..64 * 48).map(|k| k % 64 >= 32).collect();
        assert!(near(focus(&truth(moving), &image), [50.0, 12.0]));
        let tiny = TrueImage { image: Image::filled(1, 1, 1, 0.5), moving: vec![true] };
        assert!(focus(&tiny, &tiny.image).iter().all(|v| (0.0..=1.0).contains(v)));
    }
}
