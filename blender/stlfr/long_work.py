"""Base class of operators whose work is a job in a child process, and the job's progress in the status bar.

If the user opens another .blend file, a running job continues. At its end, its result is then only reported in the
panel, and nothing in the other file is changed.
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
"""Interval at which the panel's progress is updated. If larger, it lags; if smaller, Blender redraws its areas too
often.
"""

Result = set[str]


@dataclass(frozen=True)
class Followed:
    """A job whose .blend file was closed, and thus its operator deleted, with the functions to call at its end."""

    job: jobs.Job
    after: Callable[[jobs.Job], str]
    """Called if the job succeeded; returns a sentence that reports its result."""
    tidy: Callable[[], None]
    """Called if the job failed or was cancelled."""


_followed: list[Followed] = []


def reported(work: Callable[[Any, Any], Result]) -> Callable[[Any, Any], Result]:
    """Decorator for an operator's method: its errors are reported to the user, and the operator is cancelled.

    The method must have exactly the arguments operator and context, because Blender checks their number.
    """

    def method(self: Any, context: Any) -> Result:
        try:
            return work(self, context)
        except (BadInputError, FailureError) as error:
            self.report({"ERROR"}, words.in_blender(str(error)))
        except (OSError, RuntimeError) as error:
            # An error of the disk, or of one of Blender's own operators.
            self.report({"ERROR"}, " ".join(str(error).split()))
        return {"CANCELLED"}

    return method


class LongWork:
    """Base class of an operator whose work is a job in a child process.

    A script that calls the operator waits for the job. If the user presses its button, the job runs in the background.
    """

    job: jobs.Job
    scene_name: str
    timer: Any = None

    # Defined by the operator:
    report: Callable[[set[str], str], None]
    start: Callable[[Any], jobs.Job]
    """Starts the job for a Blender context, and returns it."""
    take: Callable[[Any, jobs.Job], tuple[str, str]]
    """Applies the result of a job to a scene; returns the kind of Blender report (such as `INFO`) and its sentence."""

    def tidying(self) -> Callable[[], None]:
        """The function to call after a job that failed or was cancelled. It must not refer to the operator."""
        return lambda: None

    def without_scene(self) -> Callable[[jobs.Job], str]:
        """The function to call after a job that succeeded, if its .blend file was closed.

        It must not refer to the operator. It returns the sentence that reports the result.
        """
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
        """Called when another file is opened or Blender exits. The job continues, unless Blender exits."""
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
    """Timer that follows the jobs whose .blend file was closed: shows their progress, and concludes them."""
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
    """Call what remains to be done after a job has ended, and add a message about the job for the panel.

    Raises no exception, because it would end the timer.
    """
    job = followed.job
    try:
        if job.error is not None:
            jobs.ended.append(f"{job.title} failed: {words.in_blender(job.error)}")
        if job.cancelled or job.error is not None:
            followed.tidy()
        else:
            jobs.ended.append(followed.after(job))
    except Exception as error:  # noqa: BLE001 - it would end the timer, and leave text in the status bar
        jobs.ended.append(f"{job.title}: {words.in_blender(str(error))}")


def progress_text(job: jobs.Job) -> str:
    """The progress of a job as text, such as `3 of 72: cam1, 2 min 5 s left`."""
    progress = job.progress
    if not progress.total:
        return f"{job.title}…"
    left = job.time_left_s
    rest = "" if left is None else f", {words.duration(left)} left"
    return f"{progress.done} of {progress.total}: {progress.what}{rest}"


def draw_progress(layout: Any, job: jobs.Job) -> None:
    """Draw a job's progress bar, and the button that cancels it, in one row."""
    row = layout.row(align=True)
    progress = job.progress
    factor = progress.done / progress.total if progress.total else 0.0
    row.progress(factor=min(1.0, factor), text=progress_text(job))
    row.operator("stlfr.cancel", text="", icon="CANCEL")


def show_progress(context: Any) -> None:
    """Show the running job in the status bar of every window, and redraw the areas with panels."""
    for window in context.window_manager.windows:
        window.workspace.status_text_set(_draw_status)
        for area in window.screen.areas:
            if area.type in ("VIEW_3D", "PROPERTIES"):
                area.tag_redraw()


def hide_progress() -> None:
    """Restore the normal text of the status bar in all workspaces."""
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
    """Stop following jobs whose .blend file was closed, and restore the status bar."""
    if bpy.app.timers.is_registered(_follow):
        bpy.app.timers.unregister(_follow)
    _followed.clear()
    # By a timer, because Blender crashes if windows are accessed while it exits; then the timer never runs.
    bpy.app.timers.register(hide_progress)
