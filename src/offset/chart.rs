//! Line and dot charts as one standalone SVG, by hand: the few that offsets need.

use minijinja::HtmlEscape;
use std::fmt::Write;

/// One chart.
#[derive(Clone, Debug, Default)]
pub struct Chart {
    pub title: String,
    pub x_label: String,
    pub y_label: String,
    /// Whether an axis is logarithmic; values that aren't positive are then left out.
    pub log_x: bool,
    pub log_y: bool,
    /// The least range that the y axis shows.
    pub y_shows: Option<(f64, f64)>,
    pub series: Vec<Series>,
    /// Horizontal lines, such as a truth or a target, with their labels.
    pub rules: Vec<(f64, String)>,
}

/// One set of points.
#[derive(Clone, Debug, Default)]
pub struct Series {
    pub label: String,
    pub points: Vec<ChartPoint>,
    /// Whether the points are joined,
    pub line: bool,
    /// and whether each has a dot.
    pub dots: bool,
}

/// A point, with half the length of its error bar.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ChartPoint {
    pub x: f64,
    pub y: f64,
    pub bar: f64,
}

impl From<(f64, f64)> for ChartPoint {
    fn from((x, y): (f64, f64)) -> Self {
        Self { x, y, bar: 0.0 }
    }
}

const WIDTH: f64 = 560.0;
const HEIGHT: f64 = 340.0;
/// Left, right, top and bottom of the frame, from the chart's edges.
const MARGINS: [f64; 4] = [74.0, 16.0, 34.0, 48.0];
const LEGEND_ROW: f64 = 15.0;
/// Distinct in colour and in lightness.
const COLORS: [&str; 8] =
    ["#0b62a4", "#d1495b", "#2a9d5c", "#8a5fbf", "#c77d00", "#00868b", "#6b4c3b", "#555555"];

/// An axis: values to positions on the page.
struct Axis {
    low: f64,
    high: f64,
    from: f64,
    to: f64,
    log: bool,
}

impl Axis {
    /// Around all values; a single one, or none, gets a range too.
    fn around(values: impl Iterator<Item = f64>, log: bool, from: f64, to: f64) -> Self {
        let values = values.map(|v| if log { v.log10() } else { v }).filter(|v| v.is_finite());
        let (low, high) = values
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (f64::min(l, v), f64::max(h, v)));
        let (low, high) = if low > high { (0.0, 1.0) } else { (low, high) };
        let margin = (0.05 * (high - low)).max(1e-9 + 1e-3 * high.abs());
        Self { low: low - margin, high: high + margin, from, to, log }
    }

    /// `None` for what is not on the axis.
    fn at(&self, value: f64) -> Option<f64> {
        let value = if self.log { value.log10() } else { value };
        let share = (value - self.low) / (self.high - self.low);
        (0.0..=1.0).contains(&share).then_some(self.from + share * (self.to - self.from))
    }

    /// Round values, about six.
    fn ticks(&self) -> Vec<f64> {
        let raw = (self.high - self.low) / 6.0;
        if self.log && raw > 0.12 {
            let powers = self.low.floor() as i32..=self.high.ceil() as i32;
            let digits: &[f64] = if raw > 0.5 { &[1.0] } else { &[1.0, 2.0, 5.0] };
            return powers
                .flat_map(|p| digits.iter().map(move |d| d * 10f64.powi(p)))
                .filter(|v| self.at(*v).is_some())
                .collect();
        }
        let power = 10f64.powf(raw.log10().floor());
        let step = [1.0, 2.0, 5.0, 10.0].into_iter().find(|m| m * power >= 0.8 * raw);
        let step = step.unwrap_or(10.0) * power;
        let (first, last) = ((self.low / step).ceil() as i64, (self.high / step).floor() as i64);
        let value = |k: i64| k as f64 * step;
        (first..=last)
            .take(20)
            .map(|k| if self.log { 10f64.powf(value(k)) } else { value(k) })
            .collect()
    }
}

/// Charts side by side, `columns` a row, as one SVG file.
pub fn svg(charts: &[Chart], columns: usize) -> String {
    let columns = columns.clamp(1, charts.len().max(1));
    let rows = charts.len().div_ceil(columns);
    let (width, height) = (WIDTH * columns as f64, HEIGHT * rows as f64);
    let mut out = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {width} {height}\" \
         width=\"{width}\" height=\"{height}\" font-family=\"sans-serif\" font-size=\"12\">\n\
         <rect width=\"{width}\" height=\"{height}\" fill=\"#ffffff\"/>\n"
    );
    for (k, chart) in charts.iter().enumerate() {
        let (x, y) = (WIDTH * (k % columns) as f64, HEIGHT * (k / columns) as f64);
        // Writing to a string does not fail.
        let _ = writeln!(out, "<g transform=\"translate({x} {y})\">");
        chart.draw(&mut out).unwrap_or_default();
        out.push_str("</g>\n");
    }
    out.push_str("</svg>\n");
    out
}

impl Chart {
    fn draw(&self, out: &mut String) -> std::fmt::Result {
        let [left, right, top, bottom] = MARGINS;
        let (right, bottom) = (WIDTH - right, HEIGHT - bottom);
        let points = || self.series.iter().flat_map(|s| &s.points);
        let x = Axis::around(points().map(|p| p.x), self.log_x, left, right);
        let ys = points()
            .flat_map(|p| [p.y - p.bar, p.y + p.bar, p.y])
            .chain(self.rules.iter().map(|r| r.0))
            .chain(self.y_shows.into_iter().flat_map(|(low, high)| [low, high]));
        let y = Axis::around(ys, self.log_y, bottom, top);
        for tick in x.ticks() {
            let Some(at) = x.at(tick) else { continue };
            writeln!(
                out,
                "<line x1=\"{at:.1}\" x2=\"{at:.1}\" y1=\"{top}\" y2=\"{bottom}\" stroke=\"#e4e4e4\"/>\
                 <text x=\"{at:.1}\" y=\"{}\" text-anchor=\"middle\">{}</text>",
                bottom + 15.0,
                plain(tick)
            )?;
        }
        for tick in y.ticks() {
            let Some(at) = y.at(tick) else { continue };
            writeln!(
                out,
                "<line x1=\"{left}\" x2=\"{right}\" y1=\"{at:.1}\" y2=\"{at:.1}\" stroke=\"#e4e4e4\"/>\
                 <text x=\"{}\" y=\"{:.1}\" text-anchor=\"end\">{}</text>",
                left - 6.0,
                at + 4.0,
                plain(tick)
            )?;
        }
        let middle = 0.5 * (left + right);
        writeln!(
            out,
            "<text x=\"{middle}\" y=\"20\" text-anchor=\"middle\" font-size=\"14\" \
             font-weight=\"bold\">{}</text>\
             <text x=\"{middle}\" y=\"{}\" text-anchor=\"middle\">{}</text>\
             <text transform=\"translate(14 {}) rotate(-90)\" text-anchor=\"middle\">{}</text>",
            HtmlEscape(&self.title),
            HEIGHT - 12.0,
            HtmlEscape(&self.x_label),
            0.5 * (top + bottom),
            HtmlEscape(&self.y_label)
        )?;
        for (value, label) in &self.rules {
            let Some(at) = y.at(*value) else { continue };
            writeln!(
                out,
                "<line x1=\"{left}\" x2=\"{right}\" y1=\"{at:.1}\" y2=\"{at:.1}\" \
                 stroke=\"#333333\" stroke-dasharray=\"5 4\"/>\
                 <text x=\"{}\" y=\"{:.1}\" text-anchor=\"end\" fill=\"#333333\">{}</text>",
                right - 4.0,
                at - 4.0,
                HtmlEscape(label)
            )?;
        }
        for (k, series) in self.series.iter().enumerate() {
            series.draw(out, &x, &y, COLORS[k % COLORS.len()])?;
        }
        let labelled = self.series.iter().enumerate().filter(|(_, s)| !s.label.is_empty());
        for (row, (k, series)) in labelled.enumerate() {
            let (color, at) = (COLORS[k % COLORS.len()], top + 14.0 + LEGEND_ROW * row as f64);
            writeln!(
                out,
                "<rect x=\"{}\" y=\"{}\" width=\"10\" height=\"10\" fill=\"{color}\"/>\
                 <text x=\"{}\" y=\"{at}\">{}</text>",
                left + 8.0,
                at - 9.0,
                left + 22.0,
                HtmlEscape(&series.label)
            )?;
        }
        writeln!(
            out,
            "<rect x=\"{left}\" y=\"{top}\" width=\"{}\" height=\"{}\" fill=\"none\" stroke=\"#888888\"/>",
            right - left,
            bottom - top
        )
    }
}

impl Series {
    fn draw(&self, out: &mut String, x: &Axis, y: &Axis, color: &str) -> std::fmt::Result {
        let placed: Vec<(f64, f64, ChartPoint)> =
            self.points.iter().filter_map(|p| Some((x.at(p.x)?, y.at(p.y)?, *p))).collect();
        if self.line && placed.len() > 1 {
            let path: Vec<String> =
                placed.iter().map(|(x, y, _)| format!("{x:.1},{y:.1}")).collect();
            writeln!(
                out,
                "<polyline points=\"{}\" fill=\"none\" stroke=\"{color}\" stroke-width=\"1.8\"/>",
                path.join(" ")
            )?;
        }
        for (px, py, point) in &placed {
            let ends = (y.at(point.y - point.bar), y.at(point.y + point.bar));
            if let (true, (Some(low), Some(high))) = (point.bar > 0.0, ends) {
                writeln!(
                    out,
                    "<line x1=\"{px:.1}\" x2=\"{px:.1}\" y1=\"{low:.1}\" y2=\"{high:.1}\" \
                     stroke=\"{color}\" stroke-opacity=\"0.6\"/>"
                )?;
            }
            if self.dots {
                writeln!(
                    out,
                    "<circle cx=\"{px:.1}\" cy=\"{py:.1}\" r=\"2.8\" fill=\"{color}\"/>"
                )?;
            }
        }
        Ok(())
    }
}

/// A tick without the digits that come from rounding.
fn plain(tick: f64) -> String {
    if tick != 0.0 && (tick.abs() < 1e-4 || tick.abs() >= 1e6) {
        return format!("{tick:.0e}").replace('-', "−");
    }
    let text = format!("{tick:.6}");
    let text = text.trim_end_matches('0').trim_end_matches('.');
    if text == "-0" { "0".into() } else { text.replace('-', "−") }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn chart(points: &[(f64, f64)], log_y: bool) -> Chart {
        Chart {
            title: "<b>&".into(),
            log_y,
            series: vec![Series {
                label: "a".into(),
                points: points.iter().map(|&p| p.into()).collect(),
                line: true,
                dots: true,
            }],
            ..Chart::default()
        }
    }

    #[test]
    fn every_finite_point_has_a_dot_and_text_is_escaped() {
        let svg = svg(&[chart(&[(0.0, 1.0), (1.0, f64::NAN), (2.0, 3.0)], false)], 1);
        assert_eq!(svg.matches("<circle").count(), 2);
        assert!(svg.contains("&lt;b&gt;&amp;") && !svg.contains("NaN"));
    }

    #[test]
    fn logarithmic_axes_leave_out_what_has_no_logarithm() {
        let svg = svg(&[chart(&[(0.0, 0.001), (1.0, 0.0), (2.0, 10.0)], true)], 1);
        assert_eq!(svg.matches("<circle").count(), 2);
        for tick in ["0.001", "0.1", ">10<"] {
            assert!(svg.contains(tick), "{tick}");
        }
    }

    #[test]
    fn nothing_and_a_single_point_are_drawn() {
        for points in [&[][..], &[(5.0, 5.0)][..]] {
            for log_y in [false, true] {
                let svg = svg(&[chart(points, log_y)], 3);
                assert_eq!(svg.matches("<circle").count(), points.len());
                assert!(!svg.contains("NaN") && !svg.contains("inf"));
            }
        }
        assert!(svg(&[], 2).ends_with("</svg>\n"));
    }

    #[test]
    fn ticks_are_round() {
        assert_eq!(
            (plain(-0.5), plain(2e-5), plain(30.0)),
            ("−0.5".into(), "2e−5".into(), "30".into())
        );
    }
}
