"""Standard errors of reconstructed camera poses.

The covariance of bundle adjustment with all points eliminated (Triggs et al., Bundle Adjustment: A
Modern Synthesis, 2000, sections 6 and 9), from the reprojection errors that are left. Images say nothing
about where the world's origin is, how it is turned and how large its unit is; so these seven freedoms are
taken out, as `residuals` does when it aligns. A camera changes by six numbers: a turn about the world's
axes (radians), then a move of its centre. Lengths are in the mapping's own unit.

Errors that points share (a texture seen at a slant, a wrong lens) aren't in it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from .capture import Array

FREEDOMS = 7
"""Of a similarity: turn, move, scale."""

STEP = 1e-6
"""Of a central difference, as a fraction of a point's depth. Larger, and the projection's curvature enters the
derivative; smaller, and rounding does."""


@dataclass(frozen=True)
class Sight:
    """A point seen in an image: how its pixel changes with the camera (2x6) and with the point (2x3)."""

    camera: int
    by_camera: Array
    by_point: Array


def standard_errors(model: Any) -> dict[str, tuple[float, float, int]]:
    """For each image of pycolmap's `model`, by name: of its rotation, in degrees, and of its centre; and its points.

    Both along their worst axis. Empty if there are too few points to tell.
    """
    images = [image for image in model.images.values() if image.has_pose]
    sights: dict[int, list[Sight]] = {}
    errors_px: list[Array] = []
    for number, image in enumerate(images):
        errors_px.append(_look(model, image, number, sights))
    total_px2 = sum(float(np.sum(errors**2)) for errors in errors_px)
    known = 2 * sum(len(errors) for errors in errors_px)
    redundancy = known - 3 * len(sights) - 6 * len(images) + FREEDOMS
    if redundancy <= 0:
        return {}
    centres = np.array([image.projection_center() for image in images])
    covariance = (total_px2 / redundancy) * _inverse(
        _information(sights, len(images)), _span(model, centres)
    )
    aligned = _aligning(centres)
    covariance = aligned @ covariance @ aligned.T
    found = {}
    for number, image in enumerate(images):
        turn, move = (slice(6 * number + k, 6 * number + k + 3) for k in (0, 3))
        rotation_deg = np.degrees(_worst(covariance[turn, turn]))
        centre = _worst(covariance[move, move])
        found[image.name] = float(rotation_deg), centre, len(errors_px[number])
    return found


def _look(model: Any, image: Any, number: int, sights: dict[int, list[Sight]]) -> Array:
    """Adds an image's sights to those of each point; gives the reprojection errors (N, 2), pixels."""
    seen = [p for p in image.points2D if p.has_point3D()]
    if not seen:
        return np.zeros((0, 2))
    lens, matrix = model.cameras[image.camera_id], image.cam_from_world().matrix()
    rotation = matrix[:, :3]
    ways = np.array([model.points3D[p.point3D_id].xyz for p in seen])
    ways = ways + rotation.T @ matrix[:, 3]
    places = ways @ rotation.T
    by_place = np.empty((len(seen), 2, 3))
    for axis in range(3):
        step = np.zeros_like(places)
        step[:, axis] = STEP * places[:, 2]
        change = lens.img_from_cam(places + step) - lens.img_from_cam(places - step)
        by_place[:, :, axis] = change / (2 * step[:, axis, None])
    by_point = by_place @ rotation
    by_camera = np.concatenate([by_point @ _cross(ways), -by_point], axis=2)
    for p, camera, point in zip(seen, by_camera, by_point, strict=True):
        sights.setdefault(p.point3D_id, []).append(Sight(number, camera, point))
    return np.asarray(lens.img_from_cam(places) - np.array([p.xy for p in seen]))


def _information(sights: dict[int, list[Sight]], count: int) -> Array:
    """The information on camera poses with all points eliminated: the Schur complement."""
    information = np.zeros((6 * count, 6 * count))
    for seen in sights.values():
        points = np.linalg.inv(sum(s.by_point.T @ s.by_point for s in seen))
        mixed = np.zeros((6 * count, 3))
        for s in seen:
            own = slice(6 * s.camera, 6 * s.camera + 6)
            information[own, own] += s.by_camera.T @ s.by_camera
            mixed[own] += s.by_camera.T @ s.by_point
        information -= mixed @ points @ mixed.T
    return information


def _inverse(information: Array, span: float) -> Array:
    """The inverse without the seven gauge freedoms. Lengths are made comparable with radians by the scene's `span`."""
    units = np.tile([1.0, 1.0, 1.0, span, span, span], len(information) // 6)
    values, vectors = np.linalg.eigh(information * np.outer(units, units))
    values[:FREEDOMS] = np.inf
    return np.asarray((vectors / values) @ vectors.T * np.outer(units, units))


def _aligning(centres: Array) -> Array:
    """The projection that removes mean rotation, translation and scale from pose changes."""
    count, around = len(centres), centres - centres.mean(axis=0)
    mean_turn = np.tile(np.hstack([np.eye(3), np.zeros((3, 3))]), count) / count
    unturned = np.eye(6 * count)
    shifts = np.zeros((6 * count, 4))
    for k, cross in enumerate(_cross(around)):
        turn, move = slice(6 * k, 6 * k + 3), slice(6 * k + 3, 6 * k + 6)
        unturned[turn] -= mean_turn
        unturned[move] += cross @ mean_turn
        shifts[move, :3], shifts[move, 3] = np.eye(3), around[k]
    return np.asarray((np.eye(6 * count) - shifts @ np.linalg.pinv(shifts)) @ unturned)


def _span(model: Any, centres: Array) -> float:
    points = np.array([point.xyz for point in model.points3D.values()])
    return float(np.median(np.linalg.norm(points - centres.mean(axis=0), axis=1)))


def _cross(vectors: Array) -> Array:
    """The cross-product matrices (N, 3, 3) of vectors."""
    x, y, z = vectors.T
    zero = np.zeros_like(x)
    rows = [[zero, -z, y], [z, zero, -x], [-y, x, zero]]
    return np.asarray(np.array(rows).transpose(2, 0, 1))


def _worst(covariance: Array) -> float:
    """The standard deviation along the axis where it is largest."""
    return float(np.sqrt(max(0.0, np.linalg.eigvalsh(covariance)[-1])))
