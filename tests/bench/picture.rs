//! Views and synchronized images against the truth, beside what true parts would give.
//!
//! `cargo bench --bench picture -- rig RIG.json OUT.json` writes the rig with the views that are measured:
//! halfway between the middle cameras, beside that, 12 cm above it, and 12 cm ahead.
//!
//! `cargo bench --bench picture -- CAPTURE… [--instants N] [--out DIR]`: filmed captures with `truth/`.
//! Clocks are the true ones. Prints PSNR of all pixels whose point some camera sees, and of the moving part
//! among them; for the depths of a view, the median error and the share over 1 px, in pixels of disparity
//! at 6 cm, away from depth edges and within 4 px of them. Pictures of the first instant go to DIR.

use nalgebra::Point2;
use serde_json::{Value, json};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use stlfr::camera::Camera;
use stlfr::capture::{Capture, Truth, TruthView, read_array};
use stlfr::interpolation::{SyncMethod, Synchronized};
use stlfr::light_field::{Geometry, LightField};
use stlfr::lumigraph::{BlendMethod, DepthMap};
use stlfr::metrics::moving_part;
use stlfr::offset::Offsets;
use stlfr::options::{ProxyMethod, RenderOptions, ViewOptions};
use stlfr::raster::{BitDepth, Image, read_image, write_image};

type Error = Box<dyn std::error::Error>;

/// Distance of two cameras, metres, whose disparity depth errors are stated in.
const BASELINE_M: f32 = 0.06;
/// A jump of disparity over this is a depth edge, pixels; what is within [`EDGE_PX`] of it is at the edge.
const JUMP_PX: f32 = 2.0;
const EDGE_PX: usize = 4;

/// One true image, with its depths and its moving part.
struct True {
    id: String,
    camera: Camera,
    image: Image,
    depth: DepthMap,
    moving: Vec<bool>,
}

impl True {
    fn read(truth: &Truth, view: &TruthView) -> Result<Self, Error> {
        let (width, height, depths) = read_array(&truth.file(&view.depth)?)?;
        let (w, _, motion) = read_array(&truth.file(&view.motion)?)?;
        Ok(Self {
            id: view.id.clone(),
            camera: view.camera()?,
            image: read_image(&truth.file(&view.image)?)?.0,
            depth: DepthMap::from_data(width, height, depths),
            moving: moving_part(&motion, w, 0.5, 2),
        })
    }

    /// The pixels whose point is visible in the image of some camera.
    fn seen(&self, cameras: &[Self]) -> Vec<bool> {
        let w = self.camera.width;
        let is_seen = |(k, z): (usize, &f32)| {
            let pixel = Point2::new((k % w) as f64 + 0.5, (k / w) as f64 + 0.5);
            let Some(ray) = self.camera.ray_world(&pixel) else { return false };
            let point = self.camera.center() + ray * f64::from(*z);
            cameras.iter().any(|c| {
                let Some(p) = c.camera.project(&point) else { return false };
                let z = (c.camera.cam_from_world * point).z;
                let surface = |p: Point2<f64>| c.depth.row(p.y as usize)[p.x as usize];
                c.camera.contains(&p) && z < 1.03 * f64::from(surface(p))
            })
        };
        self.depth.data().iter().enumerate().map(is_seen).collect()
    }
}

fn psnr_db(a: &Image, b: &Image, mask: &[bool]) -> f64 {
    let (mut sum, mut n) = (0.0, 0.0);
    for ((a, b), _) in
        a.data().chunks(3).zip(b.data().chunks(3)).zip(mask).filter(|(_, counts)| **counts)
    {
        sum += a.iter().zip(b).map(|(a, b)| f64::from(a - b).powi(2)).sum::<f64>();
        n += 3.0;
    }
    -10.0 * (sum / f64::max(n, 1.0)).log10()
}

/// Median error and share over 1 px, away from depth edges and at them.
fn depth_errors(found: &DepthMap, truth: &True) -> String {
    let px = truth.camera.focal_px() as f32 * BASELINE_M;
    let (w, h) = (found.width(), found.height());
    let disparity = |map: &DepthMap, x: usize, y: usize| px / map.row(y)[x];
    let (mut edge, mut away) = (Vec::new(), Vec::new());
    for y in 0..h {
        for x in 0..w {
            let own = disparity(&truth.depth, x, y);
            let mut jump: f32 = 0.0;
            for v in y.saturating_sub(EDGE_PX)..(y + EDGE_PX + 1).min(h) {
                for u in x.saturating_sub(EDGE_PX)..(x + EDGE_PX + 1).min(w) {
                    jump = jump.max((disparity(&truth.depth, u, v) - own).abs());
                }
            }
            let error = (disparity(found, x, y) - own).abs();
            // A pixel without depth is wrong by any measure.
            let error = if error.is_nan() { f32::INFINITY } else { error };
            if jump > JUMP_PX { edge.push(error) } else { away.push(error) }
        }
    }
    let figures = |errors: &mut Vec<f32>| {
        errors.sort_by(f32::total_cmp);
        let Some(median) = errors.get(errors.len() / 2) else { return "none".to_owned() };
        let over = errors.iter().filter(|e| **e > 1.0).count() as f64 / errors.len() as f64;
        format!("{median:5.3} px, {:4.1} %", 100.0 * over)
    };
    format!("away from edges {}; at edges {}", figures(&mut away), figures(&mut edge))
}

/// Everything of one instant.
struct Scene<'a> {
    field: &'a LightField,
    options: ViewOptions,
    time_s: f64,
    cameras: Vec<True>,
    /// Of all cameras: true, from the nearest frames, and synchronized.
    filmed: Vec<Option<Synchronized>>,
    nearest: Vec<Option<Synchronized>>,
    refined: Vec<Option<Synchronized>>,
}

/// One line of the table.
type Row<'a> = (&'a str, &'a [Option<Synchronized>], &'a Geometry, BlendMethod);

impl<'a> Scene<'a> {
    fn new(field: &'a LightField, time_s: f64, cameras: Vec<True>) -> Result<Self, Error> {
        let options = RenderOptions::default().view();
        let mut timed = options.clone();
        timed.blend.method = BlendMethod::SpaceTime;
        let by = |sync| field.synchronized_all(time_s, &timed.clone().with_sync(sync));
        let (nearest, refined) = (by(SyncMethod::Nearest)?, by(SyncMethod::Refined)?);
        let filmed = cameras.iter().map(|t| Some(Synchronized::filmed(t.image.clone()))).collect();
        Ok(Self { field, options, time_s, cameras, filmed, nearest, refined })
    }

    /// Mean PSNR of the synchronized images: whole, and their moving part.
    fn print_synchronized(&self) {
        let (mut whole, mut moving, mut n) = (0.0, 0.0, 0.0);
        for (t, image) in self.cameras.iter().zip(&self.refined) {
            let Some(image) = image else { continue };
            whole += psnr_db(&image.image, &t.image, &vec![true; t.moving.len()]);
            moving += psnr_db(&image.image, &t.image, &t.moving);
            n += 1.0;
        }
        println!("  synchronized images, refined: {:6.2} {:6.2} dB", whole / n, moving / n);
    }

    fn geometry(
        &self,
        images: &[Option<Synchronized>],
        method: ProxyMethod,
        target: &Camera,
    ) -> Result<Geometry, Error> {
        let mut options = self.options.clone();
        options.proxy.method = method;
        Ok(self.field.geometry(images, target, self.time_s, &options)?)
    }

    fn print_view(&self, t: &True, out: Option<&Path>) -> Result<(), Error> {
        let mesh = self.geometry(&self.refined, ProxyMethod::Mesh, &t.camera)?;
        let depth = self.geometry(&self.refined, ProxyMethod::Depth, &t.camera)?;
        let of_true = self.geometry(&self.filmed, ProxyMethod::Depth, &t.camera)?;
        let sources = self.cameras.iter().map(|c| Some(c.depth.clone())).collect();
        let exact = Geometry { view: t.depth.clone(), sources };
        println!("  view {}", t.id);
        for (name, found) in [("mesh", &mesh), ("depth", &depth), ("depth, true images", &of_true)]
        {
            println!("    {name:34} {}", depth_errors(&found.view, t));
        }
        let seen = t.seen(&self.cameras);
        let moving: Vec<bool> = t.moving.iter().zip(&seen).map(|(m, s)| *m && *s).collect();
        use BlendMethod::{Lumigraph, SpaceTime};
        let rows: [Row; 9] = [
            ("nearest frame, mesh", &self.nearest, &mesh, Lumigraph),
            ("refined, mesh", &self.refined, &mesh, Lumigraph),
            ("refined, depth", &self.refined, &depth, Lumigraph),
            ("refined, depth, space-time", &self.refined, &depth, SpaceTime),
            ("refined, true depth", &self.refined, &exact, Lumigraph),
            ("refined, true depth, space-time", &self.refined, &exact, SpaceTime),
            ("true images, mesh", &self.filmed, &mesh, Lumigraph),
            ("true images, depth", &self.filmed, &of_true, Lumigraph),
            ("true images, true depth", &self.filmed, &exact, Lumigraph),
        ];
        for (name, images, geometry, method) in rows {
            let mut options = self.options.blend.clone();
            options.method = method;
            let image = self.field.blend(images, geometry, &t.camera, &options).image;
            let [whole, part] = [&seen, &moving].map(|mask| psnr_db(&image, &t.image, mask));
            println!("    {name:34} {whole:6.2} {part:6.2} dB");
            if let Some(out) = out {
                write(
                    &out.join(format!("{}-{}.png", t.id, name.replace([' ', ','], "-"))),
                    &image,
                )?;
            }
        }
        if let Some(out) = out {
            write(&out.join(format!("{}-truth.png", t.id)), &t.image)?;
        }
        Ok(())
    }
}

fn write(path: &Path, image: &Image) -> Result<(), Error> {
    std::fs::create_dir_all(path.parent().ok_or("has no folder")?)?;
    Ok(write_image(path, image, None, BitDepth::Eight)?)
}

fn bench(folder: &str, instants: usize, out: Option<&Path>) -> Result<(), Error> {
    let capture = Arc::new(Capture::open(folder.as_ref())?);
    let truth = Truth::open(folder.as_ref())?.ok_or("has no truth")?;
    // This benchmark is about pictures alone.
    let mut offsets = Offsets::known(&capture);
    for camera in &mut offsets.cameras {
        camera.offset_s = truth.offset_s(&camera.id);
    }
    let registration = RenderOptions::default().registration;
    let field = LightField::new(capture.clone(), offsets, &registration);
    let mut times: Vec<f64> = truth.views.iter().map(|v| v.time_s).collect();
    times.dedup();
    for (n, &time) in times.iter().take(instants).enumerate() {
        let at = || truth.views.iter().filter(move |v| v.time_s == time);
        let like = |id: &str| at().find(|v| v.like.as_deref() == Some(id)).ok_or("lacks a camera");
        let cameras: Result<Vec<True>, Error> =
            capture.cameras.iter().map(|c| True::read(&truth, like(&c.id)?)).collect();
        println!("{folder} at {time:.4} s: PSNR of all that is seen, of its moving part");
        let scene = Scene::new(&field, time - capture.time_origin_s, cameras?)?;
        scene.print_synchronized();
        for view in at().filter(|v| v.like.is_none()) {
            scene.print_view(&True::read(&truth, view)?, out.filter(|_| n == 0))?;
        }
    }
    Ok(())
}

/// The views of the benchmark: name, and place in metres to the right of the rig's middle, below and ahead.
const VIEWS: [(&str, [f64; 3]); 4] = [
    ("between", [0.0; 3]),
    ("side", [-0.12, 0.0, 0.0]),
    ("high", [-0.03, -0.12, 0.0]),
    ("ahead", [0.03, 0.0, 0.12]),
];

/// Writes a rig with [`VIEWS`] in place of its own.
fn write_rig(from: &str, to: &str) -> Result<(), Error> {
    let mut rig: Value = serde_json::from_str(&std::fs::read_to_string(from)?)?;
    let lens = rig["views"][0].clone();
    let view = |(id, place): &(&str, [f64; 3])| {
        let mut view = lens.clone();
        view["id"] = json!(id);
        let translation = place.map(|v| if v == 0.0 { 0.0 } else { -v });
        let rotation = [1.0, 0.0, 0.0, 0.0];
        view["cam_from_rig"] = json!({"rotation_wxyz": rotation, "translation": translation});
        view
    };
    rig["views"] = VIEWS.iter().map(view).collect();
    let folder = Path::new(to).parent().ok_or("has no folder")?;
    std::fs::create_dir_all(folder)?;
    Ok(std::fs::write(to, serde_json::to_string_pretty(&rig)?)?)
}

fn main() -> Result<(), Error> {
    let arguments: Vec<String> = std::env::args().filter(|a| a != "--bench").collect();
    if let [_, command, from, to] = &arguments[..]
        && command == "rig"
    {
        return write_rig(from, to);
    }
    let (mut folders, mut instants, mut out) = (Vec::new(), usize::MAX, None);
    let mut args = std::env::args().skip(1).filter(|a| a != "--bench");
    while let Some(arg) = args.next() {
        match arg.as_str() {
            "--instants" => instants = args.next().ok_or("--instants lacks a number")?.parse()?,
            "--out" => out = Some(PathBuf::from(args.next().ok_or("--out lacks a folder")?)),
            _ => folders.push(arg),
        }
    }
    for folder in &folders {
        let name = Path::new(folder).file_name().unwrap_or_default();
        bench(folder, instants, out.as_ref().map(|out| out.join(name)).as_deref())?;
    }
    Ok(())
}
