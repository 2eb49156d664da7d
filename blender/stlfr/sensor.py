"""From rendered light to a camera's pixel values: lens distortion, gain, display encoding, grey, noise, bit depth.

Light is scene-linear (height, width, 3), as Cycles renders it for a pinhole. A distorted image is resampled from the
larger image of a wide pinhole, with twice the resolution. The filter is the mean over 2 x 2 pixels of the wide image
(one pixel of the final image), followed by a cubic B-spline. It reproduces linear ramps, so that nothing shifts. It has
no negative lobes, so that there is no ringing. It removes the frequency of one cycle per pixel, so that the position of
an edge doesn't depend on the pixel grid; with the spline alone, edges are displaced by up to 0.035 px. The filter's
standard deviation is 0.38 px; that of a square pixel is 0.29 px.

Does not import `bpy`.
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
"""Resolution of the wide pinhole's image relative to the final image, on each axis. Rendering time grows with its
square; at 1, edges are displaced by up to 0.035 px."""

MARGIN_PX = 4
"""Margin on all sides of the wide pinhole's image, for the support of the filter. If larger, more pixels are rendered;
below 3, the filter reaches beyond the image."""

GAIN_LIMITS = (0.01, 100.0)
"""Minimum and maximum gain after drift, equal to the limits of a rig's `gain`."""

REC709_LUMINANCE = np.array([0.2126, 0.7152, 0.0722])

SAME_SURFACE = 0.01
"""Neighbouring pixels count as one surface if their inverse depths differ by less than this fraction of the larger one.
If larger, depths are mixed across edges; if smaller, slanted surfaces get the nearest pixel's depth."""


def is_plain(camera: RigCamera) -> bool:
    """Whether the camera records exactly Blender's own 8-bit image: no distortion, gain or noise."""
    return (
        camera.distortion.is_none
        and camera.gain == 1.0
        and not any(camera.gain_drift_per_s)
        and camera.noise == 0.0
        and camera.bit_depth == 8
    )


def encoded(light: Array) -> Array:
    """Display-encoded (sRGB) values from 0 to 1 of linear light, as by Blender's view transform `Standard`."""
    linear = np.clip(light, 0.0, 1.0)
    return np.where(
        linear <= 0.0031308,
        12.92 * linear,
        1.055 * np.power(np.maximum(linear, 0.0031308), 1 / 2.4) - 0.055,
    )


def gains(camera: RigCamera, since_first_s: float) -> Array:
    """The camera's gains for red, green and blue linear light, `since_first_s` seconds after its first frame."""
    drift = np.array(camera.gain_drift_per_s) * since_first_s
    return np.clip(camera.gain * np.exp(np.clip(drift, -10.0, 10.0)), *GAIN_LIMITS)


def develop(
    light: Light,
    camera: RigCamera,
    noise_seed: int | None,
    since_first_s: float = 0.0,
) -> Pixels:
    """The camera's pixel values for this light, in 8 or 16 bits: (H, W, 3), or (H, W) for a grey camera.

    A grey camera records the encoded Rec. 709 luminance, as Blender's grey images do. `noise_seed` seeds the noise;
    None disables it. The gains are those `since_first_s` seconds after the camera's first frame.
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
    """Resamples images, depth and motion of a distorted lens from those of a wide pinhole camera."""

    lens: Pinhole
    """The pinhole parameters of the final image, without distortion."""
    distortion: distortions.Distortion
    pinhole: Pinhole
    """The parameters of the wide pinhole as Blender renders it. Its image contains all that the distorted lens sees."""

    def of_image(self, ideal: Array) -> Array:
        """Converts undistorted pixel positions (N, 2) of the final image to pixel positions of the wide image."""
        scale, shift = self._wide_from_ideal()
        return ideal * scale + shift

    def resample(self, light: Light, rows: slice = slice(None)) -> Light:
        """The light of the distorted image, resampled from the light of the wide image; all rows, or only `rows`."""
        squares = (light[:-1] + light[1:]) / 2
        squares = (squares[:, :-1] + squares[:, 1:]) / 2
        shape = (self.lens.height_px, self.lens.width_px, 2)
        at = self._positions().reshape(shape)[rows].reshape(-1, 2)
        at = at - 1.0  # the first 2 x 2 mean is centred at (1, 1)
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
        """The rows of the wide image that `resample` reads for these rows of the final image."""
        shape = (self.lens.height_px, self.lens.width_px, 2)
        y = self._positions().reshape(shape)[rows, :, 1]
        first, last = int(np.floor(y.min())) - 3, int(np.floor(y.max())) + 4
        return slice(max(0, first), min(self.pinhole.height_px, last))

    def geometry(
        self, depth_m: Light, before_px: Light, after_px: Light
    ) -> tuple[Light, Light]:
        """The depth and motion (H, W) of the distorted image, from those of the wide image.

        `before_px` and `after_px` (H, W, 2) are displacements in wide pixels to a point's position one frame before and
        after. The returned motion is the larger length of the two, in pixels of the final image. On a surface, values
        are interpolated; depth is interpolated as its inverse, which is exact on planes. At edges, the values of the
        nearest pixel are taken.
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
        """The positions in the wide image (N, 2) of all pixel centres of the distorted image, row by row."""
        return self.of_image(_ideal_grid(self.lens, self.distortion))

    def _length_px(self, at: Array, way: Array) -> Array:
        """The lengths (N) in the distorted image of displacements `way` (N, 2) from positions `at` in the wide image.

        Where the lens model has no image, the lengths are those without distortion.
        """
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
    """The wide pinhole to set up in Blender: its image contains all that the distorted lens sees, and a margin."""
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
    """The positions (N, 2) that all pixel centres would have without distortion, row by row.

    Cached, because all bands of a rolling shutter's image use it.
    """
    x, y = np.meshgrid(np.arange(lens.width_px) + 0.5, np.arange(lens.height_px) + 0.5)
    pixels = np.stack([x.ravel(), y.ravel()], axis=1)
    ideal = distortions.ideal_from_pixels(lens, distortion, pixels)
    ideal.flags.writeable = False
    return ideal


def _spline(at: Array) -> tuple[npt.NDArray[np.int64], list[Array]]:
    """The cubic B-spline at positions (N): the index of the first of four samples, and their weights.

    Sample k is at position k.
    """
    whole = np.floor(at)
    f = at - whole
    weights = [
        (1 - f) ** 3 / 6,
        (3 * f**3 - 6 * f**2 + 4) / 6,
        (-3 * f**3 + 3 * f**2 + 3 * f + 1) / 6,
        f**3 / 6,
    ]
    return whole.astype(np.int64) - 1, weights
