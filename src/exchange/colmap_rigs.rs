//! Reader of optional files of COLMAP models: rigs and frames, which give the poses of images since COLMAP 3.12, and
//! times of images as in colmap4d, an extension of COLMAP's format (specification 1.0).

use super::colmap_values::{Bytes, MAX_MODEL_BYTES, has_values, pose, text, value};
use super::{ExchangeError, check_count, content, read_bytes};
use nalgebra::Isometry3;
use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::str::SplitWhitespace;

/// Names of the files that colmap4d, an extension of COLMAP's format, adds to a model: the times of the images, and the
/// unit and the meaning of these times.
pub(super) const TIME_FILES: [&str; 2] = ["times.bin", "time_meta.json"];

/// Type and number of a sensor in a COLMAP rig. Only sensors of the type [`CAMERA`] are used.
type Sensor = (i32, u32);

/// COLMAP's code for the sensor type *camera*.
const CAMERA: i32 = 0;

/// Sensor-from-rig poses, by rig number and sensor; `None` if a sensor's pose is unknown. The pose of a rig's reference
/// sensor is the identity.
type Rigs = HashMap<u32, HashMap<Sensor, Option<Isometry3<f64>>>>;

/// A frame in COLMAP's sense: the images of one rig at one instant.
struct ModelFrame {
    rig: u32,
    rig_from_world: Isometry3<f64>,
    /// For each image: the sensor that took it, and the image's number.
    images: Vec<(Sensor, u64)>,
}

/// Returns the camera-from-world pose of each image, by image number. The poses are composed from the rigs and frames
/// of a COLMAP model. Returns an empty map if the model has no rigs or no frames.
pub(super) fn frame_poses(
    folder: &Path,
    is_binary: bool,
) -> Result<HashMap<u64, Isometry3<f64>>, ExchangeError> {
    let names = if is_binary { ["rigs.bin", "frames.bin"] } else { ["rigs.txt", "frames.txt"] };
    let [rigs_path, frames_path] = names.map(|name| folder.join(name));
    if !rigs_path.exists() || !frames_path.exists() {
        return Ok(HashMap::new());
    }
    let rigs = parsed(&rigs_path, if is_binary { binary_rigs } else { text_rigs })?;
    let frames = parsed(&frames_path, if is_binary { binary_frames } else { text_frames })?;
    let mut poses = HashMap::new();
    for ModelFrame { rig, rig_from_world, images } in frames {
        let wrong = |reason: String| content(&frames_path, reason);
        let sensors = rigs.get(&rig).ok_or_else(|| wrong(format!("there is no rig {rig}")))?;
        for (sensor, image) in images.into_iter().filter(|(sensor, _)| sensor.0 == CAMERA) {
            let sensor_from_rig = sensors
                .get(&sensor)
                .ok_or_else(|| wrong(format!("rig {rig} has no camera {}", sensor.1)))?;
            if let Some(sensor_from_rig) = sensor_from_rig {
                poses.insert(image, sensor_from_rig * rig_from_world);
            }
        }
    }
    Ok(poses)
}

fn parsed<T>(path: &Path, parse: fn(&[u8]) -> Result<T, String>) -> Result<T, ExchangeError> {
    parse(&read_bytes(path, MAX_MODEL_BYTES)?).map_err(|reason| content(path, reason))
}

fn binary_rigs(bytes: &[u8]) -> Result<Rigs, String> {
    let mut bytes = Bytes(bytes);
    let mut rigs = Rigs::new();
    for _ in 0..bytes.u64()? {
        let rig = bytes.u32()?;
        let count = bytes.u32()?;
        let mut sensors = HashMap::new();
        for k in 0..count {
            let sensor = (bytes.u32()?.cast_signed(), bytes.u32()?);
            let has_pose = k > 0 && bytes.take::<1>()? != [0];
            let pose = has_pose.then(|| binary_pose(&mut bytes)).transpose()?;
            sensors.insert(sensor, if k == 0 { Some(Isometry3::identity()) } else { pose });
            check_count(sensors.len(), "sensors")?;
        }
        rigs.insert(rig, sensors);
        check_count(rigs.len(), "rigs")?;
    }
    bytes.is_at_end()?;
    Ok(rigs)
}

fn binary_frames(bytes: &[u8]) -> Result<Vec<ModelFrame>, String> {
    let mut bytes = Bytes(bytes);
    let mut frames = Vec::new();
    for _ in 0..bytes.u64()? {
        bytes.u32()?; // the frame's own number
        let rig = bytes.u32()?;
        let rig_from_world = binary_pose(&mut bytes)?;
        let mut images = Vec::new();
        for _ in 0..bytes.u32()? {
            images.push(((bytes.u32()?.cast_signed(), bytes.u32()?), bytes.u64()?));
            check_count(images.len(), "images of a frame")?;
        }
        frames.push(ModelFrame { rig, rig_from_world, images });
        check_count(frames.len(), "frames")?;
    }
    bytes.is_at_end()?;
    Ok(frames)
}

fn binary_pose(bytes: &mut Bytes) -> Result<Isometry3<f64>, String> {
    let rotation = [bytes.f64()?, bytes.f64()?, bytes.f64()?, bytes.f64()?];
    pose(rotation, [bytes.f64()?, bytes.f64()?, bytes.f64()?])
}

/// Parses every line of a text file, except empty lines and comments, with the function `parse`. An error message
/// starts with the number of the line.
fn lines<T>(
    bytes: &[u8],
    mut parse: impl FnMut(&mut SplitWhitespace) -> Result<T, String>,
) -> Result<Vec<T>, String> {
    let mut parsed = Vec::new();
    for (k, line) in text(bytes)?.lines().enumerate().filter(|(_, line)| has_values(line)) {
        let fields = &mut line.split_whitespace();
        parsed.push(parse(fields).map_err(|reason| format!("line {}: {reason}", k + 1))?);
        check_count(parsed.len(), "lines")?;
    }
    Ok(parsed)
}

fn text_sensor(fields: &mut SplitWhitespace) -> Result<Sensor, String> {
    let kind: String = value(fields, "SENSOR_TYPE")?;
    Ok((if kind == "CAMERA" { CAMERA } else { CAMERA + 1 }, value(fields, "SENSOR_ID")?))
}

fn text_pose(fields: &mut SplitWhitespace) -> Result<Isometry3<f64>, String> {
    let mut next = |what| value(fields, what);
    let rotation = [next("QW")?, next("QX")?, next("QY")?, next("QZ")?];
    pose(rotation, [next("TX")?, next("TY")?, next("TZ")?])
}

fn text_rigs(bytes: &[u8]) -> Result<Rigs, String> {
    let rigs = lines(bytes, |fields| {
        let rig: u32 = value(fields, "RIG_ID")?;
        let count: usize = value(fields, "NUM_SENSORS")?;
        check_count(count, "sensors")?;
        let mut sensors = HashMap::new();
        for k in 0..count {
            let sensor = text_sensor(fields)?;
            let has_pose = k > 0 && value::<u8>(fields, "HAS_POSE")? != 0;
            let pose = has_pose.then(|| text_pose(fields)).transpose()?;
            sensors.insert(sensor, if k == 0 { Some(Isometry3::identity()) } else { pose });
        }
        Ok((rig, sensors))
    })?;
    Ok(rigs.into_iter().collect())
}

fn text_frames(bytes: &[u8]) -> Result<Vec<ModelFrame>, String> {
    lines(bytes, |fields| {
        value::<u32>(fields, "FRAME_ID")?;
        let rig = value(fields, "RIG_ID")?;
        let rig_from_world = text_pose(fields)?;
        let count: usize = value(fields, "NUM_DATA_IDS")?;
        check_count(count, "images of a frame")?;
        let image = |fields: &mut SplitWhitespace| {
            Ok::<_, String>((text_sensor(fields)?, value(fields, "DATA_ID")?))
        };
        let images = (0..count).map(|_| image(fields)).collect::<Result<_, _>>()?;
        Ok(ModelFrame { rig, rig_from_world, images })
    })
}

/// Reads the times of a COLMAP model's images from the file `times.bin`, or else from `times.txt`. Returns them in
/// nanoseconds, by image number. If an image has several times, the last one is used. Returns an empty map if neither
/// file exists.
pub(super) fn image_times(folder: &Path) -> Result<HashMap<u32, i64>, ExchangeError> {
    let [binary, in_text]: [PathBuf; 2] = ["times.bin", "times.txt"].map(|name| folder.join(name));
    let times = if binary.exists() {
        parsed(&binary, binary_times)?
    } else if in_text.exists() {
        parsed(&in_text, |bytes| {
            lines(bytes, |fields| Ok((value(fields, "IMAGE_ID")?, value(fields, "T_NS")?)))
        })?
    } else {
        Vec::new()
    };
    Ok(times.into_iter().collect())
}

fn binary_times(bytes: &[u8]) -> Result<Vec<(u32, i64)>, String> {
    let mut bytes = Bytes(bytes);
    let mut times = Vec::new();
    for _ in 0..bytes.u64()? {
        times.push((bytes.u32()?, bytes.u64()?.cast_signed()));
        check_count(times.len(), "times")?;
    }
    bytes.is_at_end()?;
    Ok(times)
}
