"""Scenes to film. Each module's `build()` fills an empty Blender file.

Metres, Z up. World time t seconds is Blender frame 1 + 30 t, sub-frames included. An object named
`rig` says where the rig stands: like a Blender camera, it looks along its -Z with +Y up.
Everything is procedural and seeded: the same pixels every time, no files.
"""
