"""Standard errors of reconstructed camera poses.

The covariance of bundle adjustment with all points eliminated (Triggs et al., Bundle Adjustment: A
Modern Synthesis, 2000, sections 6 and 9), from the reprojection errors that are left. Images say nothing
about where the world's origin is, how it is turned and how large its unit is; so these seven freedoms are
taken out, as `residuals` does when it aligns. A camera changes by six numbers: a turn about the world's
axes (radians), then a move of its centre. Lengths are in the mapping's own unit. Where lenses were estimated too, a
camera has more numbers: the logarithm of its focal lengths, then its principal point (pixels) and its distortion.

Errors that points share (a texture seen at a slant, a wrong lens) aren't in it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from .capture import Array
from .linear import FREEDOMS, Linearization, cross, linearized, worst


@dataclass(frozen=True)
class StandardErrors:
    """Of a reconstructed camera: of its pose along the worst axis, and of its lens."""

    rotation_deg: float
    centre: float
    points: int
    """Points that the camera sees."""
    error_px: float
    """Root mean square of its reprojection errors."""
    focal_fraction: float
    """Of its focal length, as a fraction of it; 0 where it is taken as known."""


GROUPS = {
    "focal": "focal",
    "centre": "principal_point",
    "distortion": "distortion",
}
"""What capture.json calls the groups of lens parameters."""


@dataclass(frozen=True)
class JointCovariance:
    """Of all cameras' numbers together, without the seven gauge freedoms."""

    names: list[str]
    """The images, in the order of the matrix."""
    refined: tuple[str, ...]
    """The groups of lens parameters after each pose, in their order."""
    matrix: Array

    def entry(self, names: list[str], rotation: Array, scale: float) -> dict[str, Any]:
        """As capture.json has it: for these images in this order, in a world that is turned and scaled."""
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
    """For each image of pycolmap's `model`, by name. Empty if there are too few points to tell."""
    linear = linearized(model, ())
    if linear.redundancy <= 0:
        return {}
    variance_px2 = float(np.sum(linear.errors_px**2)) / linear.redundancy
    return errors_of(linear, variance_px2 * inverse(linear, linear.reduced()[0]))


def errors_of(linear: Linearization, covariance: Array) -> dict[str, StandardErrors]:
    """By image name, from the covariance of all cameras' numbers."""
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
    """The inverse without the seven gauge freedoms. Lengths are made comparable with radians by the scene's span."""
    own = np.ones(linear.size)
    own[3:6] = linear.span
    units = np.tile(own, len(linear.images))
    values, vectors = np.linalg.eigh(information * np.outer(units, units))
    values[:FREEDOMS] = np.inf
    return np.asarray((vectors / values) @ vectors.T * np.outer(units, units))


def _aligning(centres: Array) -> Array:
    """The projection that removes mean rotation, translation and scale from pose changes."""
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
