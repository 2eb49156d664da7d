//! What bad recordings cost views: PSNR of views from degraded copies of a recording.

use super::degradation::Degradation;
use super::summary::mean;
use super::truth::{True, psnr_db};
use super::{Error, Selection, cameras_at, light_field};
use stlfr::camera::Camera;
use stlfr::capture::{Capture, Truth};
use stlfr::interpolation::SyncMethod;
use stlfr::lumigraph::BlendMethod;
use stlfr::options::{ProxyMethod, RenderOptions};
use stlfr::raster::Image;

/// How views are rendered.
const METHODS: [&str; 2] = ["scene flow", "all-cameras, depth, space-time"];

fn options() -> [RenderOptions; METHODS.len()] {
    let mut flow = RenderOptions::default();
    flow.proxy.method = ProxyMethod::SceneFlow;
    let mut depth = RenderOptions::default().with_sync(SyncMethod::AllCameras);
    depth.proxy.method = ProxyMethod::Depth;
    depth.blend.method = BlendMethod::SpaceTime;
    [flow, depth]
}

/// PSNR of all that is seen, and of its moving part, dB.
type Db = [f64; 2];

/// The scores of one view of one recording, by each of [`METHODS`].
#[derive(Clone)]
struct Row {
    degradation: Degradation,
    view: String,
    db: [Db; METHODS.len()],
    /// PSNR minus that of the recording as filmed, over the same pixels.
    difference_db: [Db; METHODS.len()],
}

/// A view at an instant that has truth.
struct Target {
    truth: True,
    /// Seconds from the capture's start.
    time_s: f64,
    /// Index of the instant.
    instant: usize,
}

/// The views of a recording or of a degraded copy.
struct Views {
    /// The cameras that filmed.
    cameras: Vec<Camera>,
    /// The image of each target by each of [`METHODS`].
    images: Vec<[Image; METHODS.len()]>,
}

/// What is measured of a capture.
struct Scene {
    whole: Capture,
    truth: Truth,
    /// The true images of all cameras, by instant.
    cameras: Vec<Vec<True>>,
    targets: Vec<Target>,
}

/// Prints the scores of every capture, and their means over captures. `only` is what the name of the only degradation
/// begins with.
pub fn bench(folders: &[String], selection: &Selection, only: &str) -> Result<(), Error> {
    if !Degradation::ALL.iter().any(|d| d.name().starts_with(only)) {
        return Err(format!("--only: no recording is named {only}").into());
    }
    let mut rows = Vec::new();
    for folder in folders {
        println!("\n{folder}");
        rows.extend(Scene::open(folder, selection)?.measure(only)?);
    }
    if folders.len() > 1 {
        println!("\nmean of {} captures", folders.len());
        print_head();
        averaged(&rows).iter().for_each(print);
    }
    Ok(())
}

impl Scene {
    fn open(folder: &str, selection: &Selection) -> Result<Self, Error> {
        let whole = Capture::open(folder.as_ref())?;
        let truth = Truth::open(folder.as_ref())?.ok_or("has no truth")?;
        let (mut cameras, mut targets) = (Vec::new(), Vec::new());
        for (instant, time) in selection.instants_s(&truth).into_iter().enumerate() {
            cameras.push(cameras_at(&whole, &truth, time)?);
            for view in selection.views(&truth, time)? {
                let time_s = time - whole.time_origin_s;
                targets.push(Target { truth: view, time_s, instant });
            }
        }
        Ok(Self { whole, truth, cameras, targets })
    }

    /// Measures and prints all degradations. One that gives no views is told and left out.
    fn measure(&self, only: &str) -> Result<Vec<Row>, Error> {
        print_head();
        let filmed = self.views(Degradation::None)?;
        let mut all = Vec::new();
        let is_wanted = |d: &Degradation| *d == Degradation::None || d.name().starts_with(only);
        for degradation in Degradation::ALL.into_iter().filter(is_wanted) {
            let degraded = match degradation {
                Degradation::None => None,
                _ => Some(self.views(degradation)),
            };
            let views = match &degraded {
                None => &filmed,
                Some(Ok(views)) => views,
                Some(Err(error)) => {
                    println!("{}: {error}", degradation.name());
                    continue;
                }
            };
            let targets = 0..self.targets.len();
            let figures: Vec<Row> =
                targets.map(|k| self.row(k, degradation, [views, &filmed])).collect();
            let rows = averaged(&figures);
            rows.iter().for_each(print);
            all.extend(rows);
        }
        Ok(all)
    }

    /// Renders all views from a degraded copy.
    fn views(&self, degradation: Degradation) -> Result<Views, Error> {
        let folder = tempfile::tempdir()?;
        degradation.write(&self.whole, folder.path())?;
        let field = light_field(folder.path(), &self.truth)?;
        let moved_s = self.whole.time_origin_s - field.capture().time_origin_s;
        let render = |target: &Target| -> Result<_, Error> {
            let [flow, depth] = options()
                .map(|options| field.view(&target.truth.camera, target.time_s + moved_s, &options));
            Ok([flow?.image, depth?.image])
        };
        let images = self.targets.iter().map(render).collect::<Result<_, _>>()?;
        let cameras = field.capture().cameras.iter().map(|c| c.camera.clone()).collect();
        Ok(Views { cameras, images })
    }

    /// Scores one target. Only pixels count that the degraded cameras see too.
    fn row(&self, target: usize, degradation: Degradation, [views, filmed]: [&Views; 2]) -> Row {
        let Target { truth, instant, .. } = &self.targets[target];
        let seen = truth.seen_through(&views.cameras, &self.cameras[*instant]);
        let moving = truth.moving_of(&seen);
        let db = |views: &Views| {
            let score = |image: &Image| [&seen, &moving].map(|m| psnr_db(image, &truth.image, m));
            views.images[target].each_ref().map(score)
        };
        let (db, filmed_db) = (db(views), db(filmed));
        let difference = |m: usize| [0, 1].map(|part| db[m][part] - filmed_db[m][part]);
        Row {
            degradation,
            view: truth.name().to_owned(),
            db,
            difference_db: [0, 1].map(difference),
        }
    }
}

/// Means over the rows of the same degradation and view, in the order in which these first come.
fn averaged(rows: &[Row]) -> Vec<Row> {
    let same = |a: &Row, b: &Row| a.degradation == b.degradation && a.view == b.view;
    let mut means: Vec<Row> = Vec::new();
    for first in rows {
        if means.iter().any(|m| same(m, first)) {
            continue;
        }
        let over = |value: &dyn Fn(&Row) -> f64| {
            mean(rows.iter().filter(|row| same(row, first)).map(value))
        };
        let parts = |of: fn(&Row) -> &[Db; METHODS.len()]| {
            [0, 1].map(|m| [0, 1].map(|part| over(&|row| of(row)[m][part])))
        };
        let (db, difference_db) = (parts(|row| &row.db), parts(|row| &row.difference_db));
        means.push(Row { db, difference_db, ..first.clone() });
    }
    means
}

fn print_head() {
    println!("PSNR of all that is seen, of its moving part; minus that as filmed [dB]");
    println!("| recording | view | {} |", METHODS.map(|m| format!("{m} | minus")).join(" | "));
    println!("|---|---|{}", "---|---|".repeat(METHODS.len()));
}

fn print(row: &Row) {
    let figures = row.db.iter().zip(&row.difference_db).map(|([all, moving], [d, moving_d])| {
        let difference = match row.degradation {
            Degradation::None => "-".to_owned(),
            _ => format!("{d:+.2} {moving_d:+.2}"),
        };
        format!("{all:.2} {moving:.2} | {difference}")
    });
    let figures: Vec<String> = figures.collect();
    println!("| {} | {} | {} |", row.degradation.name(), row.view, figures.join(" | "));
}
