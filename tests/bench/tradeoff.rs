//! Presets and `auto` beside other combinations: on each scene what they cost and give, whether
//! another combination beats a preset, and whether `auto` is within 0.2 dB of the best methods at no
//! more than their time. Planning is not in that time; it stands apart.
//!
//! Other combinations are all methods, and the cheap presets with any one parameter changed;
//! `--rounds=1` adds each scene's front with any one parameter changed. A preset is fixed before its
//! scene is known, so it is held against what beats it over all scenes (medians); what beats it on one
//! scene alone is that scene's own front, and printed. These films have no noise: without the frames before and
//! after (`outer 0`), `best` would be faster here, and lose 0.3 to 0.7 dB in noise of 2 %.
//!
//! `cargo bench --bench tradeoff -- [--runs=3] [--rounds=0] [--clock=cpu] CAPTURE…`; what is measured
//! is kept in `target/tradeoff/`, so that a run that was stopped goes on.

use std::error::Error;
use std::path::Path;
use std::sync::Arc;
use stlfr::capture::Capture;
use stlfr::interpolation::SyncMethod;
use stlfr::method::Method;
use stlfr::metrics::median;
use stlfr::options::{AutoOptions, Preset, ProxyMethod, RenderOptions};
use stlfr::progress::Reporter;
use stlfr::tradeoff::{
    AUTO, Point, SLACK_DB, TimingClock, Tradeoff, TradeoffOptions, Variable, methods, tradeoff,
    variations,
};

/// What beats a preset is this much better on the moving part, decibels, or takes at most this share
/// of its time: less is noise.
const BETTER_DB: f64 = 0.1;
const FASTER: f64 = 0.9;
/// All pixels, most of which stand still, may be this much worse.
const WHOLE_DB: f64 = 0.05;
/// `auto` may take this much longer than the best methods: the same options, timed twice, differ by
/// as much.
const AS_FAST: f64 = 1.05;

/// A point as it is judged: by seconds and the moving part, as the tool draws its front.
struct Row<'a> {
    point: &'a Point,
    seconds: f64,
    db: f64,
}

fn row<'a>(found: &Tradeoff, point: &'a Point) -> Option<Row<'a>> {
    let spread = match found.clock {
        TimingClock::Wall => point.wall_s?,
        TimingClock::Cpu => point.cpu_s?,
    };
    Some(Row { point, seconds: spread.median, db: point.quality_db? })
}

fn labelled<'a>(found: &'a Tradeoff, label: &str) -> Option<Row<'a>> {
    found.labelled(label).and_then(|p| row(found, p))
}

/// A combination beside another: its share of the other's time, and what it is better by.
#[derive(Clone, Copy)]
struct Beside {
    time: f64,
    db: f64,
    whole_db: f64,
}

impl Beside {
    fn of(row: &Row, other: &Row) -> Self {
        let whole = |row: &Row| row.point.whole.psnr_db.unwrap_or(f64::NAN);
        Self {
            time: row.seconds / other.seconds,
            db: row.db - other.db,
            whole_db: whole(row) - whole(other),
        }
    }

    fn median(all: &[Self]) -> Self {
        let of = |value: fn(&Self) -> f64| median(all.iter().map(value).collect());
        let [time, db, whole_db] =
            [of(|b| b.time), of(|b| b.db), of(|b| b.whole_db)].map(|m| m.unwrap_or(f64::NAN));
        Self { time, db, whole_db }
    }

    fn beats(&self) -> bool {
        let no_worse = self.time <= 1.0 && self.db >= 0.0 && self.whole_db >= -WHOLE_DB;
        no_worse && (self.db >= BETTER_DB || self.time <= FASTER)
    }
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
fn judge(scene: &str, found: &Tradeoff, base: &RenderOptions) -> Option<String> {
    let all: Vec<Row> = found.points.iter().filter_map(|p| row(found, p)).collect();
    for preset in Preset::ALL {
        let Some(own) = labelled(found, preset.name()) else {
            return Some(format!("{scene}: {} can't be rendered", preset.name()));
        };
        print(scene, preset.name(), &own);
        let beating = all.iter().filter(|other| Beside::of(other, &own).beats());
        if let Some(most) = beating.clone().max_by(|a, b| a.db.total_cmp(&b.db)) {
            print(scene, "  beaten", most);
            println!("{scene:<12}   by that and {} more", beating.count() - 1);
        }
    }
    let methods = methods(base);
    let of_methods = all.iter().filter(|row| methods.contains(&row.point.options));
    let best = of_methods.max_by(|a, b| a.db.total_cmp(&b.db));
    let (Some(best), Some(auto)) = (best, labelled(found, AUTO)) else {
        return Some(format!("{scene}: auto, or every method, can't be rendered"));
    };
    print(scene, AUTO, &auto);
    print(scene, "best method", best);
    println!("{scene:<12} planning {:>8.1} s", found.planning_s);
    let Beside { time, db, .. } = Beside::of(&auto, best);
    let holds = db >= -SLACK_DB && time <= AS_FAST;
    let sentence =
        format!("{scene}: auto is {db:+.2} dB beside the best methods, at {time:.2} of their time");
    println!("{sentence}");
    (!holds).then_some(sentence)
}

/// Every combination that was measured on all scenes beside a preset, over the scenes.
fn over_scenes(scenes: &[Tradeoff], preset: Preset) -> Vec<(String, Beside)> {
    let Some(first) = scenes.first() else { return Vec::new() };
    let beside = |point: &Point| {
        let on = |found: &Tradeoff| {
            let own = labelled(found, preset.name())?;
            let same = found.points.iter().find(|p| p.options == point.options)?;
            Some(Beside::of(&row(found, same)?, &own))
        };
        let all: Vec<Beside> = scenes.iter().map(on).collect::<Option<_>>()?;
        Some((point.name.clone(), Beside::median(&all)))
    };
    first.points.iter().filter_map(beside).collect()
}

/// Prints the presets over all scenes; what beats them.
fn judge_all(scenes: &[Tradeoff]) -> Vec<String> {
    let mut wrong = Vec::new();
    for preset in Preset::ALL {
        let beside_best = |found: &Tradeoff| {
            let (own, best) = (labelled(found, preset.name())?, labelled(found, "best")?);
            Some(Beside::of(&own, &best))
        };
        let all: Vec<Beside> = scenes.iter().filter_map(beside_best).collect();
        let Beside { time, db, .. } = Beside::median(&all);
        let label = preset.name();
        let seconds = scenes.iter().filter_map(|found| Some(labelled(found, label)?.seconds));
        println!(
            "{label}: {:.2} s a view, {time:.3} of best's time, {db:+.2} dB beside best (medians of {} \
             scenes)",
            median(seconds.collect()).unwrap_or(f64::NAN),
            all.len()
        );
        for (name, Beside { time, db, whole_db }) in
            over_scenes(scenes, *preset).iter().filter(|(_, beside)| beside.beats())
        {
            wrong.push(format!(
                "{label} is beaten by {name}: {time:.2} of its time, {db:+.2} dB, {whole_db:+.2} dB of \
                 all pixels (medians)"
            ));
        }
    }
    wrong
}

/// The presets with any one parameter changed; `best` as it comes out where refinement and depth pay.
fn around_presets() -> Vec<RenderOptions> {
    let variable = Variable { offsets: true, cameras: 4 };
    let mut dear = Preset::Best.options();
    (dear.sync, dear.proxy.method) = (SyncMethod::Refined, ProxyMethod::Depth);
    dear.auto = AutoOptions::default();
    let mut found = vec![dear.clone()];
    for options in [Preset::Draft.options(), Preset::Balanced.options(), dear] {
        found.extend(variations(&options, variable));
    }
    found
}

fn main() -> Result<(), Box<dyn Error>> {
    // As the program does.
    stlfr::host::reuse_freed_memory();
    let mut options = TradeoffOptions {
        rounds: 0,
        clock: TimingClock::Cpu,
        also: around_presets(),
        ..TradeoffOptions::default()
    };
    let mut folders = Vec::new();
    for argument in std::env::args().skip(1).filter(|a| a != "--bench") {
        match argument.split_once('=') {
            Some(("--runs", n)) => options.runs = n.parse()?,
            Some(("--rounds", n)) => options.rounds = n.parse()?,
            Some(("--clock", name)) => {
                options.clock = TimingClock::from_name(name).ok_or("--clock: wall or cpu")?
            }
            _ => folders.push(argument),
        }
    }
    println!("scene        which       a view   moving     whole    FLIP     ready");
    let (mut wrong, mut scenes) = (Vec::new(), Vec::new());
    for folder in &folders {
        let folder = Path::new(folder);
        let scene = folder.file_name().unwrap_or_default().to_string_lossy().into_owned();
        let capture = Arc::new(Capture::open(folder)?);
        let out = Path::new(env!("CARGO_MANIFEST_DIR")).join("target/tradeoff").join(&scene);
        let found = tradeoff(&capture, &options, &out, &Reporter::new(false))?;
        wrong.extend(judge(&scene, &found, &options.base));
        scenes.push(found);
    }
    wrong.extend(judge_all(&scenes));
    if wrong.is_empty() {
        println!("no preset is beaten, and auto holds, on {} scenes", folders.len());
        return Ok(());
    }
    Err(wrong.join("\n").into())
}
