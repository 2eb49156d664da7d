"""An open book moves while one of its leaves is turned.

Depths from the rig: book 1.15 to 1.35 m, cups 1.5 m, wallpaper 2.1 m. At 640x480 the book moves 6 to 17 pixels a frame,
mostly up and down. The leaf turns over in 1.1 s, and bends meanwhile.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from . import backdrop, kit, paint

RIG_HEIGHT_M = 1.2
PAGE_M = (0.24, 0.34)

LEFT = (
    "CHAPTER THE FOURTH",
    "In which eight clocks\nstrike, one after another.",
    "The first clock struck\nwhen the light came in,\nand the second a little\nafter, and nobody in the\n"
    "house could say by how\nmuch. It was agreed that\nno two of them had ever\nbeen right together.\n"
    "They were wound, oiled,\nand set by the sun.",
)
RIGHT = (
    "So the child sat down\nwith paper and a pencil\nand wrote what she saw\nat every stroke: where\n"
    "the cat was, the spoon,\nthe swinging lamp. From\nthe lamp alone, she said,\none could find it out.",
    "And she did, to within\na thousandth part of a\nsecond, before tea.",
)
LEAF = (
    "For a thing that moves\nis a hand on the dial.\nIt is seen from here, and\nseen from there; and if\n"
    "you know where you stood,\nthe two of them tell you\nwhen. There is no secret\nin it but patience.",
)


def arch_m(x: float) -> float:
    """The height of an open page above the book's plane, at the distance `x` from the spine: a bulge near the spine."""
    across = min(1.0, abs(x) / PAGE_M[0])
    return 0.030 * math.sin(math.pi * across**0.6) + 0.02 * across


def page(sheet: kit.Sheet, left_m: float, parts: tuple[str, ...], picture: Any) -> None:
    """Add one page to the sheet: text paragraphs from the top, and a picture below the text."""
    black = kit.ink("black", "191512")
    y = PAGE_M[1] / 2 - 0.035
    for part in parts:
        size = 0.0165 if part.isupper() else 0.0155
        sheet.text(black, part, (left_m + 0.022, y), size)
        y -= size * 1.0 * (part.count("\n") + 2)
    height = y + PAGE_M[1] / 2 - 0.025
    corner_m = (left_m + 0.022, -PAGE_M[1] / 2 + 0.025)
    sheet.rectangle(picture, corner_m, (0.196, height), layer=1)


def book() -> Any:
    """The open book without the turning leaf: two pages, the blocks of pages under them, and the cover."""
    width, height = PAGE_M
    paper = kit.ink("paper", "f1e9d6")
    etching = backdrop.photo(
        "etching",
        (0.2, 0.09),
        ("1d1a16", "5b5346", "d8ceb8", "8b7f6b", "322c25"),
        0.009,
    )
    plate = backdrop.photo(
        "plate", (0.2, 0.08), ("23395b", "5f8f9f", "f2e2b8", "c9703a", "5b1f2a"), 0.012
    )
    pages = kit.Sheet()
    pages.rectangle(paper, (-width, -height / 2), (2 * width, height))
    page(pages, -width, LEFT, etching)
    page(pages, 0.0, RIGHT, plate)
    opened = pages.build("pages", lambda x, _y: arch_m(x))
    cover = kit.Sheet()
    cloth = backdrop.photo(
        "cloth", (0.52, 0.37), ("3a0f14", "7a1f2a", "8f2f38", "5c161f", "a8505a"), 0.02
    )
    cover.rectangle(cloth, (-0.26, -0.185), (0.52, 0.37))
    back = cover.build("cover", lambda x, _y: -0.012 + 0.04 * abs(x))
    back.parent = opened
    # A block of pages under each side; only its outer edges are visible.
    edge = kit.printed(
        "edges", paint.planks("edges", (300, 200), 4, ("b8ab8c", "d8ccb0", "efe6d0"))
    )
    for side in (-1, 1):
        block = kit.box(
            "block", edge, (0.012, 0.03, height), (side * (width - 0.006), -0.002, 0)
        )
        block.location.z = -height / 2
        block.parent = opened
    return opened


def leaf() -> Any:
    """The leaf that is turned: it moves from the right side to the left as `LEAF_TURN` goes from 0 to 1."""
    sheet = kit.Sheet()
    sheet.rectangle(kit.ink("leaf", "f4eddc"), (0.0, -PAGE_M[1] / 2), PAGE_M)
    page(
        sheet,
        0.0,
        LEAF,
        backdrop.photo(
            "woodcut",
            (0.2, 0.1),
            ("181410", "4b6b3a", "e8dfc0", "b08030", "30402a"),
            0.01,
        ),
    )
    flat = sheet.build("leaf")
    rest = np.array([v.co for v in flat.data.vertices], dtype=np.float64)
    for step in range(1, LEAF_STEPS + 1):
        kit.bend(flat, f"turned {step}", swung(rest, step / LEAF_STEPS), hat(step))
    flat.data.vertices.foreach_set("co", swung(rest, 0.0).astype(np.float32).ravel())
    flat.data.shape_keys.key_blocks[0].data.foreach_set(
        "co", swung(rest, 0.0).astype(np.float32).ravel()
    )
    return flat


LEAF_STEPS = 8
LEAF_TURN = "(0.5 - 0.5*cos(2.9*{t} + 0.75))"
"""Driver expression for the turn of the leaf: 0 on the right, 1 on the left, with a period of 2.2 s."""


def hat(step: int) -> str:
    """Driver expression for the weight of the leaf's shape key `step`, for linear interpolation between keys."""
    return f"max(0, 1 - abs({LEAF_STEPS}*{LEAF_TURN} - {step}))"


def swung(rest_m: kit.Points, over: float) -> kit.Points:
    """The leaf's vertices when it is turned by the fraction `over`; columns farther from the spine lag behind."""
    x, layer, z = rest_m.T
    turn = math.pi * over
    lag = 0.9 * math.sin(turn) * (x / PAGE_M[0])
    angle = turn - lag
    # Integrated along the curve, not along its chord, so that the paper keeps its length.
    order = np.argsort(x, kind="stable")
    steps = np.diff(x[order], prepend=x[order][0])
    across, out = np.empty_like(x), np.empty_like(x)
    across[order] = np.cumsum(steps * np.cos(angle[order]))
    out[order] = np.cumsum(steps * np.sin(angle[order]))
    normal = np.stack([-np.sin(angle), np.cos(angle)])
    lift = np.array([arch_m(v) for v in across]) + 0.004
    return np.stack(
        [across - normal[0] * layer, -(out + lift) + normal[1] * layer, z], axis=1
    )


def build() -> None:
    """Build this scene in the empty Blender file that is open."""
    kit.start_scene()
    kit.place_rig((0, 0, RIG_HEIGHT_M), (0, 2, RIG_HEIGHT_M))
    kit.sky(brightness=0.85, contrast=0.4, brightest=(0.5, -0.7, 0.7))
    backdrop.flowers(2.1, RIG_HEIGHT_M)
    held = book()
    leaf().parent = held
    kit.drive(held, "location", 0, "-0.02 + 0.060*sin(4.9*{t} + 1.0)")
    kit.drive(held, "location", 1, "1.28 + 0.04*sin(3.9*{t})")
    kit.drive(
        held, "location", 2, f"{RIG_HEIGHT_M} + 0.01 + 0.115*sin(6.1*{{t}} - 0.6)"
    )
    kit.drive(held, "rotation_euler", 0, "-0.22 + 0.12*sin(5.1*{t} + 0.8)")
    kit.drive(held, "rotation_euler", 1, "0.05 + 0.10*sin(4.4*{t})")
    kit.drive(held, "rotation_euler", 2, "0.10*sin(3.3*{t} + 2.0)")

    china = ("f1ede2", "2b5c8a", "f7f5ee", "3f7fae", "dfe6ea")
    for name, place in (("cup", (0.52, 1.5)), ("jug", (-0.56, 1.62))):
        cup = kit.turned(
            name,
            kit.printed(name, paint.photo(name, (160, 360), china, 13)),
            [
                (0.05, 0),
                (0.09, 0.03),
                (0.105, 0.10),
                (0.10, 0.2),
                (0.085, 0.3),
                (0.10, 0.34),
            ],
        )
        cup.location = (*place, RIG_HEIGHT_M - 0.55)
    table = kit.printed(
        "table", paint.planks("table", (80, 800), 40, ("4a2f1b", "8a5a30", "c08a50"))
    )
    kit.box("table", table, (3.0, 0.5, 0.05), (0, 1.75, RIG_HEIGHT_M - 0.60))
