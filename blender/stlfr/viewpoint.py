"""The viewport's viewpoint as a camera, and where its picture lies in the region. No `bpy` here.

Blender's matrices: the view matrix takes the world to the viewer's axes (+x right, +y up, -z forward), the
window matrix takes those to clip coordinates. Regions count pixels from the bottom left.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from . import camera as cameras
from .camera import Array, Pinhole
from .described import Camera, describe
from .errors import BadInputError

MIN_SIDE_PX = 8
"""The smallest side of a picture. Smaller, and it shows nothing; larger, and thin regions are stretched."""

MAX_OVERSAMPLING = 2.0
"""How much larger than its place in the viewport a camera's picture is rendered, before it is scaled down. Larger, and
a small viewport waits for pixels that nobody sees; at 1, it never shows the very picture that F12 makes."""


@dataclass(frozen=True)
class Rect:
    """A rectangle of a region, pixels from the bottom left."""

    x: float
    y: float
    width: float
    height: float

    def part(self, border: tuple[float, float, float, float]) -> Rect:
        """The part within a border: left, right, bottom, top, as fractions."""
        left, right, bottom, top = border
        return Rect(
            self.x + left * self.width,
            self.y + bottom * self.height,
            (right - left) * self.width,
            (top - bottom) * self.height,
        )

    def snapped(self, width_px: int, height_px: int) -> Rect:
        """Moved by less than a pixel to show a picture of nearly its size pixel by pixel, else as it is."""
        if max(abs(self.width - width_px), abs(self.height - height_px)) >= 1.0:
            return self
        return Rect(round(self.x), round(self.y), width_px, height_px)


def camera_of_view(
    view_matrix: Array, window_matrix: Array, size_px: tuple[int, int]
) -> Camera:
    """The pinhole camera that sees what a perspective view shows."""
    if abs(window_matrix[3, 3]) > 1e-6 or window_matrix[3, 2] == 0.0:
        raise BadInputError(
            "the light field has no orthographic views: press Numpad 5 for a perspective one"
        )
    width, height = size_px
    pinhole = Pinhole(
        width_px=width,
        height_px=height,
        fx_px=0.5 * width * float(window_matrix[0, 0]),
        fy_px=0.5 * height * float(window_matrix[1, 1]),
        cx_px=0.5 * width * (1.0 - float(window_matrix[0, 2])),
        cy_px=0.5 * height * (1.0 + float(window_matrix[1, 2])),
    )
    world_from_view = np.linalg.inv(view_matrix)
    return describe(pinhole, cameras.cam_from_world_of_matrix(world_from_view))


def frame_rect(perspective: Array, corners_m: Array, size_px: tuple[int, int]) -> Rect:
    """Where the corners (N, 3) of a camera's frame lie in a region whose `perspective_matrix` is given."""
    homogeneous = np.c_[corners_m, np.ones(len(corners_m))] @ perspective.T
    clip = homogeneous[:, :2] / homogeneous[:, 3:]
    pixels = 0.5 * (clip + 1.0) * np.array(size_px)
    (left, bottom), (right, top) = pixels.min(axis=0), pixels.max(axis=0)
    return Rect(float(left), float(bottom), float(right - left), float(top - bottom))


def factor_for(camera: Camera, place: Rect) -> float:
    """By how much a camera's picture is scaled for its place: 1, unless that is far smaller."""
    oversampling = camera["width"] / max(1.0, place.width)
    return 1.0 if oversampling <= MAX_OVERSAMPLING else 1.0 / oversampling


def scaled(camera: Camera, factor: float) -> Camera:
    """The same view in a picture of another size."""
    if factor == 1.0:
        return camera
    width, height = (
        max(MIN_SIDE_PX, math.floor(camera[side] * factor + 0.5))
        for side in ("width", "height")
    )
    x, y = width / camera["width"], height / camera["height"]
    fx, fy, cx, cy = camera["params"]
    result: dict[str, Any] = dict(camera)
    result["width"], result["height"] = width, height
    result["params"] = [fx * x, fy * y, cx * x, cy * y]
    return result
