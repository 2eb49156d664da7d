//! Captures whose frames are video files.

mod common;

use common::{assert_refused, describe, edit, ffmpeg, interruptible, stderr, stlfr, synthetic};
use serde_json::{Value, json};
use std::os::unix::fs::PermissionsExt;
use std::os::unix::process::ExitStatusExt;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::{Duration, Instant};
use stlfr::capture::{Capture, CaptureError, Opening};
use stlfr::progress::Reporter;
use stlfr::raster::{BitDepth, Image, read_image, write_image};
use stlfr::video::{Codec, VideoFormat, VideoWriter};

const FRAMES: usize = 5;

/// Opens a capture whose cameras may be videos.
fn open(folder: &Path) -> Result<Capture, CaptureError> {
    let reporter = &Reporter::silent();
    Capture::open_with(folder, &Opening { ffmpeg: Some(&ffmpeg()), reporter })
}

fn encode(path: &Path, frames: &[Image], depth: BitDepth, rate_hz: f64) {
    let codec = Codec::Ffv1;
    let mut video = {
        let format = VideoFormat { depth, rate_hz, codec };
        VideoWriter::create(&ffmpeg(), path, &frames[0], format).unwrap()
    };
    frames.iter().for_each(|f| video.push(f).unwrap());
    video.finish().unwrap();
}

/// Encodes a video with ffmpeg's own arguments.
#[track_caller]
fn encode_by(arguments: &str, path: &Path) {
    let status = Command::new(ffmpeg())
        .args(["-v", "error", "-y"])
        .args(arguments.split(' '))
        .arg(path)
        .status()
        .unwrap();
    assert!(status.success(), "{arguments}");
}

/// A capture of one camera of 64×48 pixels whose frames are `video.mkv`, which isn't there yet.
fn one_camera() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    let capture = json!({"format": "stlfr-capture", "version": 1, "name": "one", "cameras": [{
        "id": "a", "frames": "video.mkv", "width": 64, "height": 48, "model": "PINHOLE",
        "params": [60.0, 60.0, 32.0, 24.0],
        "cam_from_world": {"rotation_wxyz": [1, 0, 0, 0], "translation": [0, 0, 0]},
        "clock": {"rate_hz": 30.0, "first_s": 0.0, "shared": true}}]});
    describe(folder.path(), &capture);
    folder
}

fn error(folder: &Path) -> String {
    let message = open(folder).unwrap_err().to_string();
    assert!(!message.contains('\n') && !message.contains("0x"), "{message}");
    message
}

/// The same capture as image sequences and as videos gives the same offsets and the same pictures,
/// and goes on doing so when the cache is deleted or damaged.
#[test]
fn videos_equal_their_image_sequences() {
    let images = synthetic::capture(&[0.0, 0.3, 0.6], FRAMES);
    let videos = synthetic::capture(&[0.0, 0.3, 0.6], FRAMES);
    for c in 0..3 {
        let folder = videos.path().join(format!("cam{c}"));
        let frames: Vec<Image> = (0..FRAMES)
            .map(|k| read_image(&folder.join(format!("{k:04}.png"))).unwrap().0)
            .collect();
        let rate_hz = synthetic::RATE_HZ;
        encode(&videos.path().join(format!("cam{c}.mkv")), &frames, BitDepth::Eight, rate_hz);
        std::fs::remove_dir_all(folder).unwrap();
    }
    edit(videos.path(), |json| {
        for c in 0..3 {
            json["cameras"][c]["frames"] = json!(format!("cam{c}.mkv"));
        }
    });
    let offsets = |folder: &Path| {
        let output = stlfr().arg("offsets").arg(folder).arg("--json").output().unwrap();
        assert!(output.status.success(), "{}", stderr(&output));
        output.stdout
    };
    assert_eq!(offsets(images.path()), offsets(videos.path()));
    let render = |folder: &Path| {
        let out = folder.join("out.png");
        let output = stlfr()
            .args(["-q", "render", "--like", "cam1", "--time", "0.05", "-o"])
            .args([&out, folder])
            .output()
            .unwrap();
        assert!(output.status.success(), "{}", stderr(&output));
        std::fs::read(out).unwrap()
    };
    let expected = render(images.path());
    assert!(expected == render(videos.path()), "other pixels");

    let cache = videos.path().join(".stlfr/cache/video");
    let index = |k: usize| {
        let capture = open(videos.path()).unwrap();
        capture.cameras[k].frames[0].clone()
    };
    std::fs::write(index(1), b"cut short").unwrap();
    assert!(expected == render(videos.path()), "a damaged cache was used");
    std::fs::remove_dir_all(cache).unwrap();
    assert!(expected == render(videos.path()), "other pixels from a new cache");

    // The input is not written over.
    let over = videos.path().join("cam1.mkv");
    let arguments = ["render", "--like", "cam1", "--times", "0.04:0.06:2", "-o"];
    let output = stlfr().args(arguments).args([&over, videos.path()]).output().unwrap();
    assert_refused(&output, 2, "is a frame of the capture");
}

#[test]
fn depths_and_colours_survive() {
    for (channels, depth, white) in [
        (1, BitDepth::Eight, 255.0),
        (3, BitDepth::Eight, 255.0),
        (1, BitDepth::Sixteen, 65535.0),
        (3, BitDepth::Sixteen, 65535.0),
    ] {
        let folder = one_camera();
        let data =
            (0..64 * 48 * channels).map(|k| ((k * 7919) % (white as usize + 1)) as f32 / white);
        let image = Image::from_data(64, 48, channels, data.collect());
        encode(&folder.path().join("video.mkv"), std::slice::from_ref(&image), depth, 30.0);
        let capture = open(folder.path()).unwrap();
        assert_eq!(capture.bit_depth(), depth);
        let twin = folder.path().join("twin.png");
        write_image(&twin, &image.to_rgb(), None, depth).unwrap();
        assert!(capture.read_frame(0, 0).unwrap() == read_image(&twin).unwrap().0, "{channels}");
    }
}

/// One colour in limited and in full range is read as the same colour.
#[test]
fn colour_ranges_are_distinguished() {
    for range in ["tv", "pc"] {
        let folder = one_camera();
        let source = "-f lavfi -i color=c=0xC04080:size=64x48:rate=30:duration=0.1";
        let filter = format!("-vf scale=out_range={range}:out_color_matrix=bt601 -pix_fmt yuv444p");
        let tags = format!("-color_range {range} -colorspace smpte170m -c:v ffv1");
        encode_by(&format!("{source} {filter} {tags}"), &folder.path().join("video.mkv"));
        let capture = open(folder.path()).unwrap();
        let image = capture.read_frame(0, 1).unwrap();
        for (v, expected) in image.pixel(30, 20).iter().zip([192.0, 64.0, 128.0]) {
            assert!((255.0 * v - expected).abs() <= 2.0, "{range}: {:?}", image.pixel(30, 20));
        }
    }
}

#[test]
fn sound_and_a_leading_dash_do_not_matter() {
    let folder = one_camera();
    let source = "-f lavfi -i testsrc2=size=64x48:rate=30:duration=0.2 -f lavfi -i sine -shortest";
    encode_by(&format!("{source} -c:v ffv1"), &folder.path().join("-i.mkv"));
    edit(folder.path(), |json| json["cameras"][0]["frames"] = json!("-i.mkv"));
    assert_eq!(open(folder.path()).unwrap().cameras[0].frames.len(), 6);
}

#[test]
fn bad_videos_are_one_sentence() {
    let folder = one_camera();
    let path = folder.path().join("video.mkv");
    assert!(error(folder.path()).contains("cameras[0] (a).frames: 'video.mkv' does not exist"));

    encode_by("-f lavfi -i testsrc2=size=64x48:rate=30:duration=1 -c:v ffv1 -f matroska", &path);
    let whole = std::fs::read(&path).unwrap();
    for (bytes, words) in [
        (&whole[..whole.len() / 2], "frames: 'video.mkv' is not a whole video"),
        (&whole[..200], "frames: 'video.mkv' is not a whole video"),
        (b"no video at all".as_slice(), "frames: 'video.mkv' is not a whole video"),
        (b"".as_slice(), "frames: 'video.mkv' is not a whole video"),
    ] {
        std::fs::write(&path, bytes).unwrap();
        let message = error(folder.path());
        assert!(message.contains(words), "{words}: {message}");
    }
    let left = std::fs::read_dir(folder.path().join(".stlfr/cache/video")).unwrap().flatten();
    assert!(left.map(|e| e.path()).all(|p| p.extension().is_some_and(|e| e == "lock")));

    std::fs::write(&path, &whole).unwrap();
    assert_eq!(open(folder.path()).unwrap().cameras[0].frames.len(), 30);
    for (change, words) in [
        ((|j| j["width"] = json!(65)) as fn(&mut Value), "video.mkv: is 64×48 pixels"),
        (|j| j["clock"]["rate_hz"] = json!(25.0), "video's own time stamps"),
        (|j| j["clock"] = json!({"shared": true}), "frames.json"),
        (|j| j["clock"] = json!({"shared": true, "times_s": [0, 1]}), "2 entries for 30 frames"),
        (|j| j["frames"] = json!("../video.mkv"), "stay inside"),
        (|j| j["frames"] = json!("capture.png"), "does not exist"),
        (|j| j["frames"] = json!("."), "is not a file"),
    ] {
        let before = std::fs::read(folder.path().join("capture.json")).unwrap();
        edit(folder.path(), |json| change(&mut json["cameras"][0]));
        let message = error(folder.path());
        assert!(message.contains(words), "{words}: {message}");
        std::fs::write(folder.path().join("capture.json"), before).unwrap();
    }
}

/// A file that makes ffmpeg open others is no video here.
#[test]
fn playlists_and_scripts_reach_no_other_file() {
    let folder = one_camera();
    let outside = tempfile::tempdir().unwrap();
    let secret = outside.path().join("secret.mkv");
    encode_by("-f lavfi -i testsrc2=size=64x48:rate=30:duration=0.2 -c:v ffv1", &secret);
    let path = folder.path().join("video.mkv");
    let secret = secret.display();
    for script in [
        format!("ffconcat version 1.0\nfile '{secret}'\n"),
        format!("#EXTM3U\n#EXT-X-TARGETDURATION:10\n#EXTINF:1,\n{secret}\n#EXT-X-ENDLIST\n"),
        format!("v=0\nc=IN IP4 127.0.0.1\nm=video {secret}\n"),
    ] {
        std::fs::write(&path, script).unwrap();
        assert!(error(folder.path()).contains("is not a whole video"));
    }
    std::fs::remove_file(&path).unwrap();
    std::os::unix::fs::symlink(outside.path().join("secret.mkv"), &path).unwrap();
    assert!(error(folder.path()).contains("leads out of the capture"));
}

#[test]
fn without_an_ffmpeg_the_sentence_says_what_to_do() {
    let folder = one_camera();
    std::fs::write(folder.path().join("video.mkv"), "anything").unwrap();
    let home = tempfile::tempdir().unwrap();
    std::fs::create_dir(home.path().join("blender")).unwrap();
    std::fs::write(home.path().join("blender/requirements.txt"), "").unwrap();
    let output = stlfr()
        .args(["render", "--like", "a", "--time", "0", "-o", "target/none.png"])
        .arg(folder.path())
        .env("STLFR_HOME", home.path())
        .env("PATH", "/nowhere")
        .output()
        .unwrap();
    assert_refused(&output, 1, "install it, or run stlfr setup");
}

/// A program in ffmpeg's place: `before`, then ffmpeg itself, then `after`, in the capture's folder.
fn around_ffmpeg(folder: &Path, before: &str, after: &str) -> PathBuf {
    let path = folder.join("ffmpeg.sh");
    let script = format!(
        "#!/bin/sh\ncapture='{}'\n{before}\n'{}' \"$@\"\ncode=$?\n{after}\nexit $code\n",
        folder.display(),
        ffmpeg().display()
    );
    std::fs::write(&path, script).unwrap();
    std::fs::set_permissions(&path, std::fs::Permissions::from_mode(0o755)).unwrap();
    path
}

/// Pixels of the first frame by the program in ffmpeg's place.
fn first_pixel(folder: &Path, ffmpeg: &Path) -> Result<f32, CaptureError> {
    let reporter = &Reporter::silent();
    let capture = Capture::open_with(folder, &Opening { ffmpeg: Some(ffmpeg), reporter })?;
    Ok(capture.read_frame(0, 0)?.pixel(0, 0)[0])
}

#[test]
fn a_video_that_is_another_while_it_is_decoded_is_never_cached_as_itself() {
    let moves = [
        // Another file at the path, then the first one again.
        (
            "mv $capture/video.mkv $capture/kept; mv $capture/other.mkv $capture/video.mkv",
            "mv $capture/video.mkv $capture/other.mkv; mv $capture/kept $capture/video.mkv",
        ),
        // Other bytes in the file, then the first ones again.
        (
            "cp $capture/video.mkv $capture/kept; cat $capture/other.mkv > $capture/video.mkv",
            "cat $capture/kept > $capture/video.mkv",
        ),
    ];
    for (k, (before, after)) in moves.into_iter().enumerate() {
        let folder = one_camera();
        for (name, value) in [("video.mkv", 0.25), ("other.mkv", 0.75)] {
            let images = [Image::filled(64, 48, 1, value), Image::filled(64, 48, 1, value)];
            encode(&folder.path().join(name), &images, BitDepth::Eight, 30.0);
        }
        let swapping = around_ffmpeg(folder.path(), before, after);
        match first_pixel(folder.path(), &swapping) {
            Ok(value) => assert!(k == 0 && (value - 0.25).abs() < 0.01, "{k}: {value}"),
            Err(error) => {
                let error = error.to_string();
                assert!(error.ends_with("video.mkv: changed while it was being used"), "{error}");
            }
        }
        let value = first_pixel(folder.path(), &ffmpeg()).unwrap();
        assert!((value - 0.25).abs() < 0.01, "{k}: {value}");
    }
}

#[test]
fn a_video_of_larger_images_than_its_cameras_is_refused_before_it_is_decoded() {
    let folder = one_camera();
    let path = folder.path().join("video.mkv");
    encode_by("-f lavfi -i testsrc=size=4096x2048:rate=30:duration=1 -c:v ffv1", &path);
    let start = Instant::now();
    let message = error(folder.path());
    let words = "frames: 'video.mkv' has images of 4096x2048 pixels, its camera 64x48";
    assert!(message.ends_with(words), "{message}");
    assert!(start.elapsed() < Duration::from_secs(2), "{:?}", start.elapsed());
}

#[test]
fn a_signal_ends_a_decoder_that_ignores_it() {
    let folder = one_camera();
    std::fs::write(folder.path().join("video.mkv"), "anything").unwrap();
    let bin = folder.path().join("bin");
    std::fs::create_dir(&bin).unwrap();
    let script =
        format!("#!/bin/sh\ntrap '' TERM\necho $$ > {}/id\nsleep 60\nsleep 60\n", bin.display());
    let program = bin.join("ffmpeg");
    std::fs::write(&program, script).unwrap();
    std::fs::set_permissions(&program, std::fs::Permissions::from_mode(0o755)).unwrap();
    let path = std::env::join_paths([bin.as_path(), Path::new("/usr/bin"), Path::new("/bin")]);
    let mut child = interruptible(stlfr().arg("offsets").arg(folder.path()))
        .env("PATH", path.unwrap())
        .spawn()
        .unwrap();
    let id = || std::fs::read_to_string(bin.join("id")).ok().filter(|id| id.ends_with('\n'));
    let id = std::iter::repeat_with(id).flatten().next().unwrap();
    // SAFETY: the child has not been waited for, so its id is still its own.
    unsafe { libc::kill(child.id() as i32, libc::SIGTERM) };
    assert_eq!(child.wait().unwrap().signal(), Some(libc::SIGTERM));
    // The kernel may end the killed decoder a little later. Left alone, it would live for two minutes.
    let state = || std::fs::read_to_string(format!("/proc/{}/stat", id.trim()));
    let is_gone = |_| {
        std::thread::sleep(Duration::from_millis(10));
        state().map_or(true, |state| state.contains(") Z "))
    };
    assert!((0..3000).any(is_gone), "the decoder lives on");
}
