//! Steadiness of views: a slow pan along the rig at one instant, and a slow scrub through time from one place.
//!
//! What is smooth in the truth must be smooth in the views. Printed are the largest jumps from a picture to the
//! next beside the truth's, and how much the parts flicker in which nothing happens.

use super::rig::PAN;
use super::{Error, open, write};
use nalgebra::Vector3;
use std::path::{Path, PathBuf};
use stlfr::camera::Camera;
use stlfr::capture::Truth;
use stlfr::light_field::LightField;
use stlfr::options::RenderOptions;
use stlfr::raster::{BitDepth, Image, read_image};
use stlfr::toolchain::find_ffmpeg;
use stlfr::video::{Codec, VideoFormat, VideoWriter};

/// Pictures of a sequence without truth.
const STEPS: usize = 100;
/// Side of the blocks among which the worst is looked for, pixels. Larger: a small flicker is averaged away;
/// smaller: noise decides.
const BLOCK_PX: usize = 16;
/// Largest change of a pixel over all of a true sequence that counts as none: a level and a half of 8 bits.
const STILL: f32 = 1.5 / 255.0;
/// Distance that still pixels keep from others, pixels: the reach of what moves in its surroundings.
const MARGIN_PX: usize = 2;
/// Pictures a second of the videos.
const RATE_HZ: f64 = 25.0;

/// Where from and when each picture of a sequence is taken.
struct Sequence {
    name: &'static str,
    cameras: Vec<Camera>,
    times_s: Vec<f64>,
    /// True pictures, if they were filmed.
    truth: Option<Vec<Image>>,
}

/// What is measured, and how.
pub struct Flicker {
    /// As in the program's option files.
    pub options: RenderOptions,
    /// The folder of videos and pictures.
    pub out: Option<PathBuf>,
}

impl Flicker {
    pub fn bench(&self, folder: &str) -> Result<(), Error> {
        let (field, truth) = open(folder)?;
        println!(
            "{folder}: the jumps between successive pictures that are most beyond the truth's,"
        );
        println!(
            "RMS in levels of 255; PSNR of the steps; and of the parts in which nothing happens, dB"
        );
        println!(
            "| sequence | whole | the truth's | {BLOCK_PX}×{BLOCK_PX} block | the truth's | steps | still parts |"
        );
        println!("|---|---|---|---|---|---|---|");
        for sequence in [pan(&field, &truth)?, scrub(&field, &truth)?] {
            let options = self.options.clone();
            let shots = sequence.cameras.iter().zip(&sequence.times_s);
            let views: Result<Vec<Image>, _> =
                shots.map(|(c, t)| Ok(field.view(c, *t, &options)?.image)).collect();
            let views: Result<_, Error> = views;
            let views = views?;
            print(&sequence, &views);
            if let Some(out) = &self.out {
                let name = Path::new(folder).file_name().unwrap_or_default();
                save(&out.join(name), &sequence, &views)?;
            }
        }
        Ok(())
    }
}

/// A sequence along the rig at the truth's first instant: of the filmed truth, else of [`STEPS`].
fn pan(field: &LightField, truth: &Truth) -> Result<Sequence, Error> {
    let capture = field.capture();
    let time_s = truth.views.first().ok_or("the truth has no views")?.time_s;
    let filmed: Vec<_> = truth
        .views
        .iter()
        .filter(|v| {
            v.time_s == time_s && v.id.split('-').nth(1).is_some_and(|n| n.starts_with(PAN))
        })
        .collect();
    let mut images = Vec::new();
    let mut cameras = Vec::new();
    for view in &filmed {
        cameras.push(view.camera.camera()?);
        images.push(read_image(&truth.file(&view.image)?)?.0);
    }
    if filmed.is_empty() {
        let [left, right] = ends(field);
        let at = |k: usize| {
            let share = 0.25 + 0.5 * k as f64 / (STEPS - 1) as f64;
            let mut camera = left.clone();
            camera.cam_from_world = left.cam_from_world.lerp_slerp(&right.cam_from_world, share);
            camera
        };
        cameras = (0..STEPS).map(at).collect();
    }
    let times_s = vec![time_s - capture.time_origin_s; cameras.len()];
    let truth = (!images.is_empty()).then_some(images);
    Ok(Sequence { name: "pan", cameras, times_s, truth })
}

/// The two cameras that are farthest apart.
fn ends(field: &LightField) -> [Camera; 2] {
    let cameras = || field.capture().cameras.iter().map(|c| &c.camera);
    let pairs = cameras().flat_map(|a| cameras().map(move |b| [a, b]));
    let apart = |[a, b]: &[&Camera; 2]| Vector3::norm(&(a.center() - b.center()));
    let farthest = pairs.max_by(|a, b| apart(a).total_cmp(&apart(b)));
    farthest.expect("a capture has cameras").map(Clone::clone)
}

/// A sequence through time from the true video's viewpoint, else from the first true view.
fn scrub(field: &LightField, truth: &Truth) -> Result<Sequence, Error> {
    let origin_s = field.capture().time_origin_s;
    if let Some(video) = &truth.video {
        let mut images = Vec::new();
        for k in 0..video.times_s.len() {
            let file = video.images.replace("%04d", &format!("{k:04}"));
            images.push(read_image(&truth.file(&file)?)?.0);
        }
        return Ok(Sequence {
            name: "scrub",
            cameras: vec![video.camera.camera()?; images.len()],
            times_s: video.times_s.iter().map(|t| t - origin_s).collect(),
            truth: Some(images),
        });
    }
    let view = truth.views.iter().find(|v| v.like.is_none()).ok_or("the truth has no views")?;
    let (first, last) = field.common_span_s().ok_or("no instant is common to all cameras")?;
    let time = |k: usize| first + (last - first) * (k as f64 + 0.5) / STEPS as f64;
    Ok(Sequence {
        name: "scrub",
        cameras: vec![view.camera.camera()?; STEPS],
        times_s: (0..STEPS).map(time).collect(),
        truth: None,
    })
}

/// Mean squared difference of two pictures at each pixel.
fn squared(a: &Image, b: &Image) -> Vec<f32> {
    let n = a.channels();
    let pixels = a.data().chunks(n).zip(b.data().chunks(n));
    pixels
        .map(|(a, b)| a.iter().zip(b).map(|(a, b)| (a - b).powi(2)).sum::<f32>() / n as f32)
        .collect()
}

/// Means of squares over blocks, row by row of blocks; incomplete ones are left out.
fn blocks(squares: &[f32], width: usize, side: usize) -> Vec<f64> {
    let (columns, rows) = (width / side, squares.len() / width / side);
    let mut sums = vec![0.0; columns * rows];
    for (k, v) in squares.iter().enumerate() {
        let (x, y) = (k % width / side, k / width / side);
        if x < columns && y < rows {
            sums[y * columns + x] += f64::from(*v);
        }
    }
    sums.iter().map(|s| s / (side * side) as f64).collect()
}

/// Of each step, the RMS difference of the two pictures, over blocks or over all.
fn jumps(images: &[Image], side: Option<usize>) -> Vec<Vec<f64>> {
    let of = |pair: &[Image]| {
        let squares = squared(&pair[0], &pair[1]);
        let means = match side {
            Some(side) => blocks(&squares, pair[0].width(), side),
            None => {
                vec![squares.iter().map(|v| f64::from(*v)).sum::<f64>() / squares.len() as f64]
            }
        };
        means.into_iter().map(f64::sqrt).collect()
    };
    images.windows(2).map(of).collect()
}

/// A jump where views jump most beyond the truth, or at all if there is none.
struct Jump {
    step: usize,
    block: usize,
    rms: f64,
    due: Option<f64>,
}

fn worst(views: &[Image], truth: Option<&[Image]>, side: Option<usize>) -> Jump {
    let (own, due) = (jumps(views, side), truth.map(|truth| jumps(truth, side)));
    let all = own.iter().enumerate().flat_map(|(step, blocks)| {
        let due = due.as_ref();
        blocks.iter().enumerate().map(move |(block, &rms)| {
            let due = due.map(|due| due[step][block]);
            Jump { step, block, rms, due }
        })
    });
    let beyond = |j: &Jump| j.rms - j.due.unwrap_or(0.0);
    all.max_by(|a, b| beyond(a).total_cmp(&beyond(b))).expect("a sequence has steps")
}

/// Pixels that never change in a sequence, away from those that do.
fn still(images: &[Image]) -> Vec<bool> {
    let (w, h, n) = (images[0].width(), images[0].height(), images[0].channels());
    let mut range = vec![[f32::MAX, f32::MIN]; w * h * n];
    for image in images {
        for ([low, high], v) in range.iter_mut().zip(image.data()) {
            (*low, *high) = (low.min(*v), high.max(*v));
        }
    }
    let changes: Vec<f32> =
        range.chunks(n).map(|p| p.iter().map(|[l, h]| h - l).fold(0.0, f32::max)).collect();
    let moving = stlfr::metrics::moving_part(&changes, w, STILL, MARGIN_PX);
    moving.iter().map(|m| !m).collect()
}

/// PSNR over all steps and counted pixels: of the steps beside the truth's, or beside none.
fn flicker_db(images: &[Image], truth: Option<&[Image]>, counts: Option<&[bool]>) -> f64 {
    let (mut sum, mut n) = (0.0, 0.0);
    for step in 0..images.len() - 1 {
        let change =
            |images: &[Image], k: usize| images[step + 1].data()[k] - images[step].data()[k];
        let channels = images[0].channels();
        for k in 0..images[0].data().len() {
            if counts.is_none_or(|c| c[k / channels]) {
                let due = truth.map_or(0.0, |truth| change(truth, k));
                sum += f64::from(change(images, k) - due).powi(2);
                n += 1.0;
            }
        }
    }
    -10.0 * (sum / n).log10()
}

fn print(sequence: &Sequence, views: &[Image]) {
    let truth = sequence.truth.as_deref();
    let [whole, block] = [None, Some(BLOCK_PX)].map(|side| worst(views, truth, side));
    let columns = views[0].width() / BLOCK_PX;
    let [x, y] = [block.block % columns, block.block / columns].map(|v| v * BLOCK_PX);
    let figure = |value: Option<f64>, digits: usize| {
        value.filter(|v| v.is_finite()).map_or("-".to_owned(), |v| format!("{v:.digits$}"))
    };
    let levels = |value: Option<f64>| figure(value.map(|v| 255.0 * v), 1);
    let steps_db = truth.map(|truth| flicker_db(views, Some(truth), None));
    let still_db = truth.map(|truth| flicker_db(views, None, Some(&still(truth))));
    println!(
        "| {} | {}, step {} | {} | {}, step {} at ({x}, {y}) | {} | {} | {} |",
        sequence.name,
        levels(Some(whole.rms)),
        whole.step,
        levels(whole.due),
        levels(Some(block.rms)),
        block.step,
        levels(block.due),
        figure(steps_db, 1),
        figure(still_db, 1),
    );
}

/// A video of a sequence, beside the truth, and slices of it: three rows of the pictures, from top to bottom over
/// the steps.
fn save(out: &Path, sequence: &Sequence, views: &[Image]) -> Result<(), Error> {
    let pictures: Vec<Image> = (0..views.len())
        .map(|k| match &sequence.truth {
            Some(truth) => beside(&views[k], &truth[k]),
            None => views[k].clone(),
        })
        .collect();
    let height = pictures[0].height();
    for (name, row) in [("upper", height / 4), ("middle", height / 2), ("lower", 3 * height / 4)] {
        let data = pictures.iter().flat_map(|p| p.row(row).to_vec()).collect();
        let slice =
            Image::from_data(pictures[0].width(), pictures.len(), pictures[0].channels(), data);
        write(&out.join(format!("{}-{name}.png", sequence.name)), &slice)?;
    }
    let Some(ffmpeg) = find_ffmpeg() else {
        println!("The video is left out: there is no ffmpeg.");
        return Ok(());
    };
    let codec = Codec::for_browsers(&ffmpeg)?;
    let format = VideoFormat { depth: BitDepth::Eight, rate_hz: RATE_HZ, codec };
    let path = out.join(format!("{}.{}", sequence.name, codec.suffix()));
    let mut video = VideoWriter::create(&ffmpeg, &path, &pictures[0], format)?;
    for picture in &pictures {
        video.push(picture)?;
    }
    video.finish()?;
    println!("{}", path.display());
    Ok(())
}

fn beside(left: &Image, right: &Image) -> Image {
    let rows = (0..left.height()).flat_map(|y| [left.row(y), right.row(y)]);
    let data = rows.flatten().copied().collect();
    Image::from_data(left.width() + right.width(), left.height(), left.channels(), data)
}
