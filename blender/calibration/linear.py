"""A reconstruction's reprojection errors, and their derivatives by the parameters of cameras and points.

A camera has six pose parameters: a rotation about the world's axes (radians), then a translation of its centre. They
may be followed by lens parameters: the logarithm of its focal lengths, its principal point (pixels) and its distortion
coefficients. Points are eliminated from the normal equations by the Schur complement.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from .capture import Array

FREEDOMS = 7
"""Degrees of freedom of a similarity: three of rotation, three of translation, and the scale."""

STEP = 1e-6
"""Step of central differences: a fraction of a point's depth, and of a unit of each lens parameter. If larger, the
projection's curvature falsifies the derivative; if smaller, rounding errors do."""

CHUNK = 2048
"""Number of points that are eliminated in one batch. Larger batches take more memory, smaller ones more time."""

Indices = npt.NDArray[np.int64]


@dataclass(frozen=True)
class Linearization:
    """The observations of a reconstruction, with derivatives. A row is one observation of a point in an image."""

    images: list[Any]
    refined: tuple[str, ...]
    """The groups of lens parameters that follow a camera's pose parameters, of `focal`, `centre`, `distortion`, in this
    order."""
    point_ids: list[int]
    camera: Indices
    """For each row, the index of its image in `images`."""
    point: Indices
    """For each row, the index of its point in `point_ids`."""
    by_camera: Array
    """For each row, the derivatives (2, K) of the projected pixel by the camera's K parameters."""
    by_point: Array
    """For each row, the derivatives (2, 3) of the projected pixel by the point's coordinates."""
    errors_px: Array
    """For each row, the reprojection error (x, y): the projected pixel minus the observed one."""
    span: float
    """The median distance of the points from the mean of the camera centres; 1 if there are no points."""

    @property
    def size(self) -> int:
        """The number of parameters of one camera."""
        return int(self.by_camera.shape[2])

    @property
    def centres(self) -> Array:
        """The cameras' centres (N, 3) in world coordinates, in the order of `images`."""
        return np.array([image.projection_center() for image in self.images])

    @property
    def redundancy(self) -> int:
        """The number of measured coordinates minus the number of estimated parameters, without the gauge freedoms."""
        estimated = 3 * len(self.point_ids) + self.size * len(self.images) - FREEDOMS
        return 2 * len(self.errors_px) - estimated

    def reduced(self, weights: Array | None = None) -> tuple[Array, Array]:
        """The cameras' information matrix and gradient, with all points eliminated. `weights` has one per row."""
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
        """The changes (P, 3) of the points that minimize the errors after this change of all cameras' parameters."""
        moves = np.zeros((len(self.point_ids), 3))
        for rows, inverses, mixed, gradient in self._points(weights):
            pull = gradient + np.einsum("pci,c->pi", mixed, change)
            moves[rows] = -np.einsum("pij,pj->pi", inverses, pull)
        return moves

    def _points(self, weights: Array) -> Any:
        """Yields batches of points, each with four parts of the normal equations.

        These are the points' indices, the inverse of their information matrices (P, 3, 3), the information shared with
        the cameras' parameters (P, C, 3), and the gradient (P, 3).
        """
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
            # One image may have two observations of a point, so `+=` would lose one of them.
            np.add.at(mixed, (point[:, None], columns), products)
            yield slice(first, end), np.linalg.pinv(own), mixed, gradient


def linearized(model: Any, refined: tuple[str, ...]) -> Linearization:
    """The linearization of pycolmap's reconstruction `model`, at its current cameras and points.

    `refined` names the groups of lens parameters with derivatives: `focal`, `centre`, `distortion`.
    """
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
    """An image's N observations: the points' ids, `by_camera`, `by_point` and `errors_px` as in `Linearization`."""
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
    """The pixels (N, 2) of points (N, 3) in camera coordinates, by the pycolmap camera `lens`."""
    return np.asarray(lens.img_from_cam(places)).reshape(-1, 2)


def directions(lens: Any, refined: tuple[str, ...]) -> Array:
    """The derivatives (K, P) of the lens's P parameters by the K refined parameters.

    The focal length is refined as one logarithm, so its row has the focal lengths themselves. All other rows have a 1.
    """
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
    """The derivatives (N, 2, K) of pixels by the lens's K refined parameters, by central differences."""
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
    """The cross-product matrices (N, 3, 3) of vectors (N, 3)."""
    x, y, z = vectors.T
    zero = np.zeros_like(x)
    rows = [[zero, -z, y], [z, zero, -x], [-y, x, zero]]
    return np.asarray(np.array(rows).transpose(2, 0, 1))


def worst(covariance: Array) -> float:
    """The largest standard deviation along any axis, of a vector with this covariance matrix."""
    return float(np.sqrt(max(0.0, np.linalg.eigvalsh(covariance)[-1])))
