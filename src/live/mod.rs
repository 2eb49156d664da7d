//! Shows a light field in a browser. A server, which only programs on this machine can reach, serves a page on which
//! the user moves the viewpoint and the time of the view.
//!
//! ```text
//! browser ── server ── queue ── workers ── Studio ── LightField
//!            (HTTP)   (latest)  (threads)  (pictures)
//! ```
//!
//! | file | what |
//! |---|---|
//! | `mod.rs` | the parts of the server, and its errors |
//! | `rig_frame.rs` | viewpoints, and the rig's own axes |
//! | `request.rs` | parsing of an address to the picture that it requests |
//! | `studio.rs` | pictures of the light field, and of traditional light field rendering |
//! | `true_views.rs` | pictures of the ground truth |
//! | `overlays.rs` | pictures of the cameras that pixels come from, and of depths |
//! | `encode.rs` | encoding of pictures as files |
//! | `queue.rs`, `workers.rs` | each viewer's latest request, and the threads that answer it |
//! | `scene.rs` | the description of the capture for the page |
//! | `guard.rs` | access control |
//! | `server.rs`, `answer.rs` | HTTP, with bounded sizes, numbers and times |
//! | `page/` | the page |
//!
//! # Access
//!
//! The server listens on 127.0.0.1. The page's address contains a random token; without this token, every path is
//! answered with "not found". The headers `Host` and `Origin` must name the server itself, so that requests of other
//! pages, and requests under other host names of this machine, are refused. The server answers only `GET`, and serves
//! only the page and pictures of this capture.
//!
//! Known limit: anyone on this machine who has the address gets the pictures. Another user of this machine may find the
//! address among the arguments of the program that opens the browser. With `--no-open`, the address is only printed in
//! the terminal.

mod answer;
mod encode;
mod guard;
mod overlays;
mod queue;
mod request;
mod rig_frame;
mod scene;
mod server;
mod studio;
mod true_views;
mod workers;

pub use server::Server;
pub use studio::Studio;

use crate::light_field::RenderError;
use crate::raster::ImageFileError;
use hyper::StatusCode;
use queue::Queue;
use request::{Level, PictureMethod, PictureRequest, Place, ViewDirection};
use rig_frame::RigFrame;
use studio::Picture;

/// Reason why a picture can't be served: one sentence, which the page shows.
#[derive(Debug, thiserror::Error)]
pub enum LiveError {
    /// The requested address is invalid. The field is the reason, as a sentence.
    #[error("{0}")]
    Request(String),
    #[error(transparent)]
    Render(#[from] RenderError),
    #[error(transparent)]
    ImageFile(#[from] ImageFileError),
    /// A newer request of the same viewer has replaced this request.
    #[error("a newer request took its place")]
    Superseded,
    /// Too many requests are waiting.
    #[error("too many pictures are asked for at once: close a viewer")]
    Busy,
    /// The program panicked while it rendered the picture.
    #[error("rendering failed by an error of the program; its output in the terminal says more")]
    Panicked,
    /// The request is not allowed. The fields are the HTTP status and the reason.
    #[error("{1}")]
    Refused(StatusCode, &'static str),
}
