//! `stlfr publish`: the folder, and the page in a real Chromium that draws by software.

mod common;

#[path = "view/chromium.rs"]
mod chromium;
#[path = "view/site.rs"]
mod site;

use chromium::Chromium;
use common::bodies::{Recording, board_before_wall, pose};
use common::scores::psnr_db;
use common::worlds::line_rig;
use common::{assert_refused, root, run, succeed, text};
use serde_json::json;
use site::{drawn, open, serve};
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::sync::{Arc, OnceLock};
use stlfr::camera::CameraFormat;
use stlfr::capture::Capture;
use stlfr::options::{ProxyMethod, RenderOptions};
use stlfr::pipeline::open_field;
use stlfr::progress::Reporter;
use stlfr::publish::{PublishError, PublishOptions, publish};
use stlfr::raster::read_image;
use tempfile::TempDir;

/// Three cameras with three frames each, and the site of their light field.
struct Published {
    folder: TempDir,
    printed: String,
}

impl Published {
    fn capture(&self) -> PathBuf {
        self.folder.path().join("capture")
    }

    fn site(&self) -> PathBuf {
        self.folder.path().join("site")
    }
}

fn published() -> &'static Published {
    static PUBLISHED: OnceLock<Published> = OnceLock::new();
    PUBLISHED.get_or_init(|| {
        let folder = tempfile::tempdir().unwrap();
        let world = board_before_wall(|frames| pose([0.0; 3], [0.02 * frames, 0.0, 1.3]));
        let cameras = line_rig(3, 128);
        let first_frames = &[0.0, 0.35, 0.7];
        let capture = folder.path().join("capture");
        Recording { world: &world, cameras: &cameras, first_frames, frames: 3, noise: 0.004 }
            .write(&capture);
        let site = folder.path().join("site");
        let output = succeed(&["publish", text(&capture), "-o", text(&site), "-q"]);
        Published { folder, printed: String::from_utf8(output.stdout).unwrap() }
    })
}

/// Returns the numbers of a constant's value, as they are written in Rust and in GLSL.
fn numbers(value: &str) -> Vec<f64> {
    let words = value.split(|c: char| !(c.is_ascii_alphanumeric() || "._-".contains(c)));
    words.filter_map(|word| word.parse().ok()).collect()
}

#[test]
fn constants_of_the_page_are_those_of_scene_flow() {
    // In JavaScript, other constants are the page's own. In GLSL, there are no others.
    const SHARED: [&str; 4] = ["CLUSTER_PX", "FADING", "HIDING_PX", "MAX_CONFIRMING_DT"];
    let page = |name| std::fs::read_to_string(root().join("src/publish/page").join(name)).unwrap();
    let shaders = page("shaders.js");
    let (head, _) = shaders.split_once("\nconst ").unwrap();
    let names = head.split(|c: char| c.is_whitespace() || c == ',');
    let files = names.filter(|name| name.ends_with(".rs"));
    let read = |name| std::fs::read_to_string(root().join("src/scene_flow").join(name)).unwrap();
    let rust = files.map(read).collect::<String>();
    let mut compared = BTreeSet::new();
    for line in ["frames.js", "renderer.js"].map(page).join("\n").lines().chain(shaders.lines()) {
        let Some((name, value)) = line.strip_prefix("const ").and_then(|c| c.split_once(" = "))
        else {
            continue;
        };
        let glsl = name.strip_prefix("float ").or(name.strip_prefix("vec2 "));
        let Some(name) = glsl.or(Some(name).filter(|name| SHARED.contains(name))) else {
            continue;
        };
        let start = format!("const {name}: ");
        let theirs = rust
            .lines()
            .filter_map(|line| line.trim_start_matches("pub(super) ").strip_prefix(&start));
        let mut theirs = theirs.map(|rest| numbers(rest.split_once(" = ").unwrap().1));
        assert!(theirs.any(|theirs| theirs == numbers(value)), "{name} = {value}");
        compared.insert(name.to_owned());
    }
    assert!(SHARED.iter().all(|name| compared.contains(*name)), "{compared:?}");
    assert!(compared.len() >= 20, "{compared:?}");
}

/// Places and instants between cameras and frames: metres to the right of the first camera, and seconds.
const HELD: [(f64, f64); 2] = [(0.03, 1.2 / 30.0), (0.085, 1.55 / 30.0)];

#[test]
fn the_page_draws_what_render_renders_and_asks_for_nothing_else() {
    let published = published();
    let (port, asked) = serve(&published.site());
    let mut browser = Chromium::start_drawing();
    let mut tab = open(&mut browser, &format!("http://127.0.0.1:{port}/index.html"), (640, 480));
    for (k, (x_m, time_s)) in HELD.into_iter().enumerate() {
        let camera = line_rig(3, 128)[0].shifted([x_m, 0.0, 0.0].into());
        let view = published.folder.path().join(format!("{k}.json"));
        std::fs::write(&view, json!(CameraFormat::from(&camera)).to_string()).unwrap();
        let png = published.folder.path().join(format!("{k}.png"));
        let capture = published.capture();
        let time = time_s.to_string();
        let mut arguments = vec!["render", text(&capture), "--proxy", "scene-flow", "-q"];
        arguments.extend(["--camera", text(&view), "--time", &time, "-o", text(&png)]);
        succeed(&arguments);
        let db = psnr_db(&drawn(&mut tab, &camera, time_s), &read_image(&png).unwrap().0, 0);
        assert!(db >= 35.0, "{x_m} m, {time_s} s: {db:.1} dB");
    }
    assert_eq!(tab.errors, Vec::<String>::new());
    let own = format!("http://127.0.0.1:{port}/");
    let other: Vec<&String> =
        tab.requests.iter().filter(|r| !r.starts_with(&own) && !r.starts_with("data:")).collect();
    assert!(tab.requests.len() > 8 && other.is_empty(), "{other:?}");
    // The browser keeps its word: what the page may not ask for is refused.
    let refused = tab.value(&format!(
        "fetch('http://127.0.0.1:{port}/index.html').then(() => 'answered', () => 'refused')"
    ));
    assert_eq!(refused, "refused");
    let asked: BTreeSet<String> = asked.lock().unwrap().iter().cloned().collect();
    let is_there = |path: &String| published.site().join(&path[1..]).is_file();
    assert!(asked.iter().all(is_there), "{asked:?}");
}

#[test]
fn pictures_do_not_jump_where_the_frame_of_a_camera_changes() {
    let (port, _) = serve(&published().site());
    let mut browser = Chromium::start_drawing();
    let mut tab = open(&mut browser, &format!("http://127.0.0.1:{port}/index.html"), (640, 480));
    let camera = line_rig(3, 128)[0].shifted([0.01, 0.0, 0.0].into());
    let mut picture = |frames: f64| drawn(&mut tab, &camera, frames / 30.0);
    // Frames 1 and 2 of the first camera are blended from 1.4 to 1.6. There, confidences change a little.
    let jumps = [1.4, 1.5, 1.6].map(|frames| {
        let [before, after] = [frames - 1e-4, frames + 1e-4].map(&mut picture);
        let differences = before.data().iter().zip(after.data()).map(|(a, b)| (a - b).abs());
        255.0 * differences.sum::<f32>() / before.data().len() as f32
    });
    assert!(jumps.iter().all(|jump| *jump < 0.25), "{jumps:?}");
}

#[test]
fn from_disk_and_by_touch_on_a_phone() {
    let published = published();
    let mut browser = Chromium::start_drawing();
    let address = format!("file://{}/index.html", published.site().display());
    let mut tab = open(&mut browser, &address, (390, 844));
    assert_eq!(tab.errors, Vec::<String>::new());
    assert_eq!(tab.value("document.documentElement.scrollWidth"), 390);
    tab.call("Emulation.setTouchEmulationEnabled", json!({"enabled": true}));
    let place = "stlfr.motion.target[0]";
    let before = tab.value(place).as_f64().unwrap();
    for (kind, x) in [("touchStart", 200), ("touchMove", 170), ("touchMove", 120)] {
        let points = json!([{"x": x, "y": 400}]);
        tab.call("Input.dispatchTouchEvent", json!({"type": kind, "touchPoints": points}));
    }
    tab.call("Input.dispatchTouchEvent", json!({"type": "touchEnd", "touchPoints": []}));
    let after = tab.value(place).as_f64().unwrap();
    assert!(after > before + 0.005, "{before} {after}");
    // The button stops time, and the picture goes on.
    tab.click("#play");
    let time = tab.value("stlfr.motion.time");
    let pictures = tab.value("stlfr.statistics.pictures").as_f64().unwrap();
    tab.until(&format!("stlfr.statistics.pictures > {}", pictures + 2.0));
    assert_eq!(tab.value("stlfr.motion.time"), time);
    tab.wheel([200.0, 300.0], 30.0);
    tab.until(&format!("stlfr.motion.time !== {time}"));
    // The device's turn.
    for gamma in [0, 12] {
        let turn = json!({"alpha": 0, "beta": 40, "gamma": gamma});
        tab.call("DeviceOrientation.setDeviceOrientationOverride", turn);
        tab.value("new Promise((done) => setTimeout(done, 200))");
    }
    tab.until("stlfr.motion.tilt[0] > 0.3");
    assert_eq!(tab.errors, Vec::<String>::new());
}

#[test]
fn what_is_published_is_told() {
    let published = published();
    let line = |words: &str| {
        let found = published.printed.lines().find(|line| line.contains(words));
        found.unwrap_or_else(|| panic!("{words}: {}", published.printed)).to_owned()
    };
    assert!(
        line("frames of").starts_with("7 frames of 3 cameras at 128x96, from 0.0233 to 0.0667 s")
    );
    let total = line("Together").split(' ').rev().nth(1).unwrap().parse::<f64>().unwrap();
    let size = |path: &Path| -> u64 {
        let entries = std::fs::read_dir(path).unwrap().map(|e| e.unwrap());
        entries.filter_map(|e| e.metadata().ok().filter(|m| m.is_file())).map(|m| m.len()).sum()
    };
    let bytes = size(&published.site()) + size(&published.site().join("frames"));
    assert!((total - bytes as f64 / 1e6).abs() < 0.006, "{total} {bytes}");
    let lowest: f64 = line("Beside render").rsplit(' ').nth(3).unwrap().parse().unwrap();
    assert!(lowest > 35.0, "{lowest}");
    assert!(line("<iframe").contains(r#"src="site/index.html""#));
    let index = std::fs::read_to_string(published.site().join("index.html")).unwrap();
    assert!(
        index.contains(
            "\"default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self'; "
        )
    );
}

#[test]
fn a_folder_with_other_files_is_not_replaced() {
    let published = published();
    let capture = published.capture();
    let folder = tempfile::tempdir().unwrap();
    let site = folder.path().join("site");
    let refused = |words: &str| {
        let output = run(&["publish", text(&capture), "-o", text(&site), "-q"]);
        assert_refused(&output, 2, words);
    };
    std::fs::create_dir(&site).unwrap();
    std::fs::write(site.join("index.html"), "mine").unwrap();
    refused("holds other files");
    std::fs::remove_dir_all(&site).unwrap();
    std::fs::create_dir(&site).unwrap();
    common::copy_folder(&published.site(), &site);
    std::fs::write(site.join("CNAME"), "mine").unwrap();
    refused("holds CNAME, which is no part of a site");
    std::fs::remove_file(site.join("CNAME")).unwrap();
    std::fs::write(site.join("frames/0999.js"), "of a longer span").unwrap();
    succeed(&["publish", text(&capture), "-o", text(&site), "-q"]);
    assert!(!site.join("frames/0999.js").exists() && site.join("scene.js").exists());
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1, "nothing is left beside it");
    std::fs::remove_dir_all(&site).unwrap();
    std::os::unix::fs::symlink(published.site(), &site).unwrap();
    refused("is a link, which is not written through");
    let output = run(&["publish", text(&capture), "-o", text(&capture), "-q"]);
    assert_refused(&output, 2, "is a capture, and results need a folder of their own");
    let of_frames = capture.join("truth/site");
    assert_refused(
        &run(&["publish", text(&capture), "-o", text(&of_frames)]),
        2,
        "belongs to the capture",
    );
    let output = run(&["publish", text(&capture), "-o", text(&of_frames), "--span", "5:6"]);
    assert_refused(&output, 2, "belongs to the capture");
    let elsewhere = folder.path().join("b");
    let output = run(&["publish", text(&capture), "-o", text(&elsewhere), "--span", "5:6", "-q"]);
    assert_refused(&output, 2, "--span: no camera has frames around 5 s");
    // The cameras' three frames end before 0.1 s; with other offsets than the estimated they would not.
    let span = ["-o", text(&elsewhere), "--span", "0.05:0.2", "-q"];
    let output = run(&[&["publish", text(&capture)], &span[..]].concat());
    assert_refused(&output, 2, "--span: no camera has frames around 0.2 s");
    assert!(!elsewhere.exists());
}

#[test]
fn the_bound_holds_or_nothing_is_written() {
    let published = published();
    let capture = Arc::new(Capture::open(&published.capture()).unwrap());
    let mut options = RenderOptions::default();
    options.proxy.method = ProxyMethod::SceneFlow;
    let field = open_field(capture, &options, &Reporter::silent()).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let site = folder.path().join("site");
    let within = |max_bytes: u64, max_size| {
        let wanted = PublishOptions { span_s: None, max_size, max_bytes };
        publish(&field, &options, &wanted, &site, &Reporter::silent())
    };
    assert!(matches!(within(40_000, None), Err(PublishError::TooLarge { .. })));
    assert!(!site.exists());
    let large = within(15_000_000, None).unwrap();
    let small = within(large.bytes * 3 / 4, None).unwrap();
    assert!(small.bytes <= large.bytes * 3 / 4 && small.jpeg < large.jpeg);
    let quarter = within(15_000_000, Some([64, 64])).unwrap();
    assert_eq!((quarter.size, large.size), ([64, 48], [128, 96]));
    assert!(quarter.bytes < large.bytes);
}
