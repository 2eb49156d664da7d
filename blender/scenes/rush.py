"""A disc and a parcel move at 60 to 120 pixels a frame in images of 640x480, faster than in any other scene.

Depths from the rig: disc 1.35 to 1.45 m, parcel 1.7 m, bricks 2.2 m. The disc moves along a circle, and its motion
crosses the epipolar lines of any rig. The parcel slides to and fro in the direction of the rig's line.
"""

from __future__ import annotations

from typing import Any

from . import backdrop, kit, paint

RIG_HEIGHT_M = 1.2


def disc() -> Any:
    """A disc with a patchwork texture, which faces the rig; its diameter is 18 cm."""
    colours = ("d9412b", "f3c531", "f7f4ec", "2b62b8", "241a1a")
    face = kit.printed("quilt", paint.patchwork("quilt", (320, 320), colours, 40))
    body = kit.turned(
        "disc",
        face,
        [(0.002, -0.01), (0.09, -0.01), (0.09, 0.01), (0.002, 0.01)],
        64,
    )
    sheet = kit.Sheet()
    sheet.rectangle(face, (-0.063, -0.063), (0.126, 0.126))
    kit.print_in_front(body, sheet, "front", 0.0105)
    return body


def build() -> None:
    """Build this scene in the empty Blender file that is open."""
    kit.start_scene()
    kit.place_rig((0, 0, RIG_HEIGHT_M), (0, 2, RIG_HEIGHT_M))
    kit.sky(brightness=0.85, contrast=0.4, brightest=(0.5, -0.6, 0.8))
    backdrop.bricks(2.2, RIG_HEIGHT_M)
    backdrop.poster(
        "HURRY\nUP",
        ("10002b", "5a189a", "e0aaff", "f8f9fa", "ff9e00"),
        (-0.55, 2.19, RIG_HEIGHT_M + 0.28),
    )
    body = disc()
    # 0.30 m x 15 rad/s at 1.4 m: 4.5 m/s, 73 pixels in a thirtieth of a second.
    kit.drive(body, "location", 0, "-0.05 + 0.30*cos(15*{t} + 0.4)")
    kit.drive(body, "location", 1, "1.40 + 0.05*sin(5*{t})")
    kit.drive(body, "location", 2, f"{RIG_HEIGHT_M} + 0.08 + 0.30*sin(15*{{t}} + 0.4)")
    kit.drive(body, "rotation_euler", 0, "1.5 + 0.1*sin(7*{t})")
    kit.drive(body, "rotation_euler", 1, "2*{t}")
    parcel = backdrop.photo(
        "parcel", (0.3, 0.2), ("3d2b1f", "c68b59", "f1dca7", "7f4f24", "582f0e"), 0.02
    )
    box = kit.box("parcel", parcel, (0.24, 0.12, 0.16), (0, 1.7, RIG_HEIGHT_M - 0.42))
    # 0.55 m x 16 rad/s at 1.64 m: up to 8.8 m/s, 122 pixels in a thirtieth of a second.
    kit.drive(box, "location", 0, "0.55*sin(16*{t} + 1.1)")
    kit.drive(box, "rotation_euler", 2, "0.2*sin(9*{t})")
