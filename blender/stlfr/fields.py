"""The open capture, shared by all images, so that results cached for one image serve the next. Does not import `bpy`.

Opening a capture may take long, because its videos are read. So Blender's main thread waits for it only if a script or
a button needs the capture's contents.
"""

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

Span = tuple[float, float]
"""A first and a last time, seconds."""

_opening = threading.Lock()
"""Held while a capture is opened, so that two threads don't open the same capture."""

_lock = threading.Lock()
"""Protects the variables `_open`, `_spans` and `_closed`; held only briefly."""

_open: tuple[Path, Stamp, stlfr.Capture] | None = None
_spans: dict[Path, tuple[Stamp, Span | None]] = {}
_closed = 0
"""Number of calls of `close`. A result whose computation began before the last call is not cached."""

_reader: threading.Thread | None = None


class StoppedError(Exception):
    """The caller asked to stop."""


@contextlib.contextmanager
def _own_errors() -> Iterator[None]:
    """Turn errors of the module `stlfr` into this package's, with messages in the terms of Blender's panels."""
    try:
        yield
    except InterruptedError:
        raise StoppedError from None
    except (ValueError, FileNotFoundError) as error:
        raise BadInputError(words.in_blender(str(error))) from None


def render(request: Request, proceed: Callable[[int, int], bool]) -> Samples:
    """Render the requested image as `stlfr render` does. Unknown offsets are estimated, and saved in the capture.

    Raises `StoppedError` if `proceed` returns false.
    """
    with _own_errors():
        return _capture(request.capture).render(
            request.time_s,
            camera=request.camera,
            options=request.options,
            proceed=proceed,
        )


def load_preview(request: Request) -> bool:
    """Load into memory what `preview` needs for the requested image; whether `preview` can render it."""
    with _own_errors():
        return _capture(request.capture).load_preview(
            request.time_s, camera=request.camera, options=request.options
        )


def preview(request: Request) -> Samples | None:
    """Render the requested image quickly by scene flow; None if this method isn't chosen or its results aren't there."""
    with _own_errors():
        return _capture(request.capture).preview(
            request.time_s, camera=request.camera, options=request.options
        )


def moment(request: Request) -> stlfr.Moment:
    """Prepare the requested instant: the results that all views of this instant share."""
    with _own_errors():
        return _capture(request.capture).moment(request.time_s, options=request.options)


def seen(at: stlfr.Moment, request: Request) -> Samples:
    """Render the requested view at an instant that `moment` has prepared."""
    with _own_errors():
        return at.view(request.camera)


def span_s(folder: Path) -> Span | None:
    """The first and last time of the reference camera's frames, seconds; None if the folder holds no valid capture.

    If the result isn't cached, this opens the capture, which may take long.
    """
    stamp, closed = stamp_of(folder), _closed
    known = _spans.get(folder)
    if known is None or known[0] != stamp:
        known = (stamp, _find_span_s(folder))
        with _lock:
            if closed == _closed:
                _spans[folder] = known
    return known[1]


def knows_span(folder: Path) -> bool:
    """Whether the result of `span_s` is cached, so that it returns immediately."""
    known = _spans.get(folder)
    return known is not None and known[0] == stamp_of(folder)


def read_span(folder: Path) -> None:
    """Start a thread that computes and caches `span_s`, unless one is running already. Returns immediately."""
    global _reader
    if is_reading() or knows_span(folder):
        return
    _reader = threading.Thread(
        target=span_s, args=(folder,), daemon=True, name="stlfr span"
    )
    _reader.start()


def is_reading() -> bool:
    """Whether a thread that `read_span` started is still running."""
    return _reader is not None and _reader.is_alive()


def _find_span_s(folder: Path) -> Span | None:
    try:
        with _own_errors():
            capture = _capture(folder)
            times_s = capture.times(capture.reference)
            return float(times_s[0]), float(times_s[-1])
    except (KeyboardInterrupt, SystemExit):
        raise
    except BaseException:  # noqa: BLE001 - a panic of the module is no Exception
        return None


def close(patience_s: float = 0.0) -> None:
    """Close the open capture and clear the cache; results of running threads won't be cached.

    Then waits for the thread of `read_span`, at most `patience_s` seconds.
    """
    global _open, _closed
    with _lock:
        _open = None
        _closed += 1
        _spans.clear()
    if _reader is not None and patience_s > 0.0:
        _reader.join(patience_s)


def must_be_capture(folder: Path) -> None:
    """Raises `BadInputError` if the folder holds no complete capture; the message states what it is instead."""
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
    """The open capture of a folder. It is opened again if capture.json or the saved offsets have changed."""
    import stlfr

    global _open
    with _opening:
        stamp = stamp_of(folder)
        with _lock:
            if _open is not None and _open[:2] == (folder, stamp):
                return _open[2]
            closed = _closed
        must_be_capture(folder)
        capture = stlfr.open(folder)
        with _lock:
            if closed == _closed:
                _open = (folder, stamp, capture)
        return capture


def stamp_of(folder: Path) -> Stamp:
    """Modification times and sizes of capture.json and offsets.json, to detect changes; zeros for a missing file."""
    states = []
    for name in (CAPTURE_FILE, "offsets.json"):
        try:
            state = (folder / name).stat()
            states.append((state.st_mtime_ns, state.st_size))
        except OSError:
            states.append((0, 0))
    return tuple(states)
