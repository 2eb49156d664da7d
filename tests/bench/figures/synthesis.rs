//! Figs. 14, 15 and 24: views by traditional and by space-time light field rendering.

use crate::Error;
use crate::draw::{BLACK, Part, magnified, rectangle};
use crate::page::{Page, Panel};
use crate::scene::{Clocks, Scene, over_plane};
use stlfr::interpolation::SyncMethod;
use stlfr::lumigraph::BlendMethod;
use stlfr::registration::RegistrationOptions;

/// The two ways, with their letters.
pub const WAYS: [(SyncMethod, &str); 2] = [
    (SyncMethod::Nearest, "(a) Traditional LFR, nearest frames"),
    (SyncMethod::Refined, "(b) ST-LFR"),
];

/// The magazine, all cameras at equal weights: whole, and its text.
pub fn figure_14() -> Result<Page, Error> {
    const TEXT: Part = Part([180, 140, 160, 120]);
    let scene = Scene::with_true_clocks("magazine")?;
    let truth = scene.true_view(0, "between")?;
    let mut panels = Vec::new();
    for (sync, title) in WAYS {
        let mut options = over_plane(truth.focus_m(), sync);
        options.blend.method = BlendMethod::Uniform;
        let image = scene.view(&truth.camera, scene.instants_s[0], &options)?;
        panels.push((image.clone(), title, truth.score(&image)));
    }
    panels.push((truth.image.clone(), "Truth", String::new()));
    let marked = |(image, ..): &(_, _, _)| {
        let mut image: stlfr::raster::Image = Clone::clone(image);
        rectangle(&mut image, TEXT, BLACK, 2.0);
        Panel::new(magnified(&image, Part([140, 100, 320, 270]), 2), "", "")
    };
    let whole = panels.iter().map(marked).collect();
    let text = panels
        .iter()
        .map(|(image, title, note)| Panel::new(magnified(image, TEXT, 4), *title, note));
    let text = text.collect();
    Ok(Page {
        rows: vec![whole, text],
        caption: "Fig. 14. Results with a uniform blending weight: pixels from all eight cameras are \
                  averaged, over a plane in focus on the moving magazine. Below: the marked part, magnified."
            .to_owned(),
    })
}

/// The book, from several places.
pub fn figure_15() -> Result<Page, Error> {
    const SIZE_PX: [usize; 2] = [320, 260];
    let scene = Scene::with_true_clocks("book")?;
    let mut rows = Vec::new();
    for (instant, id, place) in [
        (0, "between", "middle of the array"),
        (0, "side", "12 cm to the left"),
        (1, "ahead", "12 cm ahead"),
    ] {
        let truth = scene.true_view(instant, id)?;
        let part = truth.around_moving(SIZE_PX);
        let mut row = Vec::new();
        for (sync, title) in WAYS {
            let options = over_plane(truth.focus_m(), sync);
            let image = scene.view(&truth.camera, scene.instants_s[instant], &options)?;
            row.push(Panel::new(magnified(&image, part, 2), title, truth.score(&image)));
        }
        row.push(Panel::new(magnified(&truth.image, part, 2), "Truth", place));
        rows.push(row);
    }
    Ok(Page {
        rows,
        caption: "Fig. 15. The open book from three places: (a) traditional LFR with unsynchronized frames, \
                  (b) ST-LFR. Both over a plane in focus on the book."
            .to_owned(),
    })
}

/// The ball, with offsets estimated from the pixels alone.
pub fn figure_24() -> Result<Page, Error> {
    const BALL: Part = Part([200, 110, 320, 240]);
    let scene = Scene::open("ball", Clocks::Estimated, &RegistrationOptions::default())?;
    let errors = scene.field.offsets().cameras.iter().filter_map(|c| {
        Some((c.offset_s? - scene.truth.offset_s(&c.id)?).abs() / scene.capture.frame_s())
    });
    let worst = errors.fold(0.0, f64::max);
    let mut rows = Vec::new();
    for instant in [0, scene.instants_s.len() - 1] {
        let truth = scene.true_view(instant, "between")?;
        let mut row = Vec::new();
        for (sync, title) in WAYS {
            let options = over_plane(truth.focus_m(), sync);
            let image = scene.view(&truth.camera, scene.instants_s[instant], &options)?;
            row.push(Panel::new(magnified(&image, BALL, 2), title, truth.score(&image)));
        }
        row.push(Panel::new(magnified(&truth.image, BALL, 2), "Truth", ""));
        rows.push(row);
    }
    Ok(Page {
        rows,
        caption: format!(
            "Fig. 24. The toy ball. The recording has no common time stamps: offsets are estimated from the \
             pixels alone, the worst {worst:.4} frame from the truth. (a) Traditional LFR with \
             unsynchronized frames. (b) ST-LFR with the estimated offsets. Both over a plane."
        ),
    })
}
