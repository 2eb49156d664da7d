"""When a scene's frames show what a capture filmed. No `bpy` here: scenes and settings are read."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

from . import fields, filming, view, words

SLACK_FRAMES = 1e-3
"""By how much a covered frame may lie outside of the film: times are kept in single precision. Larger, and a frame is
promised that can't be rendered; smaller, and the first frame is missed by rounding."""


def adopt_filmed(settings: Any, capture: Path) -> bool:
    """Give a newly chosen capture the time offset with which it was filmed; whether there is one."""
    offset_s = filming.time_offset_s(capture)
    if offset_s is not None:
        settings.time_offset_s = offset_s
    return offset_s is not None


def adopt_start(settings: Any, capture: Path) -> None:
    """Give it the time offset with which it begins at the start frame."""
    span_s = fields.span_s(capture)
    if span_s is not None:
        settings.time_offset_s = span_s[0]


def covered(scene: Any, capture: Path) -> tuple[float, float] | None:
    """The scene's frames that surely have a picture; None where there is no capture, or time stands still."""
    span_s = fields.span_s(capture)
    return None if span_s is None else view.covered_frames(scene, span_s)


def whole_frames(covered: tuple[float, float]) -> tuple[int, int] | None:
    """The first and the last whole frame of those covered; None where there is none."""
    first = math.ceil(covered[0] - SLACK_FRAMES)
    last = math.floor(covered[1] + SLACK_FRAMES)
    return (first, last) if first <= last else None


def scene_range(covered: tuple[float, float] | None) -> tuple[int, int] | None:
    """The whole frames among those covered that a scene can have; None where there is none. None is before 0."""
    whole = None if covered is None else whole_frames(covered)
    if whole is None or whole[1] < 0:
        return None
    return max(0, whole[0]), whole[1]


def sentence(scene: Any, capture: Path) -> tuple[str, bool]:
    """Which frames are covered, and whether the scene's is among them."""
    span_s = fields.span_s(capture)
    if span_s is None:
        return "No capture in that folder", False
    frames = view.covered_frames(scene, span_s)
    if frames is None:
        is_covered = span_s[0] <= view.capture_time_s(scene) <= span_s[1]
        return (
            f"Time stands still; filmed is {span_s[0]:.3f} to {span_s[1]:.3f} s",
            is_covered,
        )
    now = scene.frame_current + scene.frame_subframe
    first, last = frames[0] - SLACK_FRAMES, frames[1] + SLACK_FRAMES
    return f"Covered: frames {words.frames(first, last)}", first <= now <= last
