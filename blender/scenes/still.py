"""A nearly static scene: only a clock's second hand moves, and flowers sway by a fraction of a pixel a frame.

Depths from the rig: flowers 1.4 m, clock 1.9 m, boards 2.2 m. At 640x480 the tip of the second hand moves 0.2 pixels a
frame, and the blossoms up to 0.5 pixels a frame.
"""

from __future__ import annotations

import math
from typing import Any

from . import backdrop, kit, paint

RIG_HEIGHT_M = 1.2


def clock() -> None:
    """Add a wall clock of 46 cm with a moving second hand; the hour and minute hands show ten past ten."""
    dial = kit.Sheet()
    ivory, black, red = (
        kit.ink("ivory", "efe9d8"),
        kit.ink("black", "1b1815"),
        kit.ink("red", "b3261e"),
    )
    for hour in range(1, 13):
        a = math.tau * hour / 12
        middle_m = (0.17 * math.sin(a), 0.17 * math.cos(a) - 0.016)
        dial.centred_text(black, str(hour), middle_m, 0.046, layer=1)
    for minute in range(60):
        a = math.tau * minute / 60
        x, y, size = (
            0.208 * math.sin(a),
            0.208 * math.cos(a),
            0.006 if minute % 5 else 0.012,
        )
        dial.rectangle(black, (x - size / 2, y - size / 2), (size, size), layer=1)
    dial.centred_text(black, "regulateur", (0, 0.07), 0.028, layer=1)
    printed = dial.build("dial")
    printed.location = (0.0, 1.895, RIG_HEIGHT_M + 0.12)
    walnut = kit.printed(
        "case", paint.planks("case", (60, 700), 8, ("3a2413", "6a4526", "9a6f45"))
    )
    angles = [2 * math.pi * k / 96 for k in range(97)]
    case = kit.lofted(
        "case",
        walnut,
        kit.tube(
            [(0.235 * math.cos(a), 0, 0.235 * math.sin(a)) for a in angles],
            [(0.02, 0.02)] * 97,
            (0, 1, 0),
            16,
        ),
    )
    case.parent = printed
    back = kit.lofted(
        "face",
        ivory,
        kit.tube(
            [(0, 0.004, 0), (0, 0.005, 0)],
            [(0.23, 0.23), (0.001, 0.001)],
            (0, 0, 1),
            64,
        ),
    )
    back.parent = printed
    hands(printed, black, red)


def hands(dial: Any, black: Any, red: Any) -> None:
    """Add the hour, minute and second hands to a clock; only the second hand moves."""
    for name, material, width, length, turn, out in (
        ("hour hand", black, 0.014, 0.10, -math.tau * 10.17 / 12, 0.006),
        ("minute hand", black, 0.010, 0.16, -math.tau * 10 / 60, 0.009),
        ("second hand", red, 0.006, 0.19, 0.0, 0.012),
    ):
        sheet = kit.Sheet()
        sheet.rectangle(material, (-width / 2, -0.03), (width, length + 0.03))
        hand = sheet.build(name)
        hand.parent = dial
        hand.location.y = -out
        hand.rotation_euler.y = -turn
        if name == "second hand":
            kit.drive(hand, "rotation_euler", 1, f"{math.tau / 60:.6f}*{{t}} + 0.6")


def flower(number: int, x_m: float, height_m: float) -> None:
    """Add a flower, a stem with a blossom, which sways about its foot. `number` varies its colours and its motion."""
    stem = kit.lofted(
        "stem",
        kit.ink("stem", "3f6f3a"),
        kit.tube(
            [
                (0.02 * math.sin(3 * h), 0, height_m * h)
                for h in (0, 0.25, 0.5, 0.75, 1.0)
            ],
            [(0.004, 0.004)] * 5,
            (0, 1, 0),
            8,
        ),
    )
    codes = (("d94a3a", "f3c531"), ("e6dfe8", "e2b04a"), ("8f5fa8", "f4e0a0"))[
        number % 3
    ]
    blossom = kit.turned(
        "blossom",
        kit.printed(
            "blossom", paint.patchwork(f"blossom {number}", (80, 200), codes, 14)
        ),
        [(0.004, 0), (0.035, 0.012), (0.05, 0.03), (0.030, 0.045), (0.004, 0.05)],
    )
    blossom.location = (0.02 * math.sin(3), 0, height_m)
    blossom.rotation_euler.x = 0.7
    blossom.parent = stem
    stem.location = (x_m, 1.4, RIG_HEIGHT_M - 0.28)
    kit.drive(
        stem,
        "rotation_euler",
        1,
        f"{0.1 * number - 0.2} + 0.028*sin({2.6 + 0.4 * number}*{{t}} + {number})",
    )
    kit.drive(stem, "rotation_euler", 0, f"0.022*sin({3.4 - 0.3 * number}*{{t}})")


def build() -> None:
    """Build this scene in the empty Blender file that is open."""
    kit.start_scene()
    kit.place_rig((0, 0, RIG_HEIGHT_M), (0, 2, RIG_HEIGHT_M))
    kit.sky(brightness=0.85, contrast=0.4, brightest=(-0.5, -0.6, 0.8))
    backdrop.boards(2.2, RIG_HEIGHT_M, ("54402c", "8f7350", "c4a878", "e6d3a8"))
    backdrop.poster(
        "STAND\nSTILL",
        ("1b1b3a", "693668", "f4d35e", "ee964b", "f95738"),
        (-0.66, 2.19, RIG_HEIGHT_M + 0.15),
    )
    clock()
    glaze = ("14213d", "2a6f97", "f1faee", "e9c46a", "9d0208")
    vase = kit.turned(
        "vase",
        kit.printed("vase", paint.photo("vase", (200, 400), glaze, 15)),
        [
            (0.05, 0),
            (0.085, 0.06),
            (0.10, 0.14),
            (0.08, 0.22),
            (0.05, 0.27),
            (0.065, 0.30),
        ],
    )
    vase.location = (0.36, 1.4, RIG_HEIGHT_M - 0.58)
    for number, (x_m, height_m) in enumerate(
        ((0.32, 0.26), (0.36, 0.34), (0.38, 0.22), (0.40, 0.30))
    ):
        flower(number, x_m, height_m)
