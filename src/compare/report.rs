//! `report.html`: one file that depends on no other file and on no network.
//!
//! The page is the template `report.html` beside this file, filled in by minijinja, which escapes
//! all text from files. Pictures are inlined as 8-bit PNG, and plots as SVG.

use super::results::{Metrics, StageTime, ViewMethod, used};
use crate::chart::{Dot, DotPlot, DotRow};
use crate::method::Method;
use crate::metrics::RegionScores;
use crate::raster::{Image, encode_png_8};
use base64::Engine;
use base64::engine::general_purpose::STANDARD as BASE64;
use image::codecs::png::CompressionType;
use minijinja::value::{Serde, Value};
use minijinja::{Environment, UndefinedBehavior, context};
use serde::Serialize;
use std::path::Path;

/// The pictures of one view at one instant, which the reader compares by a slider.
#[derive(Clone, Debug, Serialize)]
pub(super) struct Figure {
    /// The view and the instant.
    pub title: String,
    /// Whether it is a new view rather than a filming camera's image.
    pub is_view: bool,
    /// The truth first, then the methods.
    pub pictures: Vec<ReportPicture>,
}

/// A picture, inlined in the page.
#[derive(Clone, Debug, Serialize)]
pub(super) struct ReportPicture {
    label: String,
    width: usize,
    height: usize,
    png_base64: String,
    scores: Option<RegionScores>,
}

impl ReportPicture {
    pub fn new(label: &str, image: &Image, scores: Option<RegionScores>) -> Self {
        let png = encode_png_8(image, CompressionType::Best);
        Self {
            label: label.to_owned(),
            width: image.width(),
            height: image.height(),
            png_base64: BASE64.encode(png.expect("a buffer takes any image of 1 or 3 channels")),
            scores,
        }
    }
}

/// The whole page.
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
    env.add_template("report.html", include_str!("report.html"))?;
    let video_name = video.and_then(|v| v.file_name()).map(|n| n.to_string_lossy().into_owned());
    env.get_template("report.html")?.render(context! {
        m => Value::from(Serde(metrics)),
        stages => Value::from(Serde(stages)),
        figures => Value::from(Serde(figures)),
        video => video_name,
        compare_options => serde_json::to_string_pretty(&metrics.options).unwrap_or_default(),
        renderer_options => serde_json::to_string_pretty(&metrics.renderer).unwrap_or_default(),
        offset_plot => Value::from_safe_string(offset_plot(metrics)),
        sync_plot => Value::from_safe_string(sync_plot(metrics)),
        view_plot => Value::from_safe_string(view_plot(metrics)),
        methods => explained(metrics.sync.iter().map(|row| row.method)),
        proxies => explained(metrics.views.iter().map(|row| row.proxy)),
        measured => measured_percent(metrics),
    })
}

/// A number with `digits` decimals and a typographic minus; a dash if it is missing or infinite.
fn num(value: Value, digits: usize) -> String {
    match f64::try_from(value) {
        Ok(v) if v.is_finite() => rounded(v, digits).replace('-', "−"),
        _ => "–".into(),
    }
}

/// [`num`] with a sign, unless it is 0.
fn signed(value: Value, digits: usize) -> String {
    let plus = f64::try_from(value.clone())
        .is_ok_and(|v| v.is_finite() && v > 0.0 && rounded(v, digits) != rounded(0.0, digits));
    format!("{}{}", if plus { "+" } else { "" }, num(value, digits))
}

/// Rounded, without a minus before 0.
fn rounded(v: f64, digits: usize) -> String {
    let text = format!("{v:.digits$}");
    let zero = text.chars().all(|c| matches!(c, '-' | '0' | '.'));
    if zero { text.trim_start_matches('-').to_owned() } else { text }
}

/// Formats the PSNR of [`crate::metrics::Scores`]; identical pixels give a word.
fn psnr(scores: Value) -> Result<String, minijinja::Error> {
    let (pixels, psnr_db) = (scores.get_attr("pixels")?, scores.get_attr("psnr_db")?);
    let same = psnr_db.is_none() && u64::try_from(pixels).unwrap_or(0) > 0;
    Ok(if same { "identical".into() } else { num(psnr_db, 1) })
}

/// The smallest and the largest measured fraction of a view, in percent.
fn measured_percent(metrics: &Metrics) -> Option<[String; 2]> {
    let fractions = || metrics.views.iter().filter_map(|v| v.measured);
    let (min, max) = (fractions().min_by(f64::total_cmp)?, fractions().max_by(f64::total_cmp)?);
    Some([min, max].map(|fraction| format!("{:.1}", 100.0 * fraction)))
}

/// Names and help texts of the methods that occur. The help texts start in lower case, for the middle of a sentence.
fn explained<M: Method>(occurring: impl Iterator<Item = M>) -> Vec<Value> {
    let explain = |method: M| {
        let mut letters = method.help().chars();
        let first = letters.next().map(|c| c.to_lowercase().collect::<String>());
        let help = first.unwrap_or_default() + letters.as_str();
        context! { name => method.name(), help }
    };
    used(occurring).into_iter().map(explain).collect()
}

/// Offset errors in thousandths of a frame, with two standard errors to either side.
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

/// PSNR of the moving part of each camera's image, one row a camera, one colour a method.
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

/// PSNR of the moving part of each view, one row a view and proxy, one colour a method.
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

/// An image's dot in a plot of PSNR.
struct ScoredDot {
    /// The label of its row.
    label: String,
    title: String,
    series: usize,
    scores: Option<RegionScores>,
}

/// PSNR of the moving part, in rows by label, in order of first appearance.
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
        let scores = |pixels: usize, psnr_db: Option<f64>| context! { pixels, psnr_db };
        assert_eq!(psnr(scores(4, None)).unwrap(), "identical");
        assert_eq!(psnr(scores(0, None)).unwrap(), "–");
        assert_eq!(psnr(scores(4, Some(31.26))).unwrap(), "31.3");
    }

    #[test]
    fn pictures_decode_to_their_pixels() {
        let image = Image::from_data(2, 1, 3, vec![0.0, 0.2, 0.4, 0.6, 0.8, 1.0]);
        let png = BASE64.decode(ReportPicture::new("a", &image, None).png_base64).unwrap();
        let decoded = image::load_from_memory(&png).unwrap().into_rgb8();
        assert_eq!(decoded.into_raw(), [0, 51, 102, 153, 204, 255]);
    }
}
