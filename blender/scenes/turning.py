"""A magazine moves along an ellipse without rotation, so that all its points have the same velocity.

Depths from the rig: magazine 1.55 to 1.7 m, wall 2.1 m. At 640x480 the magazine moves 10 to 18 pixels a frame. Nothing
else moves. At 0.26 and 0.78 s, it moves along the epipolar lines of a horizontal rig. Then a pair of cameras can't
distinguish temporal offset from depth (Fig. 22 of the paper). At all other times, it also moves across these lines.
"""

from __future__ import annotations

from . import kit
from .magazine import RIG_HEIGHT_M, magazine, wall


def build() -> None:
    """Build this scene in the empty Blender file that is open."""
    kit.start_scene()
    kit.place_rig((0, 0, RIG_HEIGHT_M), (0, 2, RIG_HEIGHT_M))
    kit.sky(brightness=0.85, contrast=0.4, brightest=(-0.5, -0.6, 0.8))
    wall()
    held = magazine()
    held.rotation_euler = (-0.06, 0.05, 0.10)
    # Without rotation, all points move in parallel: none moves up while another moves down.
    kit.drive(held, "location", 0, "0.02 - 0.20*cos(6.04*{t})")
    kit.drive(held, "location", 1, "1.62")
    kit.drive(held, "location", 2, f"{RIG_HEIGHT_M} + 0.02 + 0.12*sin(6.04*{{t}})")
