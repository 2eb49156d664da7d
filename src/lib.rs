//! Space-time light field rendering (Wang, Sun, Yang, IEEE TVCG 13(4), 2007): the view from
//! anywhere, at any instant, from the videos of calibrated cameras that are not synchronized.
//!
//! ```
//! use std::sync::Arc;
//! use stlfr::{capture::Capture, options::RenderOptions, pipeline, progress::Reporter};
//! # use stlfr::raster::{BitDepth, Image, write_image};
//! # let folder = tempfile::tempdir()?;
//! # let mut cameras = Vec::new();
//! # for c in 0..3 {
//! #     let x_m = 0.06 * (c as f64 - 1.0);
//! #     cameras.push(format!(r#"{{"id": "cam{c}", "frames": "cam{c}/%d.png", "width": 64, "height": 48,
//! #         "model": "PINHOLE", "params": [64, 64, 32, 24], "clock": {{"rate_hz": 30, "first_s": 0, "shared": true}},
//! #         "cam_from_world": {{"rotation_wxyz": [1, 0, 0, 0], "translation": [{}, 0, 0]}}}}"#, -x_m));
//! #     // A textured wall, 2 m away, that moves by 2 pixels a frame.
//! #     for frame in 0..4 {
//! #         let value = |k: usize| {
//! #             let (u, v) = ((k % 64) as f64 - 2.0 * frame as f64 + 32.0 * x_m, (k / 64) as f64);
//! #             (0.5 + 0.2 * (0.8 * u).sin() * (0.7 * v).cos() + 0.2 * (0.31 * u + 0.53 * v).sin()) as f32
//! #         };
//! #         let image = Image::from_data(64, 48, 1, (0..64 * 48).map(value).collect());
//! #         write_image(&folder.path().join(format!("cam{c}/{frame}.png")), &image, None, BitDepth::Eight)?;
//! #     }
//! # }
//! # let text = format!(r#"{{"format": "stlfr-capture", "version": 1, "name": "wall", "cameras": [{}]}}"#, cameras.join(","));
//! # std::fs::write(folder.path().join("capture.json"), text)?;
//! # let folder = folder.path();
//! // `folder` holds capture.json and the cameras' frames.
//! let capture = Arc::new(Capture::open(folder)?);
//! let options = RenderOptions::default();
//! let field = pipeline::open_field(capture.clone(), &options, &Reporter::silent())?;
//!
//! let mut view = capture.cameras[1].camera.clone(); // any pinhole, anywhere:
//! view.cam_from_world.translation.x -= 0.02; // 2 cm to the right of that camera,
//! let rendered = field.view(&view, 0.05, &options)?; // halfway between two frames
//! assert_eq!((rendered.image.width(), rendered.image.height()), (64, 48));
//! # assert!(rendered.coverage.iter().filter(|c| **c).count() > 2000);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! # From the paper to the module
//!
//! | paper | module |
//! |---|---|
//! | the calibrated array, and all conventions | [`camera`] |
//! | its videos, and the ground truth of a simulated one | [`capture`] |
//! | §4 image registration | [`registration`] |
//! | §5 temporal interpolation | [`interpolation`] |
//! | §6 view synthesis | [`lumigraph`], and beyond it [`stereo`] |
//! | beyond the paper: motion and geometry together | [`scene_flow`] |
//! | §7 temporal offsets | [`offset`] |
//! | Fig. 2, the whole pipeline | [`light_field`], opened by [`pipeline`] |
//! | §8 comparison of results with the ground truth | [`compare`] |
//!
//! # Layers
//!
//! A module uses only modules of earlier lines, and none of its own line. A test checks every `use` against this list.
//!
//! ```text
//! text
//! host method progress random simd
//! json option
//! raster
//! camera video metrics chart
//! capture
//! exchange registration rig path display
//! offset interpolation lumigraph
//! stereo scene_flow
//! options
//! light_field
//! plan
//! pipeline
//! compare
//! tradeoff live farm publish
//! toolchain
//! cli
//! python
//! ```
//!
//! | module | what |
//! |---|---|
//! | [`host`] | files read within bounds and written whole, child processes, signals, clocks, caches |
//! | [`json`], [`progress`], [`random`] | reading JSON with the field that is wrong; progress with time left; pseudo-random numbers, the same on every machine |
//! | `simd` | kernels compiled for the processor: AVX2, or any |
//! | [`text`] | escaping and checks of names and sentences from files |
//! | [`method`], [`option`] | alternatives that a user chooses by name; options, declared once |
//! | [`raster`] | images in memory, and image files |
//! | [`metrics`] | PSNR, SSIM, FLIP, the moving part |
//! | [`video`] | video files, through ffmpeg |
//! | [`chart`] | charts as SVG |
//! | [`path`] | camera paths: position, direction, lens and time of a view as functions of a video's seconds |
//! | [`display`] | quilts for light-field displays, and stereo pairs |
//! | [`rig`] | simulated arrays: their file format and their generator |
//! | [`exchange`] | calibrations of other programs, and the import of recordings |
//! | [`options`] | the methods and parameters of all stages |
//! | [`plan`] | automatic choice of methods by measurements of a capture |
//! | [`tradeoff`] | time and quality of every combination of methods |
//! | [`live`] | interactive views in a browser: the server and its page |
//! | [`publish`] | a light field as a site, for any static web server |
//! | [`farm`] | jobs for render farms: Open Job Description, Slurm, Flamenco |
//! | [`toolchain`] | the Python environment: set-up, filming, checking, finding and refining calibrations |
//! | [`cli`] | the command line |
//!
//! # Adding to it
//!
//! | what | where |
//! |---|---|
//! | a method of a stage | its enum beside the stage's options, such as [`interpolation::SyncMethod`], with a line in `methods!`; then what the compiler asks for |
//! | an option | a line in the `options!` of the stage, such as [`lumigraph::BlendOptions`]; command line, schema and Python follow |
//! | a cached result | its inputs in `light_field/stages.rs`, and a `Stage` for them; on disk a `StoredStage`, which `light_field/prepare.rs` writes |
//! | a format of `import` or `export` | a file in [`exchange`], and a line in `read_calibration` there or in `cli/export.rs` |
//!
//! # The command line
//!
//! `stlfr COMMAND --help` has the options and examples. Exit codes: 0 success, 2 bad input, 1 failed work. An error is
//! one sentence on stderr. `--quiet` silences progress and notes.
//!
//! An output replaces only a regular file, never a part of a capture ([`capture::OutputGuard`]), and never through a
//! link inside its folder. Files are written to a temporary name, then renamed. An interrupted command removes its
//! temporary files; those of a killed command are removed by the next command that writes into the same folder.
//!
//! Only regular files of a bounded size are read: a pipe, a device or a file of gigabytes is an error. So is a capture
//! that changes while a command uses it. Decoded videos, registered frames, plans and measurements are cached in
//! `CAPTURE/.stlfr/cache`. A damaged entry is noted and computed again; `stlfr info` lists and deletes entries.
//! `offsets.json` may be edited ([`offset::file`]).
//!
//! Times are seconds on the reference camera's clock. Outside of the recorded time there is no image; the error states
//! the time range.
//!
//! # Paths and displays
//!
//! `stlfr render --path` follows a camera path: a file ([`path`] has the format), the animated scene camera of a `.blend`,
//! or one by name. `sweep`, `orbit`, `bullet-time` and `dolly` are fitted to the rig and to the scene's depths, so that
//! cameras see all of every view. `--time` stops time along any path. A trail is that of each frame's instant, from its
//! viewpoint.
//!
//! The suffix of `-o` chooses the format. `.exr` has the channels `R`, `G`, `B`, `A` in linear light, half floats, and `Z`,
//! metres along the axis; what has no depth is 1e10 m away.
//!
//! `--quilt` renders for Looking Glass displays, `--stereo` for two eyes: views in one direction, sheared about the plane
//! of `--convergence`, which has no parallax ([`display`]). A quilt's cone is never wider than the cameras cover: eight
//! cameras 6 cm apart cover 12 degrees at 2 m. Apple's spatial photos are not written: `libheif` can't write the group of
//! a stereo pair.
//!
//! Processes that run the same command for a sequence of images share it, each taking images that no other has, on
//! machines that see one folder with locks. Stopped, it continues. A folder `.stlfr-render-…` beside the images says
//! what is done, until all is.
//!
//! # Recordings of real cameras
//!
//! `stlfr import CALIBRATION --images FOLDER -o CAPTURE` makes a capture of another program's calibration ([`exchange`] has
//! the formats) and of a video or a folder of images for each camera. A recording belongs to the camera of its name, else
//! of its number, or as `--table` says; the notes say which. Frames have the times of `--times`, of `timestamps.csv` beside
//! the recordings, of the calibration or of the video; `--rate` overrides them. Times of different cameras need not agree:
//! `stlfr offsets` estimates how far their clocks are apart, unless `--shared` says that they are one.
//! `--readout` is the readout time of rolling shutters, where it is known: from the first row's exposure to the last
//! row's. A frame's time is then that of its middle row.
//! Variable rates, rotation flags, limited range, 10 bits, cameras of different rates and sizes, and recordings that start
//! or end apart are read as they are. Interlaced or damaged video is refused. A calibration at another resolution is
//! scaled; images of another shape are refused, unless `--crop` says that they are its top left part.
//!
//! `stlfr export CAPTURE --synchronized` renders all cameras at common instants, for programs that need synchronized images;
//! `--frames` writes the frames as filmed with their estimated times. `--undistort` makes them images of pinholes.
//!
//! # In the browser
//!
//! `stlfr view CAPTURE` opens a page, and ends with Ctrl+C. Drag to move the viewpoint, turn the wheel to
//! zoom, play the recording, slow it down, or stop time and move along the cameras. ST-LFR, traditional light
//! field rendering, the truth, *which cameras a pixel comes from* and *depth* stand beside each other, with a border
//! to drag. The legend has the weights and the depth under the pointer. *Save* gives the whole picture, and the
//! `view.json` that `stlfr render --camera` takes. `?` lists the keys; the keyboard alone suffices.
//!
//! At rest, pictures have the options of the command line, and the methods that are chosen on the page: `--preset` and
//! `--options` are those of `render`. In motion they have the same where the instant is prepared, else the options of
//! `draft`; a picture of full quality fades in. The page is served on this machine alone, at an address with a random
//! token. A link works until the server ends. `stlfr view CAPTURE --at LINK` opens the same place in a new run.
//!
//! # On the web
//!
//! `stlfr publish CAPTURE -o SITE` writes a folder for any static web server: the light field of a span of time and of the
//! places among the cameras, drawn by the visitor's graphics card. It sways until it is dragged, touched or tilted, the
//! wheel and the bar pass through time, the button stops it. The command prints the sizes, how far the pictures are from
//! `render`'s, and an `<iframe>` line. The page asks for nothing outside of its folder, and opens from disk.
//! `stlfr.picture(VIEW, SECONDS)` on the page gives a canvas with the view of a `view.json`.
//!
//! # On several machines
//!
//! The same `stlfr capture` on machines that share the capture's folder films it together: each takes images that
//! no other has, and the files are those of one machine. What a machine had begun that shows no sign of life for
//! `--silence` seconds, 60 by default, is filmed by another; nothing else is filmed twice. The machines' clocks may be wrong.
//!
//! `stlfr farm CAPTURE -o JOB` describes the whole work, from the set-up to the comparison, for engines that share it
//! among machines: an Open Job Description (AWS Deadline Cloud; `openjd run` on one machine), scripts for Slurm, a job
//! type for Flamenco. Filming and rendering, of `--times` or along `--path`, are in chunks: `--part 3-6/100` of `capture`
//! and `render`. Every task may be run again: it continues, or gives the same files. After a failed task, submit the job again. The machines must see program,
//! captures and job at the same paths. `tests/farm/slurm.py` runs the scripts, by hand, on a cluster that loses a node.
//!
//! # From Python
//!
//! `stlfr setup` installs the module `stlfr` into `.venv`; `pip install ./blender`, in this project's folder, builds it
//! into any other Python from 3.11 on, with the command `stlfr`. It has type stubs, releases the GIL, and runs in one
//! process with `bpy`. `.ci/release.py` builds a wheel for any Linux with glibc 2.17 or newer: `pip install` it there.
//! The commands that film and check use the source folder; an installed wheel finds it by `STLFR_HOME`.
//!
//! ```python
//! import numpy as np
//! import stlfr
//!
//! capture = stlfr.open(".captures/mine")
//! # (N, 2) pixels of (N, 3) world points in metres; NaN where a point has no image.
//! pixels = capture.project("cam3", np.array([[0.0, 2.0, 0.1]]))
//! times_s = capture.times("cam3")
//! # As `stlfr offsets --json` prints them.
//! offsets = capture.offsets()
//! # As `stlfr render` writes it; `camera={...}` gives any other view.
//! image = capture.render(0.1, like="cam3", preset="best", options={"proxy": "depth"}, alpha=False)
//! first_s, last_s = capture.covered_s()
//! ```
//!
//! `stlfr.methods()` lists the methods of each stage, `stlfr.options()` all options with their defaults,
//! ranges and units. `capture.render(..., proceed=f)` calls `f(done, total)` before every step of every
//! instant, and stops if it returns something false.
//! `capture.moment(0.1).view(camera)` renders many views of one instant, what they share but once.
//!
//! # Limits
//!
//! - Something must move, and not only along the line of cameras. Otherwise offsets are unknown, and the
//!   program says so.
//! - Where only thin or plain objects move, offsets are off by up to 0.01 frame over 12 frames. Their error
//!   bars say so.
//! - Lost frames are found only where other cameras film around them. One lost at a recording's very start
//!   or end may be missed. Several cameras that lose a frame at nearly the same time hide each other's
//!   losses: their offsets are unknown where several places fit.
//! - COLMAP confirms a calibration only as finely as the images show it. With small, noisy or distant
//!   images, larger errors pass the check. It says how large. With few features it can't tell, and says so.
//! - `stlfr calibrate` takes cameras that don't move, and something textured that stands still. Cameras that look one
//!   way don't tell their focal length: it is near a guess, and the command says so.
//! - Cameras' gains and white balances are corrected by one factor a channel for the whole recording.
//!   Automatic exposure is not followed.
//! - A rolling shutter's readout time (`readout_s` of a camera's clock) has to be given; it is not estimated. Rows are
//!   those of the camera's own image, lens distortion included; `--proxy scene-flow` takes those of the undistorted one.
//!   A camera's own motion is none. These take a frame's rows for simultaneous: `--sync nearest` and `crossfade`,
//!   traditional light field rendering, the rough alignment of recordings, gains, `plan`, and the page of `publish`.
//!   `export --frames` writes frames as filmed.
//! - Bodies that move by more than 60 pixels a frame lose their tracks. They are blurred, and their depth is
//!   wrong.
//! - Thin things that move further than they are thick, as a pendulum's rod, vanish between two frames.
//! - In narrow gaps between bodies that move along the line of cameras, what is behind them gets their
//!   motion. There, OpenCV's DIS interpolates up to 0.5 dB better.
//! - `--proxy scene-flow` takes 35 to 45 processor seconds for a new instant of eight cameras at 640×480 that `prepare` has
//!   not prepared, and 1 GB of memory. `stlfr view` uses what `prepare` stored, or depth per pixel.
//! - A body that bounces between two frames is misplaced in a camera's image. `--sync all-cameras` takes it
//!   from cameras that filmed it then.
//! - `capture --engine workbench` films instants. A camera with an exposure time needs Cycles.
//! - The Blender extension is tested in `bpy` without a window. `tests/window/walk.py` tries it in a window,
//!   by hand, with software OpenGL; no graphics card has drawn it yet.
//!
//! # Conventions
//!
//! Metres, seconds, right-handed world; COLMAP's camera axes and models; the centre of the
//! top-left pixel is (0.5, 0.5); transforms are named `target_from_source`; units are suffixes
//! (`_px`, `_s`, `_m`, `_deg`). f64 for geometry and time, f32 for pixels. Time is seconds on the
//! reference camera's clock. In the library's functions, 0 is the capture's start
//! ([`Capture::time_origin_s`](capture::Capture::time_origin_s)).

pub mod camera;
pub mod capture;
pub mod chart;
pub mod cli;
pub mod compare;
pub mod display;
pub mod exchange;
pub mod farm;
pub mod host;
pub mod interpolation;
pub mod json;
pub mod light_field;
pub mod live;
pub mod lumigraph;
pub mod method;
pub mod metrics;
pub mod offset;
pub mod option;
pub mod options;
pub mod path;
pub mod pipeline;
pub mod plan;
pub mod progress;
pub mod publish;
#[cfg(feature = "python")]
mod python;
pub mod random;
pub mod raster;
pub mod registration;
pub mod rig;
pub mod scene_flow;
mod simd;
pub mod stereo;
pub mod text;
pub mod toolchain;
pub mod tradeoff;
pub mod video;
