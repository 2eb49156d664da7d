"""Lens distortion: COLMAP's OPENCV model (Brown's radial and tangential distortion) and its inverse.

Filming distorts its images by this module, and point tracks are projected by it. It is intentionally independent of the
lens models in the library `stlfr`: if a filmed capture is reconstructed correctly, two implementations agree. The
module `stlfr` checks a rig's coefficients; this module doesn't. It does not import `bpy`.

On the plane z = 1, with r² = x² + y²:

    x' = x (1 + k1 r² + k2 r⁴) + 2 p1 x y + p2 (r² + 2 x²)
    y' = y (1 + k1 r² + k2 r⁴) + p1 (r² + 2 y²) + 2 p2 x y
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from .camera import Array, Pinhole

ITERATIONS = 25
"""Maximum number of steps of Newton's method. It converges in 3 to 6 steps if an inverse exists. If larger, points
without an inverse take longer; below 6, points near the radius where the model folds back get no inverse."""

STEP = 1e-14
"""Step of Newton's method at which it has converged, on the plane z = 1 (a unit is some hundreds of pixels). If larger,
the inverse is inaccurate; if smaller than the rounding of a double, no point converges."""

MIN_DETERMINANT = 1e-9
"""Minimum determinant of the distortion's derivative; without distortion it is 1. Where it isn't positive, the model
folds back and maps two points to one pixel. If larger, valid points near this radius are lost; if 0, the division
overflows."""


@dataclass(frozen=True)
class Distortion:
    """The coefficients of the distortion model, without units."""

    k1: float = 0.0
    k2: float = 0.0
    p1: float = 0.0
    p2: float = 0.0

    @property
    def is_none(self) -> bool:
        """Whether all coefficients are 0, so that there is no distortion."""
        return self == Distortion()

    def distorted(self, points: Array) -> Array:
        """Distort points (N, 2) of the plane z = 1. The result is meaningless where `is_short_of_fold` is false."""
        x, y = points.T
        r2 = x * x + y * y
        radial = 1.0 + r2 * (self.k1 + r2 * self.k2)
        return np.stack(
            [
                x * radial + 2.0 * self.p1 * x * y + self.p2 * (r2 + 2.0 * x * x),
                y * radial + self.p1 * (r2 + 2.0 * y * y) + 2.0 * self.p2 * x * y,
            ],
            axis=1,
        )

    def is_short_of_fold(self, points: Array) -> npt.NDArray[np.bool_]:
        """Whether points (N, 2) of the plane z = 1 are within the radius up to which the model is one-to-one.

        Beyond this radius, the distorted radius decreases again: the model folds the scene back over the image, unlike
        any real lens.
        """
        r2 = (points**2).sum(axis=1)
        # The radial slope, 1 + 3 k1 r² + 5 k2 r⁴, is smallest at an end or at its parabola's vertex.
        vertex = -0.3 * self.k1 / self.k2 if self.k2 > 0.0 else 0.0
        lowest_at = np.clip(vertex, 0.0, r2)
        slopes = [
            1.0 + s * (3.0 * self.k1 + 5.0 * self.k2 * s) for s in (r2, lowest_at)
        ]
        a, b, d = self._derivative(points)
        return np.asarray(
            (np.minimum(*slopes) > 0.0) & (a * d - b * b > MIN_DETERMINANT)
        )

    def undistorted(self, points: Array) -> Array:
        """The inverse of `distorted`, by Newton's method; NaN for points without an inverse."""
        found = points.copy()
        step = np.full_like(points, np.inf)
        with np.errstate(all="ignore"):
            for _ in range(ITERATIONS):
                step = self._newton_step(found, points)
                found -= step
                if np.all(_is_small(step, found) | np.isnan(step[:, 0])):
                    break
        found[~_is_small(step, found)] = np.nan
        return found

    def _derivative(self, points: Array) -> tuple[Array, Array, Array]:
        """The derivatives of `distorted` at points (N, 2): of x' by x, of x' by y (equal to y' by x), of y' by y."""
        x, y = points.T
        r2 = x * x + y * y
        radial = 1.0 + r2 * (self.k1 + r2 * self.k2)
        radial_r2 = self.k1 + 2.0 * self.k2 * r2
        a = radial + 2.0 * x * x * radial_r2 + 2.0 * self.p1 * y + 6.0 * self.p2 * x
        b = 2.0 * x * y * radial_r2 + 2.0 * self.p1 * x + 2.0 * self.p2 * y
        d = radial + 2.0 * y * y * radial_r2 + 6.0 * self.p1 * y + 2.0 * self.p2 * x
        return a, b, d

    def _newton_step(self, found: Array, wanted: Array) -> Array:
        a, b, d = self._derivative(found)
        determinant = a * d - b * b
        determinant[~(determinant > MIN_DETERMINANT)] = np.nan
        u, v = (self.distorted(found) - wanted).T
        return np.stack([d * u - b * v, a * v - b * u], axis=1) / determinant[:, None]


def _is_small(step: Array, found: Array) -> Array:
    # 100 times `STEP`, because the last step may consist of rounding errors only.
    limit = 1e2 * STEP * (1.0 + np.linalg.norm(found, axis=1))
    return np.asarray(np.linalg.norm(step, axis=1) < limit)


def ideal_from_pixels(lens: Pinhole, distortion: Distortion, pixels: Array) -> Array:
    """The positions (N, 2) that pixels would have without distortion; NaN where the distortion has no inverse."""
    scale, center = _scale_and_center(lens)
    return distortion.undistorted((pixels - center) / scale) * scale + center


def pixels_from_ideal(lens: Pinhole, distortion: Distortion, ideal: Array) -> Array:
    """The distorted positions of an ideal pinhole's pixels (N, 2); NaN where the distortion model folds back."""
    scale, center = _scale_and_center(lens)
    points = (ideal - center) / scale
    pixels = distortion.distorted(points) * scale + center
    if not distortion.is_none:
        pixels[~distortion.is_short_of_fold(points)] = np.nan
    return np.asarray(pixels)


def _scale_and_center(lens: Pinhole) -> tuple[Array, Array]:
    return np.array([lens.fx_px, lens.fy_px]), np.array([lens.cx_px, lens.cy_px])
