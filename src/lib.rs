//! Space-time light field rendering (Wang, Sun, Yang, IEEE TVCG 13(4), 2007). The input is the videos of calibrated
//! cameras that are not synchronized. The output is the view from any position near the cameras, at any instant of the
//! recording.
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
//! | the calibrated camera array, and all conventions | [`camera`] |
//! | the array's videos, and the ground truth of a simulated array | [`capture`] |
//! | §4 image registration | [`registration`] |
//! | §5 temporal interpolation | [`interpolation`] |
//! | §6 view synthesis | [`lumigraph`]; beyond the paper also [`stereo`] |
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
//! | [`host`] | bounded reading and atomic writing of files, child processes, signals, clocks, caches |
//! | [`json`], [`progress`], [`random`] | JSON files, with errors that name the invalid field; progress with the time left; pseudo-random numbers that are equal on every machine |
//! | `simd` | kernels that are compiled twice, for processors with AVX2 and for any processor |
//! | [`text`] | escaping and checks of names and sentences from files |
//! | [`method`], [`option`] | algorithms that the user chooses by name; options, each declared in one place |
//! | [`raster`] | images in memory, and image files |
//! | [`metrics`] | PSNR, SSIM, FLIP, and the moving part of an image |
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
//! # Adding to the library
//!
//! | what | where |
//! |---|---|
//! | a method of a stage | a variant of the enum beside the stage's options, such as [`interpolation::SyncMethod`], with a line in `methods!`; the compiler then reports all places that must handle it |
//! | an option | a line in the `options!` of the stage, such as [`lumigraph::BlendOptions`]; the command line, the JSON Schema and Python are derived from it |
//! | a cached result | a struct of its inputs in `light_field/stages.rs`, and a `Stage` and a function `get` in the file of its algorithm; for a result on disk also a `StoredStage`, which `light_field/prepare.rs` writes |
//! | a format of `import` or `export` | a file in [`exchange`], and a line in its `read_calibration` (import) or in `cli/export.rs` (export) |
//!
//! # The command line
//!
//! `stlfr COMMAND --help` lists the options of a command, with examples. The exit code is 0 for success, 2 for bad
//! input, and 1 if the work failed. An error is one sentence on stderr. `--quiet` silences progress and notes.
//!
//! A command replaces only regular files that are not part of a capture ([`capture::OutputGuard`]). It does not write
//! through symbolic links in its output folder. Files are written under a temporary name and then renamed. A command
//! that is interrupted removes its temporary files. If a command is killed, the next command that writes into the same
//! folder removes them.
//!
//! Commands read only regular files below a size limit; pipes, devices and files of gigabytes are errors. A command
//! also fails if the capture changes while it runs. Decoded videos, registered frames, plans and measurements are
//! cached in `CAPTURE/.stlfr/cache`. If a cached file is damaged, a note says so, and the result is computed again.
//! `stlfr info` lists and deletes cached files. You may edit `offsets.json` ([`offset::file`]).
//!
//! Times are seconds on the reference camera's clock. A view at an instant outside of the recording is an error. The
//! error states the recorded time range.
//!
//! # Paths and displays
//!
//! `stlfr render --path` renders a video along a camera path. The path is read from a JSON file ([`path`] describes the
//! format) or from the animated camera of a `.blend` file, or it is one of four ready-made paths: `sweep`, `orbit`,
//! `bullet-time` and `dolly`. Ready-made paths are fitted to the rig and to the scene's depths, so that every part of
//! every view lies inside of a camera's image. `--time` freezes time at one instant on any path. `--trail` overlays
//! several instants in each image of the video, all rendered from this image's viewpoint; the trail ends at this
//! image's instant.
//!
//! The suffix of the file after `-o` chooses the format. An `.exr` file has the channels `R`, `G`, `B` and `A` in
//! linear light as half floats, and `Z`, the depth along the camera's axis in metres. Pixels without depth have `Z` =
//! 1e10. The channels `forward.u` and `forward.v` hold the motion of each surface point to the next image, in pixels to
//! the right and up. `backward.u` and `backward.v` hold its motion to the previous image. These are Nuke's channel
//! names. `Vector.X` to `Vector.W` have the same motion as Blender's pass: X and Y are `backward`, Z and W are
//! `forward` with the opposite sign. In a sequence of images, the motion has two causes: the scene moves between the
//! instants of two images, and the viewpoint may move too. The first image has no previous image, and the last image
//! has no next image; the missing motion is the negative of the other one. A single image has the motion of the scene
//! during one frame interval of the recording. Pixels that no camera sees have motion 0. Images at which time is frozen
//! have these channels with any method. Other images have them only with `--proxy scene-flow`; with other methods, a
//! note reports that they are missing.
//!
//! `--quilt` renders all views of a Looking Glass display into one image, and `--stereo` the views of two eyes. All
//! these views look in the same direction. Their frustums are sheared so that points in the plane at the distance
//! `--convergence` have no parallax ([`display`]). A quilt's views span at most the angle that the cameras cover: eight
//! cameras 6 cm apart cover 12 degrees at a distance of 2 m. Blender's render tab writes the same files. Apple's
//! spatial photos are not supported, because `libheif` can't write the box that marks two images as a stereo pair.
//!
//! To render a sequence of images faster, start the same command several times, also on several machines that share the
//! output folder; the shared file system must support file locks. Each process renders images that no other process has
//! started. If processes are stopped, the same command continues where they ended. Until all images are complete, a
//! folder `.stlfr-render-…` beside them records which images are complete.
//!
//! # Recordings of real cameras
//!
//! `stlfr import CALIBRATION --images FOLDER -o CAPTURE` makes a capture from two inputs: a calibration that another
//! program computed ([`exchange`] lists the formats), and one video or one folder of images per camera. A recording is
//! assigned to the camera with its name, otherwise to the camera with its number; a table given by `--table` overrides
//! both. Notes list the assignment.
//!
//! Frame times are read from the table `--times`, from `timestamps.csv` beside the recordings, from the calibration, or
//! from the video files. `--rate` overrides them. The cameras' clocks may differ: `stlfr offsets` estimates their
//! offsets, unless `--shared` declares that all cameras have one clock. `--readout` gives the readout time of rolling
//! shutters, from the first row's exposure to the last row's. The time of a frame is then the time of its middle row.
//! `--readout-std` says how uncertain the readout time is; each camera's is then estimated together with the offsets.
//!
//! Videos may have variable frame rates, rotation flags, limited range or 10 bits. The cameras may differ in frame rate
//! and image size, and may start and end at different times. Interlaced videos are refused. If a video is damaged, its
//! intact frames are stored as images with their times; a note says how many frames are left out. Damage that decodes
//! without an error is not found. If images have another resolution than the calibration but its aspect ratio, the
//! calibration is scaled. Images with another aspect ratio are refused, unless `--crop` declares that each image is the
//! top left part of the calibrated one.
//!
//! `stlfr export CAPTURE --synchronized` renders the images of all cameras at common instants, for programs that need
//! synchronized cameras. `--frames` instead writes the frames as filmed, with their estimated times. `--undistort`
//! removes lens distortion from the images.
//!
//! # In the browser
//!
//! `stlfr view CAPTURE` opens a page in the browser; Ctrl+C ends the command. Drag to move the viewpoint, and turn the
//! wheel to zoom. Play the recording, slow it down, or stop time and move along the cameras. The page shows two
//! pictures side by side; the border between them can be dragged. Each picture shows one of these: the space-time light
//! field, traditional light field rendering (without synchronization), the ground truth, the depths, or *which cameras
//! a pixel comes from*. The legend shows the blending weights and the depth at the pointer. *Save* saves the whole
//! picture, and a `view.json` with which `stlfr render --camera` renders this view. `?` lists the keys; the page can
//! also be used with the keyboard alone.
//!
//! While viewpoint and time don't change, pictures are rendered as by `stlfr render`: with the options given by
//! `--preset` and `--options`, and with the methods chosen on the page. While the viewpoint moves, the same options are
//! used if the results at this instant are cached, and otherwise those of the preset `draft`; the picture of full
//! quality then fades in. By scene flow, this holds also while the time moves, if depth and motion of the frames
//! are in memory or on disk; the outlines of such quick pictures are not antialiased. Only programs on this machine can
//! reach the page; its address contains a random token. The page's address is also a link to the current viewpoint and
//! time. The link is valid until the server ends. In a later run, `stlfr view CAPTURE --at LINK` opens the page at the
//! same viewpoint and time.
//!
//! # On the web
//!
//! `stlfr publish CAPTURE -o SITE` writes a folder for any static web server. Its page shows the light field over a
//! span of time, from viewpoints among the cameras, and the visitor's graphics card renders the views. The viewpoint
//! sways by itself until the visitor drags it, touches it or tilts the device. The wheel and the time bar move through
//! time, and a button stops time. The command prints the sizes of the files, the PSNR of the page's views against those
//! of `stlfr render`, and an `<iframe>` line that embeds the page. The page loads nothing from outside of its folder,
//! and also works if it is opened from disk. On the page, the JavaScript function `stlfr.picture(VIEW, SECONDS)`
//! returns a canvas with the view of a `view.json`.
//!
//! # On several machines
//!
//! `stlfr capture` renders the images of a simulated camera rig in Blender; this is called filming. If several machines
//! share a capture's folder, run the same `stlfr capture` on all of them to film faster. Each machine films images that
//! no other machine has started. The files are the same as those that a single machine would write. If a machine shows
//! no activity for `--silence` seconds (60 by default), other machines film the images that it had started. All other
//! images are filmed once. The machines' clocks may be wrong.
//!
//! `stlfr farm CAPTURE -o JOB` writes job files that describe all the work, from the set-up to the comparison, for
//! three render farm engines: an Open Job Description (for AWS Deadline Cloud; `openjd run` runs it on one machine),
//! scripts for Slurm, and a job type for Flamenco. Filming and rendering are divided into chunks, each a command with
//! an option such as `--part 3-6/100`. A task may be run again: it continues its work, or writes the same files. After
//! a failed task, submit the job again. All machines must see the program, the captures and the job at the same paths.
//! `tests/farm/slurm.py` tests the scripts on a Slurm cluster that loses a node; it is run by hand.
//!
//! # From Python
//!
//! `stlfr setup` installs the Python module `stlfr` into `.venv`. To install the module and the command `stlfr` into
//! another Python (3.11 or newer), run `pip install ./blender` in this project's folder. The module has type stubs,
//! releases the GIL, and runs in one process with Blender's module `bpy`. `.ci/release.py` builds a wheel that
//! `pip install` accepts on any Linux with glibc 2.17 or newer. The commands that film and check need the source
//! folder; with an installed wheel, the environment variable `STLFR_HOME` must name it.
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
//! `stlfr.methods()` lists the methods of each stage, `stlfr.options()` all options with their defaults, ranges and
//! units. `capture.render(..., proceed=f)` calls `f(done, total)` before every step of the work, with the number of
//! finished instants and of all instants. Rendering stops if the call returns a false value. `capture.moment(0.1)`
//! prepares one instant; its method `view(camera)` then renders many views of this instant quickly.
//! `capture.preview(0.1, camera={...})` renders a view quickly by scene flow, or returns `None` if depth and motion must
//! be estimated first.
//!
//! # Limits
//!
//! - To estimate temporal offsets, something must move in the scene, and not only along the line of cameras. Otherwise,
//!   the offsets are unknown, and the program reports this.
//! - If only thin or untextured objects move, the errors of offsets from 12 frames are up to 0.01 frame interval. Their
//!   standard errors show it.
//! - A lost frame is found only if other cameras film before and after it. A frame that was lost at the very start or
//!   end of a recording may be missed. If several cameras lose a frame at nearly the same time, the positions of these
//!   frames may be ambiguous; the offsets of these cameras are then unknown.
//! - The check of a calibration by COLMAP is only as precise as the images allow. With small or noisy images, or a
//!   distant scene, larger errors pass the check; the check reports how large. With few features, the check reports
//!   that it can't decide.
//! - `stlfr calibrate` needs cameras that don't move, and a textured static part of the scene. If all cameras look in
//!   the same direction, the images hardly determine the focal length. The estimate is then close to its initial guess,
//!   and the command reports this.
//! - Changes by automatic exposure and white balance are corrected only if the camera sees still, textured surfaces,
//!   and if the changes differ between cameras. A sudden change is corrected as one of half a second or more. If all
//!   cameras change alike, it is assumed that the light in the scene changes.
//! - A guess of a rolling shutter's readout time (`readout_s` of a camera's clock) has to be given. If it has a standard
//!   error (`readout_std_s`), it is estimated together with the offsets. If all cameras stand upright at one height, the
//!   images show only how readout times differ between cameras, not an error that all of them share. The time
//!   of a pixel follows from its row in the camera's own, distorted image; with `--proxy scene-flow`, from its row in
//!   the undistorted image. Cameras must not move. The following assume that all rows of a frame are exposed at the
//!   same time: `--sync nearest` and `crossfade`, traditional light field rendering, the rough alignment of recordings,
//!   the estimation of gains, `plan`, and the page of `publish`. `export --frames` writes frames as filmed.
//! - If neighbouring cameras are more than 52 degrees apart, seen from what they look at, hardly any surface looks alike
//!   in two of them. `auto` then blends images over a plane, and views between cameras show ghosts.
//! - Objects that move by more than 60 pixels per frame can't be tracked. They are blurred, and their depths are wrong.
//!   `--proxy scene-flow` needs no tracks, and shows objects that move by up to 120 pixels per frame.
//! - A thin object that moves by more than its thickness from one frame to the next, such as a pendulum's rod, vanishes
//!   between the two frames.
//! - The background in narrow gaps between objects that move along the line of cameras gets the motion of these
//!   objects. There, interpolation by OpenCV's optical flow DIS is up to 0.5 dB better.
//! - For eight cameras at 640×480, `--proxy scene-flow` takes 1 GB of memory, and 35 to 45 seconds of processor time
//!   for each instant that `prepare` has not prepared. `stlfr view` uses the results that `prepare` has stored, or else
//!   depth per pixel.
//! - An object that bounces between two frames of a camera is misplaced in this camera's synchronized image.
//!   `--sync all-cameras` takes the object from other cameras that filmed it at that time.
//! - `capture --engine workbench` renders instantaneous exposures only. A camera with an exposure time needs the engine
//!   Cycles.
//! - The Blender extension is tested in `bpy` without a window. `tests/window/walk.py` tries it in a window,
//!   by hand, with software OpenGL; no graphics card has drawn it yet.
//!
//! # Conventions
//!
//! Lengths are metres and times are seconds. The world is right-handed; camera axes and camera models are COLMAP's. The
//! centre of the top-left pixel is (0.5, 0.5). Transforms are named `target_from_source`. Names of quantities end with
//! their unit (`_px`, `_s`, `_m`, `_deg`). Geometry and time are f64, pixel values are f32. Times are seconds on the
//! reference camera's clock. In the library's functions, time 0 is the capture's start
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
