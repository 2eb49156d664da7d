//! Axes of charts: positions of values on the page, and ticks at round values.

/// Axis of a chart: maps values to positions on the page, linearly or logarithmically. Positions are in pixels or
/// fractions of the width.
pub(super) struct Axis {
    /// The smallest value of the axis, or the value's decimal logarithm on a logarithmic axis.
    low: f64,
    /// The largest value of the axis, or the value's decimal logarithm on a logarithmic axis.
    high: f64,
    /// Position on the page of the axis's smallest value, pixels or a fraction of the width.
    from: f64,
    /// Position on the page of the axis's largest value, pixels or a fraction of the width.
    to: f64,
    log: bool,
}

/// Margin of an axis beyond the smallest and the largest value, as a fraction of the range of the values.
const MARGIN: f64 = 0.05;

/// Approximate number of ticks on an axis.
const TICKS: f64 = 6.0;

/// Largest number of ticks on an axis. Without this limit, rounding errors in a small range of huge values would
/// produce thousands of ticks.
const MAX_TICKS: usize = 20;

impl Axis {
    /// Makes an axis that shows all values. Its ends are at the positions `from` and `to`.
    ///
    /// Values that aren't finite are ignored, and on a logarithmic axis also values that aren't positive. If there is
    /// at most one value, the axis still has a range of positive length.
    pub fn around(values: impl Iterator<Item = f64>, log: bool, from: f64, to: f64) -> Self {
        let values = values.map(|v| if log { v.log10() } else { v }).filter(|v| v.is_finite());
        let (low, high) = values
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (f64::min(l, v), f64::max(h, v)));
        let (low, high) = if low > high { (0.0, 1.0) } else { (low, high) };
        let margin = (MARGIN * (high - low)).max(1e-9 + 1e-3 * high.abs());
        Self { low: low - margin, high: high + margin, from, to, log }
    }

    /// Returns the position of a value on the page. `None` for a value outside of the axis.
    pub fn at(&self, value: f64) -> Option<f64> {
        let value = if self.log { value.log10() } else { value };
        let fraction = (value - self.low) / (self.high - self.low);
        (0.0..=1.0).contains(&fraction).then_some(self.from + fraction * (self.to - self.from))
    }

    /// Returns the values of the axis's ticks: round values, about [`TICKS`] of them.
    pub fn ticks(&self) -> Vec<f64> {
        let raw = (self.high - self.low) / TICKS;
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
            .take(MAX_TICKS)
            .map(|k| if self.log { 10f64.powf(value(k)) } else { value(k) })
            .collect()
    }
}

/// Formats a tick's value, with a typographic minus sign and without decimal digits that are only rounding errors.
pub(super) fn tick_text(tick: f64) -> String {
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

    #[test]
    fn tick_numbers_are_short() {
        assert_eq!(
            (tick_text(-0.5), tick_text(2e-5), tick_text(30.0), tick_text(-0.002)),
            ("−0.5".into(), "2e−5".into(), "30".into(), "−0.002".into())
        );
    }

    #[test]
    fn ticks_are_round_and_inside() {
        let ticks = |low, high| Axis::around([low, high].into_iter(), false, 0.0, 100.0).ticks();
        assert_eq!(ticks(0.0, 6.0), [0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0]);
        assert_eq!(ticks(-0.0031, 0.0031).len(), 7);
    }
}
