"""Which image of the light field a frame of the scene shows. No `bpy` here: scenes and objects are read.

The capture's time, seconds on its reference camera's clock, is
`(frame - start frame) / fps * speed + time_offset_s`. After filming, the start frame is the scene's first
frame then, and the offset is the capture's time at it, so that the light field and Cycles show the same
instant. With the speed at 0 and the offset animated, time goes as one likes: it stands still
(bullet time), slows down, or runs back.
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
"""When the files that a capture is described by were last written, and how large they are."""

Samples = npt.NDArray[np.uint8] | npt.NDArray[np.uint16]
Linear = npt.NDArray[np.float32]
"""RGBA as Blender has it, (H, W, 4): scene-linear, alpha premultiplied, the bottom row first."""


@dataclass(frozen=True)
class Request:
    """An image of a light field, as the module `stlfr` takes it."""

    capture: Path
    time_s: float
    camera: dict[str, Any]
    options: dict[str, Any]
    stamp: Stamp = ()
    """Of the capture's files: another one asks for another image."""


def request(scene: Any, camera_object: Any, capture: Path) -> Request:
    """What a scene at its current frame and sub-frame asks for, seen through a camera."""
    require_perspective(camera_object)
    return Request(
        capture=capture,
        time_s=capture_time_s(scene),
        camera=describe_object(camera_object, scene),
        options=options(scene.stlfr),
    )


def require_perspective(camera_object: Any) -> None:
    """Refuse what the light field can't be seen through."""
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
    """The scene's frames, fractions included, that show a span of the capture; None where time stands still."""
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
    """The render options that the render tab amounts to, as a file for `stlfr render --options` has them."""
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
    """The options of the methods that were chosen one by one."""
    auto = {
        stage: True for stage in ("sync", "proxy") if getattr(settings, stage) == "auto"
    }
    if "sync" in auto:
        # The weights in time depend on how images are synchronized, and have no choice of their own here.
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
    """What is rendered of the image: left, right, bottom, top, in pixels from the bottom left."""
    if not render.use_border:
        return 0, width_px, 0, height_px
    return (
        int(render.border_min_x * width_px),
        int(render.border_max_x * width_px),
        int(render.border_min_y * height_px),
        int(render.border_max_y * height_px),
    )


def scene_linear(samples: Samples) -> Linear:
    """As Blender has it: samples (H, W, 1 to 4), display-encoded (sRGB), grey or RGB, with or without alpha."""
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
    """The linear value of every sample."""
    encoded = np.arange(top + 1) / top
    linear = np.where(
        encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4
    )
    return linear.astype(np.float32)
