"""Two balls bounce on a table; at each bounce, their vertical motion reverses instantaneously.

Depths from the rig: near ball 1.45 m, far ball 1.8 m, table 1.3 to 2.05 m, bricks with a plain door 2.2 m. At 640x480
the near ball hits the table at 22 pixels a frame and leaves it at the same speed, first at 0.14 s and then every 0.28
s. The far ball hits the table at 25 pixels a frame, first at 0.24 s and then every 0.4 s. Both balls spin and drift
sideways, so that points on their surfaces move up to 32 pixels a frame.
"""

from __future__ import annotations

from typing import Any

from . import backdrop, kit, paint

RIG_HEIGHT_M = 1.2
TABLE_M = RIG_HEIGHT_M - 0.34
"""Height of the table's top above the ground."""

GRAVITY_M_S2 = 9.81


def bounce(body: Any, lowest_m: float, first_s: float, period_s: float) -> None:
    """Animate the height of a bouncing body: it hits the height `lowest_m` at the time `first_s` and every `period_s`.

    `first_s` must be less than `period_s`.
    """
    rise_m = GRAVITY_M_S2 * period_s**2 / 8
    phase = 1.0 - first_s / period_s
    from_top = f"(2*fmod({{t}}/{period_s} + {phase:.6f}, 1) - 1)"
    kit.drive(body, "location", 2, f"{lowest_m} + {rise_m:.6f}*(1 - {from_top}**2)")


def ball(name: str, picture: paint.Image, radius_m: float) -> Any:
    """A ball with this picture as its texture; its origin is its centre."""
    return kit.turned(
        name, kit.printed(name, picture), kit.sphere_profile(radius_m, 0.0)
    )


def table() -> None:
    """Add a table of planks, with a plain cloth that hangs from its front edge."""
    top = kit.printed(
        "table",
        paint.planks(
            "bounce table", (280, 900), 45, ("4a2f1b", "8a5a30", "c08a50", "e0bd84")
        ),
    )
    kit.box("table", top, (2.4, 0.75, 0.04), (0, 1.675, TABLE_M - 0.04))
    kit.box(
        "cloth", kit.ink("cloth", "8f9aa0"), (2.4, 0.01, 0.6), (0, 1.31, TABLE_M - 0.64)
    )


def build() -> None:
    """Build this scene in the empty Blender file that is open."""
    kit.start_scene()
    kit.place_rig((0, 0, RIG_HEIGHT_M), (0, 2, RIG_HEIGHT_M))
    kit.sky(brightness=0.85, contrast=0.4, brightest=(-0.5, -0.6, 0.8))
    backdrop.bricks(2.2, RIG_HEIGHT_M)
    door = kit.Sheet()
    door.rectangle(kit.ink("door", "9fb0a4"), (-0.26, -1.2), (0.52, 1.6))
    door.build("door").location = (0.58, 2.19, RIG_HEIGHT_M)
    backdrop.poster(
        "UP\nDOWN",
        ("0b3948", "2a9d8f", "e9ecef", "e9c46a", "9b2226"),
        (-0.50, 2.19, RIG_HEIGHT_M + 0.28),
    )
    table()

    near = ball(
        "near ball",
        paint.patchwork(
            "near bounce",
            (300, 600),
            ("d9412b", "f3c531", "f7f4ec", "2b62b8", "3f8f4f"),
            28,
        ),
        0.11,
    )
    bounce(near, TABLE_M + 0.11, 0.14, 0.28)
    kit.drive(near, "location", 0, "-0.20 + 0.20*sin(2.6*{t} - 0.4)")
    near.location.y = 1.45
    near.rotation_mode = "XYZ"
    kit.drive(near, "rotation_euler", 0, "0.5 - 3*{t}")
    kit.drive(near, "rotation_euler", 1, "6.5*{t}")

    far = ball(
        "far ball",
        paint.photo(
            "far bounce",
            (260, 520),
            ("14304f", "2f6f9f", "d9c9a0", "7d9a4a", "9d3b2a"),
            17,
        ),
        0.10,
    )
    bounce(far, TABLE_M + 0.10, 0.24, 0.40)
    kit.drive(far, "location", 0, "0.30 - 0.22*sin(2.9*{t} - 0.3)")
    far.location.y = 1.8
    far.rotation_mode = "XYZ"
    kit.drive(far, "rotation_euler", 0, "0.4 + 2*{t}")
    kit.drive(far, "rotation_euler", 1, "-7*{t}")

    stem = kit.ink("stem", "2b2f36")
    for x_m in (0.02, 0.06):
        rod = kit.turned("rod", stem, [(0.003, 0.0), (0.003, 0.55)], segments=8)
        rod.location = (x_m, 1.95, TABLE_M)
