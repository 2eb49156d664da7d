//! Datasets for other programs: a folder of images or videos with their calibration and times.
//!
//! | format | files |
//! |---|---|
//! | COLMAP | `images/cam0/0000.png`, `sparse/0/` with a binary model, and with the times in files of its extension colmap4d (specification 1.0) |
//! | NeRF | `images/cam0/0000.png`, `transforms.json` with a `time` for every image, in seconds |
//! | LLFF | `cam00.mp4` and so on, in the order of the rows of `poses_bounds.npy` |
//!
//! If the cameras are synchronized, the images of one instant form a *frame* in COLMAP's model: a set of images from
//! the cameras of one rig.

use super::colmap::COLMAP_BINARY_FILES;
use super::colmap_rigs::TIME_FILES;
use super::colmap_values::{camera_bytes, counted, image_bytes, pose_bytes};
use super::pairing::{all_entries, numbered_order};
use super::{ExchangeError, NamedCamera, content, write, write_llff, write_nerf};
use crate::camera::Camera;
use crate::host::temporary::Temporary;
use crate::raster::{BitDepth, Image, write_image};
use crate::video::{Codec, VideoFormat, VideoWriter};
use nalgebra::Isometry3;
use std::path::{Path, PathBuf};

/// File format of a dataset for another program.
#[derive(Clone, Debug, PartialEq)]
pub enum DatasetFormat {
    /// COLMAP's binary model. If `is_synchronized`, images with the same time form a frame of a rig in this model.
    Colmap { is_synchronized: bool },
    /// NeRF's `transforms.json`.
    Nerf,
    /// LLFF's `poses_bounds.npy` and a lossless video of each camera at `rate_hz` frames per second. `bounds_m` is the
    /// nearest and the farthest depth, in metres.
    Llff { bounds_m: (f64, f64), rate_hz: f64, ffmpeg: PathBuf },
}

/// An image of a dataset.
struct DatasetImage {
    /// Index of the image's camera.
    camera: usize,
    time_ns: i64,
    /// Path of the image, relative to the folder `images`.
    name: String,
}

/// A dataset that is being written into a temporary folder. [`Self::finish`] moves the dataset to its final path. A
/// dataset that is dropped earlier leaves no files.
pub struct Dataset {
    target: PathBuf,
    format: DatasetFormat,
    cameras: Vec<(String, Camera)>,
    images: Vec<DatasetImage>,
    /// The writer of each camera's video, for LLFF only; `None` before the camera's first image. This field is declared
    /// before `temporary`, so that the writers are dropped before the temporary folder is removed.
    videos: Vec<Option<VideoWriter>>,
    temporary: Temporary,
}

/// Name of the dataset's folder inside its temporary folder.
const WHOLE: &str = "dataset";

impl Dataset {
    /// Begins a dataset that will be written to the folder `target`. `cameras` are pairs of an id and a camera. Returns
    /// an error if the target folder isn't empty, or if the format can't represent a lens.
    pub fn create(
        target: &Path,
        format: DatasetFormat,
        cameras: Vec<(String, Camera)>,
    ) -> Result<Self, ExchangeError> {
        let failed = |source| ExchangeError::Write { path: target.to_owned(), source };
        if target.symlink_metadata().is_ok() && !all_entries(target)?.is_empty() {
            return Err(content(target, "holds files already, which are not written over"));
        }
        let absolute = std::path::absolute(target).map_err(failed)?;
        let beside = absolute.parent().ok_or_else(|| content(target, "names no folder"))?;
        let temporary = Temporary::inside(beside).map_err(failed)?;
        std::fs::create_dir(temporary.path().join(WHOLE)).map_err(failed)?;
        let videos = cameras.iter().map(|_| None).collect();
        let (target, images) = (target.to_owned(), Vec::new());
        let dataset = Self { target, format, cameras, images, videos, temporary };
        dataset.write_calibration(&dataset.path("."))?; // lenses are refused before images are rendered
        Ok(dataset)
    }

    fn path(&self, name: &str) -> PathBuf {
        self.temporary.path().join(WHOLE).join(name)
    }

    /// Returns an error about the target folder. If `message` starts with the path of the temporary folder, which the
    /// user doesn't know, this path is removed.
    fn of_target(&self, message: String) -> ExchangeError {
        let path = format!("{}/", self.temporary.path().join(WHOLE).display());
        content(&self.target, message.strip_prefix(&path).unwrap_or(&message))
    }

    /// Appends an image of the camera with the index `camera`. For LLFF, each camera's images must be appended in the
    /// order of their times.
    pub fn push(
        &mut self,
        camera: usize,
        time_ns: i64,
        image: &Image,
        depth: BitDepth,
    ) -> Result<(), ExchangeError> {
        let id = &self.cameras[camera].0;
        let index = self.images.iter().filter(|other| other.camera == camera).count();
        let name = format!("{id}/{index:04}.png");
        if let DatasetFormat::Llff { rate_hz, ffmpeg, .. } = &self.format {
            let pushed = if let Some(video) = &mut self.videos[camera] {
                video.push(image)
            } else {
                let format = VideoFormat {
                    depth: BitDepth::Eight,
                    rate_hz: *rate_hz,
                    codec: Codec::H264Lossless,
                };
                let path = self.path(&format!("cam{:02}.mp4", self.row(camera)));
                VideoWriter::create(ffmpeg, &path, image, format).and_then(|mut video| {
                    video.push(image)?;
                    self.videos[camera] = Some(video);
                    Ok(())
                })
            };
            pushed.map_err(|e| self.of_target(e.to_string()))?;
        } else {
            let path = self.path("images").join(&name);
            write_image(&path, image, None, depth).map_err(|e| self.of_target(e.to_string()))?;
        }
        self.images.push(DatasetImage { camera, time_ns, name });
        Ok(())
    }

    /// Returns the index of a camera's row in LLFF's `poses_bounds.npy`. The rows are sorted as described at
    /// [`write_llff`].
    fn row(&self, camera: usize) -> usize {
        let ids: Vec<String> = self.cameras.iter().map(|(id, _)| id.clone()).collect();
        let order = numbered_order(&ids).unwrap_or_else(|| (0..ids.len()).collect());
        order.iter().position(|&k| k == camera).unwrap_or(camera)
    }

    /// Finishes the videos, writes the calibration, and moves the dataset to its final path.
    pub fn finish(mut self) -> Result<(), ExchangeError> {
        for video in std::mem::take(&mut self.videos).into_iter().flatten() {
            video.finish().map_err(|e| self.of_target(e.to_string()))?;
        }
        self.write_calibration(&self.path("."))?;
        let failed = |source| ExchangeError::Write { path: self.target.clone(), source };
        self.temporary.place(WHOLE, &self.target).map_err(failed)
    }

    fn write_calibration(&self, folder: &Path) -> Result<(), ExchangeError> {
        match &self.format {
            DatasetFormat::Colmap { is_synchronized } => {
                self.write_colmap(&folder.join("sparse/0"), *is_synchronized)
            }
            DatasetFormat::Nerf => {
                let named = |image: &DatasetImage| NamedCamera {
                    name: format!("images/{}", image.name),
                    time_ns: Some(image.time_ns),
                    camera: self.cameras[image.camera].1.clone(),
                };
                let frames: Vec<NamedCamera> = if self.images.is_empty() {
                    self.named()
                } else {
                    self.images.iter().map(named).collect()
                };
                write_nerf(&folder.join("transforms.json"), &frames)
            }
            DatasetFormat::Llff { bounds_m, .. } => {
                write_llff(&folder.join("poses_bounds.npy"), &self.named(), *bounds_m)
            }
        }
        .map_err(|error| match error {
            ExchangeError::Content { reason, .. } => content(&self.target, reason),
            error => error,
        })
    }

    fn named(&self) -> Vec<NamedCamera> {
        let named = |(id, camera): &(String, Camera)| NamedCamera {
            name: id.clone(),
            time_ns: None,
            camera: camera.clone(),
        };
        self.cameras.iter().map(named).collect()
    }

    /// Writes COLMAP's binary model, and the images' times in the files of colmap4d, an extension of COLMAP's format.
    /// Cameras and images are numbered from 1.
    fn write_colmap(&self, folder: &Path, is_synchronized: bool) -> Result<(), ExchangeError> {
        let (mut lenses, mut images) = (counted(self.cameras.len()), counted(self.images.len()));
        for (number, (_, camera)) in (1_u32..).zip(&self.cameras) {
            lenses.extend(camera_bytes(number, camera));
        }
        let mut times = counted(self.images.len());
        for (number, image) in (1_u32..).zip(&self.images) {
            let camera = &self.cameras[image.camera].1;
            images.extend(image_bytes(number, image.camera as u32 + 1, camera, &image.name));
            times.extend(number.to_le_bytes());
            times.extend(image.time_ns.to_le_bytes());
        }
        let points = counted(0);
        let [times_file, meta_file] = TIME_FILES;
        let meta = serde_json::to_vec_pretty(&self.time_meta()).map_err(|e| content(folder, e))?;
        let mut files: Vec<(&str, Vec<u8>)> =
            COLMAP_BINARY_FILES.into_iter().zip([lenses, images, points]).collect();
        files.extend([(times_file, times), (meta_file, meta)]);
        if is_synchronized {
            files.extend([("rigs.bin", self.rigs()), ("frames.bin", self.frames())]);
        }
        files.iter().try_for_each(|(name, bytes)| write(&folder.join(name), bytes))
    }

    /// Returns the bytes of COLMAP's rigs file, with one rig of all cameras. The first camera is the rig's reference
    /// sensor.
    fn rigs(&self) -> Vec<u8> {
        let mut rigs = counted(1);
        rigs.extend(RIG.to_le_bytes());
        rigs.extend((self.cameras.len() as u32).to_le_bytes());
        let reference = self
            .cameras
            .first()
            .map_or_else(Isometry3::identity, |(_, camera)| camera.cam_from_world);
        for (number, (_, camera)) in (1_u32..).zip(&self.cameras) {
            rigs.extend(CAMERA_SENSOR.to_le_bytes());
            rigs.extend(number.to_le_bytes());
            if number > 1 {
                rigs.push(1);
                rigs.extend(pose_bytes(&(camera.cam_from_world * reference.inverse())));
            }
        }
        rigs
    }

    /// Returns the bytes of COLMAP's frames file. Each instant is a frame, which consists of all images with this time.
    fn frames(&self) -> Vec<u8> {
        let mut instants: Vec<i64> = self.images.iter().map(|image| image.time_ns).collect();
        instants.sort_unstable();
        instants.dedup();
        let mut frames = counted(instants.len());
        for (frame, time_ns) in (1_u32..).zip(instants) {
            let numbered = (1_u64..).zip(&self.images);
            let members: Vec<_> = numbered.filter(|(_, image)| image.time_ns == time_ns).collect();
            frames.extend(frame.to_le_bytes());
            frames.extend(RIG.to_le_bytes());
            frames.extend(pose_bytes(&self.cameras[0].1.cam_from_world));
            frames.extend((members.len() as u32).to_le_bytes());
            for (number, image) in members {
                frames.extend(CAMERA_SENSOR.to_le_bytes());
                frames.extend((image.camera as u32 + 1).to_le_bytes());
                frames.extend(number.to_le_bytes());
            }
        }
        frames
    }

    /// Returns the contents of `time_meta.json`, a file of colmap4d (an extension of COLMAP's format). It states the
    /// unit, the meaning and the clock of the images' times.
    fn time_meta(&self) -> serde_json::Value {
        let device = |(number, (id, _)): (usize, &(String, Camera))| {
            (id.clone(), serde_json::json!({ "camera_ids": [number + 1] }))
        };
        let devices: serde_json::Map<_, _> = self.cameras.iter().enumerate().map(device).collect();
        serde_json::json!({
            "colmap4d_spec": "1.0",
            "time_convention": "mid_exposure",
            "time_unit": "ns",
            "clock_domain": "reference_camera",
            "devices": devices,
        })
    }
}

/// Number of the only rig in the COLMAP model.
const RIG: u32 = 1;
/// COLMAP's code for the sensor type *camera*.
const CAMERA_SENSOR: i32 = 0;
