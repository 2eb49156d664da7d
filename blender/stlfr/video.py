"""Replaces the images of a camera's frames by one lossless video, FFV1 in Matroska. Does not import `bpy`."""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path
from typing import TYPE_CHECKING

from .errors import FailureError
from .plan import frame_file

if TYPE_CHECKING:
    from .plan import Job
    from .rig import RigCamera


def video_file(camera_id: str) -> str:
    """The path of a camera's video, relative to the capture's folder."""
    return f"{camera_id}.mkv"


def frames_of(camera_id: str, capture: Path) -> str:
    """The field `frames` of a camera in capture.json: the video's path if it exists, else a pattern of image paths."""
    if (capture / video_file(camera_id)).is_file():
        return video_file(camera_id)
    return f"{camera_id}/%04d.png"


def holds(job: Job, capture: Path) -> bool:
    """Whether a job's image is a frame of its camera's video, which exists under its name only when it is complete."""
    in_camera = job.files[0].split("/")[0] == job.view_id
    return in_camera and (capture / video_file(job.view_id)).is_file()


def is_packed(camera: RigCamera, capture: Path) -> bool:
    """Whether the camera's images have been replaced by a video: the video exists, and the images are deleted."""
    is_there = (capture / video_file(camera.id)).is_file()
    return is_there and not (capture / camera.id).exists()


def pack(camera: RigCamera, capture: Path, scratch: Path) -> None:
    """Replace a camera's images, all of which must exist, by a video.

    The video is written in the folder `scratch`, and decoded to check that its pixels equal those of the images. Only
    then it is renamed to its final path, and the images are deleted.
    """
    ffmpeg = find_ffmpeg()
    target, images = capture / video_file(camera.id), capture / camera.id
    if not target.is_file():
        partial = scratch / target.name
        pattern = Path(frame_file(camera.id, 0)).with_name("%04d.png")
        rate = ["-framerate", repr(camera.rate_hz)]
        source = ["-f", "image2", *rate, "-start_number", "0", "-i", str(pattern)]
        codec = ["-c:v", "ffv1", "-level", "3", "-g", "1", "-slicecrc", "1"]
        exact = ["-fflags", "+bitexact", "-flags:v", "+bitexact", "-threads", "1"]
        output = ["-f", "matroska", f"file:{partial}"]
        _run([ffmpeg, *source, *codec, *exact, *output], capture)
        pixels = "gray" if camera.color == "gray" else "rgb24"
        compared = [
            _run([ffmpeg, *given, "-pix_fmt", pixels, "-f", "hash", "-"], capture)
            for given in (source, ["-i", f"file:{partial}"])
        ]
        if compared[0] != compared[1]:
            raise FailureError(f"{target}: the video has other pixels than {images}")
        with partial.open("r+b") as stream:
            os.fsync(stream.fileno())
        partial.replace(target)
    shutil.rmtree(images, ignore_errors=True)


def find_ffmpeg() -> str:
    """The path of ffmpeg: the system's, or else that of the package `imageio_ffmpeg`.

    Raises `FailureError` if there is none.
    """
    system = shutil.which("ffmpeg")
    if system is not None:
        return system
    try:
        import imageio_ffmpeg
    except ImportError:
        raise FailureError(
            "--video needs ffmpeg: install it, or run stlfr setup"
        ) from None
    return str(imageio_ffmpeg.get_ffmpeg_exe())


def _run(command: list[str], folder: Path) -> str:
    head, *rest = command
    quiet = ["-hide_banner", "-loglevel", "error", "-nostdin", "-y"]
    done = subprocess.run(
        [head, *quiet, *rest], cwd=folder, capture_output=True, text=True, check=False
    )
    if done.returncode != 0:
        said = done.stderr.strip().splitlines()
        raise FailureError(
            f"ffmpeg could not make a video: {said[0] if said else 'it was stopped'}"
        )
    return done.stdout
