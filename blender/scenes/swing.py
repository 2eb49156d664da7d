"""A ball swings fast on a string, with abrupt reversals at the ends of its swing, and spins.

Depths from the rig: jar 1.25 m, ball 1.4 to 1.55 m, stand of thin rods 1.85 m, wallpaper with a plain panel 2.2 m. At
640x480 the ball moves up to 31 pixels a frame along a slanted arc, and points on its surface up to 45. At a reversal,
first at 0.20 s and then every 0.26 s, the displacement of these points changes by up to 17 pixels from frame to frame.
"""

from __future__ import annotations

from . import backdrop, kit, paint
from .ball import pendulum

RIG_HEIGHT_M = 1.2


def stand() -> None:
    """Add a stand of thin rods behind the ball: two posts, two bars, and a bell that doesn't move."""
    steel = kit.ink("steel", "3a4048")
    for x_m in (-0.62, 0.50):
        post = kit.turned("post", steel, [(0.005, -0.70), (0.005, 0.62)], segments=10)
        post.location = (x_m, 1.85, RIG_HEIGHT_M)
    for height_m in (0.60, -0.22):
        kit.box(
            "bar", steel, (1.12, 0.008, 0.008), (-0.06, 1.85, RIG_HEIGHT_M + height_m)
        )
    brass = ("5a3a12", "b98a35", "f0dca0", "8a6420", "d8b45a")
    bell = kit.turned(
        "bell",
        kit.printed("bell", paint.photo("bell", (160, 360), brass, 14)),
        [(0.09, -0.30), (0.07, -0.26), (0.055, -0.18), (0.03, -0.13), (0.004, -0.12)],
    )
    bell.location = (0.30, 1.85, RIG_HEIGHT_M - 0.10)


def build() -> None:
    """Build this scene in the empty Blender file that is open."""
    kit.start_scene()
    kit.place_rig((0, 0, RIG_HEIGHT_M), (0, 2, RIG_HEIGHT_M))
    kit.sky(brightness=0.85, contrast=0.4, brightest=(0.5, -0.6, 0.8))
    backdrop.flowers(2.2, RIG_HEIGHT_M, ("e6e2d4", "5f8f8a", "c9713f", "3a3560"))
    panel = kit.Sheet()
    panel.rectangle(kit.ink("panel", "b9b2a2"), (-0.24, -0.32), (0.48, 0.64))
    panel.build("panel").location = (0.62, 2.19, RIG_HEIGHT_M + 0.30)
    stand()

    patches = ("e0492b", "f2c12e", "f6f2e6", "24508f", "2f7f5f", "2a2024")
    ball = pendulum(
        "ball",
        kit.printed("ball", paint.patchwork("swung", (320, 640), patches, 28)),
        0.13,
        0.52,
        (0.26, 1.5, RIG_HEIGHT_M + 0.46),
    )
    # 0.52 m x 0.33 rad x (12 rad/s)²: 25 m/s² where it turns.
    kit.drive(ball, "rotation_euler", 0, "0.10*sin(7*{t} + 2.0)")
    kit.drive(ball, "rotation_euler", 1, "0.58 + 0.33*cos(12*{t} - 2.4)")
    kit.drive(ball, "rotation_euler", 2, "5.5*{t} + 0.8*sin(6*{t})")

    glaze = ("2b1d3a", "7a4f8f", "f1ead8", "d99a3a", "3f6f6a")
    jar = kit.turned(
        "jar",
        kit.printed("jar", paint.photo("jar", (180, 380), glaze, 15)),
        [(0.05, 0), (0.085, 0.06), (0.09, 0.15), (0.055, 0.22), (0.065, 0.25)],
    )
    jar.location = (0.36, 1.25, RIG_HEIGHT_M - 0.46)
