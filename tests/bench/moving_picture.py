"""Renders README's animation: slow motion from a moving viewpoint, with one method in each half of the picture.

    .venv/bin/python -I tests/bench/moving_picture.py CAPTURE tests/golden/moving.webp [VIEWS]

In the left half, each camera shows its nearest frame, as in traditional light field rendering. The right half is
space-time light field rendering. All else is equal. While time advances through the recording, the viewpoint moves
along the array, and slightly towards the scene and back. VIEWS (36 by default) views are rendered for each half. The
animation plays them forwards and backwards, and repeats. It needs `stlfr setup`, and a capture whose cameras are
`PINHOLE` and equally oriented.
"""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import cv2
import imageio_ffmpeg
import numpy as np
import numpy.typing as npt
import stlfr

HALVES = (
    ("Traditional light field rendering", "nearest"),
    ("stlfr: space-time light field rendering", "refined"),
)
RATE_HZ = 18
"""Frame rate of the animation. If lower, motion is jerky; if higher, the file is larger."""
QUALITY = 57
"""Quality of the WebP encoder, 0 to 100. If lower, text is blurred; if higher, the file is larger."""
VIEW_PX = (416, 312)
"""Size of a view: the central part of the cameras' images, at the same scale."""
REACH = 0.5
"""Fraction of the array's width over which the viewpoint moves. If larger, objects leave the picture, and above 1,
views lack pixels at their borders. If smaller, the viewpoint hardly moves."""
FORWARD = 0.15
"""How far the viewpoint moves towards the scene, as a fraction of the array's width. If larger, images are enlarged and
thus blurred; if 0, the viewpoint moves along a straight line."""
MARGIN_S = 0.002
"""Minimum time between a view and both ends of the recording. If smaller, an error of an offset may place a view
outside of a camera's frames; then this camera doesn't contribute to the view."""
BAR_PX = 26
FONT, FONT_SCALE = cv2.FONT_HERSHEY_SIMPLEX, 0.5

Picture = npt.NDArray[np.uint8]


def main() -> None:
    """Render both halves of the animation, and encode it."""
    folder, target = Path(sys.argv[1]), Path(sys.argv[2])
    views = int(sys.argv[3]) if len(sys.argv) > 3 else 36
    capture = stlfr.open(folder)
    # Sinusoidal easing, so that the motion reverses smoothly at both ends of the loop.
    places = (1 - np.cos(np.linspace(0, np.pi, views))) / 2
    start_s, end_s = span(capture)
    filmed = json.loads((folder / "capture.json").read_text())["cameras"]
    cameras = [view(filmed, place) for place in places]
    halves = []
    for label, sync in HALVES:
        pictures = [
            labelled(
                capture.render(
                    start_s + place * (end_s - start_s),
                    camera=camera,
                    options={"sync": sync},
                ),
                label,
            )
            for place, camera in zip(places, cameras, strict=True)
        ]
        halves.append(pictures)
    gap = np.full((halves[0][0].shape[0], 4, 3), 255, np.uint8)
    pairs = [np.hstack([a, gap, b]) for a, b in zip(*halves, strict=True)]
    encode(pairs + pairs[-2:0:-1], target)
    print(f"{target}: {target.stat().st_size / 1e6:.2f} MB, {len(pairs)} views")
    slower = (2 * views - 2) / 2 / RATE_HZ / (end_s - start_s)
    print(f"{start_s:.3f} s to {end_s:.3f} s, {slower:.0f} times slower")


def span(capture: Any) -> tuple[float, float]:
    """The time span in which all cameras have frames, seconds on the reference camera's clock."""
    starts, ends = [], []
    for offset in capture.offsets()["cameras"]:
        if offset["offset_s"] is None:
            continue  # a camera with an unknown offset contributes to no view
        times = capture.times(offset["id"]) + offset["offset_s"]
        starts.append(times[0])
        ends.append(times[-1])
    return max(starts) + MARGIN_S, min(ends) - MARGIN_S


def view(cameras: list[dict[str, Any]], place: float) -> dict[str, Any]:
    """The camera object of the view at `place`, from 0 (near the first camera) to 1 (near the last camera).

    Its orientation is that of the first camera.
    """
    poses = [camera["cam_from_world"] for camera in cameras]
    rotation = rotation_of(poses[0]["rotation_wxyz"])
    first, last = (
        -rotation_of(pose["rotation_wxyz"]).T @ np.array(pose["translation"])
        for pose in (poses[0], poses[-1])
    )
    along = last - first
    centre = (first + last) / 2 + REACH * (place - 0.5) * along
    centre += FORWARD * np.sin(np.pi * place) * np.linalg.norm(along) * rotation[2]
    fx, fy, cx, cy = cameras[0]["params"]  # of PINHOLE
    width, height = VIEW_PX
    cx -= (cameras[0]["width"] - width) / 2
    cy -= (cameras[0]["height"] - height) / 2
    return {
        "width": width,
        "height": height,
        "model": "PINHOLE",
        "params": [fx, fy, cx, cy],
        "cam_from_world": {
            "rotation_wxyz": poses[0]["rotation_wxyz"],
            "translation": list(-rotation @ centre),
        },
    }


def rotation_of(wxyz: list[float]) -> npt.NDArray[np.float64]:
    """The rotation matrix of a quaternion."""
    w, *xyz = np.array(wxyz) / np.linalg.norm(wxyz)
    x, y, z = xyz
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + 2 * w * cross + 2 * cross @ cross


def labelled(picture: Any, label: str) -> Picture:
    """The picture in 8 bits without alpha, below a bar with its label."""
    if picture.dtype == np.uint16:
        picture = (picture // 257).astype(np.uint8)
    bar = np.full((BAR_PX, picture.shape[1], 3), 24, np.uint8)
    cv2.putText(
        bar, label, (8, BAR_PX - 8), FONT, FONT_SCALE, (255, 255, 255), 1, cv2.LINE_AA
    )
    return np.vstack([bar, picture[..., :3]])


def encode(pictures: list[Picture], target: Path) -> None:
    """Encode the pictures as an animated WebP file that repeats forever."""
    height, width = pictures[0].shape[:2]
    command = [imageio_ffmpeg.get_ffmpeg_exe(), "-loglevel", "error", "-y"]
    command += ["-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{width}x{height}"]
    command += ["-r", str(RATE_HZ), "-i", "-", "-c:v", "libwebp_anim", "-loop", "0"]
    command += ["-quality", str(QUALITY), "-compression_level", "6", str(target)]
    frames = b"".join(picture.tobytes() for picture in pictures)
    subprocess.run(command, input=frames, check=True)


if __name__ == "__main__":
    main()
