"""Scenes to film. The function `build()` of a scene's module builds the scene in an empty Blender file.

Lengths are metres, and Z points up. World time t seconds is Blender frame 1 + 30 t, with sub-frames. The pose of the
object named `rig` is the camera rig's pose: like a Blender camera, it looks along its -Z axis, with +Y up. Scenes are
procedural with fixed seeds and read no files, so that they always give the same pixels.
"""

TUNED_ON = ("magazine", "ball", "head", "book", "spin", "bounce")
"""The training scenes: only on these scenes, the library's parameters are tuned."""

JUDGED_ON = (
    "hand",
    "fast",
    "rush",
    "swing",
    "wave",
    "tumble",
    "turning",
    "thin",
    "textureless",
    "still",
    "along",
    "dance",
)
"""The held-out test scenes: results on them are only reported, and no parameter is tuned on them."""
