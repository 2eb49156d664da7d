"""A globe, a disc and a box spin at 20 to 25 degrees a frame, and drift slowly.

Depths from the rig: globe 1.3 m, disc 1.6 m, box 1.85 m, shelf 1.9 m, bricks 2.2 m. At 640x480 the globe's surface
moves up to 40 pixels a frame, the disc's rim 30, the box's corners 24. The globe's displacement changes by up to 15
pixels from frame to frame. The axes are tilted, so that much of the motion crosses the epipolar lines. Points near an
axis move slowly; points far from it are visible for only a few frames.
"""

from __future__ import annotations

import math
from typing import Any

from . import backdrop, kit, paint

RIG_HEIGHT_M = 1.2


def axle(name: str, lean_rad: tuple[float, float], rad_s: float, spun: Any) -> Any:
    """Animate a body to spin about its own Z axis at `rad_s`. Returns its parent: a tilted axle that can be moved.

    `lean_rad` are the axle's rotations about X and Y.
    """
    leaning = kit.group(name)
    leaning.rotation_euler = (lean_rad[0], lean_rad[1], 0.0)
    spun.parent = leaning
    kit.drive(spun, "rotation_euler", 2, f"{rad_s}*{{t}} + 0.3")
    return leaning


def globe() -> Any:
    """A globe with a diameter of 26 cm; the object's origin is its centre."""
    colours = ("14304f", "2f6f9f", "e8dcb8", "7d9a4a", "b5502f")
    return kit.turned(
        "globe",
        kit.printed("globe", paint.photo("globe", (320, 640), colours, 18)),
        kit.sphere_profile(0.13, 0.0),
    )


def disc() -> Any:
    """A printed disc with a diameter of 34 cm, whose axis is the object's Z axis; its front faces +Z."""
    rim = kit.printed(
        "rim",
        paint.patchwork("rim", (60, 900), ("1c1c1e", "b8b0a0", "c23b22", "e9c46a"), 28),
    )
    whole = kit.turned(
        "disc", rim, [(0.002, -0.012), (0.17, -0.012), (0.17, 0.0), (0.002, 0.0)], 72
    )
    print_ = kit.printed(
        "rosette",
        paint.patchwork(
            "rosette",
            (320, 320),
            ("d9412b", "f3c531", "f7f4ec", "2b62b8", "241a1a"),
            34,
        ),
    )
    front = kit.Sheet()
    front.rectangle(print_, (-0.118, -0.118), (0.236, 0.236))
    front.centred_text(kit.ink("black", "161412"), "SPIN", (0, 0.03), 0.075)
    front.centred_text(kit.ink("black", "161412"), "ROUND", (0, -0.08), 0.06)
    sheet = front.build("front")
    sheet.rotation_euler.x = -math.pi / 2
    sheet.location.z = 0.0006
    sheet.parent = whole
    return whole


def crate() -> Any:
    """An upright box; the object's origin is its centre."""
    colours = ("2b1d0e", "7f5530", "f0dcae", "3f7a6a", "a0352a")
    return kit.box(
        "crate",
        backdrop.photo("spun crate", (0.2, 0.24), colours, 0.026),
        (0.20, 0.16, 0.24),
        (0, 0, -0.12),
    )


def build() -> None:
    """Build this scene in the empty Blender file that is open."""
    kit.start_scene()
    kit.place_rig((0, 0, RIG_HEIGHT_M), (0, 2, RIG_HEIGHT_M))
    kit.sky(brightness=0.85, contrast=0.4, brightest=(-0.5, -0.6, 0.8))
    backdrop.bricks(2.2, RIG_HEIGHT_M)
    plaster = kit.Sheet()
    plaster.rectangle(kit.ink("plaster", "c9beaa"), (-0.30, -0.20), (0.60, 0.40))
    plaster.build("plaster").location = (-0.50, 2.19, RIG_HEIGHT_M + 0.38)
    planks = kit.printed(
        "shelf",
        paint.planks("spin shelf", (80, 800), 40, ("4a2f1b", "8a5a30", "c08a50")),
    )
    kit.box("shelf", planks, (3.0, 0.3, 0.04), (0, 1.95, RIG_HEIGHT_M - 0.50))

    # 13.2 rad/s: 25 degrees in a thirtieth of a second.
    turning = axle("globe axle", (0.35, 0.75), 13.2, globe())
    kit.drive(turning, "location", 0, "-0.24 + 0.05*sin(6.5*{t})")
    kit.drive(turning, "location", 1, "1.30 + 0.03*sin(5*{t})")
    kit.drive(
        turning, "location", 2, f"{RIG_HEIGHT_M} - 0.14 + 0.05*sin(8*{{t}} + 1.0)"
    )
    flat = axle("disc axle", (1.35, 0.15), -10.5, disc())
    kit.drive(flat, "location", 0, "0.20 + 0.06*sin(5*{t} + 1.0)")
    kit.drive(flat, "location", 1, "1.60")
    kit.drive(flat, "location", 2, f"{RIG_HEIGHT_M} + 0.16 + 0.06*sin(6.3*{{t}})")
    boxed = axle("crate axle", (-0.30, -0.70), 11.5, crate())
    kit.drive(boxed, "location", 0, "0.36 + 0.07*sin(5.4*{t} + 2.5)")
    kit.drive(boxed, "location", 1, "1.85")
    kit.drive(boxed, "location", 2, f"{RIG_HEIGHT_M} - 0.28 + 0.05*sin(7*{{t}})")

    mast = kit.turned(
        "mast", kit.ink("mast", "2b2f36"), [(0.003, -0.46), (0.003, 0.7)], segments=8
    )
    mast.location = (-0.02, 1.95, RIG_HEIGHT_M)
