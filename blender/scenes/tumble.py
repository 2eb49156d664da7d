"""Two boxes bounce and tumble, and the near box passes in front of the far box.

Depths from the rig: near box 1.4 m, far box 1.75 m, stage 1.2 to 2.05 m, boards 2.2 m. At 640x480 most points of the
boxes move 15 to 30 pixels a frame, the near box to the right and the far box to the left. They pass each other at 0.2
s. The near box bounces first at 0.11 s, then every 0.3 s. The far box bounces first at 0.26 s, when the near box hides
a part of it, and then every 0.34 s.
"""

from __future__ import annotations

import math
from typing import Any

from . import backdrop, kit
from .bounce import bounce

RIG_HEIGHT_M = 1.2
STAGE_M = RIG_HEIGHT_M - 0.42
"""Height of the stage above the ground."""


def box(name: str, codes: tuple[str, ...], title: str, size_m: float) -> Any:
    """A printed cube with a word on two of its sides; the object's origin is the cube's centre."""
    middle = kit.group(name)
    print_ = backdrop.photo(name, (size_m, size_m), codes, 0.022)
    half_m = size_m / 2
    cube = kit.box(f"{name} cube", print_, (size_m, size_m, size_m), (0, 0, -half_m))
    cube.parent = middle
    for turn_deg, side in ((0.0, -1.0), (180.0, 1.0)):
        label = kit.Sheet()
        wide_m, high_m = 0.8 * size_m, 0.3 * size_m
        label.rectangle(
            kit.ink("label", "f2efe4"), (-wide_m / 2, -high_m / 2), (wide_m, high_m)
        )
        label.centred_text(
            kit.ink("black", "161412"), title, (0, -0.08 * size_m), 0.25 * size_m, 1
        )
        stuck = label.build("label")
        stuck.location = (0, side * (half_m + 0.0006), 0)
        stuck.rotation_euler.z = math.radians(turn_deg)
        stuck.parent = middle
    return middle


def build() -> None:
    """Build this scene in the empty Blender file that is open."""
    kit.start_scene()
    kit.place_rig((0, 0, RIG_HEIGHT_M), (0, 2, RIG_HEIGHT_M))
    kit.sky(brightness=0.85, contrast=0.4, brightest=(0.5, -0.6, 0.8))
    backdrop.boards(2.2, RIG_HEIGHT_M, ("3f5a63", "6f8f97", "a8bfc0", "d8e0d8"))
    screen = kit.Sheet()
    screen.rectangle(kit.ink("screen", "d0c6b0"), (-0.20, -0.24), (0.40, 0.48))
    screen.build("screen").location = (-0.50, 2.19, RIG_HEIGHT_M + 0.30)
    backdrop.poster(
        "HEADS\nTAILS",
        ("3d1f5c", "8f5fa8", "f4c6d0", "e26d5c", "ffe1a8"),
        (0.52, 2.19, RIG_HEIGHT_M + 0.24),
    )
    backdrop.floor(1.15, 2.2, STAGE_M)

    reds = ("5c0f16", "c23b2f", "f0d09a", "e8843a", "2a1014")
    near = box("near box", reds, "NEAR", 0.19)
    bounce(near, STAGE_M + 0.165, 0.11, 0.30)
    kit.drive(near, "location", 0, "0.30*sin(2.9*({t} - 0.2))")
    near.location.y = 1.4
    kit.drive(near, "rotation_euler", 0, "0.3 + 2.2*{t}")
    kit.drive(near, "rotation_euler", 1, "0.2 + 4.6*{t}")
    kit.drive(near, "rotation_euler", 2, "0.5*sin(4*{t})")

    blues = ("10203f", "2f5f9f", "f0ead0", "5aa0b0", "e0b040")
    far = box("far box", blues, "FAR", 0.21)
    bounce(far, STAGE_M + 0.182, 0.26, 0.34)
    kit.drive(far, "location", 0, "-0.36*sin(3.2*({t} - 0.2))")
    far.location.y = 1.75
    kit.drive(far, "rotation_euler", 0, "-0.2 - 1.8*{t}")
    kit.drive(far, "rotation_euler", 1, "-5.0*{t}")
    kit.drive(far, "rotation_euler", 2, "0.3 + 0.5*sin(5*{t})")
