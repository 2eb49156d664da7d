"""A head turns and talks in front of bookshelves.

Depths from the rig: nose 0.95 m, shoulders 1.05 m, lamp 1.5 m, books 2.1 m. At 640x480 the face moves 8 to 18 pixels a
frame. It turns and nods, the shoulders sway, and the jaw opens and closes four times a second, so that the skin around
the mouth is stretched.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from . import backdrop, kit, paint

RIG_HEIGHT_M = 1.2
RINGS, SEGMENTS = 110, 144
TEXTURE = (420, 640)

# The head is the smooth union of these ellipsoids, each with its centre and radii in metres. The face looks along -Y,
# Z points up, the origin is between the ears, and the head is symmetric.
BODIES = (
    ((0, 0.018, 0.040), (0.076, 0.098, 0.086)),  # skull
    ((0, -0.030, 0.040), (0.066, 0.060, 0.062)),  # forehead
    ((0, -0.030, -0.035), (0.062, 0.062, 0.075)),  # face
    ((0, -0.046, -0.092), (0.036, 0.042, 0.030)),  # jaw
    ((0, -0.076, -0.106), (0.018, 0.018, 0.014)),  # chin
    ((0, -0.094, 0.006), (0.010, 0.014, 0.030)),  # bridge of the nose
    ((0, -0.106, -0.020), (0.013, 0.017, 0.013)),  # tip of the nose
    ((0.013, -0.096, -0.025), (0.009, 0.012, 0.008)),  # nostrils
    ((-0.013, -0.096, -0.025), (0.009, 0.012, 0.008)),
    ((0.032, -0.073, 0.032), (0.026, 0.017, 0.009)),  # brows
    ((-0.032, -0.073, 0.032), (0.026, 0.017, 0.009)),
    ((0.040, -0.058, -0.022), (0.026, 0.028, 0.024)),  # cheeks
    ((-0.040, -0.058, -0.022), (0.026, 0.028, 0.024)),
    ((0, -0.088, -0.055), (0.021, 0.011, 0.0065)),  # lips
    ((0, -0.085, -0.069), (0.018, 0.011, 0.0070)),
    ((0.074, 0.012, -0.005), (0.014, 0.020, 0.032)),  # ears
    ((-0.074, 0.012, -0.005), (0.014, 0.020, 0.032)),
)
SOCKETS = (((0.031, -0.092, 0.010), 0.0165), ((-0.031, -0.092, 0.010), 0.0165))
EYES = ((0.031, -0.0690, 0.009), (-0.031, -0.0690, 0.009))
EYE_RADIUS_M = 0.0125
BLEND_M = 0.010
MOUTH_M = -0.062


def outside_m(points: kit.Points) -> kit.Points:
    """The approximate signed distance of points (..., 3) to the head's surface, metres; negative inside.

    The head is the smooth union of the ellipsoids `BODIES`, minus the eye sockets.
    """
    total = np.zeros(points.shape[:-1])
    for centre, radii in BODIES:
        scaled = (points - centre) / np.array(radii)
        distance = (np.linalg.norm(scaled, axis=-1) - 1) * min(radii)
        total += np.exp(-np.clip(distance, -0.1, 0.2) / BLEND_M * 4)
    distance = -np.log(np.maximum(total, 1e-30)) * BLEND_M / 4
    for centre, radius in SOCKETS:
        hollow = radius - np.linalg.norm(points - np.array(centre), axis=-1)
        # A smooth maximum subtracts the eye socket.
        distance = np.logaddexp(600 * distance, 600 * hollow) / 600
    result: kit.Points = distance
    return result


def head_rings() -> kit.Points:
    """The head's surface as rings from the bottom to the top, by ray casting in all directions from `MIDDLE_M`."""
    polar = np.linspace(0.02, math.pi - 0.02, RINGS)[:, None]
    around = (np.arange(SEGMENTS) * math.tau / SEGMENTS)[None, :]
    directions = np.stack(
        np.broadcast_arrays(
            -np.sin(around) * np.sin(polar),
            np.cos(around) * np.sin(polar),
            -np.cos(polar),
        ),
        axis=-1,
    )
    inner = np.full((RINGS, SEGMENTS, 1), 0.02)
    outer = np.full((RINGS, SEGMENTS, 1), 0.20)
    for _ in range(22):
        middle = (inner + outer) / 2
        inside = (outside_m(MIDDLE_M + middle * directions) < 0)[..., None]
        inner, outer = np.where(inside, middle, inner), np.where(inside, outer, middle)
    rings: kit.Points = MIDDLE_M + inner * directions
    return rings


MIDDLE_M = np.array([0.0, -0.012, -0.005])
"""A point inside the head from which the whole surface is visible, so that each direction meets the surface once."""


def jaw_open(rings_m: kit.Points) -> kit.Points:
    """The head's surface with the mouth open: points below the lips are rotated about an axis near the ears."""
    x, y, z = np.moveaxis(rings_m, -1, 0)
    lower = np.clip((MOUTH_M + 0.002 - z) / 0.005, 0, 1) * np.clip(
        (0.01 - y) / 0.05, 0, 1
    )
    angle = 0.20 * lower
    dy, dz = y - 0.01, z + 0.012
    turned_y = 0.01 + np.cos(angle) * dy - np.sin(angle) * dz
    turned_z = -0.012 + np.sin(angle) * dy + np.cos(angle) * dz
    opened: kit.Points = np.stack([x * (1 - 0.06 * lower), turned_y, turned_z], axis=-1)
    return opened


def face_paint(rings_m: kit.Points) -> paint.Image:
    """The texture of the head, from the positions of its texels: skin, hair, brows, lips and stubble."""
    x, y, z = np.moveaxis(enlarged(rings_m), -1, 0)
    random = paint.generator("face")

    def noise(feature_px: float, octaves: int = 2) -> paint.Image:
        return paint.noise(TEXTURE, feature_px, octaves, random)

    def spot(
        centre: tuple[float, float], size: tuple[float, float], soft: float
    ) -> paint.Image:
        """A mask that is 1 inside an ellipse on the face as seen from the front, 0 outside, with a soft border."""
        distance = np.hypot((x - centre[0]) / size[0], (z - centre[1]) / size[1])
        result: paint.Image = np.clip((1 - distance) / soft + 0.5, 0, 1) * (y < 0)
        return result

    skin = paint.ramp(
        0.5 * noise(40, 3) + 0.5 * noise(7, 2),
        (0.2, 0.5, 0.8),
        ("b67a5a", "d4a07e", "e6bda0"),
    )
    for side in (-1, 1):
        skin = paint.blended(
            skin, 0.22 * spot((side * 0.042, -0.028), (0.03, 0.024), 0.9), "b8523f"
        )
        skin = paint.blended(
            skin, 0.35 * spot((side * 0.031, 0.010), (0.024, 0.016), 0.7), "7a4638"
        )
    skin = paint.blended(skin, 0.3 * spot((0, -0.020), (0.016, 0.014), 0.8), "b8523f")
    freckles = np.clip((noise(6, 1) - 0.74) * 9, 0, 1) * spot(
        (0, -0.012), (0.07, 0.035), 0.8
    )
    skin = paint.blended(skin, 0.5 * freckles, "8a4f30")
    stubble = (
        np.clip((-0.050 - z) / 0.02, 0, 1) * (y < 0.02) * (0.35 + 0.5 * noise(3, 1))
    )
    skin = paint.blended(skin, 0.45 * stubble, "5d4334")
    lips = np.maximum(
        spot((0, MOUTH_M + 0.006), (0.023, 0.0065), 0.3),
        spot((0, MOUTH_M - 0.006), (0.020, 0.0075), 0.3),
    )
    skin = paint.blended(skin, lips * (0.75 + 0.25 * noise(4, 1)), "a8483f")
    gap = np.exp(-(((z - MOUTH_M + 0.0005) / 0.0016) ** 2)) * spot(
        (0, MOUTH_M), (0.0235, 0.02), 0.2
    )
    skin = paint.blended(skin, np.clip(1.3 * gap, 0, 1), "2a0d0c")
    for side in (-1, 1):
        nostril = spot((side * 0.0075, -0.0300), (0.0048, 0.0026), 0.5)
        skin = paint.blended(skin, 0.8 * nostril, "3a1712")
        arch = 0.033 - 6.0 * (x - side * 0.034) ** 2
        brow = np.exp(-(((z - arch) / 0.0038) ** 2)) * spot(
            (side * 0.034, 0.032), (0.024, 0.02), 0.4
        )
        skin = paint.blended(
            skin, np.clip(brow * (0.6 + 0.7 * noise(4, 2)), 0, 1), "2c1b10"
        )
    return covered_with_hair(skin, (x, y, z), noise)


def covered_with_hair(
    skin: paint.Image,
    place_m: tuple[kit.Points, kit.Points, kit.Points],
    noise: Callable[..., paint.Image],
) -> paint.Image:
    """The texture `skin` with hair above the hairline, except near the ears; `place_m` are the texels' positions."""
    x, y, z = place_m
    strands = 0.5 * noise(3, 1) + 0.5 * noise(24, 3)
    hair = paint.ramp(strands, (0.2, 0.5, 0.8), ("1d120a", "3f2815", "7a5230"))
    line = 0.066 + 0.010 * (noise(30, 2) - 0.5) - 1.2 * np.maximum(y + 0.055, 0)
    cover = np.clip((z - line) / 0.004, 0, 1)
    near_ear = np.hypot(y - 0.012, z + 0.005) < 0.034
    cover *= 1 - near_ear * (np.abs(x) > 0.07)
    cover *= np.clip((z + 0.085) / 0.01, 0, 1)
    image: paint.Image = skin + cover[..., None].astype(np.float32) * (hair - skin)
    return np.clip(image, 0.02, 0.98).astype(np.float32)


def enlarged(rings_m: kit.Points) -> kit.Points:
    """The position of each texel on the head's surface (rows, columns, 3), interpolated from the rings."""
    v = np.linspace(0, RINGS - 1 - 1e-6, TEXTURE[0])
    u = np.arange(TEXTURE[1]) / TEXTURE[1] * SEGMENTS
    low, left = v.astype(int), u.astype(int)
    part_v, part_u = (v - low)[:, None, None], (u - left)[None, :, None]
    along = rings_m[:, left] * (1 - part_u) + rings_m[:, (left + 1) % SEGMENTS] * part_u
    result: kit.Points = along[low] * (1 - part_v) + along[low + 1] * part_v
    return result


def eye(place_m: tuple[float, float, float]) -> Any:
    """An eyeball with a painted iris, which looks along its -Z axis."""
    shape = (128, 64)
    v = np.linspace(0, 1, shape[0], dtype=np.float32)[:, None] * np.ones(
        shape, np.float32
    )
    fibres = paint.noise(shape, 4, 2, paint.generator("iris"))
    image = np.broadcast_to(paint.color("ece6de"), (*shape, 3)).astype(np.float32)
    image = paint.blended(image, ((v < 0.20) * 1.0).astype(np.float32), "1f2f3a")
    image = paint.blended(
        image, ((v < 0.18) * (0.4 + 0.6 * fibres)).astype(np.float32), "5b8aa0"
    )
    image = paint.blended(image, ((v < 0.085) * 1.0).astype(np.float32), "080808")
    ball = kit.turned(
        "eye", kit.printed("eye", image), kit.sphere_profile(EYE_RADIUS_M, 0.0)
    )
    ball.location = place_m
    return ball


def lids(place_m: tuple[float, float, float], skin: Any) -> Any:
    """The eyelids over an eyeball: two spherical caps, above and below, which leave its front uncovered."""
    radius_m = 1.10 * EYE_RADIUS_M
    upper, lower = (
        [
            (radius_m * math.cos(math.radians(a)), radius_m * math.sin(math.radians(a)))
            for a in angles
        ]
        for angles in (range(20, 90, 6), range(-89, -34, 6))
    )
    over = kit.turned("upper lid", skin, upper, segments=32)
    under = kit.turned("lower lid", skin, lower, segments=32)
    over.location = place_m
    under.parent = over
    return over


def bust() -> Any:
    """The neck and shoulders, in a striped shirt."""
    skin = backdrop.photo(
        "neck", (0.4, 0.2), ("a86f50", "c48f6d", "d9ab8b", "b98262", "e0b799"), 0.03
    )
    neck = kit.tube(
        [(0, 0.030 - 0.16 * h, h) for h in np.linspace(-0.24, -0.05, 14)],
        [(0.056 + 0.010 * abs(k - 8) / 8, 0.056) for k in range(14)],
        (0, 1, 0),
        40,
    )
    heights = np.linspace(0, 1, 30)
    shoulders = kit.tube(
        [(0, 0.055 - 0.02 * h, -0.55 + 0.375 * h) for h in heights],
        [
            (
                0.075
                + 0.125 * math.sqrt(max(0.0, 1 - max(0.0, (h - 0.60) / 0.40) ** 3)),
                0.105 - 0.04 * max(0.0, h - 0.6) / 0.4,
            )
            for h in heights
        ],
        (0, 1, 0),
        64,
    )
    collar = kit.tube(
        [(0, 0.050, -0.185 + 0.010 * k) for k in range(5)],
        [(0.072 - 0.002 * k, 0.070 - 0.002 * k) for k in range(5)],
        (0, 1, 0),
        40,
    )
    return kit.skinned(
        "bust",
        [(skin, neck), (stripes(), shoulders), (kit.ink("collar", "e9e4d8"), collar)],
    )


def stripes() -> Any:
    """The material of the shirt: stripes in two blues and white, with a knitted texture."""
    shape = (360, 900)
    y = np.arange(shape[0], dtype=np.float32)[:, None] * np.ones(shape, np.float32)
    image = np.broadcast_to(paint.color("d3cdbf"), (*shape, 3)).astype(np.float32)
    image = paint.blended(image, (y % 36 < 17).astype(np.float32), "23406b")
    image = paint.blended(image, (y % 36 < 4).astype(np.float32), "8fb0cf")
    knit = paint.noise(shape, 4, 2, paint.generator("knit")) - 0.5
    folds = paint.noise(shape, 70, 3, paint.generator("folds")) - 0.5
    return kit.printed("stripes", paint.shaded(image, 0.35 * knit + 0.35 * folds))


def build() -> None:
    """Build this scene in the empty Blender file that is open."""
    kit.start_scene()
    kit.place_rig((0, 0, RIG_HEIGHT_M), (0, 2, RIG_HEIGHT_M))
    kit.sky(brightness=0.85, contrast=0.5, brightest=(-0.7, -0.5, 0.6))
    backdrop.books(2.1, RIG_HEIGHT_M)
    rings = head_rings()
    face = kit.lofted("head", kit.printed("face", face_paint(rings)), rings)
    kit.bend(
        face,
        "jaw",
        jaw_open(rings).reshape(-1, 3),
        "clamp(0.42 + 0.45*sin(25*{t}) + 0.3*sin(11*{t} + 1), 0, 1)",
    )
    face.rotation_mode = "XYZ"
    lid_skin = kit.ink("lid", "b5785c")
    for place in EYES:
        ball = eye(place)
        ball.parent = face
        ball.rotation_euler = (-math.pi / 2, 0, 0)
        lids(place, lid_skin).parent = face
    body = bust()
    face.parent = body
    body.scale = (1.25, 1.25, 1.25)
    kit.drive(face, "rotation_euler", 0, "0.20*sin(6.9*{t} + 0.4)")
    kit.drive(face, "rotation_euler", 1, "0.07*sin(4.7*{t})")
    kit.drive(face, "rotation_euler", 2, "0.85*sin(4.2*{t} - 0.5)")
    kit.drive(body, "location", 0, "-0.02 + 0.105*sin(5.2*{t} + 1.1)")
    kit.drive(body, "location", 1, "1.08 + 0.02*sin(3.1*{t})")
    kit.drive(
        body, "location", 2, f"{RIG_HEIGHT_M} + 0.04 + 0.070*sin(7.3*{{t}} - 0.4)"
    )
    kit.drive(body, "rotation_euler", 1, "0.06*sin(3.7*{t} + 0.8)")
    shade = kit.printed(
        "shade",
        paint.wallpaper(
            "shade", (200, 800), 60, ("e8d8b0", "a8763a", "7a2f1c", "2f4f4f")
        ),
    )
    lamp = kit.turned("lamp", shade, [(0.15, 0.0), (0.09, 0.22)])
    lamp.location = (0.52, 1.5, RIG_HEIGHT_M - 0.12)
    foot = kit.turned(
        "foot",
        kit.ink("brass", "8a6a2f"),
        [
            (0.09, -0.5),
            (0.02, -0.45),
            (0.015, -0.3),
            (0.03, -0.2),
            (0.015, -0.1),
            (0.012, 0.05),
        ],
    )
    foot.location = lamp.location
