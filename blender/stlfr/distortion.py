"""Lens distortion: COLMAP's OPENCV model (Brown's radial and tangential distortion) and its inverse. No `bpy` here.

Filming distorts its images by this, and the calibration check projects by it. It is written apart from
the library's own lens models on purpose: where a capture is reconstructed rightly, two independent
implementations agree. It checks no rig; the module `stlfr` does.

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
"""Newton's method converges in 3 to 6 steps where there is an inverse at all. More steps cost time only where
there is none; fewer than 6 lose points near the fold."""

STEP = 1e-14
"""The step, in normalized units of some hundreds of pixels, at which Newton's method has converged. Larger, and
the inverse is off; smaller than a double's rounding, and no point ever converges."""

MIN_DETERMINANT = 1e-9
"""Of the derivative, which is 1 without distortion. Not positive, and the point lies past the lens's fold, where
the model shows a pixel twice. Larger, and good points near the fold are lost; 0, and the division overflows."""


@dataclass(frozen=True)
class Distortion:
    """The coefficients, without unit."""

    k1: float = 0.0
    k2: float = 0.0
    p1: float = 0.0
    p2: float = 0.0

    @property
    def is_none(self) -> bool:
        """Whether straight lines stay straight."""
        return self == Distortion()

    def distorted(self, points: Array) -> Array:
        """Distorted points (N, 2) of the plane z = 1; meaningless past the lens's fold."""
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
        """Whether the lens spreads points (N, 2) as it does those nearer to the axis.

        Past the radius where it stops, the model folds the scene back over the image, as no lens does.
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
        """Inverse of `distorted` by Newton's method; NaN where there is none."""
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
        """Of x' by x, of x' by y and of y' by x (they are the same), of y' by y."""
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
    # A few digits more than the step that Newton aims at: the last one may be rounding alone.
    limit = 1e2 * STEP * (1.0 + np.linalg.norm(found, axis=1))
    return np.asarray(np.linalg.norm(step, axis=1) < limit)


def ideal_from_pixels(lens: Pinhole, distortion: Distortion, pixels: Array) -> Array:
    """Undistorted positions of pixels (N, 2); NaN where the lens has no inverse."""
    scale, center = _scale_and_center(lens)
    return distortion.undistorted((pixels - center) / scale) * scale + center


def pixels_from_ideal(lens: Pinhole, distortion: Distortion, ideal: Array) -> Array:
    """Distorted positions of a pinhole's pixels (N, 2); NaN past the lens's fold."""
    scale, center = _scale_and_center(lens)
    points = (ideal - center) / scale
    pixels = distortion.distorted(points) * scale + center
    if not distortion.is_none:
        pixels[~distortion.is_short_of_fold(points)] = np.nan
    return np.asarray(pixels)


def _scale_and_center(lens: Pinhole) -> tuple[Array, Array]:
    return np.array([lens.fx_px, lens.fy_px]), np.array([lens.cx_px, lens.cy_px])
