//! Line and scatter charts, with ticks, error bars, labels and a key. The key is a column of explanations beside the
//! chart.

use super::axis::{Axis, tick_text};
use super::labels::{self, Box4};
use super::template::{ADVANCE, TEXT_SIZE, filled};
use minijinja::{Value, context};

/// A line or scatter chart. The default chart is empty and has linear axes.
#[derive(Clone, Debug, Default)]
pub struct Chart {
    pub title: String,
    pub x_label: String,
    pub y_label: String,
    /// Whether the x axis is logarithmic. A logarithmic axis doesn't show values that aren't positive.
    pub log_x: bool,
    /// Whether the y axis is logarithmic. A logarithmic axis doesn't show values that aren't positive.
    pub log_y: bool,
    /// Smallest and largest value of a range that the y axis includes, even if no point lies there. `None` if the data
    /// alone determine the axis's range.
    pub y_shows: Option<(f64, f64)>,
    /// Point sets of the chart. Later series are drawn over earlier series.
    pub series: Vec<Series>,
    /// Horizontal lines, such as the true value or a target. Each has a y value and a label.
    pub rules: Vec<(f64, String)>,
    /// Texts next to points of the chart.
    pub labels: Vec<Label>,
    /// Explanations (the chart's key) at the right of the chart's frame, one entry per line of text.
    pub key: Vec<String>,
}

/// A text at a point of the chart. The coordinates are in the axes' units.
#[derive(Clone, Debug)]
pub struct Label {
    pub x: f64,
    pub y: f64,
    pub text: String,
    pub bold: bool,
}

/// A set of points with a common colour.
#[derive(Clone, Debug, Default)]
pub struct Series {
    /// Name of the series in the legend. If the name is empty, the series isn't in the legend.
    pub label: String,
    /// The points of the series, in the order in which the line joins them. Points that aren't finite are not drawn.
    pub points: Vec<ChartPoint>,
    /// Whether the points are joined by a line.
    pub line: bool,
    /// Whether each point is drawn as a dot.
    pub dots: bool,
    /// Whether the series is drawn in grey.
    pub faint: bool,
}

/// A point of a series. The coordinates are in the axes' units.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ChartPoint {
    pub x: f64,
    pub y: f64,
    /// Half the length of the error bar along y, in the y axis's unit. 0 if there is no error bar.
    pub bar: f64,
    /// The two ends of the error bar along x, in the x axis's unit. `None` if there is no error bar.
    pub x_range: Option<(f64, f64)>,
}

impl From<(f64, f64)> for ChartPoint {
    fn from((x, y): (f64, f64)) -> Self {
        Self { x, y, bar: 0.0, x_range: None }
    }
}

/// Width of a chart without a key, pixels.
const WIDTH: f64 = 560.0;
const HEIGHT: f64 = 340.0;
/// Left, right, top and bottom margins between the chart's edges and its frame, pixels. The margins contain the ticks'
/// values and the titles.
const MARGINS: [f64; 4] = [74.0, 16.0, 34.0, 48.0];
/// Height of a line of text, pixels.
const ROW: f64 = 15.0;
/// Scale factor of a chart with a key (explanations beside its frame), relative to a chart without a key. The width of
/// the key itself is not scaled.
const KEYED: f64 = 1.4;
/// Colours of the series, which differ in hue and in lightness.
const COLORS: [&str; 8] =
    ["#0b62a4", "#d1495b", "#2a9d5c", "#8a5fbf", "#c77d00", "#00868b", "#6b4c3b", "#555555"];
const FAINT: &str = "#b4b4b4";

/// Draws charts in a grid with `columns` charts per row. Returns one standalone SVG document.
///
/// `columns` is clamped to the range from 1 to the number of charts. Without charts, the page is empty.
pub fn svg(charts: &[Chart], columns: usize) -> String {
    let columns = columns.clamp(1, charts.len().max(1));
    let rows = charts.len().div_ceil(columns);
    let sizes = charts.iter().map(Chart::size);
    let [w, h] = sizes.fold([WIDTH, HEIGHT], |a, b| [a[0].max(b[0]), a[1].max(b[1])]);
    let chart = |(k, chart): (usize, &Chart)| {
        context! { origin => [w * (k % columns) as f64, h * (k / columns) as f64], ..chart.drawn() }
    };
    let page = context! {
        width => (w * columns as f64).to_string(),
        height => (h * rows as f64).to_string(),
        text_size => TEXT_SIZE,
        row => ROW,
        charts => charts.iter().enumerate().map(chart).collect::<Vec<_>>(),
    };
    filled(include_str!("line_chart.svg"), page)
}

/// The axes of a chart, and the rectangle that they span.
struct Axes {
    x: Axis,
    y: Axis,
    frame: Box4,
}

impl Chart {
    fn size(&self) -> [f64; 2] {
        if self.key.is_empty() {
            return [WIDTH, HEIGHT];
        }
        let rows = self.key_from() + self.key.len() + 1;
        let height = (KEYED * HEIGHT).max(MARGINS[2] + ROW * rows as f64);
        [KEYED * WIDTH + self.key_width(), height]
    }

    fn key_width(&self) -> f64 {
        let longest = self.key.iter().map(|line| line.chars().count()).max();
        longest.map_or(0.0, |n| ADVANCE * n as f64 + 16.0)
    }

    /// Returns the row of text in which the key (the explanations beside the frame) starts, counted from 0. Above it
    /// are the legend's rows and one empty row.
    fn key_from(&self) -> usize {
        let names = self.series.iter().filter(|s| !s.label.is_empty()).count();
        if names > 0 { names + 1 } else { 0 }
    }

    fn axes(&self) -> Axes {
        let [left, right, top, bottom] = MARGINS;
        let [width, height] = self.size();
        let frame = [left, top, width - right - self.key_width(), height - bottom];
        let points = || self.series.iter().flat_map(|s| &s.points);
        let xs = points().flat_map(|p| {
            let (low, high) = p.x_range.unwrap_or((p.x, p.x));
            [low, p.x, high]
        });
        let x = Axis::around(xs, self.log_x, frame[0], frame[2]);
        let ys = points()
            .flat_map(|p| [p.y - p.bar, p.y + p.bar, p.y])
            .chain(self.rules.iter().map(|r| r.0))
            .chain(self.y_shows.into_iter().flat_map(|(low, high)| [low, high]));
        let y = Axis::around(ys, self.log_y, frame[3], frame[1]);
        Axes { x, y, frame }
    }

    /// Returns the values that are filled into the chart's SVG template. Positions are in pixels from the chart's top
    /// left corner.
    fn drawn(&self) -> Value {
        let axes = self.axes();
        let ticks = |axis: &Axis| -> Vec<Value> {
            let tick = |tick| Some(context! { at => axis.at(tick)?, text => tick_text(tick) });
            axis.ticks().into_iter().filter_map(tick).collect()
        };
        let rule =
            |(value, label): &(f64, String)| Some(context! { at => axes.y.at(*value)?, label });
        let series = |(k, series): (usize, &Series)| {
            let color = if series.faint { FAINT } else { COLORS[k % COLORS.len()] };
            let Series { label, line, dots, .. } = series;
            context! { label, line, dots, color, points => series.drawn(&axes) }
        };
        context! {
            frame => axes.frame,
            title => &self.title,
            x_label => &self.x_label,
            y_label => &self.y_label,
            x_ticks => ticks(&axes.x),
            y_ticks => ticks(&axes.y),
            rules => self.rules.iter().filter_map(rule).collect::<Vec<_>>(),
            series => self.series.iter().enumerate().map(series).collect::<Vec<_>>(),
            labels => self.drawn_labels(&axes),
            key => self.key.clone(),
            key_from => self.key_from(),
        }
    }

    /// Returns the rectangle of the legend inside of the chart's frame.
    fn legend_box(&self, axes: &Axes) -> Box4 {
        let [left, top, ..] = axes.frame;
        let names = self.series.iter().map(|s| s.label.chars().count()).filter(|n| *n > 0);
        let rows = names.clone().count() as f64;
        let longest = names.max().unwrap_or(0) as f64;
        [left, top, left + 26.0 + ADVANCE * longest, top + ROW * rows + 4.0]
    }

    /// Places the labels' texts next to their points, without overlapping dots, lines, the legend or each other. A line
    /// joins a distant text to its point. Returns the values that are filled into the SVG template.
    fn drawn_labels(&self, axes: &Axes) -> Vec<Value> {
        let placed: Vec<([f64; 2], &Label)> = self
            .labels
            .iter()
            .filter_map(|l| Some(([axes.x.at(l.x)?, axes.y.at(l.y)?], l)))
            .collect();
        let texts: Vec<_> = placed.iter().map(|(at, l)| (*at, l.text.as_str())).collect();
        let mut obstacles: Vec<Box4> = self
            .series
            .iter()
            .flat_map(|s| s.obstacles(axes))
            .map(|[x, y]| [x - 3.5, y - 3.5, x + 3.5, y + 3.5])
            .collect();
        if self.key.is_empty() {
            obstacles.push(self.legend_box(axes));
        }
        let spots = labels::place(&texts, &obstacles, &axes.frame);
        let drawn = |(spot, (at, label)): (&Box4, &([f64; 2], &Label))| {
            let near = [at[0].clamp(spot[0], spot[2]), at[1].clamp(spot[1], spot[3])];
            let is_far = (near[0] - at[0]).hypot(near[1] - at[1]) > 10.0;
            context! { at, near, is_far, spot, text => &label.text, bold => label.bold }
        };
        spots.iter().zip(&placed).map(drawn).collect()
    }
}

impl Series {
    /// Returns the points of the series that lie inside of the axes, each with its position on the page, pixels.
    fn placed(&self, axes: &Axes) -> Vec<([f64; 2], ChartPoint)> {
        let place = |p: &ChartPoint| Some(([axes.x.at(p.x)?, axes.y.at(p.y)?], *p));
        self.points.iter().filter_map(place).collect()
    }

    /// Returns the positions that labels must not cover, pixels: the dots, and points on the line every 6 pixels.
    fn obstacles(&self, axes: &Axes) -> Vec<[f64; 2]> {
        let mut positions: Vec<[f64; 2]> = self.placed(axes).iter().map(|(at, _)| *at).collect();
        if self.line {
            let ends = positions.clone();
            for pair in ends.windows(2) {
                let ([a, b], [c, d]) = (pair[0], pair[1]);
                let steps = ((c - a).hypot(d - b) / 6.0).ceil();
                let along = (1..steps as usize).map(|k| k as f64 / steps);
                positions.extend(along.map(|t| [a + (c - a) * t, b + (d - b) * t]));
            }
        }
        positions
    }

    fn drawn(&self, axes: &Axes) -> Vec<Value> {
        let drawn = |(at, point): ([f64; 2], ChartPoint)| {
            let y_bar = axes.y.at(point.y - point.bar).zip(axes.y.at(point.y + point.bar));
            let x_bar = point.x_range.and_then(|(a, b)| axes.x.at(a).zip(axes.x.at(b)));
            context! { at, y_bar => y_bar.filter(|_| point.bar > 0.0), x_bar }
        };
        self.placed(axes).into_iter().map(drawn).collect()
    }
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
                ..Series::default()
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
    fn logarithmic_axes_skip_values_without_a_logarithm() {
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
    fn elements_are_where_they_belong() {
        let mut chart = chart(&[(0.0, 0.0), (1.0, 1.0)], false);
        chart.rules = vec![(0.5, "a<b".into())];
        let svg = svg(&[chart.clone(), chart], 2);
        assert!(svg.contains("viewBox=\"0 0 1120 340\"") && svg.ends_with("</svg>\n"));
        // Ends of the horizontal line, at the left and the right of the frame, for both charts.
        for line in ["74.0,163.0 544.0,163.0", "634.0,163.0 1104.0,163.0"] {
            assert!(svg.contains(&format!("points=\"{line}\"")), "{line}");
        }
        assert!(
            svg.contains("x=\"540.0\" y=\"159.0\" text-anchor=\"end\"") && svg.contains("a&lt;b")
        );
        assert!(svg.contains(
            "<rect x=\"642.0\" y=\"39.0\" width=\"10.0\" height=\"10.0\" fill=\"#0b62a4\"/>\n"
        ));
        assert!(svg.contains("translate(14.0 163.0) rotate(-90)"));
    }

    #[test]
    fn a_key_stands_beside_an_enlarged_chart_with_labels() {
        let mut chart = chart(&[(0.01, 1.0), (0.1, 2.0), (1.0, 2.5)], false);
        chart.log_x = true;
        chart.labels = vec![Label { x: 0.1, y: 2.0, text: "balanced".into(), bold: true }];
        chart.key = vec!["a key of one line".into()];
        assert!(chart.size()[0] >= KEYED * WIDTH);
        let svg = svg(&[chart], 1);
        assert!(svg.contains("balanced") && svg.contains("a key of one line"));
    }
}
