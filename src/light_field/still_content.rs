//! Static background of a camera: the parts of its image that don't change over its whole recording.

use super::RenderError;
use super::graph::{LightField, Stage};
use super::stages::StillContent;
use crate::scene_flow::{CompactImage, FlowFrame, StillImage};
use rayon::prelude::*;
use std::sync::Arc;

/// Maximum number of frames that are compared to find a camera's static background. The frames are spread evenly over
/// the recording.
const MAX_FRAMES: usize = 15;
/// Minimum fraction of the frames that show the background colour of a pixel, if the cameras stand around the scene. If the
/// fraction were larger, a background that is hidden for most of the recording would stay unknown. If it were smaller, a
/// textureless body that passes slowly would count as background.
const MIN_SUPPORT: f64 = 1.0 / 3.0;
/// The same fraction for other cameras, whose static background only saves time. Larger: less time is saved. Smaller:
/// plain bodies that move slowly are taken for background.
const MIN_SUPPORT_OF_DEPTH: f64 = 0.6;
/// Memory per pixel of a static background, bytes: its colour, or the mark that the colour is unknown.
const PIXEL_BYTES: usize = 4;

impl Stage for StillContent<'_> {
    type Output = StillImage;
    const NAME: &'static str = "still content";

    fn bytes(still: &StillImage) -> usize {
        PIXEL_BYTES * still.pixels()
    }
}

impl StillContent<'_> {
    pub(super) fn get(&self, field: &LightField) -> Result<Arc<StillImage>, RenderError> {
        if let Some(cached) = field.cached(self) {
            return Ok(cached);
        }
        let &Self { camera, registration } = self;
        let filmed = &field.capture().cameras[camera];
        let gains = field.gains(registration);
        let (count, used) = (filmed.frames.len(), filmed.frames.len().min(MAX_FRAMES));
        let read = |k: usize| {
            let frame = (2 * k + 1) * count / (2 * used);
            let image = field.capture().read_frame(camera, frame)?;
            let own_s = filmed.clock.times_s[frame];
            let image = gains.corrected(camera, own_s, &image).unwrap_or(image);
            // Lens distortion is removed, as in the frames that the background is compared with.
            Ok(CompactImage::new(&FlowFrame::new(&filmed.camera, &image, 0.0).image))
        };
        let frames: Vec<CompactImage> =
            (0..used).into_par_iter().map(read).collect::<Result<_, RenderError>>()?;
        let is_wide = field.common_place().is_some();
        let min_support = if is_wide { MIN_SUPPORT } else { MIN_SUPPORT_OF_DEPTH };
        Ok(field.insert(self, StillImage::new(&frames, min_support)))
    }
}
