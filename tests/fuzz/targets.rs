//! The parsers, each with a good file.

use crate::common::root;
use crate::common::wall::Scene;
use std::fmt::Display;
use std::path::Path;
use stlfr::camera::{Camera, CameraFormat};
use stlfr::capture::{Capture, read_array};
use stlfr::exchange::{
    NamedCamera, read_colmap, read_llff, read_nerf, write_colmap_binary, write_colmap_text,
    write_llff, write_nerf,
};
use stlfr::json;
use stlfr::offset::{Offsets, SavedOffsets};
use stlfr::options::RenderOptions;
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
    ["cam0", "cam1"].map(|id| NamedCamera { name: id.into(), time_ns: None, camera: camera() }).into()
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
