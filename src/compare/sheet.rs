//! Comparison sheets: the ground-truth image and each method's image side by side, with labels. Below are the amplified
//! differences.

use super::lettering::{LINE_PX, TextStyle, width_px, write};
use super::truths::TrueImage;
use crate::metrics::{RegionScores, Scores};
use crate::raster::Image;
use std::borrow::Cow;

/// Grey value of a sheet's background, from 0 to 1.
const BACKGROUND: f32 = 0.09;
const TITLE: TextStyle = TextStyle { bold: true, color: [0.93; 3] };
const CAPTION: TextStyle = TextStyle { bold: false, color: [0.65; 3] };
/// Tint of the pixels of moving surfaces in the marked ground-truth image: red, green and blue, each from 0 to 1.
const MOVING_TINT: [f32; 3] = [1.0, 0.62, 0.18];
/// Tint of the pixels of static surfaces in the marked ground-truth image: red, green and blue, each from 0 to 1.
const STILL_TINT: [f32; 3] = [0.45; 3];
/// Width of the margins between panels and around them, pixels.
const MARGIN_PX: usize = 12;
/// Minimum panel width, pixels. Narrower panels are enlarged by an integer factor.
const MIN_PANEL_PX: usize = 300;
/// Maximum length of a panel's longer side, pixels. Larger panels are reduced by an integer factor. A sheet of eight
/// panels then stays below the largest size of WebP.
const MAX_PANEL_PX: usize = 1920;

/// The image of one method in a comparison sheet.
pub(super) struct Panel<'a> {
    /// Name of the method, shown above the image.
    pub title: String,
    /// The image, or the reason why the image is missing.
    pub image: Result<&'a Image, &'a String>,
    /// Scores of the image against the ground-truth image. `None` if there is no image.
    pub scores: Option<RegionScores>,
}

/// Draws a comparison sheet as an RGB image. The ground-truth image is at the left, with its moving part marked below.
/// The methods' images follow. Below each method's image is its absolute difference from the ground-truth image, times
/// `gain`.
///
/// # Panics
/// If an image differs from the ground-truth image in size or number of channels.
pub(super) fn sheet(title: &str, truth: &TrueImage, panels: &[Panel], gain: f32) -> Image {
    let factor = truth.image.width().max(truth.image.height()).div_ceil(MAX_PANEL_PX);
    let [width, height] = [truth.image.width(), truth.image.height()].map(|n| n.div_ceil(factor));
    let scale = MIN_PANEL_PX.div_ceil(width).min(MAX_PANEL_PX / height).max(1);
    let put =
        |sheet: &mut Image, at, image: &Image| paste(sheet, at, &reduced(image, factor), scale);
    let (w, h) = (width * scale, height * scale);
    let columns = 1 + panels.len();
    let head = MARGIN_PX + LINE_PX;
    let pictures = head + MARGIN_PX + 4 * LINE_PX + 4;
    let labels = pictures + h + 6;
    let differences = labels + LINE_PX;
    let width = (MARGIN_PX + w) * columns + MARGIN_PX;
    let mut sheet = Image::filled(width, differences + h + MARGIN_PX, 3, BACKGROUND);
    write(&mut sheet, (MARGIN_PX, MARGIN_PX), width, title, TITLE);

    let label = |sheet: &mut Image, x: usize, title: &str, lines: &[String], below: &str| {
        let y = head + MARGIN_PX;
        write(sheet, (x, y), w, title, TITLE);
        for (k, line) in lines.iter().enumerate() {
            write(sheet, (x, y + (k + 1) * LINE_PX), w, line, CAPTION);
        }
        write(sheet, (x, labels), w, below, CAPTION);
    };
    label(&mut sheet, MARGIN_PX, "Truth", &[], "Moving part (measured apart)");
    put(&mut sheet, (MARGIN_PX, pictures), &truth.image);
    put(&mut sheet, (MARGIN_PX, differences), &marked(truth));
    for (k, panel) in panels.iter().enumerate() {
        let x = MARGIN_PX + (k + 1) * (w + MARGIN_PX);
        let lines = match (&panel.scores, panel.image) {
            (Some(scores), _) => score_lines(scores).to_vec(),
            (None, image) => vec![image.err().cloned().unwrap_or_default()],
        };
        label(&mut sheet, x, &panel.title, &lines, &format!("|difference from truth| × {gain}"));
        if let Ok(image) = panel.image {
            put(&mut sheet, (x, pictures), image);
            put(&mut sheet, (x, differences), &difference(&truth.image, image, gain));
        }
    }
    sheet
}

/// Returns the ground-truth image in dark grey, with tinted pixels: one tint for moving surfaces, another for static
/// ones.
fn marked(truth: &TrueImage) -> Image {
    let gray = truth.image.to_gray();
    let pixels = gray.data().iter().zip(&truth.moving).flat_map(|(v, moves)| {
        let tint = if *moves { MOVING_TINT } else { STILL_TINT };
        tint.map(|t| (0.15 + 0.85 * v) * t)
    });
    Image::from_data(gray.width(), gray.height(), 3, pixels.collect())
}

/// Returns the absolute difference |a − b| times `gain`, clamped to 1.
///
/// # Panics
/// If the images differ in size or number of channels.
fn difference(a: &Image, b: &Image, gain: f32) -> Image {
    assert_eq!((a.width(), a.channels()), (b.width(), b.channels()), "images of one kind");
    let data = a.data().iter().zip(b.data()).map(|(a, b)| ((a - b).abs() * gain).min(1.0));
    Image::from_data(a.width(), a.height(), a.channels(), data.collect())
}

/// Formats an image's scores as three lines of text: PSNR, SSIM and FLIP, each for the whole image and for the moving
/// part.
fn score_lines(scores: &RegionScores) -> [String; 3] {
    let number = |v: Option<f64>, digits: usize| match v {
        Some(v) => format!("{v:.digits$}"),
        None => "-".to_owned(),
    };
    let psnr = |s: &Scores| match s.psnr_db {
        None if s.pixels > 0 => "same".to_owned(),
        db => number(db, 1),
    };
    let (whole, moving) = (&scores.whole, &scores.moving);
    let line = |metric: &str, whole: String, moving: String| {
        format!("{metric} {whole:>5}  moving part {moving:>5}")
    };
    [
        line("PSNR", psnr(whole), psnr(moving)),
        line("SSIM", number(whole.ssim, 3), number(moving.ssim, 3)),
        line("FLIP", number(whole.flip, 3), number(moving.flip, 3)),
    ]
}

/// Reduces an image by an integer factor: each output pixel is the mean of a block of `factor`×`factor` pixels. Blocks
/// at the right and lower borders may be smaller.
fn reduced(image: &Image, factor: usize) -> Cow<'_, Image> {
    if factor == 1 {
        return Cow::Borrowed(image);
    }
    let [width, height] = [image.width(), image.height()].map(|n| n.div_ceil(factor));
    let mut data = Vec::with_capacity(width * height * image.channels());
    for (y, x) in (0..height).flat_map(|y| (0..width).map(move |x| (y, x))) {
        let rows = y * factor..((y + 1) * factor).min(image.height());
        let columns = x * factor..((x + 1) * factor).min(image.width());
        let count = (rows.len() * columns.len()) as f32;
        data.extend((0..image.channels()).map(|c| {
            let row = |y: usize| columns.clone().map(move |x| image.pixel(x, y)[c]).sum::<f32>();
            rows.clone().map(row).sum::<f32>() / count
        }));
    }
    Cow::Owned(Image::from_data(width, height, image.channels(), data))
}

/// Copies an image into an RGB sheet, enlarged by the integer factor `scale`. The image's top left corner is at the
/// pixel (x, y) of the sheet.
///
/// # Panics
/// If the enlarged image doesn't fit into the sheet.
pub fn paste(sheet: &mut Image, (x, y): (usize, usize), image: &Image, scale: usize) {
    let stride = sheet.width();
    for row in 0..image.height() * scale {
        for column in 0..image.width() * scale {
            let pixel = image.pixel(column / scale, row / scale);
            let at = ((y + row) * stride + x + column) * 3;
            for (c, out) in sheet.data_mut()[at..at + 3].iter_mut().enumerate() {
                *out = pixel[c.min(pixel.len() - 1)];
            }
        }
    }
}

/// Draws a frame of the review video: images side by side, each with a title, and a heading above. Width and height are
/// even, because H.264 requires it.
pub(super) fn strip(heading: &str, panels: &[(&str, &Image)]) -> Image {
    let widest = panels.iter().map(|(_, i)| i.width()).max().unwrap_or(1);
    let tallest = panels.iter().map(|(_, i)| i.height()).max().unwrap_or(1);
    let scale = MIN_PANEL_PX.div_ceil(widest).min(2);
    let (w, h) = (widest * scale, tallest * scale);
    let top = 2 * (LINE_PX + 3);
    let width = ((w + 4) * panels.len()).saturating_sub(4).max(width_px(heading) + 8);
    let even = |n: usize| n + n % 2;
    let mut strip = Image::filled(even(width), even(top + h), 3, BACKGROUND);
    write(&mut strip, (4, 3), width, heading, CAPTION);
    for (k, (title, image)) in panels.iter().enumerate() {
        let x = k * (w + 4);
        write(&mut strip, (x + 4, LINE_PX + 3), w, title, TITLE);
        paste(&mut strip, (x, top), image, scale);
    }
    strip
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn differences_are_amplified_and_bounded() {
        let (a, b) = (Image::filled(2, 1, 1, 0.5), Image::from_data(2, 1, 1, vec![0.45, 0.9]));
        let d = difference(&a, &b, 10.0);
        assert!((d.data()[0] - 0.5).abs() < 1e-6 && d.data()[1] == 1.0);
    }

    #[test]
    fn a_sheet_holds_truth_panels_and_their_differences() {
        let (image, result) = (Image::filled(200, 100, 3, 0.5), Image::filled(200, 100, 3, 0.6));
        let truth = TrueImage { image, moving: vec![false; 200 * 100] };
        let reason = "no camera has a frame".to_owned();
        let panel = |image| Panel { title: "method".into(), image, scores: None };
        let drawn = sheet("a sheet", &truth, &[panel(Ok(&result)), panel(Err(&reason))], 4.0);
        assert_eq!(drawn.width(), 3 * 400 + 4 * 12);
        let count = |v: f32| {
            drawn.data().chunks(3).filter(|p| p.iter().all(|c| (c - v).abs() < 1e-6)).count()
        };
        assert!(count(0.5) >= 400 * 200 && count(0.6) >= 400 * 200 && count(0.4) >= 400 * 200);
    }

    #[test]
    fn large_images_are_reduced_and_no_sheet_is_too_large_for_its_file() {
        let image = Image::from_data(3, 2, 1, vec![0.0, 0.2, 0.4, 0.6, 0.8, 1.0]);
        let half = reduced(&image, 2);
        assert_eq!((half.width(), half.height()), (2, 1));
        assert!((half.data()[0] - 0.4).abs() < 1e-6 && (half.data()[1] - 0.7).abs() < 1e-6);
        for (width, height) in [(2400, 20), (20, 2400), (3, 1921)] {
            let image = Image::filled(width, height, 1, 0.5);
            let truth = TrueImage { image, moving: vec![false; width * height] };
            let panel = || Panel { title: "m".into(), image: Ok(&truth.image), scores: None };
            let drawn = sheet("t", &truth, &[panel(), panel(), panel()], 4.0);
            assert!(drawn.width().max(drawn.height()) < 1 << 13, "{width}×{height}");
        }
    }

    #[test]
    fn identical_and_empty_regions_have_words() {
        let same = Scores { pixels: 4, psnr_db: None, ssim: Some(1.0), flip: Some(0.0) };
        let lines = score_lines(&RegionScores { whole: same, moving: Scores::default() });
        assert_eq!(lines[0], "PSNR  same  moving part     -");
        assert_eq!(lines[1], "SSIM 1.000  moving part     -");
    }

    #[test]
    fn video_frames_are_even() {
        let image = Image::filled(401, 33, 1, 0.5);
        let strip = strip("t", &[("a", &image), ("b", &image)]);
        assert_eq!((strip.width() % 2, strip.height() % 2), (0, 0));
    }
}
