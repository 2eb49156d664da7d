//! `stlfr view` in a real Chromium.
//!
//! `cargo bench --bench view -- CAPTURE [--inputs N] [--minutes M] [--preset NAME]`
//!
//! - file formats of a picture: milliseconds to encode on the server and to decode in the browser
//! - from input to picture, milliseconds: the viewpoint dragged, time scrubbed, two methods beside each other; then at
//!   rest, until the chosen quality is shown. Every input waits for the picture of the one before. A picture counts
//!   when it is drawn on the page; the screen shows it up to 17 ms later.
//! - with `--minutes`, random input: memory of the server, and errors

#[path = "../view/chromium.rs"]
mod chromium;
#[path = "../common/mod.rs"]
mod common;
#[path = "../view/served.rs"]
mod served;

use chromium::{Chromium, Tab};
use image::codecs::jpeg::JpegEncoder;
use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use image::{ExtendedColorType, ImageEncoder, RgbImage};
use serde_json::Value;
use served::Served;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};
use stlfr::random::Random;

type Error = Box<dyn std::error::Error>;

const WINDOW: (u32, u32) = (1280, 800);
/// How often memory is looked at.
const SAMPLE: Duration = Duration::from_secs(5);

/// `move(k)` is an input; the milliseconds from each to its first picture.
const INPUTS: &str = r"(async (count, move, level) => {
    const pane = document.getElementById('pane-a');
    const next = () => new Promise((done) => pane.addEventListener('picture', (e) => done(e.detail), { once: true }));
    const times = [];
    for (let k = 0; k < count; k++) {
        const start = performance.now();
        move(k);
        while ((await next()) !== level);
        times.push(performance.now() - start);
    }
    return times;
})";

const DRAG: &str = r"(k) => {
    const stage = document.getElementById('stage');
    const at = (type, x) => stage.dispatchEvent(new PointerEvent(type, { pointerId: 1, clientX: x, clientY: 400, bubbles: true }));
    Element.prototype.setPointerCapture = () => {};
    if (k === 0) at('pointerdown', 640);
    at('pointermove', 640 + 200 * Math.sin((k + 1) / 9));
}";
const SCRUB: &str = r"(k) => {
    const time = document.getElementById('time');
    const [low, high] = [Number(time.min), Number(time.max)];
    time.value = low + (high - low) * (0.5 + 0.45 * Math.sin((k + 1) / 11));
    time.dispatchEvent(new Event('input'));
}";

fn summary(name: &str, times: &Value) {
    let mut times: Vec<f64> =
        times.as_array().into_iter().flatten().filter_map(Value::as_f64).collect();
    times.sort_by(f64::total_cmp);
    let (Some(worst), Some(median)) = (times.last(), times.get(times.len() / 2)) else { return };
    println!("| {name} | {median:.0} | {worst:.0} | {:.1} |", 1000.0 / median);
}

fn latency(tab: &mut Tab, count: usize) {
    println!("| input | median | worst | a second |\n|---|---|---|---|");
    let run = |tab: &mut Tab, name: &str, count: usize, input: &str, level: &str| {
        let times = tab.value(&format!("{INPUTS}({count}, {input}, '{level}')"));
        summary(name, &times);
    };
    run(tab, "dragged, just arrived", count, DRAG, "quick");
    at_rest(tab);
    // The instant is prepared once nobody waits for a picture.
    std::thread::sleep(Duration::from_secs(5));
    run(tab, "dragged, after a rest", count, DRAG, "quick");
    at_rest(tab);
    run(tab, "time scrubbed", count, SCRUB, "quick");
    at_rest(tab);
    run(tab, "time scrubbed again", count, SCRUB, "quick");
    at_rest(tab);
    tab.key("c", 0);
    at_rest(tab);
    run(tab, "dragged, two methods", count, DRAG, "quick");
    at_rest(tab);
    tab.key("c", 0);
    at_rest(tab);
    run(tab, "from input to rest, another viewpoint", count.div_ceil(8), DRAG, "full");
    run(tab, "from input to rest, another time", count.div_ceil(8), SCRUB, "full");
}

fn at_rest(tab: &mut Tab) {
    tab.until("document.getElementById('status')?.textContent.includes('at rest')");
}

/// A picture of the page as each format: how long it takes to encode, and to decode in the browser.
fn formats(served: &Served, tab: &mut Tab) -> Result<(), Error> {
    use base64::Engine;
    let png = served.get("picture?w=640&h=400&t=0.1").body;
    let picture = image::load_from_memory(&png)?.into_rgb8();
    println!("| format, 640×400 | encode, ms | decode, ms | KiB |\n|---|---|---|---|");
    for name in ["JPEG 85", "PNG fast, up", "PNG fast, adaptive", "PNG default"] {
        let mut bytes = Vec::new();
        let mut times = Vec::new();
        for _ in 0..9 {
            bytes.clear();
            let start = Instant::now();
            encode(name, &picture, &mut bytes)?;
            times.push(1e3 * start.elapsed().as_secs_f64());
        }
        times.sort_by(f64::total_cmp);
        let text = base64::engine::general_purpose::STANDARD.encode(&bytes);
        let decode = tab.value(&format!(
            "(async () => {{ const b = new Blob([Uint8Array.from(atob('{text}'), (c) => c.charCodeAt(0))]); \
             const times = []; for (let k = 0; k < 9; k++) {{ const start = performance.now(); \
             (await createImageBitmap(b)).close(); times.push(performance.now() - start); }} \
             return times.sort((a, b) => a - b)[4]; }})()"
        ));
        let decode = decode.as_f64().unwrap_or(f64::NAN);
        println!("| {name} | {:.1} | {decode:.1} | {} |", times[4], bytes.len() / 1024);
    }
    Ok(())
}

fn encode(name: &str, picture: &RgbImage, bytes: &mut Vec<u8>) -> image::ImageResult<()> {
    let (compression, filter) = match name {
        "PNG fast, up" => (CompressionType::Fast, FilterType::Up),
        "PNG fast, adaptive" => (CompressionType::Fast, FilterType::Adaptive),
        _ => (CompressionType::Default, FilterType::Adaptive),
    };
    let (width, height, rgb) = (picture.width(), picture.height(), ExtendedColorType::Rgb8);
    if name.starts_with("JPEG") {
        return JpegEncoder::new_with_quality(bytes, 85).write_image(picture, width, height, rgb);
    }
    let encoder = PngEncoder::new_with_quality(bytes, compression, filter);
    encoder.write_image(picture, width, height, rgb)
}

/// Resident memory of a process, MiB.
fn resident_mib(process: u32) -> Option<f64> {
    let status = std::fs::read_to_string(format!("/proc/{process}/status")).ok()?;
    let line = status.lines().find_map(|l| l.strip_prefix("VmRSS:"))?;
    Some(line.trim().strip_suffix("kB")?.trim().parse::<f64>().ok()? / 1024.0)
}

/// What somebody might do next.
fn random_input(tab: &mut Tab, random: &mut Random) {
    const KEYS: [&str; 20] = [
        " ",
        "t",
        "c",
        "1",
        "2",
        "3",
        "4",
        "n",
        ".",
        ",",
        "Home",
        "+",
        "-",
        "[",
        "]",
        "l",
        "ArrowLeft",
        "ArrowUp",
        "w",
        "s",
    ];
    let mut place = || [200.0 + 800.0 * random.unit(), 120.0 + 500.0 * random.unit()];
    let (from, to) = (place(), place());
    match (random.unit() * 10.0) as u32 {
        0..=3 => tab.drag(from, to, [0, 0, 8, 2][(random.unit() * 4.0) as usize]),
        4 => tab.wheel(from, 400.0 * (random.unit() - 0.5)),
        5 | 6 => {
            let share = random.unit();
            tab.value(&format!(
                "(() => {{ const t = document.getElementById('time'); \
                 t.value = Number(t.min) + {share} * (t.max - t.min); \
                 t.dispatchEvent(new Event('input')); }})()"
            ));
        }
        _ => tab.key(KEYS[(random.unit() * KEYS.len() as f64) as usize], 0),
    }
    let pause = 0.02 / (0.02 + random.unit());
    std::thread::sleep(Duration::from_secs_f64(pause));
}

/// A problem that the page shows, unless it is that the truth is elsewhere.
const PROBLEMS: &str = "[...document.querySelectorAll('.problem')].filter((p) => !p.hidden && \
                        !p.innerText.includes('truth')).map((p) => p.innerText).join(' | ')";

fn soak(served: &Served, tab: &mut Tab, minutes: f64) {
    tab.value(
        "(() => { window.pictures = 0; for (const p of document.querySelectorAll('.pane')) \
         p.addEventListener('picture', () => window.pictures++); })()",
    );
    let (start, mut random) = (Instant::now(), Random::new(18));
    let (mut samples, mut inputs, mut problems): (Vec<(f64, f64)>, _, _) =
        (Vec::new(), 0, Vec::new());
    while start.elapsed().as_secs_f64() < 60.0 * minutes {
        random_input(tab, &mut random);
        inputs += 1;
        let passed_s = start.elapsed().as_secs_f64();
        if samples.last().is_none_or(|(s, _)| passed_s - s > SAMPLE.as_secs_f64()) {
            samples.extend(resident_mib(served.process()).map(|mib| (passed_s, mib)));
            let problem = tab.value(PROBLEMS).as_str().unwrap_or_default().to_owned();
            problems.extend(Some(problem).filter(|p| !p.is_empty()));
        }
    }
    println!("| minutes | server, MiB |\n|---|---|");
    for tenth in samples.chunks(samples.len().div_ceil(10).max(1)) {
        let most = tenth.iter().map(|s| s.1).fold(0.0, f64::max);
        println!("| {:.1} | {most:.0} |", tenth[tenth.len() - 1].0 / 60.0);
    }
    let pictures = tab.value("window.pictures");
    println!("{inputs} inputs, {pictures} pictures, {} errors", tab.errors.len() + problems.len());
    for error in tab.errors.iter().chain(&problems) {
        println!("error: {error}");
    }
}

fn bench(capture: &Path, count: usize, minutes: f64, preset: Option<String>) -> Result<(), Error> {
    let more: Vec<&str> = preset.iter().flat_map(|name| ["--preset", name]).collect();
    let served = Served::start_with(capture, &more);
    let mut browser = Chromium::start();
    let mut tab = browser.tab(WINDOW, "dark");
    tab.open(&served.address);
    at_rest(&mut tab);
    println!("{}: window of {}×{}", capture.display(), WINDOW.0, WINDOW.1);
    formats(&served, &mut tab)?;
    if count > 0 {
        latency(&mut tab, count);
    }
    if minutes > 0.0 {
        soak(&served, &mut tab, minutes);
    }
    println!("server: {:.0} MiB", resident_mib(served.process()).unwrap_or(f64::NAN));
    Ok(())
}

fn main() -> Result<(), Error> {
    let (mut captures, mut count, mut minutes, mut preset) = (Vec::new(), 80, 0.0, None);
    let mut arguments = std::env::args().skip(1).filter(|a| a != "--bench");
    while let Some(argument) = arguments.next() {
        let mut value = || arguments.next().ok_or(format!("{argument} lacks a value"));
        match argument.as_str() {
            "--inputs" => count = value()?.parse()?,
            "--minutes" => minutes = value()?.parse()?,
            "--preset" => preset = Some(value()?),
            _ => captures.push(PathBuf::from(argument)),
        }
    }
    captures.iter().try_for_each(|capture| bench(capture, count, minutes, preset.clone()))
}
