//! Whether every option has a reason: what it changes of images, views, offsets and processor time on filmed
//! captures, beside the truth.
//!
//! `cargo bench --bench options -- CAPTURE… [--instants N] [--only NAME]`
//!
//! Options, their defaults and ranges are the declared ones: a method is replaced by every other, a switch is
//! turned, a number is halved and doubled. Clocks of images and views are the true ones. PSNR is of the moving
//! part. A line is marked where no capture changes by 0.1 dB, by 0.002 frame of the worst offset, or by a fifth
//! of the processor time.

use std::collections::BTreeMap;
use std::sync::Arc;
use stlfr::camera::Camera;
use stlfr::capture::{Capture, Truth, TruthView, read_array};
use stlfr::host::Stopwatch;
use stlfr::light_field::LightField;
use stlfr::metrics::moving_part;
use stlfr::offset::{Offsets, estimate};
use stlfr::option::{DeclaredOption, OptionKind};
use stlfr::options::RenderOptions;
use stlfr::progress::Reporter;
use stlfr::raster::{Image, read_image};
use stlfr::registration::FrameStore;

type Error = Box<dyn std::error::Error>;

/// Options that act with another method only, and the options that choose it.
const CONTEXTS: [(&str, &str, &str); 5] = [
    ("proxy.plane_depth_m", "proxy.method", "plane"),
    ("proxy.depth.", "proxy.method", "depth"),
    ("interpolation.max_edge_length_px", "sync", "edge-morph"),
    ("interpolation.grid_px", "sync", "edge-morph"),
    ("blend.error_angle_rad", "blend.method", "space-time"),
];
/// Options that no image of an instant depends on, and those by which the capture decides others.
const UNMEASURED: [&str; 2] = ["trail.", "auto."];

/// Smallest change that is a reason: of PSNR, of the worst offset's error, and of time as a ratio.
const MIN_DB: f64 = 0.1;
const MIN_FRAMES: f64 = 0.002;
const MIN_RATIO: f64 = 1.2;

/// A true image.
struct Target {
    /// The camera that is synchronized; `None`: a view.
    filmed: Option<usize>,
    camera: Camera,
    time_s: f64,
    image: Image,
    moving: Vec<bool>,
}

/// A capture with its truth.
struct Scene {
    capture: Arc<Capture>,
    truth: Truth,
    clocks: Offsets,
    targets: Vec<Target>,
}

/// What one set of options gives.
#[derive(Clone, Copy)]
struct Outcome {
    /// PSNR of synchronized images and of views, dB.
    db: [f64; 2],
    /// Processor seconds of all images, and of the offsets.
    cpu_s: [f64; 2],
    /// Largest error of an offset, frames; NaN where offsets were not estimated.
    worst_frames: f64,
}

impl Scene {
    fn open(folder: &str, instants: usize) -> Result<Self, Error> {
        let capture = Arc::new(Capture::open(folder.as_ref())?);
        let truth = Truth::open(folder.as_ref())?.ok_or("has no truth")?;
        let mut clocks = Offsets::known(&capture);
        for camera in &mut clocks.cameras {
            camera.offset_s = truth.offset_s(&camera.id);
        }
        let mut times_s: Vec<f64> = truth.views.iter().map(|view| view.time_s).collect();
        times_s.dedup();
        // The middle ones: there are frames before and after.
        let first = (times_s.len() - instants.min(times_s.len())).div_ceil(2);
        let used = &times_s[first..(first + instants).min(times_s.len())];
        let views = truth.views.iter().filter(|view| used.contains(&view.time_s));
        let targets: Result<_, Error> = views.map(|v| Target::read(&capture, &truth, v)).collect();
        Ok(Self { targets: targets?, capture, truth, clocks })
    }

    fn measure(&self, options: &RenderOptions, with_offsets: bool) -> Result<Outcome, Error> {
        let watch = Stopwatch::start();
        let field = LightField::new(self.capture.clone(), self.clocks.clone());
        let mut images = Vec::new();
        for target in &self.targets {
            let (image, covered) = match target.filmed {
                Some(camera) => {
                    (field.synchronized(camera, target.time_s, options)?.image.clone(), None)
                }
                None => {
                    let rendered = field.view(&target.camera, target.time_s, options)?;
                    (rendered.image, Some(rendered.coverage))
                }
            };
            images.push((target, image, covered));
        }
        let images_s = watch.elapsed().cpu_s;
        let mut squares = [[0.0, 0.0]; 2];
        for (target, image, covered) in &images {
            target.add_squares(image, covered, &mut squares[usize::from(target.filmed.is_none())]);
        }
        let watch = Stopwatch::start();
        let worst_frames = if with_offsets { self.worst_frames(options)? } else { f64::NAN };
        Ok(Outcome {
            db: squares.map(|[sum, n]: [f64; 2]| -10.0 * (sum / n).log10()),
            cpu_s: [images_s, watch.elapsed().cpu_s],
            worst_frames,
        })
    }

    /// The largest error of an estimated offset; a missing one counts as a whole frame.
    fn worst_frames(&self, options: &RenderOptions) -> Result<f64, Error> {
        let frames = FrameStore::new(self.capture.clone(), &options.registration);
        let offsets = estimate(&frames, &options.offset, &Reporter::silent())?.offsets;
        let errors = offsets.cameras.iter().filter_map(|camera| {
            let true_s = self.truth.offset_s(&camera.id)?;
            let error_s = camera.offset_s.map_or(self.capture.frame_s(), |found| found - true_s);
            Some(error_s.abs() / self.capture.frame_s())
        });
        Ok(errors.fold(0.0, f64::max))
    }
}

impl Target {
    fn read(capture: &Capture, truth: &Truth, view: &TruthView) -> Result<Self, Error> {
        let (width, _, motion_px) = read_array(&truth.file(&view.motion)?)?;
        Ok(Self {
            filmed: view.like.as_ref().and_then(|id| capture.camera_index(id)),
            camera: view.camera.camera()?,
            time_s: view.time_s - capture.time_origin_s,
            image: read_image(&truth.file(&view.image)?)?.0,
            moving: moving_part(&motion_px, width, 0.5, 2),
        })
    }

    /// Adds the squared error of the moving part to a sum, and the number of values to a count.
    fn add_squares(&self, image: &Image, covered: &Option<Vec<bool>>, [sum, n]: &mut [f64; 2]) {
        let channels = image.channels();
        for (k, (a, b)) in image.data().iter().zip(self.image.data()).enumerate() {
            let pixel = k / channels;
            if self.moving[pixel] && covered.as_ref().is_none_or(|covered| covered[pixel]) {
                *sum += f64::from(a - b).powi(2);
                *n += 1.0;
            }
        }
    }
}

/// An option's values that are compared with its default, as an options file has them.
fn values(option: &DeclaredOption) -> Vec<String> {
    let Some([min, max]) = option.range else {
        let all: Vec<String> = match option.kind {
            OptionKind::Boolean => vec!["true".into(), "false".into()],
            _ => option.choices.iter().map(|choice| choice.name.to_owned()).collect(),
        };
        let default = option.default.to_string();
        return all.into_iter().filter(|value| *value != default.trim_matches('"')).collect();
    };
    let is_integer = option.kind == OptionKind::Integer;
    let default = option.default.as_f64();
    let numbers = match default {
        Some(0.0) if is_integer => [1.0, 2.0],
        Some(0.0) => [0.01, 0.02],
        Some(default) => [0.5 * default, 2.0 * default],
        None => [1.0, 2.0],
    };
    let numbers = numbers.map(|v| if is_integer { v.round() } else { v }.clamp(min, max));
    numbers.iter().filter(|v| Some(**v) != default).map(f64::to_string).collect()
}

/// Changes of one option's value, capture by capture.
struct Row {
    name: String,
    value: String,
    /// What the option has as its default, and what this value gives.
    pairs: Vec<[Outcome; 2]>,
}

impl Row {
    /// Changes of PSNR of images and views, dB; of the worst offset, frames; ratios of both times.
    fn changes(&self) -> [Vec<f64>; 5] {
        let of = |f: &dyn Fn(&Outcome, &Outcome) -> f64| {
            self.pairs.iter().map(|[default, changed]| f(default, changed)).collect()
        };
        [
            of(&|d, c| c.db[0] - d.db[0]),
            of(&|d, c| c.db[1] - d.db[1]),
            of(&|d, c| c.worst_frames - d.worst_frames),
            of(&|d, c| c.cpu_s[0] / d.cpu_s[0]),
            of(&|d, c| if c.worst_frames.is_nan() { f64::NAN } else { c.cpu_s[1] / d.cpu_s[1] }),
        ]
    }

    fn has_reason(&self) -> bool {
        let [images, views, offsets, ..] = self.changes();
        let by = |changes: &[f64], min: f64| changes.iter().any(|c| c.abs() >= min);
        by(&images, MIN_DB) || by(&views, MIN_DB) || by(&offsets, MIN_FRAMES) || self.is_timed()
    }

    /// Whether times differ on average: single ones vary.
    fn is_timed(&self) -> bool {
        let [.., images, offsets] = self.changes();
        [images, offsets].iter().any(|ratios| mean(ratios).ln().abs() >= MIN_RATIO.ln())
    }

    fn print(&self, option_has_reason: bool) {
        let [images, views, offsets, image_time, offset_time] = self.changes();
        let cell = |v: f64, text: String| if v.is_nan() { String::new() } else { text };
        let db = |c: &[f64]| format!("{:+.2}", mean(c));
        let frames = cell(mean(&offsets), format!("{:+.4}", mean(&offsets)));
        let ratio = |c: &[f64]| cell(mean(c), format!("×{:.2}", mean(c)));
        println!(
            "| `{}` | {} | {} | {} | {frames} | {} | {} | {} |",
            self.name,
            self.value,
            db(&images),
            db(&views),
            ratio(&image_time),
            ratio(&offset_time),
            if option_has_reason { "" } else { "none" }
        );
    }
}

fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len() as f64
}

/// Measurements of the defaults, by what was set besides and whether offsets were estimated.
type Defaults = BTreeMap<(usize, Option<&'static str>, bool), Outcome>;

struct Bench {
    scenes: Vec<Scene>,
    defaults: Defaults,
}

impl Bench {
    /// The outcomes of an option's value on all captures, each beside the default's.
    fn row(&mut self, option: &DeclaredOption, value: String) -> Result<Row, Error> {
        let name = &option.name;
        let context = CONTEXTS.iter().find(|(prefix, ..)| name.starts_with(prefix));
        let mut options = RenderOptions::default();
        if let Some((_, method, choice)) = context {
            options.set(method, choice)?;
        }
        let mut changed = options.clone();
        changed.set(name, &value)?;
        let with_offsets = ["registration.", "offset."].iter().any(|p| name.starts_with(p));
        let mut pairs = Vec::new();
        for (k, scene) in self.scenes.iter().enumerate() {
            let key = (k, context.map(|(_, _, choice)| *choice), with_offsets);
            let default = match self.defaults.get(&key) {
                Some(known) => *known,
                None => scene.measure(&options, with_offsets)?,
            };
            self.defaults.insert(key, default);
            pairs.push([default, scene.measure(&changed, with_offsets)?]);
        }
        Ok(Row { name: name.clone(), value, pairs })
    }
}

fn main() -> Result<(), Error> {
    let mut arguments = std::env::args().skip(1).filter(|a| a != "--bench");
    let (mut folders, mut instants, mut only) = (Vec::new(), 1, None);
    while let Some(argument) = arguments.next() {
        let mut value = || arguments.next().ok_or("the last argument lacks its value");
        match argument.as_str() {
            "--instants" => instants = value()?.parse()?,
            "--only" => only = Some(value()?),
            _ => folders.push(argument),
        }
    }
    let scenes: Result<Vec<_>, _> = folders.iter().map(|f| Scene::open(f, instants)).collect();
    let mut bench = Bench { scenes: scenes?, defaults: Defaults::new() };
    // The first measurement alone starts threads and reads files.
    bench.scenes.first().ok_or("no capture is given")?.measure(&RenderOptions::default(), true)?;
    println!(
        "| option | value | images, dB | views, dB | offsets, frames | time | of offsets | reason |"
    );
    println!("|---|---|---|---|---|---|---|---|");
    for option in RenderOptions::default().declared() {
        let is_skipped = UNMEASURED.iter().any(|prefix| option.name.starts_with(prefix));
        if is_skipped || only.as_ref().is_some_and(|only| !option.name.contains(only)) {
            continue;
        }
        let rows = values(&option).into_iter().map(|value| bench.row(&option, value));
        let rows: Vec<Row> = rows.collect::<Result<_, _>>()?;
        let has_reason = rows.iter().any(Row::has_reason);
        rows.iter().for_each(|row| row.print(has_reason));
    }
    Ok(())
}
