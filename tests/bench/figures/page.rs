//! A figure as the paper sets it: panels in a grid on white, each with its letter beneath, and the
//! caption.

use stlfr::compare::lettering::{LINE_PX, TextStyle, width_px, write};
use stlfr::compare::sheet::paste;
use stlfr::raster::Image;

const LETTER: TextStyle = TextStyle { bold: true, color: [0.05; 3] };
const TEXT: TextStyle = TextStyle { bold: false, color: [0.25; 3] };
/// Between panels, and around them.
const MARGIN_PX: usize = 18;
/// Between a panel and the text beneath it.
const GAP_PX: usize = 6;

/// One picture of a figure.
pub struct Panel {
    pub image: Image,
    /// Letter and what it is.
    pub title: String,
    /// A second line; may be empty.
    pub note: String,
}

impl Panel {
    pub fn new(image: Image, title: impl Into<String>, note: impl Into<String>) -> Self {
        Self { image: image.to_rgb(), title: title.into(), note: note.into() }
    }
}

/// A figure.
pub struct Page {
    pub rows: Vec<Vec<Panel>>,
    /// `Fig. N.` and what it shows.
    pub caption: String,
}

impl Page {
    /// Draws the page as an RGB image. A column is as wide as its widest panel, a row as high as its
    /// highest; panels are centred in their column.
    pub fn draw(&self) -> Image {
        let columns = self.rows.iter().map(Vec::len).max().unwrap_or(0);
        let widths: Vec<usize> = (0..columns).map(|c| self.column_width(c)).collect();
        let heights: Vec<(usize, usize)> =
            self.rows.iter().map(|row| row_heights(row, &widths)).collect();
        let width = MARGIN_PX + widths.iter().map(|w| w + MARGIN_PX).sum::<usize>();
        let caption = wrapped(&self.caption, width - 2 * MARGIN_PX);
        let panels: usize = heights.iter().map(|(image, text)| image + text + MARGIN_PX).sum();
        let height = 2 * MARGIN_PX + panels + caption.len() * LINE_PX;
        let mut page = Image::filled(width, height, 3, 1.0);
        let mut y = MARGIN_PX;
        for (row, (image, text)) in self.rows.iter().zip(&heights) {
            let mut x = MARGIN_PX;
            for (panel, room) in row.iter().zip(&widths) {
                let left = x + (room - panel.image.width()) / 2;
                paste(&mut page, (left, y + image - panel.image.height()), &panel.image, 1);
                for (k, (line, style)) in lines(panel, *room).into_iter().enumerate() {
                    let at = (x + (room - width_px(&line)) / 2, y + image + GAP_PX + k * LINE_PX);
                    write(&mut page, at, *room, &line, style);
                }
                x += room + MARGIN_PX;
            }
            y += image + text + MARGIN_PX;
        }
        for (k, line) in caption.iter().enumerate() {
            write(&mut page, (MARGIN_PX, y + k * LINE_PX), width, line, LETTER);
        }
        page
    }

    fn column_width(&self, column: usize) -> usize {
        self.rows.iter().filter_map(|r| r.get(column)).map(|p| p.image.width()).max().unwrap_or(0)
    }
}

/// Height of a row's images, and of the text beneath them.
fn row_heights(row: &[Panel], widths: &[usize]) -> (usize, usize) {
    let image = row.iter().map(|p| p.image.height()).max().unwrap_or(0);
    let text = row.iter().zip(widths).map(|(p, w)| lines(p, *w).len()).max().unwrap_or(0);
    (image, if text > 0 { GAP_PX + text * LINE_PX } else { 0 })
}

/// A panel's text in lines.
fn lines(panel: &Panel, room_px: usize) -> Vec<(String, TextStyle)> {
    let styled = |text: &str, style: TextStyle| {
        wrapped(text, room_px).into_iter().map(move |line| (line, style)).collect::<Vec<_>>()
    };
    let mut lines = styled(&panel.title, LETTER);
    lines.extend(styled(&panel.note, TEXT));
    lines
}

/// Text in lines of at most `room_px`; a longer word has a line of its own.
fn wrapped(text: &str, room_px: usize) -> Vec<String> {
    let mut lines: Vec<String> = Vec::new();
    for word in text.split_whitespace() {
        match lines.last_mut() {
            Some(line) if width_px(line) + width_px(" ") + width_px(word) <= room_px => {
                line.push(' ');
                line.push_str(word);
            }
            _ => lines.push(word.to_owned()),
        }
    }
    lines
}
