"""A hand in a chequered sleeve waves in front of wooden boards with posters.

Depths from the rig: hand and sleeve 1.0 to 1.1 m, plant pot 1.45 m, boards 2.0 m. At 640x480 the fingertips move up to
25 pixels a frame, along an arc with an additional vertical oscillation. Meanwhile, the fingers bend slightly.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from . import backdrop, kit, paint

RIG_HEIGHT_M = 1.2

# For each finger: the position (x, z) of its base, its lean in degrees from upright (positive towards the thumb), the
# lengths of its three bones, and its radius. Metres, with the wrist at the origin.
FINGERS = {
    "index": ((0.036, 0.094), 9.0, (0.044, 0.026, 0.022), 0.0118),
    "middle": ((0.012, 0.100), 1.0, (0.048, 0.030, 0.023), 0.0122),
    "ring": ((-0.012, 0.097), -6.0, (0.044, 0.028, 0.023), 0.0116),
    "little": ((-0.034, 0.087), -15.0, (0.034, 0.021, 0.020), 0.0102),
    "thumb": ((0.042, 0.032), 48.0, (0.044, 0.030, 0.026), 0.0142),
}
STEPS_PER_BONE = 7


def finger(name: str, curl: float) -> kit.Points:
    """The surface of a finger as rings for `kit.lofted`; each joint is bent forward by `curl` radians."""
    (x, z), lean_deg, bones_m, radius_m = FINGERS[name]
    lean = math.radians(lean_deg)
    outward = np.array([math.sin(lean), 0.0, math.cos(lean)])
    forward = np.array([0.0, -1.0, 0.0])
    place = np.array([x, 0.0, z]) - 0.022 * outward
    centres, radii, bent = [place], [radius_m * 1.08], 0.0
    for bone, length_m in enumerate((bones_m[0] + 0.022, *bones_m[1:])):
        for step in range(1, STEPS_PER_BONE + 1):
            at = step / STEPS_PER_BONE
            bent += curl / STEPS_PER_BONE if bone or at > 0.4 else 0.0
            way = math.cos(bent) * outward + math.sin(bent) * forward
            place = place + length_m / STEPS_PER_BONE * way
            centres.append(place)
            # Thinner between the joints and towards the tip.
            waist = 1.0 - 0.10 * math.sin(math.pi * at)
            radii.append(radius_m * (1.06 - 0.09 * bone) * waist)
    # A round tip.
    last_m = radii[-1]
    for turn in (0.35, 0.65, 0.88, 0.99):
        centres.append(place + turn * 0.85 * last_m * way)
        radii.append(last_m * math.sqrt(1 - turn * turn))
    across = np.cross(outward, forward)
    upright = np.cross(across, outward)
    return kit.tube(centres, [(r, 0.9 * r) for r in radii], upright)


def palm() -> kit.Points:
    """The surface of the palm from the wrist to the knuckles, broad and flat, as rings for `kit.lofted`."""
    centres, radii = [], []
    for at in np.linspace(0.0, 1.0, 20):
        width = 0.029 + 0.019 * math.sin(min(1.0, 1.6 * at) * math.pi / 2)
        thickness = 0.0185 - 0.006 * at + 0.004 * math.sin(math.pi * at)
        centres.append((0.004 * math.sin(math.pi * at), 0.0, 0.100 * at - 0.02))
        radii.append((width, thickness))
    for turn in (0.4, 0.7, 0.9, 0.99):
        centres.append((0.0, 0.0, 0.080 + 0.016 * turn))
        radii.append(
            (0.048 * math.sqrt(1 - turn**3), 0.0125 * math.sqrt(1 - turn * turn))
        )
    return kit.tube(centres, radii, (0, 1, 0), 32)


def ball_of_the_thumb() -> kit.Points:
    """The surface of the muscle between wrist and thumb, as rings for `kit.lofted`."""
    centres, radii = [], []
    for at in np.linspace(-0.98, 0.98, 13):
        centres.append((0.030 + 0.012 * at, -0.008, 0.030 + 0.032 * at))
        radii.append((0.020 * math.sqrt(1 - at * at), 0.017 * math.sqrt(1 - at * at)))
    return kit.tube(centres, radii, (0, 1, 0))


def skin_picture(
    name: str, shape: tuple[int, int], joints: tuple[float, ...]
) -> paint.Image:
    """A picture of mottled skin, with creases across it at the joints, whose positions along it are from 0 to 1."""
    random = paint.generator(f"skin {name}")
    mottled = paint.ramp(
        0.6 * paint.noise(shape, 26, 3, random)
        + 0.4 * paint.noise(shape, 6, 2, random),
        (0.2, 0.5, 0.8),
        ("b97858", "d89e7c", "eabfa2"),
    )
    along = np.linspace(0, 1, shape[0], dtype=np.float32)[:, None]
    ripple = 0.006 * (paint.noise(shape, 22, 2, random) - 0.5)
    crease = np.zeros(shape, dtype=np.float32)
    for joint in joints:
        for line in (-0.018, 0.0, 0.016):
            crease += np.exp(-(((along + ripple - joint - line) / 0.004) ** 2))
    freckles = np.clip((paint.noise(shape, 5, 1, random) - 0.82) * 8, 0, 1)
    picture = paint.blended(mottled, 0.45 * np.clip(crease, 0, 1), "8a4f3a")
    return paint.blended(picture, 0.5 * freckles, "8f5a3c")


def skin(name: str, shape: tuple[int, int], joints: tuple[float, ...]) -> Any:
    """A material with the skin texture of `skin_picture`."""
    return kit.printed(name, skin_picture(name, shape, joints))


def sleeve() -> kit.Points:
    """The surface of the sleeve with the forearm, from the cuff downwards, as rings for `kit.lofted`."""
    centres = [(0.0, 0.0, -0.02 - 0.5 * at) for at in np.linspace(0, 1, 26)]
    radii = [
        (0.042 + 0.02 * at + 0.004 * math.sin(37 * at), 0.036 + 0.02 * at)
        for at in np.linspace(0, 1, 26)
    ]
    return kit.tube(centres, radii, (0, 1, 0), 32)


def chequers() -> Any:
    """The material of the sleeve: woven checks in three colours."""
    shape = (1000, 500)
    y, x = np.meshgrid(*(np.arange(n, dtype=np.float32) for n in shape), indexing="ij")
    image = np.broadcast_to(paint.color("e8dcc4"), (*shape, 3)).astype(np.float32)
    for across, period, width, code in (
        (x, 62.5, 22.0, "a3282f"),
        (y, 62.5, 22.0, "a3282f"),
        (x + 31, 62.5, 7.0, "1f3a5f"),
        (y + 31, 62.5, 7.0, "1f3a5f"),
    ):
        image = paint.blended(image, 0.62 * (across % period < width), code)
    weave = paint.noise(shape, 5, 2, paint.generator("weave")) - 0.5
    return kit.printed("chequers", paint.shaded(image, 0.5 * weave))


def hand(
    skin_of: Callable[[str, tuple[int, int], tuple[float, ...]], Any] = skin,
    curl: str = "0.5 + 0.5*sin(7.1*{t} + 0.4)",
) -> Any:
    """The hand with its forearm; the object's origin is at the wrist.

    `skin_of` makes the material of each part, like `skin`. `curl` is a driver expression for the bend of the fingers,
    from 0 to 1.
    """
    names = list(FINGERS)
    joints = (0.30, 0.60, 0.82)
    fingers = [
        (skin_of(name, (220, 150), joints), finger(name, 0.10)) for name in names
    ]
    rest = [
        (skin_of("palm", (260, 400), (0.08,)), palm()),
        (skin_of("ball of the thumb", (120, 160), ()), ball_of_the_thumb()),
        (chequers(), sleeve()),
    ]
    whole = kit.skinned("hand", [*fingers, *rest])
    curled = [finger(name, 0.42) for name in names] + [rings for _, rings in rest]
    kit.bend(
        whole,
        "curled",
        np.concatenate([rings.reshape(-1, 3) for rings in curled]),
        curl,
    )
    cuff = kit.lofted(
        "watch",
        kit.ink("strap", "20242b"),
        kit.tube(
            [(0, 0, -0.012 + 0.004 * k) for k in range(6)],
            [(0.036, 0.025)] * 6,
            (0, 1, 0),
            32,
        ),
    )
    cuff.parent = whole
    return whole


def build() -> None:
    """Build this scene in the empty Blender file that is open."""
    kit.start_scene()
    kit.place_rig((0, 0, RIG_HEIGHT_M), (0, 2, RIG_HEIGHT_M))
    kit.sky(brightness=0.85, contrast=0.45, brightest=(-0.6, -0.6, 0.7))
    backdrop.boards(2.0, RIG_HEIGHT_M)
    backdrop.poster(
        "WAVE\nBACK",
        ("233d4d", "619b8a", "fcca46", "fe7f2d", "a1c181"),
        (-0.62, 1.99, RIG_HEIGHT_M + 0.22),
    )
    backdrop.poster(
        "OPEN\nHANDS",
        ("3d1f5c", "8f5fa8", "f4c6d0", "e26d5c", "ffe1a8"),
        (0.60, 1.99, RIG_HEIGHT_M + 0.06),
    )
    clay = kit.printed(
        "clay",
        paint.photo(
            "clay", (200, 400), ("5c2a14", "a5522a", "d08a5a", "8a3f1f", "e0b090"), 14
        ),
    )
    pot = kit.turned(
        "pot", clay, [(0.07, 0), (0.10, 0.1), (0.12, 0.2), (0.135, 0.21), (0.135, 0.25)]
    )
    pot.location = (0.42, 1.45, RIG_HEIGHT_M - 0.58)
    waving = hand()
    waving.scale = (1.35, 1.35, 1.35)
    kit.drive(waving, "location", 0, "-0.03 + 0.09*sin(6.6*{t} + 0.3)")
    kit.drive(waving, "location", 1, "1.05 + 0.03*sin(4.3*{t})")
    kit.drive(
        waving, "location", 2, f"{RIG_HEIGHT_M} - 0.12 + 0.06*sin(9.4*{{t}} + 0.9)"
    )
    kit.drive(waving, "rotation_euler", 0, "0.10*sin(5.2*{t} + 2.0)")
    kit.drive(waving, "rotation_euler", 1, "0.34*sin(6.6*{t} + 0.7)")
    kit.drive(waving, "rotation_euler", 2, "0.25*sin(4.1*{t})")
