"""Backgrounds of the scenes: walls, floors, posters and bookshelves, with textures that have detail at every scale."""

from __future__ import annotations

from typing import Any

import numpy as np

from . import kit, paint

TEXEL_M = 0.003


def photo(
    name: str, size_m: tuple[float, float], codes: tuple[str, ...], feature_m: float
) -> Any:
    """A material that resembles a printed photograph, with texels of 1.5 mm, finer than the cameras can resolve."""
    texel_m = 0.0015
    shape = (round(size_m[1] / texel_m), round(size_m[0] / texel_m))
    return kit.printed(name, paint.photo(name, shape, codes, feature_m / texel_m))


def wall(
    name: str, picture: paint.Image, depth_m: float, centre_height_m: float
) -> None:
    """Add an upright wall that faces the rig, with this picture; each of its pixels has the size `TEXEL_M`."""
    height_m, width_m = (n * TEXEL_M for n in picture.shape[:2])
    plane = kit.Sheet()
    plane.rectangle(
        kit.printed(name, picture), (-width_m / 2, -height_m / 2), (width_m, height_m)
    )
    plane.build(name).location = (0, depth_m, centre_height_m)


def shape_of(width_m: float, height_m: float) -> tuple[int, int]:
    """The shape (rows, columns) of the picture for a wall of this size."""
    return (round(height_m / TEXEL_M), round(width_m / TEXEL_M))


def bricks(depth_m: float, centre_height_m: float) -> None:
    """Add a wall of bricks in many colours, 3.2 x 2.6 m."""
    picture = paint.bricks(
        "bricks",
        shape_of(3.2, 2.6),
        (0.075 / TEXEL_M, 0.17 / TEXEL_M),
        ("8a4020", "b5602f", "d9a878", "9c5a3c", "c98a5a"),
        "e4ddd0",
    )
    wall("wall", picture, depth_m, centre_height_m)


def flowers(
    depth_m: float,
    centre_height_m: float,
    codes: tuple[str, ...] = ("e9dfc7", "7d9a6a", "b8556b", "e2b04a"),
) -> None:
    """Add a wall with flowered wallpaper, 3.4 x 2.6 m."""
    picture = paint.wallpaper("flowers", shape_of(3.4, 2.6), 0.12 / TEXEL_M, codes)
    wall("wall", picture, depth_m, centre_height_m)


def boards(
    depth_m: float,
    centre_height_m: float,
    codes: tuple[str, ...] = ("4a2f1b", "8a5a30", "c08a50", "e0bd84"),
    upright: bool = True,
) -> None:
    """Add a wall of wooden boards, 3.4 x 2.6 m."""
    picture = paint.planks("boards", shape_of(3.4, 2.6), 0.14 / TEXEL_M, codes, upright)
    wall("wall", picture, depth_m, centre_height_m)


def floor(near_m: float, far_m: float, height_m: float) -> None:
    """Add a wooden floor from the depth `far_m` towards the rig, to the depth `near_m`."""
    depth_m = far_m - near_m
    picture = paint.planks(
        "floor",
        shape_of(3.4, depth_m),
        0.11 / TEXEL_M,
        ("5a3a22", "94633a", "b98a58", "d9b88a"),
    )
    plane = kit.Sheet()
    plane.rectangle(kit.printed("floor", picture), (-1.7, 0.0), (3.4, depth_m))
    lying = plane.build("floor")
    lying.location = (0, near_m, height_m)
    lying.rotation_euler.x = -np.pi / 2


def poster(
    title: str,
    codes: tuple[str, ...],
    centre_m: tuple[float, float, float],
) -> None:
    """Add a poster, 38 x 50 cm, with a title above a picture."""
    name = title.replace("\n", " ").lower()
    sheet = kit.Sheet()
    sheet.rectangle(kit.ink(f"{name} edge", "efe9dc"), (-0.19, -0.25), (0.38, 0.50))
    picture_m = (0.34, 0.28)
    picture = photo(name, picture_m, codes, 0.028)
    sheet.rectangle(picture, (-0.17, -0.23), picture_m, layer=1)
    sheet.centred_text(kit.ink(f"{name} ink", "1a1a1a"), title, (0.0, 0.155), 0.10)
    sheet.build(name).location = centre_m


def books(depth_m: float, centre_height_m: float, shelves: int = 4) -> None:
    """Add bookshelves, 3.2 m wide, full of books of different sizes whose backs protrude by different lengths."""
    random = paint.generator("books")
    columns, per_book_px, height_px = 24, 24, 200
    spines = paint.generator("spines")
    atlas = np.concatenate(
        [_spine(k, per_book_px, height_px, spines) for k in range(columns)], axis=1
    )
    atlas = paint.shaded(
        atlas, 0.3 * (paint.noise(atlas.shape[:2], 5, 2, spines) - 0.5)
    )
    cloth = kit.printed("books", atlas)
    wood = kit.printed(
        "shelf",
        paint.planks("shelf", (16, 800), 16, ("4a2f1b", "7a5030", "a87848")),
    )
    back = kit.printed(
        "back", paint.planks("back", (400, 500), 40, ("241811", "3c2a1c", "54402c"))
    )
    spacing_m = 0.36
    bottom_m = centre_height_m - spacing_m * shelves / 2
    kit.box("back", back, (3.2, 0.02, spacing_m * shelves), (0, depth_m, bottom_m))
    for shelf in range(shelves + 1):
        height_m = bottom_m + shelf * spacing_m
        kit.box("shelf", wood, (3.2, 0.24, 0.025), (0, depth_m - 0.12, height_m))
        if shelf == shelves:
            break
        x_m, number = -1.55, 0
        while x_m < 1.5:
            width_m, tall_m, out_m = (
                float(random.uniform(*span))
                for span in ((0.025, 0.06), (0.22, 0.31), (0.13, 0.22))
            )
            column = int(random.integers(columns))
            inset = 1.5 / atlas.shape[1]
            part = (column / columns + inset, 0, (column + 1) / columns - inset, 1)
            place = (x_m + width_m / 2, depth_m - out_m / 2, height_m + 0.025)
            kit.box("book", cloth, (width_m, out_m, tall_m), place, part=part)
            x_m += width_m + (0.001 if random.random() < 0.94 else 0.05)
            number += 1


def _spine(k: int, width_px: int, height_px: int, random: np.random.Generator) -> Any:
    """The picture of one book's spine: cloth, bands, and a title as a row of strokes."""
    codes = ("7d1d1d", "1d3557", "2f5d3a", "c9a227", "5a3d6b", "d8cfb8", "1f1f24")
    inks = ("f0e3b4", "e9c46a", "f4f1de", "2b1b12", "f0e3b4", "7a2f1c", "c0c0c0")
    image = np.broadcast_to(
        paint.color(codes[k % len(codes)]), (height_px, width_px, 3)
    ).copy()
    image *= random.uniform(0.75, 1.15)
    ink = paint.color(inks[k % len(inks)])
    for band in random.integers(6, height_px - 8, 3):
        image[band : band + 3] = ink
    low, y = int(random.integers(25, 50)), 0
    for y in range(low, low + int(random.integers(70, 120)), 5):
        left = int(random.integers(4, 9))
        right = width_px - int(random.integers(4, 9))
        if random.random() < 0.85:
            image[y : y + 3, left:right] = ink
    return np.clip(image, 0, 1).astype(np.float32)
