"""Two balls, one near and one far, swing in front of bookshelves; the near ball hides the far ball at times.

Depths from the rig: vase 1.3 m, near ball 1.5 m, far ball 1.9 m, shelves 2.3 m. At 640x480 the near ball moves up to 20
pixels a frame, along an arc that crosses the epipolar lines of any rig. Both balls spin, so their textures rotate too.
"""

from __future__ import annotations

from typing import Any

from . import backdrop, kit, paint

RIG_HEIGHT_M = 1.2


def pendulum(
    name: str,
    material: Any,
    radius_m: float,
    length_m: float,
    hook_m: tuple[float, ...],
) -> Any:
    """A ball on a string; the object's origin is the hook, so that its rotation swings the ball."""
    hung = kit.turned(name, material, kit.sphere_profile(radius_m, -length_m))
    string = kit.turned(
        f"{name} string",
        kit.ink("string", "2a221c"),
        [(0.004, -length_m + 0.9 * radius_m), (0.004, 0.0)],
        segments=8,
    )
    string.parent = hung
    hung.location = hook_m
    hung.rotation_mode = "ZXY"
    return hung


def build() -> None:
    """Build this scene in the empty Blender file that is open."""
    kit.start_scene()
    kit.place_rig((0, 0, RIG_HEIGHT_M), (0, 2, RIG_HEIGHT_M))
    kit.sky(brightness=0.85, contrast=0.4, brightest=(-0.5, -0.6, 0.8))
    backdrop.books(2.3, RIG_HEIGHT_M)

    patches = ("d9412b", "f3c531", "f7f4ec", "2b62b8", "3f8f4f")
    near = pendulum(
        "near ball",
        kit.printed("patches", paint.patchwork("near", (330, 660), patches, 34)),
        0.15,
        0.75,
        (-0.05, 1.5, RIG_HEIGHT_M + 0.72),
    )
    kit.drive(near, "rotation_euler", 0, "0.10*sin(3.62*{t} + 1.3)")
    kit.drive(near, "rotation_euler", 1, "0.05 - 0.46*cos(3.62*{t} + 0.75)")
    kit.drive(near, "rotation_euler", 2, "1.1*sin(2.10*{t} + 0.7)")

    earth = ("14304f", "2f6f9f", "d9c9a0", "7d9a4a", "3f5f2f")
    far = pendulum(
        "far ball",
        kit.printed("earth", paint.photo("far", (260, 520), earth, 16)),
        0.12,
        0.60,
        (0.36, 1.9, RIG_HEIGHT_M + 0.66),
    )
    kit.drive(far, "rotation_euler", 0, "0.30*sin(4.04*{t})")
    kit.drive(far, "rotation_euler", 1, "0.38*sin(4.04*{t} + 0.9)")
    kit.drive(far, "rotation_euler", 2, "-1.4*{t}")

    glaze = ("14213d", "2a6f97", "f1faee", "e9c46a", "9d0208")
    vase = kit.turned(
        "vase",
        kit.printed("glaze", paint.photo("vase", (200, 400), glaze, 15)),
        [
            (0.05, 0),
            (0.09, 0.05),
            (0.11, 0.13),
            (0.09, 0.2),
            (0.045, 0.27),
            (0.06, 0.32),
        ],
    )
    vase.location = (0.40, 1.3, RIG_HEIGHT_M - 0.50)
