//! The command `stlfr rig`, which generates simulated camera rigs.

use super::CliError;
use super::error::written;
use super::files::CommandOutput;
use super::print::Page;
use super::values::{image_size, method};
use crate::capture::{self, MAX_FRAMES};
use crate::host::write_atomically;
use crate::rig::limits::MAX_CAMERAS;
use crate::rig::{
    self, Delays, Loss, LossStamps, Rig, RigColor, RigDistortion, RigLayout, RigOptions,
};
use crate::text::MAX_ID_LENGTH;
use crate::tradeoff;
use std::num::NonZeroUsize;
use std::path::PathBuf;

/// Generate a rig file with the poses, lenses, shutters and sensors of simulated cameras. The same command writes the
/// same file.
///
/// If an option takes a list, its values are assigned to the cameras in turn.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  \
    stlfr rig line --count 8 --seed 7 -o rigs/mine.json\n  \
    stlfr rig grid --rows 3 --columns 3 --rate 24,25,30 --noise 0.01 -o rigs/mine.json\n  \
    stlfr rig arc --count 5 --distance 1.5 --distortion=-0.2,0.05,0.001,0 -o rigs/mine.json\n  \
    stlfr rig --check rigs/mine.json\n  \
    stlfr rig --schema rig > rig.schema.json")]
#[command(group = clap::ArgGroup::new("what").required(true).args(["layout", "check", "schema"]))]
pub struct RigArgs {
    /// Arrangement of the cameras: a line from left to right, a grid row by row, or an arc whose cameras look at one
    /// point.
    layout: Option<LayoutName>,
    /// Check a rig file instead of generating one.
    #[arg(long, value_name = "FILE")]
    check: Option<PathBuf>,
    /// Print the JSON Schema of a format instead of generating a rig.
    #[arg(long, value_name = "FORMAT")]
    schema: Option<SchemaName>,
    #[command(flatten)]
    place: PlaceArgs,
    #[command(flatten)]
    clock: RigClockArgs,
    #[command(flatten)]
    sensor: SensorArgs,
    /// Seed of all random numbers.
    #[arg(long, value_name = "N", default_value_t = 0)]
    seed: u64,
    /// Name of the rig [default: the name of the file].
    #[arg(long, value_name = "NAME")]
    name: Option<String>,
    /// The file to write [default: standard output].
    #[arg(short, long, value_name = "FILE")]
    output: Option<PathBuf>,
}

#[derive(Clone, Copy, Debug, clap::ValueEnum)]
enum LayoutName {
    Line,
    Grid,
    Arc,
}

#[derive(Clone, Copy, Debug, clap::ValueEnum)]
enum SchemaName {
    Rig,
    Capture,
    Tradeoff,
}

#[derive(Debug, clap::Args)]
#[command(next_help_heading = "Places and lenses")]
struct PlaceArgs {
    /// Number of cameras of a line or an arc [default: 8].
    #[arg(long, value_name = "N", value_parser = number_of)]
    count: Option<NonZeroUsize>,
    /// Number of rows of a grid [default: 2].
    #[arg(long, value_name = "N", value_parser = number_of)]
    rows: Option<NonZeroUsize>,
    /// Number of columns of a grid [default: 4].
    #[arg(long, value_name = "N", value_parser = number_of)]
    columns: Option<NonZeroUsize>,
    /// Distance between neighbouring cameras, in metres.
    #[arg(long, value_name = "M", default_value_t = 0.06)]
    spacing: f64,
    /// Distance to the point that the cameras of an arc look at, in metres [default: 1.8].
    #[arg(long, value_name = "M")]
    distance: Option<f64>,
    /// Image sizes, in pixels.
    #[arg(long, value_name = "WxH,…", default_value = "640x480", value_delimiter = ',',
        value_parser = image_size)]
    size: Vec<(u32, u32)>,
    /// Focal lengths, in millimetres.
    #[arg(long, value_name = "MM,…", default_value = "38.6", value_delimiter = ',')]
    lens: Vec<f64>,
    /// Longer side of the sensor, in millimetres.
    #[arg(long, value_name = "MM", default_value_t = 36.0)]
    sensor: f64,
    /// Lens distortion of all cameras, in COLMAP's OPENCV model.
    #[arg(long, value_name = "K1,K2,P1,P2", value_parser = distortion, allow_hyphen_values = true)]
    distortion: Option<RigDistortion>,
}

#[derive(Debug, clap::Args)]
#[command(next_help_heading = "Shutters and clocks")]
struct RigClockArgs {
    /// Frame rates, in hertz.
    #[arg(long, value_name = "HZ,…", default_value = "30", value_delimiter = ',')]
    rate: Vec<f64>,
    /// Times of the first exposures: `random` within a frame interval, `none` for no delay, or a list of seconds.
    #[arg(long, value_name = "random|none|S,…", default_value = "random", value_parser = delays,
        allow_hyphen_values = true)]
    delays: Delays,
    /// Standard deviations of the jitter of exposure times, in seconds.
    #[arg(long, value_name = "S,…", default_value = "0.001", value_delimiter = ',')]
    jitter: Vec<f64>,
    /// The cameras record no time stamps, so that their jitter is unknown.
    #[arg(long)]
    hidden_jitter: bool,
    /// Largest drift of the clocks, in parts per million; the reference camera's clock has no drift.
    #[arg(long, value_name = "PPM", default_value_t = 0.0)]
    drift: f64,
    /// Number of frames that each camera loses; the reference camera loses none.
    #[arg(long, value_name = "N", default_value_t = 0)]
    lost: usize,
    /// Frames are lost only among the first N frames, but never the very first frame.
    #[arg(long, value_name = "N", default_value_t = 9, value_parser = 1..MAX_FRAMES as i64)]
    lost_within: i64,
    /// How the time stamps show lost frames: as gaps, not at all, or as gaps in every second camera.
    #[arg(long, value_name = "HOW", default_value = "stamped",
        value_parser = method::<LossStamps>())]
    lost_stamps: LossStamps,
    /// All cameras share one clock, and offsets are not estimated.
    #[arg(long)]
    shared_clock: bool,
    /// Exposure durations, in seconds.
    #[arg(long, value_name = "S,…", default_value = "0", value_delimiter = ',')]
    exposure: Vec<f64>,
    /// Readout times of rolling shutters, from the first row to the last, in seconds.
    #[arg(long, value_name = "S,…", default_value = "0", value_delimiter = ',')]
    readout: Vec<f64>,
}

#[derive(Debug, clap::Args)]
#[command(next_help_heading = "Sensors")]
struct SensorArgs {
    /// Colour or grey cameras.
    #[arg(long, value_name = "COLOR,…", default_value = "rgb", value_delimiter = ',',
        value_parser = method::<RigColor>())]
    color: Vec<RigColor>,
    /// Gain factors of the sensors.
    #[arg(long, value_name = "GAIN,…", default_value = "1", value_delimiter = ',')]
    gain: Vec<f64>,
    /// Standard deviations of the noise, relative to a full scale of 1.
    #[arg(long, value_name = "SIGMA,…", default_value = "0", value_delimiter = ',')]
    noise: Vec<f64>,
    /// Bits per channel, 8 or 16.
    #[arg(long, value_name = "N", default_value_t = 8)]
    bit_depth: u32,
}

pub fn run(args: &RigArgs, page: &mut Page) -> Result<(), CliError> {
    if let Some(schema) = args.schema {
        let schema = match schema {
            SchemaName::Rig => rig::schema(),
            SchemaName::Capture => capture::schema(),
            SchemaName::Tradeoff => tradeoff::schema(),
        };
        page.line(format_args!("{schema:#}"));
        return Ok(());
    }
    if let Some(file) = &args.check {
        let rig = Rig::read(file)?;
        let (cameras, views) = (rig.cameras.len(), rig.views.len());
        page.line(format_args!("{}: {cameras} cameras, {views} views", file.display()));
        return Ok(());
    }
    let rig = args.options()?.generate()?;
    let text = rig.to_json();
    match &args.output {
        None => page.text(text),
        Some(file) => {
            CommandOutput::File(file).check(None)?;
            written(file, write_atomically(file, text.as_bytes()))?;
        }
    }
    Ok(())
}

impl RigArgs {
    fn options(&self) -> Result<RigOptions, CliError> {
        let (place, clock, sensor) = (&self.place, &self.clock, &self.sensor);
        Ok(RigOptions {
            name: self.name(),
            layout: place.layout(self.layout.unwrap_or(LayoutName::Line))?,
            spacing_m: place.spacing,
            sizes_px: place.size.clone(),
            lenses_mm: place.lens.clone(),
            sensor_width_mm: place.sensor,
            distortion: place.distortion.unwrap_or_default(),
            rates_hz: clock.rate.clone(),
            delays: clock.delays.clone(),
            jitters_s: clock.jitter.clone(),
            jitter_stamped: !clock.hidden_jitter,
            max_drift_ppm: clock.drift,
            loss: (clock.lost > 0).then_some(Loss {
                count: clock.lost,
                within: clock.lost_within as usize,
                stamps: clock.lost_stamps,
            }),
            clock_shared: clock.shared_clock,
            exposures_s: clock.exposure.clone(),
            readouts_s: clock.readout.clone(),
            gains: sensor.gain.clone(),
            noises: sensor.noise.clone(),
            colors: sensor.color.clone(),
            bit_depth: sensor.bit_depth,
            seed: self.seed,
        })
    }

    /// Returns the given name, or else the output file's name without extension, or else `rig`.
    fn name(&self) -> String {
        let stem = || {
            let stem = self.output.as_ref()?.file_stem()?.to_str()?;
            Some(stem.chars().take(MAX_ID_LENGTH).collect())
        };
        self.name.clone().or_else(stem).unwrap_or_else(|| "rig".into())
    }
}

impl PlaceArgs {
    /// Returns the rig's layout. Arguments that belong to another layout are an error.
    fn layout(&self, name: LayoutName) -> Result<RigLayout, CliError> {
        let is_grid = matches!(name, LayoutName::Grid);
        let wrong = if is_grid && self.count.is_some() {
            Some("--count: a grid has --rows and --columns instead")
        } else if !is_grid && (self.rows.is_some() || self.columns.is_some()) {
            Some("--rows and --columns: a line and an arc have --count instead")
        } else if !matches!(name, LayoutName::Arc) && self.distance.is_some() {
            Some("--distance: only an arc has one")
        } else {
            None
        };
        if let Some(sentence) = wrong {
            return Err(CliError::BadInput(sentence.into()));
        }
        let or = |given: Option<NonZeroUsize>, default| given.or(NonZeroUsize::new(default));
        let [count, rows, columns] = [(self.count, 8), (self.rows, 2), (self.columns, 4)]
            .map(|(given, default)| or(given, default).unwrap_or(NonZeroUsize::MIN));
        Ok(match name {
            LayoutName::Line => RigLayout::Line { count },
            LayoutName::Grid => RigLayout::Grid { rows, columns },
            LayoutName::Arc => RigLayout::Arc { count, distance_m: self.distance.unwrap_or(1.8) },
        })
    }
}

fn number_of(text: &str) -> Result<NonZeroUsize, String> {
    let number = text.parse().ok().filter(|n: &NonZeroUsize| n.get() <= MAX_CAMERAS);
    number.ok_or_else(|| format!("is no number from 1 to {MAX_CAMERAS}"))
}

fn delays(text: &str) -> Result<Delays, String> {
    match text {
        "none" => Ok(Delays::None),
        "random" => Ok(Delays::Random),
        _ => numbers(text)
            .map(Delays::Listed)
            .ok_or_else(|| "is neither `random` nor `none` nor a list of seconds".into()),
    }
}

fn distortion(text: &str) -> Result<RigDistortion, String> {
    match numbers(text).as_deref() {
        Some(&[k1, k2, p1, p2]) => Ok(RigDistortion { k1, k2, p1, p2 }),
        _ => Err("is not four numbers such as -0.2,0.05,0.001,0".into()),
    }
}

fn numbers(text: &str) -> Option<Vec<f64>> {
    text.split(',').map(|n| n.trim().parse().ok()).collect()
}
