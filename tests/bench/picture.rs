//! Views and synchronized images against the truth, beside what true parts would give and beside other programs.
//!
//! `cargo bench --bench picture -- rig RIG.json OUT.json [--synchronized]` writes the rig with the views that are
//! measured: halfway between the middle cameras, beside that, 12 cm above it, and 12 cm ahead. All shutters are
//! the reference's if wanted.
//!
//! `cargo bench --bench picture -- CAPTURE… [--instants N] [--out DIR]`: filmed captures with `truth/`.
//! Clocks are the true ones. Prints PSNR and FLIP of all pixels whose point some camera sees, and of the moving
//! part among them; for the depths of a view, the median error and the share over 1 px, in pixels of disparity
//! at 6 cm, away from depth edges and within 4 px of them. Pictures of the first instant go to DIR. After several
//! captures, their means.

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

use peers::Python;
use scene::Scene;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use stlfr::capture::{Capture, Truth};
use stlfr::light_field::LightField;
use stlfr::offset::Offsets;
use stlfr::options::RenderOptions;
use stlfr::raster::{BitDepth, Image, write_image};
use summary::Summary;
use truth::True;

type Error = Box<dyn std::error::Error>;

fn write(path: &Path, image: &Image) -> Result<(), Error> {
    std::fs::create_dir_all(path.parent().ok_or("has no folder")?)?;
    Ok(write_image(path, image, None, BitDepth::Eight)?)
}

/// A capture whose clocks are the true ones: this benchmark is about pictures alone.
fn open(folder: &str) -> Result<(LightField, Truth), Error> {
    let capture = Arc::new(Capture::open(folder.as_ref())?);
    let truth = Truth::open(folder.as_ref())?.ok_or("has no truth")?;
    let mut offsets = Offsets::known(&capture);
    for camera in &mut offsets.cameras {
        camera.offset_s = truth.offset_s(&camera.id);
    }
    let field = LightField::new(capture, offsets, &RenderOptions::default().registration);
    Ok((field, truth))
}

/// What is done with every capture.
struct Run {
    instants: usize,
    out: Option<PathBuf>,
    python: Option<Python>,
}

impl Run {
    fn bench(&self, folder: &str, summary: &mut Summary) -> Result<(), Error> {
        let name = Path::new(folder).file_name().unwrap_or_default();
        let out = self.out.as_ref().map(|out| out.join(name));
        summary.begin(&name.to_string_lossy());
        let (field, truth) = open(folder)?;
        let capture = field.capture();
        let mut times: Vec<f64> = truth.views.iter().map(|v| v.time_s).collect();
        times.dedup();
        for (n, &time) in times.iter().take(self.instants).enumerate() {
            let at = || truth.views.iter().filter(move |v| v.time_s == time);
            let like =
                |id: &str| at().find(|v| v.like.as_deref() == Some(id)).ok_or("lacks a camera");
            let cameras: Result<Vec<True>, Error> =
                capture.cameras.iter().map(|c| True::read(&truth, like(&c.id)?)).collect();
            println!("{folder} at {time:.4} s: PSNR of all that is seen, of its moving part");
            let at_s = time - capture.time_origin_s;
            let scene = Scene::new(&field, at_s, cameras?, self.python.as_ref())?;
            scene.print_synchronized(summary);
            for view in at().filter(|v| v.like.is_none()) {
                let out = out.as_deref().filter(|_| n == 0);
                scene.print_view(&True::read(&truth, view)?, out, summary)?;
            }
        }
        Ok(())
    }
}

fn main() -> Result<(), Error> {
    let arguments: Vec<String> = std::env::args().skip(1).filter(|a| a != "--bench").collect();
    if let [command, from, to, rest @ ..] = &arguments[..]
        && command == "rig"
    {
        return rig::write(from, to, rest.iter().any(|a| a == "--synchronized"));
    }
    let (mut folders, mut instants, mut out) = (Vec::new(), usize::MAX, None);
    let mut args = arguments.into_iter();
    while let Some(arg) = args.next() {
        match arg.as_str() {
            "--instants" => instants = args.next().ok_or("--instants lacks a number")?.parse()?,
            "--out" => out = Some(PathBuf::from(args.next().ok_or("--out lacks a folder")?)),
            _ => folders.push(arg),
        }
    }
    let run = Run { instants, out, python: Python::find() };
    let mut summary = Summary::default();
    for folder in &folders {
        run.bench(folder, &mut summary)?;
    }
    summary.print();
    Ok(())
}
