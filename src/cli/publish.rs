//! The command `stlfr publish`, which writes a light field as a website.

use super::CliError;
use super::files::{CommandOutput, OptionsArgs, open_capture};
use super::print::Page;
use super::values::{TimeSpan, image_size};
use super::viewpoint::rounded;
use crate::light_field::{Viewpoint, check_times_before_offsets};
use crate::options::ProxyMethod;
use crate::pipeline;
use crate::progress::Reporter;
use crate::publish::{Publication, PublishOptions, check_folder, publish};
use std::path::{Path, PathBuf};

/// Publish the light field as a folder that any static web server shows.
///
/// The visitor's graphics card renders the views (WebGL 2) from the frames with their depth and motion, as render
/// --proxy scene-flow does. The page also opens from disk. Depth and motion that prepare has not stored are computed
/// first. Quality and size of the frames are the largest that fit into --max-mb.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  \
    stlfr publish .captures/demo -o site\n  \
    stlfr publish .captures/demo -o site --span 0.05:0.2 --max-mb 8\n  \
    stlfr publish .captures/demo -o site --size 640x480\n\n\
    python3 -m http.server -d site shows it at http://localhost:8000. An address that ends with #t=0.1&x=0.02 begins \
    there: t in seconds, x, y and z in metres to the right, up and ahead of the cameras' middle.")]
pub struct PublishArgs {
    /// The capture's folder.
    capture: PathBuf,
    /// Folder of the site: a new folder, or the folder of an earlier site.
    #[arg(short, long, value_name = "SITE")]
    output: PathBuf,
    /// Time span of the site, in seconds on the reference camera's clock [default: the span in which all cameras film].
    #[arg(long, value_name = "START:END", allow_hyphen_values = true)]
    span: Option<TimeSpan>,
    /// Largest size of the frames; larger frames are halved until they fit.
    #[arg(long, value_name = "WxH", value_parser = image_size)]
    size: Option<(u32, u32)>,
    /// Largest size of the folder, in MB.
    #[arg(long, value_name = "MB", default_value = "15", value_parser = clap::value_parser!(u32).range(1..=1000))]
    max_mb: u32,
    #[command(flatten)]
    options: OptionsArgs,
}

/// Number of bytes in a megabyte.
const MB: f64 = 1e6;

pub fn run(args: &PublishArgs, page: &mut Page, reporter: &Reporter) -> Result<(), CliError> {
    let mut options = args.options.read()?;
    // The page renders by scene flow, whatever method other commands use.
    options.proxy.method = ProxyMethod::SceneFlow;
    (options.auto.proxy, options.auto.blend, options.auto.sync) = (false, false, false);
    CommandOutput::Folder(&args.output, &[]).check(Some(&args.capture))?;
    check_folder(&args.output)?;
    let capture = open_capture(&args.capture, None, reporter)?;
    let origin_s = capture.time_origin_s;
    let span_s = args.span.map(|TimeSpan(first, last)| (first - origin_s, last - origin_s));
    if let Some((first, last)) = span_s {
        let checked = check_times_before_offsets(&capture, None, &[first, last]);
        checked.map_err(|e| CliError::from(e).of_flag("--span"))?;
    }
    let name = capture.name.clone();
    let field = pipeline::open_field(capture, &options, reporter)?;
    if let Some((first, last)) = span_s {
        let capture = field.capture();
        let lens = Viewpoint::View(&capture.cameras[capture.reference].camera);
        let checked = field.check_times(lens, &[first, last]);
        checked.map_err(|e| CliError::from(e).of_flag("--span"))?;
    }
    let wanted = PublishOptions {
        span_s,
        max_size: args.size.map(|(width, height)| [width as usize, height as usize]),
        max_bytes: u64::from(args.max_mb) * MB as u64,
    };
    let published = publish(&field, &options, &wanted, &args.output, reporter)?;
    print(&published, origin_s, page);
    page.line(iframe(&args.output, &name, published.size));
    Ok(())
}

/// Prints the numbers and sizes of the published data, and the PSNR of the site's pictures relative to the pictures
/// that `stlfr render` renders for the same views.
fn print(published: &Publication, origin_s: f64, page: &mut Page) {
    let &Publication { cameras, frames, size: [width, height], span_s, jpeg, .. } = published;
    let [start, end] = [span_s.0, span_s.1].map(|t| rounded(t + origin_s));
    page.line(format_args!(
        "{frames} frames of {cameras} cameras at {width}x{height}, from {start} to {end} s."
    ));
    let mb = |bytes: u64| bytes as f64 / MB;
    page.line(format_args!("Images: JPEG of quality {jpeg}, {:.2} MB.", mb(published.image_bytes)));
    let block = match published.block_px {
        1 => "every pixel".to_owned(),
        side => format!("every {side}x{side} pixels"),
    };
    page.line(format_args!(
        "Depth and motion: of {block}, disparities in steps of {} px, {:.2} MB.",
        published.disparity_step_px,
        mb(published.flow_bytes)
    ));
    page.line(format_args!("Together with the page: {:.2} MB.", mb(published.bytes)));
    let psnr_db = &published.psnr_db;
    if !psnr_db.is_empty() {
        page.line(format_args!(
            "Beside render's pictures at {} places between two cameras and instants between two frames: {:.1} to {:.1} dB.",
            psnr_db.len(),
            psnr_db.iter().copied().fold(f64::INFINITY, f64::min),
            psnr_db.iter().copied().fold(f64::NEG_INFINITY, f64::max),
        ));
    }
}

/// Returns the line of HTML with the `<iframe>` that embeds the site in another page.
fn iframe(folder: &Path, name: &str, [width, height]: [usize; 2]) -> String {
    let folder = folder.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
    format!(
        r#"<iframe src="{}/index.html" title="{}" width="{width}" height="{height}" style="border:0" loading="lazy" allow="accelerometer; gyroscope; fullscreen"></iframe>"#,
        in_address(&folder),
        in_attribute(name),
    )
}

/// Percent-encodes the name of a folder for a URL.
fn in_address(name: &str) -> String {
    let shown = |b: u8| match b {
        b if b.is_ascii_alphanumeric() || b"-._~".contains(&b) => char::from(b).to_string(),
        b => format!("%{b:02X}"),
    };
    name.bytes().map(shown).collect()
}

/// Escapes a text for the value of an HTML attribute.
fn in_attribute(text: &str) -> String {
    text.replace('&', "&amp;").replace('"', "&quot;").replace('<', "&lt;").replace('>', "&gt;")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_line_for_other_pages_holds_any_name() {
        let line = iframe(Path::new("sites/a \"b\"/"), "<x> & \"y\"", [640, 480]);
        assert!(line.starts_with(r#"<iframe src="a%20%22b%22/index.html" title="&lt;x&gt; &amp; &quot;y&quot;" width="640""#), "{line}");
    }
}
