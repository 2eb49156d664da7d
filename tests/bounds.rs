//! Hostile files: refused in one sentence, or passed over, at once and within a gigabyte of memory. Every
//! input found is a case with a name. By hand, `cargo test --release --test bounds -- --nocapture` prints
//! the table.

mod common;

use common::wall::{FOCAL_PX, H, Scene, write_truth};
use common::{assert_refused, make_pipe, run, stderr, stlfr, text};
use serde_json::json;
use std::fs::File;
use std::io::Write;
use std::os::unix::fs::symlink;
use std::path::Path;
use std::process::Stdio;
use std::time::{Duration, Instant};
use stlfr::raster::{BitDepth, Image, read_image};
use tempfile::TempDir;

/// Most memory that any of these may take, MiB: a gigabyte.
const MAX_MIB: f64 = 953.0;
/// How long any may take. Larger: a hang is waited for. Smaller: a busy machine is taken for one.
const MAX_TIME: Duration = Duration::from_secs(60);

/// A capture with truth, a view, a calibration and its images: everything that a command reads.
fn inputs() -> TempDir {
    let scene = Scene { frames: 3, ..Scene::default() };
    let folder = scene.film();
    let root = folder.path();
    write_truth(root, &scene);
    std::fs::write(root.join("view.json"), scene.camera([0.01, 0.0, 0.0]).to_string()).unwrap();
    for (format, to) in [("colmap", "bin"), ("colmap-text", "txt"), ("nerf", "nerf.json")] {
        let to = root.join(to);
        let export = run(&["export", text(root), "--format", format, "-o", text(&to)]);
        assert!(export.status.success(), "{}", stderr(&export));
    }
    folder
}

/// Where a file is put, and the command that reads it, with the inputs' folder for `@`.
type Reader = (&'static str, &'static str);

const READERS: [Reader; 17] = [
    ("capture.json", "plan @"),
    ("offsets.json", "offsets @"),
    ("truth/truth.json", "compare @ -o @/review"),
    ("truth/0.npy", "compare @ -o @/review"),
    ("truth/0.png", "compare @ -o @/review"),
    ("view.json", "render @ --camera @/view.json --time 0.05 -o @/out.png"),
    ("options.json", "plan @ --options @/options.json"),
    ("mine.json", "compare @ --offsets @/mine.json"),
    ("bin/cameras.bin", "import @/bin --images @ --rate 25 -o @/new"),
    ("bin/images.bin", "import @/bin --images @ --rate 25 -o @/new"),
    ("txt/images.txt", "import @/txt --images @ --rate 25 -o @/new"),
    ("nerf.json", "import @/nerf.json --images @ --rate 25 -o @/new"),
    ("llff.npy", "import @/llff.npy --images @ --rate 25 -o @/new"),
    ("Calib.toml", "import @/Calib.toml --images @ --rate 25 -o @/new"),
    ("Calib.qca.txt", "import @/Calib.qca.txt --images @ --rate 25 -o @/new"),
    ("times.csv", "import @/nerf.json --images @ --times @/times.csv -o @/new"),
    ("bin/times.bin", "import @/bin --images @ --rate 25 -o @/new"),
];

/// How a command on a hostile input ended.
struct Ended {
    code: Option<i32>,
    sentence: String,
    peak_mib: f64,
    seconds: f64,
}

/// Runs a command, which must end in time.
fn ended(command: &str, root: &Path) -> Ended {
    let start = Instant::now();
    let words = command.split(' ').map(|word| word.replace('@', text(root)));
    let mut child = stlfr()
        .arg("-q")
        .args(words)
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .expect("the program starts");
    let status = format!("/proc/{}/status", child.id());
    let mut peak_mib = 0.0_f64;
    loop {
        let high_water = std::fs::read_to_string(&status).ok().and_then(|status| {
            let line = status.lines().find_map(|l| l.strip_prefix("VmHWM:"))?;
            line.trim().strip_suffix("kB")?.trim().parse::<f64>().ok()
        });
        peak_mib = peak_mib.max(high_water.unwrap_or(0.0) / 1024.0);
        if child.try_wait().expect("the program can be waited for").is_some() {
            break;
        }
        if start.elapsed() > MAX_TIME || peak_mib > 4.0 * MAX_MIB {
            child.kill().expect("the program can be killed");
        }
        std::thread::sleep(Duration::from_millis(1));
    }
    let seconds = start.elapsed().as_secs_f64();
    let output = child.wait_with_output().expect("the program has ended");
    Ended { code: output.status.code(), sentence: stderr(&output), peak_mib, seconds }
}

/// Checks how a command ended, and prints its row of the table: refused in a sentence with these words,
/// or done where there are none.
#[track_caller]
fn check(name: &str, command: &str, root: &Path, words: &str) {
    let Ended { code, sentence, peak_mib, seconds } = ended(command, root);
    let shown = sentence.trim().replace(text(root), "CAPTURE");
    let code_shown = code.map_or("killed".into(), |code| code.to_string());
    println!("| {name} | {code_shown} | {peak_mib:.0} | {seconds:.2} | {shown} |");
    assert_eq!(code, Some(if words.is_empty() { 0 } else { 2 }), "{name}: {sentence}");
    assert!(sentence.contains(words), "{name}: {sentence}");
    assert!(sentence.trim_end().lines().count() <= 1, "{name}: {sentence}");
    assert!(peak_mib <= MAX_MIB, "{name}: {peak_mib:.0} MiB");
}

/// Each file as something that is no regular file.
fn no_file(kind: &str, make: fn(&Path)) {
    let folder = inputs();
    for (file, command) in READERS {
        let path = folder.path().join(file);
        let kept = folder.path().join("kept");
        let was_there = path.exists();
        if was_there {
            std::fs::rename(&path, &kept).unwrap();
        }
        make(&path);
        let command = command.to_owned();
        let words = match kind {
            // Links inside of truth/ must not lead out of it.
            "a device" if file.starts_with("truth/0") => "must stay inside truth/",
            _ => &format!("is {kind}, not a regular file"),
        };
        check(&format!("{file}: {kind}"), &command, folder.path(), words);
        if path.is_dir() {
            std::fs::remove_dir(&path).unwrap();
        } else {
            std::fs::remove_file(&path).unwrap();
        }
        if was_there {
            std::fs::rename(&kept, &path).unwrap();
        }
    }
}

#[test]
fn pipes_are_refused_and_not_waited_for() {
    no_file("a pipe", make_pipe);
}

#[test]
fn endless_devices_are_refused() {
    no_file("a device", |path| symlink("/dev/zero", path).unwrap());
    let folder = inputs();
    let options = "plan @ --options /dev/zero";
    check("--options /dev/zero", options, folder.path(), "/dev/zero: is a device");
    make_pipe(&folder.path().join("rig.json"));
    let rig = "capture @/rig.json --scene still -o @/new";
    check("rig.json: a pipe", rig, folder.path(), "rig.json: is a pipe, not a regular file");
}

#[test]
fn folders_are_refused() {
    no_file("a folder", |path| std::fs::create_dir(path).unwrap());
}

#[test]
fn files_of_terabytes_are_refused_unread() {
    for (file, command) in READERS {
        let folder = inputs();
        let path = folder.path().join(file);
        File::create(&path).unwrap().set_len(1 << 40).unwrap();
        check(&format!("{file}: 1 TiB"), command, folder.path(), ", the maximum");
    }
}

/// The largest view that is not refused, over each geometry.
#[test]
fn the_largest_views_take_no_gigabyte() {
    let folder = inputs();
    let mut view = Scene { frames: 3, ..Scene::default() }.camera([0.01, 0.0, 0.0]);
    let (width, height) = (8192, 4320);
    let zoom = f64::from(height) / H as f64;
    (view["width"], view["height"]) = (json!(width), json!(height));
    let focal = zoom * FOCAL_PX;
    view["params"] = json!([focal, focal, f64::from(width) / 2.0, f64::from(height) / 2.0]);
    std::fs::write(folder.path().join("view.json"), view.to_string()).unwrap();
    for (geometry, kind) in [
        ("mesh", "png"),
        ("depth", "png"),
        ("scene-flow", "png"),
        ("depth", "exr"),
        ("scene-flow", "exr"),
    ] {
        let view = "render @ --camera @/view.json --time 0.05 --sync refined";
        let command = format!("{view} --proxy {geometry} -o @/out.{kind}");
        check(&format!("{width}×{height}, {geometry}, {kind}"), &command, folder.path(), "");
    }
}

/// What stands between, over and over.
fn write_list(path: &Path, [before, entry, after]: [&str; 3], bytes: usize) {
    let mut file = File::create(path).unwrap();
    let chunk = entry.repeat((1 << 20) / entry.len());
    file.write_all(before.as_bytes()).unwrap();
    for _ in 0..bytes / chunk.len() {
        file.write_all(chunk.as_bytes()).unwrap();
    }
    file.write_all(after.as_bytes()).unwrap();
}

const MIB: usize = 1 << 20;

/// A list: its file, what it is of, before, entry and after, its MiB, the command, and its words.
type List<'a> = (&'a str, &'a str, [&'a str; 3], usize, &'a str, &'a str);

fn check_lists(lists: &[List]) {
    for &(name, file, list, mib, command, words) in lists {
        let folder = inputs();
        write_list(&folder.path().join(file), list, mib * MIB);
        check(&format!("{file}: {name}"), command, folder.path(), words);
    }
}

/// Lists as long as the files may be: what their entries are in memory stays within bounds too.
#[test]
fn long_lists_of_a_capture_take_no_gigabyte() {
    let camera = r#"{"id":"a","frames":"a%d","width":1,"height":1,"model":"","params":[],
        "cam_from_world":{"rotation_wxyz":[1,0,0,0],"translation":[0,0,0]},"clock":{"shared":true"#;
    let head = r#"{"format":"stlfr-capture","version":1,"name":"a","cameras":["#;
    let cameras = [head, &format!("{camera}}}}},"), &format!("{camera}}}}}]}}")];
    let times = [&format!("{head}{camera},\"times_s\":["), "0,", "0]}}]}"];
    let view = r#"{"id":"a","time_s":0,"like":null,"image":"","depth":"","motion":"","camera":{"width":1,
        "height":1,"model":"","params":[],"cam_from_world":{"rotation_wxyz":[1,0,0,0],"translation":[0,0,0]}}}"#;
    let truth = r#"{"format":"stlfr-truth","version":1,"scene":"","rig":"","#;
    let views_after = format!("{view}],\"offsets\":[],\"shutter\":[]}}");
    let (views_before, view) = (format!("{truth}\"views\":["), format!("{view},"));
    let views = [views_before.as_str(), &view, &views_after];
    let clocks_after = "{\"id\":\"a\",\"offset_s\":0}],\"views\":[],\"shutter\":[]}";
    let clocks = [&format!("{truth}\"offsets\":["), "{\"id\":\"a\",\"offset_s\":0},", clocks_after];
    let compare = READERS[2].1;
    check_lists(&[
        ("63 MiB of cameras", "capture.json", cameras, 63, "plan @", "capture.json: cameras"),
        ("63 MiB of times", "capture.json", times, 63, "plan @", "capture.json: cameras"),
        ("63 MiB of views", "truth/truth.json", views, 63, compare, "at most 10000 are read"),
        ("63 MiB of clocks", "truth/truth.json", clocks, 63, READERS[7].1, "mine.json: "),
    ]);
}

#[test]
fn other_long_lists_take_no_gigabyte() {
    let matrix = "[[1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]";
    let frame = format!("{{\"file_path\":\"\",\"transform_matrix\":{matrix},\"w\":9}},");
    let one = frame.trim_end_matches(',');
    let frames_after = format!("{one}]}}");
    let offset = "{\"id\":\"\"},";
    let offsets = ["{\"reference\":\"cam1\",\"cameras\":[", offset, "{\"id\":\"\"}]}"];
    let numbers = |before| [before, "0,", "0]}"];
    let nerf = READERS[11].1;
    check_lists(&[
        ("200 MB of numbers", "nerf.json", numbers("{\"x\":["), 200, nerf, "64 MiB"),
        ("63 MiB of numbers", "nerf.json", numbers("{\"x\":["), 63, nerf, "frames"),
        (
            "63 MiB of empty frames",
            "nerf.json",
            ["{\"frames\":[", "{},", "{}]}"],
            63,
            nerf,
            "more than 100000 frames",
        ),
        (
            "63 MiB of frames",
            "nerf.json",
            ["{\"frames\":[", &frame, &frames_after],
            63,
            nerf,
            "more than 100000 frames",
        ),
        ("15 MiB of empty cameras", "offsets.json", offsets, 15, "offsets @", "no camera of"),
        ("15 MiB of empty cameras", "mine.json", offsets, 15, READERS[7].1, "mine.json"),
        ("63 MiB of numbers", "capture.json", numbers("{\"x\":["), 63, "plan @", "x: unknown"),
        ("900 KiB of numbers", "options.json", numbers("{\"x\":["), 0, READERS[6].1, "x: unknown"),
        (
            "700 MiB of images",
            "txt/images.txt",
            ["", "1 1 0 0 0 0 0 0 1 a\n\n", ""],
            700,
            READERS[10].1,
            "more than 100000 images",
        ),
        (
            "700 MiB of cameras",
            "bin/cameras.bin",
            ["\u{7f}", "\0\0\0\0", ""],
            700,
            READERS[8].1,
            "bin",
        ),
    ]);
}

/// CRC-32 of a chunk, as PNG has it.
fn crc(bytes: &[u8]) -> u32 {
    let table: Vec<u32> = (0..256_u32)
        .map(|n| (0..8).fold(n, |c, _| if c & 1 == 1 { 0xedb8_8320 ^ (c >> 1) } else { c >> 1 }))
        .collect();
    !bytes.iter().fold(!0, |c, b| table[(c as u8 ^ b) as usize] ^ (c >> 8))
}

/// So many zeros and some, compressed, without the checksum: one block of fixed codes, of which each is
/// the last byte again 258 times.
fn zeros(bytes: usize) -> Vec<u8> {
    let mut stream = vec![0x78, 0x01];
    let (mut buffer, mut filled) = (0_u64, 0);
    let mut put = |stream: &mut Vec<u8>, bits: &str| {
        for bit in bits.bytes() {
            buffer |= u64::from(bit - b'0') << filled;
            filled += 1;
            if filled == 8 {
                stream.push(buffer as u8);
                (buffer, filled) = (0, 0);
            }
        }
    };
    put(&mut stream, "110"); // the last block, of fixed codes
    put(&mut stream, "00110000"); // a zero
    let again = "1100010100000"; // 258 bytes from 1 byte back
    let start = stream.len();
    // Eight of them are 13 bytes: from then on all is the same.
    (0..8).for_each(|_| put(&mut stream, again));
    let eight = stream[start..].to_vec();
    (1..bytes / (8 * 258)).for_each(|_| stream.extend(&eight));
    put(&mut stream, "0000000"); // the end
    put(&mut stream, "00000000");
    stream
}

/// A PNG with another chunk before its pixels.
fn with_chunk(png: &[u8], kind: &[u8], data: &[u8]) -> Vec<u8> {
    const AFTER_HEADER: usize = 8 + 25;
    let body = [kind, data].concat();
    let length = (data.len() as u32).to_be_bytes();
    let chunk = [&length[..], &body, &crc(&body).to_be_bytes()].concat();
    [&png[..AFTER_HEADER], &chunk, &png[AFTER_HEADER..]].concat()
}

#[test]
fn what_else_an_image_holds_is_not_unpacked() {
    let folder = inputs();
    let frame = folder.path().join("cam1/1.png");
    let whole = std::fs::read(&frame).unwrap();
    let image = read_image(&frame).unwrap();
    let four_gigabytes = zeros(4_000_000_000);
    let chunks = [("iCCP", "p\0\0"), ("zTXt", "t\0\0"), ("iTXt", "t\0\x01\0\0\0")];
    for (kind, before) in chunks {
        let data = [before.as_bytes(), &four_gigabytes].concat();
        std::fs::write(&frame, with_chunk(&whole, kind.as_bytes(), &data)).unwrap();
        let render = "render @ --like cam1 --sync nearest --time 0.041 -o @/out.png";
        check(&format!("a frame with 4 GB in its {kind}"), render, folder.path(), "");
        assert_eq!(read_image(&frame).unwrap(), image);
    }
}

#[test]
fn an_image_of_gigabytes_is_refused() {
    let folder = inputs();
    // 60000×60000 in a few bytes, and no pixels.
    let mut png = b"\x89PNG\r\n\x1a\n\0\0\0\x0d".to_vec();
    let header = [b"IHDR".as_slice(), &60_000_u32.to_be_bytes(), &60_000_u32.to_be_bytes()];
    let header = [&header.concat()[..], &[8, 2, 0, 0, 0]].concat();
    png.extend(&header);
    png.extend(crc(&header).to_be_bytes());
    png.extend([0, 0, 0, 0]);
    png.extend(b"IDAT");
    png.extend(crc(b"IDAT").to_be_bytes());
    let frame = folder.path().join("cam1/1.png");
    for (name, bytes) in [
        ("png", png),
        ("ppm", b"P6 60000 60000 255\n".to_vec()),
        ("pgm", b"P5 60000 60000 255\n".to_vec()),
    ] {
        std::fs::write(&frame, bytes).unwrap();
        let words = "cam1/1.png: is 60000×60000 pixels";
        check(&format!("a {name} of 60000×60000"), "plan @", folder.path(), words);
    }
}

/// PNG of every kind: the samples are those of the `image` crate, which read them before.
#[test]
fn every_kind_of_png_is_read_as_ever() {
    use image::{DynamicImage, ExtendedColorType, ImageEncoder, codecs::png::PngEncoder};
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.png");
    let (w, h) = (7, 5);
    for (kind, bytes) in [
        (ExtendedColorType::L8, 1),
        (ExtendedColorType::La8, 2),
        (ExtendedColorType::Rgb8, 3),
        (ExtendedColorType::Rgba8, 4),
        (ExtendedColorType::L16, 2),
        (ExtendedColorType::La16, 4),
        (ExtendedColorType::Rgb16, 6),
        (ExtendedColorType::Rgba16, 8),
    ] {
        let data: Vec<u8> = (0..w * h * bytes).map(|k| (37 * k % 251) as u8).collect();
        let encoder = PngEncoder::new(File::create(&path).unwrap());
        encoder.write_image(&data, w, h, kind).unwrap();
        let (found, depth) = read_image(&path).unwrap();
        let expected = image::open(&path).unwrap();
        let is_gray = matches!(
            expected,
            DynamicImage::ImageLuma8(_)
                | DynamicImage::ImageLumaA8(_)
                | DynamicImage::ImageLuma16(_)
                | DynamicImage::ImageLumaA16(_)
        );
        let samples: Vec<f32> = match (is_gray, depth) {
            (true, BitDepth::Eight) => unit(&expected.into_luma8(), 255.0),
            (true, BitDepth::Sixteen) => unit(&expected.into_luma16(), 65535.0),
            (false, BitDepth::Eight) => unit(&expected.into_rgb8(), 255.0),
            (false, BitDepth::Sixteen) => unit(&expected.into_rgb16(), 65535.0),
        };
        let channels = if is_gray { 1 } else { 3 };
        assert_eq!(found, Image::from_data(w as usize, h as usize, channels, samples), "{kind:?}");
    }
}

fn unit<T: Copy + Into<f32>>(samples: &[T], largest: f32) -> Vec<f32> {
    samples.iter().map(|&v| v.into() / largest).collect()
}

/// What `render` says of times that nobody filmed, and that it has written nothing by then.
#[track_caller]
fn assert_refused_before_writing(folder: &TempDir, arguments: &[&str], words: &str) {
    let out = tempfile::tempdir().unwrap();
    let pattern = out.path().join("%d.png");
    let render = ["-q", "render", text(folder.path()), "-o", text(&pattern)];
    assert_refused(&run(&[&render[..], arguments].concat()), 2, words);
    assert_eq!(std::fs::read_dir(out.path()).unwrap().count(), 0, "nothing is written");
}

#[test]
fn a_span_outside_of_the_film_is_told_before_the_first_image() {
    let folder = inputs();
    let has_offsets = || folder.path().join("offsets.json").exists();
    // The reference's times are known without an estimate.
    let wholly = ["--like", "cam1", "--times", "5:6:10000"];
    assert_refused_before_writing(
        &folder,
        &wholly,
        "cam1 has no frames around 5 s: it covers 0 to 0.08 s",
    );
    let partly = ["--like", "cam1", "--times", "0.02:0.09:10000"];
    assert_refused_before_writing(&folder, &partly, "cam1 has no frames around 0.08000");
    // The others' are not, but they can't be minutes away.
    let wholly = ["--like", "cam0", "--times", "60:70:10000"];
    assert_refused_before_writing(&folder, &wholly, "whatever the offsets, cam0 filmed within");
    let camera = folder.path().join("view.json");
    let view = ["--camera", text(&camera), "--times", "60:70:10000"];
    assert_refused_before_writing(
        &folder,
        &view,
        "whatever the offsets, the cameras filmed within",
    );
    assert!(!has_offsets(), "nothing was estimated for it");
    // Partly outside by the estimate: before the first image all the same.
    let partly = ["--like", "cam0", "--times", "0.03:0.2:9"];
    assert_refused_before_writing(&folder, &partly, "cam0 has no frames around");
    let view = ["--camera", text(&camera), "--times", "0.03:0.2:9"];
    assert_refused_before_writing(&folder, &view, "no camera has frames around");
    assert!(has_offsets());
}

#[test]
fn a_span_outside_of_known_clocks_is_told_without_the_frames() {
    let folder = Scene { frames: 3, shared: [true; 3], ..Scene::default() }.film();
    // What can't be decoded isn't asked for.
    let frame = folder.path().join("cam0/1.png");
    let bytes = std::fs::read(&frame).unwrap();
    std::fs::write(&frame, &bytes[..bytes.len() / 2]).unwrap();
    std::fs::write(
        folder.path().join("view.json"),
        Scene::default().camera([0.01, 0.0, 0.0]).to_string(),
    )
    .unwrap();
    let camera = folder.path().join("view.json");
    let view = ["--camera", text(&camera), "--times", "0.03:0.2:9"];
    assert_refused_before_writing(&folder, &view, "no camera has frames around 0.0938 s");
    let like = ["--like", "cam0", "--times", "-0.01:0.02:9"];
    assert_refused_before_writing(&folder, &like, "cam0 has no frames around -0.01 s");
}
