//! Values to positions on the page, and round values between.

/// An axis: values to positions on the page.
pub(super) struct Axis {
    low: f64,
    high: f64,
    from: f64,
    to: f64,
    log: bool,
}

impl Axis {
    /// Around all values; a single one, or none, gets a range too.
    pub fn around(values: impl Iterator<Item = f64>, log: bool, from: f64, to: f64) -> Self {
        let values = values.map(|v| if log { v.log10() } else { v }).filter(|v| v.is_finite());
        let (low, high) = values
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (f64::min(l, v), f64::max(h, v)));
        let (low, high) = if low > high { (0.0, 1.0) } else { (low, high) };
        let margin = (0.05 * (high - low)).max(1e-9 + 1e-3 * high.abs());
        Self { low: low - margin, high: high + margin, from, to, log }
    }

    /// `None` for what is not on the axis.
    pub fn at(&self, value: f64) -> Option<f64> {
        let value = if self.log { value.log10() } else { value };
        let share = (value - self.low) / (self.high - self.low);
        (0.0..=1.0).contains(&share).then_some(self.from + share * (self.to - self.from))
    }

    /// Round values, about six.
    pub fn ticks(&self) -> Vec<f64> {
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

/// A tick without the digits that come from rounding.
pub(super) fn plain(tick: f64) -> String {
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
    fn ticks_are_round() {
        assert_eq!(
            (plain(-0.5), plain(2e-5), plain(30.0)),
            ("−0.5".into(), "2e−5".into(), "30".into())
        );
    }
}
