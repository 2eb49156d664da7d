"""Renders one picture of every scene into a contact sheet with names, and prints a table of the scenes' motion.

    .venv/bin/python -I tests/bench/contact_sheet.py tests/golden/scenes.png

Motion is measured on the ground truth motion maps of the view `between` of the rig linear8, at the instants
`MEASURED_S`. The motion of a pixel is the larger one of its displacements from the previous frame and to the next
frame. The change of motion is measured on the ground truth point tracks in the same view: it is the largest difference
between the displacements of a point in two consecutive frame intervals, if the point is visible in all three frames.
All values are pixels at 640x480.
"""

from __future__ import annotations

import importlib
import importlib.util
import os
import struct
import sys
import tempfile
import zlib
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

ROOT = Path(__file__).resolve().parents[2]
spec = importlib.util.spec_from_file_location(
    "stlfr_capture_script", ROOT / "blender" / "capture.py"
)
assert spec is not None and spec.loader is not None
spec.loader.exec_module(importlib.util.module_from_spec(spec))  # loads stlfr_extension
film = importlib.import_module("stlfr_extension.film")
rigs = importlib.import_module("stlfr_extension.rig")
scenes = importlib.import_module("stlfr_extension.scenes")
tracks = importlib.import_module("stlfr_extension.tracks")

SIZE_PX = (160, 120)
SAMPLES = 96
SHOWN_S = 0.3
MEASURED_S = (0.05, 0.15, 0.25, 0.35)
MOVING_PX = 0.1
TRACKED_FRAMES = 12
STEPS_PER_FRAME = 8
"""Sampled instants per frame interval at which tracks are evaluated. More take longer; with fewer, the change of motion
at a bounce is underestimated."""
POINTS = 800
COLUMNS = 4
LABEL_PX = 20
COLORS = 160

Picture = npt.NDArray[np.uint8]


def main(target: Path) -> None:
    """Render and measure all scenes, write the contact sheet to `target`, and print the table."""
    rig = rigs.resized(rigs.load(ROOT / "rigs" / "linear8.json"), *SIZE_PX)
    tiles, rows = [], []
    with tempfile.TemporaryDirectory() as scratch:
        for name in scenes.names():
            with silence():
                picture, row = look(name, rig, Path(scratch))
            tiles.append(labelled(picture, name))
            rows.append(row)
    empty = np.full_like(tiles[0], 255)
    tiles += [empty] * (-len(tiles) % COLUMNS)
    sheet = np.vstack(
        [np.hstack(tiles[i : i + COLUMNS]) for i in range(0, len(tiles), COLUMNS)]
    )
    target.write_bytes(palette_png(sheet))
    print(
        "| scene | parameters | depth, m | moving | median, px/frame | 90th percentile | max "
        "| change of motion, px |"
    )
    print("|---|---|---|---|---|---|---|---|")
    print("\n".join(rows))
    print(f"{target}: {target.stat().st_size // 1000} kB", file=sys.stderr)


def look(name: str, rig: Any, scratch: Path) -> tuple[Picture, str]:
    """Render a scene: returns its picture, and its row of the table."""
    scene = scenes.open_scene(name, None)
    studio = film.Studio(
        scene, (*rig.cameras, *rig.views), len(os.sched_getaffinity(0))
    )
    depths, motions = [], []
    for time_s in MEASURED_S:
        depth, motion = scratch / "depth.npy", scratch / "motion.npy"
        image = film.Image("between", time_s, 1, 1)
        studio.render_geometry(image, depth, motion, scratch, 30.0)
        depths.append(np.load(depth))
        motions.append(np.load(motion) * 640 / SIZE_PX[0])
    studio.render_image(
        film.Image("between", SHOWN_S, SAMPLES, 1), scratch / "shown.png", scratch
    )
    shown = np.asarray(cv2.imread(str(scratch / "shown.png")), dtype=np.uint8)
    depth, motion = np.array(depths), np.array(motions)
    moving = motion[motion > MOVING_PX]
    median, most_of_it, most = np.percentile(moving, [50, 90, 100])
    change = largest_change_px(studio)
    row = (
        f"| `{name}` | {use_of(name)} | {depth.min():.2f} to {depth.max():.2f} | "
        f"{100 * moving.size / motion.size:.0f} % | "
        f"{median:.1f} | {most_of_it:.1f} | {most:.1f} | {change:.1f} |"
    )
    return shown, row


def use_of(name: str) -> str:
    """Whether parameters are tuned on a scene (`tuned`), or it is held out for evaluation (`judged`), or neither."""
    package = importlib.import_module(scenes.PACKAGE)
    if name in package.TUNED_ON:
        return "tuned"
    return "judged" if name in package.JUDGED_ON else ""


def largest_change_px(studio: Any) -> float:
    """The largest change of a visible point's displacement from one frame interval to the next, pixels at 640x480."""
    step_s = 1 / (30.0 * STEPS_PER_FRAME)
    exposures = [
        tracks.Exposure("between", k, k * step_s, k * step_s)
        for k in range(TRACKED_FRAMES * STEPS_PER_FRAME)
    ]
    arrays = tracks.follow(studio, exposures, POINTS, 1).cameras[0].arrays
    pixels = arrays["pixels"] * 640 / SIZE_PX[0]
    visible = arrays["visible"].astype(bool)
    first, last = slice(None, -2 * STEPS_PER_FRAME), slice(2 * STEPS_PER_FRAME, None)
    middle = slice(STEPS_PER_FRAME, -STEPS_PER_FRAME)
    change = np.linalg.norm(pixels[first] - 2 * pixels[middle] + pixels[last], axis=2)
    seen = visible[first] & visible[middle] & visible[last]
    return float(change[seen].max())


def labelled(picture: Picture, name: str) -> Picture:
    """The picture above its name, on white, with a margin."""
    tile = np.full((picture.shape[0] + LABEL_PX, picture.shape[1], 3), 255, np.uint8)
    tile[: picture.shape[0]] = picture
    tile[:, -2:] = 255
    place, font = (2, tile.shape[0] - 6), cv2.FONT_HERSHEY_SIMPLEX
    cv2.putText(tile, name, place, font, 0.42, (20, 20, 20), 1, cv2.LINE_AA)
    return tile


def palette_png(bgr: Picture) -> bytes:
    """Encode an image (blue first) as a PNG with `COLORS` colours, a third as large as with all colours."""
    height, width = bgr.shape[:2]
    pixels = bgr.reshape(-1, 3).astype(np.float32)
    cv2.setRNGSeed(1)
    criteria = (cv2.TERM_CRITERIA_MAX_ITER, 12, 0.0)
    _, _, centres = cv2.kmeans(
        pixels[::7], COLORS, None, criteria, 1, cv2.KMEANS_PP_CENTERS
    )
    nearest = np.empty(len(pixels), dtype=np.uint8)
    for start in range(0, len(pixels), 8192):
        part = pixels[start : start + 8192, None] - centres
        nearest[start : start + 8192] = np.argmin((part**2).sum(axis=2), axis=1)
    rows = np.zeros(
        (height, width + 1), dtype=np.uint8
    )  # each row starts with filter 0
    rows[:, 1:] = nearest.reshape(height, width)
    palette = np.clip(np.round(centres[:, ::-1]), 0, 255).astype(np.uint8).tobytes()
    header = struct.pack(">IIBBBBB", width, height, 8, 3, 0, 0, 0)
    chunks = (
        (b"IHDR", header),
        (b"PLTE", palette),
        (b"IDAT", zlib.compress(rows.tobytes(), 9)),
        (b"IEND", b""),
    )
    return b"\x89PNG\r\n\x1a\n" + b"".join(
        struct.pack(">I", len(data))
        + kind
        + data
        + struct.pack(">I", zlib.crc32(kind + data))
        for kind, data in chunks
    )


class silence:  # noqa: N801 - used as a statement
    """Context that discards stdout, also that of C code, to suppress Blender's messages."""

    def __enter__(self) -> None:
        sys.stdout.flush()
        self.kept = os.dup(1)
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, 1)
        os.close(nowhere)

    def __exit__(self, *_: object) -> None:
        sys.stdout.flush()
        os.dup2(self.kept, 1)
        os.close(self.kept)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
