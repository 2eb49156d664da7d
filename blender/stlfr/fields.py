"""The capture that is open, so that one image's registered frames serve the next. No `bpy` here."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from . import filming, words
from .errors import BadInputError
from .plan import CAPTURE_FILE
from .view import Request, Samples, Stamp

if TYPE_CHECKING:
    import stlfr

_lock = threading.Lock()
_open: tuple[Path, Stamp, stlfr.Capture] | None = None
_spans: dict[Path, tuple[Stamp, tuple[float, float] | None]] = {}


class StoppedError(Exception):
    """The caller asked to stop."""


@contextlib.contextmanager
def _own_errors() -> Iterator[None]:
    """What the module refuses, as this package's errors."""
    try:
        yield
    except InterruptedError:
        raise StoppedError from None
    except ValueError as error:
        raise BadInputError(words.in_blender(str(error))) from None


def render(request: Request, proceed: Callable[[int, int], bool]) -> Samples:
    """The image, as `stlfr render` writes it. Offsets that aren't known yet are estimated, and saved in the capture."""
    with _own_errors():
        return _capture(request.capture).render(
            request.time_s,
            camera=request.camera,
            options=request.options,
            proceed=proceed,
        )


def moment(request: Request) -> stlfr.Moment:
    """What the views of a request's instant share."""
    with _own_errors():
        return _capture(request.capture).moment(request.time_s, options=request.options)


def seen(at: stlfr.Moment, request: Request) -> Samples:
    """A request's image of its instant."""
    with _own_errors():
        return at.view(request.camera)


def span_s(folder: Path) -> tuple[float, float] | None:
    """The first and the last time of the reference camera's frames: what is surely covered.

    None where the folder holds no capture.
    """
    stamp = stamp_of(folder)
    known = _spans.get(folder)
    if known is None or known[0] != stamp:
        known = (stamp, _find_span_s(folder))
        _spans[folder] = known
    return known[1]


def _find_span_s(folder: Path) -> tuple[float, float] | None:
    try:
        with _own_errors():
            capture = _capture(folder)
            times_s = capture.times(capture.reference)
    except BadInputError:
        return None
    return float(times_s[0]), float(times_s[-1])


def close() -> None:
    """Forget the open capture."""
    global _open
    with _lock:
        _open = None
        _spans.clear()


def must_be_capture(folder: Path) -> None:
    """Refuse a folder that holds none, and say what it holds instead."""
    if (folder / CAPTURE_FILE).is_file():
        return
    if not folder.exists():
        raise BadInputError(f"there is no folder {folder}")
    if filming.is_begun(folder):
        raise BadInputError(
            f"the film in {folder} isn't finished: name that folder under Film, and press Resume"
        )
    raise BadInputError(
        f"{folder} holds no capture: film one there, or choose the folder in which {CAPTURE_FILE} lies"
    )


def _capture(folder: Path) -> stlfr.Capture:
    """The capture; opened anew when its description or its saved offsets have changed."""
    import stlfr

    global _open
    with _lock:
        stamp = stamp_of(folder)
        if _open is None or _open[:2] != (folder, stamp):
            must_be_capture(folder)
            _open = (folder, stamp, stlfr.open(folder))
        return _open[2]


def stamp_of(folder: Path) -> Stamp:
    """Of a capture's description and its saved offsets; a file that isn't there has zeros."""
    states = []
    for name in (CAPTURE_FILE, "offsets.json"):
        try:
            state = (folder / name).stat()
            states.append((state.st_mtime_ns, state.st_size))
        except OSError:
            states.append((0, 0))
    return tuple(states)
