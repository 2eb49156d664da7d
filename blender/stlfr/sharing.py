"""Processes, on one machine or on several that share a folder, film one capture together. No `bpy` here.

A process claims an item of the work by creating a file, `.film/claims/ITEM.N`, which no second one can create.
Claims stay until the capture is whole: a machine whose view of the folder is old films nothing again. N counts
the owners: the item of an owner that is silent for too long is claimed as N + 1.

Every process has a folder `.film/partial/NAME` for its half-written images and its heartbeat, a number that
it counts up every second. The others measure by their own clocks how long the number has stood still; no
clocks of two machines are compared. A process that ended on this machine is known at once: it, and the
filming processes that it has started, held a lock on the heartbeat.
"""

from __future__ import annotations

import contextlib
import os
import re
import shutil
import threading
import time
import uuid
from collections import deque
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Generic, Self, TypeVar

from . import plan as plans
from . import reading
from .errors import BadInputError
from .folder import scratch_folder

BEAT_S = 1.0
"""Between two heartbeats. Larger needs a longer silence; smaller writes more often into the shared folder."""

LOOK_S = 1.0
"""Between two looks at what others do. Larger, and the end is noticed later; smaller reads more often."""

SILENCE_S = 60
"""After so many seconds without a heartbeat others take over. Smaller, and a file system that shows changes late makes
images be filmed twice; larger, and the items of a machine that died wait longer."""

HEARTBEAT = "heartbeat"

NAME_LINE = re.compile(r"[0-9a-f]{32}\n")
"""What a claim holds: its owner's name."""

Item = TypeVar("Item")


class Member:
    """This process among those that film a capture. Leaving the context leaves them."""

    def __init__(self, capture: Path, silence_s: float = SILENCE_S) -> None:
        self.capture = capture
        self.silence_s = silence_s
        self.claims = capture / plans.HIDDEN_FOLDER / "claims"
        self.name = uuid.uuid4().hex
        self.scratch = scratch_folder(capture) / self.name
        self._ended = threading.Event()
        self._heard: dict[str, tuple[str, float]] = {}

    def __enter__(self) -> Self:
        self.claims.mkdir(parents=True, exist_ok=True)
        self.scratch.mkdir(parents=True)
        flags = os.O_RDWR | os.O_CREAT | os.O_EXCL
        self.lock = os.open(self.scratch / HEARTBEAT, flags, 0o666)
        self._machine = _machine() if _locks(self.lock, exclusively=True) else ""
        self._beat(0)
        self._beating = threading.Thread(target=self._beat_on, daemon=True)
        self._beating.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        self._beating.join()
        os.close(self.lock)
        shutil.rmtree(self.scratch, ignore_errors=True)
        with contextlib.suppress(OSError):
            self.scratch.parent.rmdir()  # if it was the last one's

    def _beat(self, count: int) -> None:
        with contextlib.suppress(OSError):  # the others take over if it lasts
            os.lseek(self.lock, 0, os.SEEK_SET)
            os.write(self.lock, f"{self._machine:<80} {count:012}\n".encode())
            os.fsync(self.lock)

    def _beat_on(self) -> None:
        count = 0
        while not self._ended.wait(BEAT_S):
            count += 1
            self._beat(count)

    def begin(self) -> None:
        """Say that the capture is not whole any more."""
        (self.capture / plans.CAPTURE_FILE).unlink(missing_ok=True)

    @property
    def is_over(self) -> bool:
        """Whether another process has made the capture whole meanwhile."""
        whole = (self.capture / plans.CAPTURE_FILE).is_file()
        return whole and not self.claims.is_dir()

    def end(self) -> None:
        """Remove all claims and half-written images: the capture is whole."""
        with contextlib.suppress(OSError):
            self.claims.rename(self.scratch / "claims")  # all at once
        shutil.rmtree(scratch_folder(self.capture), ignore_errors=True)

    def claim(self, item: str, owners: int) -> bool:
        """Whether this process becomes the item's next owner, after so many earlier ones."""
        flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL
        try:
            claim = os.open(self.claims / f"{item}.{owners}", flags, 0o666)
        except FileExistsError:
            return False
        with os.fdopen(claim, "w", encoding="ascii") as stream:
            stream.write(self.name + "\n")
        return True

    def may_claim(self, item: str, owners: int) -> bool:
        """Whether the last of the item's owners films no more."""
        claim = self.claims / f"{item}.{owners - 1}"
        text = _text(claim) or ""
        if not NAME_LINE.fullmatch(text):  # its owner is writing it, or died of that
            return self._is_silent(claim.name, "")
        heartbeat = self.scratch.with_name(text.strip()) / HEARTBEAT
        beat = _text(heartbeat)
        if beat is None:
            return True
        if self._machine and beat.startswith(self._machine) and _is_free(heartbeat):
            return True
        return self._is_silent(text, beat)

    def _is_silent(self, name: str, beat: str) -> bool:
        now_s = time.monotonic()
        last, since_s = self._heard.get(name, ("?", now_s))
        if last != beat:
            self._heard[name] = (beat, now_s)
            return False
        return now_s - since_s > self.silence_s


class Shared(Generic[Item]):
    """Items of work that several processes do, each of them once."""

    def __init__(
        self,
        member: Member,
        items: dict[str, Item],
        is_done: Callable[[Item], bool],
        on_done_elsewhere: Callable[[Item], None],
    ) -> None:
        self.member = member
        self.items = items
        self.is_done = is_done
        self.on_done_elsewhere = on_done_elsewhere
        self._untried = deque(items)
        self._owners: dict[str, int] = {}
        """Of the items that others have claimed and not done yet."""
        self._next_look_s = 0.0

    @property
    def is_over(self) -> bool:
        """Whether all items are done, but those that this process took."""
        return not self._untried and not self._owners

    def take(self) -> Item | None:
        """An item that nobody does and that is not done; None if there is none now."""
        name = self._claimed()
        if name is None:
            return None
        self.member.begin()
        return self.items[name]

    def _claimed(self) -> str | None:
        while self._untried:
            name = self._untried.popleft()
            if not self.member.claim(name, 0):
                self._owners[name] = 1
            elif self._is_left(name):
                return name
        if time.monotonic() < self._next_look_s:
            return None
        for name in list(self._owners):
            if self._is_left(name) and self._inherits(name):
                del self._owners[name]
                if self._is_left(name):
                    return name
        self._next_look_s = time.monotonic() + LOOK_S
        return None

    def each(self) -> Iterator[Item]:
        """The items that this process has to do, until all are done."""
        while not self.is_over:
            item = self.take()
            if item is not None:
                yield item
            elif not self.is_over:
                time.sleep(LOOK_S)

    def _inherits(self, name: str) -> bool:
        if not self.member.may_claim(name, self._owners[name]):
            return False
        self._owners[name] += 1
        return self.member.claim(name, self._owners[name] - 1)

    def _is_left(self, name: str) -> bool:
        if self.is_done(self.items[name]):
            self._owners.pop(name, None)
            self.on_done_elsewhere(self.items[name])
            return False
        return True


def claim_folder(plan: plans.Plan, capture: Path) -> None:
    """Make the folder this plan's, as `plan.claim` does, also where others do the same at this moment."""
    for attempt in range(4):
        try:
            plans.claim(plan, capture)
            return
        except (BadInputError, FileNotFoundError):
            plan_file = capture / plans.HIDDEN_FOLDER / plans.PLAN_FILE
            if attempt == 3 or not plan_file.is_file():
                raise
            time.sleep(0.1)


def _text(path: Path) -> str | None:
    """What a file holds; None if it isn't there, and nothing if it can't be read now."""
    try:
        return reading.read_text(path)
    except FileNotFoundError:
        return None
    except (OSError, ValueError):
        return ""


def _machine() -> str:
    """What only processes of this machine, since it started, have in common; empty if that is unknown."""
    try:
        return Path("/proc/sys/kernel/random/boot_id").read_text("ascii").strip()
    except OSError:
        return ""


def _is_free(heartbeat: Path) -> bool:
    """Whether no process holds its lock any more."""
    try:
        with heartbeat.open("rb") as stream:
            return _locks(stream.fileno(), exclusively=False)
    except OSError:
        return False


def _locks(descriptor: int, exclusively: bool) -> bool:
    """Whether the file gets locked until it is closed, by this process and those that inherit it."""
    try:
        import fcntl  # not on Windows

        how = fcntl.LOCK_EX if exclusively else fcntl.LOCK_SH
        fcntl.flock(descriptor, how | fcntl.LOCK_NB)
    except (ImportError, OSError):
        return False
    return True
