"""Which frames of a Blender scene show instants that a capture covers. Does not import `bpy`."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

from . import fields, filming, view, words

SLACK_FRAMES = 1e-3
"""Tolerance for a frame outside of the covered range, in frames, as Blender stores times in single precision. If
larger, a frame counts as covered that can't be rendered; if smaller, rounding excludes the first frame."""


def adopt_filmed(settings: Any, capture: Path) -> bool:
    """Set the scene's time offset to the one with which the capture was filmed. Returns whether the capture has one."""
    offset_s = filming.time_offset_s(capture)
    if offset_s is not None:
        settings.time_offset_s = offset_s
    return offset_s is not None


def adopt_start(settings: Any, capture: Path) -> None:
    """Set the scene's time offset so that the start frame shows the first instant that the capture covers."""
    span_s = fields.span_s(capture)
    if span_s is not None:
        settings.time_offset_s = span_s[0]


def covered(scene: Any, capture: Path) -> tuple[float, float] | None:
    """The first and last frame of the scene, with fractions, at which the capture is covered.

    None if there is no capture in the folder, or if time stands still.
    """
    span_s = fields.span_s(capture)
    return None if span_s is None else view.covered_frames(scene, span_s)


def whole_frames(covered: tuple[float, float]) -> tuple[int, int] | None:
    """The first and the last whole frame in a range of covered frames; None if it contains no whole frame."""
    first = math.ceil(covered[0] - SLACK_FRAMES)
    last = math.floor(covered[1] + SLACK_FRAMES)
    return (first, last) if first <= last else None


def scene_range(covered: tuple[float, float] | None) -> tuple[int, int] | None:
    """The first and last whole frame in a range of covered frames, not below 0, as scenes have no negative frames.

    None if there is no such frame.
    """
    whole = None if covered is None else whole_frames(covered)
    if whole is None or whole[1] < 0:
        return None
    return max(0, whole[0]), whole[1]


def sentence(scene: Any, capture: Path) -> tuple[str, bool]:
    """A sentence for the panel about the covered frames, and whether the scene's current frame is covered."""
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
