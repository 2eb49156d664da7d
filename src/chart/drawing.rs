//! A drawing of lines, dots and words, as SVG and as an image: the same shapes both ways.

use super::lettering::{self, LINE_PX, Weight};
use crate::raster::Image;
use minijinja::HtmlEscape;
use std::fmt::Write;

/// Red, green and blue.
pub(super) type Color = [u8; 3];

/// Which end of a text stands at its place.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Anchor {
    Start,
    Middle,
    End,
}

/// One thing on the page; positions in the page's units from its top left corner.
#[derive(Clone, Debug)]
pub(super) enum Shape {
    /// Joined by straight lines.
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
    /// `at` is on the baseline; upward text is turned by a quarter.
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
pub struct Drawing {
    pub(super) size: [f64; 2],
    pub(super) shapes: Vec<Shape>,
}

/// What a letter advances by, in the page's units: that of the image's letters, pixels.
pub(super) const ADVANCE: f64 = 7.0;

/// Height of the SVG's letters: those of monospaced fonts are 0.6 of it wide.
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

    /// As an RGB image, a pixel a unit.
    pub fn image(&self) -> Image {
        let [w, h] = self.size.map(|v| (v.round() as usize).max(1));
        let mut image = Image::filled(w, h, 3, 1.0);
        for shape in &self.shapes {
            shape.paint(&mut image);
        }
        image
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

    fn paint(&self, image: &mut Image) {
        match self {
            Self::Path { points, color, width, dashed } => {
                for ends in points.windows(2) {
                    segment(image, ends[0], ends[1], *width, *dashed, *color);
                }
            }
            Self::Rect { at, size, color } => {
                let [left, top] = at.map(|v| v.round().max(0.0) as usize);
                let right = ((at[0] + size[0]).round().max(0.0) as usize).min(image.width());
                let bottom = ((at[1] + size[1]).round().max(0.0) as usize).min(image.height());
                for y in top..bottom {
                    (left..right).for_each(|x| ink(image, x, y, 1.0, *color));
                }
            }
            Self::Disc { at, radius, color } => {
                let (c, r) = (*at, *radius);
                around(image, [c[0] - r, c[1] - r], [c[0] + r, c[1] + r], *color, |x, y| {
                    r - (x - c[0]).hypot(y - c[1]) + 0.5
                });
            }
            Self::Text { at, text, anchor, bold, color, upward } => {
                let weight = if *bold { Weight::Bold } else { Weight::Regular };
                let [x, y] = *at;
                let room = lettering::width_px(text);
                let before = match anchor {
                    Anchor::Start => 0.0,
                    Anchor::Middle => 0.5 * room as f64,
                    Anchor::End => room as f64,
                };
                // The baseline is five sixths of a line down.
                let above = LINE_PX as f64 * 5.0 / 6.0;
                lettering::letters(room, text, weight, |along, down, strength| {
                    let (along, down) = (along as f64 - before, down as f64 - above);
                    let (x, y) =
                        if *upward { (x + down, y - along) } else { (x + along, y + down) };
                    if x >= 0.0 && y >= 0.0 {
                        ink(image, x as usize, y as usize, f64::from(strength), *color);
                    }
                });
            }
        }
    }
}

/// A straight line, in pixels.
fn segment(image: &mut Image, a: [f64; 2], b: [f64; 2], width: f64, dashed: bool, color: Color) {
    let along = [b[0] - a[0], b[1] - a[1]];
    let length = along[0].hypot(along[1]);
    if !(length > 0.0) {
        return;
    }
    let reach = 0.5 * width + 1.0;
    let low = [a[0].min(b[0]) - reach, a[1].min(b[1]) - reach];
    let high = [a[0].max(b[0]) + reach, a[1].max(b[1]) + reach];
    around(image, low, high, color, |x, y| {
        let from_a = [x - a[0], y - a[1]];
        let t = (from_a[0] * along[0] + from_a[1] * along[1]) / length;
        let on = t.clamp(0.0, length);
        if dashed && on % (DASH[0] + DASH[1]) > DASH[0] {
            return 0.0;
        }
        let nearest = [a[0] + along[0] * on / length, a[1] + along[1] * on / length];
        0.5 * width - (x - nearest[0]).hypot(y - nearest[1]) + 0.5
    });
}

/// Inks the pixels of a box by how much of each is covered.
fn around(
    image: &mut Image,
    low: [f64; 2],
    high: [f64; 2],
    color: Color,
    covered: impl Fn(f64, f64) -> f64,
) {
    let from = |v: f64| v.floor().max(0.0) as usize;
    let to = |v: f64, size: usize| (v.ceil().max(0.0) as usize).min(size);
    for y in from(low[1])..to(high[1], image.height()) {
        for x in from(low[0])..to(high[0], image.width()) {
            let share = covered(x as f64 + 0.5, y as f64 + 0.5).clamp(0.0, 1.0);
            if share > 0.0 {
                ink(image, x, y, share, color);
            }
        }
    }
}

fn ink(image: &mut Image, x: usize, y: usize, strength: f64, color: Color) {
    lettering::blend(image, x, y, strength as f32, color.map(|v| f32::from(v) / 255.0));
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The dark pixels of a page of 60 units.
    fn inked(shape: Shape) -> Vec<(usize, usize)> {
        let image = Drawing { size: [60.0, 60.0], shapes: vec![shape] }.image();
        (0..60 * 60).filter(|k| image.data()[3 * k] < 0.5).map(|k| (k % 60, k / 60)).collect()
    }

    const BLACK: Color = [0; 3];

    fn line(dashed: bool) -> Vec<(usize, usize)> {
        let points = vec![[5.0, 30.0], [55.0, 30.0]];
        inked(Shape::Path { points, color: BLACK, width: 2.0, dashed })
    }

    #[test]
    fn shapes_are_where_they_were_put() {
        let disc = inked(Shape::Disc { at: [30.0, 15.0], radius: 8.0, color: BLACK });
        assert!((190..215).contains(&disc.len()), "π·8²: {}", disc.len());
        assert!(disc.iter().all(|(x, y)| x.abs_diff(30) <= 8 && y.abs_diff(15) <= 8));
        let line = line(false);
        assert!(line.iter().all(|(_, y)| *y == 29 || *y == 30) && line.len() >= 98, "{line:?}");
        let rect = Shape::Rect { at: [10.0, 10.0], size: [8.0, 4.0], color: BLACK };
        assert_eq!(inked(rect).len(), 8 * 4);
    }

    #[test]
    fn dashes_have_gaps() {
        let (whole, dashed) = (line(false).len(), line(true).len());
        assert!(dashed > whole / 3 && dashed < 3 * whole / 4, "{dashed} of {whole}");
    }

    #[test]
    fn letters_advance_as_the_page_has_it() {
        assert_eq!(lettering::width_px("0123456789") as f64, 10.0 * ADVANCE);
    }

    #[test]
    fn text_runs_along_or_upward_from_its_anchor() {
        let text = |anchor, upward| {
            let text = "abc".into();
            inked(Shape::Text { at: [30.0, 30.0], text, anchor, bold: false, color: BLACK, upward })
        };
        assert!(text(Anchor::Start, false).iter().all(|(x, y)| *x >= 30 && *y <= 34));
        assert!(text(Anchor::End, false).iter().all(|(x, _)| *x <= 30));
        let upward = text(Anchor::Start, true);
        assert!(upward.len() > 20 && upward.iter().all(|(x, y)| *y <= 30 && *x <= 34));
    }
}
