"""From light to a camera's pixels: lens distortion, gain, display encoding, grey, noise, bit depth. No `bpy` here.

Light is scene-linear, height x width x 3, as Cycles renders it for a pinhole. A distorted lens's
image is resampled from a pinhole's that is larger and twice as fine, with an image's pixel of four
of its pixels and a cubic B-spline. They reproduce ramps, so that nothing shifts; have no negative
lobes, so that no light rings; and let nothing through at one cycle a pixel, so that edges lie the
same wherever they fall on the grid (the spline alone: up to 0.035 px off). Their blur is 0.38 px in
standard deviation, a square pixel's being 0.29.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from . import distortion as distortions
from .camera import Array, Pinhole

if TYPE_CHECKING:
    from .rig import RigCamera

Light = npt.NDArray[np.float32]
Pixels = npt.NDArray[np.uint8] | npt.NDArray[np.uint16]

FINENESS = 2
"""Pixels of the wide pinhole to one of the image, on each axis. Filming takes its square in time; at 1 edges lie
up to 0.035 px off."""

MARGIN_PX = 4
"""Of the wide pinhole's image, all around: as far as the spline reaches, and some more. Larger costs pixels;
below 3 the spline reaches beyond the image."""

GAIN_LIMITS = (0.01, 100.0)
"""As of a rig's `gain`."""

REC709_LUMINANCE = np.array([0.2126, 0.7152, 0.0722])

SAME_SURFACE = 0.01
"""Inverse depths of neighbours that differ by less, relative to the larger, lie on one surface. Larger mixes
depths across edges; smaller takes the nearest pixel's depth on surfaces seen at a slant."""


def is_plain(camera: RigCamera) -> bool:
    """Whether Blender's own 8-bit picture is what the camera records."""
    return (
        camera.distortion.is_none
        and camera.gain == 1.0
        and not any(camera.gain_drift_per_s)
        and camera.noise == 0.0
        and camera.bit_depth == 8
    )


def encoded(light: Array) -> Array:
    """Display-encoded (sRGB) values of 0 to 1, as Blender's `Standard` view gives them."""
    linear = np.clip(light, 0.0, 1.0)
    return np.where(
        linear <= 0.0031308,
        12.92 * linear,
        1.055 * np.power(np.maximum(linear, 0.0031308), 1 / 2.4) - 0.055,
    )


def gains(camera: RigCamera, since_first_s: float) -> Array:
    """Factors on red, green and blue light, some seconds after the camera's first frame."""
    drift = np.array(camera.gain_drift_per_s) * since_first_s
    return np.clip(camera.gain * np.exp(np.clip(drift, -10.0, 10.0)), *GAIN_LIMITS)


def develop(
    light: Light,
    camera: RigCamera,
    noise_seed: int | None,
    since_first_s: float = 0.0,
) -> Pixels:
    """What the camera records of the light: 8 or 16 bits, H x W x 3, or H x W if it is grey.

    A grey camera records Rec. 709's luminance, encoded, as Blender's grey pictures do. The noise is
    drawn anew for every seed; none without one. The gains are those some seconds after the camera's first
    frame.
    """
    linear = gains(camera, since_first_s) * light.astype(np.float64)
    if camera.color == "gray":
        linear = linear @ REC709_LUMINANCE
    values = encoded(linear)
    if noise_seed is not None and camera.noise > 0.0:
        generator = np.random.Generator(np.random.PCG64(noise_seed))
        values = values + camera.noise * generator.standard_normal(values.shape)
    white = 2**camera.bit_depth - 1
    whole = np.floor(np.clip(values, 0.0, 1.0) * white + 0.5)
    return whole.astype(np.uint8) if camera.bit_depth == 8 else whole.astype(np.uint16)


@dataclass(frozen=True)
class Wide:
    """The pinhole image that a distorted one is resampled from."""

    lens: Pinhole
    """Of the image, without its distortion."""
    distortion: distortions.Distortion
    pinhole: Pinhole
    """Wide enough for all that the distorted lens sees, as Blender renders it."""

    def of_image(self, ideal: Array) -> Array:
        """Pixels (N, 2) of the wide image from distortion-free ones of the image."""
        scale, shift = self._wide_from_ideal()
        return ideal * scale + shift

    def resample(self, light: Light, rows: slice = slice(None)) -> Light:
        """The distorted lens's light, of all rows of the image or of some, from the wide pinhole's."""
        squares = (light[:-1] + light[1:]) / 2
        squares = (squares[:, :-1] + squares[:, 1:]) / 2
        shape = (self.lens.height_px, self.lens.width_px, 2)
        at = self._positions().reshape(shape)[rows].reshape(-1, 2)
        at = at - 1.0  # the first square's centre is at (1, 1)
        left, x_weights = _spline(at[:, 0])
        top, y_weights = _spline(at[:, 1])
        result = np.zeros((len(at), light.shape[2]))
        for j in range(4):
            for i in range(4):
                weight = y_weights[j] * x_weights[i]
                result += weight[:, None] * squares[top + j, left + i]
        size = (-1, self.lens.width_px, light.shape[2])
        return result.reshape(size).astype(np.float32)

    def rows_for(self, rows: slice) -> slice:
        """The rows of the wide image that `resample` reads for these of the image."""
        shape = (self.lens.height_px, self.lens.width_px, 2)
        y = self._positions().reshape(shape)[rows, :, 1]
        first, last = int(np.floor(y.min())) - 3, int(np.floor(y.max())) + 4
        return slice(max(0, first), min(self.pinhole.height_px, last))

    def geometry(
        self, depth_m: Light, before_px: Light, after_px: Light
    ) -> tuple[Light, Light]:
        """The distorted lens's depth and motion from the wide pinhole's.

        The motions given are H x W x 2 in wide pixels, to where the point is a frame before and
        after; the one returned is the larger of the two distances in pixels of the image.
        On one surface everything is interpolated: depth, as its inverse, exactly on planes. Beside
        edges, it is the nearest pixel's.
        """
        at = self._positions()
        whole = np.floor(at - 0.5).astype(np.int64)
        f = at - 0.5 - whole
        nearest = np.round(f).astype(np.int64)
        inverse = 1.0 / depth_m.astype(np.float64)  # 0 where there is nothing
        values = np.concatenate(
            [inverse[..., None], before_px.astype(np.float64), after_px], axis=2
        )
        corners = {
            (i, j): values[whole[:, 1] + j, whole[:, 0] + i]
            for j in (0, 1)
            for i in (0, 1)
        }
        depths = [corner[:, 0] for corner in corners.values()]
        farthest, nearest_one = np.min(depths, axis=0), np.max(depths, axis=0)
        is_smooth = nearest_one - farthest <= SAME_SURFACE * nearest_one
        mixed = np.zeros_like(corners[0, 0])
        for (i, j), corner in corners.items():
            weight = np.abs(1 - i - f[:, 0]) * np.abs(1 - j - f[:, 1])
            is_nearest = (nearest[:, 0] == i) & (nearest[:, 1] == j)
            mixed += np.where(is_smooth, weight, is_nearest)[:, None] * corner
        steps = [self._length_px(at, mixed[:, k : k + 2]) for k in (1, 3)]
        with np.errstate(divide="ignore"):
            return self._shaped(1.0 / mixed[:, 0]), self._shaped(np.maximum(*steps))

    def _positions(self) -> Array:
        """Where in the wide image the centre of every pixel is, row by row."""
        return self.of_image(_ideal_grid(self.lens, self.distortion))

    def _length_px(self, at: Array, way: Array) -> Array:
        """How far the distorted image goes along ways (N, 2) of the wide one; out of the lens's sight, as without it."""
        step = self._distorted(at + way) - self._distorted(at)
        scale, _ = self._wide_from_ideal()
        step = np.where(np.isnan(step), way / scale, step)
        return np.asarray(np.linalg.norm(step, axis=1))

    def _distorted(self, wide: Array) -> Array:
        scale, shift = self._wide_from_ideal()
        ideal = (wide - shift) / scale
        return distortions.pixels_from_ideal(self.lens, self.distortion, ideal)

    def _wide_from_ideal(self) -> tuple[Array, Array]:
        lens, wide = self.lens, self.pinhole
        scale = np.array([wide.fx_px / lens.fx_px, wide.fy_px / lens.fy_px])
        center = np.array([lens.cx_px, lens.cy_px])
        return scale, np.array([wide.cx_px, wide.cy_px]) - center * scale

    def _shaped(self, values: Array) -> Light:
        return values.reshape(self.lens.height_px, self.lens.width_px).astype(
            np.float32
        )


def wide_pinhole(lens: Pinhole, distortion: distortions.Distortion) -> Pinhole:
    """The pinhole to ask Blender for: all that the distorted lens sees, and a margin."""
    ideal = _ideal_grid(lens, distortion)
    low, high = ideal.min(axis=0), ideal.max(axis=0)
    width_px, height_px = np.ceil((high - low) * FINENESS).astype(int) + 2 * MARGIN_PX
    cx_px, cy_px = (np.array([lens.cx_px, lens.cy_px]) - low) * FINENESS + MARGIN_PX
    return Pinhole(
        int(width_px),
        int(height_px),
        lens.fx_px * FINENESS,
        lens.fy_px * FINENESS,
        float(cx_px),
        float(cy_px),
    )


@functools.lru_cache(maxsize=1)
def _ideal_grid(lens: Pinhole, distortion: distortions.Distortion) -> Array:
    """Where the centres of all pixels, row by row, would be without distortion. Kept for the next band of the image."""
    x, y = np.meshgrid(np.arange(lens.width_px) + 0.5, np.arange(lens.height_px) + 0.5)
    pixels = np.stack([x.ravel(), y.ravel()], axis=1)
    ideal = distortions.ideal_from_pixels(lens, distortion, pixels)
    ideal.flags.writeable = False
    return ideal


def _spline(at: Array) -> tuple[npt.NDArray[np.int64], list[Array]]:
    """The first of the four samples that a position (sample 0 is at 0) is made of, and their weights."""
    whole = np.floor(at)
    f = at - whole
    weights = [
        (1 - f) ** 3 / 6,
        (3 * f**3 - 6 * f**2 + 4) / 6,
        (-3 * f**3 + 3 * f**2 + 3 * f + 1) / 6,
        f**3 / 6,
    ]
    return whole.astype(np.int64) - 1, weights
