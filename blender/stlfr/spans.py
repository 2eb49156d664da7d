"""The time span that a capture covers, for Blender's main thread, which must not wait for it.

A background thread reads the span; when it has ended, the panels are redrawn.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import bpy

from . import fields

POLL_S = 0.1
"""Time between two checks whether a span has been read. If larger, panels show it later; if smaller, Blender is woken
more often than needed."""

_wanted: dict[Path, list[Callable[[], None]]] = {}
"""Captures whose spans are still to be read, each with the functions to call afterwards."""


def is_known(folder: Path) -> bool:
    """Whether a capture's span is cached, so that `fields.span_s` doesn't block.

    If not, the span is read in the background, and the panels are redrawn afterwards. Always true without a window,
    because a script may wait.
    """
    if bpy.app.background or fields.knows_span(folder):
        return True
    _want(folder)
    return False


def when_known(folder: Path, work: Callable[[], None]) -> None:
    """Call `work` in the main thread as soon as the capture's span is cached; at once if it is, or without a window."""
    if is_known(folder):
        work()
    else:
        _wanted[folder].append(work)


def forget() -> None:
    """Drop all waiting calls, because another file is opened or the extension is unregistered."""
    _wanted.clear()
    if bpy.app.timers.is_registered(_poll):
        bpy.app.timers.unregister(_poll)


def _want(folder: Path) -> None:
    _wanted.setdefault(folder, [])
    fields.read_span(folder)
    if not bpy.app.timers.is_registered(_poll):
        bpy.app.timers.register(_poll, first_interval=POLL_S)


def _poll() -> float | None:
    """Timer: makes the calls that waited for spans that are now cached, and starts to read the next span."""
    for folder in list(_wanted):
        if fields.knows_span(folder):
            for work in _wanted.pop(folder):
                work()
            _redraw()
        else:
            fields.read_span(folder)
    return POLL_S if _wanted else None


def _redraw() -> None:
    """Redraw the properties editors, whose panels show the covered frames."""
    for window in bpy.context.window_manager.windows:
        for area in window.screen.areas:
            if area.type == "PROPERTIES":
                area.tag_redraw()
