//! A light field in a browser: one page that looks around in space and time, served on this machine alone.
//!
//! ```text
//! browser ── server ── queue ── workers ── Studio ── LightField
//!            (HTTP)   (latest)  (threads)  (pictures)
//! ```
//!
//! | file | what |
//! |---|---|
//! | `mod.rs` | what is served, and what refuses a request |
//! | `rig_frame.rs` | viewpoints, and the rig's own axes |
//! | `request.rs` | the picture that an address requests |
//! | `studio.rs` | pictures of the light field and of traditional LFR |
//! | `true_views.rs` | pictures of the truth |
//! | `overlays.rs` | pictures of the cameras that pixels come from, and of depths |
//! | `encode.rs` | pictures as files |
//! | `queue.rs`, `workers.rs` | each viewer's latest request, and the threads that answer it |
//! | `scene.rs` | the description of the capture for the page |
//! | `guard.rs` | the check whether a request may be answered |
//! | `server.rs`, `answer.rs` | HTTP, within bounds of size, number and time |
//! | `page/` | the page |
//!
//! # Who may ask
//!
//! The server listens on 127.0.0.1. An address holds a random token, without which nothing is found. `Host` and
//! `Origin` must be the server's own, so that no other page, and no name that leads here, can ask. Only `GET` is
//! answered, and nothing but the page and pictures of this capture.
//!
//! Known limit: whoever has the address may look, also another user of this machine, who may find it among the
//! arguments of the program that opens the browser. `--no-open` gives it to the terminal alone.

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

/// Why a picture can't be made: one sentence, which the page shows.
#[derive(Debug, thiserror::Error)]
pub enum LiveError {
    /// The address is invalid.
    #[error("{0}")]
    Request(String),
    #[error(transparent)]
    Render(#[from] RenderError),
    #[error(transparent)]
    ImageFile(#[from] ImageFileError),
    /// A newer request of the same viewer replaced this one.
    #[error("a newer request took its place")]
    Superseded,
    /// Too many requests are waiting.
    #[error("too many pictures are asked for at once: close a viewer")]
    Busy,
    /// The program failed unexpectedly.
    #[error("rendering failed by an error of the program; its output in the terminal says more")]
    Panicked,
    /// The request is not allowed: the HTTP status, and why.
    #[error("{1}")]
    Refused(StatusCode, &'static str),
}
