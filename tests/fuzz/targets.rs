//! The parsers, each with a good file.

use crate::common::root;
use crate::common::wall::Scene;
use serde_json::json;
use std::fmt::Display;
use std::path::Path;
use stlfr::camera::{Camera, CameraFormat};
use stlfr::capture::{Capture, Truth, read_array};
use stlfr::exchange::{
    Dataset, DatasetFormat, NamedCamera, read_anipose, read_colmap, read_llff, read_nerf,
    read_qualisys, read_times, write_colmap_binary, write_colmap_text, write_llff, write_nerf,
};
use stlfr::json;
use stlfr::offset::{Offsets, SavedOffsets};
use stlfr::options::RenderOptions;
use stlfr::path::PathFormat;
use stlfr::raster::{BitDepth, Image, read_image, write_image};
use stlfr::rig::Rig;

/// One file of one parser.
pub struct Target {
    pub name: &'static str,
    /// The file that is mutated, in the folder.
    pub file: &'static str,
    pub is_text: bool,
    /// Writes the good file, and what stands beside it.
    pub prepare: fn(&Path),
    pub parse: fn(&Path) -> Result<(), String>,
}

fn text(error: impl Display) -> String {
    error.to_string()
}

/// Copies a scene's capture into the folder.
fn film(folder: &Path) {
    let scene = Scene { frames: 2, ..Scene::default() }.film();
    for camera in ["cam0", "cam1", "cam2"] {
        std::fs::create_dir_all(folder.join(camera)).unwrap();
        for frame in ["0.png", "1.png"] {
            let file = Path::new(camera).join(frame);
            std::fs::copy(scene.path().join(&file), folder.join(&file)).unwrap();
        }
    }
    std::fs::copy(scene.path().join("capture.json"), folder.join("capture.json")).unwrap();
}

pub fn capture() -> Target {
    Target {
        name: "capture",
        file: "capture.json",
        is_text: true,
        prepare: film,
        parse: |folder| Capture::open(folder).map(drop).map_err(text),
    }
}

fn camera() -> Camera {
    let json = Scene::default().camera([0.01, 0.0, 0.0]);
    serde_json::from_value::<CameraFormat>(json).unwrap().camera().unwrap()
}

pub fn view() -> Target {
    Target {
        name: "view",
        file: "view.json",
        is_text: true,
        prepare: |folder| {
            let json = Scene::default().camera([0.01, 0.0, 0.0]);
            std::fs::write(folder.join("view.json"), json.to_string()).unwrap();
        },
        parse: |folder| {
            let format: CameraFormat = json::read(&folder.join("view.json")).map_err(text)?;
            let camera = format.camera().map_err(text)?;
            let center = camera.center();
            assert!(center.iter().all(|v| v.is_finite()), "{center}");
            Ok(())
        },
    }
}

pub fn path() -> Target {
    Target {
        name: "path",
        file: "path.json",
        is_text: true,
        prepare: |folder| {
            let key = |at_s: f64, x: f64| {
                let camera = Scene::default().camera([x, 0.0, 0.0]);
                json!({"at_s": at_s, "time_s": 0.1 * at_s, "camera": camera, "rest": at_s > 0.0})
            };
            let path = json!({
                "format": "stlfr-path", "version": 1, "rate_hz": 30.0, "constant_speed": true,
                "keys": [key(0.0, 0.0), key(0.5, 0.02), key(1.0, 0.01)]
            });
            std::fs::write(folder.join("path.json"), path.to_string()).unwrap();
        },
        parse: |folder| {
            let format: PathFormat = json::read(&folder.join("path.json")).map_err(text)?;
            let path = format.path()?;
            let center = path.at(0.4 * path.duration_s()).camera.center();
            assert!(center.iter().all(|v| v.is_finite()), "{center}");
            Ok(())
        },
    }
}

pub fn truth() -> Target {
    Target {
        name: "truth",
        file: "truth/truth.json",
        is_text: true,
        prepare: |folder| {
            let camera = Scene::default().camera([0.01, 0.0, 0.0]);
            let view = json!({
                "id": "between", "time_s": 0.1, "like": null, "camera": camera,
                "image": "views/between.png", "depth": "depth/between.npy",
                "motion": "motion/between.npy"
            });
            let truth = json!({
                "format": "stlfr-truth", "version": 1, "scene": "wall", "rig": "row",
                "offsets": [{"id": "cam0", "offset_s": 0.0}],
                "shutter": [{"id": "cam0", "times_s": [0.0, 0.04]}],
                "views": [view]
            });
            std::fs::create_dir_all(folder.join("truth")).unwrap();
            std::fs::write(folder.join("truth/truth.json"), truth.to_string()).unwrap();
        },
        parse: |folder| Truth::open(folder).map(drop).map_err(text),
    }
}

pub fn options() -> Target {
    Target {
        name: "options",
        file: "options.json",
        is_text: true,
        prepare: |folder| {
            let text = serde_json::to_string_pretty(&RenderOptions::default()).unwrap();
            std::fs::write(folder.join("options.json"), text).unwrap();
        },
        parse: |folder| {
            let options: RenderOptions = json::read(&folder.join("options.json")).map_err(text)?;
            options.check().map_err(text)
        },
    }
}

pub fn offsets() -> Target {
    Target {
        name: "offsets",
        file: "offsets.json",
        is_text: true,
        prepare: |folder| {
            film(folder);
            let offsets = Offsets::known(&Capture::open(folder).unwrap());
            let text = serde_json::to_string_pretty(&offsets).unwrap();
            std::fs::write(folder.join("offsets.json"), text).unwrap();
        },
        parse: |folder| {
            let capture = Capture::open(folder).map_err(text)?;
            if let SavedOffsets::Edited(offsets) = Offsets::saved(&capture).map_err(text)? {
                assert!(offsets.fits(&capture), "{offsets:?}");
            }
            Ok(())
        },
    }
}

pub fn rig() -> Target {
    Target {
        name: "rig",
        file: "rig.json",
        is_text: true,
        prepare: |folder| {
            std::fs::copy(root().join("rigs/grey-mix.json"), folder.join("rig.json")).unwrap();
        },
        parse: |folder| Rig::read(&folder.join("rig.json")).map(drop).map_err(text),
    }
}

fn write_png(folder: &Path, depth: BitDepth) {
    let data = (0..16 * 12 * 3).map(|k| (k % 97) as f32 / 97.0).collect();
    write_image(&folder.join("a.png"), &Image::from_data(16, 12, 3, data), None, depth).unwrap();
}

fn read_png(folder: &Path) -> Result<(), String> {
    let (image, _) = read_image(&folder.join("a.png")).map_err(text)?;
    assert!(image.data().iter().all(|v| (0.0..=1.0).contains(v)));
    Ok(())
}

pub fn png_8() -> Target {
    Target {
        name: "png_8",
        file: "a.png",
        is_text: false,
        prepare: |folder| write_png(folder, BitDepth::Eight),
        parse: read_png,
    }
}

pub fn png_16() -> Target {
    Target { prepare: |folder| write_png(folder, BitDepth::Sixteen), name: "png_16", ..png_8() }
}

pub fn depth_npy() -> Target {
    Target {
        name: "depth_npy",
        file: "depth.npy",
        is_text: false,
        prepare: |folder| {
            let header = "{'descr': '<f4', 'fortran_order': False, 'shape': (3, 4), }";
            let header = format!("{header:<117}\n");
            let mut bytes = b"\x93NUMPY\x01\x00\x76\x00".to_vec();
            bytes.extend(header.bytes());
            bytes.extend((0..12).flat_map(|k| (k as f32).to_le_bytes()));
            std::fs::write(folder.join("depth.npy"), bytes).unwrap();
        },
        parse: |folder| read_array(&folder.join("depth.npy")).map(drop).map_err(text),
    }
}

fn cameras() -> Vec<NamedCamera> {
    ["cam0", "cam1"]
        .map(|id| NamedCamera { name: id.into(), time_ns: None, camera: camera() })
        .into()
}

fn parse_colmap(folder: &Path) -> Result<(), String> {
    for found in read_colmap(folder).map_err(text)? {
        assert!(found.camera.focal_px() > 0.0);
    }
    Ok(())
}

pub fn colmap_text_cameras() -> Target {
    Target {
        name: "colmap_text_cameras",
        file: "cameras.txt",
        is_text: true,
        prepare: |folder| write_colmap_text(folder, &cameras()).unwrap(),
        parse: parse_colmap,
    }
}

pub fn colmap_text_images() -> Target {
    Target { name: "colmap_text_images", file: "images.txt", ..colmap_text_cameras() }
}

pub fn colmap_binary_cameras() -> Target {
    Target {
        name: "colmap_binary_cameras",
        file: "cameras.bin",
        is_text: false,
        prepare: |folder| write_colmap_binary(folder, &cameras()).unwrap(),
        parse: parse_colmap,
    }
}

pub fn colmap_binary_images() -> Target {
    Target { name: "colmap_binary_images", file: "images.bin", ..colmap_binary_cameras() }
}

/// A model of a rig with two cameras at one instant, in text.
fn write_rig(folder: &Path) {
    write_colmap_text(folder, &cameras()).unwrap();
    let rigs = "7 2 CAMERA 1 CAMERA 2 1 1 0 0 0 -0.5 0 0\n";
    std::fs::write(folder.join("rigs.txt"), rigs).unwrap();
    let frames = "1 7 1 0 0 0 0 0 -2 2 CAMERA 1 1 CAMERA 2 2\n";
    std::fs::write(folder.join("frames.txt"), frames).unwrap();
}

pub fn colmap_text_rigs() -> Target {
    Target {
        name: "colmap_text_rigs",
        file: "rigs.txt",
        is_text: true,
        prepare: write_rig,
        parse: parse_colmap,
    }
}

pub fn colmap_text_frames() -> Target {
    Target { name: "colmap_text_frames", file: "frames.txt", ..colmap_text_rigs() }
}

/// A dataset with a binary model of a rig.
fn write_dataset(folder: &Path) {
    let format = DatasetFormat::Colmap { is_synchronized: true };
    let cameras = cameras().into_iter().map(|c| (c.name, c.camera)).collect();
    let mut dataset = Dataset::create(&folder.join("data"), format, cameras).unwrap();
    let image = Image::filled(8, 6, 1, 0.5);
    for camera in 0..2 {
        dataset.push(camera, 1_000_000, &image, BitDepth::Eight).unwrap();
    }
    dataset.finish().unwrap();
}

pub fn colmap_binary_rigs() -> Target {
    Target {
        name: "colmap_binary_rigs",
        file: "data/sparse/0/rigs.bin",
        is_text: false,
        prepare: write_dataset,
        parse: |folder| parse_colmap(&folder.join("data/sparse/0")),
    }
}

pub fn colmap_binary_frames() -> Target {
    Target {
        name: "colmap_binary_frames",
        file: "data/sparse/0/frames.bin",
        ..colmap_binary_rigs()
    }
}

pub fn colmap_times() -> Target {
    Target { name: "colmap_times", file: "data/sparse/0/times.bin", ..colmap_binary_rigs() }
}

/// A camera as Anipose and Pose2Sim write it.
const CALIB: &str = r#"[cam_0]
name = "left"
size = [ 640, 480.0 ]
matrix = [ [ 500.0, 0.0, 319.5 ], [ 0.0, 510.0, 239.5 ], [ 0.0, 0.0, 1.0 ] ]
distortions = [ 0.1, -0.2, 0.001, 0.002, 0.3 ]
rotation = [ 0.1, 0.2, 0.3 ]
translation = [ 0.5, 0.0, 1.0 ]
fisheye = false

[metadata]
adjusted = false
"#;

pub fn calib_toml() -> Target {
    Target {
        name: "calib_toml",
        file: "Calib.toml",
        is_text: true,
        prepare: |folder| std::fs::write(folder.join("Calib.toml"), CALIB).unwrap(),
        parse: |folder| read_anipose(&folder.join("Calib.toml")).map(drop).map_err(text),
    }
}

/// A camera as Qualisys writes it.
const QCA: &str = r#"<?xml version='1.0' encoding='ASCII'?>
<calibration type="regular"><cameras><camera active="1" serial="cam01" model="none">
<fov_video left="0" top="8" right="639" bottom="487"/>
<transform r11="1" r12="0" r13="0" r21="0" r22="0" r23="1" r31="0" r32="-1" r33="0" x="100" y="-2000" z="1500"/>
<intrinsic focalLengthU="32000" focalLengthV="32640" centerPointU="20448" centerPointV="15840" skew="0.0"
 radialDistortion1="-0.1" radialDistortion2="0.2" tangentalDistortion1="0.001" tangentalDistortion2="0.002"/>
</camera></cameras></calibration>
"#;

pub fn qualisys() -> Target {
    Target {
        name: "qualisys",
        file: "Calib.qca.txt",
        is_text: true,
        prepare: |folder| std::fs::write(folder.join("Calib.qca.txt"), QCA).unwrap(),
        parse: |folder| read_qualisys(&folder.join("Calib.qca.txt")).map(drop).map_err(text),
    }
}

pub fn timestamps() -> Target {
    Target {
        name: "timestamps",
        file: "timestamps.csv",
        is_text: true,
        prepare: |folder| {
            let text =
                "sync_index,cam_id,frame_time\n416,3,48033.0121928\n416,\"1\",48033.00157345\n";
            std::fs::write(folder.join("timestamps.csv"), text).unwrap();
        },
        parse: |folder| read_times(&folder.join("timestamps.csv")).map(drop).map_err(text),
    }
}

pub fn transforms() -> Target {
    Target {
        name: "transforms",
        file: "transforms.json",
        is_text: true,
        prepare: |folder| write_nerf(&folder.join("transforms.json"), &cameras()).unwrap(),
        parse: |folder| read_nerf(&folder.join("transforms.json")).map(drop).map_err(text),
    }
}

pub fn poses_bounds() -> Target {
    Target {
        name: "poses_bounds",
        file: "poses_bounds.npy",
        is_text: false,
        prepare: |folder| {
            write_llff(&folder.join("poses_bounds.npy"), &cameras(), (1.0, 6.0)).unwrap();
        },
        parse: |folder| read_llff(&folder.join("poses_bounds.npy")).map(drop).map_err(text),
    }
}
