"""The static background of each camera's recording: the median of its frames.

The median needs no synchronization, because static surfaces look the same at any time. A moving object vanishes from
the median of a pixel that it covers in less than half of the frames. A pixel is masked if many frames differ from the
median, because an object then covered the background for long.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from .capture import Array
from .frames import MOVING_LEVELS, MOVING_WINDOW_PX, Picture, box_mean, eight_bit

MAX_FRAMES = 15
"""Maximum number of frames in a camera's median, evenly spaced in time. If larger, the median takes longer; if smaller,
it has more noise, and shows more of the objects that stop for a while."""

MAX_MOVING_FRACTION = 0.25
"""A pixel is masked if a larger fraction of the frames differs from the median. If larger, slowly moving bodies pass
for static; if smaller, the background behind moving bodies is masked too."""

MARGIN_PX = 4
"""Half-width of the square around masked pixels in which features are ignored. If larger, few features remain; if
smaller, features lie on the outlines of moving bodies."""


def background(capture: Any, camera_id: str) -> Picture:
    """The median of a camera's frames, with a mask of static pixels. `capture` is a `stlfr.Capture`.

    If the camera has fewer than three frames, the first frame without a mask.
    """
    count = len(capture.times(camera_id))
    indices = np.unique(
        np.linspace(0, count - 1, min(count, MAX_FRAMES)).round().astype(int)
    )
    frames = np.array([eight_bit(capture.frame(camera_id, int(k))) for k in indices])
    if len(frames) < 3:
        return Picture(frames[0])
    ordered = np.sort(frames, axis=0)  # numpy's median takes eight bytes a value
    low, high = (len(frames) - 1) // 2, len(frames) // 2
    median = 0.5 * (ordered[low].astype(np.float64) + ordered[high])
    moving = np.zeros(median.shape[:2])
    for frame in frames:
        difference = np.abs(frame - median).mean(axis=2)
        moving += box_mean(difference, MOVING_WINDOW_PX) > MOVING_LEVELS
    covered: Array = (moving > MAX_MOVING_FRACTION * len(frames)).astype(np.float64)
    still = box_mean(covered, 2 * MARGIN_PX + 1) < 1e-9
    return Picture((median + 0.5).astype(np.uint8), still)
