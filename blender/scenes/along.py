"""A train and a cart slide sideways: all motion is along the epipolar lines of a horizontal rig.

Depths from the rig: train 1.5 m, cart 1.8 m, wallpaper 2.2 m. No point changes its height or its depth, so a change of
the temporal offset and a change of depth have the same effect on the images. Thus a pair of cameras in a horizontal row
can't determine temporal offsets. At 640x480 the train moves 12 to 18 pixels a frame, and the cart 8 to 12 pixels in the
opposite direction.
"""

from __future__ import annotations

from typing import Any

from . import backdrop, kit, paint

RIG_HEIGHT_M = 1.2


def wagon(name: str, codes: tuple[str, ...], x_m: float) -> Any:
    """A railway wagon: a box with windows, without wheels, whose rotation would be another motion."""
    body = kit.box(
        name,
        backdrop.photo(name, (0.34, 0.2), codes, 0.024),
        (0.34, 0.12, 0.20),
        (x_m, 0, 0.04),
    )
    window = kit.ink("window", "20303a")
    frame = kit.ink("frame", "f0e3b4")
    sheet = kit.Sheet()
    for k in range(4):
        left = -0.145 + 0.076 * k
        sheet.rectangle(frame, (left - 0.006, 0.094), (0.064, 0.072))
        sheet.rectangle(window, (left, 0.10), (0.052, 0.06), layer=1)
    sheet.rectangle(frame, (-0.165, 0.05), (0.33, 0.008))
    panes = sheet.build("panes")
    panes.location = (0, -0.061, 0)
    panes.parent = body
    dark = kit.ink("chassis", "1c1a18")
    chassis = kit.box("chassis", dark, (0.36, 0.10, 0.03), (0, 0, -0.03))
    chassis.parent = body
    return body


def build() -> None:
    """Build this scene in the empty Blender file that is open."""
    kit.start_scene()
    kit.place_rig((0, 0, RIG_HEIGHT_M), (0, 2, RIG_HEIGHT_M))
    kit.sky(brightness=0.85, contrast=0.4, brightest=(-0.5, -0.6, 0.8))
    backdrop.flowers(2.2, RIG_HEIGHT_M, ("dfe6dc", "6f8fa0", "d0803a", "7a2f3c"))
    sleepers = kit.printed(
        "track", paint.planks("track", (30, 900), 15, ("2b1d12", "5c4128", "8a6a45"))
    )
    for depth_m, height_m in ((1.5, -0.28), (1.8, 0.12)):
        kit.box(
            "track", sleepers, (3.0, 0.2, 0.03), (0, depth_m, RIG_HEIGHT_M + height_m)
        )

    train = kit.group("train")
    train.location = (0, 1.5, RIG_HEIGHT_M - 0.21)
    reds = ("5c0f16", "a3282f", "e8c07a", "d0503a", "3a0a10")
    greens = ("10301f", "2f6f4a", "e8dcb0", "5a9a6a", "0c2418")
    blues = ("10203f", "2f5f9f", "e8e4d0", "6a9ad0", "0a1428")
    for name, codes, x_m in (
        ("red", reds, -0.38),
        ("green", greens, 0.0),
        ("blue", blues, 0.38),
    ):
        wagon(f"{name} wagon", codes, x_m).parent = train
    # 0.30 m x 4 rad/s at 1.5 m: up to 18 pixels in a thirtieth of a second.
    kit.drive(train, "location", 0, "0.30*sin(4.0*{t} - 0.8)")

    cart()
    vase()


def cart() -> None:
    """A cart with a sign, which slides in the direction opposite to the train's."""
    body = kit.box(
        "cart",
        backdrop.photo(
            "cart",
            (0.3, 0.2),
            ("2b1d0e", "b08030", "f0e0b0", "8a3f1f", "40502a"),
            0.022,
        ),
        (0.30, 0.14, 0.20),
        (0, 1.8, RIG_HEIGHT_M + 0.15),
    )
    sign = kit.Sheet()
    sign.rectangle(kit.ink("board", "f2efe4"), (-0.13, 0.0), (0.26, 0.10))
    sign.centred_text(kit.ink("black", "161412"), "SIDEWAYS", (0, 0.032), 0.052)
    board = sign.build("sign")
    board.location = (0, -0.072, 0.05)
    board.parent = body
    kit.drive(body, "location", 0, "0.12 - 0.28*sin(3.6*{t} - 0.6)")


def vase() -> None:
    """A painted vase that stands still in the foreground."""
    standing = kit.turned(
        "vase",
        kit.printed(
            "vase",
            paint.photo(
                "vase",
                (200, 400),
                ("14213d", "2a6f97", "f1faee", "e9c46a", "9d0208"),
                15,
            ),
        ),
        [
            (0.05, 0),
            (0.085, 0.06),
            (0.10, 0.14),
            (0.08, 0.24),
            (0.04, 0.32),
            (0.055, 0.36),
        ],
    )
    standing.location = (0.42, 1.25, RIG_HEIGHT_M - 0.55)
