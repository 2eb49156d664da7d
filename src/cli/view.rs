//! The command `stlfr view`, which shows a capture in the browser.

use super::CliError;
use super::error::heard;
use super::files::{OptionsArgs, open_capture};
use crate::host;
use crate::light_field::LightField;
use crate::live::{Server, Studio};
use crate::method::Method;
use crate::options::{AutoOptions, ProxyMethod, RenderOptions};
use crate::pipeline;
use crate::progress::Reporter;
use std::io::{ErrorKind, Write};
use std::path::PathBuf;
use std::process::{Command, Stdio};

/// Look around in a capture, in space and time, in the browser. Ctrl+C ends the command.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  \
    stlfr view .captures/demo\n  \
    stlfr view .captures/demo --preset balanced\n  \
    stlfr view .captures/demo --at 'at=c3&t=0.1'\n  \
    stlfr view .captures/demo --port 8800 --no-open\n\n\
    The page is served on this machine alone, at the address that is printed. Whoever has the address may look. \
    On the page, ? says what a key does.")]
pub struct ViewArgs {
    /// The capture's folder.
    capture: PathBuf,
    /// Port of the page's address [default: a free port].
    #[arg(long, value_name = "N", default_value_t = 0, hide_default_value = true)]
    port: u16,
    /// Start at the view of a link that the page gave, also in an earlier run. Only the part of the link after # is
    /// needed.
    #[arg(long, value_name = "LINK", value_parser = place)]
    at: Option<String>,
    /// Print the address, but open no browser.
    #[arg(long)]
    no_open: bool,
    #[command(flatten)]
    options: OptionsArgs,
}

pub fn run(args: &ViewArgs, reporter: &Reporter) -> Result<(), CliError> {
    host::bound_arenas();
    let options = args.options.read()?;
    let capture = open_capture(&args.capture, None, reporter)?;
    // The port is bound first, so that a port in use is reported before long work.
    let server = Server::bind(args.port).map_err(|error| refused(args.port, &error))?;
    let field = pipeline::open_field(capture, &options, reporter)?;
    let (options, words) = live_options(&field, &options, &args.options, reporter)?;
    let studio = Studio::new(&field, &options, words, reporter);
    let mut address = server.address();
    if let Some(place) = &args.at {
        address = format!("{address}#{place}");
    }
    let mut stdout = std::io::stdout().lock();
    heard(writeln!(stdout, "{address}").and_then(|()| stdout.flush()))?;
    drop(stdout);
    if !args.no_open && !open(&address) {
        reporter.note("No browser could be opened: open the address by hand.");
    }
    server.serve(&studio).map_err(|error| CliError::Failure(format!("the server ended ({error})")))
}

/// Returns the options with which the page's pictures are rendered, and the equivalent flags of `stlfr render`.
///
/// In two cases, an automatic choice of methods would make the page slow, and depth per pixel is used instead. In the
/// first case, no options are given and no plan is cached, so that the plan would have to be computed. In the second
/// case, the plan chooses scene flow, but depth and motion of the frames have not been stored by `stlfr prepare`.
fn live_options(
    field: &LightField,
    options: &RenderOptions,
    args: &OptionsArgs,
    reporter: &Reporter,
) -> Result<(RenderOptions, Vec<String>), CliError> {
    let mut words = args.words();
    let mut set = |option: &str, method: &str| {
        words.extend(["--set".into(), format!("{option}={method}")]);
    };
    if args.are_default() && pipeline::planned_before(field, options).is_none() {
        let mut usual = RenderOptions { auto: AutoOptions::default(), ..options.clone() };
        usual.proxy.method = ProxyMethod::Depth;
        set("sync", usual.sync.name());
        set("proxy.method", usual.proxy.method.name());
        set("blend.method", usual.blend.method.name());
        reporter.note(
            "Pictures are by depth per pixel. stlfr prepare chooses methods by this capture, and makes pictures faster.",
        );
        return Ok((usual, words));
    }
    let mut planned = pipeline::resolved(field, options, reporter)?;
    let is_slow = planned.proxy.method == ProxyMethod::SceneFlow && options.auto.proxy;
    if is_slow && !field.has_prepared_maps(&planned) {
        planned.proxy.method = ProxyMethod::Depth;
        set("proxy.method", planned.proxy.method.name());
        reporter.note(
            "Pictures are by depth per pixel. Scene flow would be better, but takes half a minute for a new instant: run \
             stlfr prepare with the same options first.",
        );
    }
    Ok((planned, words))
}

/// Largest length of the page's state in a link, in bytes.
const MAX_PLACE: usize = 512;

/// Returns the state of the page (viewpoint, time and methods) from a link: the names and values after `#`. The state
/// may also be given alone, without the rest of the link.
fn place(link: &str) -> Result<String, String> {
    let place = link.rsplit_once('#').map_or(link, |(_, place)| place);
    let is_plain = |c: char| c.is_ascii_alphanumeric() || "=&.+-".contains(c);
    match place {
        "" => Err("has no place".into()),
        _ if place.len() > MAX_PLACE => Err(format!("has more than {MAX_PLACE} bytes")),
        _ if !place.chars().all(is_plain) => {
            Err("is not what a link of the page has after its #".into())
        }
        _ => Ok(place.to_owned()),
    }
}

fn refused(port: u16, error: &std::io::Error) -> CliError {
    match error.kind() {
        ErrorKind::AddrInUse => {
            CliError::BadInput(format!("--port: another program serves at {port} already"))
        }
        _ => CliError::BadInput(format!("--port: {port} can't be had ({error})")),
    }
}

/// Opens an address in the user's browser. Returns `false` if no program can open it.
fn open(address: &str) -> bool {
    use std::os::unix::process::CommandExt;
    let opener = if cfg!(target_os = "macos") { "open" } else { "xdg-open" };
    let mut command = Command::new(opener);
    command.arg(address).stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null());
    // The browser gets a process group of its own, so that Ctrl+C ends the server, but not the browser.
    match command.process_group(0).spawn() {
        Ok(mut child) => {
            // The child may be the browser itself, which keeps running. Therefore a thread waits for the child.
            std::thread::spawn(move || child.wait());
            true
        }
        Err(_) => false,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_place_is_that_of_any_run_and_nothing_else() {
        let of_a_link = place("http://127.0.0.1:8800/0123/#x=-0.03&t=0.1&show=st").unwrap();
        assert_eq!(of_a_link, "x=-0.03&t=0.1&show=st");
        assert_eq!(place("at=c3&t=1e-1").unwrap(), "at=c3&t=1e-1");
        let long = "a".repeat(600);
        for wrong in ["", "http://127.0.0.1:8800/0123/", "#", "t=0 1", "x=1;y", "<b>", &long] {
            assert!(place(wrong).is_err(), "{wrong}");
        }
    }
}
