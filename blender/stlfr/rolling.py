"""Rolling shutters: when each row of a frame is exposed, and which rows are rendered together. Does not import `bpy`.

Rows are exposed one after the other, from the first to the last, at a constant rate. The time of a frame is that of its
middle row. The rows of a frame are rendered in bands; all rows of a band show the instant of the band's middle.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from .camera import Array

MAX_STEP_PX = 0.1
"""Maximum displacement of a body with the speed `SPEED` because all rows of a band show one instant. If larger,
outlines of bodies have visible steps; if smaller, filming takes proportionally longer."""
SPEED = 0.625
"""The speed of a fast body in image widths per second: 13 pixels per frame at a width of 640 pixels and 30 Hz."""

NODE_S = 0.004
"""Maximum time between two nodes (sampled instants) of a readout; points are assumed to move straight between nodes. If
larger, curved paths are cut short: with this value, by 0.02 px for an acceleration of 10 px/frame² at 30 Hz. If
smaller, tracks take proportionally longer."""


@dataclass(frozen=True)
class Band:
    """A band of rows, from `first` up to but excluding `end`. `offset_s` is its time relative to the frame's time."""

    first: int
    end: int
    offset_s: float


def row_offsets_s(y_px: Array, height_px: int, readout_s: float) -> Array:
    """The exposure times of vertical image positions, relative to the frame's time; the first row's centre is 0.5."""
    return (y_px - height_px / 2) * (readout_s / max(1, height_px - 1))


def bands(size_px: tuple[int, int], readout_s: float) -> list[Band]:
    """The bands of a frame, from the top. `size_px` is (width, height). With a global shutter, there is one band."""
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
    """The nodes of a readout: instants relative to the frame's time, between which points are assumed to move straight.

    The first and last node are the first and last row's times. Without a readout time, there is one node, 0.
    """
    count = math.ceil(readout_s / NODE_S)
    return np.linspace(-readout_s / 2, readout_s / 2, count + 1)


@dataclass(frozen=True)
class Exposed:
    """The instants at which a rolling shutter exposes points, given between two of the nodes `nodes_s`.

    Arrays have one entry per point.
    """

    node: np.ndarray[tuple[int], np.dtype[np.int64]]
    """Index of the earlier of the two nodes around the point's exposure."""
    fraction: Array
    """Position of the exposure between the earlier node (0) and the later node (1)."""

    def between(self, values: Array) -> Array:
        """Interpolates values (nodes, points, n) linearly to each point's exposure; the result is (points, n)."""
        points = np.arange(len(self.node))
        before = values[self.node, points]
        if len(values) == 1:
            return before
        return before + self.fraction[:, None] * (
            values[self.node + 1, points] - before
        )

    @property
    def nearest(self) -> np.ndarray[tuple[int], np.dtype[np.int64]]:
        """Index of the node nearest to each point's exposure."""
        return self.node + (self.fraction > 0.5)


def exposed(y_px: Array, height_px: int, readout_s: float) -> Exposed:
    """When a rolling shutter exposes moving points: at the instant when a point lies in the row that is then exposed.

    `y_px` (nodes, points) are the points' vertical positions at the nodes `nodes_s`. Points above or below the image
    are exposed with its first or last row.
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
