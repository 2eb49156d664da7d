"""Textures painted with NumPy: smooth noise, Voronoi cells, bricks, and pictures composed of them.

An image is an array (height, width) or (height, width, 3) of sRGB-encoded values from 0 to 1. Row 0 is at the bottom,
as in Blender. All random numbers are seeded, so that equal calls paint equal pixels.
"""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

Image = npt.NDArray[np.float32]


def generator(name: str) -> np.random.Generator:
    """A random number generator whose seed is computed from the texture's name."""
    return np.random.default_rng(zlib.crc32(name.encode()))


def color(hex_code: str) -> Image:
    """The sRGB values of a code such as `d0a040`."""
    return np.array(
        [int(hex_code[i : i + 2], 16) / 255 for i in (0, 2, 4)], dtype=np.float32
    )


def noise(
    shape: tuple[int, int], feature_px: float, octaves: int, random: np.random.Generator
) -> Image:
    """Smooth noise from 0 to 1 with features of about `feature_px`; each octave halves their size and strength."""
    total = np.zeros(shape, dtype=np.float32)
    for octave in range(octaves):
        total += 0.5**octave * _smooth_lattice(
            shape, max(1.0, feature_px * 0.5**octave), random
        )
    total -= total.min()
    total /= total.max()
    return total


def _smooth_lattice(
    shape: tuple[int, int], spacing_px: float, random: np.random.Generator
) -> Image:
    """An image of random values on a lattice with this spacing, smoothly interpolated."""
    y, x = (np.arange(n, dtype=np.float32) / spacing_px for n in shape)
    lattice = random.random((int(y[-1]) + 2, int(x[-1]) + 2), dtype=np.float32)
    row, column = y.astype(int), x.astype(int)
    v, u = (f * f * (3 - 2 * f) for f in ((y % 1)[:, None], (x % 1)[None, :]))
    along = lattice[:, column] * (1 - u) + lattice[:, column + 1] * u
    result: Image = (along[row] * (1 - v) + along[row + 1] * v).astype(np.float32)
    return result


def cells(
    shape: tuple[int, int], spacing_px: float, random: np.random.Generator
) -> Image:
    """An image of Voronoi cells about `spacing_px` wide, each with a constant grey value from 0 to 1."""
    y, x = (np.arange(n, dtype=np.float32) / spacing_px + 1 for n in shape)
    lattice_shape = (int(y[-1]) + 3, int(x[-1]) + 3)
    shift_y, shift_x, grey = random.random((3, *lattice_shape), dtype=np.float32)
    rows, columns = (np.arange(n, dtype=np.float32) for n in lattice_shape)
    centre_y, centre_x = rows[:, None] + shift_y, columns[None, :] + shift_x
    nearest = np.full(shape, np.inf, dtype=np.float32)
    result = np.zeros(shape, dtype=np.float32)
    for dy in (-1, 0, 1):
        for dx in (-1, 0, 1):
            row, column = y.astype(int) + dy, x.astype(int) + dx

            def here(lattice: Image, row: Any = row, column: Any = column) -> Image:
                return lattice[row][:, column]

            distance = (here(centre_y) - y[:, None]) ** 2
            distance += (here(centre_x) - x[None, :]) ** 2
            closer = distance < nearest
            np.copyto(nearest, distance, where=closer)
            np.copyto(result, here(grey), where=closer)
    return result


def ramp(factor: Image, stops: Sequence[float], codes: Sequence[str]) -> Image:
    """Map an image of factors to colours, which are interpolated between the `codes` at the factors `stops`."""
    colors = np.stack([color(code) for code in codes])
    return np.stack(
        [np.interp(factor, stops, colors[:, c]) for c in range(3)], axis=-1
    ).astype(np.float32)


def photo(
    name: str, shape: tuple[int, int], codes: Sequence[str], feature_px: float
) -> Image:
    """A picture like a printed photograph: soft large shapes in five colours, small sharp cells, and grain."""
    random = generator(name)
    shapes = ramp(
        noise(shape, 5 * feature_px, 4, random), (0.15, 0.38, 0.5, 0.62, 0.85), codes
    )
    patches = cells(shape, feature_px, random) - 0.5
    grain = noise(shape, 0.45 * feature_px, 2, random) - 0.5
    return shaded(shapes, 0.42 * patches + 0.38 * grain)


def bricks(
    name: str,
    shape: tuple[int, int],
    brick_px: tuple[float, float],
    codes: Sequence[str],
    mortar: str,
) -> Image:
    """A picture of a brick wall: bricks in colours interpolated between `codes`, with stains, chips and grain."""
    random = generator(name)
    y, x = np.meshgrid(*(np.arange(n, dtype=np.float32) for n in shape), indexing="ij")
    row = (y / brick_px[0]).astype(int)
    along = x / brick_px[1] + 0.5 * (row % 2)
    tint = random.random((int(row.max()) + 1, int(along.max()) + 1), dtype=np.float32)
    base = ramp(
        tint[row, along.astype(int)], np.linspace(0, 1, len(codes)).tolist(), codes
    )
    gap_px = np.minimum(
        np.minimum(y % brick_px[0], -y % brick_px[0]),
        np.minimum(along % 1, -along % 1) * brick_px[1],
    )
    is_brick = np.clip(gap_px - 0.055 * brick_px[0] + 0.5, 0, 1)[..., None]
    wall = base * is_brick + color(mortar) * (1 - is_brick)
    stains = noise(shape, 2.5 * brick_px[0], 3, random) - 0.5
    chips = cells(shape, 0.32 * brick_px[0], random) - 0.5
    grain = noise(shape, 0.16 * brick_px[0], 2, random) - 0.5
    return shaded(wall, 0.25 * stains + 0.28 * chips + 0.28 * grain)


def patchwork(
    name: str, shape: tuple[int, int], codes: Sequence[str], feature_px: float
) -> Image:
    """A picture of patches about `feature_px` wide in the given colours, with fine noise added."""
    random = generator(name)
    grey = cells(shape, feature_px, random)
    colors = np.stack([color(code) for code in codes])
    patches = colors[np.minimum((grey * len(codes)).astype(int), len(codes) - 1)]
    return shaded(patches, 0.5 * (noise(shape, 0.3 * feature_px, 2, random) - 0.5))


def planks(
    name: str,
    shape: tuple[int, int],
    plank_px: float,
    codes: Sequence[str],
    upright: bool = False,
) -> Image:
    """A picture of wooden boards, horizontal or `upright`: grain along the boards, dark gaps between them."""
    random = generator(name)
    height, width = shape[::-1] if upright else shape
    y = np.arange(height, dtype=np.float32)
    board = (y / plank_px).astype(int)
    tint = random.random(int(board.max()) + 1, dtype=np.float32)
    # Features are eight times as long as wide. Each board is cut from another place of the same wood.
    wood = noise((2 * height, width // 8 + 2), 0.3 * plank_px, 4, random)
    rows = (np.arange(height) + 37 * board) % wood.shape[0]
    columns = np.arange(width) / 8
    left = columns.astype(int)
    part = (columns - left).astype(np.float32)[None]
    grain = wood[rows][:, left] * (1 - part) + wood[rows][:, left + 1] * part
    factor = 0.3 * tint[board][:, None] + 0.7 * grain
    boards = ramp(factor, np.linspace(0.15, 0.85, len(codes)).tolist(), codes)
    gap = np.clip(np.minimum(y % plank_px, -y % plank_px) / 2.5, 0.25, 1)[:, None]
    boards *= gap[..., None]
    result = shaded(boards, 0.25 * (noise((height, width), 5, 2, random) - 0.5))
    return np.ascontiguousarray(np.swapaxes(result, 0, 1)) if upright else result


def wallpaper(
    name: str, shape: tuple[int, int], tile_px: float, codes: Sequence[str]
) -> Image:
    """A picture of wallpaper with flowers in a staggered grid, slightly faded.

    `codes` are the colours of the ground, the leaves, the petals and the flowers' centres.
    """
    random = generator(name)
    y, x = np.meshgrid(*(np.arange(n, dtype=np.float32) for n in shape), indexing="ij")
    row = np.floor(y / tile_px)
    v = y / tile_px - row - 0.5
    shifted = x / tile_px + 0.5 * (row % 2)
    column = np.floor(shifted)
    u = shifted - column - 0.5
    turn = (2.4 * row + 1.7 * column) % (2 * np.pi)
    radius, angle = np.hypot(u, v), np.arctan2(v, u) + turn
    petals = 0.24 + 0.10 * np.cos(5 * angle)
    leaves = 0.36 + 0.12 * np.cos(3 * angle + 1.0)
    sharp = tile_px / 2
    image = np.broadcast_to(color(codes[0]), (*shape, 3)).astype(np.float32)
    for inside, code in (
        (leaves - radius, codes[1]),
        (petals - radius, codes[2]),
        (0.09 - radius, codes[3]),
    ):
        image = blended(image, np.clip(inside * sharp + 0.5, 0, 1), code)
    fade = noise(shape, 2 * tile_px, 3, random) - 0.5
    grain = noise(shape, 0.08 * tile_px, 2, random) - 0.5
    return shaded(image, 0.3 * fade + 0.25 * grain)


def blended(image: Image, amount: Image, code: str) -> Image:
    """Blend an image towards a colour; `amount` is the colour's weight at each pixel, from 0 to 1."""
    return (image + amount[..., None] * (color(code) - image)).astype(np.float32)


def shaded(image: Image, amount: Image) -> Image:
    """Brighten an image where `amount` is positive, darken it where negative; values are clipped to 0.04 to 0.96.

    This range prevents that the scene's light clips colours in renderings.
    """
    return np.clip(
        image + amount[..., None] * (0.35 + 0.65 * image), 0.04, 0.96
    ).astype(np.float32)
