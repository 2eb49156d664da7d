"""One image per camera for the check of a calibration, with a mask of static pixels.

Unsynchronized cameras have no images of a common instant. If a simulator filmed the capture and wrote ground truth, the
images are the ground truth of all cameras at one instant. Otherwise, each camera's image is its frame nearest to the
middle of the capture, by the camera's own clock. Pixels that differ between the frames before and after this frame are
masked, because they may show moving objects. RANSAC must reject moving objects that the mask misses.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from .capture import Array, Camera, CheckError, read_json

MOVING_LEVELS = 10.0
"""A pixel counts as moving if the mean difference of two frames over a window of `MOVING_WINDOW_PX` is larger; grey
levels of 255. If larger, slow motion is missed; if smaller, noise masks static pixels."""

MOVING_WINDOW_PX = 5
"""Side of the square window over which differences of frames are averaged. If larger, small moving objects are missed;
if smaller, noise masks static pixels."""

MOVING_MARGIN_PX = 15
"""Half-width of the square around moving pixels in which features are ignored; a SIFT descriptor covers pixels up to
about this distance. If larger, few features remain; if smaller, descriptors depend on moving objects."""


@dataclass(frozen=True)
class Picture:
    """One camera's image, 8-bit (H, W, channels), and the mask `still` of its static pixels; None if all are static."""

    pixels: npt.NDArray[np.uint8]
    still: npt.NDArray[np.bool_] | None = None


def pictures_of_one_instant(
    folder: Path, capture: Any, cameras: list[Camera], pycolmap: Any
) -> tuple[dict[str, Picture], str]:
    """One image per camera, by id, and a description of their source and time. `capture` is a `stlfr.Capture`.

    The images are ground truth if `folder` has it for all cameras, otherwise frames with masks of static pixels.
    """
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
    """The ground truth image files of all cameras at the first instant that has them, by camera id, and the instant.

    None if the capture has no ground truth, or none with all cameras at one instant.
    """
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
    """The camera's frame nearest to an instant, with a mask of pixels that are alike in the frames before and after.

    At the first frame, the mask compares this frame and the next; at the last frame, the previous frame and this one.
    There is no mask if the camera has a single frame.
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
    """Mask (H, W) of pixels that are more than `MOVING_MARGIN_PX` away from pixels where the two images differ."""
    grey = [image.astype(np.float64).mean(axis=2) for image in (before, after)]
    moving = box_mean(np.abs(grey[1] - grey[0]), MOVING_WINDOW_PX) > MOVING_LEVELS
    still: npt.NDArray[np.bool_] = (
        box_mean(moving.astype(np.float64), 2 * MOVING_MARGIN_PX + 1) < 1e-9
    )
    return still


def eight_bit(
    pixels: npt.NDArray[np.uint8] | npt.NDArray[np.uint16],
) -> npt.NDArray[np.uint8]:
    """An image with 8 or 16 bits per value, converted to 8 bits."""
    if pixels.dtype == np.uint8:
        return pixels.astype(np.uint8)
    return (pixels.astype(np.float64) / 257.0 + 0.5).astype(np.uint8)


def read_image(path: Path, pycolmap: Any) -> npt.NDArray[np.uint8]:
    """An image file as 8-bit RGB (H, W, 3). Raises `CheckError` if it can't be read."""
    # pycolmap would wait forever for data from a pipe.
    bitmap = pycolmap.Bitmap.read(path, as_rgb=True) if path.is_file() else None
    if bitmap is None:
        raise CheckError(f"{path}: can't be read as an image", 2)
    return np.asarray(bitmap.to_array(), dtype=np.uint8)


def box_mean(image: Array, window_px: int) -> Array:
    """The mean of an image (H, W) over a square window of odd size around each pixel; borders are replicated."""
    half = window_px // 2
    for axis in (0, 1):
        padding = [(half + 1, half) if a == axis else (0, 0) for a in (0, 1)]
        sums = np.cumsum(np.pad(image, padding, mode="edge"), axis=axis)
        image = (
            np.take(sums, range(window_px, sums.shape[axis]), axis)
            - np.take(sums, range(sums.shape[axis] - window_px), axis)
        ) / window_px
    return image
