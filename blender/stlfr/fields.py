"""The capture that is open, so that one image's registered frames serve the next. No `bpy` here.

Opening one can take long, as its videos are looked through: Blender's main thread waits for it only where a
script or a button asks for what the capture holds.
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
"""Held while one is opened, so that no two threads open the same."""

_lock = threading.Lock()
"""Of what follows; never held for long."""

_open: tuple[Path, Stamp, stlfr.Capture] | None = None
_spans: dict[Path, tuple[Stamp, Span | None]] = {}
_closed = 0
"""How often everything was forgotten: what was begun before is not kept."""

_reader: threading.Thread | None = None


class StoppedError(Exception):
    """The caller asked to stop."""


@contextlib.contextmanager
def _own_errors() -> Iterator[None]:
    """Turn the module's errors into this package's."""
    try:
        yield
    except InterruptedError:
        raise StoppedError from None
    except (ValueError, FileNotFoundError) as error:
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
    """Render a request at its instant."""
    with _own_errors():
        return at.view(request.camera)


def span_s(folder: Path) -> Span | None:
    """The first and the last time of the reference camera's frames: what is surely covered.

    None where the folder holds no capture. Opens it where that isn't known yet.
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
    """Whether `span_s` returns at once."""
    known = _spans.get(folder)
    return known is not None and known[0] == stamp_of(folder)


def read_span(folder: Path) -> None:
    """Find `span_s` in a thread of its own, if none does so yet: one at a time. Returns at once."""
    global _reader
    if is_reading() or knows_span(folder):
        return
    _reader = threading.Thread(
        target=span_s, args=(folder,), daemon=True, name="stlfr span"
    )
    _reader.start()


def is_reading() -> bool:
    """Whether a thread is reading the span."""
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
    """Forget the open capture, at once; what is being opened isn't kept. Waits at most so long for the thread."""
    global _open, _closed
    with _lock:
        _open = None
        _closed += 1
        _spans.clear()
    if _reader is not None and patience_s > 0.0:
        _reader.join(patience_s)


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
    """Time stamps and sizes of the capture's description and offsets; zeros for a missing file."""
    states = []
    for name in (CAPTURE_FILE, "offsets.json"):
        try:
            state = (folder / name).stat()
            states.append((state.st_mtime_ns, state.st_size))
        except OSError:
            states.append((0, 0))
    return tuple(states)
