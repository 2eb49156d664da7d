//! Dot plots: labelled rows of dots on one horizontal axis, as SVG for use inside of an HTML page.
//!
//! Every SVG element has a CSS class. The HTML page's style sheet defines the colours for light and dark schemes.

use super::axis::{Axis, tick_text};
use super::template::filled;
use minijinja::{Value, context};

/// A dot plot: labelled rows of dots on a common horizontal axis.
#[derive(Clone, Debug, Default)]
pub struct DotPlot {
    /// The rows, from top to bottom.
    pub rows: Vec<DotRow>,
    /// Label of the horizontal axis: quantity and unit.
    pub x_label: String,
    /// Whether the axis extends equally far to both sides of 0, with a line at 0.
    pub symmetric: bool,
}

/// A row of a dot plot: a label and its dots.
#[derive(Clone, Debug, Default)]
pub struct DotRow {
    pub label: String,
    /// Dots of the row. Dots that aren't finite are not drawn.
    pub dots: Vec<Dot>,
}

/// A dot of a dot plot's row. Values are in the unit of the plot's axis.
#[derive(Clone, Debug, Default)]
pub struct Dot {
    pub value: f64,
    /// Half the length of the error bar, in the axis's unit. `None` for no error bar.
    pub bar: Option<f64>,
    /// Number of the dot's colour. The number modulo 6 selects one of the page's CSS classes `s0` to `s5`, each with a
    /// colour.
    pub series: usize,
    /// Text of the dot's tooltip.
    pub title: String,
}

/// Number of the page's CSS classes for colours, `s0` to `s5`.
const SERIES_CLASSES: usize = 6;

impl Dot {
    fn is_finite(&self) -> bool {
        self.value.is_finite() && self.bar.is_none_or(f64::is_finite)
    }

    /// Returns the two ends of the dot's error bar. Without an error bar, both ends are the dot's value.
    fn ends(&self) -> [f64; 2] {
        let bar = self.bar.unwrap_or(0.0);
        [self.value - bar, self.value + bar]
    }
}

impl DotPlot {
    /// Returns the plot as inline SVG of class `plot`, in two versions: `wide`, and `narrow` for phones. The page's
    /// style sheet shows one of the two versions. The text is empty if no dot is finite.
    pub fn svg(&self) -> String {
        let dots = self.rows.iter().flat_map(|r| &r.dots).filter(|d| d.is_finite());
        let mut ends: Vec<f64> = dots.flat_map(Dot::ends).collect();
        if ends.is_empty() {
            return String::new();
        }
        if self.symmetric {
            ends.extend(ends.iter().map(|v| -v).collect::<Vec<_>>());
        }
        // Positions are fractions of the plot's width.
        let axis = Axis::around(ends.into_iter(), false, 0.0, 1.0);
        let tick = |tick: f64| {
            let is_zero = self.symmetric && tick == 0.0;
            Some(context! { at => axis.at(tick)?, text => tick_text(tick), is_zero })
        };
        let dot = |dot: &Dot| {
            let [low, high] = dot.ends().map(|v| axis.at(v));
            Some(context! {
                at => axis.at(dot.value).filter(|_| dot.is_finite())?,
                bar => dot.bar.and(low.zip(high)),
                series => dot.series % SERIES_CLASSES,
                title => &dot.title,
            })
        };
        let row = |row: &DotRow| {
            let dots: Vec<Value> = row.dots.iter().filter_map(dot).collect();
            context! { label => &row.label, dots }
        };
        let ticks: Vec<Value> = axis.ticks().into_iter().filter_map(tick).collect();
        let rows: Vec<Value> = self.rows.iter().map(row).collect();
        filled(include_str!("dot_plot.svg"), context! { x_label => &self.x_label, ticks, rows })
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
