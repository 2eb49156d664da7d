//! Dot plots: rows of labelled dots on one axis, as SVG that stands inside an HTML page.
//!
//! Every element has a CSS class of the page, so that its colours follow a light or a dark scheme.

use super::axis::{Axis, tick_text};
use super::drawing::Drawing;
use minijinja::HtmlEscape;

/// Rows of dots on a common axis.
#[derive(Clone, Debug, Default)]
pub struct DotPlot {
    /// From the top.
    pub rows: Vec<DotRow>,
    /// Quantity and unit of the axis.
    pub x_label: String,
    /// Whether the axis reaches equally far to both sides of 0, with a line there.
    pub symmetric: bool,
}

/// A row: a label and its dots.
#[derive(Clone, Debug, Default)]
pub struct DotRow {
    pub label: String,
    /// Dots that aren't finite are not drawn.
    pub dots: Vec<Dot>,
}

/// A dot of a row, in the axis's unit.
#[derive(Clone, Debug, Default)]
pub struct Dot {
    pub value: f64,
    /// Half the length of its error bar.
    pub bar: Option<f64>,
    /// Its colour: the page's class `s0` to `s5`, modulo 6.
    pub series: usize,
    /// The text that hovering shows.
    pub title: String,
}

/// CSS classes of colours that a page has.
const SERIES_CLASSES: usize = 6;

/// Distances in a plot, pixels.
struct PlotLayout {
    /// CSS class.
    class: &'static str,
    width: f64,
    /// Left end of the axis.
    left: f64,
    row_height: f64,
    /// The dots' distance below the top of their row.
    dots_below: f64,
    /// The label's position from the left top of its row.
    label_at: [f64; 2],
    label_anchor: &'static str,
}

/// Labels beside the dots.
const WIDE: PlotLayout = PlotLayout {
    class: "wide",
    width: 720.0,
    left: 150.0,
    row_height: 24.0,
    dots_below: 12.0,
    label_at: [138.0, 16.0],
    label_anchor: "end",
};

/// Labels above the dots, for a telephone.
const NARROW: PlotLayout = PlotLayout {
    class: "narrow",
    width: 340.0,
    left: 12.0,
    row_height: 38.4,
    dots_below: 26.4,
    label_at: [0.0, 14.4],
    label_anchor: "start",
};

const RIGHT_MARGIN: f64 = 16.0;
const TOP: f64 = 8.0;
/// Room for ticks and the axis's label below the rows.
const FOOT: f64 = 44.0;

impl Dot {
    fn is_finite(&self) -> bool {
        self.value.is_finite() && self.bar.is_none_or(f64::is_finite)
    }

    /// Ends of its error bar.
    fn ends(&self) -> [f64; 2] {
        let bar = self.bar.unwrap_or(0.0);
        [self.value - bar, self.value + bar]
    }
}

impl DotPlot {
    /// The plot as inline SVG of class `plot`, twice: `wide`, and `narrow` for a telephone. The page
    /// shows one of them. An empty string if there is no finite dot.
    pub fn svg(&self) -> String {
        let dots = self.rows.iter().flat_map(|r| &r.dots).filter(|d| d.is_finite());
        let mut ends: Vec<f64> = dots.flat_map(Dot::ends).collect();
        if ends.is_empty() {
            return String::new();
        }
        if self.symmetric {
            ends.extend(ends.iter().map(|v| -v).collect::<Vec<_>>());
        }
        let drawn = |layout: &PlotLayout| {
            let right = layout.width - RIGHT_MARGIN;
            self.drawn(&Axis::around(ends.iter().copied(), false, layout.left, right), layout)
        };
        drawn(&WIDE) + &drawn(&NARROW)
    }

    fn drawn(&self, axis: &Axis, layout: &PlotLayout) -> String {
        let mut drawing = Drawing::default();
        let bottom = TOP + layout.row_height * self.rows.len() as f64;
        for tick in axis.ticks() {
            let Some(at) = axis.at(tick) else { continue };
            let is_zero_line = self.symmetric && tick == 0.0;
            let style = if is_zero_line { "class=\"zero\"" } else { "class=\"grid\"" };
            drawing.path(&[[at, TOP], [at, bottom]], style);
            drawing.text([at, bottom + 16.0], &tick_text(tick), "middle", "class=\"tick\"");
        }
        let middle = (layout.left + layout.width - RIGHT_MARGIN) / 2.0;
        drawing.text([middle, bottom + 36.0], &self.x_label, "middle", "class=\"tick\"");
        for (k, row) in self.rows.iter().enumerate() {
            drawing.origin = [0.0, TOP + layout.row_height * k as f64];
            drawing.text(layout.label_at, &row.label, layout.label_anchor, "class=\"label\"");
            for dot in row.dots.iter().filter(|d| d.is_finite()) {
                dot.draw(&mut drawing, axis, layout.dots_below);
            }
        }
        let label = HtmlEscape(self.x_label.as_str());
        let attributes =
            format!("class=\"plot {}\" role=\"img\" aria-label=\"{label}\"", layout.class);
        drawing.svg(&attributes, [layout.width, bottom + FOOT], "")
    }
}

impl Dot {
    fn draw(&self, drawing: &mut Drawing, axis: &Axis, y: f64) {
        let class = format!("s{}", self.series % SERIES_CLASSES);
        if let ([Some(low), Some(high)], Some(_)) = (self.ends().map(|v| axis.at(v)), self.bar) {
            drawing.path(&[[low, y], [high, y]], &format!("class=\"bar {class}\""));
        }
        if let Some(x) = axis.at(self.value) {
            drawing.disc([x, y], 4.5, &format!("class=\"{class}\""), &self.title);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn dot(value: f64) -> Dot {
        Dot { value, bar: Some(1.0), series: 1, title: "<b>".into() }
    }

    fn svg(rows: &[DotRow], x_label: &str, symmetric: bool) -> String {
        DotPlot { rows: rows.to_vec(), x_label: x_label.into(), symmetric }.svg()
    }

    #[test]
    fn labels_are_escaped_and_odd_values_not_drawn() {
        let rows = [DotRow { label: "<script>".into(), dots: vec![dot(2.0), dot(f64::NAN)] }];
        let svg = svg(&rows, "error & more", false);
        assert!(!svg.contains("<script>") && !svg.contains("<b>") && !svg.contains("NaN"));
        assert!(svg.contains("&lt;script&gt;") && svg.contains("error &amp; more"));
        assert_eq!(svg.matches("<circle").count(), 2, "one in each size");
    }

    #[test]
    fn dots_bars_and_ticks_have_the_pages_classes() {
        let rows = [DotRow { label: "cam0".into(), dots: vec![Dot { series: 7, ..dot(2.0) }] }];
        let svg = svg(&rows, "a", true);
        for class in ["plot wide", "plot narrow", "zero", "grid", "label", "bar s1", "s1"] {
            assert!(svg.contains(&format!("class=\"{class}\"")), "{class}");
        }
    }

    #[test]
    fn nothing_to_draw_is_nothing() {
        assert_eq!(svg(&[], "a", true), "");
        let rows = [DotRow { label: "a".into(), dots: vec![dot(f64::INFINITY)] }];
        assert_eq!(svg(&rows, "a", true), "");
        for symmetric in [true, false] {
            let same = [DotRow { label: "a".into(), dots: vec![Dot { bar: None, ..dot(0.0) }] }];
            let svg = svg(&same, "a", symmetric);
            assert!(svg.contains("<circle") && !svg.contains("NaN"));
        }
    }
}
