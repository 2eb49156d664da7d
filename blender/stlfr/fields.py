"""The capture that is open, so that one image's registered frames serve the next. No `bpy` here."""

from __future__ import annotations

import threading
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from .errors import BadInputError
from .view import Request, Samples

if TYPE_CHECKING:
    import stlfr

Stamp = tuple[tuple[int, int], ...]

_lock = threading.Lock()
_open: tuple[Path, Stamp, stlfr.Capture] | None = None


class StoppedError(Exception):
    """The caller asked to stop."""


def render(request: Request, proceed: Callable[[int, int], bool]) -> Samples:
    """The image, as `stlfr render` writes it. Offsets that aren't known yet are estimated, and saved in the capture."""
    try:
        return _capture(request.capture).render(
            request.time_s,
            camera=request.camera,
            options=request.options,
            proceed=proceed,
        )
    except InterruptedError:
        raise StoppedError from None
    except ValueError as error:
        raise BadInputError(str(error)) from None


def close() -> None:
    """Forget the open capture."""
    global _open
    with _lock:
        _open = None


def _capture(folder: Path) -> stlfr.Capture:
    """The capture; opened anew when its description or its saved offsets have changed."""
    import stlfr

    global _open
    with _lock:
        stamp = _stamp(folder)
        if _open is None or _open[:2] != (folder, stamp):
            _open = (folder, stamp, stlfr.open(folder))
        return _open[2]


def _stamp(folder: Path) -> Stamp:
    states = []
    for name in ("capture.json", "offsets.json"):
        try:
            state = (folder / name).stat()
            states.append((state.st_mtime_ns, state.st_size))
        except OSError:
            states.append((0, 0))
    return tuple(states)
