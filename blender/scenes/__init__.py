"""Scenes to film. Each module's `build()` fills an empty Blender file.

Metres, Z up. World time t seconds is Blender frame 1 + 30 t, sub-frames included. An object named
`rig` says where the rig stands: like a Blender camera, it looks along its -Z with +Y up.
Everything is procedural and seeded: the same pixels every time, no files.
"""

TUNED_ON = ("magazine", "ball", "head", "book", "spin", "bounce")
"""Sweeps choose parameters on these scenes, and on no others."""

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
"""These scenes only judge: what is measured on them changes no parameter."""
