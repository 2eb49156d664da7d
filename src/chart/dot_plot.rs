//! Dot plots: rows of labelled dots on one axis, as SVG that stands inside an HTML page.
//!
//! Colours are the page's: every element has a CSS class, so that the plot follows a light or a dark
//! scheme.

use super::axis::{Axis, tick_text};
use minijinja::HtmlEscape;
use std::fmt::{Result, Write};

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
    /// Its colour: the page's class `s0` to `s5`, from the start again after those.
    pub series: usize,
    /// The text that hovering shows.
    pub title: String,
}

/// CSS classes of colours that a page has.
const SERIES_CLASSES: usize = 6;

/// How wide a page has to be for the plot beside its rows' labels, and for the one below them.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Size {
    Wide,
    Narrow,
}

impl Size {
    fn class(self) -> &'static str {
        match self {
            Self::Wide => "wide",
            Self::Narrow => "narrow",
        }
    }

    fn width(self) -> f64 {
        match self {
            Self::Wide => 720.0,
            Self::Narrow => 340.0,
        }
    }

    /// Room at the left for the rows' labels. Smaller: long names are cut.
    fn label_width(self) -> f64 {
        match self {
            Self::Wide => 150.0,
            Self::Narrow => 12.0,
        }
    }

    /// How far below a row's top its dots are. On a narrow page, its label stands above them.
    fn dots_below(self) -> f64 {
        match self {
            Self::Wide => 0.5 * ROW_HEIGHT,
            Self::Narrow => 1.1 * ROW_HEIGHT,
        }
    }

    fn row_height(self) -> f64 {
        match self {
            Self::Wide => ROW_HEIGHT,
            Self::Narrow => 1.6 * ROW_HEIGHT,
        }
    }
}

const RIGHT_MARGIN: f64 = 16.0;
/// Larger: plots of many cameras fill pages. Smaller: labels of neighbouring rows touch.
const ROW_HEIGHT: f64 = 24.0;
const TOP: f64 = 8.0;
/// Room for ticks and the axis's label below the rows.
const FOOT: f64 = 44.0;

/// Margin beyond the dots on either side, as a fraction of their range; of a symmetric axis's reach
/// in [`SYMMETRIC_MARGIN`]. Larger: dots crowd in the middle. Smaller: dots are cut at the edge.
const MARGIN: f64 = 0.06;
const SYMMETRIC_MARGIN: f64 = 0.05;

/// Smallest reach of an axis whose dots coincide; it only keeps divisions from 0.
const MIN_REACH: f64 = 1e-9;

impl Dot {
    fn is_finite(&self) -> bool {
        self.value.is_finite() && self.bar.is_none_or(f64::is_finite)
    }

    /// Ends of its error bar.
    fn reach(&self) -> [f64; 2] {
        let bar = self.bar.unwrap_or(0.0);
        [self.value - bar, self.value + bar]
    }
}

impl DotPlot {
    /// The plot as inline SVG of class `plot`, twice: `wide`, and `narrow` for a telephone; the page shows one
    /// of them. An empty string if there is no finite dot.
    pub fn svg(&self) -> String {
        let Some(range) = self.range() else { return String::new() };
        let mut svg = String::new();
        for size in [Size::Wide, Size::Narrow] {
            let axis = Axis::spanning(range, size.label_width(), size.width() - RIGHT_MARGIN);
            // Writing to a string does not fail.
            self.write(&mut svg, &axis, size).unwrap_or_default();
        }
        svg
    }

    /// Ends of the axis; `None` if there is no finite dot.
    fn range(&self) -> Option<[f64; 2]> {
        let dots = || self.rows.iter().flat_map(|r| &r.dots).filter(|d| d.is_finite());
        let low = dots().map(|d| d.reach()[0]).fold(f64::INFINITY, f64::min);
        let high = dots().map(|d| d.reach()[1]).fold(f64::NEG_INFINITY, f64::max);
        if low > high {
            return None;
        }
        Some(if self.symmetric {
            let reach = low.abs().max(high.abs()).max(MIN_REACH) * (1.0 + SYMMETRIC_MARGIN);
            [-reach, reach]
        } else {
            let margin = (MARGIN * (high - low)).max(1e-3 * high.abs()).max(MIN_REACH);
            [low - margin, high + margin]
        })
    }

    fn write(&self, svg: &mut String, axis: &Axis, size: Size) -> Result {
        let bottom = TOP + size.row_height() * self.rows.len() as f64;
        let label = HtmlEscape(self.x_label.as_str());
        write!(
            svg,
            "<svg class=\"plot {}\" viewBox=\"0 0 {} {}\" role=\"img\" aria-label=\"{label}\">",
            size.class(),
            size.width(),
            bottom + FOOT
        )?;
        self.write_ticks(svg, axis, bottom)?;
        let middle = (size.label_width() + size.width() - RIGHT_MARGIN) / 2.0;
        write!(
            svg,
            "<text x=\"{middle}\" y=\"{}\" text-anchor=\"middle\">{label}</text>",
            bottom + 36.0
        )?;
        for (k, row) in self.rows.iter().enumerate() {
            row.write(svg, axis, TOP + size.row_height() * k as f64, size)?;
        }
        svg.push_str("</svg>");
        Ok(())
    }

    fn write_ticks(&self, svg: &mut String, axis: &Axis, bottom: f64) -> Result {
        for tick in axis.ticks() {
            let Some(at) = axis.at(tick) else { continue };
            let class = if self.symmetric && tick == 0.0 { "zero" } else { "grid" };
            write!(
                svg,
                "<line class=\"{class}\" x1=\"{at:.1}\" x2=\"{at:.1}\" y1=\"{TOP}\" y2=\"{bottom}\"/>\
                 <text x=\"{at:.1}\" y=\"{}\" text-anchor=\"middle\">{}</text>",
                bottom + 16.0,
                tick_text(tick)
            )?;
        }
        Ok(())
    }
}

impl DotRow {
    /// The row's label and dots, from the height `top` down.
    fn write(&self, svg: &mut String, axis: &Axis, top: f64, size: Size) -> Result {
        let y = top + size.dots_below();
        let (x, baseline, anchor) = match size {
            Size::Wide => (size.label_width() - 12.0, y + 4.0, "end"),
            Size::Narrow => (0.0, top + 0.6 * ROW_HEIGHT, "start"),
        };
        write!(
            svg,
            "<text class=\"label\" x=\"{x}\" y=\"{baseline:.1}\" text-anchor=\"{anchor}\">{}</text>",
            HtmlEscape(self.label.as_str())
        )?;
        for dot in self.dots.iter().filter(|d| d.is_finite()) {
            let class = format!("s{}", dot.series % SERIES_CLASSES);
            let [low, high] = dot.reach().map(|v| axis.at(v));
            if let (Some(low), Some(high), Some(_)) = (low, high, dot.bar) {
                write!(
                    svg,
                    "<line class=\"bar {class}\" x1=\"{low:.1}\" x2=\"{high:.1}\" y1=\"{y}\" y2=\"{y}\"/>"
                )?;
            }
            let Some(x) = axis.at(dot.value) else { continue };
            write!(
                svg,
                "<circle class=\"{class}\" cx=\"{x:.1}\" cy=\"{y}\" r=\"4.5\"><title>{}</title></circle>",
                HtmlEscape(dot.title.as_str())
            )?;
        }
        Ok(())
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
