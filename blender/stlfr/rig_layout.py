"""A new rig: cameras in a line or a grid, facing the same way, each with a delay of its own. No `bpy` here."""

from __future__ import annotations

import random
from dataclasses import dataclass
from typing import Any

import numpy as np

from .rig import FORMAT, VERSION

Content = dict[str, Any]
"""What a rig file holds."""


@dataclass(frozen=True)
class Layout:
    """A rig's plan. Lengths in metres, between neighbours."""

    name: str
    columns: int
    rows: int
    spacing_m: float
    width_px: int
    height_px: int
    lens_mm: float
    sensor_width_mm: float
    rate_hz: float
    jitter_s: float
    seed: int
    """Decides the delays, evenly distributed over a frame, and later the jitter."""


def content(layout: Layout) -> Content:
    """The rig file: `cam0` top left, row by row; the middle camera is the reference; one view from the centre."""
    generator = random.Random(f"{layout.seed}/delays")
    count = layout.columns * layout.rows
    picture = {
        "width": layout.width_px,
        "height": layout.height_px,
        "lens_mm": layout.lens_mm,
        "sensor_width_mm": layout.sensor_width_mm,
    }
    cameras = [
        {
            "id": f"cam{index}",
            **picture,
            "cam_from_rig": _facing_ahead(
                *_place_m(layout, index % layout.columns, index // layout.columns)
            ),
            "rate_hz": layout.rate_hz,
            "delay_s": round(generator.random() / layout.rate_hz, 6),
            "jitter_s": layout.jitter_s,
        }
        for index in range(count)
    ]
    return {
        "format": FORMAT,
        "version": VERSION,
        "name": layout.name,
        "reference": f"cam{(count - 1) // 2}",
        "seed": layout.seed,
        "cameras": cameras,
        "views": [
            {"id": "between", **picture, "cam_from_rig": _facing_ahead(0.0, 0.0)}
        ],
    }


def shortest(value: float) -> float:
    """The shortest of the numbers that Blender, in single precision, holds as the same: what was typed."""
    return float(str(np.float32(value)))


def _place_m(layout: Layout, column: int, row: int) -> tuple[float, float]:
    """Right and down of the rig's centre."""
    return (
        (column - (layout.columns - 1) / 2) * layout.spacing_m,
        (row - (layout.rows - 1) / 2) * layout.spacing_m,
    )


def _facing_ahead(right_m: float, down_m: float) -> Content:
    # No -0.0, no 0.15000000000000002.
    translation = [round(-right_m, 9) + 0.0, round(-down_m, 9) + 0.0, 0.0]
    return {"rotation_wxyz": [1, 0, 0, 0], "translation": translation}
