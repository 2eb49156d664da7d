"""Conversion between linear light and sRGB values."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]


def linear(encoded: Array) -> Array:
    """Linear light of sRGB values, both from 0 to 1."""
    power = ((encoded + 0.055) / 1.055) ** 2.4
    return np.where(encoded <= 0.04045, encoded / 12.92, power)


def encoded(light: Array) -> Array:
    """The sRGB values of linear light, clipped to 0 to 1."""
    clipped = np.clip(light, 0.0, 1.0)
    power = 1.055 * clipped ** (1 / 2.4) - 0.055
    return np.where(clipped <= 0.0031308, 12.92 * clipped, power)
