"""Renders the pictures of a viewport in background threads; a new request replaces the previous one.

While the view or the time changes, a fast method renders pictures, with a resolution adapted to the machine's speed:
scene flow if it is chosen and its results are there, else the preset `draft`.
When nothing has changed for `REST_S`, the chosen methods render a picture at full resolution. If something changes
then, this full picture is abandoned at its next step. A fast picture is always finished and shown; otherwise, nothing
would be seen while requests change faster than pictures are rendered. Does not import `bpy`.
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
from .view import Linear, Request, Samples

if TYPE_CHECKING:
    import stlfr

FAST = {"preset": "draft"}
"""The render options of the fast method, used while the view or the time changes, unless scene flow is ready."""

REST_S = 0.15
"""Time without changes after which the chosen methods begin to render. If larger, the full picture is late; if smaller,
it is often begun in vain between two movements of the mouse."""

SLOW_S, QUICK_S = 1 / 12, 1 / 30
"""If a fast picture takes longer than `SLOW_S`, the next one has a lower resolution; if it takes less than `QUICK_S`, a
higher one. If they are further apart, the resolution stays too low or too high; if closer, it flickers."""

SMALLEST = 0.25
"""Minimum resolution of fast pictures, as a fraction of the full resolution. If larger, slow machines lag; if smaller,
the scene can't be recognized."""

STEP = 0.7
"""Factor of one change of the resolution. Nearer to 1, adapting takes many pictures; if smaller, the resolution
jumps."""

PATIENCE_S = 5.0
"""How long closing waits for a rendering thread to end. If larger, Blender's window may hang; if smaller, Blender may
exit while the thread still runs."""


@dataclass(frozen=True)
class Picture:
    """A rendered picture with its request."""

    pixels: Linear
    request: Request
    is_final: bool
    """Whether the chosen methods rendered it at full resolution; if false, the fast method rendered it."""


@dataclass
class Pace:
    """The resolution of fast pictures, adapted to their rendering times; `factor` is its fraction of the full one."""

    factor: float = 1.0

    def took(self, seconds: float) -> None:
        """Adapt the resolution to the rendering time of the last picture."""
        if seconds > SLOW_S:
            self.factor = max(SMALLEST, self.factor * STEP)
        elif seconds < QUICK_S:
            self.factor = min(1.0, self.factor / STEP)


@dataclass
class Counts:
    """Statistics of the rendered pictures, for the viewport's status line and for benchmarks.

    `took` in a name marks a duration in seconds. All other times are seconds on the monotonic clock.
    """

    fast: int = 0
    final: int = 0
    final_took_s: float = 0.0
    fast_took_s: float = 0.0
    """Total rendering time of the fast pictures, without loading, and without those that also prepared an instant."""
    fast_drawn: int = 0
    asked_s: float = 0.0
    """When the latest new request was made."""
    final_drawn_s: float = 0.0
    """When a full picture was last drawn."""
    times_s: list[float] = field(default_factory=list)
    """When each of the latest fast pictures was ready; at most 21 since the last pause."""

    def drawn(self, is_final: bool) -> None:
        """Count a picture that the viewport has drawn."""
        if is_final:
            self.final_drawn_s = time.monotonic()
        else:
            self.fast_drawn += 1

    @property
    def rate_hz(self) -> float:
        """Fast pictures per second since the last pause, over at most 21 pictures; 0 if there are fewer than two."""
        times = self.times_s
        if len(times) < 2 or times[-1] <= times[0]:
            return 0.0
        return (len(times) - 1) / (times[-1] - times[0])

    def ready(self, now_s: float) -> None:
        """Count a fast picture that is ready at `now_s`. After a pause of a second, the rate is measured anew."""
        if self.times_s and now_s - self.times_s[-1] > 1.0:
            self.times_s.clear()
        self.times_s = [*self.times_s[-20:], now_s]
        self.fast += 1


class Live:
    """Renders the pictures of one viewport. `want` and the properties return immediately, in any thread."""

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
        self._preview_pace = Pace()
        self._moment: tuple[_Instant, stlfr.Moment] | None = None
        self._last: _Instant | None = None
        self.counts = Counts()

    def want(self, request: Request) -> bool:
        """Request a picture, replacing the previous request. Returns whether the two requests differ."""
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
        """Drop the latest picture and the current request."""
        with self._changed:
            self._wanted = self._picture = self._error = None
            self._serial += 1
            self._served = self._begun = self._serial
            self._changed.notify_all()

    @property
    def picture(self) -> Picture | None:
        """The latest picture; None before the first picture and after an error."""
        return self._picture

    @property
    def error(self) -> str | None:
        """Why the last rendering failed, one sentence; None if it didn't."""
        return self._error

    @property
    def is_closed(self) -> bool:
        """Whether `close` was called."""
        return self._closed

    @property
    def is_busy(self) -> bool:
        """Whether the current request may still yield another picture."""
        return not self._closed and self._served != self._serial

    def take_news(self) -> bool:
        """Whether there is a new picture or error to draw since the last call of this method."""
        with self._changed:
            news, self._news = self._news, False
        return news

    def close(self, patience_s: float = 0.0) -> None:
        """Stop rendering for good. Waits for each of the two threads, at most `patience_s` seconds."""
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
        """Start rendering the full picture in another thread, if the request doesn't change for `REST_S`.

        Its steps may take long, and fast pictures must not wait until an abandoned full picture reaches its next step.
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
        """Run `work`; store its error, if the request is still the current one. Returns whether it succeeded."""
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
        """Render a picture by scene flow if its results are there, else by the preset `draft`."""
        pace = self._preview_pace
        small = replace(request, camera=viewpoint.scaled(request.camera, pace.factor))
        # Loading counts apart: a lower resolution doesn't make it faster.
        samples = None
        if fields.load_preview(small):
            start_s = time.monotonic()
            samples = fields.preview(small)
            if samples is not None:
                self._took(start_s, pace)
        if samples is None:
            samples = self._draft(request)
        self.counts.ready(time.monotonic())
        return Picture(view.scene_linear(samples), request, False)

    def _took(self, start_s: float, pace: Pace) -> None:
        """Count the rendering time of a fast picture, and adapt the resolution of the next ones to it."""
        seconds = time.monotonic() - start_s
        pace.took(seconds)
        self.counts.fast_took_s += seconds

    def _draft(self, request: Request) -> Samples:
        """Render a picture by the preset. From the second view of an instant on, shared results are cached."""
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
        if not fresh:
            self._took(start_s, pace)
        return samples

    def _rests(self, serial: int) -> bool:
        """Wait for `REST_S`. Returns whether the request didn't change in this time."""
        with self._changed:
            return not self._changed.wait_for(lambda: self._serial != serial, REST_S)

    def _show(self, serial: int, picture: Picture) -> None:
        """Publish a picture. A fast picture is published even if the request has changed, as it is the latest one."""
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
    """An instant of a capture; `stamp` changes if the capture's files change."""

    capture: Path
    stamp: view.Stamp
    time_s: float
