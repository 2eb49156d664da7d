//! `stlfr publish`: the site, and its page in a real Chromium that draws by software.
//!
//! `cargo bench --bench publish -- CAPTURE [--max-mb N,N] [--seconds S]`
//!
//! - sizes, and views from what is published beside `render`'s, for each bound of the folder's size
//! - the page's pictures beside `render`'s and beside the truth, at the true views, for the first bound
//! - the page in windows of 1280×720 and 390×844: milliseconds to the first picture, in a browser that was just started
//!   and in one that runs, median of several; pictures a second while it plays, and the level of quality that it ended at

#[path = "../view/chromium.rs"]
mod chromium;
#[path = "../common/mod.rs"]
mod common;
#[path = "../view/site.rs"]
mod site;

use chromium::Chromium;
use common::scores::psnr_db;
use site::{drawn, open, serve};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;
use stlfr::capture::{Capture, Truth};
use stlfr::light_field::LightField;
use stlfr::options::{ProxyMethod, RenderOptions};
use stlfr::pipeline::open_field;
use stlfr::progress::Reporter;
use stlfr::publish::{PublishOptions, publish};
use stlfr::raster::read_image;

type Error = Box<dyn std::error::Error>;

const WINDOWS: [(u32, u32); 2] = [(1280, 720), (390, 844)];
/// Time after which a browser has started all its processes.
const SETTLED: Duration = Duration::from_secs(3);
const FIRST_PICTURES: usize = 5;
/// Time after which the page has found the level that keeps up.
const WARM: Duration = Duration::from_secs(15);

fn bench(capture: &Path, bounds_mb: &[u64], played: Duration) -> Result<(), Error> {
    let mut options = RenderOptions::default();
    options.proxy.method = ProxyMethod::SceneFlow;
    let opened = Arc::new(Capture::open(capture)?);
    let field = open_field(opened, &options, &Reporter::silent())?;
    let folder = tempfile::tempdir()?;
    let sites: Vec<PathBuf> =
        bounds_mb.iter().map(|mb| folder.path().join(mb.to_string())).collect();
    println!(
        "| at most, MB | size | JPEG | block | images, MB | depth and motion, MB | all, MB | beside render, dB |"
    );
    println!("|---|---|---|---|---|---|---|---|");
    for (mb, site) in bounds_mb.iter().zip(&sites) {
        let wanted = PublishOptions { span_s: None, max_size: None, max_bytes: mb * 1_000_000 };
        let found = publish(&field, &options, &wanted, site, &Reporter::new(false))?;
        let [images, flow, all] = [found.image_bytes, found.flow_bytes, found.bytes];
        let [images, flow, all] = [images, flow, all].map(|b| format!("{:.2}", b as f64 / 1e6));
        let db: Vec<String> = found.psnr_db.iter().map(|db| format!("{db:.1}")).collect();
        let ([width, height], jpeg, block) = (found.size, found.jpeg, found.block_px);
        let db = db.join(", ");
        println!(
            "| {mb} | {width}×{height} | {jpeg} | {block} | {images} | {flow} | {all} | {db} |"
        );
    }
    let Some(site) = sites.first() else { return Ok(()) };
    let (port, _) = serve(site);
    let address = format!("http://127.0.0.1:{port}/index.html");
    pictures(capture, &field, &options, &address)?;
    println!(
        "| window | first picture, ms | in a browser just started, ms | pictures a second | level |\n|---|---|---|---|---|"
    );
    for window in WINDOWS {
        let [running_ms, started_ms] =
            [SETTLED, Duration::ZERO].map(|wait| first_picture_ms(&address, window, wait));
        let mut browser = Chromium::start_drawing();
        let mut tab = open(&mut browser, &address, window);
        std::thread::sleep(WARM);
        let before = tab.value("stlfr.statistics.pictures").as_f64().unwrap_or(f64::NAN);
        std::thread::sleep(played);
        let after = tab.value("stlfr.statistics.pictures").as_f64().unwrap_or(f64::NAN);
        let rate = (after - before) / played.as_secs_f64();
        let level = tab.value("stlfr.statistics.level");
        let (width, height) = window;
        println!("| {width}×{height} | {running_ms:.0} | {started_ms:.0} | {rate:.1} | {level} |");
    }
    Ok(())
}

/// Median time from the page's address to its first picture, each in a browser of its own that runs since `wait`.
fn first_picture_ms(address: &str, window: (u32, u32), wait: Duration) -> f64 {
    let mut times_ms: Vec<f64> = (0..FIRST_PICTURES)
        .map(|_| {
            let mut browser = Chromium::start_drawing();
            drop(browser.tab(window, "dark"));
            std::thread::sleep(wait);
            let mut tab = open(&mut browser, address, window);
            tab.value("stlfr.statistics.firstMs").as_f64().unwrap_or(f64::NAN)
        })
        .collect();
    times_ms.sort_by(f64::total_cmp);
    times_ms[FIRST_PICTURES / 2]
}

/// The page's pictures of the true views.
fn pictures(
    capture: &Path,
    field: &LightField,
    options: &RenderOptions,
    address: &str,
) -> Result<(), Error> {
    let Some(truth) = Truth::open(capture)? else { return Ok(()) };
    let mut browser = Chromium::start_drawing();
    let mut tab = open(&mut browser, address, WINDOWS[0]);
    println!("| view | page beside render, dB | page beside truth, dB | render beside truth, dB |");
    println!("|---|---|---|---|");
    for view in &truth.views {
        let (camera, time_s) = (view.camera.camera()?, view.time_s);
        let rendered = field.view(&camera, time_s - field.capture().time_origin_s, options)?;
        let (rendered, page) = (rendered.image.to_rgb(), drawn(&mut tab, &camera, time_s));
        let image = read_image(&truth.file(&view.image)?)?.0.to_rgb();
        let page_db = [&rendered, &image].map(|other| psnr_db(&page, other, 0));
        let render_db = psnr_db(&rendered, &image, 0);
        println!("| {} | {:.1} | {:.1} | {render_db:.1} |", view.id, page_db[0], page_db[1]);
    }
    Ok(())
}

fn main() -> Result<(), Error> {
    let (mut captures, mut bounds_mb, mut seconds) = (Vec::new(), vec![15], 10.0);
    let mut arguments = std::env::args().skip(1).filter(|a| a != "--bench");
    while let Some(argument) = arguments.next() {
        let mut value = || arguments.next().ok_or(format!("{argument} lacks a value"));
        match argument.as_str() {
            "--max-mb" => {
                bounds_mb = value()?.split(',').map(str::parse).collect::<Result<_, _>>()?;
            }
            "--seconds" => seconds = value()?.parse()?,
            _ => captures.push(PathBuf::from(argument)),
        }
    }
    let played = Duration::from_secs_f64(seconds);
    captures.iter().try_for_each(|capture: &PathBuf| bench(capture, &bounds_mb, played))
}
