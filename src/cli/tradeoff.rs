//! The command `stlfr tradeoff`, which measures time and quality of combinations of methods.

use super::CliError;
use super::files::{CommandOutput, OptionsArgs, open_capture};
use super::print::Page;
use super::values::method;
use crate::options::RenderOptions;
use crate::progress::Reporter;
use crate::tradeoff::{FILES, Point, TimingClock, Tradeoff, TradeoffOptions, methods, tradeoff};
use std::path::PathBuf;

/// Measure time and quality of every sensible combination of methods and main parameters on this capture.
///
/// Quality is measured against the ground truth, or without ground truth against held-out cameras. The output is
/// tradeoff.json, a plot (tradeoff.svg), and recommended.json, the options of the fastest combination within 0.2 dB of
/// the best. If the command is interrupted, the same command resumes it.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  \
    stlfr tradeoff .captures/demo -o tradeoff\n  \
    stlfr tradeoff .captures/demo -o tradeoff --rounds 2 --runs 5\n  \
    stlfr render .captures/demo --options tradeoff/recommended.json --like cam3 --time 0.1 -o cam3.png")]
pub struct TradeoffArgs {
    /// The capture's folder.
    capture: PathBuf,
    /// Folder for the results: a new folder, or the folder of an interrupted run.
    #[arg(short, long, value_name = "DIR")]
    output: PathBuf,
    /// Number of times that each view is timed.
    #[arg(long, value_name = "N", default_value_t = 3, value_parser = parsed(1, 1000))]
    runs: usize,
    /// Number of rounds that vary the Pareto front's combinations, one parameter at a time; 0 measures only the
    /// methods.
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = parsed(0, 10))]
    rounds: usize,
    /// The kind of time from which the Pareto front is computed.
    #[arg(long, value_name = "CLOCK", value_parser = method::<TimingClock>(), default_value = "wall")]
    clock: TimingClock,
    /// Print JSON and nothing else.
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    options: OptionsArgs,
}

/// Returns a parser for counts from `min` to `max`.
fn parsed(min: usize, max: usize) -> impl Fn(&str) -> Result<usize, String> + Clone {
    move |text| match text.parse() {
        Ok(count) if (min..=max).contains(&count) => Ok(count),
        _ => Err(format!("must be from {min} to {max}")),
    }
}

pub fn run(args: &TradeoffArgs, page: &mut Page, reporter: &Reporter) -> Result<(), CliError> {
    // Every combination fixes the methods, so that no method is chosen automatically.
    let are_default = args.options.are_default();
    let base = if are_default { RenderOptions::default() } else { args.options.read()? };
    let output = CommandOutput::Folder(&args.output, &FILES);
    let capture = open_capture(&args.capture, Some(output), reporter)?;
    let options = TradeoffOptions {
        runs: args.runs,
        rounds: args.rounds,
        base,
        clock: args.clock,
        ..TradeoffOptions::default()
    };
    let found = tradeoff(&capture, &options, &args.output, reporter)?;
    if args.json {
        return page.json(&found);
    }
    print_table(&found, &options, page);
    page.line(format_args!("plot: {}", args.output.join("tradeoff.svg").display()));
    Ok(())
}

/// Prints a table of the measured combinations: all combinations of methods, the Pareto front, the presets and the
/// automatic choice.
fn print_table(found: &Tradeoff, options: &TradeoffOptions, page: &mut Page) {
    page.line(format_args!(
        "{:<2}{:>24} {:>7} {:>8} {:>14} {:>14}  combination",
        "", "view, s (least to most)", "CPU, s", "ready, s", "moving dB FLIP", "whole dB FLIP"
    ));
    let methods = methods(&options.base);
    let shown = |p: &&Point| p.on_front || !p.labels.is_empty() || methods.contains(&p.options);
    for point in found.points.iter().filter(shown) {
        page.line(line(point));
    }
    let hidden = found.points.iter().filter(|p| !shown(p)).count();
    page.line(format_args!(
        "* the front; {hidden} more combinations are in tradeoff.json. Ready: offsets and \
         registration. Planning took {:.1} s.",
        found.planning_s
    ));
    page.line(format_args!("recommended: {}", found.points[found.recommended].name));
}

fn line(point: &Point) -> String {
    let number = |v: Option<f64>, width: usize, decimals: usize| {
        v.map_or(format!("{:>width$}", "-"), |v| format!("{v:>width$.decimals$}"))
    };
    let time = point
        .wall_s
        .map_or("-".to_owned(), |s| format!("{:.3} ({:.3} to {:.3})", s.median, s.min, s.max));
    let labels = match point.labels.as_slice() {
        [] => String::new(),
        labels => format!(" [{}]", labels.join(", ")),
    };
    let reason = point.reason.as_ref().map_or(String::new(), |r| format!(": {r}"));
    format!(
        "{:<2}{time:>24} {} {} {} {} {} {}  {}{labels}{reason}",
        if point.on_front { "*" } else { "" },
        number(point.cpu_s.map(|s| s.median), 7, 3),
        number(point.preparation.map(|p| p.sum_s()), 8, 1),
        number(point.moving.psnr_db, 8, 2),
        number(point.moving.flip, 5, 3),
        number(point.whole.psnr_db, 8, 2),
        number(point.whole.flip, 5, 3),
        point.name,
    )
}
