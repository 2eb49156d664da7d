//! `stlfr view`

use super::CliError;
use super::files::{OptionsArgs, open_capture};
use super::print::heard;
use std::io::{ErrorKind, Write};
use std::path::PathBuf;
use std::process::{Command, Stdio};
use stlfr::host;
use stlfr::light_field::LightField;
use stlfr::live::{Server, Studio};
use stlfr::options::{AutoOptions, ProxyMethod, RenderOptions};
use stlfr::pipeline;
use stlfr::progress::Reporter;

/// Look around in a capture, in space and time, in the browser. Ends with Ctrl+C.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  \
    stlfr view .captures/demo\n  \
    stlfr view .captures/demo --preset balanced\n  \
    stlfr view .captures/demo --port 8800 --no-open\n\n\
    The page is served on this machine alone, at the address that is printed. Whoever has the address may look. \
    On the page, ? says what a key does.")]
pub struct ViewArgs {
    /// The capture's folder.
    capture: PathBuf,
    /// The port of the page's address [default: a free one].
    #[arg(long, value_name = "N", default_value_t = 0, hide_default_value = true)]
    port: u16,
    /// Only print the address.
    #[arg(long)]
    no_open: bool,
    #[command(flatten)]
    options: OptionsArgs,
}

pub fn run(args: &ViewArgs, reporter: &Reporter) -> Result<(), CliError> {
    host::bound_arenas();
    let options = args.options.read()?;
    let capture = open_capture(&args.capture, None, reporter)?;
    // The port is bound before long work, which would be in vain without it.
    let server = Server::bind(args.port).map_err(|error| refused(args.port, &error))?;
    let field = pipeline::open_field(capture, &options, reporter)?;
    let options = live_options(&field, &options, args.options.are_default(), reporter)?;
    let studio = Studio::new(&field, &options, args.options.words(), reporter);
    let address = server.address();
    let mut stdout = std::io::stdout().lock();
    heard(writeln!(stdout, "{address}").and_then(|()| stdout.flush()))?;
    drop(stdout);
    if !args.no_open && !open(&address) {
        reporter.note("No browser could be opened: open the address by hand.");
    }
    server.serve(&studio).map_err(|error| CliError::Failure(format!("the server ended ({error})")))
}

/// The options after the automatic choice of methods, without what a page can't wait for: a plan, unless it was made before
/// or options are given, and maps that are not prepared.
fn live_options(
    field: &LightField,
    options: &RenderOptions,
    are_default: bool,
    reporter: &Reporter,
) -> Result<RenderOptions, CliError> {
    if are_default && pipeline::planned_before(field, options).is_none() {
        reporter.note(
            "Pictures are by depth per pixel. stlfr prepare chooses methods by this capture, and makes pictures faster.",
        );
        let mut usual = RenderOptions { auto: AutoOptions::default(), ..options.clone() };
        usual.proxy.method = ProxyMethod::Depth;
        return Ok(usual);
    }
    let mut planned = pipeline::resolved(field, options, reporter)?;
    let is_slow = planned.proxy.method == ProxyMethod::SceneFlow && options.auto.proxy;
    if is_slow && !field.has_prepared_maps(&planned) {
        planned.proxy.method = ProxyMethod::Depth;
        reporter.note(
            "Pictures are by depth per pixel. Scene flow would be better, but takes half a minute for a new instant: run \
             stlfr prepare with the same options first.",
        );
    }
    Ok(planned)
}

fn refused(port: u16, error: &std::io::Error) -> CliError {
    match error.kind() {
        ErrorKind::AddrInUse => {
            CliError::BadInput(format!("--port: another program serves at {port} already"))
        }
        _ => CliError::BadInput(format!("--port: {port} can't be had ({error})")),
    }
}

/// Opens an address in the user's browser. Returns whether there is a program that opens addresses.
fn open(address: &str) -> bool {
    use std::os::unix::process::CommandExt;
    let opener = if cfg!(target_os = "macos") { "open" } else { "xdg-open" };
    let mut command = Command::new(opener);
    command.arg(address).stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null());
    // In a group of its own: Ctrl+C ends the server, not the browser.
    match command.process_group(0).spawn() {
        Ok(mut child) => {
            // The child may be the browser itself, which runs on: a thread waits for it.
            std::thread::spawn(move || child.wait());
            true
        }
        Err(_) => false,
    }
}
