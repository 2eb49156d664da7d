//! Charts of errors and error bars against one varied parameter of the captures.

use super::captures::{Outcome, summary};
use super::median;
use stlfr::chart::{Chart, Series};

/// The varied parameter's name and its values.
pub type Sweep<'a> = (&'a str, &'a [f64]);

/// The chart of a sweep. `measure` gives the outcomes at a value, and the number of unknown offsets.
pub fn chart<E>(
    captures: &str,
    (name, values): Sweep,
    measure: impl Fn(f64) -> Result<(Vec<Outcome>, usize), E>,
) -> Result<Chart, E> {
    let labels = ["median |error|", "worst |error|", "median standard error"];
    let mut lines = labels.map(|label| Series {
        label: label.into(),
        line: true,
        dots: true,
        ..Series::default()
    });
    for &value in values {
        let (outcomes, unknown) = measure(value)?;
        println!("{name} {value}: {}; {unknown} unknown", summary(&outcomes));
        let errors: Vec<f64> = outcomes.iter().map(|o| o.error_frames.abs()).collect();
        let bars: Vec<f64> = outcomes.iter().map(|o| o.std_err_frames).collect();
        let worst = errors.iter().copied().fold(0.0, f64::max);
        for (line, y) in lines.iter_mut().zip([median(&errors), worst, median(&bars)]) {
            line.points.push((value, y).into());
        }
    }
    Ok(Chart {
        title: format!("{captures}: offset error by {name}"),
        x_label: name.into(),
        y_label: "frames".into(),
        log_y: true,
        series: lines.into(),
        rules: vec![(0.005, "0.005 frame".into())],
        ..Chart::default()
    })
}
