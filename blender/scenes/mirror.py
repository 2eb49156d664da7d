"""Highlights and reflections on polished metal, which move over the surfaces that show them.

Depths from the rig: kettle 1.35 m, tray 1.55 m, bowl 1.8 m, wallpaper 2.2 m. Reflections have another depth and another
motion than the metal, and look different to each camera. At 640x480 the tray moves 5 to 14 pixels a frame. Workbench
renders no reflections.
"""

from __future__ import annotations

import math
from typing import Any

from . import backdrop, kit, paint

RIG_HEIGHT_M = 1.2


def window(x_m: float, material: Any) -> None:
    """Add a wall behind the rig, which is reflected by the metal."""
    sheet = kit.Sheet()
    sheet.rectangle(material, (-1.2, -1.0), (2.4, 2.0))
    behind = sheet.build("behind")
    behind.location = (x_m, -1.6, RIG_HEIGHT_M)
    behind.rotation_euler.z = math.pi


def build() -> None:
    """Build this scene in the empty Blender file that is open."""
    kit.start_scene()
    kit.place_rig((0, 0, RIG_HEIGHT_M), (0, 2, RIG_HEIGHT_M))
    kit.sky(
        brightness=0.7, contrast=0.5, brightest=(-0.5, -0.6, 0.8), seen_in_mirrors=True
    )
    kit.sun(2.2, (0.5, 0.8, -0.9), angle_deg=6.0)
    backdrop.flowers(2.2, RIG_HEIGHT_M, ("3a4a5c", "7d9a6a", "d8b04a", "b8556b"))
    window(
        1.6,
        kit.printed(
            "room",
            paint.wallpaper(
                "room", (300, 360), 60, ("efe2c4", "a3282f", "1f3a5f", "e2b04a")
            ),
        ),
    )
    window(
        -1.7,
        kit.printed(
            "doors",
            paint.planks(
                "doors", (300, 360), 30, ("2a1a10", "8a5a30", "e0bd84"), upright=True
            ),
        ),
    )
    board = kit.printed(
        "table", paint.planks("table", (120, 800), 40, ("4a2f1b", "8a5a30", "c08a50"))
    )
    kit.box("table", board, (3.0, 0.9, 0.05), (0, 1.7, RIG_HEIGHT_M - 0.55))
    tray()
    kettle()
    bowl_and_ball()


def tray() -> None:
    """Add a polished tray that swings, with a printed ring on it."""
    metal = kit.turned(
        "tray",
        kit.polished("tray", "d8d4cc", 0.08),
        [
            (0.001, 0),
            (0.17, 0.0),
            (0.19, 0.008),
            (0.21, 0.03),
            (0.215, 0.03),
            (0.215, 0.026),
        ],
        72,
    )
    metal.rotation_mode = "XYZ"
    kit.drive(metal, "location", 0, "-0.16 + 0.06*sin(4.7*{t} + 0.8)")
    kit.drive(metal, "location", 1, "1.55")
    kit.drive(
        metal, "location", 2, f"{RIG_HEIGHT_M} + 0.10 + 0.16*sin(5.3*{{t}} - 0.4)"
    )
    kit.drive(metal, "rotation_euler", 0, "1.25 + 0.25*sin(4.4*{t})")
    kit.drive(metal, "rotation_euler", 1, "0.25*sin(3.8*{t} + 1.0)")
    badge = kit.turned(
        "badge",
        kit.printed(
            "badge",
            paint.patchwork("badge", (120, 400), ("7a1f2a", "e2b04a", "1f3a5f"), 20),
        ),
        [(0.095, 0.0015), (0.125, 0.0015)],
        72,
    )
    badge.parent = metal


def kettle() -> None:
    """Add a copper kettle that rocks."""
    copper = kit.turned(
        "kettle",
        kit.polished("copper", "d08a5a", 0.12),
        [
            (0.001, 0),
            (0.12, 0),
            (0.15, 0.05),
            (0.15, 0.11),
            (0.11, 0.18),
            (0.05, 0.22),
            (0.05, 0.235),
            (0.02, 0.25),
            (0.001, 0.28),
        ],
        64,
    )
    copper.location = (0.36, 1.35, RIG_HEIGHT_M - 0.50)
    kit.drive(copper, "rotation_euler", 0, "0.10*sin(4.9*{t})")


def bowl_and_ball() -> None:
    """Add a static glazed bowl, and a chrome ball that swings."""
    bowl = kit.turned(
        "bowl",
        kit.polished("glaze", "3f8f8a", 0.25),
        [
            (0.06, 0),
            (0.12, 0.03),
            (0.17, 0.10),
            (0.18, 0.16),
            (0.172, 0.16),
            (0.15, 0.08),
        ],
        64,
    )
    bowl.location = (-0.48, 1.8, RIG_HEIGHT_M - 0.50)
    ball = kit.turned(
        "ball",
        kit.polished("chrome", "f0f0f0", 0.03),
        kit.sphere_profile(0.10, 0.0, 40),
        64,
    )
    kit.drive(ball, "location", 0, "0.42 + 0.07*sin(4.1*{t} + 2.2)")
    kit.drive(ball, "location", 1, "1.85")
    kit.drive(ball, "location", 2, f"{RIG_HEIGHT_M} + 0.22 + 0.13*sin(5.0*{{t}} + 1.2)")
