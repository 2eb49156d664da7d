//! Figs. 5, 6, 7, 9 and 10: the paper's temporal interpolation, part by part.

use crate::Error;
use crate::draw::{BLUE, Part, RED, YELLOW, arrow, dot, line, magnified, pale};
use crate::page::{Page, Panel};
use crate::scene::{Clocks, Scene, TrueView};
use std::sync::Arc;
use stlfr::capture::FrameTimes;
use stlfr::interpolation::{
    EDGE_BOOST, Edge, EdgeFeature, InterpolationOptions, RowFractions, SyncMethod, cross_dissolve,
    edge_set, morph_warp, real_edges,
};
use stlfr::options::RenderOptions;
use stlfr::raster::Image;
use stlfr::registration::{
    Frame, RegistrationOptions, Track, Verdict, epipolar_check, temporal_flow,
};

/// The magazine in the filming cameras' images.
const MAGAZINE: Part = Part([105, 100, 330, 270]);

/// A camera of the magazine's recording, halfway between two of its frames.
struct Pair {
    scene: Scene,
    camera: usize,
    /// The earlier frame.
    k: usize,
    time_s: f64,
    truth: TrueView,
}

/// Corners a frame. Larger: the mismatches drown in right matches, and the schemes hardly differ; smaller: the
/// magazine has too few real edges.
const CORNERS: usize = 1500;
/// Registration as in the paper: forward and backward flow, whose mismatches the epipolar test alone removes.
fn papers_registration(epipolar_test: bool) -> RegistrationOptions {
    RegistrationOptions {
        max_corners: CORNERS,
        consistency_checks: false,
        epipolar_test,
        ..RegistrationOptions::default()
    }
}

/// Interpolation as in the paper, on straight lines; but all features are vertices of the edge set.
fn papers_interpolation() -> InterpolationOptions {
    InterpolationOptions { curved: false, ..InterpolationOptions::default() }
}

impl Pair {
    fn open(epipolar_test: bool) -> Result<Self, Error> {
        let scene = Scene::open("magazine", Clocks::True, &papers_registration(epipolar_test))?;
        let time_s = scene.instants_s[0];
        let (camera, k) = scene.farthest_from_frames(time_s).ok_or("no camera has two frames")?;
        let truth = scene.true_view(0, &scene.capture.cameras[camera].id)?;
        Ok(Self { scene, camera, k, time_s, truth })
    }

    fn frames(&self) -> Result<[Arc<Frame>; 2], Error> {
        let frame =
            |k| self.scene.field.frames(&RegistrationOptions::default()).get(self.camera, k);
        Ok([frame(self.k)?, frame(self.k + 1)?])
    }

    fn tracks(&self) -> Result<Arc<Vec<Track>>, Error> {
        Ok(self.scene.field.tracks(self.camera, self.k, &RegistrationOptions::default())?)
    }

    fn times_s(&self) -> Result<Vec<f64>, Error> {
        self.scene.times_s()[self.camera].clone().ok_or_else(|| "unknown clock".into())
    }

    /// The features of the forward or the backward flow.
    fn features(&self, forward: bool) -> Result<Vec<EdgeFeature>, Error> {
        let times_s = self.times_s()?;
        let tracks = self.tracks()?;
        let of_set = |t: &&Track| if forward { t.in_forward_set() } else { t.in_backward_set() };
        let feature = |t: &Track| {
            let straight = Track { before: None, after: None, ..t.clone() };
            let target = straight.trajectory(FrameTimes::global(&times_s), self.k)?.at(self.time_s);
            let (source, other) = if forward { (t.earlier, t.later) } else { (t.later, t.earlier) };
            Some(EdgeFeature { source, other, target })
        };
        Ok(tracks.iter().filter(of_set).filter_map(feature).collect())
    }

    /// The edge set of the earlier (`forward`) or the later frame.
    fn edges(&self, forward: bool) -> Result<Vec<Edge>, Error> {
        let [earlier, later] = self.frames()?;
        let (source, other) = if forward { (&earlier, &later) } else { (&later, &earlier) };
        let (w, h) = (source.image.width(), source.image.height());
        let features = self.features(forward)?;
        let [source, other] = [source, other].map(|f| &f.pyramid.levels[0]);
        let real = real_edges(&features, source, other, papers_interpolation().max_edge_length_px);
        Ok(edge_set(&features, &real, w, h))
    }

    /// The morph by some of the edges.
    fn morphed(&self, virtual_edges: bool) -> Result<Image, Error> {
        let [earlier, later] = self.frames()?;
        let times_s = self.times_s()?;
        let [start, end] = [times_s[self.k], times_s[self.k + 1]];
        let (w, h) = (earlier.image.width(), earlier.image.height());
        let warp = |forward: bool| -> Result<_, Error> {
            let mut edges = self.edges(forward)?;
            edges.retain(|e| virtual_edges || e.mean_fitness.is_some());
            Ok(morph_warp(&edges, [w, h], EDGE_BOOST, papers_interpolation().grid_px))
        };
        let fraction = RowFractions::constant((self.time_s - start) / (end - start));
        let images = [&earlier.image, &later.image];
        Ok(cross_dissolve(images, [&warp(true)?, &warp(false)?], fraction, None))
    }

    /// The camera's image at the instant by a method, with the paper's options.
    fn synchronized(&self, sync: SyncMethod) -> Result<Image, Error> {
        let options = RenderOptions {
            interpolation: papers_interpolation(),
            ..RenderOptions { sync, ..RenderOptions::default() }
        };
        Ok(self.scene.field.synchronized(self.camera, self.time_s, &options)?.image.clone())
    }

    fn panel(&self, image: &Image, title: &str) -> Panel {
        Panel::new(magnified(image, MAGAZINE, 2), title, self.truth.score(image))
    }
}

/// The gradient's magnitude, and the real edges.
pub fn figure_5() -> Result<Page, Error> {
    let pair = Pair::open(true)?;
    let [frame, _] = pair.frames()?;
    let level = &frame.pyramid.levels[0];
    let magnitude = (0..level.width * level.height).map(|k| {
        let (gx, gy) = level.gradient(k % level.width, k / level.width);
        (4.0 * gx.hypot(gy)).min(1.0)
    });
    let gradients = Image::from_data(level.width, level.height, 1, magnitude.collect());
    let mut drawn = magnified(&pale(&frame.image), MAGAZINE, 2);
    let edges = pair.edges(true)?;
    for edge in edges.iter().filter(|e| e.mean_fitness.is_some()) {
        draw_edge(&mut drawn, edge, BLUE, 1.5);
    }
    let count = edges.iter().filter(|e| e.mean_fitness.is_some()).count();
    Ok(Page {
        rows: vec![vec![
            Panel::new(magnified(&gradients, MAGAZINE, 2), "(a) Gradient magnitude", ""),
            Panel::new(drawn, "(b) Real feature edges (blue)", format!("{count} in the frame")),
        ]],
        caption: "Fig. 5. Real feature edges. (a) The gradient magnitude map. (b) EdgeFeature edges detected by \
                  testing feature points pairwise, one a contour."
            .to_owned(),
    })
}

/// The flow before and after the epipolar test.
pub fn figure_6() -> Result<Page, Error> {
    let pair = Pair::open(true)?;
    let [frame, _] = pair.frames()?;
    let frames = &pair.scene.field.frames(&RegistrationOptions::default());
    let tracks = temporal_flow(frames, pair.camera, pair.k)?;
    let verdicts = epipolar_check(frames, &pair.scene.times_s(), pair.camera, pair.k, &tracks)?;
    let base = magnified(&pale(&frame.image), MAGAZINE, 2);
    let (mut before, mut after) = (base.clone(), base);
    let mut rejected = 0;
    for (track, verdict) in tracks.iter().zip(&verdicts) {
        let ends = [track.earlier, track.later].map(|p| within(p, 2.0));
        let is_wrong = *verdict == Verdict::Rejected;
        rejected += usize::from(is_wrong);
        arrow(&mut before, ends, if is_wrong { RED } else { BLUE }, 1.2);
        if !is_wrong {
            arrow(&mut after, ends, BLUE, 1.2);
        }
    }
    Ok(Page {
        rows: vec![vec![
            Panel::new(before, "(a) Before the epipolar test", format!("{} tracks", tracks.len())),
            Panel::new(after, "(b) After it", format!("{rejected} rejected, red in (a)")),
        ]],
        caption:
            "Fig. 6. The optical flow between two frames, (a) before and (b) after applying the \
                  epipolar constraint."
                .to_owned(),
    })
}

/// The edge set.
pub fn figure_7() -> Result<Page, Error> {
    let pair = Pair::open(true)?;
    let [frame, _] = pair.frames()?;
    let mut drawn = magnified(&pale(&frame.image), Part([0, 0, 640, 480]), 2);
    let edges = pair.edges(true)?;
    for (real, color) in [(false, YELLOW), (true, BLUE)] {
        for edge in edges.iter().filter(|e| e.mean_fitness.is_some() == real) {
            let ends = edge.ends.map(|f| f.source * 2.0);
            line(&mut drawn, ends, color, 1.4);
            if real {
                ends.iter().for_each(|p| dot(&mut drawn, *p, color, 3.0));
            }
        }
    }
    let real = edges.iter().filter(|e| e.mean_fitness.is_some()).count();
    let note = format!("{real} real edges (blue), {} virtual edges (yellow)", edges.len() - real);
    Ok(Page {
        rows: vec![vec![Panel::new(drawn, note, "")]],
        caption: "Fig. 7. The edge map constructed after constrained Delaunay triangulation."
            .to_owned(),
    })
}

/// Interpolation without and with virtual edges.
pub fn figure_9() -> Result<Page, Error> {
    let pair = Pair::open(true)?;
    Ok(Page {
        rows: vec![vec![
            pair.panel(&pair.morphed(false)?, "(a) Without virtual feature edges"),
            pair.panel(&pair.morphed(true)?, "(b) With virtual feature edges"),
            Panel::new(magnified(&pair.truth.image, MAGAZINE, 2), "Truth", ""),
        ]],
        caption:
            "Fig. 9. Interpolation result (a) without and (b) with virtual feature edges, halfway \
                  between two frames of one camera."
                .to_owned(),
    })
}

/// Interpolation by four schemes.
pub fn figure_10() -> Result<Page, Error> {
    let (untested, tested) = (Pair::open(false)?, Pair::open(true)?);
    let schemes = [
        (&untested, SyncMethod::EdgeMorph, "(a) Image morphing without epipolar test"),
        (&tested, SyncMethod::Triangulation, "(b) Direct image triangulation with epipolar test"),
        (
            &tested,
            SyncMethod::Morph,
            "(c) Image morphing with epipolar test, without extra edge weights",
        ),
        (
            &tested,
            SyncMethod::EdgeMorph,
            "(d) Image morphing with epipolar test and extra edge weights",
        ),
    ];
    let mut panels = Vec::new();
    for (pair, sync, title) in schemes {
        panels.push(pair.panel(&pair.synchronized(sync)?, title));
    }
    let second = panels.split_off(2);
    Ok(Page {
        rows: vec![panels, second],
        caption: "Fig. 10. The interpolated result using different schemes, halfway between two frames of \
                  one camera."
            .to_owned(),
    })
}

/// Where a point of the frame is in the magnified magazine.
fn within(p: nalgebra::Point2<f64>, factor: f64) -> nalgebra::Point2<f64> {
    let [left, top, ..] = MAGAZINE.0;
    (p - nalgebra::Vector2::new(left as f64, top as f64)) * factor
}

fn draw_edge(image: &mut Image, edge: &Edge, color: crate::draw::Color, width_px: f64) {
    line(image, edge.ends.map(|f| within(f.source, 2.0)), color, width_px);
}
