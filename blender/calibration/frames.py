"""The images of one instant, one a camera, and what may have moved in them.

Cameras that aren't synchronized have no images of one instant. Where a simulator left its truth, the
check takes that: all cameras at one instant. Else it takes the frame of each camera that is nearest to
the middle of the capture, by the cameras' own clocks, and masks what moved between the frames before
and after it: what stands still is the same at any time. What the mask misses is left to RANSAC.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from .capture import Array, Camera, CheckError, read_json

MOVING_LEVELS = 10.0
"""A pixel counts as moving where the frames before and after differ by this much (of 255), averaged over
`MOVING_WINDOW_PX`. Larger, and slow things stay in; smaller, and noise takes out what stands still."""

MOVING_WINDOW_PX = 5
"""Side of the window that differences are averaged over. Larger, and what is small moves unnoticed; smaller, and noise
takes out what stands still."""

MOVING_MARGIN_PX = 15
"""How far around moving pixels features are ignored: they look that far. Larger, and few features are left to place
cameras by; smaller, and features depend on what moves."""


@dataclass(frozen=True)
class Picture:
    """One camera's image, 8-bit (H, W, channels), and its mask of static pixels (None: all)."""

    pixels: npt.NDArray[np.uint8]
    still: npt.NDArray[np.bool_] | None = None


def pictures_of_one_instant(
    folder: Path, capture: Any, cameras: list[Camera], pycolmap: Any
) -> tuple[dict[str, Picture], str]:
    """One image per camera, by id, and where they come from. `capture` is the `stlfr` module's."""
    ids = [camera["id"] for camera in cameras]
    found = truth_images(folder, ids)
    if found is not None:
        paths, time_s = found
        pictures = {i: Picture(read_image(path, pycolmap)) for i, path in paths.items()}
        return pictures, f"truth at {time_s:.4f} s"
    times_s = {i: capture.times(i) for i in ids}
    middle_s = float(np.median([0.5 * (t[0] + t[-1]) for t in times_s.values()]))
    pictures = {i: picture_at(capture, i, times_s[i], middle_s) for i in ids}
    if any(picture.still is not None for picture in pictures.values()):
        return pictures, f"frames nearest to {middle_s:.4f} s, what moves masked"
    return pictures, f"frames nearest to {middle_s:.4f} s"


def truth_images(folder: Path, ids: list[str]) -> tuple[dict[str, Path], float] | None:
    """The files of the first instant that the truth shows from all cameras, and the instant."""
    if not (folder / "truth" / "truth.json").is_file():
        return None
    truth = read_json(folder / "truth" / "truth.json")
    instants: dict[float, dict[str, Path]] = {}
    for view in truth["views"]:
        if view["like"] is not None:
            path = folder / "truth" / view["image"]
            instants.setdefault(view["time_s"], {})[view["like"]] = path
    for time_s, paths in sorted(instants.items()):
        if all(camera_id in paths for camera_id in ids):
            return {i: paths[i] for i in ids}, time_s
    return None


def picture_at(capture: Any, camera_id: str, times_s: Array, time_s: float) -> Picture:
    """The frame nearest to an instant, and what stood still around it.

    The first and the last frame have no neighbour on one side; the other one's is used alone.
    """
    nearest = int(np.argmin(np.abs(times_s - time_s)))
    before, after = max(nearest - 1, 0), min(nearest + 1, len(times_s) - 1)
    pixels = eight_bit(capture.frame(camera_id, nearest))
    if before == after:
        return Picture(pixels)
    frames = [eight_bit(capture.frame(camera_id, k)) for k in (before, after)]
    return Picture(pixels, standing_still(*frames))


def standing_still(
    before: npt.NDArray[np.uint8], after: npt.NDArray[np.uint8]
) -> npt.NDArray[np.bool_]:
    """Mask (H, W) of pixels far enough from every difference between two images."""
    grey = [image.astype(np.float64).mean(axis=2) for image in (before, after)]
    moving = box_mean(np.abs(grey[1] - grey[0]), MOVING_WINDOW_PX) > MOVING_LEVELS
    still: npt.NDArray[np.bool_] = (
        box_mean(moving.astype(np.float64), 2 * MOVING_MARGIN_PX + 1) < 1e-9
    )
    return still


def eight_bit(
    pixels: npt.NDArray[np.uint8] | npt.NDArray[np.uint16],
) -> npt.NDArray[np.uint8]:
    """The same image in 8 bits, as SIFT sees it."""
    if pixels.dtype == np.uint8:
        return pixels.astype(np.uint8)
    return (pixels.astype(np.float64) / 257.0 + 0.5).astype(np.uint8)


def read_image(path: Path, pycolmap: Any) -> npt.NDArray[np.uint8]:
    """An image file as 8-bit RGB."""
    # At a pipe, pycolmap would wait.
    bitmap = pycolmap.Bitmap.read(path, as_rgb=True) if path.is_file() else None
    if bitmap is None:
        raise CheckError(f"{path}: can't be read as an image", 2)
    return np.asarray(bitmap.to_array(), dtype=np.uint8)


def box_mean(image: Array, window_px: int) -> Array:
    """The mean over a square window (odd size) around every pixel; borders are replicated."""
    half = window_px // 2
    for axis in (0, 1):
        padding = [(half + 1, half) if a == axis else (0, 0) for a in (0, 1)]
        sums = np.cumsum(np.pad(image, padding, mode="edge"), axis=axis)
        image = (
            np.take(sums, range(window_px, sums.shape[axis]), axis)
            - np.take(sums, range(sums.shape[axis] - window_px), axis)
        ) / window_px
    return image
