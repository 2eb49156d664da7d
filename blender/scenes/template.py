"""A template for new scenes: a card with text floats in front of a wall while a box rotates.

Copy this file under another name into this folder; then `stlfr capture RIG --scene NAME` films it. Requirements:

- `build()` builds the scene in an empty Blender file. The result depends only on this file and on the modules that it
  imports from this folder. It must not depend on other files, the time, or random numbers except those of
  `paint.generator(NAME)`, so that it always gives the same pixels.
- Lengths are metres, and Z points up. World time t seconds is Blender frame 1 + 30 t. `kit.drive` animates objects by
  expressions of `{t}`, which are exact at any instant between frames; keyframes are possible too.
- The pose of an object named `rig` (see `kit.place_rig`) is the camera rig's pose.
- Matt surfaces with painted pictures (`kit.printed`) render fastest, and look alike in all cameras.

Recommendations for rigs such as `linear8`: moving objects at depths of 1 to 1.8 m, and the background at 2 to 2.4 m.
Then there is depth, but nothing leaves the outer cameras' view. At 640x480, 1 m/s at a depth of 1.5 m is 15 pixels a
frame. Some motion should be vertical, across the epipolar lines of a horizontal rig, because motion along these lines
leaves time and depth ambiguous. Textures should have detail from 3 pixels upwards.

Describe in this comment the depths of all objects, and how fast they move, as in the following line.

Depths from the rig: card 1.4 m, box 1.7 m, wall 2.1 m. At 640x480 the card moves 5 to 12 pixels a frame.
"""

from __future__ import annotations

from . import backdrop, kit, paint

RIG_HEIGHT_M = 1.2


def build() -> None:
    """Build this scene in the empty Blender file that is open."""
    kit.start_scene()
    kit.place_rig((0, 0, RIG_HEIGHT_M), (0, 2, RIG_HEIGHT_M))
    kit.sky(brightness=0.85, contrast=0.4, brightest=(-0.5, -0.6, 0.8))
    backdrop.bricks(2.1, RIG_HEIGHT_M)

    # A printed card: rectangles and text in page coordinates, each layer over the one below.
    card = kit.Sheet()
    card.rectangle(kit.ink("card", "f2efe4"), (-0.22, -0.15), (0.44, 0.30))
    picture = paint.photo(
        "view", (130, 270), ("12324a", "2f7fa8", "e8dcc0", "d98b3a", "7a2f1c"), 14
    )
    view = kit.printed("view", picture)
    card.rectangle(view, (-0.20, -0.13), (0.40, 0.15), layer=1)
    card.centred_text(kit.ink("black", "161412"), "YOUR SCENE", (0, 0.065), 0.062)
    floating = card.build("card", bend=lambda x, _y: 0.3 * x * x)
    kit.drive(floating, "location", 0, "-0.08 + 0.05*sin(4.3*{t})")
    kit.drive(floating, "location", 1, "1.4")
    kit.drive(
        floating, "location", 2, f"{RIG_HEIGHT_M} + 0.12 + 0.12*sin(5.6*{{t}} + 0.5)"
    )
    kit.drive(floating, "rotation_euler", 1, "0.15*sin(4.9*{t} + 1.0)")

    patches = ("d9412b", "f3c531", "f7f4ec", "2b62b8", "3f8f4f")
    parcel = kit.printed("parcel", paint.patchwork("parcel", (200, 200), patches, 26))
    box = kit.box("box", parcel, (0.26, 0.26, 0.26), (0.38, 1.7, RIG_HEIGHT_M - 0.42))
    kit.drive(box, "rotation_euler", 2, "0.4 + 0.9*{t}")
