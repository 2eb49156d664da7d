//! The options `--quilt` and `--stereo` of `stlfr render`, which put several views into one picture.

use super::CliError;
use super::shots::{Shots, camera};
use super::values::{ImageOutput, positive};
use crate::camera::Camera;
use crate::capture::NamedView;
use crate::display::{QuiltLayout, covered_cone_deg, stereo};
use crate::light_field::{LightField, Request, Viewpoint};
use crate::options::RenderOptions;
use crate::progress::Reporter;

/// Smallest angle between the first and the last view of a quilt, in degrees. At a smaller angle, no depth is visible.
const MIN_CONE_DEG: f64 = 1.0;

/// Arguments for pictures that contain several views.
#[derive(Debug, clap::Args)]
pub struct DisplayArgs {
    /// Render a quilt, a grid of views, for a Looking Glass display: go, portrait, 16-landscape, 16-landscape-7x7,
    /// 16-portrait, 27-landscape, 27-portrait, 32-landscape, 32-portrait, 65, or a layout such as 8x6:3360x3360. The
    /// layout is appended to the file's name, such as _qs8x6a0.75.
    #[arg(long, value_name = "DISPLAY")]
    quilt: Option<QuiltLayout>,
    /// Angle between a quilt's first and last view [default: the display's angle, at most the angle that the cameras
    /// cover].
    #[arg(long, value_name = "DEGREES", requires = "quilt", value_parser = positive)]
    cone: Option<f64>,
    /// Render the views of the left and the right eye side by side, with this distance between the eyes, in metres.
    #[arg(long, value_name = "METRES", conflicts_with = "quilt", value_parser = positive)]
    stereo: Option<f64>,
    /// Distance of the plane without parallax, which appears at the display's surface [default: the middle of the
    /// scene's depths].
    #[arg(long, value_name = "METRES", value_parser = positive)]
    convergence: Option<f64>,
}

/// The arrangement of the views in one picture, and the arrangement of their cameras.
pub enum Layout {
    Single,
    Quilt { quilt: QuiltLayout, cone_deg: f64, convergence_m: f64 },
    Stereo { distance_m: f64, convergence_m: f64 },
}

/// Positions of the views inside a picture.
pub struct PictureParts {
    /// Width and height of the picture, in pixels.
    pub size_px: [usize; 2],
    /// Position (x, y) of each view's top left pixel in the picture.
    pub origins: Vec<[usize; 2]>,
}

impl DisplayArgs {
    /// Returns whether the arguments choose pictures with several views: quilts or stereo pairs.
    pub fn is_of_several(&self) -> bool {
        self.quilt.is_some() || self.stereo.is_some()
    }

    /// Returns the output path. For a quilt, the quilt's layout is appended to the file's name, as Looking Glass
    /// software expects.
    pub fn named(&self, output: &ImageOutput) -> ImageOutput {
        self.quilt.map_or_else(|| output.clone(), |quilt| output.ending(&quilt.name()))
    }

    /// Returns the layout of the views inside each rendered picture. Without `--convergence`, the convergence distance
    /// is the middle depth of the first view. Without `--cone`, the angle between a quilt's first and last view is the
    /// display's angle, limited to the angle that the cameras cover around every view.
    pub fn layout(
        &self,
        field: &LightField,
        shots: &Shots,
        options: &RenderOptions,
        reporter: &Reporter,
    ) -> Result<Layout, CliError> {
        if !self.is_of_several() {
            return match self.convergence {
                None => Ok(Layout::Single),
                Some(_) => Err(CliError::BadInput(
                    "--convergence: must be given with --quilt or --stereo".into(),
                )),
            };
        }
        let shot = shots.get(0);
        let view = camera(field, &shot.view);
        let convergence_m = match self.convergence {
            Some(convergence_m) => convergence_m,
            None => {
                let request = Request::new(Viewpoint::View(view), shot.time_s, options);
                field.depth_range_m(view, &request)?[1]
            }
        };
        let Some(quilt) = self.quilt else {
            let distance_m = self.stereo.unwrap_or_default();
            return Ok(Layout::Stereo { distance_m, convergence_m });
        };
        let cameras: Vec<Camera> =
            field.capture().cameras.iter().map(|filmed| filmed.camera.clone()).collect();
        let covered =
            |k| covered_cone_deg(camera(field, &shots.get(k).view), &cameras, convergence_m);
        let covered_deg = (0..shots.len()).map(covered).fold(f64::INFINITY, f64::min);
        let cone_deg = self.cone_deg(quilt, covered_deg, convergence_m)?;
        reporter.note(&format!(
            "The cameras cover a cone of {covered_deg:.1} degrees at {convergence_m:.2} m; the quilt has {cone_deg:.1} \
             of the display's {:.0}.",
            quilt.cone_deg
        ));
        Ok(Layout::Quilt { quilt, cone_deg, convergence_m })
    }

    fn cone_deg(&self, quilt: QuiltLayout, covered_deg: f64, at_m: f64) -> Result<f64, CliError> {
        let cone_deg = self.cone.unwrap_or(quilt.cone_deg.min(covered_deg));
        let covered = format!(
            "the cameras cover a cone of {covered_deg:.1} degrees about this view at {at_m:.2} m"
        );
        if self.cone.is_some() && cone_deg > covered_deg {
            return Err(CliError::BadInput(format!("--cone: {covered}")));
        }
        if cone_deg < MIN_CONE_DEG {
            return Err(CliError::BadInput(format!(
                "--quilt: {covered}, and a quilt needs {MIN_CONE_DEG}: choose a view amid the cameras, or a nearer \
                 --convergence"
            )));
        }
        Ok(cone_deg)
    }
}

impl Layout {
    /// Returns the views that a picture contains, in the order of their positions in [`PictureParts::origins`]. `view`
    /// is the view in the middle between them.
    pub fn views(&self, field: &LightField, view: &NamedView) -> Vec<NamedView> {
        let middle = camera(field, view);
        let cameras = match self {
            Self::Single => return vec![view.clone()],
            Self::Quilt { quilt, cone_deg, convergence_m } => {
                quilt.cameras(middle, *cone_deg, *convergence_m)
            }
            Self::Stereo { distance_m, convergence_m } => {
                stereo(middle, *distance_m, *convergence_m).to_vec()
            }
        };
        cameras.into_iter().map(NamedView::Free).collect()
    }

    /// Returns the positions of the views inside a picture; `None` for a picture of a single view.
    pub fn parts(&self, field: &LightField, view: &NamedView) -> Option<PictureParts> {
        match self {
            Self::Single => None,
            Self::Quilt { quilt, .. } => {
                let origins = (0..quilt.views()).map(|k| quilt.tile_origin(k)).collect();
                Some(PictureParts { size_px: quilt.size_px, origins })
            }
            Self::Stereo { .. } => {
                let Camera { width, height, .. } = *camera(field, view);
                Some(PictureParts {
                    size_px: [2 * width, height],
                    origins: vec![[0, 0], [width, 0]],
                })
            }
        }
    }
}
