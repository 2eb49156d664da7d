//! The command `stlfr info`, which shows the contents of a capture.

use super::CliError;
use super::error::of_io;
use super::files::must_be_a_file;
use super::print::{Page, decimals};
use super::viewpoint::{example, rounded};
use crate::capture::{CAPTURE_FILE, Capture, CaptureError, CaptureFormat, Opening, Truth};
use crate::host::{CacheUse, DiskCache};
use crate::json;
use crate::offset::{Offsets, SavedOffsets};
use crate::progress::Reporter;
use serde::Serialize;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Show what a capture contains, its offsets, and its cached results.
///
/// Nothing is decoded or estimated. Decoded videos, registered frames, plans, measurements and hashes of files are
/// cached in the capture's folder, under .stlfr/cache. They may be deleted at any time, and are computed again when
/// they are needed.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  \
    stlfr info .captures/demo\n  \
    stlfr info .captures/demo --json\n  \
    stlfr info .captures/demo --delete-cache\n  \
    stlfr info .captures/demo --delete-cache video")]
pub struct InfoArgs {
    /// The capture's folder.
    capture: PathBuf,
    /// Print JSON and nothing else.
    #[arg(long)]
    json: bool,
    /// Delete all cached results, or the cached results of one kind, and do nothing else.
    #[arg(long, value_name = "KIND", num_args = 0..=1, conflicts_with = "json")]
    delete_cache: Option<Option<String>>,
}

pub fn run(args: &InfoArgs, page: &mut Page, reporter: &Reporter) -> Result<(), CliError> {
    if let Some(kind) = &args.delete_cache {
        return delete(&args.capture, kind.as_deref(), page);
    }
    let info = Info::of(&args.capture, reporter)?;
    if args.json {
        page.json(&info)
    } else {
        info.print(&args.capture, page);
        Ok(())
    }
}

/// Deletes cached results. This also works if the capture can't be opened.
fn delete(capture: &Path, kind: Option<&str>, page: &mut Page) -> Result<(), CliError> {
    must_be_a_file(&capture.join(CAPTURE_FILE))?;
    let cache = DiskCache::new(capture, |_| ());
    let cached: Vec<String> = cache.listing().into_iter().map(|found| found.kind).collect();
    if let Some(kind) = kind.filter(|kind| !cached.iter().any(|k| k == kind)) {
        let others = match &*cached {
            [] => "nor is anything else".to_owned(),
            cached => format!("but {}", cached.join(", ")),
        };
        let sentence = format!("--delete-cache: no '{kind}' is cached, {others}");
        return Err(CliError::BadInput(sentence));
    }
    let deleted = of_io(capture, "the cache can't be deleted", cache.delete(kind))?;
    page.line(match deleted.entries {
        0 => "Nothing was cached.".to_owned(),
        n => format!("Deleted {n} {}, {}.", entries(n), size(deleted.bytes)),
    });
    Ok(())
}

/// Summary of a capture, which is printed as text or JSON.
#[derive(Serialize)]
struct Info {
    name: String,
    /// Id of the reference camera.
    reference: String,
    cameras: Vec<CameraInfo>,
    /// First and last time at which all cameras with known clocks have frames, in seconds on the reference camera's
    /// clock. `None` if there is no such time, or if videos aren't decoded yet.
    times_of_all_s: Option<(f64, f64)>,
    /// First and last time at which any camera with a known clock has frames, in seconds on the reference camera's
    /// clock. `None` if videos aren't decoded yet.
    times_of_any_s: Option<(f64, f64)>,
    /// Times of the ground-truth images, in seconds on the reference camera's clock, by the name of the view.
    truth: BTreeMap<String, Vec<f64>>,
    offsets: OffsetsState,
    cache: Vec<CacheUse>,
    /// Example of a command that renders a view; `None` if videos aren't decoded yet.
    example: Option<String>,
}

#[derive(Serialize)]
struct CameraInfo {
    id: String,
    width: u32,
    height: u32,
    model: String,
    /// The camera's field `frames` in capture.json: the pattern of the image files, or a video.
    source: String,
    /// Number of frames; `None` if videos aren't decoded yet.
    frames: Option<usize>,
    /// Frame rate, in hertz; `None` for a camera with one frame, or if it is unknown before videos are decoded.
    rate_hz: Option<f64>,
    clock: ClockState,
    /// Time on the reference camera's clock minus time on this camera's clock, in seconds; `None` if unknown.
    offset_s: Option<f64>,
    std_err_s: Option<f64>,
}

#[derive(Clone, Copy, PartialEq, Serialize)]
#[serde(rename_all = "snake_case")]
enum ClockState {
    Reference,
    /// The camera shares the clock of the reference camera.
    Shared,
    /// Every camera of the capture has a single frame, so that no offset is needed.
    OneFrame,
    Estimated,
    /// The offset in offsets.json was edited by hand.
    Edited,
    Unknown,
}

#[derive(Clone, Copy, PartialEq, Serialize)]
#[serde(rename_all = "snake_case")]
enum OffsetsState {
    /// No offset is needed, because all cameras share one clock, or every camera has a single frame.
    Unneeded,
    Missing,
    /// The offsets in offsets.json were estimated from the capture's present frames.
    Estimated,
    /// The offsets in offsets.json were estimated from other frames, or by another version of the program.
    Outdated,
    Edited,
    /// The offsets in offsets.json were not compared with the frames, because the capture's videos have not been
    /// decoded by any command so far.
    Unchecked,
}

impl Info {
    fn of(folder: &Path, reporter: &Reporter) -> Result<Self, CliError> {
        // No ffmpeg is given, so that no video is decoded.
        let capture = match Capture::open_with(folder, &Opening { ffmpeg: None, reporter }) {
            Ok(capture) => Some(capture),
            Err(CaptureError::NoFfmpeg { .. }) => None,
            Err(error) => return Err(error.into()),
        };
        let path = folder.join(CAPTURE_FILE);
        let format: CaptureFormat = json::read(&path)
            .map_err(|source| CaptureError::Json { path: path.clone(), source })?;
        let (state, offsets) = match &capture {
            None => (OffsetsState::Unchecked, None),
            Some(capture) => offsets(capture)?,
        };
        let number = capture.as_ref().map_or_else(
            || match &format.reference {
                Some(id) => format.cameras.iter().position(|camera| camera.id == *id).unwrap_or(0),
                None => (format.cameras.len() - 1) / 2,
            },
            |capture| capture.reference,
        );
        let spans = capture.as_ref().zip(offsets.as_ref()).map(|(c, o)| spans_s(c, o));
        let camera = |(k, from): (usize, &crate::capture::FilmedCameraFormat)| {
            let filmed = capture.as_ref().map(|capture| &capture.cameras[k]);
            let offset = offsets.as_ref().map(|offsets| &offsets.cameras[k]);
            let offset_s = offset.and_then(|offset| offset.offset_s);
            let shares = |k: usize| format.cameras[k].clock.shared;
            CameraInfo {
                id: from.id.clone(),
                width: from.width,
                height: from.height,
                model: from.model.clone(),
                source: from.frames.clone(),
                frames: filmed.map(|filmed| filmed.frames.len()),
                rate_hz: from.clock.rate_hz.or_else(|| {
                    let frame_s = filmed.map(|filmed| filmed.clock.frame_s());
                    frame_s.filter(|s| *s > 0.0).map(|s| 1.0 / s)
                }),
                clock: match (offset_s, state) {
                    _ if k == number => ClockState::Reference,
                    _ if shares(k) && shares(number) => ClockState::Shared,
                    (Some(_), OffsetsState::Unneeded) => ClockState::OneFrame,
                    (Some(_), OffsetsState::Edited) => ClockState::Edited,
                    (Some(_), _) => ClockState::Estimated,
                    (None, _) => ClockState::Unknown,
                },
                offset_s,
                std_err_s: offset.and_then(|offset| offset.std_err_s),
            }
        };
        Ok(Self {
            reference: format.cameras[number].id.clone(),
            cameras: format.cameras.iter().enumerate().map(camera).collect(),
            name: format.name,
            times_of_all_s: spans.and_then(|(all, _)| all),
            times_of_any_s: spans.and_then(|(_, any)| any),
            truth: true_times_s(folder)?,
            offsets: state,
            cache: DiskCache::new(folder, |_| ()).listing(),
            example: capture.as_ref().map(|capture| example(capture, folder)),
        })
    }

    fn print(&self, folder: &Path, page: &mut Page) {
        let count = self.cameras.len();
        let cameras = if count == 1 { "camera" } else { "cameras" };
        page.line(format_args!("{}: {count} {cameras}, reference {}", self.name, self.reference));
        page.line(format_args!(
            "\n{:<12} {:>11} {:<16} {:>9} {:>7}  clock",
            "camera", "size", "model", "rate", "frames"
        ));
        self.cameras.iter().for_each(|camera| page.line(camera.row()));
        page.line("");
        match (self.times_of_all_s, self.times_of_any_s) {
            (_, None) => page.line("Times    unknown: videos aren't decoded yet"),
            (None, Some((first, last))) => {
                page.line(format_args!(
                    "Times    {first:.4} to {last:.4} s from any camera, none from all"
                ));
            }
            (Some(all), Some(any)) => page.line(format_args!(
                "Times    {:.4} to {:.4} s from all cameras, {:.4} to {:.4} s from any",
                all.0, all.1, any.0, any.1
            )),
        }
        let unknown = self.cameras.iter().filter(|c| c.clock == ClockState::Unknown).count();
        if unknown > 0 && self.times_of_any_s.is_some() {
            page.line(format_args!("         without {unknown} of unknown clock"));
        }
        page.line(format_args!("Offsets  {}", self.offsets.sentence()));
        list(page, "Truth", "none", self.true_views());
        let cached = self.cache.iter().map(|CacheUse { kind, entries: n, bytes }| {
            format!("{kind:<22} {n:>6} {:<7} {:>10}", entries(*n), size(*bytes))
        });
        list(page, "Cache", "empty", cached.collect());
        if !self.cache.is_empty() {
            page.line(format_args!(
                "         deleted by: stlfr info {} --delete-cache [KIND]",
                folder.display()
            ));
        }
        list(
            page,
            "Example",
            "none: videos aren't decoded yet",
            self.example.clone().into_iter().collect(),
        );
    }

    /// Returns the list of ground-truth views as rows of text. Successive views with the same times share a row.
    fn true_views(&self) -> Vec<String> {
        let views: Vec<(&String, &Vec<f64>)> = self.truth.iter().collect();
        let row = |views: &[(&String, &Vec<f64>)]| {
            let ids: Vec<&str> = views.iter().map(|(id, _)| id.as_str()).collect();
            format!("{} at {}", ids.join(", "), times_of(views[0].1))
        };
        views.chunk_by(|a, b| a.1 == b.1).map(row).collect()
    }
}

/// Prints rows of text, with the text `head` before the first row. If there are no rows, prints `none` after `head`.
fn list(page: &mut Page, mut head: &str, none: &str, rows: Vec<String>) {
    if rows.is_empty() {
        page.line(format_args!("{head:<8} {none}"));
    }
    for row in rows {
        page.line(format_args!("{head:<8} {row}"));
        head = "";
    }
}

impl CameraInfo {
    fn row(&self) -> String {
        let rate = self.rate_hz.map_or("-".into(), |rate| format!("{} Hz", rounded(rate)));
        let frames = self.frames.map_or("?".into(), |frames| frames.to_string());
        let clock = match self.clock {
            ClockState::Reference => "reference".to_owned(),
            ClockState::Shared => "known: the reference's".to_owned(),
            ClockState::OneFrame => "one frame".to_owned(),
            ClockState::Unknown => "unknown".to_owned(),
            ClockState::Estimated => format!("estimated: {}", self.offset()),
            ClockState::Edited => format!("edited: {}", self.offset()),
        };
        let size = format!("{}×{}", self.width, self.height);
        format!("{:<12} {size:>11} {:<16} {rate:>9} {frames:>7}  {clock}", self.id, self.model)
    }

    fn offset(&self) -> String {
        let ms = |seconds: Option<f64>| 1e3 * seconds.unwrap_or(f64::NAN);
        let digits = decimals(self.std_err_s.map(|s| 1e3 * s));
        format!("{:.digits$} ± {:.digits$} ms", ms(self.offset_s), ms(self.std_err_s))
    }
}

impl OffsetsState {
    fn sentence(self) -> &'static str {
        match self {
            Self::Unneeded => "need no estimate",
            Self::Missing => "not estimated yet (stlfr offsets)",
            Self::Estimated => "offsets.json, estimated from these frames",
            Self::Outdated => "offsets.json is of other frames or of another version",
            Self::Edited => "offsets.json, edited by hand",
            Self::Unchecked => "not looked at: videos aren't decoded yet",
        }
    }
}

/// Returns the state of offsets.json, and the known temporal offsets, which are never `None`. The offsets are read from
/// the file if the file was edited, or if its offsets were estimated from the capture's present frames. Otherwise, only
/// the offsets that need no estimate are known.
fn offsets(capture: &Capture) -> Result<(OffsetsState, Option<Offsets>), CliError> {
    let is_known = |camera| capture.has_reference_clock(camera);
    let mut known = Offsets::known(capture);
    if capture.is_static() || (0..capture.cameras.len()).all(is_known) {
        return Ok((OffsetsState::Unneeded, Some(known)));
    }
    for (_, offset) in known.cameras.iter_mut().enumerate().filter(|(k, _)| !is_known(*k)) {
        (offset.offset_s, offset.std_err_s) = (None, None);
    }
    Ok(match Offsets::saved(capture)? {
        SavedOffsets::Missing => (OffsetsState::Missing, Some(known)),
        SavedOffsets::Edited(offsets) => (OffsetsState::Edited, Some(offsets)),
        SavedOffsets::Estimated { offsets, options, hash } => {
            if Offsets::hash(capture, &options)? == hash {
                (OffsetsState::Estimated, Some(offsets))
            } else {
                (OffsetsState::Outdated, Some(known))
            }
        }
    })
}

/// Returns the times of the ground-truth images, in seconds on the reference camera's clock, by the name of the view.
fn true_times_s(folder: &Path) -> Result<BTreeMap<String, Vec<f64>>, CliError> {
    let mut by_view = BTreeMap::<String, Vec<f64>>::new();
    for view in Truth::open(folder)?.into_iter().flat_map(|truth| truth.views) {
        by_view.entry(view.id).or_default().push(view.time_s);
    }
    by_view.values_mut().for_each(|times| times.sort_by(f64::total_cmp));
    Ok(by_view)
}

type Span = Option<(f64, f64)>;

/// Returns the time span in which all cameras have frames, and the time span in which any camera has frames, in seconds
/// on the reference camera's clock. A span without times is `None`. Cameras with unknown clocks are ignored.
fn spans_s(capture: &Capture, offsets: &Offsets) -> (Span, Span) {
    let times_s = offsets.common_times_s(capture);
    let of_camera = |times: &Vec<f64>| Some((*times.first()?, *times.last()?));
    let spans: Vec<(f64, f64)> = times_s.iter().flatten().filter_map(of_camera).collect();
    let origin_s = capture.time_origin_s;
    let fold = |start: fn(f64, f64) -> f64, end: fn(f64, f64) -> f64| {
        let span = spans.iter().copied().reduce(|a, b| (start(a.0, b.0), end(a.1, b.1)));
        span.filter(|(first, last)| first <= last).map(|(a, b)| (a + origin_s, b + origin_s))
    };
    (fold(f64::max, f64::min), fold(f64::min, f64::max))
}

/// Formats a list of times as text: the first six times, and the number of the remaining times.
fn times_of(times_s: &[f64]) -> String {
    const SHOWN: usize = 6;
    let shown: Vec<String> = times_s.iter().take(SHOWN).map(|t| rounded(*t)).collect();
    let more = times_s.len().saturating_sub(SHOWN);
    let more = if more > 0 { format!(" and {more} more") } else { String::new() };
    format!("{} s{more}", shown.join(", "))
}

fn entries(count: usize) -> &'static str {
    if count == 1 { "entry" } else { "entries" }
}

fn size(bytes: u64) -> String {
    match bytes as f64 {
        b if b < 1e3 => format!("{b} B"),
        b if b < 1e6 => format!("{:.1} kB", b / 1e3),
        b if b < 1e9 => format!("{:.1} MB", b / 1e6),
        b => format!("{:.1} GB", b / 1e9),
    }
}
