"""Conversion between Blender's camera and COLMAP's `PINHOLE`.

Pixels: the top-left pixel's centre is (0.5, 0.5), x points right, y points down.
Camera axes: COLMAP's are +x right, +y down, +z forward; Blender's are +x right, +y up, -z forward.
World: metres, with the same axes in both.

Blender stores lens, sensor, shift and matrices in single precision. So compute a camera's description from the values
that Blender returns, not from those that were assigned; then the description equals what Blender renders.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

COLMAP_FROM_BLENDER_AXES: Array = np.diag([1.0, -1.0, -1.0])


@dataclass(frozen=True)
class BlenderLens:
    """The settings that decide a perspective camera's projection in Blender, besides its pose.

    `width_px` and `height_px` are the size of the rendered image, with the resolution percentage applied.
    """

    width_px: int
    height_px: int
    lens_mm: float
    sensor_width_mm: float = 36.0
    sensor_height_mm: float = 24.0
    sensor_fit: str = "AUTO"
    shift_x: float = 0.0
    shift_y: float = 0.0
    pixel_aspect_x: float = 1.0
    pixel_aspect_y: float = 1.0


@dataclass(frozen=True)
class Pinhole:
    """The parameters of COLMAP's camera model `PINHOLE`, in pixels."""

    width_px: int
    height_px: int
    fx_px: float
    fy_px: float
    cx_px: float
    cy_px: float

    @property
    def params(self) -> list[float]:
        """The parameters in COLMAP's order: fx, fy, cx, cy."""
        return [self.fx_px, self.fy_px, self.cx_px, self.cy_px]

    def rows(self, first: int, end: int) -> Pinhole:
        """The pinhole of the image's rows from `first` to before `end`."""
        return replace(self, height_px=end - first, cy_px=self.cy_px - first)


@dataclass(frozen=True)
class RigidTransform:
    """A rigid transform target_from_source: `target = R(rotation_wxyz) source + translation_m`."""

    rotation_wxyz: tuple[float, float, float, float]
    translation_m: tuple[float, float, float]

    def matrix(self) -> Array:
        """The transform as a 4x4 matrix."""
        matrix = np.eye(4)
        matrix[:3, :3] = rotation_from_quaternion(self.rotation_wxyz)
        matrix[:3, 3] = self.translation_m
        return matrix

    def to_json(self) -> dict[str, list[float]]:
        """The transform as a JSON object of capture.json, with `rotation_wxyz` and `translation`."""
        return {
            "rotation_wxyz": [q + 0.0 for q in self.rotation_wxyz],  # no -0.0
            "translation": [t + 0.0 for t in self.translation_m],
        }


def pinhole_from_lens(lens: BlenderLens) -> Pinhole:
    """The `PINHOLE` camera with the same projection as Blender's lens, sensor, shift and pixel aspect.

    The sensor fit decides which side of the image corresponds to the sensor's size. `HORIZONTAL`: the image's width
    corresponds to `sensor_width`. `VERTICAL`: its height corresponds to `sensor_height`. `AUTO`: its longer side, pixel
    aspect included (the width if equal), corresponds to `sensor_width`, also in portrait format.

    Both shifts are fractions of this side. A positive shift moves the image window right or up over the image plane, so
    the principal point moves left or down. A pixel is `pixel_aspect_x` by `pixel_aspect_y`; only their ratio matters.
    """
    shown_width = lens.width_px * lens.pixel_aspect_x
    shown_height = lens.height_px * lens.pixel_aspect_y
    spans_width = lens.sensor_fit == "HORIZONTAL" or (
        lens.sensor_fit == "AUTO" and shown_width >= shown_height
    )
    sensor_mm = (
        lens.sensor_height_mm if lens.sensor_fit == "VERTICAL" else lens.sensor_width_mm
    )
    side = shown_width if spans_width else shown_height
    return Pinhole(
        width_px=lens.width_px,
        height_px=lens.height_px,
        fx_px=lens.lens_mm / sensor_mm * side / lens.pixel_aspect_x,
        fy_px=lens.lens_mm / sensor_mm * side / lens.pixel_aspect_y,
        cx_px=0.5 * lens.width_px - lens.shift_x * side / lens.pixel_aspect_x,
        cy_px=0.5 * lens.height_px + lens.shift_y * side / lens.pixel_aspect_y,
    )


def lens_from_pinhole(pinhole: Pinhole, sensor_width_mm: float = 36.0) -> BlenderLens:
    """The Blender lens (sensor fit `HORIZONTAL`) with the projection of `pinhole`; the inverse of `pinhole_from_lens`.

    The pixel aspect represents fx/fy. Blender requires both of its parts to be at least 1, hence the two cases.
    """
    aspect_x = max(1.0, pinhole.fy_px / pinhole.fx_px)
    aspect_y = max(1.0, pinhole.fx_px / pinhole.fy_px)
    side = pinhole.width_px * aspect_x
    return BlenderLens(
        width_px=pinhole.width_px,
        height_px=pinhole.height_px,
        lens_mm=pinhole.fx_px * sensor_width_mm / pinhole.width_px,
        sensor_width_mm=sensor_width_mm,
        sensor_fit="HORIZONTAL",
        shift_x=(0.5 * pinhole.width_px - pinhole.cx_px) * aspect_x / side,
        shift_y=(pinhole.cy_px - 0.5 * pinhole.height_px) * aspect_y / side,
        pixel_aspect_x=aspect_x,
        pixel_aspect_y=aspect_y,
    )


def lens_of(camera_object: Any, scene: Any) -> BlenderLens:
    """The lens of a Blender camera object, with the image size and pixel aspect of this scene's render settings."""
    camera, render = camera_object.data, scene.render
    return BlenderLens(
        width_px=render.resolution_x * render.resolution_percentage // 100,
        height_px=render.resolution_y * render.resolution_percentage // 100,
        lens_mm=camera.lens,
        sensor_width_mm=camera.sensor_width,
        sensor_height_mm=camera.sensor_height,
        sensor_fit=camera.sensor_fit,
        shift_x=camera.shift_x,
        shift_y=camera.shift_y,
        pixel_aspect_x=render.pixel_aspect_x,
        pixel_aspect_y=render.pixel_aspect_y,
    )


def cam_from_world_of(camera_object: Any) -> RigidTransform:
    """A Blender camera object's `cam_from_world`, with COLMAP's axes. Like Blender, this ignores the object's scale."""
    return cam_from_world_of_matrix(
        np.array(camera_object.matrix_world, dtype=np.float64)
    )


def cam_from_world_of_matrix(world_from_blender_cam: Array) -> RigidTransform:
    """The transform `cam_from_world` with COLMAP's axes, from a Blender camera's `matrix_world` (4x4)."""
    axes = world_from_blender_cam[:3, :3] / np.linalg.norm(
        world_from_blender_cam[:3, :3], axis=0
    )
    quaternion = quaternion_from_rotation(COLMAP_FROM_BLENDER_AXES @ axes.T)
    translation = -rotation_from_quaternion(quaternion) @ world_from_blender_cam[:3, 3]
    return RigidTransform(
        quaternion,
        (float(translation[0]), float(translation[1]), float(translation[2])),
    )


def blender_matrix(cam_from_world: RigidTransform) -> Array:
    """Blender's `matrix_world` (4x4) of a camera with this `cam_from_world`."""
    matrix: Array = np.linalg.inv(cam_from_world.matrix())
    matrix[:3, :3] = matrix[:3, :3] @ COLMAP_FROM_BLENDER_AXES
    return matrix


def rotation_from_quaternion(rotation_wxyz: tuple[float, float, float, float]) -> Array:
    """The 3x3 rotation of a quaternion, which is normalized first."""
    w, x, y, z = np.array(rotation_wxyz) / math.sqrt(sum(q * q for q in rotation_wxyz))
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def quaternion_from_rotation(rotation: Array) -> tuple[float, float, float, float]:
    """The unit quaternion (w >= 0) closest to a nearly orthonormal 3x3 matrix (Bar-Itzhack 2000)."""
    r = rotation
    symmetric = np.array(
        [
            [r[0, 0] - r[1, 1] - r[2, 2], 0, 0, 0],
            [r[1, 0] + r[0, 1], r[1, 1] - r[0, 0] - r[2, 2], 0, 0],
            [r[2, 0] + r[0, 2], r[2, 1] + r[1, 2], r[2, 2] - r[0, 0] - r[1, 1], 0],
            [r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1], np.trace(r)],
        ]
    )
    _, vectors = np.linalg.eigh(symmetric / 3.0)  # reads the lower triangle
    x, y, z, w = vectors[:, -1]
    sign = -1.0 if w < 0 else 1.0
    return (float(sign * w), float(sign * x), float(sign * y), float(sign * z))


def project(
    pinhole: Pinhole, cam_from_world: RigidTransform, points_world_m: Array
) -> Array:
    """Pixel coordinates (N, 2) of world points (N, 3); NaN for points not in front of the camera."""
    matrix = cam_from_world.matrix()
    x, y, z = (points_world_m @ matrix[:3, :3].T + matrix[:3, 3]).T
    with np.errstate(divide="ignore", invalid="ignore"):
        pixels: Array = np.stack(
            [
                pinhole.fx_px * x / z + pinhole.cx_px,
                pinhole.fy_px * y / z + pinhole.cy_px,
            ],
            axis=1,
        )
    pixels[~(z > 0)] = np.nan
    return pixels
