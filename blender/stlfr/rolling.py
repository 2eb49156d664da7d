"""Rolling shutters: when each row of a frame is exposed, and the bands of rows that are rendered at once. No `bpy` here.

Rows are exposed one after the other, from the first to the last, at a constant rate. A frame's time is
that of its middle. A band of rows is rendered as of one instant, its middle row's.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from .camera import Array

MAX_STEP_PX = 0.1
"""How far the body of `SPEED` is from its place at most, because a band is rendered as of one instant. Larger, and bodies
are cut into visible steps; smaller, and filming takes longer in proportion."""
SPEED = 0.625
"""A fast body's speed in widths of the image a second: 13 pixels a frame at 640 pixels and 30 Hz."""

NODE_S = 0.004
"""The longest time between the instants of a readout between which points' paths are taken as straight. Larger, and
fast turns are cut off: at 10 px/frame² and 30 Hz by 0.02 px; smaller, and tracks take longer in proportion."""


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


def nodes_s(readout_s: float) -> Array:
    """Instants, relative to the frame's time, between which points move on straight lines during a readout."""
    count = math.ceil(readout_s / NODE_S)
    return np.linspace(-readout_s / 2, readout_s / 2, count + 1)


@dataclass(frozen=True)
class Exposed:
    """When points were exposed: between two of the instants `nodes_s`. Arrays are over points."""

    node: np.ndarray[tuple[int], np.dtype[np.int64]]
    """The earlier of the two instants."""
    fraction: Array
    """Of the way to the later one."""

    def between(self, values: Array) -> Array:
        """Values (nodes, points, n) at the points' own times."""
        points = np.arange(len(self.node))
        before = values[self.node, points]
        if len(values) == 1:
            return before
        return before + self.fraction[:, None] * (
            values[self.node + 1, points] - before
        )

    @property
    def nearest(self) -> np.ndarray[tuple[int], np.dtype[np.int64]]:
        """The instant nearest to each point's time."""
        return self.node + (self.fraction > 0.5)


def exposed(y_px: Array, height_px: int, readout_s: float) -> Exposed:
    """When a rolling shutter exposes moving points: where their rows' times are the instants'.

    `y_px` (nodes, points) is where they are at the instants `nodes_s`. Points above or below the image are taken as of
    its first or last row's time.
    """
    offsets_s = nodes_s(readout_s)
    if len(offsets_s) == 1:
        return Exposed(np.zeros(y_px.shape[1], dtype=np.int64), np.zeros(y_px.shape[1]))
    rows_s = row_offsets_s(y_px, height_px, readout_s)
    ahead_s = offsets_s[:, None] - np.clip(rows_s, offsets_s[0], offsets_s[-1])
    node = np.argmax(ahead_s[1:] >= 0.0, axis=0)
    points = np.arange(y_px.shape[1])
    before, after = ahead_s[node, points], ahead_s[node + 1, points]
    with np.errstate(divide="ignore", invalid="ignore"):
        fraction = np.clip(before / (before - after), 0.0, 1.0)
    return Exposed(node, np.where(np.isfinite(fraction), fraction, 0.0))
