"""Lets several processes, on one machine or on several that share a folder, film one capture. Does not import `bpy`.

A process claims an item of work by creating a file `.film/claims/ITEM.N`; creation fails if the file exists already.
Claims remain until the capture is complete. So a machine that sees an outdated state of the folder films nothing twice.
N is the number of earlier owners of the item: if the owner of claim N is silent for too long, another process takes
over with the claim N + 1.

Every process has a folder `.film/partial/NAME` for its incomplete images and its heartbeat, a number that it increments
every second. Other processes measure, by their own clocks, how long the number hasn't changed; so clocks of different
machines are never compared. The end of a process on the same machine is noticed immediately: the process, and the
filming processes that it started, held a lock on the heartbeat file.
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
"""Time between two heartbeats. If larger, `SILENCE_S` must be larger too; if smaller, more is written into the shared
folder."""

LOOK_S = 1.0
"""Time between two looks at the claims of other processes. If larger, their end is noticed later; if smaller, the
shared folder is read more often."""

SILENCE_S = 60
"""After this time without a heartbeat, other processes take over a process's work. If smaller, images are filmed twice
on a file system that shows changes late; if larger, the work of a machine that failed waits longer."""

HEARTBEAT = "heartbeat"

NAME_LINE = re.compile(r"[0-9a-f]{32}\n")
"""The content of a claim file: the name of the process that owns the claim."""

Item = TypeVar("Item")


class Member:
    """This process, as one of the processes that film a capture. The context manager starts and ends its heartbeat."""

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
            self.scratch.parent.rmdir()  # succeeds only if no other process has a folder there

    def _beat(self, count: int) -> None:
        # If writing keeps failing, other processes take over.
        with contextlib.suppress(OSError):
            os.lseek(self.lock, 0, os.SEEK_SET)
            os.write(self.lock, f"{self._machine:<80} {count:012}\n".encode())
            os.fsync(self.lock)

    def _beat_on(self) -> None:
        count = 0
        while not self._ended.wait(BEAT_S):
            count += 1
            self._beat(count)

    def begin(self) -> None:
        """Remove capture.json, which marks a complete capture, because an image will be filmed.

        Does nothing if another process has completed the capture meanwhile, as `end` removes this process's folder.
        """
        with contextlib.suppress(FileNotFoundError):
            (self.capture / plans.CAPTURE_FILE).replace(
                self.scratch / plans.CAPTURE_FILE
            )

    @property
    def is_over(self) -> bool:
        """Whether another process has completed the capture."""
        whole = (self.capture / plans.CAPTURE_FILE).is_file()
        return whole and not self.claims.is_dir()

    def end(self) -> None:
        """Remove all claims and incomplete images, because the capture is complete."""
        with contextlib.suppress(OSError):
            self.claims.rename(self.scratch / "claims")  # removes all claims atomically
        shutil.rmtree(scratch_folder(self.capture), ignore_errors=True)

    def claim(self, item: str, owners: int) -> bool:
        """Try to claim an item of work that had `owners` earlier owners. Returns whether this process now owns it."""
        flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL
        try:
            claim = os.open(self.claims / f"{item}.{owners}", flags, 0o666)
        except FileExistsError:
            return False
        with os.fdopen(claim, "w", encoding="ascii") as stream:
            stream.write(self.name + "\n")
        return True

    def may_claim(self, item: str, owners: int) -> bool:
        """Whether the last of the item's `owners` earlier owners has ended or is silent for too long."""
        claim = self.claims / f"{item}.{owners - 1}"
        text = _text(claim) or ""
        # An incomplete claim is being written, or its owner ended while writing it.
        if not NAME_LINE.fullmatch(text):
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
    """Items of work that are shared by several processes, so that each item is done once.

    `items` has the items by name. `on_done_elsewhere` is called for each item that another process has done.
    """

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
        """The number of owners so far of each item that another process has claimed and not done yet, by name."""
        self._next_look_s = 0.0

    @property
    def is_over(self) -> bool:
        """Whether every item is done, or was taken by this process."""
        return not self._untried and not self._owners

    def take(self) -> Item | None:
        """Claim and return an item that isn't done and that no running process has claimed; None if there is none.

        An item may become free later, if its owner stops; `is_over` tells whether this is possible.
        """
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
        """Yields the items that this process has claimed, until all items are done; waits for other processes."""
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
    """Assign the folder `capture` to this plan, as `plan.claim` does; other processes may do so at the same time."""
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
    """The text of a file; None if the file doesn't exist, and an empty text if it can't be read."""
    try:
        return reading.read_text(path)
    except FileNotFoundError:
        return None
    except (OSError, ValueError):
        return ""


def _machine() -> str:
    """An identifier of this machine since its last boot; empty if it is unknown."""
    try:
        return Path("/proc/sys/kernel/random/boot_id").read_text("ascii").strip()
    except OSError:
        return ""


def _is_free(heartbeat: Path) -> bool:
    """Whether no process holds a lock on this heartbeat file."""
    try:
        with heartbeat.open("rb") as stream:
            return _locks(stream.fileno(), exclusively=False)
    except OSError:
        return False


def _locks(descriptor: int, exclusively: bool) -> bool:
    """Try to lock an open file. Returns whether it succeeded.

    The lock lasts until this process, and all processes that inherited the descriptor, have closed the file.
    """
    try:
        import fcntl  # not on Windows

        how = fcntl.LOCK_EX if exclusively else fcntl.LOCK_SH
        fcntl.flock(descriptor, how | fcntl.LOCK_NB)
    except (ImportError, OSError):
        return False
    return True
