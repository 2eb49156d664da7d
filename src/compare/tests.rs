//! Tests of the comparison on a tiny capture, with a renderer whose errors are known.

use super::*;
use crate::capture::{CAPTURE_FILE, Capture, Truth};
use crate::offset::{CameraOffset, Offsets};
use crate::progress::Reporter;
use crate::raster::{BitDepth, Image, read_image, write_image};
use serde_json::{Value, json};

const W: usize = 24;
const H: usize = 20;
/// Time of the capture's first instant in `capture.json`, seconds. Inside the program this time is 0.
const ORIGIN_S: f64 = 100.0;
/// A valid camera id that isn't safe as a file name.
const EVIL: &str = "an odd id";

/// Returns the JSON of a camera with 8 frames per second, whose frame times are exact in binary.
fn camera(id: &str) -> Value {
    json!({"width": W, "height": H, "model": "PINHOLE", "params": [24.0, 24.0, 12.0, 10.0],
        "cam_from_world": {"rotation_wxyz": [1, 0, 0, 0], "translation": [0, 0, 0]},
        "id": id, "frames": format!("{}/%d.png", if id == EVIL { "evil" } else { id }),
        "clock": {"rate_hz": 8.0, "first_s": ORIGIN_S, "shared": false}})
}

fn scene() -> Image {
    let data = (0..W * H * 3).map(|k| 0.25 + ((k * 37) % 41) as f32 / 82.0).collect();
    Image::from_data(W, H, 3, data)
}

/// Returns the bytes of an npy file with a motion of 2 px in the image's top left quarter, and 0 elsewhere.
fn motion() -> Vec<u8> {
    let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
    let header = format!("{{'descr': '<f4', 'fortran_order': False, 'shape': ({H}, {W}), }}\n");
    bytes.extend((header.len() as u16).to_le_bytes());
    bytes.extend(header.as_bytes());
    for k in 0..W * H {
        let moves = k % W < W / 2 && k / W < H / 2;
        bytes.extend(if moves { 2f32 } else { 0.0 }.to_le_bytes());
    }
    bytes
}

struct Set {
    folder: tempfile::TempDir,
    fake: Fake,
}

impl Set {
    /// Writes a capture of two cameras, with the ids `a` and [`EVIL`]. The ground truth has images of one instant: with
    /// the poses of both cameras, and from a new view. `change` edits the ground truth before it is written.
    fn new(change: impl FnOnce(&mut Value)) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let capture = json!({"format": "stlfr-capture", "version": 1, "name": "<b>tiny</b>",
            "reference": "a", "cameras": [camera("a"), camera(EVIL)]});
        for id in ["a", "evil"] {
            for k in 0..3 {
                let path = folder.path().join(format!("{id}/{k}.png"));
                write_image(&path, &scene(), None, BitDepth::Sixteen).unwrap();
            }
        }
        let view = |id: &str, like: Option<&str>| {
            let mut at = camera("x");
            for field in ["id", "frames", "clock"] {
                at.as_object_mut().unwrap().remove(field);
            }
            json!({"id": id, "time_s": ORIGIN_S + 0.0625, "like": like, "camera": at,
                "image": "v.png", "depth": "none.npy", "motion": "v.npy"})
        };
        let mut truth = json!({"format": "stlfr-truth", "version": 1, "scene": "s", "rig": "r",
            "offsets": [{"id": "a", "offset_s": 0.0}, {"id": EVIL, "offset_s": 0.01}],
            "shutter": [],
            "views": [view("t0-a", Some("a")), view("t0-evil", Some(EVIL)), view("t0-new", None)]});
        change(&mut truth);
        let path = folder.path().join("truth/v.png");
        write_image(&path, &scene(), None, BitDepth::Sixteen).unwrap();
        std::fs::write(folder.path().join("truth/v.npy"), motion()).unwrap();
        std::fs::write(folder.path().join(CAPTURE_FILE), capture.to_string()).unwrap();
        std::fs::write(folder.path().join("truth/truth.json"), truth.to_string()).unwrap();
        let fake = Fake {
            field: LightField::new(Arc::new(Capture::open(folder.path()).unwrap()), offsets()),
            truth: read_image(&path).unwrap().0,
            broken: None,
            covered: W * H,
            options: RenderOptions::default(),
        };
        Self { folder, fake }
    }

    fn compare(&self, options: &CompareOptions) -> Result<Summary, CompareError> {
        let truth = Truth::open(self.folder.path())?;
        compare(&self.fake, truth.as_ref(), &self.out(), options, &Reporter::silent())
    }

    fn out(&self) -> PathBuf {
        self.folder.path().join("review")
    }

    fn metrics(&self) -> Value {
        serde_json::from_slice(&std::fs::read(self.out().join("metrics.json")).unwrap()).unwrap()
    }
}

fn offsets() -> Offsets {
    let row = |id: &str, offset_s, std_err_s| CameraOffset {
        id: id.into(),
        offset_s: Some(offset_s),
        std_err_s: Some(std_err_s),
        ..CameraOffset::default()
    };
    let cameras = vec![row("a", 0.0, 0.0), row(EVIL, 0.0125, f64::INFINITY)];
    Offsets { reference: "a".into(), cameras }
}

/// A renderer whose errors are known. The image of a camera differs from the ground-truth image by 0.1 with `nearest`,
/// and by 0.01 with all other synchronization methods. A rendered view is the mean of the cameras' images.
struct Fake {
    field: LightField,
    truth: Image,
    /// Index of a camera for which every synchronization method except `nearest` fails.
    broken: Option<usize>,
    /// Number of covered pixels of a rendered view: the first pixels, row by row.
    covered: usize,
    options: RenderOptions,
}

impl Renderer for Fake {
    fn field(&self) -> &LightField {
        &self.field
    }

    fn synchronized(
        &self,
        sync: SyncMethod,
        camera: usize,
        time_s: f64,
    ) -> Result<Arc<Synchronized>, String> {
        assert!((0.0..=0.25).contains(&time_s), "times start with the capture: {time_s}");
        let error = match sync {
            SyncMethod::Nearest => 0.1,
            _ if self.broken == Some(camera) => return Err("it has no frame <there>".into()),
            _ => 0.01,
        };
        let mut image = self.truth.clone();
        image.data_mut().iter_mut().for_each(|v| *v += error);
        Ok(Arc::new(Synchronized::filmed(image)))
    }

    fn view(&self, view: &ComparedView) -> Result<Rendered, String> {
        let &ComparedView { target, time_s, .. } = view;
        let of = |camera: usize| match view.images {
            Images::By(sync) => self.synchronized(sync, camera, time_s).ok(),
            Images::Given(given) => given.all()[camera].clone(),
        };
        let images: Vec<Arc<Synchronized>> = (0..2).filter_map(of).collect();
        let images: Vec<&Image> = images.iter().map(|s| &s.image).collect();
        let mean = |k: usize| images.iter().map(|i| i.data()[k]).sum::<f32>() / images.len() as f32;
        let coverage: Vec<bool> = (0..W * H).map(|k| k < self.covered).collect();
        let data = (0..W * H * 3).map(|k| if coverage[k / 3] { mean(k) } else { 0.0 }).collect();
        Ok(Rendered { image: Image::from_data(target.width, target.height, 3, data), coverage })
    }

    fn options(&self) -> &RenderOptions {
        &self.options
    }

    fn timings(&self) -> Vec<StageTime> {
        vec![StageTime { stage: "registration".into(), seconds: 1.0 }]
    }
}

fn near(value: &Value, expected: f64) {
    let value = value.as_f64().unwrap_or(f64::NAN);
    assert!((value - expected).abs() < 0.01, "{value} instead of {expected}");
}

#[test]
fn known_errors_give_the_known_numbers() {
    let set = Set::new(|_| ());
    let summary = set.compare(&CompareOptions::default()).unwrap();
    let m = set.metrics();
    assert_eq!(m["sync"].as_array().unwrap().len(), 4);
    assert_eq!(m["views"].as_array().unwrap().len(), 9);
    for row in m["sync"].as_array().unwrap() {
        let db = if row["method"] == "nearest" { 20.0 } else { 40.0 };
        near(&row["scores"]["whole"]["psnr_db"], db);
        near(&row["scores"]["moving"]["psnr_db"], db);
        // The moving quarter has 12×10 pixels. Dilation adds 2 pixels to the right and below.
        assert_eq!(row["scores"]["moving"]["pixels"], 14 * 12);
        near(&row["time_s"], ORIGIN_S + 0.0625);
    }
    for row in m["views"].as_array().unwrap() {
        let psnr = &row["scores"]["whole"]["psnr_db"];
        match row["method"].as_str().unwrap() {
            "traditional-lfr" => near(psnr, 20.0),
            "st-lfr" => near(psnr, 40.0),
            _ => assert!(psnr.is_null()),
        }
        assert_eq!(row["cameras"], 2);
    }
    near(&m["headline"]["sync"]["median_gain_db"], 20.0);
    near(&m["headline"]["views"][1]["gain_moving_db"], 20.0);
    near(&m["headline"]["offset"]["worst_frames"], 0.0025 * 8.0);
    assert!(m["offsets"][1]["std_err_s"].is_null());
    assert_eq!(m["headline"]["missing_images"], 0);
    assert_eq!(summary.report, set.out().join("report.html"));
    for file in ["timings.json", "report.html", "sheets/t0-a.webp", "sheets/t0-new-mesh.webp"] {
        assert!(set.out().join(file).is_file(), "{file}");
    }
    let (written, depth) = read_image(&set.out().join("images/t0-a/nearest.png")).unwrap();
    assert_eq!((written.width(), depth), (W, BitDepth::Sixteen));
}

#[test]
fn what_comes_from_files_is_escaped() {
    let set = Set::new(|truth| truth["scene"] = json!("\"><img src=x><script>alert(1)</script>"));
    set.compare(&CompareOptions { all_methods: true, ..Default::default() }).unwrap();
    let html = std::fs::read_to_string(set.out().join("report.html")).unwrap();
    assert!(
        !html.contains("<script>alert")
            && !html.contains("<img src=x>")
            && !html.contains("<b>tiny")
    );
    assert!(html.contains("&lt;script&gt;alert(1)"));
    assert!(!html.contains("http://") && !html.contains("https://"), "it needs no network");
    // The report must show the files that were measured.
    let data = html.split("application/json\">").nth(1).unwrap().split("</script>").next().unwrap();
    let groups: Value = serde_json::from_str(data).unwrap();
    let views = groups.as_array().unwrap().iter().flat_map(|g| g["views"].as_array().unwrap());
    let (mut views, mut files) = (views.collect::<Vec<_>>(), Vec::new());
    assert_eq!(views.len(), 3);
    for view in views.drain(..) {
        files.push(view["truth"].as_str().unwrap());
        let cells =
            view["cells"].as_array().unwrap().iter().flat_map(|row| row.as_array().unwrap());
        files.extend(cells.map(|cell| cell["file"].as_str().unwrap()));
    }
    assert!(
        files.len() > 20 && files.iter().all(|file| set.out().join(file).is_file()),
        "{files:?}"
    );
}

#[test]
fn bytes_do_not_depend_on_the_thread_count() {
    let set = Set::new(|_| ());
    let mut seen = Vec::new();
    for threads in [1, 3] {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| set.compare(&CompareOptions::default())).unwrap();
        seen.push(std::fs::read(set.out().join("metrics.json")).unwrap());
    }
    assert_eq!(seen[0], seen[1]);
    let text = String::from_utf8(seen.remove(0)).unwrap();
    assert!(!text.contains("NaN") && !text.contains("inf"));
}

#[test]
fn a_camera_without_an_image_is_excluded_and_counted() {
    let mut set = Set::new(|_| ());
    set.fake.broken = Some(1);
    set.compare(&CompareOptions::default()).unwrap();
    let m = set.metrics();
    let st = m["views"].as_array().unwrap().iter().find(|v| v["method"] == "st-lfr").unwrap();
    assert_eq!((&st["cameras"], &st["excluded"][0]["camera"]), (&json!(1), &json!(EVIL)));
    let lost = m["sync"].as_array().unwrap().iter().find(|s| s["scores"].is_null()).unwrap();
    assert_eq!(lost["reason"], "it has no frame <there>");
    assert_eq!(m["headline"]["missing_images"], 4, "one camera image, and it in three proxies");
}

#[test]
fn pixels_that_no_camera_sees_are_not_measured() {
    let mut set = Set::new(|_| ());
    set.fake.covered = W * H / 2;
    set.compare(&CompareOptions::default()).unwrap();
    let m = set.metrics();
    let row = &m["views"][0];
    near(&row["measured"], 0.5);
    near(&row["scores"]["whole"]["psnr_db"], 20.0);
    assert_eq!(row["scores"]["whole"]["pixels"], W * H / 2);
}

#[test]
fn without_motion_the_moving_part_is_null_and_nothing_panics() {
    let set = Set::new(|_| ());
    set.compare(&CompareOptions { moving_threshold_px: 9.0, ..Default::default() }).unwrap();
    let m = set.metrics();
    assert_eq!(
        m["sync"][0]["scores"]["moving"],
        json!({"pixels": 0, "psnr_db": null,
        "ssim": null, "flip": null})
    );
    assert!(m["headline"]["sync"]["median_gain_db"].is_null());
    let none = Set::new(|truth| truth["views"] = json!([]));
    let summary = none.compare(&CompareOptions::default()).unwrap();
    assert_eq!((summary.headline.sync.median_gain_db, summary.headline.views.len()), (None, 0));
}

#[test]
fn what_is_wrong_is_one_sentence() {
    let set = Set::new(|_| ());
    let message =
        |set: &Set, options: CompareOptions| set.compare(&options).unwrap_err().to_string();
    let flat = CompareOptions { pixels_per_degree: f64::NAN, ..Default::default() };
    assert!(message(&set, flat).starts_with("pixels_per_degree is NaN"));
    std::fs::remove_file(set.folder.path().join("truth/v.npy")).unwrap();
    assert!(message(&set, CompareOptions::default()).contains("v.npy"));
    std::fs::remove_file(set.folder.path().join("truth/truth.json")).unwrap();
    assert!(message(&set, CompareOptions::default()).contains("has no truth"));
    assert!(!set.out().exists(), "nothing is rendered before the truth is checked");

    type Break = fn(&mut Value);
    let cases: &[(Break, &str)] = &[
        (|t| t["views"][1]["like"] = json!("zz"), "no camera has the id 'zz'"),
        (|t| t["views"][1]["id"] = json!("t0-a"), "views[1] (t0-a)"),
        (|t| t["views"][2]["image"] = json!("../v.png"), "inside truth/"),
        (|t| t["views"][2]["camera"]["width"] = json!(25), "24×20 pixels, its camera 25×20"),
    ];
    for (make_wrong, expected) in cases {
        let message = message(&Set::new(make_wrong), CompareOptions::default());
        assert!(message.contains(expected) && !message.contains('\n'), "{message}");
    }
}

#[cfg(unix)]
#[test]
fn a_video_is_written_whole_or_not_at_all() {
    use std::os::unix::fs::PermissionsExt;
    let set = Set::new(|_| ());
    let program = set.folder.path().join("fake-ffmpeg");
    // A fake ffmpeg. It lists no encoders, and writes its input to the file that its last argument names.
    let script = "#!/bin/sh\ncase \"$*\" in *-encoders*) exit 0;; esac\n\
        for last; do :; done\ncat > \"${last#file:}\"\nexit ${FAIL:-0}\n";
    std::fs::write(&program, script).unwrap();
    std::fs::set_permissions(&program, std::fs::Permissions::from_mode(0o755)).unwrap();
    let video = video::VideoOptions { frames: 3, ffmpeg: program.clone(), ..Default::default() };
    let options = CompareOptions { video: Some(video), ..Default::default() };
    let summary = set.compare(&options).unwrap();
    let path = summary.video.unwrap();
    assert_eq!(path, set.out().join("review.mkv"));
    let bytes = std::fs::metadata(&path).unwrap().len();
    assert!(
        bytes > 0 && bytes.is_multiple_of(3 * 3),
        "three frames of three bytes a pixel: {bytes}"
    );
    let html = std::fs::read_to_string(&summary.report).unwrap();
    assert!(html.contains("href=\"review.mkv\""));
    let metrics = std::fs::read_to_string(set.out().join("metrics.json")).unwrap();
    assert!(!metrics.contains("fake-ffmpeg"), "no path of this machine in the results");

    std::fs::write(&program, script.replace("${FAIL:-0}", "3")).unwrap();
    std::fs::remove_file(&path).unwrap();
    std::fs::remove_file(&summary.report).unwrap();
    assert!(set.compare(&options).unwrap_err().to_string().contains("can't be written"));
    assert!(summary.report.is_file(), "the numbers are not lost with the video");
    let left = std::fs::read_dir(set.out()).unwrap().flatten();
    assert!(left.map(|e| e.file_name()).all(|n| !n.to_string_lossy().contains("review.mkv")));
}
