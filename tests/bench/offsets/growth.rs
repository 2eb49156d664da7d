//! Errors and error bars as one thing about films grows, as a chart.

use super::captures::{Outcome, summary};
use super::median;
use stlfr::chart::{Chart, Series};

/// What is varied, and the values that it takes.
pub type Sweep<'a> = (&'a str, &'a [f64]);

/// The chart of all offsets at each value; `at` gives them, and how many cameras are unknown.
pub fn chart<E>(
    films: &str,
    (name, values): Sweep,
    at: impl Fn(f64) -> Result<(Vec<Outcome>, usize), E>,
) -> Result<Chart, E> {
    let labels = ["median |error|", "worst |error|", "median standard error"];
    let mut lines = labels.map(|label| Series {
        label: label.into(),
        line: true,
        dots: true,
        ..Series::default()
    });
    for &value in values {
        let (found, unknown) = at(value)?;
        println!("{name} {value}: {}; {unknown} unknown", summary(&found));
        let errors: Vec<f64> = found.iter().map(|o| o.error_frames.abs()).collect();
        let bars: Vec<f64> = found.iter().map(|o| o.std_err_frames).collect();
        let worst = errors.iter().copied().fold(0.0, f64::max);
        for (line, y) in lines.iter_mut().zip([median(&errors), worst, median(&bars)]) {
            line.points.push((value, y).into());
        }
    }
    Ok(Chart {
        title: format!("{films}: offset error by {name}"),
        x_label: name.into(),
        y_label: "frames".into(),
        log_y: true,
        series: lines.into(),
        rules: vec![(0.005, "0.005 frame".into())],
        ..Chart::default()
    })
}
