"""What a capture covers, for Blender's main thread: it is read beside it, and panels are drawn anew when it is there."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import bpy

from . import fields

POLL_S = 0.1
"""How often it is asked whether it is there. Larger, and it shows late; smaller, and Blender is woken for nothing."""

_wanted: dict[Path, list[Callable[[], None]]] = {}
"""Captures that are still to be read, and what is to be done then."""


def is_known(folder: Path) -> bool:
    """Whether `fields.span_s` returns at once; where it doesn't, it is read, and the panels are drawn anew then.

    Without a window nothing is drawn anew, and a script goes on with what it asked for: it waits.
    """
    if bpy.app.background or fields.knows_span(folder):
        return True
    _want(folder)
    return False


def when_known(folder: Path, work: Callable[[], None]) -> None:
    """Do something in the main thread as soon as the span is known: now, where it is or where there is no window."""
    if is_known(folder):
        work()
    else:
        _wanted[folder].append(work)


def forget() -> None:
    """Another file is opened, or the extension goes: nothing that was to be done is done."""
    _wanted.clear()
    if bpy.app.timers.is_registered(_poll):
        bpy.app.timers.unregister(_poll)


def _want(folder: Path) -> None:
    _wanted.setdefault(folder, [])
    fields.read_span(folder)
    if not bpy.app.timers.is_registered(_poll):
        bpy.app.timers.register(_poll, first_interval=POLL_S)


def _poll() -> float | None:
    """One capture after the other."""
    for folder in list(_wanted):
        if fields.knows_span(folder):
            for work in _wanted.pop(folder):
                work()
            _redraw()
        else:
            fields.read_span(folder)
    return POLL_S if _wanted else None


def _redraw() -> None:
    """The properties, which say what is covered."""
    for window in bpy.context.window_manager.windows:
        for area in window.screen.areas:
            if area.type == "PROPERTIES":
                area.tag_redraw()
