//! `review.json`: the layout of the Blender file `review.blend`.

use super::TRADITIONAL;
use super::results::{Metrics, SyncResult, ViewMethod, ViewResult};
use super::video::ReviewVideo;
use crate::interpolation::SyncMethod;
use crate::method::Method;
use serde::Serialize;

/// Name of the layout file in the comparison's folder.
pub const FILE: &str = "review.json";

/// Display time of a still picture in the review, seconds.
const STILL_S: f64 = 2.0;

/// Frame rate of the review's sequences of still pictures, hertz.
const STILL_RATE_HZ: f64 = 12.0;

/// Contents of `review.json`. Paths are relative to the file's folder.
#[derive(Debug, Serialize)]
pub(super) struct ReviewLayout {
    format: &'static str,
    version: u32,
    title: String,
    /// Factor by which difference images are amplified.
    difference_gain: f32,
    reels: Vec<Reel>,
}

/// A sequence of shots in the Blender file, with a common frame rate.
#[derive(Debug, Serialize)]
struct Reel {
    name: &'static str,
    rate_hz: f64,
    shots: Vec<ReviewShot>,
}

/// The ground-truth picture or video and those of two methods, shown side by side for a number of frames. A missing
/// picture is `None`.
#[derive(Debug, Serialize)]
struct ReviewShot {
    label: String,
    frames: usize,
    is_movie: bool,
    truth: Option<String>,
    traditional: Option<ReviewPanel>,
    space_time: Option<ReviewPanel>,
}

#[derive(Debug, Serialize)]
struct ReviewPanel {
    title: String,
    file: String,
}

/// Returns the layout of the review. It has up to three sequences: the video, the blended views, and the images of the
/// capture's cameras.
pub(super) fn layout(metrics: &Metrics, video: Option<&ReviewVideo>) -> ReviewLayout {
    let mut reels: Vec<Reel> = video.map(movie_reel).into_iter().collect();
    for (name, shots) in [("Views", view_shots(metrics)), ("Cameras", camera_shots(metrics))] {
        if !shots.is_empty() {
            reels.push(Reel { name, rate_hz: STILL_RATE_HZ, shots });
        }
    }
    ReviewLayout {
        format: "stlfr-review",
        version: 1,
        title: metrics.capture.name.clone(),
        difference_gain: metrics.options.difference_gain,
        reels,
    }
}

fn movie_reel(video: &ReviewVideo) -> Reel {
    let file = |name: &str| Some(video.movies.iter().find(|(n, _)| *n == name)?.1.clone());
    let panel = |method: ViewMethod| {
        Some(ReviewPanel { title: method.help().into(), file: file(method.name())? })
    };
    let shot = ReviewShot {
        label: video.view.clone(),
        frames: video.frames,
        is_movie: true,
        truth: file("truth"),
        traditional: panel(ViewMethod::TraditionalLfr),
        space_time: panel(ViewMethod::StLfr),
    };
    Reel { name: "Video", rate_hz: video.rate_hz, shots: vec![shot] }
}

/// Makes a shot of still pictures. `panels` are the pictures of traditional and of space-time light field rendering, in
/// this order. The ground-truth picture is the file `truth.png` in the same folder. Returns `None` if neither method
/// has a picture.
fn still(label: String, panels: [Option<ReviewPanel>; 2]) -> Option<ReviewShot> {
    let (folder, _) = panels.iter().flatten().next()?.file.rsplit_once('/')?;
    let truth = Some(format!("{folder}/truth.png"));
    let [traditional, space_time] = panels;
    let frames = (STILL_S * STILL_RATE_HZ) as usize;
    Some(ReviewShot { label, frames, is_movie: false, truth, traditional, space_time })
}

fn view_shots(metrics: &Metrics) -> Vec<ReviewShot> {
    let ours = metrics.views.iter().filter(|row| row.method == ViewMethod::StLfr);
    let shot = |row: &ViewResult| {
        let proxy = row.proxy.name();
        let panel = |method: ViewMethod| {
            let same =
                |r: &&ViewResult| r.view == row.view && r.proxy == row.proxy && r.method == method;
            let file = metrics.views.iter().find(same)?.image.clone()?;
            Some(ReviewPanel { title: format!("{}, {proxy}", method.help()), file })
        };
        let label = format!("{} at {:.4} s, {proxy}", row.view, row.time_s);
        still(label, [ViewMethod::TraditionalLfr, ViewMethod::StLfr].map(panel))
    };
    ours.filter_map(shot).collect()
}

fn camera_shots(metrics: &Metrics) -> Vec<ReviewShot> {
    let ours = metrics.sync.iter().filter(|row| row.method == metrics.options.sync);
    let shot = |row: &SyncResult| {
        let panel = |method: SyncMethod| {
            let same = |r: &&SyncResult| r.view == row.view && r.method == method;
            let file = metrics.sync.iter().find(same)?.image.clone()?;
            Some(ReviewPanel { title: format!("{}, {}", row.camera, method.name()), file })
        };
        let label = format!("{} at {:.4} s", row.view, row.time_s);
        still(label, [TRADITIONAL, row.method].map(panel))
    };
    ours.filter_map(shot).collect()
}
