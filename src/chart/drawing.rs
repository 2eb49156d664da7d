//! An SVG drawing of lines, dots and texts.

use minijinja::HtmlEscape;

/// Elements of SVG, the later over the earlier. Positions are pixels at a zoom of 1, from the top left.
///
/// A `style` is text of SVG attributes: a colour, or a class of the page.
#[derive(Debug, Default)]
pub(super) struct Drawing {
    elements: String,
    /// Where the positions of the next elements start.
    pub origin: [f64; 2],
}

/// Width of a letter, pixels.
pub(super) const ADVANCE: f64 = 7.0;

/// Font size, pixels. Letters of monospaced fonts are 0.6 of it wide, which is [`ADVANCE`].
pub(super) const TEXT_SIZE: f64 = 11.7;

impl Drawing {
    /// A white page of this size.
    pub fn on_white([width, height]: [f64; 2]) -> Self {
        let elements = format!("<rect width=\"{width}\" height=\"{height}\" fill=\"#ffffff\"/>\n");
        Self { elements, origin: [0.0; 2] }
    }

    /// The SVG element of this size, with further attributes before and after it.
    pub fn svg(&self, before: &str, [width, height]: [f64; 2], after: &str) -> String {
        format!(
            "<svg {before} viewBox=\"0 0 {width} {height}\" {after}>\n\
             {}</svg>\n",
            self.elements
        )
    }

    fn at(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        [x + self.origin[0], y + self.origin[1]]
    }

    /// Points joined by straight lines.
    pub fn path(&mut self, points: &[[f64; 2]], style: &str) {
        let points = points.iter().map(|p| self.at(*p)).map(|[x, y]| format!("{x:.1},{y:.1}"));
        let points = points.collect::<Vec<_>>().join(" ");
        self.elements += &format!("<polyline points=\"{points}\" fill=\"none\" {style}/>\n");
    }

    pub fn square(&mut self, at: [f64; 2], size: f64, style: &str) {
        let [x, y] = self.at(at);
        let size = format!("width=\"{size:.1}\" height=\"{size:.1}\"");
        self.elements += &format!("<rect x=\"{x:.1}\" y=\"{y:.1}\" {size} {style}/>\n");
    }

    /// A disc; hovering shows its title, if it has one.
    pub fn disc(&mut self, at: [f64; 2], radius: f64, style: &str, title: &str) {
        let [x, y] = self.at(at);
        let disc = format!("<circle cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"{radius}\" {style}");
        self.elements += &match title {
            "" => format!("{disc}/>\n"),
            title => format!("{disc}><title>{}</title></circle>\n", HtmlEscape(title)),
        };
    }

    /// A text whose baseline has its `anchor` (`start`, `middle` or `end`) at a position.
    pub fn text(&mut self, at: [f64; 2], text: &str, anchor: &str, style: &str) {
        let [x, y] = self.at(at);
        self.placed_text(&format!("x=\"{x:.1}\" y=\"{y:.1}\""), text, anchor, style);
    }

    /// A text that runs upward, with its middle at a position.
    pub fn upward_text(&mut self, at: [f64; 2], text: &str, style: &str) {
        let [x, y] = self.at(at);
        let place = format!("transform=\"translate({x:.1} {y:.1}) rotate(-90)\"");
        self.placed_text(&place, text, "middle", style);
    }

    fn placed_text(&mut self, place: &str, text: &str, anchor: &str, style: &str) {
        self.elements += &format!(
            "<text {place} text-anchor=\"{anchor}\" {style} xml:space=\"preserve\">{}</text>\n",
            HtmlEscape(text)
        );
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn drawn(draw: impl FnOnce(&mut Drawing)) -> String {
        let mut drawing = Drawing { origin: [10.0, 5.0], ..Drawing::default() };
        draw(&mut drawing);
        drawing.elements
    }

    #[test]
    fn elements_are_where_they_were_put() {
        let disc = drawn(|d| d.disc([20.0, 10.0], 8.0, "fill=\"#000\"", ""));
        assert_eq!(disc, "<circle cx=\"30.0\" cy=\"15.0\" r=\"8\" fill=\"#000\"/>\n");
        let square = drawn(|d| d.square([0.0, 7.0], 8.0, "class=\"a\""));
        assert_eq!(
            square,
            "<rect x=\"10.0\" y=\"12.0\" width=\"8.0\" height=\"8.0\" class=\"a\"/>\n"
        );
        let path = drawn(|d| d.path(&[[0.0, 25.0], [45.0, 25.0]], ""));
        assert!(path.contains("points=\"10.0,30.0 55.0,30.0\""));
        let page = Drawing::default().svg("", [60.0, 40.0], "");
        assert!(page.contains("viewBox=\"0 0 60 40\"") && page.ends_with("</svg>\n"));
    }

    #[test]
    fn letters_advance_as_labels_assume() {
        assert!((0.6 * TEXT_SIZE - ADVANCE).abs() < 0.05);
    }

    #[test]
    fn text_runs_along_or_upward_from_its_anchor() {
        let along = drawn(|d| d.text([20.0, 15.0], "a<b", "end", ""));
        assert!(along.contains("x=\"30.0\" y=\"20.0\" text-anchor=\"end\""));
        assert!(along.contains("a&lt;b"));
        let upward = drawn(|d| d.upward_text([20.0, 15.0], "abc", ""));
        assert!(upward.contains("translate(30.0 20.0) rotate(-90)"));
    }
}
