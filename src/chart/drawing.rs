//! A drawing of lines, dots and text, written as SVG.

use minijinja::HtmlEscape;
use std::fmt::Write;

/// Red, green and blue, display-encoded.
pub(super) type Color = [u8; 3];

/// The end of a text that stands at its position.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Anchor {
    Start,
    Middle,
    End,
}

/// One element of the page. Positions are in the page's units from its top left corner.
#[derive(Clone, Debug)]
pub(super) enum Shape {
    /// Points joined by straight lines.
    Path {
        points: Vec<[f64; 2]>,
        color: Color,
        width: f64,
        dashed: bool,
    },
    Rect {
        at: [f64; 2],
        size: [f64; 2],
        color: Color,
    },
    Disc {
        at: [f64; 2],
        radius: f64,
        color: Color,
    },
    /// A line of text; `at` is on its baseline. Upward text is turned by a quarter.
    Text {
        at: [f64; 2],
        text: String,
        anchor: Anchor,
        bold: bool,
        color: Color,
        upward: bool,
    },
}

/// Shapes on a white page, the later over the earlier.
#[derive(Clone, Debug)]
pub(super) struct Drawing {
    /// Width and height of the page.
    pub size: [f64; 2],
    pub shapes: Vec<Shape>,
}

/// Advance of a letter, in the page's units. Larger: labels keep needlessly apart. Smaller: they
/// overlap.
pub(super) const ADVANCE: f64 = 7.0;

/// Height of the letters: those of monospaced fonts are 0.6 of it wide, which is [`ADVANCE`].
pub(super) const TEXT_SIZE: f64 = 11.7;

/// Lengths of a dash and of the gap after it.
const DASH: [f64; 2] = [5.0, 4.0];

impl Drawing {
    /// As a standalone SVG file.
    pub fn svg(&self) -> String {
        let [width, height] = self.size;
        let mut out = format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {width} {height}\" \
             width=\"{width}\" height=\"{height}\" font-family=\"'Noto Sans Mono', monospace\" \
             font-size=\"{TEXT_SIZE}\">\n\
             <rect width=\"{width}\" height=\"{height}\" fill=\"#ffffff\"/>\n"
        );
        for shape in &self.shapes {
            // Writing to a string does not fail.
            shape.write(&mut out).unwrap_or_default();
        }
        out.push_str("</svg>\n");
        out
    }
}

fn hex([r, g, b]: Color) -> String {
    format!("#{r:02x}{g:02x}{b:02x}")
}

impl Shape {
    fn write(&self, out: &mut String) -> std::fmt::Result {
        match self {
            Self::Path { points, color, width, dashed } => {
                let points: Vec<String> =
                    points.iter().map(|[x, y]| format!("{x:.1},{y:.1}")).collect();
                let dashes = if *dashed {
                    format!(" stroke-dasharray=\"{} {}\"", DASH[0], DASH[1])
                } else {
                    String::new()
                };
                writeln!(
                    out,
                    "<polyline points=\"{}\" fill=\"none\" stroke=\"{}\" stroke-width=\"{width}\"{dashes}/>",
                    points.join(" "),
                    hex(*color)
                )
            }
            Self::Rect { at: [x, y], size: [w, h], color } => writeln!(
                out,
                "<rect x=\"{x:.1}\" y=\"{y:.1}\" width=\"{w:.1}\" height=\"{h:.1}\" fill=\"{}\"/>",
                hex(*color)
            ),
            Self::Disc { at: [x, y], radius, color } => writeln!(
                out,
                "<circle cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"{radius}\" fill=\"{}\"/>",
                hex(*color)
            ),
            Self::Text { at: [x, y], text, anchor, bold, color, upward } => {
                let place = if *upward {
                    format!("transform=\"translate({x:.1} {y:.1}) rotate(-90)\"")
                } else {
                    format!("x=\"{x:.1}\" y=\"{y:.1}\"")
                };
                let anchor = match anchor {
                    Anchor::Start => "start",
                    Anchor::Middle => "middle",
                    Anchor::End => "end",
                };
                let weight = if *bold { " font-weight=\"bold\"" } else { "" };
                writeln!(
                    out,
                    "<text {place} text-anchor=\"{anchor}\"{weight} fill=\"{}\" \
                     xml:space=\"preserve\">{}</text>",
                    hex(*color),
                    HtmlEscape(text)
                )
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const BLACK: Color = [0; 3];

    fn written(shape: Shape) -> String {
        let mut out = String::new();
        shape.write(&mut out).unwrap();
        out
    }

    #[test]
    fn shapes_are_where_they_were_put() {
        let disc = written(Shape::Disc { at: [30.0, 15.0], radius: 8.0, color: BLACK });
        assert_eq!(disc, "<circle cx=\"30.0\" cy=\"15.0\" r=\"8\" fill=\"#000000\"/>\n");
        let rect = Shape::Rect { at: [10.0, 12.0], size: [8.0, 4.0], color: [0xd1, 0x49, 0x5b] };
        assert_eq!(
            written(rect),
            "<rect x=\"10.0\" y=\"12.0\" width=\"8.0\" height=\"4.0\" fill=\"#d1495b\"/>\n"
        );
        let page = Drawing { size: [60.0, 40.0], shapes: Vec::new() }.svg();
        assert!(page.contains("viewBox=\"0 0 60 40\"") && page.ends_with("</svg>\n"));
    }

    #[test]
    fn dashes_have_gaps() {
        let line = |dashed| {
            let points = vec![[5.0, 30.0], [55.0, 30.0]];
            written(Shape::Path { points, color: BLACK, width: 2.0, dashed })
        };
        assert!(line(false).contains("points=\"5.0,30.0 55.0,30.0\""));
        assert!(line(true).contains("stroke-dasharray=\"5 4\""));
        assert!(!line(false).contains("stroke-dasharray"));
    }

    #[test]
    fn letters_advance_as_labels_assume() {
        assert!((0.6 * TEXT_SIZE - ADVANCE).abs() < 0.05);
    }

    #[test]
    fn text_runs_along_or_upward_from_its_anchor() {
        let text = |anchor, upward| {
            let text = "abc".into();
            written(Shape::Text {
                at: [30.0, 20.0],
                text,
                anchor,
                bold: false,
                color: BLACK,
                upward,
            })
        };
        assert!(text(Anchor::Start, false).contains("x=\"30.0\" y=\"20.0\" text-anchor=\"start\""));
        assert!(text(Anchor::End, false).contains("text-anchor=\"end\""));
        assert!(text(Anchor::Start, true).contains("translate(30.0 20.0) rotate(-90)"));
    }
}
