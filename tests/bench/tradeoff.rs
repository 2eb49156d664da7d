//! Presets and `auto` beside every other combination: on each scene what they cost and give, whether
//! another combination beats a preset, and whether `auto` is within 0.2 dB of the best rungs at no
//! more than their time. Planning is not in that time; it stands apart.
//!
//! `cargo bench --bench tradeoff -- [--runs=3] [--rounds=0] [--clock=cpu] CAPTURE…`; what is measured
//! is kept in `target/tradeoff/`, so that a run that was stopped goes on.

use clap::ValueEnum;
use std::error::Error;
use std::path::Path;
use std::sync::Arc;
use stlfr::capture::Capture;
use stlfr::compare::metrics::median;
use stlfr::progress::Reporter;
use stlfr::render::{Preset, RenderOptions};
use stlfr::tradeoff::{AUTO, Clock, Point, SLACK_DB, Tradeoff, TradeoffOptions, rungs, tradeoff};

/// A preset is beaten by what takes no longer and is no worse in any measure (PSNR and FLIP of the
/// moving part and of all pixels), and is this much better on the moving part, decibels, or takes
/// at most this share of its time: less is noise.
const BETTER_DB: f64 = 0.1;
const FASTER: f64 = 0.9;
/// `auto` may take this much longer than the best rungs: the same options, timed twice, differ by
/// as much.
const AS_FAST: f64 = 1.05;

struct Row<'a> {
    point: &'a Point,
    seconds: f64,
    db: f64,
}

fn row<'a>(found: &Tradeoff, point: &'a Point) -> Option<Row<'a>> {
    let spread = match found.clock {
        Clock::Wall => point.wall_s?,
        Clock::Cpu => point.cpu_s?,
    };
    Some(Row { point, seconds: spread.median, db: point.quality_db? })
}

fn beats(other: &Row, preset: &Row) -> bool {
    let measures = |p: &Point| {
        let flip = [p.moving.flip, p.whole.flip].map(|f| f.map(|f| -f));
        [p.moving.psnr_db, p.whole.psnr_db, flip[0], flip[1]]
    };
    let no_worse = measures(other.point).iter().zip(measures(preset.point)).all(|(a, b)| *a >= b);
    let better = other.db >= preset.db + BETTER_DB && other.seconds <= preset.seconds;
    no_worse && (better || other.seconds <= FASTER * preset.seconds)
}

fn print(scene: &str, label: &str, row: &Row) {
    let preparation = row.point.preparation.map_or(f64::NAN, |p| p.sum_s());
    println!(
        "{scene:<12} {label:<9} {:>8.3} s {:>7.2} dB {:>7.2} dB {:>7.4}  {preparation:>7.1} s  {}",
        row.seconds,
        row.db,
        row.point.whole.psnr_db.unwrap_or(f64::NAN),
        row.point.moving.flip.unwrap_or(f64::NAN),
        row.point.name
    );
}

/// Prints a scene's rows; what doesn't hold.
fn judge(scene: &str, found: &Tradeoff, base: &RenderOptions) -> Vec<String> {
    let all: Vec<Row> = found.points.iter().filter_map(|p| row(found, p)).collect();
    let mut wrong = Vec::new();
    for preset in Preset::value_variants() {
        let name = preset.name();
        let Some(own) = found.labelled(name).and_then(|p| row(found, p)) else {
            wrong.push(format!("{scene}: {name} can't be rendered"));
            continue;
        };
        print(scene, name, &own);
        for other in all.iter().filter(|other| beats(other, &own)) {
            wrong.push(format!(
                "{scene}: {name} ({:.3} s, {:.2} dB) is beaten by {} ({:.3} s, {:.2} dB)",
                own.seconds, own.db, other.point.name, other.seconds, other.db
            ));
        }
    }
    let rungs = rungs(base);
    let of_rungs = all.iter().filter(|row| rungs.contains(&row.point.options));
    let best = of_rungs.max_by(|a, b| a.db.total_cmp(&b.db));
    let auto = found.labelled(AUTO).and_then(|p| row(found, p));
    let (Some(best), Some(auto)) = (best, auto) else {
        wrong.push(format!("{scene}: auto, or every rung, can't be rendered"));
        return wrong;
    };
    print(scene, AUTO, &auto);
    print(scene, "best rung", best);
    let holds = auto.db >= best.db - SLACK_DB && auto.seconds <= AS_FAST * best.seconds;
    if !holds {
        wrong.push(format!(
            "{scene}: auto is {:.2} dB below the best rungs at {:.2} times their time",
            best.db - auto.db,
            auto.seconds / best.seconds
        ));
    }
    println!("{scene:<12} planning {:>8.1} s", found.planning_s);
    wrong
}

fn main() -> Result<(), Box<dyn Error>> {
    let mut options =
        TradeoffOptions { runs: 3, rounds: 0, clock: Clock::Cpu, ..TradeoffOptions::default() };
    let mut folders = Vec::new();
    for argument in std::env::args().skip(1).filter(|a| a != "--bench") {
        match argument.split_once('=') {
            Some(("--runs", n)) => options.runs = n.parse()?,
            Some(("--rounds", n)) => options.rounds = n.parse()?,
            Some(("--clock", name)) => options.clock = Clock::from_str(name, false)?,
            _ => folders.push(argument),
        }
    }
    println!("scene        which       a view   moving     whole    FLIP     ready");
    let mut wrong = Vec::new();
    let mut relative: Vec<(&str, Vec<(f64, f64)>)> =
        Preset::value_variants().iter().map(|p| (p.name(), Vec::new())).collect();
    for folder in &folders {
        let folder = Path::new(folder);
        let scene = folder.file_name().unwrap_or_default().to_string_lossy().into_owned();
        let capture = Arc::new(Capture::open(folder)?);
        let out = Path::new(env!("CARGO_MANIFEST_DIR")).join("target/tradeoff").join(&scene);
        let found = tradeoff(&capture, &options, &out, &Reporter::new(false))?;
        wrong.extend(judge(&scene, &found, &options.base));
        let best = found.labelled(Preset::Best.name()).and_then(|p| row(&found, p));
        for (name, values) in &mut relative {
            let own = found.labelled(name).and_then(|p| row(&found, p));
            let pair = own.zip(best.as_ref());
            values.extend(pair.map(|(own, best)| (own.seconds / best.seconds, own.db - best.db)));
        }
    }
    for (name, values) in relative {
        let (time, db) = values.iter().copied().unzip();
        println!(
            "{name}: {:.3} of best's time, {:+.2} dB (medians of {} scenes)",
            median(time).unwrap_or(f64::NAN),
            median(db).unwrap_or(f64::NAN),
            values.len()
        );
    }
    if wrong.is_empty() {
        println!("no preset is beaten, and auto holds, on {} scenes", folders.len());
        return Ok(());
    }
    Err(wrong.join("\n").into())
}
