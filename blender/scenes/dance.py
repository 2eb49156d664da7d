"""A figure dances in front of a plain green cloth, which surrounds it and continues along the floor.

This scene is for arrays whose cameras surround it, such as `tests/bench/dome12.json`. The textured limbs rotate against
each other, and occlude each other and the body; each camera sees at most half of their surfaces. The cloth has soft
folds, but no texture to match.

Depths from the rig: figure 1.6 to 2.5 m, cloth and floor 1.6 to 3.5 m. In images of 640x480, the median speed of moving
pixels is 10 to 17 pixels a frame, and a tenth of them moves by more than 18 to 24. In images of `dome12` at 1024x1224,
these speeds are 17 to 32 and 33 to 45.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from . import kit, paint

RIG_HEIGHT_M = 1.2
FLOOR_M = 0.52
CENTRE_M = (0.0, 2.0)
"""The centre of the stage (x, y), at which all cameras of a surrounding array look."""
CLOTH_RADIUS_M = 1.5
TEMPO = 1.45
"""Factor on the speed of the dance: expressions in this file are evaluated at `TEMPO` times the world time."""


def cloth() -> None:
    """Add the background: a half cylinder of cloth, which bends at its foot into a floor of the same colour."""
    shape = (500, 900)
    random = paint.generator("cloth")
    folds = paint.noise(shape, 120, 2, random)
    picture = np.broadcast_to(paint.color("58a873"), (*shape, 3)).astype(np.float32)
    material = kit.printed("cloth", paint.shaded(picture, 0.16 * (folds - 0.5)))
    # The profile from the top down, then along the bend at the foot of the cloth.
    bend_m = 0.25
    profile = [(CLOTH_RADIUS_M, 3.6 - 0.3 * k) for k in range(10)]
    profile += [
        (
            CLOTH_RADIUS_M - bend_m * (1 - math.cos(turn)),
            bend_m * (1 - math.sin(turn)),
        )
        for turn in np.linspace(0.0, math.pi / 2, 9)
    ]
    # An arc around the stage, open towards the rig: one way along the front of the cloth, back along its rear.
    angles = np.linspace(math.radians(-35), math.radians(215), 97)
    there = np.stack([np.cos(angles), np.sin(angles), np.zeros_like(angles)], axis=1)
    thickness_m = 0.01
    rings = np.array(
        [
            np.concatenate(
                [
                    r * there + (0.0, 0.0, z),
                    (r + thickness_m) * there[::-1] + (0.0, 0.0, z - thickness_m),
                ]
            )
            for r, z in profile
        ]
    )
    hung = kit.lofted("cloth", material, rings)
    hung.location = (*CENTRE_M, FLOOR_M)
    floor = kit.Sheet()
    floor.rectangle(kit.ink("floor", "58a873"), (-6.0, -6.0), (12.0, 12.0))
    laid = floor.build("floor")
    laid.rotation_euler.x = -math.pi / 2
    laid.location = (*CENTRE_M, FLOOR_M - 0.002)


def limb(
    name: str,
    material: Any,
    size_m: tuple[float, float, float],
    parent: Any,
    joint_m: tuple[float, float, float],
) -> Any:
    """A rounded limb that hangs down from its joint, which is the object's origin.

    `size_m` is the limb's length, its radius at the joint, and its radius at the other end. `joint_m` is the joint's
    position relative to `parent`.
    """
    length_m, from_m, to_m = size_m
    centres = [(0.0, 0.0, 0.6 * from_m), (0.0, 0.0, 0.35 * from_m)]
    radii = [(0.45 * from_m, 0.45 * from_m), (0.85 * from_m, 0.85 * from_m)]
    for at in np.linspace(0.0, 1.0, 12):
        # A muscle's bulge in its upper half.
        radius_m = (
            from_m + (to_m - from_m) * at + 0.12 * from_m * math.sin(math.pi * at)
        )
        centres.append((0.0, 0.0, -length_m * at))
        radii.append((radius_m, radius_m))
    centres += [(0.0, 0.0, -length_m - 0.5 * to_m), (0.0, 0.0, -length_m - 0.8 * to_m)]
    radii += [(0.8 * to_m, 0.8 * to_m), (0.3 * to_m, 0.3 * to_m)]
    made = kit.lofted(name, material, kit.tube(centres, radii, (0, 1, 0), 24))
    made.parent, made.location = parent, joint_m
    return made


def cloth_of(name: str, codes: tuple[str, ...], spacing_px: float) -> Any:
    """The material of a printed fabric with patches of these colours, about `spacing_px` texels wide."""
    return kit.printed(name, paint.patchwork(name, (260, 240), codes, spacing_px))


def torso(body: Any) -> None:
    """Add the torso to the body: hips, waist, chest and neck, in a patched shirt."""
    shirt = cloth_of("shirt", ("c8362b", "f1c84b", "f4efe2", "1f3f7a", "261d1d"), 22)
    outline = [
        (-0.10, 0.050, 0.045),
        (-0.08, 0.105, 0.080),
        (0.00, 0.120, 0.088),
        (0.10, 0.098, 0.072),
        (0.20, 0.118, 0.082),
        (0.30, 0.138, 0.085),
        (0.36, 0.120, 0.070),
        (0.39, 0.060, 0.050),
        (0.42, 0.036, 0.036),
        (0.47, 0.034, 0.034),
    ]
    heights = np.linspace(outline[0][0], outline[-1][0], 36)
    z, across, thick = (np.array(column) for column in zip(*outline, strict=True))
    radii = [
        (float(np.interp(h, z, across)), float(np.interp(h, z, thick))) for h in heights
    ]
    rings = kit.tube([(0.0, 0.0, h) for h in heights], radii, (0, 1, 0), 40)
    kit.lofted("torso", shirt, rings).parent = body


def head(body: Any) -> Any:
    """Add a head with a painted face and a woollen cap to the body."""
    shape = (240, 480)
    face = paint.ramp(
        paint.noise(shape, 30, 3, paint.generator("face")),
        (0.2, 0.5, 0.8),
        ("b0704f", "d49a78", "e9c3a6"),
    )
    y, x = np.meshgrid(*(np.arange(n, dtype=np.float32) for n in shape), indexing="ij")

    def spot(u: float, v: float, wide: float, high: float) -> paint.Image:
        inside = ((x - u) / wide) ** 2 + ((y - v) / high) ** 2 < 1
        return inside.astype(np.float32)

    # The front, -y, is three quarters around.
    for u, v, wide, high, code in (
        (342, 128, 10, 6, "f6f2ea"),
        (378, 128, 10, 6, "f6f2ea"),
        (343, 128, 4, 5, "20303c"),
        (377, 128, 4, 5, "20303c"),
        (360, 108, 5, 9, "a8643f"),
        (360, 84, 16, 4, "8c2f2f"),
    ):
        face = paint.blended(face, spot(u, v, wide, high), code)
    knit = paint.patchwork("cap", shape, ("3b2a6b", "8a63b8", "e3d7ee", "c04a6e"), 14)
    face = np.where((y > 160)[..., None], knit, face)
    made = kit.turned(
        "head", kit.printed("face", face), kit.sphere_profile(0.085, 0.0, 28)
    )
    made.parent, made.location, made.scale = body, (0.0, 0.0, 0.55), (0.9, 1.0, 1.15)
    return made


def drive(target: Any, path: str, axis: int, expression: str) -> None:
    """Animate one component of a property; `{t}` in the expression is world time in seconds times `TEMPO`."""
    kit.drive(target, path, axis, expression.replace("{t}", f"({TEMPO}*{{t}})"))


def turn(target: Any, axis: int, middle: float, amount: float, rhythm: str) -> None:
    """Animate the angle of a joint about one axis: `middle` plus `amount` times `rhythm`, radians.

    `rhythm` is an expression of `{t}` with values from -1 to 1.
    """
    drive(target, "rotation_euler", axis, f"{middle} + {amount}*{rhythm}")


def arms(body: Any) -> None:
    """Add both arms to the body; upper arms, forearms and hands swing at different rates."""
    sleeve = cloth_of("sleeve", ("c8362b", "f4efe2", "1f3f7a", "e79a3c"), 16)
    skin = kit.printed(
        "skin",
        paint.photo(
            "skin", (200, 200), ("7d4a33", "b97858", "e2b596", "93583f", "cf9a78"), 12
        ),
    )
    for side, start in ((-1, 0.3), (1, 1.9)):
        upper = limb(
            "upper arm", sleeve, (0.21, 0.042, 0.034), body, (side * 0.15, 0.0, 0.33)
        )
        turn(upper, 0, 0.15, 0.55, f"sin(6.3*{{t}} + {start})")
        turn(upper, 1, -side * 1.15, 0.75, f"sin(7.4*{{t}} + {start + 0.8})")
        fore = limb("forearm", skin, (0.20, 0.033, 0.024), upper, (0.0, 0.0, -0.215))
        turn(fore, 0, -0.65, 0.55, f"sin(8.1*{{t}} + {start + 2.0})")
        hand = limb("hand", skin, (0.07, 0.026, 0.022), fore, (0.0, 0.0, -0.215))
        turn(hand, 0, -0.2, 0.4, f"sin(9.0*{{t}} + {start})")


def legs(body: Any) -> None:
    """Add both legs to the body; they kick alternately."""
    denim = cloth_of("trousers", ("1d2f52", "34598f", "7fa1cf", "d9e2ee", "b3452c"), 18)
    shoe = kit.printed(
        "shoe", paint.patchwork("shoe", (120, 120), ("1c1a1a", "f2ede2", "c7342c"), 12)
    )
    for side, start in ((-1, 0.0), (1, 3.14)):
        thigh = limb(
            "thigh", denim, (0.29, 0.068, 0.050), body, (side * 0.065, 0.0, -0.06)
        )
        turn(thigh, 0, 0.25, 0.45, f"sin(6.3*{{t}} + {start})")
        turn(thigh, 1, -side * 0.16, 0.14, f"sin(6.3*{{t}} + {start + 1.0})")
        shin = limb("shin", denim, (0.27, 0.048, 0.034), thigh, (0.0, 0.0, -0.295))
        turn(shin, 0, -0.55, 0.45, f"sin(6.3*{{t}} + {start + 0.9})")
        foot = limb("foot", shoe, (0.11, 0.034, 0.026), shin, (0.0, 0.02, -0.285))
        turn(foot, 0, -1.2, 0.2, f"sin(6.3*{{t}} + {start})")


def build() -> None:
    """Build this scene in the empty Blender file that is open."""
    kit.start_scene()
    kit.place_rig((0, 0, RIG_HEIGHT_M), (0, 2, RIG_HEIGHT_M))
    kit.sky(brightness=0.85, contrast=0.4, brightest=(-0.5, -0.6, 0.8))
    cloth()
    body = kit.group("dancer")
    drive(body, "location", 0, "0.16*sin(5.2*{t} + 0.4)")
    drive(body, "location", 1, f"{CENTRE_M[1]} + 0.08*sin(4.1*{{t}})")
    drive(body, "location", 2, f"{RIG_HEIGHT_M} + 0.04 + 0.05*sin(9.6*{{t}} + 1.0)")
    turn(body, 2, 0.2, 0.7, "sin(4.4*{t} + 0.9)")
    turn(body, 1, 0.0, 0.10, "sin(6.1*{t})")
    torso(body)
    face = head(body)
    turn(face, 2, 0.0, 0.35, "sin(5.0*{t} + 2.2)")
    arms(body)
    legs(body)
