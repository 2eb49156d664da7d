//! Fig. 1: the array, what traditional and space-time light field rendering make of it, and motion
//! trails.

use crate::Error;
use crate::draw::{BLACK, BLUE, Color, Part, RED, dot, line, magnified};
use crate::page::{Page, Panel};
use crate::scene::{Scene, over_plane};
use crate::synthesis::WAYS;
use nalgebra::{Point2, Vector2};
use stlfr::compare::lettering::{TextStyle, width_px, write};
use stlfr::interpolation::SyncMethod;
use stlfr::light_field::Viewpoint;
use stlfr::light_field::{Context, Request, render};
use stlfr::options::TrailMode;
use stlfr::raster::Image;

/// Size of the panels, pixels.
const SIZE_PX: [usize; 2] = [640, 480];
const LABEL: TextStyle = TextStyle { bold: false, color: [0.15; 3] };
/// Colour of the array's frame.
const STEEL: Color = [0.55, 0.57, 0.6];
/// Instants of a trail between two frames of a camera. Larger: time; smaller: the ball shows as separate images.
const INSTANTS_A_FRAME: usize = 6;
/// Frames that a trail lasts. Larger: beyond the recording; smaller: the trail is as short as the ball.
const TRAIL_FRAMES: usize = 6;

/// The array and its clocks, a waving hand, and the trail of a ball.
pub fn figure_1() -> Result<Page, Error> {
    let (hand, ball) = (Scene::with_true_clocks("hand")?, Scene::with_true_clocks("ball")?);
    let mut top = vec![Panel::new(
        array(&hand),
        "(a) The camera array",
        "eight cameras, 6 cm apart, 30 frames a second",
    )];
    let instant = 1;
    let truth = hand.true_view(instant, "between")?;
    let part = truth.top_of_moving([320, 240]);
    let letters = ["(b) Traditional LFR", "(c) ST-LFR"];
    for ((sync, _), title) in WAYS.into_iter().zip(letters) {
        let options = over_plane(truth.focus_m(), sync);
        let image = hand.view(&truth.camera, hand.instants_s[instant], &options)?;
        top.push(Panel::new(magnified(&image, part, 2), title, truth.score(&image)));
    }
    let mut bottom = vec![Panel::new(
        shutters(&hand, hand.instants_s[instant]),
        "(a) When their shutters open",
        "red: the instant of the pictures above",
    )];
    for ((sync, _), title) in WAYS.into_iter().zip(letters) {
        bottom.push(Panel::new(trail(&ball, sync)?, title, "trail of a swinging ball"));
    }
    Ok(Page {
        rows: vec![top, bottom],
        caption: "Fig. 1. (a) The simulated camera array; its cameras are not synchronized. Pictures \
                  synthesized using (b) traditional LFR and (c) ST-LFR. Bottom: motion trails. Traditional \
                  LFR overlays the instants of one camera's frames; ST-LFR synthesizes those in between."
            .to_owned(),
    })
}

/// The ball's trail in the middle of the array.
fn trail(scene: &Scene, sync: SyncMethod) -> Result<Image, Error> {
    let truth = scene.true_view(0, "between")?;
    let frame_s = scene.capture.frame_s();
    let (_, end_s) = scene.field.common_span_s().ok_or("no common time")?;
    let mut options = over_plane(truth.focus_m(), sync);
    let steps = if sync == SyncMethod::Nearest { 1 } else { INSTANTS_A_FRAME };
    options.trail.instants = TRAIL_FRAMES * steps + 1;
    options.trail.duration_s = TRAIL_FRAMES as f64 * frame_s;
    options.trail.mode = TrailMode::Mean;

    let from = Viewpoint::View(&truth.camera);
    let image =
        render(&scene.field, &Request::new(from, end_s, &options), &Context::unattended())?.image;
    Ok(magnified(&image, Part([150, 130, 320, 240]), 2))
}

/// The cameras from the front, where the calibration has them.
fn array(scene: &Scene) -> Image {
    let [w, h] = SIZE_PX;
    let mut image = Image::filled(w, h, 3, 0.97);
    let reference = &scene.capture.cameras[scene.capture.reference].camera;
    let places: Vec<_> = scene
        .capture
        .cameras
        .iter()
        .map(|c| (&c.id, reference.cam_from_world * c.camera.center()))
        .collect();
    let middle = places.iter().map(|(_, p)| p.x).sum::<f64>() / places.len() as f64;
    let px_per_m = 0.82 * w as f64 / 0.48;
    let y = 0.46 * h as f64;
    let right = w as f64 - 30.0;
    let mut bar = |from: (f64, f64), to: (f64, f64), width_px: f64| {
        let ends = [from, to].map(|(x, below)| Point2::new(x, y + below));
        line(&mut image, ends, STEEL, width_px);
    };
    bar((30.0, 42.0), (right, 42.0), 12.0);
    for foot in [130.0, w as f64 - 130.0] {
        bar((foot, 48.0), (foot, 170.0), 8.0);
        bar((foot - 40.0, 172.0), (foot + 40.0, 172.0), 8.0);
    }
    for (id, place) in places {
        // Seen from the front, the camera on the right is on the left.
        let x = 0.5 * w as f64 - (place.x - middle) * px_per_m;
        draw_camera(&mut image, Point2::new(x, y));
        let left = (x - 0.5 * width_px(id) as f64) as usize;
        write(&mut image, (left, (y - 58.0) as usize), w, id, LABEL);
    }
    image
}

/// A camera from the front, with its lens at a point.
fn draw_camera(image: &mut Image, lens: Point2<f64>) {
    let off = |right: f64, below: f64| lens + Vector2::new(right, below);
    line(image, [off(0.0, 20.0), off(0.0, 40.0)], [0.35; 3], 10.0);
    for row in [-12.0, 0.0, 12.0] {
        line(image, [off(-14.0, row), off(14.0, row)], [0.18, 0.19, 0.22], 26.0);
    }
    for (width_px, color) in
        [(42.0, [0.3, 0.31, 0.35]), (34.0, [0.08; 3]), (24.0, [0.12, 0.2, 0.38]), (10.0, [0.03; 3])]
    {
        dot(image, lens, color, width_px);
    }
    dot(image, off(-6.0, -6.0), [0.75, 0.85, 1.0], 5.0);
}

/// When each camera's shutter opens around an instant, on the reference's clock.
fn shutters(scene: &Scene, instant_s: f64) -> Image {
    const SPAN_S: f64 = 0.11;
    const TICK_MS: f64 = 20.0;
    let start_ms = TICK_MS * ((instant_s - 0.5 * SPAN_S) * 1e3 / TICK_MS).round();
    let start_s = 1e-3 * start_ms;
    let [w, h] = SIZE_PX;
    let mut image = Image::filled(w, h, 3, 0.97);
    let (left, right, top, bottom) = (70.0, w as f64 - 30.0, 40.0, h as f64 - 70.0);
    let x_of = |t: f64| left + (right - left) * (t - start_s) / SPAN_S;
    let at = |x: f64, y: f64| Point2::new(x, y);
    let instant = x_of(instant_s);
    line(&mut image, [at(instant, top - 14.0), at(instant, bottom + 10.0)], RED, 2.0);
    let cameras = scene.capture.cameras.iter().zip(scene.times_s());
    let step = (bottom - top) / (scene.capture.cameras.len() - 1).max(1) as f64;
    for (row, (camera, times_s)) in cameras.enumerate() {
        let y = top + row as f64 * step;
        line(&mut image, [at(left, y), at(right, y)], [0.75; 3], 1.0);
        write(&mut image, (14, y as usize - 8), w, &camera.id, LABEL);
        for t in times_s.iter().flatten().filter(|t| (start_s..start_s + SPAN_S).contains(*t)) {
            dot(&mut image, at(x_of(*t), y), BLUE, 11.0);
        }
    }
    line(&mut image, [at(left, bottom + 22.0), at(right, bottom + 22.0)], BLACK, 1.5);
    for tick in 0..=5 {
        let ms = start_ms + TICK_MS * f64::from(tick);
        let x = x_of(1e-3 * ms);
        line(&mut image, [at(x, bottom + 18.0), at(x, bottom + 26.0)], BLACK, 1.5);
        let label = if tick == 5 { format!("{ms:.0} ms") } else { format!("{ms:.0}") };
        let x = (x - 0.5 * width_px(&label) as f64).min((w - width_px(&label) - 6) as f64);
        write(&mut image, (x as usize, bottom as usize + 32), w, &label, LABEL);
    }
    image
}
