"""Residuals: each camera's exported pose against its reconstruction from images."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .capture import Array, EstimatedPose, Pose

ROTATION_TOLERANCE_DEG = 0.05
POSITION_TOLERANCE_MM = 1.0
"""A camera further off than either is named. Over three instants of `magazine` at 320x240, truth images,
right cameras came out within 0.014 deg and 0.4 mm; a camera turned by 0.2 deg or moved by 2 mm must
stand out from that. Larger, and such a camera passes; smaller, and right ones fail on poorer images."""

STANDARD_ERRORS = 5.0
"""Nor is a camera named that is off by fewer standard errors than these: small, noisy or distant images
place it no better. Larger, and wrong ones pass there; smaller, and right ones are accused."""

MIN_POINTS = 200
"""A camera that sees fewer points tells nothing: standard errors of so few are too small. Over 48 recordings of
right cameras, those named had 35 to 179. Larger, and small images tell nothing; smaller, and right ones are accused."""


@dataclass(frozen=True)
class Residual:
    """Difference between a camera's exported and reconstructed pose, with standard errors of the latter."""

    id: str
    rotation_deg: float
    position_mm: float
    rotation_std_err_deg: float
    position_std_err_mm: float
    points: int

    @property
    def rotation_limit_deg(self) -> float:
        """The tolerance, or more where the standard error is large."""
        return max(ROTATION_TOLERANCE_DEG, STANDARD_ERRORS * self.rotation_std_err_deg)

    @property
    def position_limit_mm(self) -> float:
        """The tolerance, or more where the standard error is large."""
        return max(POSITION_TOLERANCE_MM, STANDARD_ERRORS * self.position_std_err_mm)

    @property
    def is_told(self) -> bool:
        """Whether the camera sees enough points."""
        return self.points >= MIN_POINTS

    @property
    def is_off(self) -> bool:
        """Whether the difference exceeds the tolerance and the standard errors, and is told."""
        return self.is_told and (
            self.rotation_deg > self.rotation_limit_deg
            or self.position_mm > self.position_limit_mm
        )


@dataclass(frozen=True)
class Similarity:
    """Brings a reconstruction's world onto the capture's."""

    rotation: Array
    scale: float
    shift_m: Array

    def pose(self, pose: Pose) -> Pose:
        """A reconstructed pose in the capture's world."""
        rotation = pose.rotation @ self.rotation.T
        centre_m = self.scale * self.rotation @ pose.centre_m + self.shift_m
        return Pose(rotation, -rotation @ centre_m)


def alignment(exported: dict[str, Pose], estimated: dict[str, Pose]) -> Similarity:
    """The similarity that brings the estimate onto the exported poses.

    Positions alone don't fix a similarity for a rig in a line (it may turn about the line), so the
    rotation comes from the cameras' rotations, scale and translation from their positions. The fit
    minimizes distances, not their squares, so that one displaced camera doesn't drag the others.
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
    """Each camera's residual after the similarity that brings the estimate onto the exported poses."""
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
    """The rotation with the least sum of distances (not squared) to the given ones."""
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
    """The angle of a rotation; accurate for tiny angles."""
    return float(
        np.degrees(
            2 * np.arcsin(min(1.0, np.linalg.norm(rotation - np.eye(3)) / np.sqrt(8)))
        )
    )
