"""The animated scene camera as a camera path for `stlfr render --path`. Does not import `bpy`."""

from __future__ import annotations

from typing import Any

from . import view
from .described import describe_object
from .errors import BadInputError

MAX_FRAMES = 100_000
"""Maximum number of keys of a camera path, as `stlfr render` limits it."""


def path(scene: Any) -> dict[str, Any]:
    """The content of a path file: a key for every frame of the scene, with the camera and the light field's time.

    Raises `BadInputError` if the scene has too many frames, or if a camera isn't perspective.
    """
    frames = range(scene.frame_start, scene.frame_end + 1)
    if not 1 <= len(frames) <= MAX_FRAMES:
        raise BadInputError(
            f"the scene has {len(frames)} frames, must have from 1 to {MAX_FRAMES}"
        )
    rate_hz = scene.render.fps / scene.render.fps_base
    keys = []
    for frame in frames:
        scene.frame_set(frame)
        camera = camera_at(scene, frame)
        view.require_perspective(camera)
        keys.append(
            {
                "at_s": (frame - scene.frame_start) / rate_hz,
                "time_s": view.capture_time_s(scene),
                "camera": describe_object(camera, scene),
            }
        )
    return {"format": "stlfr-path", "version": 1, "rate_hz": rate_hz, "keys": keys}


def camera_at(scene: Any, frame: int) -> Any:
    """The scene's camera at a frame: the camera of the last marker with a camera, or else the active camera."""
    cuts = [m for m in scene.timeline_markers if m.camera and m.frame <= frame]
    return max(cuts, key=lambda marker: marker.frame).camera if cuts else scene.camera
