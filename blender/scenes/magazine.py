"""An open magazine is waved, a ball swings, and a vase occludes part of the wall behind them.

Depths from the rig: vase 1.40 m, magazine 1.55 to 1.75 m, ball 1.85 m, wall 2.1 m. At 640x480 the magazine moves 10 to
20 pixels a frame along a curved path. It moves mostly up and down, across a horizontal rig's epipolar lines, and also
rotates.
"""

from __future__ import annotations

import math
from typing import Any

from . import backdrop, kit, paint
from .backdrop import photo

RIG_HEIGHT_M = 1.2

HEADLINE = "LIGHT FIELDS"
COLUMN_FRONT = "Eight cameras stood in a\nline, each with a clock"
COLUMN_LEFT = (
    "of its own. No two\nopened together,\nand yet the page\nthey saw was one\npage, in one place,\n"
    "at one moment. The\nline looked on, and\nso do we. Find the\nhour of each eye,\nand time is space."
)
COLUMN_RIGHT = (
    "Give every camera its\nown offset, and follow\neach corner as it moves.\nThen ask for the image\n"
    "at any instant, from\nany place between."
)


def magazine() -> Any:
    """The open magazine: two bulging pages with text and pictures, 62 x 42 cm."""
    paper, black, red = (
        kit.ink("paper", "f2efe4"),
        kit.ink("black", "161412"),
        kit.ink("red", "b3261e"),
    )
    harbour = photo(
        "harbour",
        (0.275, 0.20),
        ("12324a", "2f7fa8", "e8dcc0", "d98b3a", "7a2f1c"),
        0.020,
    )
    garden = photo(
        "garden",
        (0.14, 0.145),
        ("16361b", "4f8f2f", "d8d46a", "e6e0e8", "b03a72"),
        0.017,
    )
    page = kit.Sheet()
    page.rectangle(paper, (-0.31, -0.21), (0.62, 0.42))
    page.rectangle(harbour, (-0.295, -0.195), (0.275, 0.20), layer=1)
    page.rectangle(garden, (0.155, -0.045), (0.14, 0.145), layer=1)
    page.rectangle(red, (-0.295, 0.185), (0.59, 0.012), layer=1)
    page.rectangle(red, (0.02, -0.075), (0.275, 0.006), layer=1)
    page.centred_text(black, HEADLINE, (-0.158, 0.130), 0.047)
    page.centred_text(black, "in space and time", (-0.158, 0.092), 0.031)
    page.text(black, COLUMN_FRONT, (-0.29, 0.055), 0.0215)
    page.text(black, COLUMN_LEFT, (0.02, 0.160), 0.0145)
    page.text(red, "No. 4", (0.16, 0.122), 0.05)
    page.text(black, COLUMN_RIGHT, (0.02, -0.1), 0.02)

    def bulge_m(x: float, _y: float) -> float:
        return 0.035 * math.sin(math.pi * min(1.0, abs(x) / 0.31) ** 0.7) + 0.06 * abs(
            x
        )

    return page.build("magazine", bulge_m)


def wave(held: Any) -> None:
    """Animate an object as if waved by hand: up and down once a second, sideways and in rotation with other periods."""
    kit.drive(held, "location", 0, "-0.10 + 0.070*sin(5.10*{t} + 1.9)")
    kit.drive(held, "location", 1, "1.66 + 0.045*sin(4.30*{t} + 0.4)")
    kit.drive(
        held,
        "location",
        2,
        f"{RIG_HEIGHT_M} + 0.04 + 0.145*sin(6.28*{{t}} - 1.1) + 0.020*sin(13.1*{{t}})",
    )
    kit.drive(held, "rotation_euler", 0, "-0.10 + 0.22*sin(5.70*{t} - 0.3)")
    kit.drive(held, "rotation_euler", 1, "0.06 + 0.20*sin(6.28*{t} + 0.5)")
    kit.drive(held, "rotation_euler", 2, "0.12 + 0.24*sin(4.70*{t} + 2.2)")


def ball() -> Any:
    """A patterned ball on a string; the object's origin is the hook from which it hangs."""
    material = kit.printed(
        "ball",
        paint.patchwork(
            "ball", (220, 440), ("d9412b", "f3c531", "f7f4ec", "2b62b8", "3f8f4f"), 26
        ),
    )
    hung = kit.turned("ball", material, kit.sphere_profile(0.105, -0.62))
    string = kit.turned(
        "string",
        kit.ink("string", "3a3028"),
        [(0.004, -0.52), (0.004, 0.0)],
        segments=8,
    )
    string.parent = hung
    return hung


def swing(hung: Any) -> None:
    """Animate a ball as a pendulum of 0.62 m with a period of 1.58 s, mostly sideways, and spinning."""
    hung.location = (0.46, 1.86, RIG_HEIGHT_M + 0.62)
    hung.rotation_mode = "ZXY"
    kit.drive(hung, "rotation_euler", 0, "0.16*sin(3.98*{t} + 1.3)")
    kit.drive(hung, "rotation_euler", 1, "0.40*sin(3.98*{t} - 0.2)")
    kit.drive(hung, "rotation_euler", 2, "0.9*sin(2.10*{t} + 0.7)")


def wall() -> None:
    """Add the background: a brick wall with posters, and crates in front of it."""
    backdrop.bricks(2.1, RIG_HEIGHT_M)
    backdrop.poster(
        "SPACE\nTIME",
        ("1b1b3a", "693668", "f4d35e", "ee964b", "f95738"),
        (-0.72, 2.092, RIG_HEIGHT_M + 0.32),
    )
    backdrop.poster(
        "EIGHT\nEYES",
        ("0b3948", "2a9d8f", "e9ecef", "e9c46a", "9b2226"),
        (0.14, 2.092, RIG_HEIGHT_M + 0.40),
    )
    backdrop.poster(
        "KEEP\nSYNC",
        ("101418", "3a5a40", "dad7cd", "588157", "bc4749"),
        (0.68, 2.092, RIG_HEIGHT_M - 0.22),
    )
    crate = photo(
        "crate", (0.42, 0.40), ("2b1d0e", "7f5530", "e0b878", "a06a3a", "4a3018"), 0.030
    )
    tin = photo(
        "tin", (0.2, 0.3), ("0d2b45", "3d6fa5", "f0f0e8", "c9a227", "7d1d1d"), 0.022
    )
    box = kit.box(
        "crate", crate, (0.42, 0.26, 0.40), (-0.62, 1.93, RIG_HEIGHT_M - 0.75)
    )
    box.rotation_euler.z = math.radians(18)
    can = kit.box("tin", tin, (0.20, 0.20, 0.30), (0.10, 1.95, RIG_HEIGHT_M - 0.75))
    can.rotation_euler.z = math.radians(-25)


def foreground() -> None:
    """Add a painted vase close to the rig, which occludes part of the background."""
    glaze = photo(
        "glaze", (0.6, 0.4), ("14213d", "2a6f97", "f1faee", "e9c46a", "9d0208"), 0.022
    )
    profile = [
        (0.050, 0.0),
        (0.085, 0.05),
        (0.105, 0.13),
        (0.092, 0.21),
        (0.050, 0.28),
        (0.040, 0.32),
        (0.056, 0.36),
    ]
    vase = kit.turned("vase", glaze, profile)
    vase.location = (0.22, 1.42, RIG_HEIGHT_M - 0.56)


def build() -> None:
    """Build this scene in the empty Blender file that is open."""
    kit.start_scene()
    kit.place_rig((0, 0, RIG_HEIGHT_M), (0, 2, RIG_HEIGHT_M))
    kit.sky(brightness=0.85, contrast=0.4, brightest=(-0.5, -0.6, 0.8))
    wall()
    foreground()
    wave(magazine())
    swing(ball())
