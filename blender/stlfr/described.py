"""A camera as capture.json and view files spell it: made from Blender's, and projected by. No `bpy` here."""

from __future__ import annotations

from typing import Any

import numpy as np

from . import camera as cameras
from . import distortion as distortions
from .camera import Array, Pinhole, RigidTransform
from .distortion import Distortion

Camera = dict[str, Any]
"""`width`, `height`, `model` (`PINHOLE` or `OPENCV`), `params`, `cam_from_world`."""


def describe(
    pinhole: Pinhole,
    cam_from_world: RigidTransform,
    distortion: Distortion | None = None,
) -> Camera:
    """A camera without distortion is a `PINHOLE`."""
    model, more = "PINHOLE", []
    if distortion is not None and not distortion.is_none:
        model = "OPENCV"
        more = [distortion.k1, distortion.k2, distortion.p1, distortion.p2]
    return {
        "width": pinhole.width_px,
        "height": pinhole.height_px,
        "model": model,
        "params": [*pinhole.params, *more],
        "cam_from_world": cam_from_world.to_json(),
    }


def describe_object(camera_object: Any, scene: Any) -> Camera:
    """A Blender camera object as this scene would render it."""
    pinhole = cameras.pinhole_from_lens(cameras.lens_of(camera_object, scene))
    return describe(pinhole, cameras.cam_from_world_of(camera_object))


def lens_of(camera: Camera) -> tuple[Pinhole, Distortion]:
    """Intrinsics."""
    params = camera["params"]
    pinhole = Pinhole(camera["width"], camera["height"], *params[:4])
    return pinhole, Distortion(*params[4:])


def pose_of(camera: Camera) -> RigidTransform:
    """`cam_from_world`."""
    pose = camera["cam_from_world"]
    return RigidTransform(tuple(pose["rotation_wxyz"]), tuple(pose["translation"]))


def centre_of(camera: Camera) -> Array:
    """The camera's centre in the world, metres."""
    matrix = pose_of(camera).matrix()
    return np.asarray(-matrix[:3, :3].T @ matrix[:3, 3])


def project(camera: Camera, points_m: Array) -> Array:
    """Pixels (N, 2) of world points (N, 3); NaN behind the camera and past its lens's fold."""
    pinhole, distortion = lens_of(camera)
    ideal = cameras.project(pinhole, pose_of(camera), points_m)
    return distortions.pixels_from_ideal(pinhole, distortion, ideal)


def direction_of(camera: Camera, pixel: tuple[float, float]) -> Array:
    """The viewing direction of a pixel in the world, with length 1 along the camera's +z; NaN without an inverse."""
    pinhole, distortion = lens_of(camera)
    ((x, y),) = distortions.ideal_from_pixels(pinhole, distortion, np.array([pixel]))
    ray = [
        (x - pinhole.cx_px) / pinhole.fx_px,
        (y - pinhole.cy_px) / pinhole.fy_px,
        1.0,
    ]
    return np.asarray(pose_of(camera).matrix()[:3, :3].T @ ray)
