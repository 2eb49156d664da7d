//! Dot plots as inline SVG, by hand: rows of labelled points on one axis is all that the report
//! needs, and colours must follow the page's light or dark scheme, which plotting crates bake in.

use minijinja::HtmlEscape;
use std::fmt::Write;

/// One row: a label and its points.
pub(super) struct Row {
    pub label: String,
    pub points: Vec<Point>,
}

/// A point; its colour is the page's class `s0` to `s5`.
pub(super) struct Point {
    pub value: f64,
    /// Half the length of its error bar.
    pub bar: Option<f64>,
    pub series: usize,
    /// What hovering says.
    pub title: String,
}

const WIDTH: f64 = 720.0;
const LABEL_WIDTH: f64 = 150.0;
const ROW_HEIGHT: f64 = 24.0;
const TOP: f64 = 8.0;

/// Rows of points on a common axis; `from_zero_both_ways` makes the axis symmetric with a line at
/// zero. Points that aren't finite are left out; nothing to draw is an empty string.
pub(super) fn dot_plot(rows: &[Row], axis: &str, from_zero_both_ways: bool) -> String {
    let finite = |p: &&Point| p.value.is_finite() && p.bar.is_none_or(f64::is_finite);
    let points = || rows.iter().flat_map(|r| &r.points).filter(finite);
    let reach = |p: &Point| (p.value - p.bar.unwrap_or(0.0), p.value + p.bar.unwrap_or(0.0));
    let low = points().map(|p| reach(p).0).fold(f64::INFINITY, f64::min);
    let high = points().map(|p| reach(p).1).fold(f64::NEG_INFINITY, f64::max);
    if low > high {
        return String::new();
    }
    let (low, high) = if from_zero_both_ways {
        let most = low.abs().max(high.abs()).max(1e-9) * 1.05;
        (-most, most)
    } else {
        let margin = (0.06 * (high - low)).max(1e-3 * high.abs()).max(1e-9);
        (low - margin, high + margin)
    };
    let bottom = TOP + ROW_HEIGHT * rows.len() as f64;
    let x = |v: f64| LABEL_WIDTH + (v - low) / (high - low) * (WIDTH - LABEL_WIDTH - 16.0);

    let mut svg = format!(
        "<svg class=\"plot\" viewBox=\"0 0 {WIDTH} {}\" role=\"img\" aria-label=\"{}\">",
        bottom + 44.0,
        HtmlEscape(axis)
    );
    let mut draw = |text: std::fmt::Arguments| svg.write_fmt(text).unwrap_or_default();
    for tick in ticks(low, high) {
        let at = x(tick);
        let class = if from_zero_both_ways && tick == 0.0 { "zero" } else { "grid" };
        draw(format_args!(
            "<line class=\"{class}\" x1=\"{at:.1}\" x2=\"{at:.1}\" y1=\"{TOP}\" y2=\"{bottom}\"/>\
             <text x=\"{at:.1}\" y=\"{}\" text-anchor=\"middle\">{}</text>",
            bottom + 16.0,
            plain(tick)
        ));
    }
    let middle = (LABEL_WIDTH + WIDTH - 16.0) / 2.0;
    draw(format_args!(
        "<text x=\"{middle}\" y=\"{}\" text-anchor=\"middle\">{}</text>",
        bottom + 36.0,
        HtmlEscape(axis)
    ));
    for (k, row) in rows.iter().enumerate() {
        let y = TOP + ROW_HEIGHT * (k as f64 + 0.5);
        draw(format_args!(
            "<text class=\"label\" x=\"{}\" y=\"{:.1}\" text-anchor=\"end\">{}</text>",
            LABEL_WIDTH - 12.0,
            y + 4.0,
            HtmlEscape(row.label.as_str())
        ));
        for point in row.points.iter().filter(finite) {
            let class = format!("s{}", point.series % 6);
            if let Some(bar) = point.bar {
                draw(format_args!(
                    "<line class=\"bar {class}\" x1=\"{:.1}\" x2=\"{:.1}\" y1=\"{y}\" y2=\"{y}\"/>",
                    x(point.value - bar),
                    x(point.value + bar)
                ));
            }
            draw(format_args!(
                "<circle class=\"{class}\" cx=\"{:.1}\" cy=\"{y}\" r=\"4.5\"><title>{}</title></circle>",
                x(point.value),
                HtmlEscape(point.title.as_str())
            ));
        }
    }
    svg.push_str("</svg>");
    svg
}

/// Round values within a range, about six of them.
fn ticks(low: f64, high: f64) -> Vec<f64> {
    let raw = (high - low) / 6.0;
    let power = 10f64.powf(raw.log10().floor());
    let step =
        [1.0, 2.0, 5.0, 10.0].into_iter().find(|m| m * power >= 0.8 * raw).unwrap_or(10.0) * power;
    let (first, last) = ((low / step).ceil() as i64, (high / step).floor() as i64);
    (first..=last).take(20).map(|k| k as f64 * step).collect()
}

/// A tick without the digits that come from rounding.
fn plain(tick: f64) -> String {
    let text = format!("{tick:.6}");
    let text = text.trim_end_matches('0').trim_end_matches('.');
    if text == "-0" { "0".into() } else { text.replace('-', "−") }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn point(value: f64) -> Point {
        Point { value, bar: Some(1.0), series: 1, title: "<b>".into() }
    }

    #[test]
    fn ticks_are_round_and_inside() {
        assert_eq!(ticks(0.0, 6.0), [0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0]);
        assert_eq!(ticks(-0.0031, 0.0031).len(), 7);
        assert_eq!((plain(-0.002), plain(30.0)), ("−0.002".into(), "30".into()));
    }

    #[test]
    fn labels_are_escaped_and_odd_values_left_out() {
        let rows = [Row { label: "<script>".into(), points: vec![point(2.0), point(f64::NAN)] }];
        let svg = dot_plot(&rows, "error & more", false);
        assert!(!svg.contains("<script>") && !svg.contains("<b>") && !svg.contains("NaN"));
        assert!(svg.contains("&lt;script&gt;") && svg.contains("error &amp; more"));
        assert_eq!(svg.matches("<circle").count(), 1);
    }

    #[test]
    fn nothing_to_draw_is_nothing() {
        assert_eq!(dot_plot(&[], "a", true), "");
        let rows = [Row { label: "a".into(), points: vec![point(f64::INFINITY)] }];
        assert_eq!(dot_plot(&rows, "a", true), "");
        let same = [Row { label: "a".into(), points: vec![Point { bar: None, ..point(0.0) }] }];
        assert!(!dot_plot(&same, "a", true).contains("NaN"));
        assert!(!dot_plot(&same, "a", false).contains("NaN"));
    }
}
