"""Long work in a child process, which can be cancelled at any time and doesn't block Blender. Does not import `bpy`.

The process writes JSON lines to stdout: progress, `{"done", "total", "what"}`, and its result, `{"result"}`. If it
fails, the last line on stderr is the error, one sentence.
"""

from __future__ import annotations

import contextlib
import json
import signal
import subprocess
import threading
import time
from dataclasses import dataclass
from typing import Any

from .errors import FailureError

PATIENCE_S = 20.0
"""How long a cancelled process may take to end its own children before it is killed. If larger, Blender's window blocks
longer if the process hangs; if smaller, processes on a busy machine are killed while their children still run."""


@dataclass(frozen=True)
class Progress:
    """The progress of a job: `done` of `total` steps, and the current step. If `total` is 0, steps can't be counted."""

    done: int = 0
    total: int = 0
    what: str = ""


class Job:
    """A child process that runs, or has ended. All methods but `wait` and `cancel` return immediately.

    `title` names the job for the user. `result` is what the process reported as its result, or None.
    """

    def __init__(self, title: str, command: list[str]) -> None:
        self.title = title
        self.progress = Progress()
        self.result: Any = None
        self.cancelled = False
        self._first: tuple[float, int] | None = None
        self._errors: list[str] = []
        try:
            self._process = subprocess.Popen(
                command,
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                text=True,
                encoding="utf-8",
                errors="replace",
                start_new_session=True,  # a Ctrl-C is Blender's to handle
            )
        except OSError as error:
            raise FailureError(f"{title} can't start: {error}") from None
        self._readers = [
            threading.Thread(target=read, daemon=True)
            for read in (self._read_output, self._read_errors)
        ]
        for reader in self._readers:
            reader.start()
        _running.append(self)

    @property
    def is_running(self) -> bool:
        """Whether the process still runs, or its output isn't completely read yet. Afterwards, `result` is final."""
        return self._process.poll() is None or any(r.is_alive() for r in self._readers)

    @property
    def error(self) -> str | None:
        """Why the process failed, one sentence; None if it succeeded, still runs, or was cancelled."""
        if self.is_running or self.cancelled or self._process.returncode == 0:
            return None
        sentences = [line.strip() for line in self._errors if line.strip()]
        return (
            sentences[-1]
            if sentences
            else f"{self.title} ended with status {self._process.returncode}"
        )

    @property
    def time_left_s(self) -> float | None:
        """The estimated time until the process ends, from its speed so far; None if it is unknown."""
        progress = self.progress
        if self._first is None or progress.done <= self._first[1]:
            return None
        since_s, done_before = self._first
        pace_s = (time.monotonic() - since_s) / (progress.done - done_before)
        return pace_s * max(0, progress.total - progress.done)

    def wait(self) -> None:
        """Wait until the process has ended. If an exception such as Ctrl+C interrupts the wait, cancel the process."""
        try:
            self._process.wait()
            self._finish()
        except BaseException:
            self.cancel()
            raise

    def cancel(self) -> None:
        """Terminate the process, and wait until it and the processes that it has started have ended."""
        if self._process.poll() is None:
            self.cancelled = True
            self._process.send_signal(signal.SIGTERM)
            try:
                self._process.wait(PATIENCE_S)
            except subprocess.TimeoutExpired:
                self._process.kill()
                self._process.wait()
        self._finish()

    def _finish(self) -> None:
        for reader in self._readers:
            reader.join()
        with contextlib.suppress(ValueError):
            _running.remove(self)

    def _read_output(self) -> None:
        assert self._process.stdout is not None
        with self._process.stdout as lines:
            for line in lines:
                with contextlib.suppress(ValueError):
                    said = json.loads(line)
                    if isinstance(said, dict):
                        self._hear(said)

    def _hear(self, said: dict[str, Any]) -> None:
        if "result" in said:
            self.result = said["result"]
        elif {"done", "total"} <= said.keys():
            if self._first is None:
                self._first = (time.monotonic(), said["done"])
            self.progress = Progress(said["done"], said["total"], said.get("what", ""))

    def _read_errors(self) -> None:
        assert self._process.stderr is not None
        with self._process.stderr as lines:
            for line in lines:
                self._errors = [*self._errors[-9:], line]


_running: list[Job] = []

ended: list[str] = []
"""Messages for the panel, about jobs that failed, or that ended after their .blend file had been closed."""


def running() -> Job | None:
    """The job that is running, or None. At most one job runs at a time."""
    for job in _running[:]:
        if job.is_running:
            return job
        job._finish()
    return None


def must_be_free() -> None:
    """Raises `FailureError` if a job is running already."""
    job = running()
    if job is not None:
        raise FailureError(f"{job.title} is under way: wait for its end or cancel it")


def end_all() -> None:
    """Cancel all running jobs."""
    for job in _running[:]:
        job.cancel()
