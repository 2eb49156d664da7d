//! `review.json`: the layout of `review.blend`.

use super::results::{Metrics, ViewMethod};
use super::{TRADITIONAL, video};
use crate::interpolation::SyncMethod;
use crate::method::Method;
use serde::Serialize;

/// The file's name in the review's folder.
pub const FILE: &str = "review.json";

/// Display time of a still, seconds.
const STILL_S: f64 = 2.0;

/// Frame rate without a video, hertz.
const STILL_RATE_HZ: f64 = 12.0;

/// The whole file. Paths are relative to its folder.
#[derive(Debug, Serialize)]
pub(super) struct Layout {
    format: &'static str,
    version: u32,
    title: String,
    /// Factor of the differences.
    difference_gain: f32,
    reels: Vec<Reel>,
}

/// A sequence of shots with one frame rate.
#[derive(Debug, Serialize)]
struct Reel {
    name: &'static str,
    rate_hz: f64,
    shots: Vec<Shot>,
}

/// The truth and two methods, side by side for a number of frames. `None` for a missing picture.
#[derive(Debug, Serialize)]
struct Shot {
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

/// New views, the filming cameras' images, and the video.
pub(super) fn layout(metrics: &Metrics, video: Option<&video::Written>) -> Layout {
    let mut reels: Vec<Reel> = video.map(movie_reel).into_iter().collect();
    for (name, shots) in [("Views", view_shots(metrics)), ("Cameras", camera_shots(metrics))] {
        if !shots.is_empty() {
            reels.push(Reel { name, rate_hz: STILL_RATE_HZ, shots });
        }
    }
    Layout {
        format: "stlfr-review",
        version: 1,
        title: metrics.capture.name.clone(),
        difference_gain: metrics.options.difference_gain,
        reels,
    }
}

fn movie_reel(video: &video::Written) -> Reel {
    let file = |slug: &str| video.movies.iter().find(|m| m.slug == slug).map(|m| m.file.clone());
    let panel = |method: ViewMethod| {
        Some(ReviewPanel { title: method.title().into(), file: file(method.slug())? })
    };
    let shot = Shot {
        label: video.view.clone(),
        frames: video.frames,
        is_movie: true,
        truth: file("truth"),
        traditional: panel(ViewMethod::TraditionalLfr),
        space_time: panel(ViewMethod::StLfr),
    };
    Reel { name: "Video", rate_hz: video.rate_hz, shots: vec![shot] }
}

/// Path of the true picture, in the folder of the methods' pictures.
fn truth_beside(file: &str) -> Option<String> {
    Some(format!("{}/truth.png", file.rsplit_once('/')?.0))
}

fn still(
    label: String,
    traditional: Option<ReviewPanel>,
    space_time: Option<ReviewPanel>,
) -> Option<Shot> {
    let any = traditional.as_ref().or(space_time.as_ref())?;
    Some(Shot {
        label,
        frames: (STILL_S * STILL_RATE_HZ) as usize,
        is_movie: false,
        truth: truth_beside(&any.file),
        traditional,
        space_time,
    })
}

fn view_shots(metrics: &Metrics) -> Vec<Shot> {
    let rows = || metrics.views.iter();
    rows()
        .filter(|row| row.method == ViewMethod::StLfr)
        .filter_map(|row| {
            let panel = |method: ViewMethod| {
                let same = |r: &&super::results::ViewResult| {
                    r.view == row.view && r.proxy == row.proxy && r.method == method
                };
                let file = rows().find(same)?.image.clone()?;
                Some(ReviewPanel {
                    title: format!("{}, {}", method.title(), row.proxy.name()),
                    file,
                })
            };
            let label = format!("{} at {:.4} s, {}", row.view, row.time_s, row.proxy.name());
            still(label, panel(ViewMethod::TraditionalLfr), panel(ViewMethod::StLfr))
        })
        .collect()
}

fn camera_shots(metrics: &Metrics) -> Vec<Shot> {
    let rows = || metrics.sync.iter();
    rows()
        .filter(|row| row.method == metrics.options.sync)
        .filter_map(|row| {
            let panel = |method: SyncMethod| {
                let found = rows().find(|r| r.view == row.view && r.method == method)?;
                Some(ReviewPanel {
                    title: format!("{}, {}", row.camera, method.name()),
                    file: found.image.clone()?,
                })
            };
            let label = format!("{} at {:.4} s", row.view, row.time_s);
            still(label, panel(TRADITIONAL), panel(row.method))
        })
        .collect()
}
