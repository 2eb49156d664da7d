"""Camera objects as in capture.json and in view files: made from Blender's cameras, and their projection.

Does not import `bpy`.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from . import camera as cameras
from . import distortion as distortions
from .camera import Array, Pinhole, RigidTransform
from .distortion import Distortion

Camera = dict[str, Any]
"""A camera object: `width`, `height`, `model` (`PINHOLE` or `OPENCV`), `params` and `cam_from_world`."""


def describe(
    pinhole: Pinhole,
    cam_from_world: RigidTransform,
    distortion: Distortion | None = None,
) -> Camera:
    """The camera object with these intrinsics, pose and distortion: `OPENCV`, or `PINHOLE` without distortion."""
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
    """The camera object of a Blender camera, with the image size of this scene's render settings."""
    pinhole = cameras.pinhole_from_lens(cameras.lens_of(camera_object, scene))
    return describe(pinhole, cameras.cam_from_world_of(camera_object))


def lens_of(camera: Camera) -> tuple[Pinhole, Distortion]:
    """The intrinsics of a camera object: pinhole parameters and distortion."""
    params = camera["params"]
    pinhole = Pinhole(camera["width"], camera["height"], *params[:4])
    return pinhole, Distortion(*params[4:])


def pose_of(camera: Camera) -> RigidTransform:
    """The pose of a camera object, as the transform `cam_from_world`."""
    pose = camera["cam_from_world"]
    return RigidTransform(tuple(pose["rotation_wxyz"]), tuple(pose["translation"]))


def centre_of(camera: Camera) -> Array:
    """The centre of a camera object in world coordinates, metres."""
    matrix = pose_of(camera).matrix()
    return np.asarray(-matrix[:3, :3].T @ matrix[:3, 3])


def project(camera: Camera, points_m: Array) -> Array:
    """Pixels (N, 2) of world points (N, 3); NaN behind the camera, and where the distortion model folds back."""
    pinhole, distortion = lens_of(camera)
    ideal = cameras.project(pinhole, pose_of(camera), points_m)
    return distortions.pixels_from_ideal(pinhole, distortion, ideal)


def direction_of(camera: Camera, pixel: tuple[float, float]) -> Array:
    """The viewing direction of a pixel in world coordinates, scaled to length 1 along the camera's +z axis.

    NaN if the distortion has no inverse at this pixel.
    """
    pinhole, distortion = lens_of(camera)
    ((x, y),) = distortions.ideal_from_pixels(pinhole, distortion, np.array([pixel]))
    ray = [
        (x - pinhole.cx_px) / pinhole.fx_px,
        (y - pinhole.cy_px) / pinhole.fy_px,
        1.0,
    ]
    return np.asarray(pose_of(camera).matrix()[:3, :3].T @ ray)
