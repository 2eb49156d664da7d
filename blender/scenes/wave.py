"""A hand with nearly plain skin waves fast: its motion reverses five times a second.

Depths from the rig: hand and sleeve 1.0 to 1.1 m, lamp 1.45 m, boards with one plain board 2.0 m. At 640x480 the
fingertips move up to 36 pixels a frame. At a reversal, first at 0.09 s and then every 0.2 s, their displacement changes
by up to 20 pixels from frame to frame. Meanwhile, the fingers bend.
"""

from __future__ import annotations

from typing import Any

from . import backdrop, kit, paint
from .hand import hand, skin_picture

RIG_HEIGHT_M = 1.2

SKIN_CONTRAST = 0.3
"""Factor on the contrast of the skin's mottling, creases and freckles. If larger, features are found all over the hand;
if smaller, only on its outlines."""


def plain_skin(name: str, shape: tuple[int, int], joints: tuple[float, ...]) -> Any:
    """A material like `hand.skin`, with its contrast reduced by `SKIN_CONTRAST`."""
    picture = skin_picture(name, shape, joints)
    mean = picture.mean(axis=(0, 1))
    return kit.printed(name, mean + SKIN_CONTRAST * (picture - mean))


def lamp() -> None:
    """Add a lamp on a thin stem, which doesn't move."""
    shade = kit.turned(
        "shade",
        kit.printed(
            "shade",
            paint.wallpaper(
                "tulips", (200, 800), 50, ("d8e0e4", "3f6f4f", "c23b4a", "f0c040")
            ),
        ),
        [(0.14, 0.0), (0.085, 0.20)],
    )
    shade.location = (0.44, 1.45, RIG_HEIGHT_M - 0.02)
    stem = kit.turned(
        "stem", kit.ink("stem", "2b2f36"), [(0.006, -0.6), (0.006, 0.02)], segments=12
    )
    stem.location = shade.location


def build() -> None:
    """Build this scene in the empty Blender file that is open."""
    kit.start_scene()
    kit.place_rig((0, 0, RIG_HEIGHT_M), (0, 2, RIG_HEIGHT_M))
    kit.sky(brightness=0.85, contrast=0.45, brightest=(0.6, -0.6, 0.7))
    backdrop.boards(2.0, RIG_HEIGHT_M, ("2f4a44", "5f8578", "93b0a0", "cfdcc8"))
    board = kit.Sheet()
    board.rectangle(kit.ink("plain board", "c2b8a0"), (-0.20, -1.1), (0.40, 2.2))
    board.build("plain board").location = (0.16, 1.99, RIG_HEIGHT_M)
    backdrop.poster(
        "GOOD\nBYE",
        ("233d4d", "619b8a", "fcca46", "fe7f2d", "a1c181"),
        (-0.60, 1.99, RIG_HEIGHT_M + 0.16),
    )
    lamp()
    waving = hand(plain_skin, "0.5 + 0.5*sin(14*{t} + 0.4)")
    waving.scale = (1.35, 1.35, 1.35)
    # (0.065 m + 0.3 m x 0.20 rad) x (15.7 rad/s)²: 31 m/s² at the fingertips where it turns.
    kit.drive(waving, "location", 0, "-0.05 + 0.055*sin(15.7*{t} + 0.15)")
    kit.drive(waving, "location", 1, "1.05 + 0.03*sin(6.1*{t})")
    kit.drive(
        waving, "location", 2, f"{RIG_HEIGHT_M} - 0.12 + 0.035*sin(17*{{t}} + 1.3)"
    )
    kit.drive(waving, "rotation_euler", 0, "0.12*sin(9*{t} + 2.0)")
    kit.drive(waving, "rotation_euler", 1, "0.04 + 0.20*sin(15.7*{t} + 0.15)")
    kit.drive(waving, "rotation_euler", 2, "0.25*sin(7*{t})")
