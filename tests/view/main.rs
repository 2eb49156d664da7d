//! `stlfr view`: who may ask the server and what it answers ([`http`]), and the page in a real Chromium ([`page`]).
//!
//! [`filmed`] makes the capture, [`chromium`] drives the browser.

#[path = "../common/mod.rs"]
mod common;

mod chromium;
mod filmed;
mod http;
mod page;
mod served;
