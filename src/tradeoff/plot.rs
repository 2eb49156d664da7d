//! The chart of quality against time.

use super::{Against, Point, Spread, TimingClock, Tradeoff};
use crate::chart::{self, Chart, ChartPoint, Label, Series};

/// Returns the label of the chart's y axis, which names the reference images and the unit of quality.
fn quality(tradeoff: &Tradeoff) -> &'static str {
    let moving = tradeoff.points.iter().any(|p| p.moving.psnr_db.is_some());
    match (tradeoff.against, moving) {
        (Against::Truth, true) => "moving part against the truth, PSNR in dB",
        (Against::Truth, false) => "against the truth, PSNR in dB",
        (Against::HeldOut, true) => "changing part of held-out cameras, PSNR in dB",
        (Against::HeldOut, false) => "held-out cameras, PSNR in dB",
        (Against::MostAccurate, _) => "against the most accurate methods, PSNR in dB",
    }
}

fn time(tradeoff: &Tradeoff, point: &Point) -> Option<Spread> {
    match tradeoff.clock {
        TimingClock::Wall => point.wall_s,
        TimingClock::Cpu => point.cpu_s,
    }
}

/// Returns the chart as SVG. It shows all points, the Pareto front with numbers, the presets and `auto` with their
/// names, and a legend of the numbers.
pub(super) fn svg(tradeoff: &Tradeoff) -> String {
    let place = |point: &Point| {
        let (time, y) = (time(tradeoff, point)?, point.quality_db?);
        Some(ChartPoint { x: time.median, y, bar: 0.0, x_range: Some((time.min, time.max)) })
    };
    let label = |point: &Point, text: String, bold: bool| {
        let ChartPoint { x, y, .. } = place(point)?;
        Some(Label { x, y, text, bold })
    };
    let front: Vec<&Point> = tradeoff.pareto_front().collect();
    let series = |label: &str, has: fn(&Point) -> bool, line, faint| {
        let points = tradeoff.points.iter().filter(|p| has(p)).filter_map(place).collect();
        Series { label: label.into(), points, line, dots: true, faint }
    };
    let is_named = |p: &Point| !p.labels.is_empty();
    let series = vec![
        series("other combinations", |p| !p.on_front && p.labels.is_empty(), false, true),
        series("Pareto front", |p| p.on_front, true, false),
        // Drawn last, so that it covers the other series.
        series("presets and auto", is_named, false, false),
    ];
    let named = tradeoff.points.iter().filter(|p| is_named(p));
    let mut labels: Vec<Label> =
        named.filter_map(|p| label(p, p.labels.join(", "), true)).collect();
    let numbers = front.iter().enumerate();
    labels.extend(numbers.filter_map(|(k, p)| label(p, (k + 1).to_string(), false)));
    let (w, h) = tradeoff.size_px;
    let seconds = match tradeoff.clock {
        TimingClock::Wall => "seconds",
        TimingClock::Cpu => "processor seconds",
    };
    let chart = Chart {
        title: format!("{}: {} cameras, a view of {w}×{h}", tradeoff.capture, tradeoff.cameras),
        x_label: format!(
            "{seconds} for a view at a new instant, {} threads; bars are least and most",
            tradeoff.threads
        ),
        y_label: quality(tradeoff).into(),
        log_x: true,
        series,
        labels,
        key: key(tradeoff, &front),
        ..Chart::default()
    };
    chart::svg(&[chart], 1)
}

/// Returns the lines of the chart's legend: the numbered combinations on the Pareto front, then the presets and `auto`,
/// then the recommended combination. `front` has the combinations on the Pareto front, fastest first.
fn key(tradeoff: &Tradeoff, front: &[&Point]) -> Vec<String> {
    let line = |mark: &str, point: &Point| {
        let seconds = time(tradeoff, point).map_or(f64::NAN, |s| s.median);
        let quality = point.quality_db.unwrap_or(f64::NAN);
        format!("{mark:>8} {seconds:>7.3} s {quality:>6.2} dB  {}", point.name)
    };
    let mut lines: Vec<String> =
        front.iter().enumerate().map(|(k, p)| line(&(k + 1).to_string(), p)).collect();
    lines.push(String::new());
    let named = tradeoff.points.iter().filter(|p| !p.labels.is_empty());
    lines.extend(named.flat_map(|p| p.labels.iter().map(move |l| line(l, p))));
    if let Some(point) = tradeoff.points.get(tradeoff.recommended) {
        lines.push(String::new());
        lines.push("recommended, the fastest within 0.2 dB of the best:".into());
        lines.push(line("", point));
    }
    lines
}
