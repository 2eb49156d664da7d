//! One instant of a capture: its synchronized images and its views, by every method.

use super::peers::Peers;
use super::summary::Summary;
use super::truth::{Judge, True, depth_errors, psnr_db};
use super::{Error, write};
use std::path::Path;
use std::sync::Arc;
use stlfr::camera::Camera;
use stlfr::interpolation::{SyncMethod, Synchronized};
use stlfr::light_field::{
    Context, Geometry, GivenImages, Images, LightField, Request, Viewpoint, render,
};
use stlfr::lumigraph::BlendMethod::{self, Lumigraph, SpaceTime};
use stlfr::options::{ProxyMethod, RenderOptions};

/// The images of all cameras, in the capture's order.
type CameraImages = Vec<Option<Arc<Synchronized>>>;

/// One row of a view's table.
struct Row<'a> {
    name: String,
    images: &'a CameraImages,
    geometry: &'a Geometry,
    method: BlendMethod,
}

impl<'a> Row<'a> {
    fn new(
        name: &str,
        images: &'a CameraImages,
        geometry: &'a Geometry,
        method: BlendMethod,
    ) -> Self {
        Self { name: name.to_owned(), images, geometry, method }
    }
}

/// Name of the rows by scene flow.
const SCENE_FLOW: &str = "scene flow";

/// The options of views by scene flow.
fn scene_flow() -> RenderOptions {
    let mut options = RenderOptions::default();
    options.proxy.method = ProxyMethod::SceneFlow;
    options
}

/// Everything of one instant.
pub struct Scene<'a> {
    field: &'a LightField,
    time_s: f64,
    cameras: Vec<True>,
    /// Of all cameras: true, from the nearest frames, synchronized, by scene flow, and by the peers that there are.
    filmed: CameraImages,
    nearest: CameraImages,
    refined: CameraImages,
    all_cameras: CameraImages,
    by_scene_flow: CameraImages,
    peers: Vec<(&'static str, CameraImages)>,
}

impl<'a> Scene<'a> {
    pub fn new(
        field: &'a LightField,
        time_s: f64,
        cameras: Vec<True>,
        peers: &Peers,
    ) -> Result<Self, Error> {
        let mut timed = RenderOptions::default();
        timed.blend.method = SpaceTime;
        let by = |sync| {
            field.synchronized_all(
                time_s,
                &RenderOptions { sync, ..timed.clone() },
                &Context::unattended(),
            )
        };
        let (nearest, refined) = (by(SyncMethod::Nearest)?, by(SyncMethod::Refined)?);
        let all_cameras = by(SyncMethod::AllCameras)?;
        let flow = scene_flow();
        let by_scene_flow = |camera: usize| -> Result<_, Error> {
            let request = Request::new(Viewpoint::Like(camera), time_s, &flow);
            let image = render(field, &request, &Context::unattended())?.image;
            Ok(Some(Arc::new(Synchronized::filmed(image))))
        };
        let by_scene_flow = (0..cameras.len()).map(by_scene_flow).collect::<Result<_, _>>()?;
        let filmed =
            cameras.iter().map(|t| Some(Arc::new(Synchronized::filmed(t.image.clone())))).collect();
        let shared = |images: Vec<Option<Synchronized>>| {
            images.into_iter().map(|image| image.map(Arc::new)).collect()
        };
        let peers = peers.synchronized(field, time_s)?;
        let peers = peers.into_iter().map(|(name, images)| (name, shared(images))).collect();
        Ok(Self {
            field,
            time_s,
            cameras,
            filmed,
            nearest,
            refined,
            all_cameras,
            by_scene_flow,
            peers,
        })
    }

    /// Mean PSNR of the synchronized images: whole, and their moving part.
    pub fn print_synchronized(&self, summary: &mut Summary) {
        println!("  synchronized images");
        let peers = self.peers.iter().map(|(name, images)| (*name, images));
        let own = [
            ("nearest frame", &self.nearest),
            ("refined", &self.refined),
            ("all-cameras", &self.all_cameras),
            (SCENE_FLOW, &self.by_scene_flow),
        ];
        for (name, images) in own.into_iter().chain(peers) {
            let (mut whole, mut moving) = (Vec::new(), Vec::new());
            for (t, image) in self.cameras.iter().zip(images) {
                let Some(image) = image else { continue };
                whole.push(psnr_db(&image.image, &t.image, &vec![true; t.moving.len()]));
                moving.push(psnr_db(&image.image, &t.image, &t.moving));
            }
            let [whole, moving] = [whole, moving].map(super::summary::mean);
            println!("    {name:34} {whole:6.2} {moving:6.2} dB");
            summary.add_synchronized(name, [whole, moving]);
        }
    }

    fn geometry(
        &self,
        images: &CameraImages,
        method: ProxyMethod,
        target: &Camera,
    ) -> Result<Geometry, Error> {
        geometry((self.field, self.time_s), images, method, target)
    }

    pub fn print_view(
        &self,
        t: &True,
        out: Option<&Path>,
        summary: &mut Summary,
    ) -> Result<(), Error> {
        let mesh = self.geometry(&self.refined, ProxyMethod::Mesh, &t.camera)?;
        let stereo = |images| self.geometry(images, ProxyMethod::Depth, &t.camera);
        let (depth, of_true) = (stereo(&self.refined)?, stereo(&self.filmed)?);
        let of_all = stereo(&self.all_cameras)?;
        let of_peers: Vec<Geometry> =
            self.peers.iter().map(|(_, images)| stereo(images)).collect::<Result<_, _>>()?;
        let exact = exact(&self.cameras, t);
        println!("  view {}", t.id);
        for (name, found) in [
            ("mesh", &mesh),
            ("depth", &depth),
            ("depth, all-cameras", &of_all),
            ("depth, true images", &of_true),
        ] {
            println!("    {name:34} {}", depth_errors(&found.view, t));
        }
        let mut rows = vec![Row::new("nearest frame, mesh", &self.nearest, &mesh, Lumigraph)];
        for ((name, images), own) in self.peers.iter().zip(&of_peers) {
            rows.push(Row::new(&format!("{name}, mesh"), images, &mesh, Lumigraph));
            rows.push(Row::new(&format!("{name}, depth"), images, own, Lumigraph));
        }
        rows.extend([
            Row::new("refined, mesh", &self.refined, &mesh, Lumigraph),
            Row::new("refined, depth", &self.refined, &depth, Lumigraph),
            Row::new("refined, depth, space-time", &self.refined, &depth, SpaceTime),
            Row::new("all-cameras, depth", &self.all_cameras, &of_all, Lumigraph),
            Row::new("all-cameras, depth, space-time", &self.all_cameras, &of_all, SpaceTime),
            Row::new("refined, true depth", &self.refined, &exact, Lumigraph),
            Row::new("refined, true depth, space-time", &self.refined, &exact, SpaceTime),
            Row::new("true images, mesh", &self.filmed, &mesh, Lumigraph),
            Row::new("true images, depth", &self.filmed, &of_true, Lumigraph),
            Row::new("true images, true depth", &self.filmed, &exact, Lumigraph),
        ]);
        let judge = Judge::new(t, t.seen(&self.cameras));
        print_rows((self.field, &judge), t, &rows, out, summary)?;
        print_scene_flow((self.field, self.time_s), &judge, t, out, summary)
    }
}

/// The geometry of these images at an instant.
fn geometry(
    (field, time_s): (&LightField, f64),
    images: &CameraImages,
    method: ProxyMethod,
    target: &Camera,
) -> Result<Geometry, Error> {
    let mut options = RenderOptions::default();
    options.proxy.method = method;
    let images = GivenImages::filmed(images.clone());
    let shape = Images::Given(&images);
    let request = Request::new(Viewpoint::View(target), time_s, &options);
    Ok(field.geometry(target, &Request { shape, ..request })?)
}

/// True depths.
fn exact(cameras: &[True], t: &True) -> Geometry {
    let sources = cameras.iter().map(|c| Some(Arc::new(c.depth.clone()))).collect();
    Geometry { view: t.depth.clone(), sources }
}

fn print_rows(
    (field, judge): (&LightField, &Judge),
    t: &True,
    rows: &[Row],
    out: Option<&Path>,
    summary: &mut Summary,
) -> Result<(), Error> {
    for Row { name, images, geometry, method } in rows {
        let mut options = RenderOptions::default().blend;
        options.method = *method;
        let image = field.blend(images, geometry, &t.camera, &options).image;
        let scores = judge.scores(&image);
        println!("    {name:34} {scores}");
        summary.add_view(t.name(), name, scores);
        if let Some(out) = out {
            let file = format!("{}-{}.png", t.id, name.replace([' ', ','], "-"));
            write(&out.join(file), &image)?;
        }
    }
    if let Some(out) = out {
        write(&out.join(format!("{}-truth.png", t.id)), &t.image)?;
    }
    Ok(())
}

/// Prints a view by the true images of all cameras, over depths from these and over true depths.
pub fn print_true_images(
    (field, time_s): (&LightField, f64),
    cameras: &[True],
    t: &True,
    out: Option<&Path>,
    summary: &mut Summary,
) -> Result<(), Error> {
    let filmed: CameraImages =
        cameras.iter().map(|t| Some(Arc::new(Synchronized::filmed(t.image.clone())))).collect();
    let of_true = geometry((field, time_s), &filmed, ProxyMethod::Depth, &t.camera)?;
    let exact = exact(cameras, t);
    let rows = [
        Row::new("true images, depth", &filmed, &of_true, Lumigraph),
        Row::new("true images, true depth", &filmed, &exact, Lumigraph),
    ];
    print_rows((field, &Judge::new(t, t.seen(cameras))), t, &rows, out, summary)
}

/// Prints the view by depth and motion of the frames, which needs no synchronized images.
pub fn print_scene_flow(
    (field, time_s): (&LightField, f64),
    judge: &Judge,
    t: &True,
    out: Option<&Path>,
    summary: &mut Summary,
) -> Result<(), Error> {
    let options = scene_flow();
    let request = Request::new(Viewpoint::View(&t.camera), time_s, &options);
    let depths = field.geometry(&t.camera, &request)?.view;
    println!("    {SCENE_FLOW:34} {}", depth_errors(&depths, t));
    let image = render(field, &request, &Context::unattended())?.image;
    let scores = judge.scores(&image);
    println!("    {SCENE_FLOW:34} {scores}");
    summary.add_view(t.name(), SCENE_FLOW, scores);
    match out {
        Some(out) => write(&out.join(format!("{}-scene-flow.png", t.id)), &image),
        None => Ok(()),
    }
}
