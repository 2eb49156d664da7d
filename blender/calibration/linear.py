"""A reconstruction's reprojection errors, and how they change with cameras and points.

A camera changes by six numbers: a turn about the world's axes (radians), then a move of its centre. With its lens refined
it has more: the logarithm of its focal lengths, its principal point (pixels), its distortion. Points are eliminated
(the Schur complement).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from .capture import Array

FREEDOMS = 7
"""Of a similarity: turn, move, scale."""

STEP = 1e-6
"""Of a central difference, as a fraction of a point's depth. Larger, and the projection's curvature enters the
derivative; smaller, and rounding does."""

CHUNK = 2048
"""Points that are eliminated at once. Larger, and more memory is taken; smaller, and more time."""

Indices = npt.NDArray[np.int64]


@dataclass(frozen=True)
class Linearization:
    """All sights of a model: a point seen in an image is a row."""

    images: list[Any]
    refined: tuple[str, ...]
    """Groups of lens parameters among a camera's numbers, in their order: `focal`, `centre`, `distortion`."""
    point_ids: list[int]
    camera: Indices
    """By row: the number of its image."""
    point: Indices
    """By row: the number of its point."""
    by_camera: Array
    """By row: how its pixel changes with its camera (2xN)."""
    by_point: Array
    """By row: how its pixel changes with its point (2x3)."""
    errors_px: Array
    """By row: projected minus seen."""
    span: float
    """The points' median distance from the cameras."""

    @property
    def size(self) -> int:
        """Numbers of a camera."""
        return int(self.by_camera.shape[2])

    @property
    def centres(self) -> Array:
        """Of the cameras."""
        return np.array([image.projection_center() for image in self.images])

    @property
    def redundancy(self) -> int:
        """How many more numbers are measured than estimated."""
        estimated = 3 * len(self.point_ids) + self.size * len(self.images) - FREEDOMS
        return 2 * len(self.errors_px) - estimated

    def reduced(self, weights: Array | None = None) -> tuple[Array, Array]:
        """Information and gradient of the cameras with all points eliminated. Weights are the rows'."""
        count, size = len(self.images), self.size
        weights = np.ones(len(self.camera)) if weights is None else weights
        weighted = weights[:, None, None] * self.by_camera
        blocks = np.zeros((count, size, size))
        np.add.at(blocks, self.camera, np.swapaxes(weighted, 1, 2) @ self.by_camera)
        gradient = np.zeros((count, size))
        np.add.at(
            gradient, self.camera, np.einsum("nij,ni->nj", weighted, self.errors_px)
        )
        information = np.zeros((count * size, count * size))
        for k, block in enumerate(blocks):
            own = slice(k * size, (k + 1) * size)
            information[own, own] = block
        flat = gradient.ravel()
        for _, inverses, mixed, own_gradient in self._points(weights):
            eliminated = np.einsum("pci,pij->pcj", mixed, inverses)
            information -= np.tensordot(eliminated, mixed, axes=([0, 2], [0, 2]))
            flat -= np.einsum("pci,pi->c", eliminated, own_gradient)
        return information, flat

    def moved_points(self, weights: Array, change: Array) -> Array:
        """How points move (P, 3) where the cameras change so."""
        moves = np.zeros((len(self.point_ids), 3))
        for rows, inverses, mixed, gradient in self._points(weights):
            pull = gradient + np.einsum("pci,c->pi", mixed, change)
            moves[rows] = -np.einsum("pij,pj->pi", inverses, pull)
        return moves

    def _points(self, weights: Array) -> Any:
        """Chunks of points: which, inverse information (P, 3, 3), mixed with cameras (P, C, 3), gradient (P, 3)."""
        size, width = self.size, self.size * len(self.images)
        order = np.argsort(self.point, kind="stable")
        for first in range(0, len(self.point_ids), CHUNK):
            end = min(first + CHUNK, len(self.point_ids))
            low, high = np.searchsorted(self.point[order], [first, end])
            rows = order[low:high]
            point = self.point[rows] - first
            weighted = weights[rows, None, None] * self.by_point[rows]
            own = np.zeros((end - first, 3, 3))
            np.add.at(own, point, np.swapaxes(weighted, 1, 2) @ self.by_point[rows])
            gradient = np.zeros((end - first, 3))
            pulls = np.einsum("nij,ni->nj", weighted, self.errors_px[rows])
            np.add.at(gradient, point, pulls)
            mixed = np.zeros((end - first, width, 3))
            columns = self.camera[rows, None] * size + np.arange(size)
            products = np.swapaxes(self.by_camera[rows], 1, 2) @ weighted
            # A camera may see a point at two places.
            np.add.at(mixed, (point[:, None], columns), products)
            yield slice(first, end), np.linalg.pinv(own), mixed, gradient


def linearized(model: Any, refined: tuple[str, ...]) -> Linearization:
    """pycolmap's `model`; `refined` are groups of lens parameters: `focal`, `centre`, `distortion`."""
    images = [image for image in model.images.values() if image.has_pose]
    point_ids = sorted(model.points3D)
    numbers = {point_id: k for k, point_id in enumerate(point_ids)}
    parts = [_sights(model, image, refined) for image in images]
    point = [numbers[i] for ids, *_ in parts for i in ids]
    by_camera, by_point, errors_px = (
        np.concatenate([part[k] for part in parts]) for k in (1, 2, 3)
    )
    camera = np.repeat(np.arange(len(images)), [len(part[0]) for part in parts])
    xyz = np.array([model.points3D[i].xyz for i in point_ids]).reshape(-1, 3)
    centres = np.array([image.projection_center() for image in images])
    away = np.linalg.norm(xyz - centres.mean(axis=0), axis=1)
    span = float(np.median(away)) if len(away) else 1.0
    rows = np.array(point, dtype=np.int64)
    return Linearization(
        images, refined, point_ids, camera, rows, by_camera, by_point, errors_px, span
    )


def _sights(
    model: Any, image: Any, refined: tuple[str, ...]
) -> tuple[list[int], Array, Array, Array]:
    """An image's sights: their points, by_camera, by_point, and errors (N, 2), pixels."""
    seen = [p for p in image.points2D if p.has_point3D()]
    ids = [p.point3D_id for p in seen]
    lens, matrix = model.cameras[image.camera_id], image.cam_from_world().matrix()
    rotation = matrix[:, :3]
    ways = np.array([model.points3D[i].xyz for i in ids]).reshape(-1, 3)
    ways = ways + rotation.T @ matrix[:, 3]
    places = ways @ rotation.T
    by_place = np.empty((len(seen), 2, 3))
    for axis in range(3):
        step = np.zeros_like(places)
        step[:, axis] = STEP * places[:, 2]
        change = pixels(lens, places + step) - pixels(lens, places - step)
        by_place[:, :, axis] = change / (2 * step[:, axis, None])
    by_point = by_place @ rotation
    by_lens = _by_lens(lens, places, refined)
    by_camera = np.concatenate([by_point @ cross(ways), -by_point, by_lens], axis=2)
    errors = pixels(lens, places) - np.array([p.xy for p in seen]).reshape(-1, 2)
    return ids, by_camera, by_point, errors


def pixels(lens: Any, places: Array) -> Array:
    """Where a lens shows points of the camera's frame (N, 2)."""
    return np.asarray(lens.img_from_cam(places)).reshape(-1, 2)


def directions(lens: Any, refined: tuple[str, ...]) -> Array:
    """How a lens's parameters change (K, P) with each of its refined numbers."""
    params = np.array(lens.params)
    units, changes = np.eye(len(params)), []
    if "focal" in refined:
        focal = lens.focal_length_idxs()
        changes.append(units[focal].T @ params[focal])
    if "centre" in refined:
        changes.extend(units[lens.principal_point_idxs()])
    if "distortion" in refined:
        changes.extend(units[lens.extra_params_idxs()])
    return np.array(changes).reshape(-1, len(params))


def _by_lens(lens: Any, places: Array, refined: tuple[str, ...]) -> Array:
    """How pixels change (N, 2, K) with the refined numbers of a lens."""
    params = np.array(lens.params)
    changes = directions(lens, refined)
    columns = np.empty((len(places), 2, len(changes)))
    for k, change in enumerate(changes):
        lens.params = params + STEP * change
        ahead = pixels(lens, places)
        lens.params = params - STEP * change
        columns[:, :, k] = (ahead - pixels(lens, places)) / (2 * STEP)
    lens.params = params
    return columns


def cross(vectors: Array) -> Array:
    """The cross-product matrices (N, 3, 3) of vectors."""
    x, y, z = vectors.T
    zero = np.zeros_like(x)
    rows = [[zero, -z, y], [z, zero, -x], [-y, x, zero]]
    return np.asarray(np.array(rows).transpose(2, 0, 1))


def worst(covariance: Array) -> float:
    """The standard deviation along the axis where it is largest."""
    return float(np.sqrt(max(0.0, np.linalg.eigvalsh(covariance)[-1])))
