"""What stands still in each camera's recording: the median of its frames.

It needs no synchronization: what stands still is the same at any time. What moves away from a place for most of
the recording is gone from the median there. Where many frames differ from the median, something covered the
place for long, and the place is masked.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from .capture import Array
from .frames import MOVING_LEVELS, MOVING_WINDOW_PX, Picture, box_mean, eight_bit

MAX_FRAMES = 15
"""Frames of a camera that its median is of, evenly spaced. Larger, and long films take longer; smaller, and more noise is
left, and of what stops for a while."""

MAX_MOVING_FRACTION = 0.25
"""A place is masked where a larger fraction of the frames differs from the median. Larger, and the median of a body that
moves slowly passes as still; smaller, and the background behind moving bodies is lost."""

MARGIN_PX = 4
"""How far around masked pixels features are ignored. Larger, and few features are left; smaller, and features stand on
the outlines of what moves."""


def background(capture: Any, camera_id: str) -> Picture:
    """The median of a camera's frames, and where it is of one still surface. `capture` is the `stlfr` module's."""
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
