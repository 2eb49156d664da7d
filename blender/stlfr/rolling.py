"""Rolling shutters: when each row of a frame is exposed, and the bands of rows that are rendered at once. No `bpy` here.

Rows are exposed one after the other, from the first to the last, at a constant rate. A frame's time is
that of its middle. A band of rows is rendered as of one instant, its middle row's.
"""

from __future__ import annotations

from dataclasses import dataclass

from .camera import Array

MAX_STEP_PX = 0.1
"""How far the body of `SPEED` is from its place at most, because a band is rendered as of one instant. Larger, and bodies
are cut into visible steps; smaller, and filming takes longer in proportion."""
SPEED = 0.625
"""A fast body's speed in widths of the image a second: 13 pixels a frame at 640 pixels and 30 Hz."""


@dataclass(frozen=True)
class Band:
    """Rows from `first` to before `end`, and their time relative to the frame's."""

    first: int
    end: int
    offset_s: float


def row_offsets_s(y_px: Array, height_px: int, readout_s: float) -> Array:
    """The times of vertical positions relative to their frame's; the first row's centre is at 0.5."""
    return (y_px - height_px / 2) * (readout_s / max(1, height_px - 1))


def bands(size_px: tuple[int, int], readout_s: float) -> list[Band]:
    """The bands of a frame, from the top; one for a global shutter."""
    width_px, height_px = size_px
    row_s = readout_s / max(1, height_px - 1)
    band_s = 2 * MAX_STEP_PX / (SPEED * width_px)
    rows = height_px if row_s == 0.0 else min(height_px, max(1, int(band_s / row_s)))
    return [
        Band(first, end, (first + end - height_px) / 2 * row_s)
        for first in range(0, height_px, rows)
        for end in (min(first + rows, height_px),)
    ]
