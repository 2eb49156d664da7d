"""Reads cameras and poses from `capture.json`, and from the COLMAP model in the folder `colmap` beside it."""

from __future__ import annotations

import importlib
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

reading: Any = importlib.import_module("stlfr_extension.reading")

Array = npt.NDArray[np.float64]

Camera = dict[str, Any]
"""A camera object as in capture.json, with the fields `width`, `height`, `model`, `params` and `cam_from_world`."""


class CheckError(Exception):
    """An error that ends the command: one sentence for the user, and the exit code."""

    def __init__(self, message: str, exit_code: int) -> None:
        super().__init__(message)
        self.exit_code = exit_code


@dataclass(frozen=True)
class Pose:
    """A camera's pose as the transform from world to camera: `rotation` (3, 3) first, then `translation_m`."""

    rotation: Array
    translation_m: Array

    @property
    def centre_m(self) -> Array:
        """The camera's centre in world coordinates, metres."""
        centre: Array = -self.rotation.T @ self.translation_m
        return centre


@dataclass(frozen=True)
class EstimatedPose(Pose):
    """A pose estimated by structure from motion, in the reconstruction's world and unit of length.

    Standard errors are those along the axis where they are largest.
    """

    rotation_std_err_deg: float = 0.0
    centre_std_err: float = 0.0
    """Standard error of the camera's centre, in the reconstruction's unit of length."""
    points: int = 0
    """Number of the reconstruction's points that the camera sees."""


def read_json(path: Path) -> dict[str, Any]:
    """Read a JSON file that holds an object. Raises `CheckError` if it can't be read or holds no object."""
    try:
        content = json.loads(reading.read_text(path))
    except FileNotFoundError:
        raise CheckError(f"{path}: no such file", 2) from None
    except (OSError, ValueError) as error:
        raise CheckError(f"{path}: can't be read ({error})", 2) from None
    if not isinstance(content, dict):
        raise CheckError(f"{path}: must hold a JSON object", 2)
    return content


def pose_of(camera: Camera, pycolmap: Any) -> Pose:
    """The pose of a camera object of capture.json."""
    w, x, y, z = camera["cam_from_world"]["rotation_wxyz"]
    quaternion = np.array([x, y, z, w]) / np.linalg.norm([w, x, y, z])
    rotation = pycolmap.Rotation3d(quaternion).matrix()
    return Pose(
        rotation, np.array(camera["cam_from_world"]["translation"], dtype=np.float64)
    )


def lens_of(camera: Camera, pycolmap: Any) -> Any:
    """The intrinsics of a camera object of capture.json, as a `pycolmap.Camera`."""
    return pycolmap.Camera(
        model=camera["model"],
        width=camera["width"],
        height=camera["height"],
        params=camera["params"],
    )


def view_of(camera: Camera) -> Camera:
    """A camera object with only the fields that `stlfr.project` takes: size, lens and pose, but no frames."""
    fields = ("width", "height", "model", "params", "cam_from_world")
    return {name: camera[name] for name in fields}


def exported_model(
    folder: Path, cameras: list[Camera], pycolmap: Any
) -> dict[str, tuple[Any, Pose]] | None:
    """Each camera's intrinsics and pose by its id, which pycolmap reads from `folder`/colmap; None without that folder.

    Raises `CheckError` if pycolmap can't read the model, or if one of `cameras` isn't in it.
    """
    if not (folder / "colmap").is_dir():
        return None
    for file in sorted((folder / "colmap").iterdir()):
        # pycolmap would wait forever for data from a pipe.
        if not file.is_file():
            raise CheckError(f"{file}: is no regular file", 2)
    try:
        model = pycolmap.Reconstruction(folder / "colmap")
    except (ValueError, RuntimeError) as error:
        raise CheckError(
            f"{folder / 'colmap'}: pycolmap can't read it ({error})", 2
        ) from None
    found = {}
    for image in model.images.values():
        matrix = image.cam_from_world().matrix()
        found[image.name.split("/")[0]] = (
            model.cameras[image.camera_id],
            Pose(matrix[:, :3], matrix[:, 3]),
        )
    for camera in cameras:
        if camera["id"] not in found:
            raise CheckError(f"{folder / 'colmap'}: has no image of {camera['id']}", 2)
    return found
