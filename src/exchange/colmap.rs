//! COLMAP's sparse model: the files `cameras`, `images` and `points3D`, as text or binary.

use super::colmap_rigs::{frame_poses, image_times};
use super::colmap_values::{
    Bytes, MAX_MODEL_BYTES, camera_bytes, counted, has_values, image_bytes, pose, text, value,
};
use super::{ExchangeError, NamedCamera, check_count, checked, content, write};
use crate::camera::{CameraFormat, CameraModel};
use nalgebra::Isometry3;
use std::collections::{BTreeMap, HashMap};
use std::fmt::Write as _;
use std::path::Path;

/// Names of the files of a text model: cameras, images and points, in this order.
pub const COLMAP_TEXT_FILES: [&str; 3] = ["cameras.txt", "images.txt", "points3D.txt"];
/// Names of the files of a binary model: cameras, images and points, in this order.
pub const COLMAP_BINARY_FILES: [&str; 3] = ["cameras.bin", "images.bin", "points3D.bin"];

/// Image size (width, height; pixels) and lens of each camera, by COLMAP's camera id.
type Lenses = HashMap<u32, ((u64, u64), CameraModel)>;

struct ModelImage {
    number: u32,
    name: String,
    camera_id: u32,
    rotation_wxyz: [f64; 4],
    translation: [f64; 3],
}

/// Two parsers: of COLMAP's cameras file, and of its images file. The caller adds the file's name to their error
/// messages.
type Readers = (fn(&[u8]) -> Result<Lenses, String>, fn(&[u8]) -> Result<Vec<ModelImage>, String>);

/// Reads the folder of a COLMAP model. Returns one [`NamedCamera`] per image, named after the image and sorted by image
/// number. Binary files are preferred to text files, as in COLMAP. If the model has rigs and frames, the poses follow
/// from them. If it has the file `times` of colmap4d, an extension of COLMAP's format, the images' times are read from
/// this file.
///
/// Errors: no images, too many images or cameras, a file that is not regular or larger than `MAX_MODEL_BYTES`, an
/// unknown camera model, a camera that is invalid in a capture.
pub fn read_colmap(folder: &Path) -> Result<Vec<NamedCamera>, ExchangeError> {
    let is_binary = folder.join(COLMAP_BINARY_FILES[0]).exists();
    let files = if is_binary { COLMAP_BINARY_FILES } else { COLMAP_TEXT_FILES };
    let [cameras_path, images_path, _] = files.map(|file| folder.join(file));
    let (read_lenses, read_images): Readers =
        if is_binary { (binary_lenses, binary_images) } else { (text_lenses, text_images) };
    let lenses = read_lenses(&bytes(&cameras_path)?).map_err(|e| content(&cameras_path, e))?;
    let mut images = read_images(&bytes(&images_path)?).map_err(|e| content(&images_path, e))?;
    if images.is_empty() {
        return Err(content(&images_path, "holds no image"));
    }
    images.sort_by_key(|image| image.number);
    let (poses, times) = (frame_poses(folder, is_binary)?, image_times(folder)?);
    let cameras = images.into_iter().map(|image| {
        let number = image.number;
        named(&lenses, image, poses.get(&u64::from(number)), times.get(&number).copied())
            .map_err(|reason| content(&images_path, format!("image {number}: {reason}")))
    });
    cameras.collect()
}

/// Returns the camera of an image, with the image's name and time. `frame_pose` is the camera-from-world pose that
/// follows from the image's frame and rig. It overrides the pose in `image`; `None` if the model has no such pose.
/// `time_ns` is `None` if the model has no time of the image.
fn named(
    lenses: &Lenses,
    image: ModelImage,
    frame_pose: Option<&Isometry3<f64>>,
    time_ns: Option<i64>,
) -> Result<NamedCamera, String> {
    let (size, model) = lenses
        .get(&image.camera_id)
        .ok_or_else(|| format!("there is no camera {}", image.camera_id))?;
    let own = pose(image.rotation_wxyz, image.translation);
    let cam_from_world = frame_pose.map_or(own, |pose| Ok(*pose))?;
    Ok(NamedCamera { name: image.name, time_ns, camera: checked(*size, model, &cam_from_world)? })
}

fn bytes(path: &Path) -> Result<Vec<u8>, ExchangeError> {
    super::read_bytes(path, MAX_MODEL_BYTES)
}

fn text_lenses(bytes: &[u8]) -> Result<Lenses, String> {
    let mut lenses = HashMap::new();
    for (k, line) in text(bytes)?.lines().enumerate().filter(|(_, line)| has_values(line)) {
        let (id, size, model) = text_lens(line).map_err(|e| format!("line {}: {e}", k + 1))?;
        if lenses.insert(id, (size, model)).is_some() {
            return Err(format!("line {}: there are two cameras {id}", k + 1));
        }
        check_count(lenses.len(), "cameras")?;
    }
    Ok(lenses)
}

fn text_lens(line: &str) -> Result<(u32, (u64, u64), CameraModel), String> {
    let fields = &mut line.split_whitespace();
    let id = value(fields, "CAMERA_ID")?;
    let name: String = value(fields, "MODEL")?;
    let size = (value(fields, "WIDTH")?, value(fields, "HEIGHT")?);
    let params: Vec<f64> = fields
        .map(|p| p.parse().map_err(|_| format!("PARAMS can't be '{p}'")))
        .collect::<Result<_, _>>()?;
    Ok((id, size, model(&name, &params)?))
}

fn model(name: &str, params: &[f64]) -> Result<CameraModel, String> {
    CameraModel::from_params(name, params)
        .ok_or_else(|| format!("the model {name} with {} parameters isn't known", params.len()))
}

/// Parses `images.txt`. Each image has two lines. The second line lists the image's points, may be empty, and is
/// skipped.
fn text_images(bytes: &[u8]) -> Result<Vec<ModelImage>, String> {
    let mut images = Vec::new();
    let mut lines = text(bytes)?.lines().enumerate();
    while let Some((k, line)) = lines.find(|(_, line)| has_values(line)) {
        images.push(text_image(line.trim()).map_err(|e| format!("line {}: {e}", k + 1))?);
        check_count(images.len(), "images")?;
        lines.next();
    }
    Ok(images)
}

/// Number of values before the image's name in the first of an image's two lines in `images.txt`.
const IMAGE_FIELDS: usize = 9;

/// Returns the rest of a line after its first `count` fields, which are separated by white space.
fn after_fields(line: &str, count: usize) -> &str {
    (0..count).fold(line, |rest, _| {
        rest.find(char::is_whitespace).map_or("", |end| rest[end..].trim_start())
    })
}

fn text_image(line: &str) -> Result<ModelImage, String> {
    let fields = &mut line.split_whitespace();
    let number = value(fields, "IMAGE_ID")?;
    let mut next = |what| value(fields, what);
    let rotation_wxyz = [next("QW")?, next("QX")?, next("QY")?, next("QZ")?];
    let translation = [next("TX")?, next("TY")?, next("TZ")?];
    let camera_id = value(fields, "CAMERA_ID")?;
    // COLMAP ends a name at its first space, but other programs write names that contain spaces.
    let name = after_fields(line, IMAGE_FIELDS).to_owned();
    if name.is_empty() {
        return Err("NAME is missing".into());
    }
    Ok(ModelImage { number, name, camera_id, rotation_wxyz, translation })
}

fn binary_lenses(bytes: &[u8]) -> Result<Lenses, String> {
    let mut bytes = Bytes(bytes);
    let mut lenses = HashMap::new();
    for _ in 0..bytes.u64()? {
        let id = bytes.u32()?;
        let number = bytes.u32()?;
        let &(name, _, count) = CameraModel::KNOWN
            .iter()
            .find(|(_, known, _)| u32::try_from(*known) == Ok(number))
            .ok_or_else(|| format!("camera {id}: the model number {number} isn't known"))?;
        let size = (bytes.u64()?, bytes.u64()?);
        let params = (0..count).map(|_| bytes.f64()).collect::<Result<Vec<_>, _>>()?;
        if lenses.insert(id, (size, model(name, &params)?)).is_some() {
            return Err(format!("there are two cameras {id}"));
        }
        check_count(lenses.len(), "cameras")?;
    }
    bytes.is_at_end()?;
    Ok(lenses)
}

fn binary_images(bytes: &[u8]) -> Result<Vec<ModelImage>, String> {
    let mut bytes = Bytes(bytes);
    let mut images = Vec::new();
    for _ in 0..bytes.u64()? {
        let number = bytes.u32()?;
        let rotation_wxyz = [bytes.f64()?, bytes.f64()?, bytes.f64()?, bytes.f64()?];
        let translation = [bytes.f64()?, bytes.f64()?, bytes.f64()?];
        let camera_id = bytes.u32()?;
        let name = bytes.name()?;
        let points = bytes.u64()?;
        bytes.skip(points, 24)?; // x, y, and the point's number
        images.push(ModelImage { number, name, camera_id, rotation_wxyz, translation });
        check_count(images.len(), "images")?;
    }
    bytes.is_at_end()?;
    Ok(images)
}

/// Returns the files of a COLMAP text model, by file name: `cameras.txt`, `images.txt` and an empty `points3D.txt`.
///
/// `images` has a name and a camera for each image. Images and cameras are numbered from 1 in the given order. Cameras
/// are not checked (see [`CameraFormat::camera`]). Every number is written so that it parses to the same double.
pub fn colmap_text(images: &[(String, CameraFormat)]) -> BTreeMap<&'static str, String> {
    let mut camera_lines = String::from("# CAMERA_ID MODEL WIDTH HEIGHT PARAMS[]\n");
    let mut image_lines = String::from(
        "# IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME\n# POINTS2D[] as (X Y POINT3D_ID): none\n",
    );
    for (k, (name, camera)) in images.iter().enumerate() {
        let n = k + 1;
        let CameraFormat { width, height, model, params, cam_from_world } = camera;
        let pose = [&cam_from_world.rotation_wxyz[..], &cam_from_world.translation].concat();
        // Writing to a string can't fail.
        let _ = writeln!(camera_lines, "{n} {model} {width} {height} {}", numbers(params));
        let _ = writeln!(image_lines, "{n} {} {n} {name}\n", numbers(&pose));
    }
    let points = "# POINT3D_ID X Y Z R G B ERROR TRACK[] as (IMAGE_ID POINT2D_IDX): none\n";
    let [cameras, images, points3d] = COLMAP_TEXT_FILES;
    BTreeMap::from([(cameras, camera_lines), (images, image_lines), (points3d, points.to_owned())])
}

fn numbers(values: &[f64]) -> String {
    values.iter().copied().map(number).collect::<Vec<_>>().join(" ")
}

/// Formats a double as the shortest text that parses to the same double, with an exponent as in C, such as `1e-07`.
fn number(value: f64) -> String {
    let text = format!("{value:?}");
    let Some((digits, exponent)) = text.split_once('e') else { return text };
    let (sign, power) = exponent.strip_prefix('-').map_or(('+', exponent), |power| ('-', power));
    format!("{digits}e{sign}{power:0>2}")
}

/// Writes the files of [`colmap_text`] into a folder, which is created if it is missing. A name that contains a space
/// is an error, because COLMAP splits lines at spaces.
pub fn write_colmap_text(folder: &Path, cameras: &[NamedCamera]) -> Result<(), ExchangeError> {
    if let Some(spaced) = cameras.iter().find(|c| c.name.contains(char::is_whitespace)) {
        let reason = format!(
            "COLMAP's text files can't hold a name with spaces, such as '{}': --format colmap writes binary ones",
            spaced.name
        );
        return Err(content(folder, reason));
    }
    let images: Vec<(String, CameraFormat)> =
        cameras.iter().map(|c| (c.name.clone(), CameraFormat::from(&c.camera))).collect();
    colmap_text(&images)
        .into_iter()
        .try_for_each(|(name, text)| write(&folder.join(name), text.as_bytes()))
}

/// Writes the cameras as a binary COLMAP model: `cameras.bin`, `images.bin` and an empty `points3D.bin`. Images and
/// cameras are numbered as in [`colmap_text`]. The folder is created if it is missing.
pub fn write_colmap_binary(folder: &Path, cameras: &[NamedCamera]) -> Result<(), ExchangeError> {
    let (mut lenses, mut images) = (counted(cameras.len()), counted(cameras.len()));
    for (number, NamedCamera { name, camera, .. }) in (1_u32..).zip(cameras) {
        lenses.extend(camera_bytes(number, camera));
        images.extend(image_bytes(number, number, camera, name));
    }
    let points = 0_u64.to_le_bytes();
    COLMAP_BINARY_FILES
        .iter()
        .zip([lenses.as_slice(), &images, &points])
        .try_for_each(|(name, bytes)| write(&folder.join(name), bytes))
}
