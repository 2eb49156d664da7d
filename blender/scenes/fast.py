"""A paddle and a ball move very fast, at about 40 pixels a frame in images of 640x480.

Depths from the rig: paddle 1.35 to 1.45 m, ball 1.75 m, bricks 2.2 m. The paddle moves along a circle at constant
speed, so its motion crosses the epipolar lines of any rig. The ball bounces.
"""

from __future__ import annotations

import math
from typing import Any

from . import backdrop, kit, paint

RIG_HEIGHT_M = 1.2


def paddle() -> Any:
    """A round paddle with a diameter of 24 cm, a picture on its front, and a handle."""
    face = backdrop.photo(
        "bat", (0.75, 0.1), ("7d1020", "d23b2f", "f3e3c0", "e8a13a", "2b1b3a"), 0.03
    )
    disc = kit.turned(
        "paddle",
        face,
        [(0.002, -0.012), (0.12, -0.012), (0.12, 0.012), (0.002, 0.012)],
        64,
    )
    front = kit.Sheet()
    target = kit.printed(
        "target",
        paint.patchwork(
            "target", (280, 280), ("d9412b", "f3c531", "f7f4ec", "2b62b8", "241a1a"), 30
        ),
    )
    front.rectangle(target, (-0.083, -0.083), (0.166, 0.166))
    front.centred_text(kit.ink("black", "161412"), "FAST", (0, -0.025), 0.07)
    kit.print_in_front(disc, front, "print", 0.0125)
    grip = kit.printed(
        "grip", paint.planks("grip", (60, 200), 10, ("3a2413", "7a5030", "b98a58"))
    )
    handle = kit.box("handle", grip, (0.03, 0.17, 0.024), (0, -0.19, -0.012))
    handle.parent = disc
    return disc


def build() -> None:
    """Build this scene in the empty Blender file that is open."""
    kit.start_scene()
    kit.place_rig((0, 0, RIG_HEIGHT_M), (0, 2, RIG_HEIGHT_M))
    kit.sky(brightness=0.85, contrast=0.4, brightest=(0.5, -0.6, 0.8))
    backdrop.bricks(2.2, RIG_HEIGHT_M)
    backdrop.poster(
        "CATCH\nTHIS",
        ("0b3948", "2a9d8f", "e9ecef", "e9c46a", "9b2226"),
        (0.62, 2.19, RIG_HEIGHT_M + 0.30),
    )
    bat = paddle()
    bat.rotation_mode = "XYZ"
    # 0.30 m x 8.2 rad/s at 1.4 m: 2.46 m/s, 40 pixels in a thirtieth of a second.
    kit.drive(bat, "location", 0, "-0.04 + 0.30*cos(8.2*{t} + 2.4)")
    kit.drive(bat, "location", 1, "1.40 + 0.05*sin(5*{t})")
    kit.drive(bat, "location", 2, f"{RIG_HEIGHT_M} + 0.05 + 0.30*sin(8.2*{{t}} + 2.4)")
    kit.drive(bat, "rotation_euler", 0, "1.45 + 0.15*sin(7*{t})")
    kit.drive(bat, "rotation_euler", 1, "0.25*sin(6.1*{t} + 1)")

    colours = ("f4d35e", "ee964b", "f7f4ec", "0d3b66", "3f8f4f")
    ball = kit.turned(
        "ball",
        kit.printed("ball", paint.patchwork("ball", (200, 400), colours, 26)),
        kit.sphere_profile(0.09, 0.0),
    )
    # Bounces of 0.6 s and 0.66 m: up to 4.4 m/s where it lands, 2 m/s on average.
    kit.drive(ball, "location", 0, "0.46 + 0.10*sin(2.6*{t})")
    kit.drive(ball, "location", 1, "1.75")
    kit.drive(
        ball,
        "location",
        2,
        f"{RIG_HEIGHT_M} - 0.40 + 0.66*(1 - (2*fmod({{t}}/0.6 + 0.2, 1) - 1)**2)",
    )
    kit.drive(ball, "rotation_euler", 1, "5*{t}")
    crate = backdrop.photo(
        "crate", (0.5, 0.2), ("2b1d0e", "7f5530", "e0b878", "a06a3a", "4a3018"), 0.03
    )
    box = kit.box("crate", crate, (0.5, 0.3, 0.2), (0.45, 1.75, RIG_HEIGHT_M - 0.69))
    box.rotation_euler.z = math.radians(8)
