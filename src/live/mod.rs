//! A light field in a browser: one page for looking around in space and time, served only to this machine.
//!
//! ```text
//! browser ── server ── queue ── workers ── Studio ── LightField
//! (HTTP)   (latest)  (threads)  (pictures)
//! ```
//!
//! | file | what |
//! |---|---|
//! | `mod.rs` | the parts of the server, and its errors |
//! | `rig_frame.rs` | viewpoints, and the rig's own axes |
//! | `request.rs` | the picture that an address requests |
//! | `studio.rs` | pictures of the light field and of traditional LFR |
//! | `true_views.rs` | pictures of the truth |
//! | `overlays.rs` | pictures of the cameras that pixels come from, and of depths |
//! | `encode.rs` | pictures as files |
//! | `queue.rs`, `workers.rs` | each viewer's latest request, and the threads that answer it |
//! | `scene.rs` | the description of the capture for the page |
//! | `guard.rs` | access control |
//! | `server.rs`, `answer.rs` | HTTP, with bounded sizes, numbers and times |
//! | `page/` | the page |
//!
//! # Access
//!
//! The server listens on 127.0.0.1. An address contains a random token, without which every path is "not
//! found". `Host` and `Origin` must be the server's own, so that neither another page nor another name for
//! this machine gets an answer. Only `GET` is answered, and only the page and pictures of this capture are
//! served.
//!
//! Known limit: anyone who has the address gets the pictures. Another user of this machine may find it among
//! the arguments of the program that opens the browser. With `--no-open`, it is only printed in the terminal.

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

/// Why a picture can't be served: one sentence, which the page shows.
#[derive(Debug, thiserror::Error)]
pub enum LiveError {
    /// The address is invalid.
    #[error("{0}")]
    Request(String),
    #[error(transparent)]
    Render(#[from] RenderError),
    #[error(transparent)]
    ImageFile(#[from] ImageFileError),
    /// A newer request of the same viewer has replaced this one.
    #[error("a newer request took its place")]
    Superseded,
    /// Too many requests are waiting.
    #[error("too many pictures are asked for at once: close a viewer")]
    Busy,
    /// The program failed unexpectedly.
    #[error("rendering failed by an error of the program; its output in the terminal says more")]
    Panicked,
    /// The request is not allowed: the HTTP status, and the reason.
    #[error("{1}")]
    Refused(StatusCode, &'static str),
}
