"""What a viewport shows: rendered in a thread of its own, the latest wish first. No `bpy` here.

While the view or the time changes, pictures come from the fast method, at a resolution that keeps up.
When nothing has changed for a moment, the chosen methods render at full resolution. Such a picture is given
up at its next step when something changes; a fast one is finished and shown, else nothing would be seen
while changes come faster than pictures.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

from . import fields, view, viewpoint
from .errors import BadInputError, FailureError
from .view import Linear, Request

if TYPE_CHECKING:
    import stlfr

FAST = {"preset": "draft"}
"""The options while something changes."""

REST_S = 0.15
"""How long nothing changes before the chosen methods render. Larger, and the full picture comes late; smaller, and it is
begun in vain between two moves of a hand."""

SLOW_S, QUICK_S = 1 / 12, 1 / 30
"""A picture that takes longer than the first is rendered smaller next time; one that takes less than the second, larger.
Further apart, and the resolution stays too low or too high for long; closer, and it flickers."""

SMALLEST = 0.25
"""The smallest resolution while something changes, as a fraction of the full one. Larger, and slow machines lag; smaller,
and one can't tell what one sees."""

STEP = 0.7
"""By how much the resolution changes at once. Nearer to 1, and it takes many pictures to keep up; smaller, and it jumps."""

PATIENCE_S = 5.0
"""How long closing waits for a step to end. Larger, and Blender's window hangs; smaller, and it may end under a running
thread."""


@dataclass(frozen=True)
class Picture:
    """A picture, and how it was made."""

    pixels: Linear
    request: Request
    is_final: bool
    """By the chosen methods at full resolution."""


@dataclass
class Pace:
    """Which resolution keeps up."""

    factor: float = 1.0

    def took(self, seconds: float) -> None:
        """Adapt to what a picture took."""
        if seconds > SLOW_S:
            self.factor = max(SMALLEST, self.factor * STEP)
        elif seconds < QUICK_S:
            self.factor = min(1.0, self.factor / STEP)


@dataclass
class Counts:
    """What has been shown, for a measurement."""

    fast: int = 0
    final: int = 0
    final_took_s: float = 0.0
    fast_took_s: float = 0.0
    """To render all of them."""
    fast_drawn: int = 0
    asked_s: float = 0.0
    """When something last changed."""
    final_drawn_s: float = 0.0
    """When the full picture of it was drawn."""
    times_s: list[float] = field(default_factory=list)
    """When each fast picture was ready, the last ones."""

    def drawn(self, is_final: bool) -> None:
        """Count a picture that was drawn."""
        if is_final:
            self.final_drawn_s = time.monotonic()
        else:
            self.fast_drawn += 1

    @property
    def rate_hz(self) -> float:
        """Fast pictures a second, over the last ones that followed each other closely."""
        times = self.times_s
        if len(times) < 2 or times[-1] <= times[0]:
            return 0.0
        return (len(times) - 1) / (times[-1] - times[0])

    def ready(self, now_s: float) -> None:
        """Count a fast picture; after a pause, the count starts again."""
        if self.times_s and now_s - self.times_s[-1] > 1.0:
            self.times_s.clear()
        self.times_s = [*self.times_s[-20:], now_s]
        self.fast += 1


class Live:
    """One viewport's pictures. `want` and the properties return at once, from any thread."""

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self._wanted: Request | None = None
        self._serial = 0
        self._begun = 0
        self._served = 0
        self._completing = threading.Lock()
        self._completer: threading.Thread | None = None
        self._closed = False
        self._picture: Picture | None = None
        self._error: str | None = None
        self._news = False
        self._thread: threading.Thread | None = None
        self._paces = {True: Pace(), False: Pace()}
        self._moment: tuple[_Instant, stlfr.Moment] | None = None
        self._last: _Instant | None = None
        self.counts = Counts()

    def want(self, request: Request) -> bool:
        """Request a picture, in place of an earlier request; returns whether the request is new."""
        with self._changed:
            if self._closed or request == self._wanted:
                return False
            self._wanted = request
            self._serial += 1
            self.counts.asked_s = time.monotonic()
            if self._thread is None:
                self._thread = threading.Thread(
                    target=self._run, daemon=True, name="stlfr viewport"
                )
                self._thread.start()
            self._changed.notify_all()
        return True

    def refuse(self) -> None:
        """Drop the shown picture and the running request."""
        with self._changed:
            self._wanted = self._picture = self._error = None
            self._serial += 1
            self._served = self._begun = self._serial
            self._changed.notify_all()

    @property
    def picture(self) -> Picture | None:
        """The latest picture; None before the first and after an error."""
        return self._picture

    @property
    def error(self) -> str | None:
        """Why there is no picture, one sentence."""
        return self._error

    @property
    def is_closed(self) -> bool:
        """Whether this is closed."""
        return self._closed

    @property
    def is_busy(self) -> bool:
        """Whether another picture may come by itself."""
        return not self._closed and self._served != self._serial

    def take_news(self) -> bool:
        """Whether something is to be drawn since this was last asked."""
        with self._changed:
            news, self._news = self._news, False
        return news

    def close(self, patience_s: float = 0.0) -> None:
        """Give up; nothing comes any more. Waits at most so long for the thread."""
        with self._changed:
            self._closed = True
            self._serial += 1
            self._picture = self._wanted = None
            self._changed.notify_all()
        for thread in (self._thread, self._completer):
            if thread is not None and patience_s > 0.0:
                thread.join(patience_s)

    def _run(self) -> None:
        while True:
            with self._changed:
                while not self._closed and self._begun == self._serial:
                    self._changed.wait()
                if self._closed:
                    self._moment = None
                    return
                serial, request = self._serial, self._wanted
                self._begun = serial
            assert request is not None
            self._begin(serial, request)

    def _begin(self, serial: int, request: Request) -> None:
        if self._does(serial, lambda: self._show(serial, self._fast(request))):
            self._begin_full(serial, request)

    def _begin_full(self, serial: int, request: Request) -> None:
        """If nothing changes meanwhile: in a thread of its own. Its steps can be long where frames are new, and fast
        pictures don't wait for the end of one that is given up.
        """
        if self._rests(serial):
            self._completer = threading.Thread(
                target=self._complete,
                args=(serial, request),
                daemon=True,
                name="stlfr viewport",
            )
            self._completer.start()

    def _complete(self, serial: int, request: Request) -> None:
        with self._completing:
            if self._serial == serial:
                self._does(serial, lambda: self._full(serial, request))

    def _full(self, serial: int, request: Request) -> None:
        start_s = time.monotonic()
        samples = fields.render(request, lambda *_: self._serial == serial)
        self.counts.final += 1
        self.counts.final_took_s = time.monotonic() - start_s
        self._show(serial, Picture(view.scene_linear(samples), request, True))
        with self._changed:
            if self._serial == serial:
                self._served, self._news = serial, True

    def _does(self, serial: int, work: Callable[[], None]) -> bool:
        """Run a step; returns its success, and stores its error."""
        try:
            work()
        except fields.StoppedError:
            return False
        except (BadInputError, FailureError) as error:
            self._fail(serial, str(error))
        except BaseException as error:  # noqa: BLE001 - a panic of the module is no Exception
            name = type(error).__name__
            self._fail(serial, f"rendering failed: {error} ({name})")
        else:
            return True
        return False

    def _fast(self, request: Request) -> Picture:
        """By the fast method; from the second view of an instant on, what its views share is kept."""
        start_s = time.monotonic()
        instant = _Instant(request.capture, request.stamp, request.time_s)
        repeated, self._last = instant == self._last, instant
        pace = self._paces[repeated]
        small = replace(
            request,
            camera=viewpoint.scaled(request.camera, pace.factor),
            options=FAST,
        )
        fresh = False
        if repeated and (self._moment is None or self._moment[0] != instant):
            self._moment, fresh = (instant, fields.moment(small)), True
        if self._moment is not None and self._moment[0] == instant:
            samples = fields.seen(self._moment[1], small)
        else:
            samples = fields.render(small, lambda *_: not self._closed)
        now_s = time.monotonic()
        if not fresh:
            pace.took(now_s - start_s)
            self.counts.fast_took_s += now_s - start_s
        self.counts.ready(now_s)
        return Picture(view.scene_linear(samples), request, False)

    def _rests(self, serial: int) -> bool:
        """Whether requests have stopped changing for a moment."""
        with self._changed:
            return not self._changed.wait_for(lambda: self._serial != serial, REST_S)

    def _show(self, serial: int, picture: Picture) -> None:
        """A fast picture is shown though it is stale already: it is the latest there is."""
        with self._changed:
            if self._closed or (picture.is_final and self._serial != serial):
                return
            if self._wanted is not None:
                self._picture, self._error, self._news = picture, None, True

    def _fail(self, serial: int, sentence: str) -> None:
        with self._changed:
            if self._serial == serial and not self._closed:
                self._picture, self._error, self._news = None, sentence, True
                self._served = serial


@dataclass(frozen=True)
class _Instant:
    """Of a capture."""

    capture: Path
    stamp: view.Stamp
    time_s: float
