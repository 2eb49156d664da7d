"""Plain bodies in front of a plain wall, with almost no texture to match.

Depths from the rig: cone 1.4 m, cylinder 1.7 m, sphere 1.9 m, wall 2.4 m. The wall has very faint stains and a single
scratch. The bodies have hardly more than their outlines and their shading. At 640x480 the cylinder and the sphere move
6 to 14 pixels a frame.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from . import backdrop, kit, paint

RIG_HEIGHT_M = 1.2


def plain(name: str, code: str, stains: float) -> Any:
    """A material of one colour, with faint stains of a few grey levels; `stains` is their strength."""
    shape = (200, 400)
    image = np.broadcast_to(paint.color(code), (*shape, 3)).astype(np.float32)
    faint = paint.noise(shape, 60, 2, paint.generator(name)) - 0.5
    return kit.printed(name, paint.shaded(image, stains * faint))


def build() -> None:
    """Build this scene in the empty Blender file that is open."""
    kit.start_scene()
    kit.place_rig((0, 0, RIG_HEIGHT_M), (0, 2, RIG_HEIGHT_M))
    kit.sky(brightness=0.8, contrast=0.55, brightest=(-0.6, -0.5, 0.7))
    shape = backdrop.shape_of(3.6, 2.8)
    image = np.broadcast_to(paint.color("cfc8ba"), (*shape, 3)).astype(np.float32)
    stains = paint.noise(shape, 120, 3, paint.generator("plaster")) - 0.5
    y, x = np.meshgrid(*(np.arange(n, dtype=np.float32) for n in shape), indexing="ij")
    along = x - 0.36 * shape[1] - 0.3 * (y - 0.5 * shape[0])
    scratch = np.clip(2 - np.abs(along), 0, 1) * (np.abs(y - 0.55 * shape[0]) < 60)
    image = paint.blended(paint.shaded(image, 0.05 * stains), 0.4 * scratch, "8a8276")
    backdrop.wall("wall", image, 2.4, RIG_HEIGHT_M)
    backdrop_floor = plain("floor", "a89f90", 0.04)
    kit.box("floor", backdrop_floor, (3.6, 1.6, 0.02), (0, 1.7, RIG_HEIGHT_M - 0.62))

    cone = kit.turned("cone", plain("cone", "c56a3f", 0.05), [(0.13, 0), (0.002, 0.36)])
    cone.location = (-0.40, 1.4, RIG_HEIGHT_M - 0.60)
    post = kit.turned(
        "cylinder",
        plain("cylinder", "3f6f8f", 0.05),
        [(0.001, -0.17), (0.09, -0.17), (0.09, 0.17), (0.001, 0.17)],
    )
    kit.drive(post, "location", 0, "-0.02 + 0.16*sin(4.4*{t} + 0.3)")
    kit.drive(post, "location", 1, "1.7")
    kit.drive(post, "location", 2, f"{RIG_HEIGHT_M} + 0.10 + 0.12*sin(5.6*{{t}} - 0.5)")
    kit.drive(post, "rotation_euler", 0, "0.3 + 0.5*sin(3.6*{t})")
    kit.drive(post, "rotation_euler", 1, "0.9*sin(3.1*{t} + 1.0)")
    sphere = kit.turned(
        "sphere", plain("sphere", "b9a24a", 0.05), kit.sphere_profile(0.15, 0.0)
    )
    kit.drive(sphere, "location", 0, "0.45 + 0.06*sin(3.9*{t} + 2.0)")
    kit.drive(sphere, "location", 1, "1.9")
    kit.drive(
        sphere, "location", 2, f"{RIG_HEIGHT_M} - 0.10 + 0.22*sin(5.2*{{t}} + 0.7)"
    )
