"""Thin objects in front of wooden boards: a wheel's spokes, a wire fence, and cables.

Depths from the rig: fence 1.35 m, wheel 1.6 m, swinging cables 1.8 m, boards 2.2 m. At 640x480, spokes and wires are
one to three pixels wide. The wheel moves up and down by up to 10 pixels a frame. It also rotates, so that its rim moves
by up to 30 pixels a frame.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from . import backdrop, kit, paint

RIG_HEIGHT_M = 1.2
SPOKES = 18


def ring(name: str, material: Any, radius_m: float, thickness_m: float) -> Any:
    """A torus whose plane faces the rig."""
    angles = np.linspace(0, math.tau, 97)
    centres = [(radius_m * math.cos(a), 0.0, radius_m * math.sin(a)) for a in angles]
    return kit.lofted(
        name, material, kit.tube(centres, [(thickness_m,) * 2] * 97, (0, 1, 0), 10)
    )


def rod(start_m: tuple[float, ...], end_m: tuple[float, ...], radius_m: float) -> Any:
    """The surface of a straight wire, as rings for `kit.lofted`."""
    centres = np.linspace(start_m, end_m, 4)
    upright = (0, 1, 0) if abs(end_m[1] - start_m[1]) < 0.05 else (0, 0, 1)
    return kit.tube(centres.tolist(), [(radius_m, radius_m)] * 4, upright, 6)


def wheel() -> Any:
    """A bicycle wheel with a radius of 27 cm: tyre, rim, crossed spokes, hub and reflector."""
    rubber = kit.printed(
        "tyre", paint.patchwork("tyre", (40, 900), ("1c1c1e", "2a2a2d", "b8b0a0"), 18)
    )
    tyre = ring("wheel", rubber, 0.27, 0.013)
    ring("rim", kit.ink("steel", "b9bdc4"), 0.25, 0.006).parent = tyre
    silver = kit.ink("spoke", "d8dce2")
    spokes = []
    for k in range(SPOKES):
        outer = math.tau * k / SPOKES
        inner = outer + (1.2 if k % 2 else -1.2)
        side = 0.012 if k % 4 < 2 else -0.012
        spokes.append(
            rod(
                (0.022 * math.cos(inner), side, 0.022 * math.sin(inner)),
                (0.25 * math.cos(outer), 0.0, 0.25 * math.sin(outer)),
                0.0016,
            )
        )
    kit.skinned("spokes", [(silver, rings) for rings in spokes]).parent = tyre
    hub = kit.lofted(
        "hub",
        kit.ink("hub", "c23b22"),
        kit.tube(
            [(0, y, 0) for y in (-0.021, -0.02, 0.02, 0.021)],
            [(r, r) for r in (0.001, 0.024, 0.024, 0.001)],
            (0, 0, 1),
            24,
        ),
    )
    hub.parent = tyre
    flag = kit.Sheet()
    flag.rectangle(kit.ink("reflector", "e8842c"), (-0.02, 0.13), (0.04, 0.06))
    flag.build("reflector").parent = tyre
    return tyre


def fence() -> None:
    """Add a fence of wire netting with rhombic meshes."""
    wire = kit.ink("wire", "6f8f5f")
    wires = []
    for k in range(-5, 9):
        for slope in (-1, 1):
            x = 0.06 * k
            wires.append(
                rod(
                    (x, 0.002 * slope, -0.5 if slope > 0 else 0.22),
                    (x + 0.72, 0.002 * slope, 0.22 if slope > 0 else -0.5),
                    0.0018,
                )
            )
    netting = kit.skinned("netting", [(wire, rings) for rings in wires])
    netting.location = (0.08, 1.35, RIG_HEIGHT_M + 0.02)
    netting.rotation_euler.z = 0.12


def cable(number: int, x_m: float, length_m: float) -> None:
    """Add a cable that hangs and swings, with a tag at its end. `number` varies its colour and its motion."""
    cord = kit.ink(f"cord {number}", ("1f1f24", "7d1d1d", "1d3557")[number % 3])
    hung = kit.lofted("cable", cord, rod((0, 0, -length_m), (0, 0, 0), 0.0025))
    hung.location = (x_m, 1.8, RIG_HEIGHT_M + 0.75)
    tag = kit.box(
        "tag",
        backdrop.photo(
            f"tag {number}",
            (0.05, 0.07),
            ("1d3557", "e9c46a", "f1faee", "9d0208", "2a9d8f"),
            0.012,
        ),
        (0.05, 0.008, 0.07),
        (0, 0, -length_m - 0.07),
    )
    tag.parent = hung
    kit.drive(
        hung, "rotation_euler", 1, f"0.22*sin({3.3 + 0.35 * number}*{{t}} + {number})"
    )
    kit.drive(hung, "rotation_euler", 0, f"0.10*sin({4.1 - 0.3 * number}*{{t}})")


def build() -> None:
    """Build this scene in the empty Blender file that is open."""
    kit.start_scene()
    kit.place_rig((0, 0, RIG_HEIGHT_M), (0, 2, RIG_HEIGHT_M))
    kit.sky(brightness=0.85, contrast=0.4, brightest=(-0.5, -0.6, 0.8))
    backdrop.boards(
        2.2, RIG_HEIGHT_M, ("3f5a63", "6f8f97", "a8bfc0", "d8e0d8"), upright=False
    )
    fence()
    for number, (x_m, length_m) in enumerate(
        ((-0.62, 0.75), (-0.30, 0.45), (0.28, 0.6), (0.60, 0.9))
    ):
        cable(number, x_m, length_m)
    rolling = wheel()
    kit.drive(rolling, "location", 0, "-0.22 + 0.06*sin(4.4*{t})")
    rolling.location.y = 1.6
    kit.drive(
        rolling, "location", 2, f"{RIG_HEIGHT_M} - 0.05 + 0.13*sin(5.2*{{t}} + 0.4)"
    )
    kit.drive(rolling, "rotation_euler", 1, "1.4*sin(3.7*{t} + 0.2)")
    kit.drive(rolling, "rotation_euler", 2, "0.35 + 0.15*sin(2.9*{t})")
