//! The viewpoint arguments of `stlfr render`, and the example command of `stlfr info`.

use super::CliError;
use super::error::written;
use super::files::read_view;
use super::values::{PathSource, Shift, job_word};
use crate::camera::Camera;
use crate::capture::{Capture, NamedView};
use crate::method::Method;
use nalgebra::{Point3, distance};
use std::path::{Path, PathBuf, absolute};

/// Arguments that choose the viewpoint. `--camera`, `--like` and `--path` form the clap group `view`, so that a command
/// can require one of them.
#[derive(Debug, clap::Args)]
pub struct ViewpointArgs {
    /// JSON file of the view: a camera in the format of capture.json.
    #[arg(long, value_name = "VIEW.json", group = "view")]
    pub camera: Option<PathBuf>,
    /// Name of the view: a camera of the capture, or a view of the ground truth, such as between.
    #[arg(long, value_name = "NAME", group = "view")]
    like: Option<String>,
    /// A camera path over position, direction, lens and time: path.json, the animated camera of my.blend, or one of
    /// sweep, orbit, bullet-time and dolly, which stay where the cameras see the whole view.
    #[arg(long, value_name = "PATH", group = "view")]
    pub path: Option<PathSource>,
    /// Move the view right, down and forward, in metres along its own axes, such as 0.03,0,0.
    #[arg(
        long,
        value_name = "X,Y,Z",
        allow_hyphen_values = true,
        requires = "view",
        conflicts_with = "path"
    )]
    shift: Option<Shift>,
}

impl ViewpointArgs {
    /// Reads the camera of the `--camera` file. Returns `None` without `--camera`.
    pub fn camera(&self) -> Result<Option<Camera>, CliError> {
        self.camera.as_deref().map(read_view).transpose()
    }

    /// Returns the name that `--like` gives; `None` without `--like`.
    pub fn name(&self) -> Option<&str> {
        self.like.as_deref()
    }

    /// Returns the command-line arguments that choose the same viewpoint in a command that runs in another folder.
    /// Paths are absolute.
    pub fn absolute_words(&self) -> Result<Vec<String>, CliError> {
        let file = |flag: &str, path: &Path| -> Result<String, CliError> {
            Ok(format!("--{flag}={}", job_word(&written(path, absolute(path))?)?))
        };
        let mut words: Vec<String> = self.like.iter().map(|id| format!("--like={id}")).collect();
        words.extend(self.camera.as_deref().map(|path| file("camera", path)).transpose()?);
        match &self.path {
            Some(PathSource::Json(path) | PathSource::Blend(path)) => {
                words.push(file("path", path)?)
            }
            Some(PathSource::ReadyMade(kind)) => words.push(format!("--path={}", kind.name())),
            None => {}
        }
        words.extend(self.shift.iter().map(|Shift([x, y, z])| format!("--shift={x},{y},{z}")));
        Ok(words)
    }

    /// Returns the view that the arguments choose. `given` is the result of [`Self::camera`].
    pub fn view(&self, given: Option<Camera>, capture: &Capture) -> Result<NamedView, CliError> {
        let name = self.like.as_deref().unwrap_or_default();
        let view = match given {
            Some(camera) => NamedView::Free(camera),
            None => capture.named_view(name).map_err(|e| CliError::from(e).of_flag("--like"))?,
        };
        let Some(Shift(shift_m)) = &self.shift else { return Ok(view) };
        let camera = match &view {
            NamedView::Filming(index) => &capture.cameras[*index].camera,
            NamedView::Free(camera) => camera,
        };
        Ok(NamedView::Free(camera.shifted((*shift_m).into())))
    }
}

fn centers(capture: &Capture) -> Vec<Point3<f64>> {
    capture.cameras.iter().map(|filmed| filmed.camera.center()).collect()
}

/// Returns a warning if a view is further from every camera than any two cameras are from each other, and `None`
/// otherwise.
pub fn far_outside(view: &Camera, capture: &Capture) -> Option<String> {
    let centers = centers(capture);
    let to_all = |from: &Point3<f64>| centers.iter().map(|c| distance(from, c)).collect::<Vec<_>>();
    let away_m = to_all(&view.center()).into_iter().fold(f64::INFINITY, f64::min);
    let width_m = centers.iter().flat_map(to_all).fold(0.0, f64::max);
    let is_far = away_m > width_m && away_m > 0.0;
    is_far.then(|| {
        format!(
            "The view is {away_m:.3} m from the nearest camera, and the cameras are at most {width_m:.3} m from \
             each other: the image may be distorted."
        )
    })
}

/// Returns an example of a command line with `stlfr render`. It renders the view halfway between the reference camera
/// and the camera nearest to it, at an instant between two frames.
pub fn example(capture: &Capture, folder: &Path) -> String {
    let reference = &capture.cameras[capture.reference];
    let centers = centers(capture);
    let from = &centers[capture.reference];
    let others = (0..centers.len()).filter(|c| *c != capture.reference);
    let nearest =
        others.min_by(|a, b| distance(from, &centers[*a]).total_cmp(&distance(from, &centers[*b])));
    let shift = nearest.map(|other| {
        let towards = reference.camera.cam_from_world * centers[other];
        let [x, y, z] = [towards.x, towards.y, towards.z].map(|m| rounded(0.5 * m));
        format!(" --shift {x},{y},{z}")
    });
    let times_s = capture.times_in_file_s(capture.reference);
    let middle = times_s.len() / 2;
    let time_s = 0.5 * (times_s[middle.saturating_sub(1)] + times_s[middle]);
    format!(
        "stlfr render {} --like {}{} --time {} -o view.png",
        quoted(&folder.display().to_string()),
        quoted(&reference.id),
        shift.unwrap_or_default(),
        rounded(time_s),
    )
}

/// Formats a number with at most four decimals.
pub fn rounded(value: f64) -> String {
    let text = format!("{value:.4}");
    let text = text.trim_end_matches('0').trim_end_matches('.');
    if text == "-0" { "0".to_owned() } else { text.to_owned() }
}

/// Quotes a word for a shell's command line, if the word needs quotes.
fn quoted(word: &str) -> String {
    let is_plain = |c: char| c.is_alphanumeric() || "/._-".contains(c);
    if word.chars().all(is_plain) {
        word.to_owned()
    } else {
        format!("'{}'", word.replace('\'', r"'\''"))
    }
}
