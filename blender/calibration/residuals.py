"""Residuals: the difference between each camera's pose in the capture and its pose by structure from motion."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .capture import Array, EstimatedPose, Pose

ROTATION_TOLERANCE_DEG = 0.05
POSITION_TOLERANCE_MM = 1.0
"""A camera is reported if its residual exceeds `ROTATION_TOLERANCE_DEG` or `POSITION_TOLERANCE_MM`. On ground truth
images of the scene `magazine` at 320x240, residuals of correct cameras were at most 0.014 deg and 0.4 mm. If larger, a
camera that is rotated by 0.2 deg or moved by 2 mm may pass; if smaller, correct cameras fail on poorer images."""

STANDARD_ERRORS = 5.0
"""A camera is reported only if its residual also exceeds this many standard errors, because small or noisy images place
cameras less precisely. If larger, wrong cameras pass on such images; if smaller, correct cameras are reported."""

MIN_POINTS = 200
"""A camera that sees fewer points has no verdict, because standard errors from few points are too small. In 48
recordings with correct calibrations, the wrongly reported cameras saw 35 to 179 points. If larger, small images get no
verdict; if smaller, correct cameras are reported."""


@dataclass(frozen=True)
class Residual:
    """The difference between a camera's pose in the capture and its reconstructed pose.

    The standard errors are those of the reconstructed pose. `points` is the number of points that the camera sees.
    """

    id: str
    rotation_deg: float
    position_mm: float
    rotation_std_err_deg: float
    position_std_err_mm: float
    points: int

    @property
    def rotation_limit_deg(self) -> float:
        """The largest acceptable rotation residual: the tolerance, or `STANDARD_ERRORS` standard errors if larger."""
        return max(ROTATION_TOLERANCE_DEG, STANDARD_ERRORS * self.rotation_std_err_deg)

    @property
    def position_limit_mm(self) -> float:
        """The largest acceptable position residual: the tolerance, or `STANDARD_ERRORS` standard errors if larger."""
        return max(POSITION_TOLERANCE_MM, STANDARD_ERRORS * self.position_std_err_mm)

    @property
    def is_told(self) -> bool:
        """Whether the camera sees at least `MIN_POINTS` points, so that its residual is reliable."""
        return self.points >= MIN_POINTS

    @property
    def is_off(self) -> bool:
        """Whether the residual is reliable, and its rotation or its position exceeds the limit."""
        return self.is_told and (
            self.rotation_deg > self.rotation_limit_deg
            or self.position_mm > self.position_limit_mm
        )


@dataclass(frozen=True)
class Similarity:
    """A similarity from a reconstruction's world to another world: `x -> scale * rotation @ x + shift_m`."""

    rotation: Array
    scale: float
    shift_m: Array

    def pose(self, pose: Pose) -> Pose:
        """A pose of the reconstruction's world, transformed into the other world."""
        rotation = pose.rotation @ self.rotation.T
        centre_m = self.scale * self.rotation @ pose.centre_m + self.shift_m
        return Pose(rotation, -rotation @ centre_m)


def alignment(exported: dict[str, Pose], estimated: dict[str, Pose]) -> Similarity:
    """The similarity that best aligns the estimated poses with the exported poses.

    If the cameras stand in a line, their positions leave the rotation about this line undetermined. So the rotation is
    computed from the cameras' rotations, and scale and translation from their positions. The fit minimizes the sum of
    distances, not of their squares, so that one wrong camera has little influence.
    """
    ids = [camera_id for camera_id in exported if camera_id in estimated]
    relative = [exported[i].rotation.T @ estimated[i].rotation for i in ids]
    rotation = robust_mean_rotation(relative)
    turned = np.array([rotation @ estimated[i].centre_m for i in ids])
    centres = np.array([exported[i].centre_m for i in ids])
    weights = np.ones(len(ids))
    scale, shift_m = 1.0, np.zeros(3)
    for _ in range(100):
        weights /= weights.sum()
        mean_turned, mean_centre = weights @ turned, weights @ centres
        spread = weights @ np.sum((turned - mean_turned) ** 2, axis=1)
        agreement = weights @ np.sum(
            (turned - mean_turned) * (centres - mean_centre), axis=1
        )
        scale = float(agreement / spread) if spread > 0 else 1.0
        shift_m = mean_centre - scale * mean_turned
        distances_m = np.linalg.norm(scale * turned + shift_m - centres, axis=1)
        weights = 1.0 / np.maximum(distances_m, 1e-5)
    return Similarity(rotation, scale, shift_m)


def residuals(
    exported: dict[str, Pose], estimated: dict[str, EstimatedPose]
) -> list[Residual]:
    """Each camera's residual after the similarity that aligns the estimated poses with the exported poses.

    Cameras that are missing in either argument have none.
    """
    similarity = alignment(exported, dict(estimated))
    found = []
    for camera_id, pose in estimated.items():
        if camera_id not in exported:
            continue
        aligned, right = similarity.pose(pose), exported[camera_id]
        found.append(
            Residual(
                camera_id,
                angle_deg(right.rotation.T @ aligned.rotation),
                1000.0 * float(np.linalg.norm(aligned.centre_m - right.centre_m)),
                pose.rotation_std_err_deg,
                1000.0 * similarity.scale * pose.centre_std_err,
                pose.points,
            )
        )
    return sorted(found, key=lambda r: list(exported).index(r.id))


def robust_mean_rotation(rotations: list[Array]) -> Array:
    """The rotation that minimizes the sum of (unsquared) Frobenius distances to the given rotations."""
    weights = np.ones(len(rotations))
    mean = rotations[0]
    for _ in range(100):
        u, _singular, vt = np.linalg.svd(
            np.tensordot(weights, np.array(rotations), axes=1)
        )
        mean = u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt
        distances = np.array([np.linalg.norm(mean - r) for r in rotations])
        weights = 1.0 / np.maximum(distances, 1e-6)
    return mean


def angle_deg(rotation: Array) -> float:
    """The angle of a rotation matrix, degrees; also accurate for tiny angles."""
    return float(
        np.degrees(
            2 * np.arcsin(min(1.0, np.linalg.norm(rotation - np.eye(3)) / np.sqrt(8)))
        )
    )
