//! Line and scatter charts: numbers by numbers, with ticks, error bars, labels and a key.

use super::axis::{Axis, tick_text};
use super::drawing::{ADVANCE, Anchor, Color, Drawing, Shape};
use super::labels::{self, Box4};

/// A line or scatter chart. The default is empty, with linear axes.
#[derive(Clone, Debug, Default)]
pub struct Chart {
    pub title: String,
    pub x_label: String,
    pub y_label: String,
    /// Whether the x axis is logarithmic. Values that aren't positive are then not drawn.
    pub log_x: bool,
    /// As `log_x`, for the y axis.
    pub log_y: bool,
    /// A range that the y axis shows in any case.
    pub y_shows: Option<(f64, f64)>,
    /// The later over the earlier.
    pub series: Vec<Series>,
    /// Horizontal lines, such as a truth or a target, with their labels.
    pub rules: Vec<(f64, String)>,
    /// Texts beside points.
    pub labels: Vec<Label>,
    /// Lines of text beside the frame.
    pub key: Vec<String>,
}

/// A text at a point of the chart, in the axes' units.
#[derive(Clone, Debug)]
pub struct Label {
    pub x: f64,
    pub y: f64,
    pub text: String,
    pub bold: bool,
}

/// A set of points of one colour.
#[derive(Clone, Debug, Default)]
pub struct Series {
    /// Its entry in the legend; a series without one has an empty label.
    pub label: String,
    /// In the order in which a line joins them. Points that aren't finite are not drawn.
    pub points: Vec<ChartPoint>,
    /// Whether the points are joined by a line.
    pub line: bool,
    /// Whether each point has a dot.
    pub dots: bool,
    /// Whether the series is grey, as a background to the others.
    pub faint: bool,
}

/// A point of a series, in the axes' units.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ChartPoint {
    pub x: f64,
    pub y: f64,
    /// Half the length of its error bar along y; 0 for none.
    pub bar: f64,
    /// Ends of its error bar along x.
    pub x_range: Option<(f64, f64)>,
}

impl From<(f64, f64)> for ChartPoint {
    fn from((x, y): (f64, f64)) -> Self {
        Self { x, y, bar: 0.0, x_range: None }
    }
}

/// Size of a chart without a key, in the page's units (a pixel at a zoom of 1).
const WIDTH: f64 = 560.0;
const HEIGHT: f64 = 340.0;
/// Left, right, top and bottom of the frame, from the chart's edges: room for ticks and titles.
const MARGINS: [f64; 4] = [74.0, 16.0, 34.0, 48.0];
/// Height of a line of text. Smaller than the letters' 11.7, lines overlap.
const ROW: f64 = 15.0;
/// Enlargement of a chart with a key, which stands beside it and makes the page wide anyway.
const KEYED: f64 = 1.4;
/// Distinct in colour and in lightness.
const COLORS: [Color; 8] = [
    [0x0b, 0x62, 0xa4],
    [0xd1, 0x49, 0x5b],
    [0x2a, 0x9d, 0x5c],
    [0x8a, 0x5f, 0xbf],
    [0xc7, 0x7d, 0x00],
    [0x00, 0x86, 0x8b],
    [0x6b, 0x4c, 0x3b],
    [0x55, 0x55, 0x55],
];
const INK: Color = [0; 3];
const FRAME: Color = [0x88; 3];
const GRID: Color = [0xe4; 3];
const FAINT: Color = [0xb4; 3];

/// Charts side by side, `columns` a row, as one standalone SVG file.
///
/// `columns` is clamped to 1 and to the number of charts. No charts give an empty page.
pub fn svg(charts: &[Chart], columns: usize) -> String {
    let columns = columns.clamp(1, charts.len().max(1));
    let rows = charts.len().div_ceil(columns);
    let sizes = charts.iter().map(Chart::size);
    let [w, h] = sizes.fold([WIDTH, HEIGHT], |a, b| [a[0].max(b[0]), a[1].max(b[1])]);
    let mut page = Page { origin: [0.0; 2], shapes: Vec::new() };
    for (k, chart) in charts.iter().enumerate() {
        page.origin = [w * (k % columns) as f64, h * (k / columns) as f64];
        chart.draw(&mut page);
    }
    Drawing { size: [w * columns as f64, h * rows as f64], shapes: page.shapes }.svg()
}

/// The page's shapes, and the place of the chart that is being drawn.
struct Page {
    /// Top left corner of the chart.
    origin: [f64; 2],
    shapes: Vec<Shape>,
}

impl Page {
    fn at(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        [x + self.origin[0], y + self.origin[1]]
    }

    fn path(&mut self, points: &[[f64; 2]], color: Color, width: f64, dashed: bool) {
        let points = points.iter().map(|p| self.at(*p)).collect();
        self.shapes.push(Shape::Path { points, color, width, dashed });
    }

    fn disc(&mut self, at: [f64; 2], radius: f64, color: Color) {
        self.shapes.push(Shape::Disc { at: self.at(at), radius, color });
    }

    fn text(&mut self, at: [f64; 2], text: &str, anchor: Anchor, bold: bool) {
        let (at, text) = (self.at(at), text.to_owned());
        self.shapes.push(Shape::Text { at, text, anchor, bold, color: INK, upward: false });
    }
}

/// A chart's axes, in its frame: left, top, right and bottom.
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

    /// The row that the key starts at: below the legend, which stands above it.
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

    fn draw(&self, page: &mut Page) {
        let axes = self.axes();
        let [left, top, right, bottom] = axes.frame;
        self.draw_grid(page, &axes);
        for (value, label) in &self.rules {
            let Some(at) = axes.y.at(*value) else { continue };
            page.path(&[[left, at], [right, at]], [0x33; 3], 1.0, true);
            page.text([right - 4.0, at - 4.0], label, Anchor::End, false);
        }
        for (k, series) in self.series.iter().enumerate() {
            series.draw(page, &axes, self.color(k));
        }
        self.draw_labels(page, &axes);
        self.draw_legend(page, &axes);
        let corners = [[left, top], [right, top], [right, bottom], [left, bottom], [left, top]];
        page.path(&corners, FRAME, 1.0, false);
        for (row, line) in self.key.iter().enumerate() {
            let at = [right + 16.0, top + 10.0 + ROW * (self.key_from() + row) as f64];
            page.text(at, line, Anchor::Start, false);
        }
    }

    fn color(&self, series: usize) -> Color {
        if self.series[series].faint { FAINT } else { COLORS[series % COLORS.len()] }
    }

    /// Ticks with their grid lines, the title and the axes' labels.
    fn draw_grid(&self, page: &mut Page, axes: &Axes) {
        let [left, top, right, bottom] = axes.frame;
        for tick in axes.x.ticks() {
            let Some(at) = axes.x.at(tick) else { continue };
            page.path(&[[at, top], [at, bottom]], GRID, 1.0, false);
            page.text([at, bottom + 15.0], &tick_text(tick), Anchor::Middle, false);
        }
        for tick in axes.y.ticks() {
            let Some(at) = axes.y.at(tick) else { continue };
            page.path(&[[left, at], [right, at]], GRID, 1.0, false);
            page.text([left - 6.0, at + 4.0], &tick_text(tick), Anchor::End, false);
        }
        let middle = 0.5 * (left + right);
        page.text([middle, 20.0], &self.title, Anchor::Middle, true);
        page.text([middle, bottom + 36.0], &self.x_label, Anchor::Middle, false);
        let (at, text) = (page.at([14.0, 0.5 * (top + bottom)]), self.y_label.clone());
        let (anchor, color) = (Anchor::Middle, INK);
        page.shapes.push(Shape::Text { at, text, anchor, bold: false, color, upward: true });
    }

    /// The series' colours and labels: inside the frame, or above the key where there is one.
    fn draw_legend(&self, page: &mut Page, axes: &Axes) {
        let [left, top, right, _] = axes.frame;
        let labelled = self.series.iter().enumerate().filter(|(_, s)| !s.label.is_empty());
        let beside = if self.key.is_empty() { left + 8.0 } else { right + 16.0 };
        for (row, (k, series)) in labelled.enumerate() {
            let at = top + 14.0 + ROW * row as f64;
            let swatch = page.at([beside, at - 9.0]);
            let color = self.color(k);
            page.shapes.push(Shape::Rect { at: swatch, size: [10.0, 10.0], color });
            page.text([beside + 14.0, at], &series.label, Anchor::Start, false);
        }
    }

    /// The box of the legend inside the frame.
    fn legend_box(&self, axes: &Axes) -> Box4 {
        let [left, top, ..] = axes.frame;
        let names = self.series.iter().map(|s| s.label.chars().count()).filter(|n| *n > 0);
        let rows = names.clone().count() as f64;
        let longest = names.max().unwrap_or(0) as f64;
        [left, top, left + 26.0 + ADVANCE * longest, top + ROW * rows + 4.0]
    }

    /// Texts beside points, clear of dots, of lines, of the legend and of each other.
    fn draw_labels(&self, page: &mut Page, axes: &Axes) {
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
        for (spot, (at, label)) in
            labels::place(&texts, &obstacles, &axes.frame).iter().zip(&placed)
        {
            let near = [at[0].clamp(spot[0], spot[2]), at[1].clamp(spot[1], spot[3])];
            if (near[0] - at[0]).hypot(near[1] - at[1]) > 10.0 {
                page.path(&[*at, near], FRAME, 0.8, false);
            }
            page.text([spot[0], spot[3] - 2.0], &label.text, Anchor::Start, label.bold);
        }
    }
}

impl Series {
    /// Its points that lie on the axes, with their positions.
    fn placed(&self, axes: &Axes) -> Vec<([f64; 2], ChartPoint)> {
        let place = |p: &ChartPoint| Some(([axes.x.at(p.x)?, axes.y.at(p.y)?], *p));
        self.points.iter().filter_map(place).collect()
    }

    /// Positions that labels keep clear of: its dots, and its line every six units.
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

    fn draw(&self, page: &mut Page, axes: &Axes, color: Color) {
        let placed = self.placed(axes);
        if self.line && placed.len() > 1 {
            let points: Vec<_> = placed.iter().map(|(at, _)| *at).collect();
            page.path(&points, color, 1.8, false);
        }
        for (at, point) in placed {
            let ends = axes.y.at(point.y - point.bar).zip(axes.y.at(point.y + point.bar));
            if let Some((low, high)) = ends.filter(|_| point.bar > 0.0) {
                page.path(&[[at[0], low], [at[0], high]], color, 1.0, false);
            }
            let ends = point.x_range.and_then(|(a, b)| axes.x.at(a).zip(axes.x.at(b)));
            if let Some((low, high)) = ends {
                page.path(&[[low, at[1]], [high, at[1]]], color, 1.0, false);
            }
            if self.dots {
                page.disc(at, 2.8, color);
            }
        }
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
