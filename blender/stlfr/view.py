"""Which image of the light field a frame of a Blender scene shows. Does not import `bpy`; callers pass its objects.

The capture's time, seconds on its reference camera's clock, is
`(frame - start frame) / fps * speed + time_offset_s`. After filming, the start frame is set to the scene's first frame,
and the offset to the capture's time at this frame, so that the light field and Cycles show the same instant. If the
speed is 0 and the offset is animated, time can stand still (bullet time), slow down, or run backwards.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from .described import describe_object
from .errors import BadInputError

Stamp = tuple[tuple[int, int], ...]
"""Modification times and sizes of the files that describe a capture."""

Samples = npt.NDArray[np.uint8] | npt.NDArray[np.uint16]
Linear = npt.NDArray[np.float32]
"""An RGBA image as in Blender, (H, W, 4): scene-linear, with premultiplied alpha and the bottom row first."""


@dataclass(frozen=True)
class Request:
    """A request to render one image of a light field, with the arguments of `stlfr.Capture.render`."""

    capture: Path
    time_s: float
    camera: dict[str, Any]
    options: dict[str, Any]
    stamp: Stamp = ()
    """Modification times and sizes of the capture's files; if they change, the image must be rendered again."""


def request(scene: Any, camera_object: Any, capture: Path) -> Request:
    """The request for the view of a Blender camera at the scene's current frame and sub-frame."""
    require_perspective(camera_object)
    return Request(
        capture=capture,
        time_s=capture_time_s(scene),
        camera=describe_object(camera_object, scene),
        options=options(scene.stlfr),
    )


def require_perspective(camera_object: Any) -> None:
    """Raises `BadInputError` if there is no camera, or if it isn't a perspective camera."""
    if camera_object is None or camera_object.type != "CAMERA":
        raise BadInputError("the scene has no camera to look through")
    if camera_object.data.type != "PERSP":
        raise BadInputError(
            f"camera {camera_object.name} isn't a perspective camera, the only kind that the light field can show"
        )


def capture_time_s(scene: Any) -> float:
    """The capture's time at the scene's current frame, seconds on the reference camera's clock."""
    settings = scene.stlfr
    frames = scene.frame_current + scene.frame_subframe - settings.start_frame
    scene_s = frames * scene.render.fps_base / scene.render.fps
    return float(scene_s * settings.speed + settings.time_offset_s)


def covered_frames(
    scene: Any, span_s: tuple[float, float]
) -> tuple[float, float] | None:
    """The first and last frame, with fractions, of the scene's frames that show this time span of the capture.

    None if time stands still.
    """
    settings = scene.stlfr
    if settings.speed == 0.0:
        return None
    frames_a_second = scene.render.fps / scene.render.fps_base / settings.speed
    ends = [
        settings.start_frame + (time_s - settings.time_offset_s) * frames_a_second
        for time_s in span_s
    ]
    return min(ends), max(ends)


def options(settings: Any) -> dict[str, Any]:
    """The render options for the settings of the render tab, in the format of files for `stlfr render --options`."""
    result: dict[str, Any] = (
        _methods(settings) if settings.preset == "none" else {"preset": settings.preset}
    )
    if settings.use_trail:
        result["trail"] = {
            "duration_s": settings.trail_duration_s,
            "instants": settings.trail_instants,
            "mode": settings.trail_mode,
        }
    return result


def _methods(settings: Any) -> dict[str, Any]:
    """The render options if no preset is chosen: the methods of synchronization and of scene shape."""
    auto = {
        stage: True for stage in ("sync", "proxy") if getattr(settings, stage) == "auto"
    }
    if "sync" in auto:
        # The blending weights in time depend on the synchronization, and the panel has no choice for them.
        auto["blend"] = True
    proxy: dict[str, Any] = {} if "proxy" in auto else {"method": settings.proxy}
    if settings.proxy == "plane" and settings.use_plane_depth:
        proxy["plane_depth_m"] = settings.plane_depth_m
    result: dict[str, Any] = {"proxy": proxy}
    if "sync" not in auto:
        result["sync"] = settings.sync
    result["auto"] = {stage: stage in auto for stage in ("sync", "proxy", "blend")}
    return result


def border_px(render: Any, width_px: int, height_px: int) -> tuple[int, int, int, int]:
    """Blender's render border in pixels from the image's bottom left: left, right, bottom, top."""
    if not render.use_border:
        return 0, width_px, 0, height_px
    return (
        int(render.border_min_x * width_px),
        int(render.border_max_x * width_px),
        int(render.border_min_y * height_px),
        int(render.border_max_y * height_px),
    )


def scene_linear(samples: Samples) -> Linear:
    """Convert an image to Blender's format: from sRGB samples (H, W, 1 to 4), grey or RGB, with or without alpha."""
    top = np.iinfo(samples.dtype).max
    channels = samples.shape[2]
    result = np.ones((*samples.shape[:2], 4), dtype=np.float32)
    upright = samples[::-1]
    result[..., :3] = _decoded(top)[upright[..., : 3 if channels >= 3 else 1]]
    if channels in (2, 4):
        result[..., 3] = upright[..., -1] / np.float32(top)
        result[..., :3] *= result[..., 3:]
    return result


@functools.cache
def _decoded(top: int) -> npt.NDArray[np.float32]:
    """The linear values of all sRGB sample values from 0 to `top`."""
    encoded = np.arange(top + 1) / top
    linear = np.where(
        encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4
    )
    return linear.astype(np.float32)
