//! The views that `stlfr render` renders: one view at one instant, one view at many instants, or a camera path.

use super::CliError;
use super::files::{read_blend_path, read_path};
use super::values::{PathSource, Times, positive, rate_hz};
use super::viewpoint::{ViewpointArgs, far_outside};
use crate::camera::Camera;
use crate::capture::{Capture, NamedView};
use crate::light_field::{CameraAt, LightField, Viewpoint, check_times_before_offsets};
use crate::options::RenderOptions;
use crate::path::{CameraPath, PATH_RATE_HZ, PathFrame, READY_MADE_S, ReadyMadePath};
use crate::pipeline::{PathFitError, ready_made_path};
use crate::progress::Reporter;

/// Arguments that choose the instants of the views.
#[derive(Debug, clap::Args)]
pub struct InstantArgs {
    /// The instant, in seconds on the reference camera's clock. With --path, time stops at this instant.
    #[arg(
        long,
        value_name = "SECONDS",
        allow_negative_numbers = true,
        requires = "view",
        conflicts_with = "times"
    )]
    time: Option<f64>,
    /// N evenly spaced instants from START to END, both included, such as for slow motion.
    #[arg(
        long,
        value_name = "START:END:N",
        allow_hyphen_values = true,
        requires = "view",
        conflicts_with = "path"
    )]
    pub times: Option<Times>,
    /// Duration of the video along a path, in seconds [default: the path's own; 4 for sweep, orbit, bullet-time and
    /// dolly].
    #[arg(long, value_name = "SECONDS", requires = "path", value_parser = positive)]
    duration: Option<f64>,
    /// Frame rate of a video or a path, in hertz [default: the path's rate or 30; for --times the capture's rate].
    #[arg(long, value_name = "HZ", value_parser = rate_hz)]
    fps: Option<f64>,
}

impl InstantArgs {
    /// Returns the arguments that choose the same instants in another command.
    pub fn words(&self) -> Vec<String> {
        let number = |flag: &str, value: Option<f64>| value.map(|v| format!("--{flag}={v}"));
        let span = |Times(times_s): &Times| {
            let (first, last) = (times_s[0], times_s[times_s.len() - 1]);
            format!("--times={first}:{last}:{}", times_s.len())
        };
        let words = [number("time", self.time), self.times.as_ref().map(span)];
        let more = [number("duration", self.duration), number("fps", self.fps)];
        words.into_iter().chain(more).flatten().collect()
    }
}

/// The command-line arguments that choose the views to render, and their instants.
pub struct ShotArgs<'a> {
    pub viewpoint: &'a ViewpointArgs,
    pub instants: &'a InstantArgs,
}

/// A view at an instant: one image to render.
#[derive(Debug)]
pub struct Shot {
    pub view: NamedView,
    /// The instant, in seconds from the capture's start.
    pub time_s: f64,
}

/// All views to render, in order.
pub struct Shots<'a> {
    viewpoint: &'a ViewpointArgs,
    source: ShotSource,
    /// Frame rate of the output, in hertz; `None` if it is the capture's frame rate.
    rate_hz: Option<f64>,
    /// Number of views.
    count: usize,
    is_sequence: bool,
    /// The views. The list is empty before [`Shots::place`]; for a ready-made path such as `orbit`, it is empty before
    /// [`Shots::fit`].
    shots: Vec<Shot>,
}

enum ShotSource {
    /// One view, and its instants in seconds on the reference camera's clock. The camera is that of the `--camera`
    /// file; `None` if `--like` names the view.
    Still(Option<Box<Camera>>, Vec<f64>),
    Path(Vec<PathFrame>),
    ReadyMade {
        kind: ReadyMadePath,
        duration_s: f64,
        frozen_s: Option<f64>,
    },
}

impl<'a> ShotArgs<'a> {
    /// Reads the files that the arguments name, and returns the views to render. Makes all checks that need no capture.
    pub fn shots(self, reporter: &Reporter) -> Result<Shots<'a>, CliError> {
        if self.instants.time.is_some_and(|time_s| !time_s.is_finite()) {
            return Err(CliError::BadInput("--time: must be finite".into()));
        }
        let path = self.viewpoint.path.as_ref();
        let given = self.viewpoint.camera()?;
        let path = match path {
            None => return self.still(given),
            Some(PathSource::ReadyMade(kind)) => return self.ready_made(*kind),
            Some(PathSource::Json(file)) => read_path(file)?,
            Some(PathSource::Blend(file)) => read_blend_path(file, reporter)?,
        };
        let lasting = |duration_s| {
            let wrong = |error| CliError::BadInput(format!("--duration: {error}"));
            path.lasting(duration_s).map_err(wrong)
        };
        let path = self.instants.duration.map_or_else(|| Ok(path.clone()), lasting)?;
        let rate_hz = self.instants.fps.or(path.rate_hz).unwrap_or(PATH_RATE_HZ);
        let mut frames = frames(&path, rate_hz)?;
        if let Some(time_s) = self.instants.time {
            frames.iter_mut().for_each(|frame| frame.time_s = time_s);
        }
        let count = frames.len();
        Ok(self.path_shots(ShotSource::Path(frames), rate_hz, count))
    }

    fn still(self, given: Option<Camera>) -> Result<Shots<'a>, CliError> {
        let times_s = match (self.instants.time, &self.instants.times) {
            (Some(time_s), _) => vec![time_s],
            (None, Some(Times(times_s))) => times_s.clone(),
            (None, None) => {
                return Err(CliError::BadInput("--time or --times must be given".into()));
            }
        };
        let (viewpoint, rate_hz, count) = (self.viewpoint, self.instants.fps, times_s.len());
        let source = ShotSource::Still(given.map(Box::new), times_s);
        let is_sequence = self.instants.time.is_none();
        Ok(Shots { viewpoint, source, rate_hz, count, is_sequence, shots: Vec::new() })
    }

    fn ready_made(self, kind: ReadyMadePath) -> Result<Shots<'a>, CliError> {
        let rate_hz = self.instants.fps.unwrap_or(PATH_RATE_HZ);
        let duration_s = self.instants.duration.unwrap_or(READY_MADE_S);
        let count = CameraPath::frame_count(duration_s, rate_hz).map_err(of_path)?;
        let source = ShotSource::ReadyMade { kind, duration_s, frozen_s: self.instants.time };
        Ok(self.path_shots(source, rate_hz, count))
    }

    /// Creates the views of a camera path. Their cameras and times are determined later, by [`Shots::place`] and
    /// [`Shots::fit`].
    fn path_shots(self, source: ShotSource, rate_hz: f64, count: usize) -> Shots<'a> {
        let viewpoint = self.viewpoint;
        let rate_hz = Some(rate_hz);
        Shots { viewpoint, source, rate_hz, count, is_sequence: true, shots: Vec::new() }
    }
}

fn of_path(error: impl std::fmt::Display) -> CliError {
    CliError::BadInput(format!("--path: {error}"))
}

fn frames(path: &CameraPath, rate_hz: f64) -> Result<Vec<PathFrame>, CliError> {
    path.frames(rate_hz).map_err(of_path)
}

impl Shots<'_> {
    /// Returns the number of views.
    pub fn len(&self) -> usize {
        self.count
    }

    /// Returns whether the output is a sequence. A sequence may have a single view.
    pub fn is_sequence(&self) -> bool {
        self.is_sequence
    }

    /// Returns the instants that the arguments choose, in seconds on the reference camera's clock. Empty for a
    /// ready-made path such as `orbit`.
    #[cfg(test)]
    pub fn times_in_file_s(&self) -> Vec<f64> {
        match &self.source {
            ShotSource::Still(_, times_s) => times_s.clone(),
            ShotSource::Path(frames) => frames.iter().map(|frame| frame.time_s).collect(),
            ShotSource::ReadyMade { .. } => Vec::new(),
        }
    }

    /// Returns the view with this index.
    ///
    /// # Panics
    /// If the views aren't placed yet ([`Self::place`], [`Self::fit`]).
    pub fn get(&self, index: usize) -> &Shot {
        &self.shots[index]
    }

    /// Returns the cameras and instants of the views before and after a view in the sequence; `None` at the ends. For a
    /// single view, returns its own camera one frame interval earlier and one frame interval later.
    pub fn neighbors<'b>(
        &'b self,
        field: &'b LightField,
        index: usize,
    ) -> [Option<CameraAt<'b>>; 2] {
        let at = |shot: &'b Shot, later_s| (camera(field, &shot.view), shot.time_s + later_s);
        if self.shots.len() < 2 {
            let frame_s = field.capture().frame_s();
            return [-frame_s, frame_s].map(|later_s| Some(at(self.get(index), later_s)));
        }
        let other = |index: Option<usize>| Some(at(self.shots.get(index?)?, 0.0));
        [other(index.checked_sub(1)), other(Some(index + 1))]
    }

    /// Returns a hash of the views, the offsets, the options and `more`, as 16 hexadecimal digits. `more` is a text
    /// with other options of the output.
    pub fn key(&self, field: &LightField, options: &RenderOptions, more: &str) -> String {
        let mut hasher = blake3::Hasher::new();
        hasher.update(format!("{:?} {options:?} {more}", field.offsets()).as_bytes());
        self.shots.iter().for_each(|shot| {
            hasher.update(format!("{shot:?}").as_bytes());
        });
        hasher.finalize().to_hex()[..16].to_owned()
    }

    /// Returns the frame rate of the output, in hertz: the chosen rate, or else the capture's frame rate.
    pub fn rate_hz(&self, capture: &Capture) -> f64 {
        let frame_s = capture.frame_s();
        let own_hz = if frame_s > 0.0 { 1.0 / frame_s } else { PATH_RATE_HZ };
        self.rate_hz.unwrap_or(own_hz)
    }

    /// Determines the camera and the time of each view, and makes all checks that need no offsets. The views of a
    /// ready-made path such as `orbit` are determined later, by [`Self::fit`].
    pub fn place(&mut self, capture: &Capture, reporter: &Reporter) -> Result<(), CliError> {
        let origin_s = capture.time_origin_s;
        match &self.source {
            ShotSource::Still(given, times_s) => {
                let view = self.viewpoint.view(given.as_deref().cloned(), capture)?;
                let shot = |time_s: &f64| Shot { view: view.clone(), time_s: time_s - origin_s };
                self.shots = times_s.iter().map(shot).collect();
            }
            ShotSource::Path(frames) => {
                let shot = |PathFrame { camera, time_s }: &PathFrame| Shot {
                    view: NamedView::Free(camera.clone()),
                    time_s: time_s - origin_s,
                };
                self.shots = frames.iter().map(shot).collect();
            }
            ShotSource::ReadyMade { frozen_s, .. } => {
                let frozen_s: Vec<f64> = frozen_s.iter().map(|time_s| time_s - origin_s).collect();
                return Ok(check_times_before_offsets(capture, None, &frozen_s)?);
            }
        }
        let filming = match self.shots.first().map(|shot| &shot.view) {
            Some(NamedView::Filming(index)) => Some(*index),
            _ => None,
        };
        check_times_before_offsets(capture, filming, &self.times_s())?;
        let notes = self.shots.iter().filter_map(|shot| match &shot.view {
            NamedView::Free(camera) => far_outside(camera, capture),
            NamedView::Filming(_) => None,
        });
        notes.take(1).for_each(|note| reporter.note(&note));
        Ok(())
    }

    fn times_s(&self) -> Vec<f64> {
        self.shots.iter().map(|shot| shot.time_s).collect()
    }

    /// Returns an error if the instant of a view is outside the light field's time range.
    pub fn check(&self, field: &LightField) -> Result<(), CliError> {
        let Some(first) = self.shots.first() else { return Ok(()) };
        Ok(field.check_times(viewpoint(&first.view), &self.times_s())?)
    }

    /// Fits the camera path to the scene if it is a ready-made path such as `orbit`. Other views are unchanged.
    pub fn fit(&mut self, field: &LightField, options: &RenderOptions) -> Result<(), CliError> {
        let ShotSource::ReadyMade { kind, duration_s, frozen_s } = self.source else {
            return Ok(());
        };
        let frozen_s = frozen_s.map(|time_s| time_s - field.capture().time_origin_s);
        let path = ready_made_path(field, options, kind, duration_s, frozen_s);
        let path = path.map_err(|error| match error {
            PathFitError::Depths(error) => error.into(),
            PathFitError::Path(error) => of_path(error),
        })?;
        let shot = |PathFrame { camera, time_s }| Shot { view: NamedView::Free(camera), time_s };
        let frames = frames(&path, self.rate_hz.unwrap_or(PATH_RATE_HZ))?;
        self.shots = frames.into_iter().map(shot).collect();
        self.check(field)
    }
}

/// Returns the camera of a view.
pub fn camera<'a>(field: &'a LightField, view: &'a NamedView) -> &'a Camera {
    match view {
        NamedView::Filming(index) => &field.capture().cameras[*index].camera,
        NamedView::Free(camera) => camera,
    }
}

/// Converts a view to the viewpoint that the light field renders: a camera of the capture, or a free camera.
pub fn viewpoint(view: &NamedView) -> Viewpoint<'_> {
    match view {
        NamedView::Filming(index) => Viewpoint::Like(*index),
        NamedView::Free(camera) => Viewpoint::View(camera),
    }
}
