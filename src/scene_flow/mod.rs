//! Scene flow, beyond the paper: estimates depth and motion for every frame, from the frames of all cameras, each at
//! its own time. A view at an instant is rendered from the frames nearest in time: their surface points are moved to
//! the instant and blended.
//!
//! ```text
//! frames ── pyramids ── PatchMatch, coarse to fine ── FlowMap of each frame ── splat ── blend(view)
//! ```
//!
//! The frames are not synchronized first. Cameras that film at different times sample motion more densely, so the
//! motion between two samples is smaller. Related work: Klose, Lipski, Magnor, *Reconstructing Shape and Motion from
//! Asynchronous Cameras* (VMV 2010); Bleyer, Rhemann, Rother, *PatchMatch Stereo* (BMVC 2011); Taniai et al., *Fast
//! Multi-frame Stereo Scene Flow* (CVPR 2017).
//!
//! Known limits: outlines are off by about a pixel. The disparity of image edges parallel to the line of cameras
//! can't be measured, so their depth is found only where they move, or where they lie in a plane of known depth.
//!
//! | file | content |
//! |---|---|
//! | `frame.rs` | a frame without lens distortion |
//! | `matching_image.rs` | the image pyramid of a frame |
//! | `grid.rs` | the neighbours of a pixel |
//! | `lens_grid.rs` | lens distortion, tabulated |
//! | `noise.rs` | the noise of an image |
//! | `geometry.rs` | projection of a pixel with inverse depth from one camera into another |
//! | `timing.rs` | the time between pixels of two frames, with rolling shutters |
//! | `contrast.rs` | an image that doesn't depend on the exposure |
//! | `element.rs` | a surface element: the depth, path and slant of the surface at a pixel |
//! | `observing_frame.rs` | another frame, in which elements are observed |
//! | `patch.rs`, `footprint.rs` | the pixels around a pixel, and where other frames see them |
//! | `matching.rs` | the matching cost of an element over all frames |
//! | `gauss_newton.rs`, `affine_fit.rs` | refinement of an element by image gradients, and by its neighbours |
//! | `smoothing.rs` | interpolation over plain surfaces, and along thin bodies |
//! | `planes.rs`, `extension.rs` | planes of static surfaces, extended over pixels of uncertain depth |
//! | `sweep.rs` | one pass of PatchMatch over a map |
//! | `transfer.rs`, `consistency.rs` | proposals from other frames' maps, and the cost of differing from these maps |
//! | `estimate.rs` | the order of these steps, for several frames together |
//! | `uncertainty.rs` | standard errors of depth and velocity |
//! | `variance_factor.rs` | standard errors, scaled by how much the maps of several frames differ |
//! | `map.rs`, `flow_pixel.rs`, `packed.rs` | a frame's depth and motion, and their stored form |
//! | `element_lanes.rs` | eight surface elements side by side, for SIMD |
//! | `still.rs`, `background.rs` | the static background of a camera; its depth in frames |
//! | `silhouette.rs` | which pixels of a frame show a body, and which the static background |
//! | `agreements.rs`, `confidence.rs` | whether other maps agree with an element; the fraction of those that do |
//! | `tile_bounds.rs` | tiles of a map, and where a view or another frame can see them |
//! | `area.rs` | the parts of a view that are splatted |
//! | `placement.rs`, `splat.rs`, `composite.rs`, `blend.rs` | rendering of a view from several maps |
//! | `agreed.rs` | pixels at which a few maps agree, for quick views |
//! | `pixels.rs` | the pixels of a view, and how its holes are closed and filled |
//! | `robust_mean.rs` | the mean of the colours that several maps show at a pixel |
//! | `motion.rs` | the motion of the surfaces in a view |

mod affine_fit;
mod agreed;
mod agreements;
mod area;
mod background;
mod blend;
mod composite;
mod confidence;
mod consistency;
mod contrast;
mod element;
mod element_lanes;
mod estimate;
mod extension;
mod flow_pixel;
mod footprint;
mod frame;
mod gauss_newton;
mod geometry;
mod grid;
mod lens_grid;
mod map;
mod matching;
mod matching_image;
mod motion;
mod noise;
mod observing_frame;
mod packed;
mod patch;
mod pixels;
mod placement;
mod planes;
mod robust_mean;
mod silhouette;
mod smoothing;
mod splat;
mod still;
mod sweep;
mod tile_bounds;
mod timing;
mod transfer;
mod uncertainty;
mod variance_factor;

#[cfg(test)]
mod tests;

pub use agreements::{Agreements, agreements, confirmed_by};
pub use background::Background;
pub use blend::{Detail, FlowView, blend, quick_maps};
pub use confidence::{confidence, confidences, uncompared};
pub use contrast::local_contrast;
pub use element::{Element, ElementErrors};
pub use estimate::{EstimatedFrame, Estimation};
pub use frame::{FlowFrame, PyramidFrame, pinhole};
pub use geometry::{Projection, distorted, undistorted};
pub use map::{ElementMap, FlowMap, MappedFrame};
pub use matching::MAX_OBSERVATIONS;
pub use matching_image::MatchingImage;
pub use motion::MotionMap;
pub use observing_frame::SIMULTANEOUS;
pub use placement::fading;
pub use still::{CompactImage, StillImage};
pub use sweep::Limits;
