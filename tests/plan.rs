//! The plan of a capture: every decision both ways; and `auto`, which renders by the plan.

mod common;

use common::arc::arc_rig;
use common::bodies::{Recording, board_before_wall, pose};
use common::wall::{FRAME_S, Scene, open};
use common::{assert_refused, edit, run, stderr, succeed, text, tiny_copy};
use serde_json::{Value, json};
use stlfr::interpolation::SyncMethod;
use stlfr::light_field::LightField;
use stlfr::lumigraph::BlendMethod;
use stlfr::method::Method;
use stlfr::options::{AutoOptions, ProxyMethod, RenderOptions};
use stlfr::pipeline::{open_field, resolved};
use stlfr::plan::{Decision, Plan, plan};
use stlfr::progress::Reporter;
use stlfr::raster::{Image, read_image, write_image};
use stlfr::raster::{encoded_from_linear, linear_from_encoded};
use tempfile::TempDir;

/// Opens a capture's light field and plans its views.
fn plan_of(folder: &TempDir, options: &RenderOptions) -> (Plan, LightField) {
    let field = open_field(open(folder), options, &Reporter::silent()).unwrap();
    (plan(&field, options, &Reporter::silent()).unwrap(), field)
}

/// Options whose methods the capture decides.
fn auto() -> RenderOptions {
    RenderOptions { auto: AutoOptions::all(), ..RenderOptions::default() }
}

fn planned(scene: &Scene, change: impl FnOnce(&mut Value)) -> Plan {
    let folder = scene.film();
    edit(folder.path(), change);
    plan_of(&folder, &auto()).0
}

/// The decision of a stage; every stage has one.
#[track_caller]
fn decision<'a>(plan: &'a Plan, stage: &str) -> &'a Decision {
    plan.decisions.iter().find(|d| d.stage == stage).expect("the stage is decided")
}

#[track_caller]
fn assert_choices(plan: &Plan, choices: &[(&str, &str)]) {
    for (stage, method) in choices {
        let decision = decision(plan, stage);
        assert_eq!(decision.method, *method, "{decision:?}");
    }
}

/// Nothing moves, and all clocks are one.
fn still() -> Scene {
    Scene { velocity: [0.0; 2], offsets_s: [0.0; 3], shared: [true; 3], ..Scene::default() }
}

#[test]
fn a_still_synchronized_wall_requires_nothing_but_a_blend() {
    let plan = planned(&still(), |_| ());
    let stages = [
        ("offsets", "known clocks"),
        ("sync", "nearest"),
        ("trajectory", "straight"),
        ("proxy", "plane"),
        ("gains", "equal"),
        ("lenses", "pinhole"),
        ("references", "one direction"),
    ];
    assert_choices(&plan, &stages);
    assert_eq!(
        (plan.options.sync, plan.options.proxy.method),
        (SyncMethod::Nearest, ProxyMethod::Plane)
    );
    assert!(!plan.options.interpolation.curved);
}

#[test]
fn what_moves_alike_is_triangulated_and_what_moves_apart_refined() {
    assert_choices(
        &planned(&Scene::default(), |_| ()),
        &[("offsets", "estimated"), ("sync", "triangulation"), ("proxy", "plane")],
    );
    let scene = Scene { board: Some([-1.5, -0.8]), ..Scene::default() };
    assert_choices(&planned(&scene, |_| ()), &[("sync", "refined"), ("proxy", "depth")]);
    // A tenth of a pixel a frame is less than a budget, but more than nothing.
    let scene = Scene { velocity: [0.02, 0.05], ..still() };
    let plan = planned(&scene, |_| ());
    assert!([SyncMethod::Nearest, SyncMethod::Crossfade].contains(&plan.options.sync));
}

/// Two cameras see a board pass; the third shows its first frame all the time, but for noise.
#[test]
fn where_nothing_changes_nothing_is_registered() {
    let scene = Scene { board: Some([-1.5, -0.8]), shared: [true; 3], ..Scene::default() };
    let folder = scene.film();
    let path = |frame: usize| folder.path().join(format!("cam2/{frame}.png"));
    let (first, depth) = read_image(&path(0)).unwrap();
    for frame in 0..scene.frames {
        let mut image = first.clone();
        for (k, v) in image.data_mut().iter_mut().enumerate() {
            *v = (*v + 0.01 * ((k * 7 + frame * 11) as f32 * 1.3).sin()).clamp(0.0, 1.0);
        }
        write_image(&path(frame), &image, None, depth).unwrap();
    }
    let options = auto();
    let (plan, field) = plan_of(&folder, &options);
    assert_choices(&plan, &[("sync", "refined"), ("still pairs", "cross-faded")]);
    let time_s = 1.6 * FRAME_S;
    let synchronized = |camera: usize, sync: SyncMethod| {
        field
            .synchronized(camera, time_s, &RenderOptions { sync, ..plan.options.clone() })
            .unwrap()
            .image
            .clone()
    };
    let both = |camera: usize| {
        [SyncMethod::Crossfade, SyncMethod::Refined].map(|sync| synchronized(camera, sync))
    };
    assert!((0.003..0.03).contains(&plan.options.interpolation.still_change));
    let [crossfaded, refined] = both(2);
    assert_eq!(crossfaded, refined, "nothing changes");
    let [crossfaded, refined] = both(1);
    assert_ne!(crossfaded, refined, "a board passes");

    let plan = planned(&scene, |_| ());
    assert_choices(&plan, &[("sync", "refined"), ("still pairs", "registered")]);
    assert_eq!(plan.options.interpolation.still_change, 0.0);
}

/// A lamp that flickers moves nothing and changes all blocks alike, so that the changes of such pairs
/// are no noise.
#[test]
fn flicker_is_not_taken_for_noise() {
    let folder = still().film();
    for frame in [1, 3] {
        let path = folder.path().join(format!("cam2/{frame}.png"));
        let (mut image, depth) = read_image(&path).unwrap();
        image.data_mut().iter_mut().for_each(|v| *v = (*v + 20.0 / 255.0).min(1.0));
        write_image(&path, &image, None, depth).unwrap();
    }
    let mut options = RenderOptions::default();
    options.auto.sync = true;
    let (plan, _) = plan_of(&folder, &options);
    assert_choices(&plan, &[("still pairs", "cross-faded")]);
    assert!(plan.options.interpolation.still_change < 0.001, "{plan:?}");
}

#[test]
fn a_smaller_budget_asks_for_more() {
    let folder = still().film();
    let mut options = auto();
    options.auto.budget_px = 1e-9;
    let (plan, _) = plan_of(&folder, &options);
    assert_choices(&plan, &[("proxy", "depth")]);
    assert_eq!(plan.options.interpolation.still_change, 0.0);
}

#[test]
fn a_camera_that_records_more_light_is_corrected() {
    let scene = still();
    let folder = scene.film();
    let brighter = std::fs::read_dir(folder.path().join("cam2")).unwrap();
    for path in brighter.map(|entry| entry.unwrap().path()) {
        let (image, depth) = read_image(&path).unwrap();
        let more = |v: &f32| encoded_from_linear(1.25 * linear_from_encoded(f64::from(*v))) as f32;
        let data = image.data().iter().map(more).collect();
        let image = Image::from_data(image.width(), image.height(), image.channels(), data);
        write_image(&path, &image, None, depth).unwrap();
    }
    let options = auto();
    let (plan, field) = plan_of(&folder, &options);
    assert_choices(&plan, &[("gains", "corrected"), ("sync", "nearest"), ("proxy", "plane")]);
    let [r, g, b] = field.gains(&plan.options.registration).factors[2];
    assert!([r, g, b].iter().all(|gain| (gain - 1.25).abs() < 0.02), "{r} {g} {b}");
    // Seen from there, the view is as bright as the reference records it.
    let camera = field.capture().cameras[2].camera.clone();
    let view = field.view(&camera, 0.0, &plan.options).unwrap().image;
    let wanted = scene.image(scene.centers_m[2], 0.0);
    let apart: f32 = view.data().iter().zip(wanted.data()).map(|(a, b)| (a - b).abs()).sum();
    assert!(apart / (view.data().len() as f32) < 2.0 / 255.0, "{apart}");
}

#[test]
fn lenses_and_a_second_direction_are_seen() {
    let plan = planned(&still(), |json| {
        for camera in json["cameras"].as_array_mut().expect("a list") {
            let p = camera["params"].clone();
            camera["model"] = json!("OPENCV");
            camera["params"] = json!([p[0], p[1], p[2], p[3], -0.05, 0.0, 0.0, 0.0]);
        }
    });
    assert_choices(&plan, &[("lenses", "distorted")]);
    assert!(decision(&plan, "lenses").measured.unwrap() > 0.1);
    let centers_m = [[-0.06, 0.0, 0.0], [0.0; 3], [0.0, 0.06, 0.0]];
    let plan = planned(&Scene { centers_m, ..still() }, |_| ());
    assert_choices(&plan, &[("references", "two directions")]);
}

#[test]
fn only_the_methods_that_are_auto_are_decided() {
    let folder = still().film();
    let mut options = RenderOptions::default();
    options.auto.proxy = true;
    let field = open_field(open(&folder), &options, &Reporter::silent()).unwrap();
    options.blend.method = BlendMethod::Uniform;
    // Planned, then kept.
    let [planned, kept] =
        [(); 2].map(|()| resolved(&field, &options, &Reporter::silent()).unwrap());
    assert_eq!(planned.sync, SyncMethod::Refined);
    assert_eq!(planned.proxy.method, ProxyMethod::Plane);
    assert_eq!(planned.blend.method, BlendMethod::Uniform);
    assert!(planned.auto.stages().is_empty());
    assert_eq!(kept, planned);
}

#[test]
fn a_plan_is_kept_for_the_same_capture_and_options() {
    let folder = still().film();
    let plans = folder.path().join(".stlfr/cache/plans");
    let files = || std::fs::read_dir(&plans).map_or(0, Iterator::count);
    let planned = |more: &[&str]| {
        let image = folder.path().join("view.png");
        let arguments = ["render", text(folder.path()), "--like", "cam1", "--time", "0", "-o"];
        let auto = ["--sync", "auto", "--proxy", "auto", "--blend", "auto"];
        let output = succeed(&[&arguments[..], &[text(&image)], &auto, more].concat());
        (std::fs::read(&image).unwrap(), stderr(&output))
    };
    let because = "the best plane displaces points by";
    let (first, why) = planned(&[]);
    assert!(why.contains(because) && files() == 1, "{why}");
    let (again, why) = planned(&[]);
    assert!(why.contains("Auto: sync nearest, proxy plane, blend"), "{why}");
    assert!(why.contains("as planned before") && files() == 1 && again == first, "{why}");

    // What is damaged is planned anew; so are other options, and another capture.
    let file = std::fs::read_dir(&plans).unwrap().next().unwrap().unwrap().path();
    let whole = std::fs::read(&file).unwrap();
    let (checksum, content) = whole.split_at(32);
    let other = std::str::from_utf8(content).unwrap().replace("nearest", "refined");
    std::fs::write(&file, [checksum, other.as_bytes()].concat()).unwrap();
    let (again, why) = planned(&[]);
    assert!(why.contains("is damaged") && why.contains(because) && again == first, "{why}");
    assert!(planned(&["--preset", "draft"]).1.contains(because) && files() == 2);
    edit(folder.path(), |json| json["name"] = json!("another"));
    assert!(planned(&[]).1.contains(because) && files() == 3);

    // Nothing is measured where a choice has no effect.
    let image = folder.path().join("view.png");
    let given = ["--like", "cam1", "--time", "0", "--sync", "nearest", "--proxy", "plane"];
    let render = ["render", text(folder.path()), "-o", text(&image), "--preset", "best"];
    let said = stderr(&succeed(&[&render[..], &given].concat()));
    assert!(!said.contains("Auto") && files() == 3, "{said}");
}

#[test]
fn held_out_frames_decide_the_weights_and_scene_flow_if_asked() {
    let folder = tiny_copy();
    let field = open_field(open(&folder), &auto(), &Reporter::silent()).unwrap();
    let by = |sync: bool, blend: bool| {
        let mut options = auto();
        options.auto = AutoOptions { sync, blend, proxy: sync || blend, ..AutoOptions::default() };
        options.proxy.method = ProxyMethod::Depth;
        options.blend.method = BlendMethod::Uniform;
        plan(&field, &options, &Reporter::silent()).unwrap()
    };
    let all = by(true, true);
    assert!([SyncMethod::Refined, SyncMethod::AllCameras].contains(&all.options.sync), "{all:?}");
    let decision = self::decision(&all, "blend");
    let is_better = decision.measured.expect("held-out frames were compared") > 0.0;
    let chosen = if is_better { BlendMethod::SpaceTime } else { BlendMethod::Lumigraph };
    assert_eq!((decision.method, all.options.blend.method), (chosen.name(), chosen));
    let proxy = self::decision(&all, "proxy");
    let gains = proxy.measured.expect("held-out frames were compared") > proxy.limit.unwrap();
    let chosen = if gains { ProxyMethod::SceneFlow } else { ProxyMethod::Depth };
    assert_eq!((proxy.method, all.options.proxy.method), (chosen.name(), chosen));
    let sync_only = by(true, false);
    assert_eq!(sync_only.options.blend.method, BlendMethod::Uniform);
    // Nothing is rendered for what isn't asked for.
    assert_choices(&by(false, false), &[("blend", "as given")]);
}

/// Four cameras film a board that moves before a still wall. They stand on a circle around the board, `angle_deg` degrees
/// apart.
fn arc(angle_deg: f64) -> TempDir {
    let world = board_before_wall(|frames| {
        let angle = 0.8 * frames;
        pose([0.0; 3], [0.12 * angle.cos(), 0.1 * angle.sin(), 1.3])
    });
    let cameras = arc_rig(160, angle_deg, 1.3, 1.3);
    let (folder, first_frames) = (tempfile::tempdir().unwrap(), &[0.0, 0.25, 0.5, 0.75]);
    Recording { world: &world, cameras: &cameras, first_frames, frames: 6, noise: 0.004 }
        .write(folder.path());
    folder
}

#[test]
fn cameras_around_the_scene_need_scene_flow_and_no_comparison() {
    let [wide, narrow] = [15.0, 3.0].map(|angle| plan_of(&arc(angle), &auto()).0);
    let proxy = decision(&wide, "proxy");
    assert_eq!(wide.options.proxy.method, ProxyMethod::SceneFlow);
    assert!(proxy.because.contains("15.0 degrees apart"), "{proxy:?}");
    assert_choices(&wide, &[("sync", "refined"), ("blend", "as given")]);
    let proxy = decision(&narrow, "proxy");
    assert!(!proxy.because.contains("degrees"), "{proxy:?}");
    // A plane is chosen where it suffices, whatever the cameras' angles are.
    let mut flat = auto();
    (flat.auto.budget_px, flat.auto.sync, flat.sync) = (1e6, false, SyncMethod::Refined);
    assert_eq!(plan_of(&arc(15.0), &flat).0.options.proxy.method, ProxyMethod::Plane);
    // A method that is asked for is kept.
    let mut options = auto();
    (options.auto.proxy, options.proxy.method) = (false, ProxyMethod::Plane);
    assert_eq!(plan_of(&arc(15.0), &options).0.options.proxy.method, ProxyMethod::Plane);
}

/// Hardly any surface looks alike in two cameras 60 degrees apart: their images are blended over a plane.
#[test]
fn cameras_too_far_apart_to_be_matched_get_a_plane_and_a_reason() {
    let (plan, field) = plan_of(&arc(60.0), &auto());
    let proxy = decision(&plan, "proxy");
    assert_eq!(plan.options.proxy.method, ProxyMethod::Plane);
    assert!(proxy.because.contains("60.0 degrees apart") && proxy.because.contains("ghosts"));
    assert_choices(&plan, &[("sync", "refined"), ("blend", "as given")]);
    let own = &field.capture().cameras[1].camera;
    let time_s = 2.5 / 30.0 - field.capture().time_origin_s;
    let seen = field.view(own, time_s, &plan.options).expect("a view");
    assert!(seen.coverage.iter().filter(|covered| **covered).count() > own.width * own.height / 2);
}

#[test]
fn without_a_frame_between_others_the_weights_are_as_given() {
    let scene = Scene { board: Some([-1.5, -0.8]), shared: [true; 3], ..Scene::default() };
    assert_choices(&planned(&scene, |_| ()), &[("blend", "as given")]);
}

#[test]
fn auto_renders_what_the_planned_options_do() {
    let folder = Scene::default().film();
    let path = |name: &str| text(&folder.path().join(name)).to_owned();
    let capture = text(folder.path());
    let output = succeed(&["-q", "plan", capture, "-o", &path("options.json")]);
    let table = String::from_utf8(output.stdout).unwrap();
    assert!(table.contains("triangulation") && table.contains("px a frame"), "{table}");
    let time = format!("{}", 1.6 * FRAME_S);
    let render = |choice: &[&str], image: &str| {
        let arguments = ["-q", "render", capture, "--like", "cam1", "--time", &time, "-o", image];
        succeed(&[arguments.as_slice(), choice].concat());
        std::fs::read(image).unwrap()
    };
    let auto = render(&["--sync", "auto", "--proxy", "auto", "--blend", "auto"], &path("auto.png"));
    let by_file = render(&["--options", &path("options.json")], &path("file.png"));
    assert!(auto == by_file, "the file's options give another view");
    assert!(auto == render(&[], &path("default.png")), "the default is another");
    let refined = ["--sync", "refined", "--proxy", "mesh", "--blend", "lumigraph"];
    assert!(auto != render(&refined, &path("refined.png")), "nothing was chosen");
}

#[test]
fn plan_speaks_json_and_refuses_a_bad_budget() {
    let folder = still().film();
    let capture = text(folder.path());
    let output = succeed(&["-q", "plan", capture, "--json"]);
    let plan: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(plan["decisions"][1]["stage"], "sync");
    assert_eq!(plan["options"]["sync"], "nearest");
    let refused = run(&["-q", "plan", capture, "--budget-px", "nan"]);
    assert_refused(&refused, 2, "auto.budget_px");
}

#[test]
fn options_are_not_written_over_the_capture() {
    let folder = still().film();
    let capture = text(folder.path());
    let before = std::fs::read(folder.path().join("capture.json")).unwrap();
    for (name, words) in [
        ("capture.json", "describes the capture"),
        ("cam0/0.png", "is a frame of the capture"),
        ("cam0", "is a folder"),
        ("nowhere/options.json/x", "nowhere"),
    ] {
        let output = folder.path().join(name);
        if name.starts_with("nowhere") {
            std::fs::write(folder.path().join("nowhere"), "").unwrap();
        }
        let refused = run(&["-q", "plan", capture, "-o", text(&output)]);
        assert_refused(&refused, 2, words);
    }
    assert_eq!(std::fs::read(folder.path().join("capture.json")).unwrap(), before);
}
