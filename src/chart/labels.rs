//! Placement of text labels next to points, without overlaps.

use super::template::{ADVANCE, TEXT_SIZE};

/// Rectangle on a chart's page: left, top, right and bottom, pixels.
pub(super) type Box4 = [f64; 4];

/// Candidate distances of a label's text from its point, pixels, in the order in which they are tried.
const DISTANCES: [f64; 6] = [7.0, 14.0, 24.0, 36.0, 50.0, 66.0];
/// Number of candidate directions of a label's text from its point, at each candidate distance.
const DIRECTIONS: usize = 16;
/// First candidate direction of a label's text from its point, radians anticlockwise from the right: up and to the
/// left. In a plot of quality over cost, the area up and left of the best points is free.
const FIRST_ANGLE: f64 = 2.4;

fn overlap(a: &Box4, b: &Box4) -> bool {
    a[0] < b[2] && b[0] < a[2] && a[1] < b[3] && b[1] < a[3]
}

/// Returns the rectangle of a text that is `width` pixels wide. The rectangle lies `distance` pixels from the point
/// `at`, in the direction `angle`, radians anticlockwise from the right.
fn text_box(at: [f64; 2], width: f64, angle: f64, distance: f64) -> Box4 {
    let (w, h) = (0.5 * width, 0.5 * TEXT_SIZE);
    let (dx, dy) = (angle.cos(), -angle.sin());
    let x = at[0] + dx * (distance + w);
    let y = at[1] + dy * (distance + h);
    [x - w, y - h, x + w, y + h]
}

/// Chooses a rectangle for the text of each label, next to the label's point. A label is a point and a text. All
/// coordinates are pixels.
///
/// The rectangle is the nearest candidate inside of `frame` that overlaps neither an obstacle nor the rectangle of an
/// earlier text. If there is no such candidate, the first candidate is taken.
pub(super) fn place(labels: &[([f64; 2], &str)], obstacles: &[Box4], frame: &Box4) -> Vec<Box4> {
    let mut taken: Vec<Box4> = obstacles.to_vec();
    labels
        .iter()
        .map(|(at, text)| {
            let width = ADVANCE * text.chars().count() as f64;
            let tried = DISTANCES.iter().flat_map(|distance| {
                (0..DIRECTIONS).map(move |k| {
                    let angle = FIRST_ANGLE + std::f64::consts::TAU * k as f64 / DIRECTIONS as f64;
                    text_box(*at, width, angle, *distance)
                })
            });
            let inside = |b: &Box4| {
                b[0] >= frame[0] && b[1] >= frame[1] && b[2] <= frame[2] && b[3] <= frame[3]
            };
            let clear = |b: &Box4| !taken.iter().any(|t| overlap(t, b));
            let spot = tried
                .clone()
                .find(|b| inside(b) && clear(b))
                .unwrap_or_else(|| text_box(*at, width, FIRST_ANGLE, DISTANCES[0]));
            taken.push(spot);
            spot
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::Random;

    #[test]
    fn texts_cover_neither_texts_nor_points() {
        let mut random = Random::new(5);
        let points: Vec<[f64; 2]> = (0..25)
            .map(|_| [350.0 + 300.0 * random.signed(), 200.0 + 150.0 * random.signed()])
            .collect();
        let labels: Vec<_> = points.iter().map(|p| (*p, "balanced")).collect();
        let dots: Vec<Box4> =
            points.iter().map(|[x, y]| [x - 3.0, y - 3.0, x + 3.0, y + 3.0]).collect();
        let frame = [0.0, 0.0, 700.0, 400.0];
        let boxes = place(&labels, &dots, &frame);
        for (k, a) in boxes.iter().enumerate() {
            assert!(!dots.iter().any(|d| overlap(a, d)), "{k}");
            assert!(!boxes[..k].iter().any(|b| overlap(a, b)), "{k}");
            assert!(a[0] >= 0.0 && a[2] <= 700.0 && a[1] >= 0.0 && a[3] <= 400.0);
        }
    }

    #[test]
    fn a_text_without_room_is_placed_all_the_same() {
        let frame = [0.0, 0.0, 10.0, 10.0];
        assert_eq!(place(&[([5.0, 5.0], "wider than the frame")], &[], &frame).len(), 1);
    }
}
