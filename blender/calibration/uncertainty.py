"""Standard errors of reconstructed camera poses and lenses.

They follow from the covariance of bundle adjustment with all points eliminated (Triggs et al., Bundle Adjustment: A
Modern Synthesis, 2000, sections 6 and 9), scaled by the remaining reprojection errors. Images don't determine the
world's origin, orientation and scale. So these seven gauge freedoms are removed from the covariance, as `residuals`
removes them by an alignment. A camera has six pose parameters: a rotation about the world's axes (radians), then a
translation of its centre, in the reconstruction's unit of length. If lenses are estimated too, these parameters follow:
the logarithm of the focal lengths, the principal point (pixels) and the distortion coefficients.

Errors that many points share, such as those of a wrong lens or of slanted textures, are not included.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from .capture import Array
from .linear import FREEDOMS, Linearization, cross, linearized, worst


@dataclass(frozen=True)
class StandardErrors:
    """Standard errors of a reconstructed camera's pose and lens.

    `rotation_deg` and `centre` are those along the axis with the largest error. `centre` is in the reconstruction's
    unit of length.
    """

    rotation_deg: float
    centre: float
    points: int
    """Number of points that the camera sees."""
    error_px: float
    """Root mean square of the camera's reprojection errors."""
    focal_fraction: float
    """Standard error of the focal length, as a fraction of it; 0 if the focal length was fixed."""


GROUPS = {
    "focal": "focal",
    "centre": "principal_point",
    "distortion": "distortion",
}
"""The names in capture.json of the groups of lens parameters."""


@dataclass(frozen=True)
class JointCovariance:
    """The joint covariance of all cameras' pose and lens parameters, without the seven gauge freedoms."""

    names: list[str]
    """The image names, one per camera, in the order of the matrix's rows."""
    refined: tuple[str, ...]
    """The groups of lens parameters that follow each camera's six pose parameters, in the matrix's order."""
    matrix: Array

    def entry(self, names: list[str], rotation: Array, scale: float) -> dict[str, Any]:
        """The covariance in the form of capture.json: the lower triangle, for the given images in this order.

        `rotation` and `scale` transform it into another world.
        """
        size = len(self.matrix) // len(self.names)
        order = [self.names.index(name) for name in names]
        rows = (np.array(order)[:, None] * size + np.arange(size)).ravel()
        own = np.eye(size)
        own[:3, :3], own[3:6, 3:6] = rotation, scale * rotation
        into = np.kron(np.eye(len(names)), own)
        matrix = into @ self.matrix[np.ix_(rows, rows)] @ into.T
        return {
            "lens": [GROUPS[group] for group in self.refined],
            "rows": [
                [float(f"{value:.7g}") for value in row[: k + 1]]
                for k, row in enumerate(0.5 * (matrix + matrix.T))
            ],
        }


def standard_errors(model: Any) -> dict[str, StandardErrors]:
    """Standard errors of each image's pose, by image name, for pycolmap's reconstruction `model` with fixed lenses.

    Empty if there are too few points to determine the poses.
    """
    linear = linearized(model, ())
    if linear.redundancy <= 0:
        return {}
    variance_px2 = float(np.sum(linear.errors_px**2)) / linear.redundancy
    return errors_of(linear, variance_px2 * inverse(linear, linear.reduced()[0]))


def errors_of(linear: Linearization, covariance: Array) -> dict[str, StandardErrors]:
    """Standard errors by image name, from the joint covariance of all cameras' parameters.

    Those of poses are relative to the mean rotation, position and scale of all cameras.
    """
    count, size = len(linear.images), linear.size
    poses = (np.arange(count)[:, None] * size + np.arange(6)).ravel()
    aligned = _aligning(linear.centres)
    pose_covariance = aligned @ covariance[np.ix_(poses, poses)] @ aligned.T
    found = {}
    for number, image in enumerate(linear.images):
        turn, move = (slice(6 * number + k, 6 * number + k + 3) for k in (0, 3))
        focal = size * number + 6
        focal_variance = covariance[focal, focal] if "focal" in linear.refined else 0.0
        errors = linear.errors_px[linear.camera == number]
        found[image.name] = StandardErrors(
            float(np.degrees(worst(pose_covariance[turn, turn]))),
            worst(pose_covariance[move, move]),
            len(errors),
            float(np.sqrt(np.sum(errors**2) / max(1, len(errors)))),
            float(np.sqrt(max(0.0, focal_variance))),
        )
    return found


def inverse(linear: Linearization, information: Array) -> Array:
    """The inverse of the cameras' information matrix without the seven gauge freedoms, which is their covariance.

    To be comparable with radians, lengths are divided by the median distance of the points.
    """
    own = np.ones(linear.size)
    own[3:6] = linear.span
    units = np.tile(own, len(linear.images))
    values, vectors = np.linalg.eigh(information * np.outer(units, units))
    values[:FREEDOMS] = np.inf
    return np.asarray((vectors / values) @ vectors.T * np.outer(units, units))


def _aligning(centres: Array) -> Array:
    """The projection matrix that removes the mean rotation, translation and scale from changes of all cameras' poses.

    `centres` (N, 3) are the cameras' centres; the matrix is (6 N, 6 N).
    """
    count, around = len(centres), centres - centres.mean(axis=0)
    mean_turn = np.tile(np.hstack([np.eye(3), np.zeros((3, 3))]), count) / count
    unturned = np.eye(6 * count)
    shifts = np.zeros((6 * count, 4))
    for k, product in enumerate(cross(around)):
        turn, move = slice(6 * k, 6 * k + 3), slice(6 * k + 3, 6 * k + 6)
        unturned[turn] -= mean_turn
        unturned[move] += product @ mean_turn
        shifts[move, :3], shifts[move, 3] = np.eye(3), around[k]
    return np.asarray((np.eye(6 * count) - shifts @ np.linalg.pinv(shifts)) @ unturned)
