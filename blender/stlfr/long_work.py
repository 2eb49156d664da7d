"""Operators whose work is a job beside Blender, and the progress that the status bar shows meanwhile.

A job outlives the file that it was begun in: another file may be opened. What it found is then said, and
nothing of the other file is changed.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import bpy

from . import jobs, words
from .errors import BadInputError, FailureError

POLL_S = 0.2
"""The interval at which the panel shows a job's progress. Larger, and it lags; smaller, and Blender redraws its areas
for nothing."""

Result = set[str]


@dataclass(frozen=True)
class Followed:
    """A job whose file was closed, and what is to be done after it. Its operator is gone by then."""

    job: jobs.Job
    after: Callable[[jobs.Job], str]
    """Where it found something; gives the sentence that says so."""
    tidy: Callable[[], None]
    """Where it found nothing."""


_followed: list[Followed] = []


def reported(work: Callable[[Any, Any], Result]) -> Callable[[Any, Any], Result]:
    """An operator's method whose errors become its report. Blender counts its arguments: operator and context."""

    def method(self: Any, context: Any) -> Result:
        try:
            return work(self, context)
        except (BadInputError, FailureError) as error:
            self.report({"ERROR"}, words.in_blender(str(error)))
        except (OSError, RuntimeError) as error:
            # Of the disk, or of one of Blender's own operators.
            self.report({"ERROR"}, " ".join(str(error).split()))
        return {"CANCELLED"}

    return method


class LongWork:
    """An operator whose work is a job."""

    job: jobs.Job
    scene_name: str
    timer: Any = None

    # The operator's own:
    report: Callable[[set[str], str], None]
    start: Callable[[Any], jobs.Job]
    """Gives the job, for a context."""
    take: Callable[[Any, jobs.Job], tuple[str, str]]
    """Takes over into a scene what a job found; gives the kind of a report, and its sentence."""

    def tidying(self) -> Callable[[], None]:
        """What is to be done after a job that found nothing; it doesn't need the operator."""
        return lambda: None

    def without_scene(self) -> Callable[[jobs.Job], str]:
        """What is to be done after a job whose file was closed; gives the sentence that says what it found."""
        return lambda job: f"{job.title} is done"

    @reported
    def execute(self, context: Any) -> Result:
        self._begin(context)
        self.job.wait()
        return self._end(context)

    def invoke(self, context: Any, _event: Any) -> Result:
        return self._begin_beside(context)

    @reported
    def _begin_beside(self, context: Any) -> Result:
        self._begin(context)
        self.timer = context.window_manager.event_timer_add(
            POLL_S, window=context.window
        )
        context.window_manager.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def modal(self, context: Any, event: Any) -> Result:
        if event.type != "TIMER":
            return {"PASS_THROUGH"}
        show_progress(context)
        if self.job.is_running:
            return {"PASS_THROUGH"}
        context.window_manager.event_timer_remove(self.timer)
        hide_progress()
        result = reported(LongWork._end)(self, context)
        with contextlib.suppress(RuntimeError):  # without an undo system
            bpy.ops.ed.undo_push(message=self.job.title)
        return result

    def cancel(self, context: Any) -> None:
        """Another file is opened, or Blender ends: the job goes on, unless Blender's end ends it."""
        context.window_manager.event_timer_remove(self.timer)
        _followed.append(Followed(self.job, self.without_scene(), self.tidying()))
        if not bpy.app.timers.is_registered(_follow):
            bpy.app.timers.register(_follow, first_interval=POLL_S, persistent=True)

    def _begin(self, context: Any) -> None:
        jobs.must_be_free()
        jobs.ended.clear()
        self.job = self.start(context)
        self.scene_name = context.scene.name  # the scene itself may move in memory

    def _end(self, _context: Any) -> Result:
        job = self.job
        if job.cancelled or job.error is not None:
            self.tidying()()
        if job.cancelled:
            self.report({"WARNING"}, f"{job.title} was cancelled")
            return {"CANCELLED"}
        if job.error is not None:
            jobs.ended.append(f"{job.title} failed: {words.in_blender(job.error)}")
            raise FailureError(job.error)
        scene = bpy.data.scenes.get(self.scene_name)
        if scene is None:
            raise FailureError(
                f"{job.title} is done, but scene {self.scene_name} is gone"
            )
        kind, sentence = self.take(scene, job)
        self.report({kind}, sentence)
        return {"FINISHED"}


def _follow() -> float | None:
    """Look after jobs whose file was closed."""
    show_progress(bpy.context)
    for followed in _followed[:]:
        if followed.job.is_running:
            continue
        _followed.remove(followed)
        conclude(followed)
        show_progress(bpy.context)
    if _followed:
        return POLL_S
    hide_progress()
    return None


def conclude(followed: Followed) -> None:
    """After the job's end: what is left to do, and the sentence about it for the panel. It raises nothing, so that the
    timer goes on.
    """
    job = followed.job
    try:
        if job.error is not None:
            jobs.ended.append(f"{job.title} failed: {words.in_blender(job.error)}")
        if job.cancelled or job.error is not None:
            followed.tidy()
        else:
            jobs.ended.append(followed.after(job))
    except Exception as error:  # noqa: BLE001 - the timer would end, and the status bar keep its text
        jobs.ended.append(f"{job.title}: {words.in_blender(str(error))}")


def progress_text(job: jobs.Job) -> str:
    """`3 of 72: cam1, 2 min 5 s left`."""
    progress = job.progress
    if not progress.total:
        return f"{job.title}…"
    left = job.time_left_s
    rest = "" if left is None else f", {words.duration(left)} left"
    return f"{progress.done} of {progress.total}: {progress.what}{rest}"


def draw_progress(layout: Any, job: jobs.Job) -> None:
    """One row: how far it is, and what ends it."""
    row = layout.row(align=True)
    progress = job.progress
    factor = progress.done / progress.total if progress.total else 0.0
    row.progress(factor=min(1.0, factor), text=progress_text(job))
    row.operator("stlfr.cancel", text="", icon="CANCEL")


def show_progress(context: Any) -> None:
    """Draw the job in the status bar of every window, where nothing scrolls it away, and the areas anew."""
    for window in context.window_manager.windows:
        window.workspace.status_text_set(_draw_status)
        for area in window.screen.areas:
            if area.type in ("VIEW_3D", "PROPERTIES"):
                area.tag_redraw()


def hide_progress() -> None:
    """Give the status bar back."""
    for workspace in bpy.data.workspaces:
        workspace.status_text_set(None)


def _draw_status(header: Any, _context: Any) -> None:
    job = jobs.running()
    if job is None:
        return
    layout = header.layout
    layout.label(text=job.title, icon="TIME")
    row = layout.row(align=True)
    row.ui_units_x = 20
    draw_progress(row, job)


def unregister() -> None:
    """Leave nothing behind."""
    if bpy.app.timers.is_registered(_follow):
        bpy.app.timers.unregister(_follow)
    _followed.clear()
    # Later: when Blender ends, it has taken its windows down already, and what touches them ends it by a crash.
    bpy.app.timers.register(hide_progress)
