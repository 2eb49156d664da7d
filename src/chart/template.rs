//! SVG templates of charts. minijinja fills them in, and escapes all texts.

use minijinja::syntax::SyntaxConfig;
use minijinja::{Environment, Value};

/// Width of a letter in a chart's texts, pixels. The font is monospaced.
pub(super) const ADVANCE: f64 = 7.0;

/// Font size of a chart's texts, pixels. A letter of a monospaced font is 0.6 times as wide, which is [`ADVANCE`].
pub(super) const TEXT_SIZE: f64 = 11.7;

/// Fills in an SVG template. The template's values can be formatted by two filters: `px` writes a position with one
/// decimal, and `number` writes a number without trailing zeros.
///
/// # Panics
/// If the template itself has an error, such as wrong syntax. The values can't cause a panic.
pub(super) fn filled(template: &'static str, values: Value) -> String {
    let mut env = Environment::new();
    let mut syntax = SyntaxConfig::builder();
    syntax.trim_blocks(true).lstrip_blocks(true).keep_trailing_newline(true);
    env.set_syntax(syntax.build().expect("delimiters are the default ones"));
    env.add_filter("px", |position: f64| format!("{position:.1}"));
    env.add_filter("number", |value: f64| value.to_string());
    // The suffix `.html` makes minijinja escape texts.
    env.add_template("chart.html", template).expect("the template has no wrong syntax");
    let chart = env.get_template("chart.html").expect("it was added");
    chart.render(values).expect("the template uses what it is given")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn letters_advance_as_labels_assume() {
        assert!((0.6 * TEXT_SIZE - ADVANCE).abs() < 0.05);
    }
}
