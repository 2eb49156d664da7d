//! Charts as SVG, for offsets, trade-offs, reports and benchmarks.
//!
//! | file | contents |
//! |---|---|
//! | `line_chart.rs` | line and scatter charts, several on a page: standalone files |
//! | `dot_plot.rs` | rows of labelled dots on one axis: inline SVG in the colours of an HTML page |
//! | `axis.rs` | positions of values, and ticks |
//! | `labels.rs` | placement of texts beside points |
//! | `template.rs`, `*.svg` | templates of SVG |
//!
//! Known limits: legends may cover points, and the placement of labels assumes a monospaced font.

mod axis;
mod dot_plot;
mod labels;
mod line_chart;
mod template;

pub use dot_plot::{Dot, DotPlot, DotRow};
pub use line_chart::{Chart, ChartPoint, Label, Series, svg};
