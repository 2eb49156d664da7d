//! `report.html`, the report of a comparison. It needs no network, only the folders `images` and `sheets` next to it.
//!
//! minijinja fills in the template `report.html`, which lies next to this source file, and escapes all text from files.
//! The style sheet `report.css` and the script `report.js` are embedded. Pictures are the measured files in `images`.
//! The browser loads only the pictures of the current view. Plots are SVG.

use super::results::{Metrics, StageTime, ViewHeadline, ViewMethod, used};
use super::viewer::{Figure, groups};
use crate::chart::{Dot, DotPlot, DotRow};
use crate::method::Method;
use crate::metrics::RegionScores;
use minijinja::value::{Serde, Value};
use minijinja::{Environment, UndefinedBehavior, context};
use serde::Serialize;
use std::path::Path;

/// Returns the report as HTML.
pub(super) fn html(
    metrics: &Metrics,
    stages: &[StageTime],
    figures: &[Figure],
    video: Option<&Path>,
) -> Result<String, minijinja::Error> {
    let mut env = Environment::new();
    env.set_undefined_behavior(UndefinedBehavior::Strict);
    env.add_filter("num", num);
    env.add_filter("signed", signed);
    env.add_filter("psnr", psnr);
    env.add_filter("decimals", decimals);
    env.add_template("report.html", include_str!("report.html"))?;
    let video_name = video.and_then(|v| v.file_name()).map(|n| n.to_string_lossy().into_owned());
    env.get_template("report.html")?.render(context! {
        m => Value::from(Serde(metrics)),
        rendered => Value::from(Serde(rendered(metrics))),
        stages => Value::from(Serde(stages)),
        viewer => in_script(&groups(metrics, figures)),
        has_pictures => !figures.is_empty(),
        view_table => Value::from(Serde(view_table(metrics))),
        sync_table => Value::from(Serde(sync_table(metrics))),
        sheets => Value::from(Serde(figures.iter().flat_map(|f| &f.sheets).collect::<Vec<_>>())),
        video => video_name,
        compare_options => serde_json::to_string_pretty(&metrics.options).unwrap_or_default(),
        renderer_options => serde_json::to_string_pretty(&metrics.renderer).unwrap_or_default(),
        offset_plot => Value::from_safe_string(offset_plot(metrics)),
        sync_plot => Value::from_safe_string(sync_plot(metrics)),
        view_plot => Value::from_safe_string(view_plot(metrics)),
        methods => explained(metrics.sync.iter().map(|row| row.method)),
        proxies => explained(metrics.views.iter().map(|row| row.proxy)),
        measured => measured_percent(metrics),
        style => Value::from_safe_string(include_str!("report.css").into()),
        script => Value::from_safe_string(include_str!("report.js").into()),
    })
}

/// Returns a value as JSON text for a `script` element. The text is escaped, so it can't close the element.
fn in_script(value: &impl Serialize) -> Value {
    let text = serde_json::to_string(value).unwrap_or_default();
    Value::from_safe_string(text.replace('<', "\\u003c"))
}

/// Returns the summary of the blended views for one proxy geometry: the one that `stlfr render` uses with the options
/// of the comparison. `None` if no such view was rendered.
fn rendered(metrics: &Metrics) -> Option<&ViewHeadline> {
    let headline = &metrics.headline;
    let proxy = headline.methods.iter().find(|method| method.is_rendered)?.proxy;
    headline.views.iter().find(|views| views.proxy == proxy)
}

/// A table of scores in the report. Each row is a compared image, each column a method.
#[derive(Serialize)]
struct ScoreTable {
    columns: Vec<&'static str>,
    rows: Vec<ScoreRow>,
    /// Sentences that say why images are missing.
    missing: Vec<String>,
}

#[derive(Serialize)]
struct ScoreRow {
    labels: [String; 2],
    scores: Vec<Option<RegionScores>>,
}

/// The scores of an image that one method rendered, for a [`ScoreTable`].
struct ScoredImage<'a> {
    labels: [String; 2],
    method: &'static str,
    scores: Option<RegionScores>,
    reason: Option<&'a str>,
}

impl ScoreTable {
    /// Makes a table. Images with the same labels form one row, and the scores of each image are in the column of its
    /// method.
    fn new<'a>(columns: Vec<&'static str>, images: impl Iterator<Item = ScoredImage<'a>>) -> Self {
        let (mut rows, mut missing): (Vec<ScoreRow>, Vec<String>) = Default::default();
        for ScoredImage { labels, method, scores, reason } in images {
            if let Some(reason) = reason {
                missing.push(format!("{}, {}, {method}: {reason}", labels[0], labels[1]));
            }
            let at = rows.iter().position(|row| row.labels == labels).unwrap_or(rows.len());
            if at == rows.len() {
                rows.push(ScoreRow { labels, scores: vec![None; columns.len()] });
            }
            if let Some(column) = columns.iter().position(|column| *column == method) {
                rows[at].scores[column] = scores;
            }
        }
        Self { columns, rows, missing }
    }
}

fn view_table(metrics: &Metrics) -> ScoreTable {
    let columns = ViewMethod::ALL.iter().map(|method| method.help()).collect();
    let images = metrics.views.iter().map(|row| ScoredImage {
        labels: [row.view.clone(), row.proxy.name().to_owned()],
        method: row.method.help(),
        scores: row.scores,
        reason: row.reason.as_deref(),
    });
    ScoreTable::new(columns, images)
}

fn sync_table(metrics: &Metrics) -> ScoreTable {
    let methods = used(metrics.sync.iter().map(|row| row.method));
    let images = metrics.sync.iter().map(|row| ScoredImage {
        labels: [row.camera.clone(), format!("{:.4} s", row.time_s)],
        method: row.method.name(),
        scores: row.scores,
        reason: row.reason.as_deref(),
    });
    ScoreTable::new(methods.iter().map(|method| method.name()).collect(), images)
}

/// Formats a number with `digits` decimals and a typographic minus sign. A missing or infinite number becomes a dash.
fn num(value: Value, digits: usize) -> String {
    match f64::try_from(value) {
        Ok(v) if v.is_finite() => rounded(v, digits).replace('-', "−"),
        _ => "–".into(),
    }
}

/// Formats a number like [`num`], with an explicit plus sign if it is positive after rounding.
fn signed(value: Value, digits: usize) -> String {
    let plus = f64::try_from(value.clone())
        .is_ok_and(|v| v.is_finite() && v > 0.0 && rounded(v, digits) != rounded(0.0, digits));
    format!("{}{}", if plus { "+" } else { "" }, num(value, digits))
}

/// Returns the number of decimals for a value whose standard error is `std_err` × `factor`. The standard error then has
/// two significant digits. Returns 4 if the standard error is missing or not positive.
fn decimals(std_err: Value, factor: f64) -> usize {
    let error = f64::try_from(std_err).map(|error| factor * error);
    match error {
        Ok(error) if error.is_finite() && error > 0.0 => {
            (1.0 - error.log10().floor()).clamp(0.0, 6.0) as usize
        }
        _ => 4,
    }
}

/// Formats a number with `digits` decimals. A number that is rounded to zero has no minus sign.
fn rounded(v: f64, digits: usize) -> String {
    let text = format!("{v:.digits$}");
    let zero = text.chars().all(|c| matches!(c, '-' | '0' | '.'));
    if zero { text.trim_start_matches('-').to_owned() } else { text }
}

/// Formats the PSNR of [`crate::metrics::Scores`]. Identical images have no finite PSNR, and give the text `identical`.
fn psnr(scores: Value) -> Result<String, minijinja::Error> {
    let (pixels, psnr_db) = (scores.get_attr("pixels")?, scores.get_attr("psnr_db")?);
    let same = psnr_db.is_none() && u64::try_from(pixels).unwrap_or(0) > 0;
    Ok(if same { "identical".into() } else { num(psnr_db, 1) })
}

/// Returns the smallest and the largest percentage of a blended view's pixels on which the view was compared with the
/// ground truth, among all views. `None` if no view was compared.
fn measured_percent(metrics: &Metrics) -> Option<[String; 2]> {
    let fractions = || metrics.views.iter().filter_map(|v| v.measured);
    let (min, max) = (fractions().min_by(f64::total_cmp)?, fractions().max_by(f64::total_cmp)?);
    Some([min, max].map(|fraction| format!("{:.1}", 100.0 * fraction)))
}

/// Returns the names and help texts of the methods that occur, each once. The help texts start in lower case, for use
/// within a sentence.
fn explained<M: Method>(occurring: impl Iterator<Item = M>) -> Vec<Value> {
    let explain = |method: M| {
        let mut letters = method.help().chars();
        let first = letters.next().map(|c| c.to_lowercase().collect::<String>());
        let help = first.unwrap_or_default() + letters.as_str();
        context! { name => method.name(), help }
    };
    used(occurring).into_iter().map(explain).collect()
}

/// Returns the SVG plot of the errors of the estimated offsets, in thousandths of a frame interval, with error bars of
/// ±2 standard errors.
fn offset_plot(metrics: &Metrics) -> String {
    let rows: Vec<DotRow> = metrics
        .offsets
        .iter()
        .filter(|o| !o.shares_clock)
        .map(|o| {
            let dot = o.error_frames.map(|error| Dot {
                value: 1e3 * error,
                bar: o.std_err_frames.map(|s| 2e3 * s),
                series: 1,
                title: format!("{}: {:+.3} thousandths of a frame", o.camera, 1e3 * error),
            });
            DotRow { label: o.camera.clone(), dots: dot.into_iter().collect() }
        })
        .collect();
    let x_label = "error, thousandths of a frame (bar: ±2 standard errors)".into();
    DotPlot { rows, x_label, symmetric: true }.svg()
}

/// Returns the SVG plot of the PSNR of each camera's synchronized images, on the pixels of moving surfaces. Each camera
/// has a row, each synchronization method a colour.
fn sync_plot(metrics: &Metrics) -> String {
    let methods = used(metrics.sync.iter().map(|row| row.method));
    let dots = metrics.sync.iter().map(|row| ScoredDot {
        label: row.camera.clone(),
        title: format!("{}, {}", row.view, row.method.name()),
        series: methods.iter().position(|m| *m == row.method).unwrap_or(0),
        scores: row.scores,
    });
    psnr_plot(dots, "PSNR on the moving part, dB (a dot per instant)")
}

/// Returns the SVG plot of the PSNR of each blended view, on the pixels of moving surfaces. Each view with each proxy
/// geometry has a row, each method a colour.
fn view_plot(metrics: &Metrics) -> String {
    let dots = metrics.views.iter().map(|row| {
        let label = format!("{}, {}", row.view, row.proxy.name());
        ScoredDot {
            title: format!("{label}, {}", row.method.help()),
            label,
            series: ViewMethod::ALL.iter().position(|m| *m == row.method).unwrap_or(0),
            scores: row.scores,
        }
    });
    psnr_plot(dots, "PSNR on the moving part, dB")
}

/// A dot in a PSNR plot: the score of one image.
struct ScoredDot {
    /// Label of the dot's row.
    label: String,
    title: String,
    series: usize,
    scores: Option<RegionScores>,
}

/// Returns an SVG plot of PSNRs on the pixels of moving surfaces. Dots with the same label form a row. Rows are in
/// order of first appearance.
fn psnr_plot(dots: impl Iterator<Item = ScoredDot>, x_label: &str) -> String {
    let mut rows: Vec<DotRow> = Vec::new();
    for ScoredDot { label, title, series, scores } in dots {
        let Some(db) = scores.and_then(|s| s.moving.psnr_db) else { continue };
        let dot = Dot { value: db, bar: None, series, title: format!("{title}: {db:.2} dB") };
        match rows.iter_mut().find(|r| r.label == label) {
            Some(row) => row.dots.push(dot),
            None => rows.push(DotRow { label, dots: vec![dot] }),
        }
    }
    DotPlot { rows, x_label: x_label.into(), symmetric: false }.svg()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_for_readers() {
        assert_eq!(num(Value::from(-1.25), 1), "−1.2");
        assert_eq!(num(Value::from(()), 1), "–");
        assert_eq!(signed(Value::from(2.714), 2), "+2.71");
        assert_eq!(signed(Value::from(-3.0), 0), "−3");
        assert_eq!(
            (signed(Value::from(-0.01), 1), num(Value::from(-0.0), 2)),
            ("0.0".into(), "0.00".into())
        );
        let digits = |error: f64| decimals(Value::from(error), 1e3);
        assert_eq!((digits(4e-4), digits(0.06e-3), digits(2.0), digits(0.0)), (2, 3, 0, 4));
        let scores = |pixels: usize, psnr_db: Option<f64>| context! { pixels, psnr_db };
        assert_eq!(psnr(scores(4, None)).unwrap(), "identical");
        assert_eq!(psnr(scores(0, None)).unwrap(), "–");
        assert_eq!(psnr(scores(4, Some(31.26))).unwrap(), "31.3");
    }

    #[test]
    fn no_text_ends_the_script() {
        let text = in_script(&["</script><b>"]).to_string();
        assert!(!text.contains('<'), "{text}");
        assert_eq!(serde_json::from_str::<[String; 1]>(&text).unwrap()[0], "</script><b>");
    }

    #[test]
    fn images_with_the_same_labels_are_a_row() {
        let image = |view: &str, method, reason: Option<&'static str>| ScoredImage {
            labels: [view.to_owned(), "mesh".into()],
            method,
            scores: Some(RegionScores::default()).filter(|_| reason.is_none()),
            reason,
        };
        let images = [image("a", "x", None), image("b", "y", None), image("a", "y", Some("dark"))];
        let table = ScoreTable::new(vec!["x", "y"], images.into_iter());
        let found: Vec<Vec<bool>> =
            table.rows.iter().map(|r| r.scores.iter().map(Option::is_some).collect()).collect();
        assert_eq!(found, [[true, false], [false, true]]);
        assert_eq!(table.missing, ["a, mesh, y: dark"]);
    }
}
