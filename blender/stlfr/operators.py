"""What the user presses: each checks, calls plain functions, and says what went wrong in one sentence.

Called from a script, long work is waited for. Pressed, it runs beside Blender and the panel shows how
far it is.
"""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import bpy
from bpy.props import BoolProperty, FloatProperty, IntProperty, StringProperty

import stlfr

from . import engine, filming, jobs, native, rig_objects
from .errors import BadInputError, FailureError
from .paths import absolute
from .rig_objects import shortest

POLL_S = 0.2
"""The interval at which the panel shows a job's progress. Larger, and it lags; smaller, and Blender redraws its areas
for nothing."""

Result = set[str]


def reported(work: Callable[[Any, Any], Result]) -> Callable[[Any, Any], Result]:
    """An operator's method whose errors become its report. Blender counts its arguments: operator and context."""

    def method(self: Any, context: Any) -> Result:
        try:
            return work(self, context)
        except (BadInputError, FailureError) as error:
            self.report({"ERROR"}, str(error))
        except (OSError, RuntimeError) as error:
            # Of the disk, or of one of Blender's own operators.
            self.report({"ERROR"}, " ".join(str(error).split()))
        return {"CANCELLED"}

    return method


class STLFR_OT_rig_create(bpy.types.Operator):
    """Put a new rig where the scene's camera stands, in place of the rig there is."""

    bl_idname = "stlfr.rig_create"
    bl_label = "Create Rig"
    bl_options = {"REGISTER", "UNDO"}

    rig_name: StringProperty(name="Name", default="rig")
    columns: IntProperty(name="Columns", default=8, min=1, max=100)
    rows: IntProperty(name="Rows", default=1, min=1, max=100)
    spacing_m: FloatProperty(
        name="Spacing", default=0.06, min=0.0, max=1e3, subtype="DISTANCE", precision=4
    )
    width_px: IntProperty(name="Width", default=640, min=8, max=16384)
    height_px: IntProperty(name="Height", default=480, min=8, max=16384)
    lens_mm: FloatProperty(name="Lens", default=38.6, min=1.0, max=5000.0)
    rate_hz: FloatProperty(name="Rate", default=30.0, min=1e-3, max=1e5)
    jitter_s: FloatProperty(name="Jitter", default=0.001, min=0.0, precision=6)
    seed: IntProperty(name="Seed", default=7, min=0)

    @reported
    def execute(self, context: Any) -> Result:
        grid = {"rows": self.rows, "columns": self.columns}
        options = {
            "name": self.rig_name,
            "layout": {"line": {"count": self.columns}}
            if self.rows == 1
            else {"grid": grid},
            "spacing_m": shortest(self.spacing_m),
            "sizes_px": [[self.width_px, self.height_px]],
            "lenses_mm": [shortest(self.lens_mm)],
            "rates_hz": [shortest(self.rate_hz)],
            "jitters_s": [shortest(self.jitter_s)],
            "seed": self.seed,
        }
        rig_objects.build(context.scene, native.generate_rig(options))
        return {"FINISHED"}

    def invoke(self, context: Any, _event: Any) -> Result:
        return set(context.window_manager.invoke_props_dialog(self))


class STLFR_OT_rig_load(bpy.types.Operator):
    """Set up the cameras of a rig file, in place of the rig there is."""

    bl_idname = "stlfr.rig_load"
    bl_label = "Load Rig"
    bl_options = {"REGISTER", "UNDO"}

    filepath: StringProperty(subtype="FILE_PATH")
    filter_glob: StringProperty(default="*.json", options={"HIDDEN"})

    @reported
    def execute(self, context: Any) -> Result:
        content = rig_objects.read(absolute(self.filepath))
        rig_objects.build(context.scene, content)
        return {"FINISHED"}

    def invoke(self, context: Any, _event: Any) -> Result:
        context.window_manager.fileselect_add(self)
        return {"RUNNING_MODAL"}


class STLFR_OT_rig_save(bpy.types.Operator):
    """Write the scene's rig to a rig file."""

    bl_idname = "stlfr.rig_save"
    bl_label = "Save Rig"

    filepath: StringProperty(subtype="FILE_PATH", default="//rig.json")
    filter_glob: StringProperty(default="*.json", options={"HIDDEN"})
    check_existing: BoolProperty(default=True, options={"HIDDEN"})

    @reported
    def execute(self, context: Any) -> Result:
        content = rig_objects.describe(context.scene)
        rig_objects.write(content, absolute(self.filepath))
        return {"FINISHED"}

    def invoke(self, context: Any, _event: Any) -> Result:
        context.window_manager.fileselect_add(self)
        return {"RUNNING_MODAL"}


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

    def tidy(self) -> None:
        """After a job that found nothing."""

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
        for area in context.screen.areas if context.screen else ():
            area.tag_redraw()
        if self.job.is_running:
            return {"PASS_THROUGH"}
        context.window_manager.event_timer_remove(self.timer)
        result = reported(LongWork._end)(self, context)
        with contextlib.suppress(RuntimeError):  # without an undo system
            bpy.ops.ed.undo_push(message=self.job.title)
        return result

    def cancel(self, context: Any) -> None:
        """Another file is opened, or Blender ends."""
        self.job.cancel()
        context.window_manager.event_timer_remove(self.timer)

    def _begin(self, context: Any) -> None:
        jobs.must_be_free()
        self.job = self.start(context)
        self.scene_name = context.scene.name  # the scene itself may move in memory

    def _end(self, _context: Any) -> Result:
        job = self.job
        if job.cancelled or job.error is not None:
            self.tidy()
        if job.cancelled:
            self.report({"WARNING"}, f"{job.title} was cancelled")
            return {"CANCELLED"}
        if job.error is not None:
            raise FailureError(job.error)
        scene = bpy.data.scenes.get(self.scene_name)
        if scene is None:
            raise FailureError(
                f"{job.title} is done, but scene {self.scene_name} is gone"
            )
        kind, sentence = self.take(scene, job)
        self.report({kind}, sentence)
        return {"FINISHED"}


class STLFR_OT_film(LongWork, bpy.types.Operator):
    """Film a copy of this scene with the rig's cameras into a new capture, or go on with a film that was stopped."""

    bl_idname = "stlfr.film"
    bl_label = "Film"

    resume: BoolProperty(
        name="Resume", description="Go on with the film that was stopped in that folder"
    )

    def start(self, context: Any) -> jobs.Job:
        self.capture = absolute(context.scene.stlfr.film_folder)
        if not self.resume:
            prepare_film(context.scene, self.capture)
        command = filming.command(
            self.capture, python(), module_folder(), bpy.app.binary_path
        )
        return jobs.Job("Filming", command)

    def take(self, scene: Any, job: jobs.Job) -> tuple[str, str]:
        scene.stlfr.time_offset_s = filming.finish(self.capture)
        scene.stlfr.capture = str(self.capture)
        scene.stlfr.offsets.clear()
        return "INFO", f"Filmed into {self.capture}"

    def tidy(self) -> None:
        filming.tidy(self.capture)


class STLFR_OT_offsets(LongWork, bpy.types.Operator):
    """Estimate how far each camera's clock is off, from the pixels alone, and save the offsets in the capture."""

    bl_idname = "stlfr.offsets"
    bl_label = "Estimate Offsets"

    def start(self, context: Any) -> jobs.Job:
        capture = engine.capture_folder(context.scene)
        script = Path(__file__).resolve().parent / "estimate.py"
        command = [*python(), str(script), str(capture), str(module_folder())]
        return jobs.Job("Estimating offsets", command)

    def take(self, scene: Any, job: jobs.Job) -> tuple[str, str]:
        return show_offsets(scene.stlfr.offsets, job.result["cameras"])


class STLFR_OT_cancel(bpy.types.Operator):
    """End the work that is under way; a film can be resumed."""

    bl_idname = "stlfr.cancel"
    bl_label = "Cancel"

    @classmethod
    def poll(cls, _context: Any) -> bool:
        return jobs.running() is not None

    def execute(self, _context: Any) -> Result:
        jobs.end_all()
        return {"FINISHED"}


class STLFR_OT_open_review(bpy.types.Operator):
    """Add the scenes of the comparison's review.blend to this file: truth and results as strips."""

    bl_idname = "stlfr.open_review"
    bl_label = "Load Comparison"
    bl_options = {"REGISTER", "UNDO"}

    @reported
    def execute(self, context: Any) -> Result:
        scenes = append_scenes(review_file(context.scene, "review.blend"))
        if context.window is not None:
            context.window.scene = scenes[0]
        self.report({"INFO"}, f"Added {', '.join(scene.name for scene in scenes)}")
        return {"FINISHED"}


class STLFR_OT_open_report(bpy.types.Operator):
    """Open the comparison's report in the browser."""

    bl_idname = "stlfr.open_report"
    bl_label = "Open Report"

    @reported
    def execute(self, context: Any) -> Result:
        url = review_file(context.scene, "report.html").as_uri()
        return set(bpy.ops.wm.url_open(url=url))


def python() -> list[str]:
    """A Python with numpy, and with `bpy` if that is a module; without the user's own settings."""
    return [sys.executable, *(bpy.app.python_args or ("-I",))]


def module_folder() -> Path:
    """The folder that holds the module `stlfr`: another Python doesn't find it by itself."""
    return Path(stlfr.__file__).resolve().parent.parent


def prepare_film(scene: Any, capture: Path) -> None:
    """Check the rig, and lay down what is filmed: copies of the rig and of the .blend as they are now."""
    settings = scene.stlfr
    if bpy.context.scene != scene:
        raise BadInputError(f"scene {scene.name} isn't the one that is shown")
    content = rig_objects.describe(scene)
    options = filming.Options(
        title=Path(bpy.data.filepath).stem or scene.name,
        frames=settings.film_frames,
        samples=settings.film_samples,
        truth=settings.film_truth,
        instants=settings.film_instants,
        workers=settings.film_workers,
    )
    blend = filming.begin(capture, content, options)
    try:
        rig_objects.write(content, blend.with_name(filming.RIG_COPY))
        bpy.ops.wm.save_as_mainfile(
            filepath=str(blend), copy=True, check_existing=False, relative_remap=True
        )
    except BaseException:
        filming.tidy(capture)
        raise


def show_offsets(shown: Any, found: list[dict[str, Any]]) -> tuple[str, str]:
    """Put estimated offsets into the list; gives the kind of a report about them, and its sentence."""
    shown.clear()
    for camera in found:
        item = shown.add()
        item.camera_id = camera["id"]
        item.is_known = camera["offset_s"] is not None
        item.offset_s = camera["offset_s"] or 0.0
        item.std_err_s = camera["std_err_s"] or 0.0
        item.reason = camera.get("reason", "")
    unknown = [camera for camera in found if camera["offset_s"] is None]
    if not unknown:
        return "INFO", f"The offsets of all {len(found)} cameras are known"
    first = unknown[0]
    return "WARNING", (
        f"{len(unknown)} of {len(found)} cameras have an unknown offset: "
        f"{', '.join(camera['id'] for camera in unknown)} ({first['id']}: {first.get('reason', 'no reason given')})"
    )


def review_file(scene: Any, name: str) -> Path:
    """A file that `stlfr compare` has written for the chosen capture."""
    capture = engine.capture_folder(scene)
    file = capture / "review" / name
    if not file.is_file():
        raise BadInputError(
            f"{file} isn't there: make the comparison with `stlfr compare {capture}`"
        )
    return file


def append_scenes(blend: Path) -> list[Any]:
    """Add the scenes of another .blend to this one."""
    with bpy.data.libraries.load(str(blend), link=False) as (there, here):
        here.scenes = list(there.scenes)
    if not here.scenes:
        raise BadInputError(f"{blend} holds no scene")
    return list(here.scenes)


CLASSES = (
    STLFR_OT_rig_create,
    STLFR_OT_rig_load,
    STLFR_OT_rig_save,
    STLFR_OT_film,
    STLFR_OT_offsets,
    STLFR_OT_cancel,
    STLFR_OT_open_review,
    STLFR_OT_open_report,
)

register, unregister = bpy.utils.register_classes_factory(CLASSES)
