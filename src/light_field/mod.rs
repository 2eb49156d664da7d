//! Light field of a capture, continuous in space and time (the paper's Fig. 2). A graph of stages computes views from
//! the recorded frames.
//!
//! ```text
//! frames ── tracks of a frame pair ── a camera's image at an instant ── geometry at an instant ── view
//! §4             §4                            §5                            §6                  §6
//! ```
//!
//! [`render`] is the only entry point. It requests results of stages, and stages request results of earlier stages. A
//! result depends only on the stage's inputs (`stages.rs`) and on the capture's frames and clocks. One cache in memory,
//! the memo, holds all results. Its keys are the serialized inputs. Views of one instant therefore share all results
//! that don't depend on the viewpoint.
//!
//! | file | what |
//! |---|---|
//! | `graph.rs` | the capture, its clocks, and results by stage |
//! | `stages.rs` | the inputs of every stage |
//! | `timeline.rs` | which frames lie around an instant |
//! | `frame_pair.rs` | §4: change and feature tracks between two frames |
//! | `camera_image.rs` | §5: a camera's image at an instant |
//! | `correspondences.rs` | §6: features that show the same point |
//! | `points.rs` | §6: points of the scene, and the proxy through them |
//! | `depth.rs` | depth per pixel of the cameras, by stereo matching |
//! | `geometry.rs` | the depth map of a view, and the cameras' depth maps for occlusion |
//! | `view.rs` | §6: the blended view |
//! | `scene_flow.rs`, `slots.rs`, `matched_frames.rs` | depth and motion of frames, estimated for groups of frames, and views from them |
//! | `wide.rs` | depth ranges for cameras around the scene |
//! | `still_content.rs`, `still_depth.rs` | the static background of each camera, and its depth |
//! | `gains.rs` | exposure gains of the cameras, also of cameras around the scene |
//! | `flow_frames.rs` | frames with their scene flow (depth and motion), for callers that render views by themselves |
//! | `all_cameras.rs` | a camera's image at an instant, blended from the images of all cameras |
//! | `image_motion.rs` | motion of a view's pixels to the previous and the next picture of a sequence |
//! | `request.rs` | the request of a view |
//! | `render.rs`, `trail.rs` | rendering of a view; temporal integration (Fig. 1) |
//! | `prepare.rs`, `stored_slots.rs` | tracks, exposure gains and scene flow, stored on disk for later views |

mod all_cameras;
mod camera_image;
mod context;
mod correspondences;
mod depth;
mod error;
mod flow_frames;
mod frame_pair;
mod gains;
mod geometry;
mod graph;
mod image_motion;
mod matched_frames;
mod points;
mod prepare;
mod render;
mod request;
mod scene_flow;
mod slots;
mod stages;
mod still_content;
mod still_depth;
mod stored_slots;
mod timeline;
mod trail;
mod view;
mod wide;

pub use context::Context;
pub use error::RenderError;
pub use geometry::Geometry;
pub use graph::LightField;
pub use image_motion::{CameraAt, ImageMotion, Layers};
pub use prepare::{PREPARED, Preparation};
pub use render::{render, render_with_layers};
pub use request::{Request, Viewpoint};
pub use scene_flow::LoadedFrame;
pub use stages::{GivenImages, Images};
pub use timeline::check_times_before_offsets;
pub use wide::{MAX_MATCHED_ANGLE_RAD, MIN_WIDE_ANGLE_RAD};
