"""A viewport's viewpoint as a camera object, and the place of its picture in the viewport's region.

Blender's view matrix transforms world coordinates to view coordinates (+x right, +y up, -z forward), and its window
matrix transforms view coordinates to clip coordinates. Pixels of a region are counted from the bottom left. Does not
import `bpy`.
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
"""Minimum width and height of a picture. If smaller, it shows nothing; if larger, pictures of thin regions are
stretched."""

MAX_OVERSAMPLING = 2.0
"""Maximum ratio of the width of a camera's picture to its width in the viewport; above, it is rendered smaller. If
larger, a small viewport waits for invisible pixels; at 1, a viewport never shows exactly the picture that F12
renders."""


@dataclass(frozen=True)
class Rect:
    """A rectangle in a viewport's region, in pixels from the bottom left."""

    x: float
    y: float
    width: float
    height: float

    def part(self, border: tuple[float, float, float, float]) -> Rect:
        """The part of the rectangle within a border, which is given as fractions: left, right, bottom, top."""
        left, right, bottom, top = border
        return Rect(
            self.x + left * self.width,
            self.y + bottom * self.height,
            (right - left) * self.width,
            (top - bottom) * self.height,
        )

    def snapped(self, width_px: int, height_px: int) -> Rect:
        """The rectangle aligned to whole pixels with the size of the picture, so that pixels are shown one to one.

        If its size differs from the picture's by a pixel or more, it is returned unchanged.
        """
        if max(abs(self.width - width_px), abs(self.height - height_px)) >= 1.0:
            return self
        return Rect(round(self.x), round(self.y), width_px, height_px)


def camera_of_view(
    view_matrix: Array, window_matrix: Array, size_px: tuple[int, int]
) -> Camera:
    """The pinhole camera with the same image as a perspective viewport of this size (width, height).

    Raises `BadInputError` if the view is orthographic.
    """
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
    """The bounding rectangle of a camera's frame in a region with this `perspective_matrix` and size in pixels.

    `corners_m` (N, 3) are the frame's corners in world coordinates.
    """
    homogeneous = np.c_[corners_m, np.ones(len(corners_m))] @ perspective.T
    clip = homogeneous[:, :2] / homogeneous[:, 3:]
    pixels = 0.5 * (clip + 1.0) * np.array(size_px)
    (left, bottom), (right, top) = pixels.min(axis=0), pixels.max(axis=0)
    return Rect(float(left), float(bottom), float(right - left), float(top - bottom))


def factor_for(camera: Camera, place: Rect) -> float:
    """The factor on the size of a camera's picture for display in `place`.

    It is 1, unless the picture is more than `MAX_OVERSAMPLING` times wider than `place`; then it makes the widths
    equal.
    """
    oversampling = camera["width"] / max(1.0, place.width)
    return 1.0 if oversampling <= MAX_OVERSAMPLING else 1.0 / oversampling


def scaled(camera: Camera, factor: float) -> Camera:
    """The same view as a camera object with its image size multiplied by `factor`, at least `MIN_SIDE_PX`."""
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
