"""The extension's operators: each checks its input, calls plain functions, and reports an error as one sentence.

If a script calls an operator with long work, the call waits for its end. If the user presses its button, the work runs
in the background, and the panel shows its progress.
"""

from __future__ import annotations

import functools
import shutil
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import bpy
from bpy.props import (
    BoolProperty,
    EnumProperty,
    FloatProperty,
    IntProperty,
    StringProperty,
)

import stlfr

from . import (
    engine,
    fields,
    filming,
    jobs,
    native,
    pictures,
    rig_objects,
    scenes,
    timing,
)
from .errors import BadInputError
from .long_work import LongWork, Result, reported
from .paths import absolute
from .properties import FROM_BLEND
from .rig_objects import shortest


class STLFR_OT_rig_create(bpy.types.Operator):
    """Create a new rig in place of the scene's rig, or else at the scene's camera."""

    bl_idname = "stlfr.rig_create"
    bl_label = "Create Rig"
    bl_options = {"REGISTER", "UNDO"}

    rig_name: StringProperty(name="Name", description="The rig's", default="rig")
    columns: IntProperty(
        name="Columns", description="Cameras side by side", default=8, min=1, max=100
    )
    rows: IntProperty(
        name="Rows", description="Cameras above each other", default=1, min=1, max=100
    )
    spacing_m: FloatProperty(
        name="Spacing",
        description="From one camera to the next",
        default=0.06,
        min=0.0,
        max=1e3,
        subtype="DISTANCE",
        precision=4,
    )
    width_px: IntProperty(
        name="Width",
        description="Of the images",
        default=640,
        min=8,
        max=16384,
        subtype="PIXEL",
    )
    height_px: IntProperty(
        name="Height",
        description="Of the images",
        default=480,
        min=8,
        max=16384,
        subtype="PIXEL",
    )
    lens_mm: FloatProperty(
        name="Lens",
        description="Focal length, for a sensor 36 mm wide",
        default=38.6,
        min=1.0,
        max=5000.0,
        subtype="DISTANCE_CAMERA",
        precision=1,
    )
    rate_hz: FloatProperty(
        name="Frames a Second",
        description="How often each camera takes an image",
        default=30.0,
        min=1e-3,
        max=1e5,
    )
    delays: EnumProperty(
        name="Delays",
        description="When the cameras take their first images",
        items=[
            ("random", "Random", "Each somewhere within one frame: not synchronized"),
            ("none", "None", "All at the same time: synchronized"),
        ],
    )
    jitter_s: FloatProperty(
        name="Jitter",
        description="Standard deviation of each image's time: how irregularly cameras trigger",
        default=0.001,
        min=0.0,
        precision=5,
        unit="TIME_ABSOLUTE",
    )
    seed: IntProperty(
        name="Seed",
        description="Another seed draws other delays and jitter",
        default=7,
        min=0,
    )

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
            "delays": self.delays,
            "jitters_s": [shortest(self.jitter_s)],
            "seed": self.seed,
        }
        rig_objects.build(context.scene, native.generate_rig(options))
        rig_objects.select(context.view_layer, rig_objects.all_of(context.scene))
        return {"FINISHED"}

    def invoke(self, context: Any, _event: Any) -> Result:
        return set(context.window_manager.invoke_props_dialog(self))


class STLFR_OT_rig_load(bpy.types.Operator):
    """Create the cameras of a rig file, replacing the scene's rig."""

    bl_idname = "stlfr.rig_load"
    bl_label = "Load Rig"
    bl_options = {"REGISTER", "UNDO"}

    filepath: StringProperty(subtype="FILE_PATH", options=FROM_BLEND)
    filter_glob: StringProperty(default="*.json", options={"HIDDEN"})

    @reported
    def execute(self, context: Any) -> Result:
        content = rig_objects.read(absolute(self.filepath))
        rig_objects.build(context.scene, content)
        rig_objects.select(context.view_layer, rig_objects.all_of(context.scene))
        return {"FINISHED"}

    def invoke(self, context: Any, _event: Any) -> Result:
        context.window_manager.fileselect_add(self)
        return {"RUNNING_MODAL"}


class STLFR_OT_rig_save(bpy.types.Operator):
    """Write the scene's rig to a rig file."""

    bl_idname = "stlfr.rig_save"
    bl_label = "Save Rig"

    filepath: StringProperty(
        subtype="FILE_PATH", default="//rig.json", options=FROM_BLEND
    )
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


class STLFR_OT_rig_show(bpy.types.Operator):
    """Select the rig, and center the 3D view on it."""

    bl_idname = "stlfr.rig_show"
    bl_label = "Show Rig"
    bl_options = {"REGISTER", "UNDO"}

    @reported
    def execute(self, context: Any) -> Result:
        rig_objects.select(context.view_layer, rig_objects.all_of(context.scene))
        if context.area is not None and context.area.type == "VIEW_3D":
            region = next(r for r in context.area.regions if r.type == "WINDOW")
            with context.temp_override(area=context.area, region=region):
                bpy.ops.view3d.view_selected("EXEC_DEFAULT", use_all_regions=False)
        return {"FINISHED"}


class STLFR_OT_film(LongWork, bpy.types.Operator):
    """Film a copy of this scene with the rig's cameras into a new capture, or resume filming that was stopped."""

    bl_idname = "stlfr.film"
    bl_label = "Film"

    resume: BoolProperty(
        name="Resume", description="Go on with the film that was stopped in that folder"
    )

    def start(self, context: Any) -> jobs.Job:
        self.folder = context.scene.stlfr.film_folder
        self.capture = absolute(self.folder)
        if not self.resume:
            prepare_film(context.scene, self.capture)
        command = filming.command(
            self.capture, python(), module_folder(), bpy.app.binary_path
        )
        return jobs.Job("Filming", command)

    def take(self, scene: Any, job: jobs.Job) -> tuple[str, str]:
        offset_s = filming.finish(self.capture)
        scene.stlfr.capture = self.folder
        scene.stlfr.start_frame = scene.frame_start
        scene.stlfr.time_offset_s = offset_s
        return "INFO", f"Filmed into {self.capture}"

    def without_scene(self) -> Callable[[jobs.Job], str]:
        capture = self.capture

        def after(_job: jobs.Job) -> str:
            filming.finish(capture)
            return f"The film in {capture} is done; its file is closed: choose that folder as the capture to use it"

        return after

    def tidying(self) -> Callable[[], None]:
        return functools.partial(filming.tidy, self.capture)


class STLFR_OT_offsets(LongWork, bpy.types.Operator):
    """Estimate the temporal offset of each camera from the images alone, and save the offsets in the capture."""

    bl_idname = "stlfr.offsets"
    bl_label = "Estimate Offsets"

    def start(self, context: Any) -> jobs.Job:
        capture = engine.capture_folder(context.scene)
        fields.must_be_capture(capture)
        script = Path(__file__).resolve().parent / "estimate.py"
        command = [*python(), str(script), str(capture), str(module_folder())]
        return jobs.Job("Estimating offsets", command)

    def take(self, scene: Any, job: jobs.Job) -> tuple[str, str]:
        return show_offsets(scene.stlfr.offsets, job.result["cameras"])


class STLFR_OT_picture(LongWork, bpy.types.Operator):
    """Render the quilt or stereo pair of this frame, or of every frame of the scene, to a file."""

    bl_idname = "stlfr.picture"
    bl_label = "Render Picture"

    animation: BoolProperty(
        name="Animation", description="Every frame of the scene, through its camera"
    )

    def start(self, context: Any) -> jobs.Job:
        scene = context.scene
        capture = engine.capture_folder(scene)
        fields.must_be_capture(capture)
        if scene.stlfr.layout == "VIEW":
            raise BadInputError("choose a quilt or a stereo pair; F12 renders the view")
        given = pictures.output(absolute(scene.stlfr.picture_file), self.animation)
        suffixes = {display["name"]: display["suffix"] for display in stlfr.displays()}
        self.file = pictures.written(scene.stlfr, given, suffixes)
        self.scratch = Path(tempfile.mkdtemp(prefix="stlfr-picture-"))
        try:
            frame = scene.frame_current, scene.frame_subframe
            seen = pictures.words(scene, self.scratch, self.animation)
            if self.animation:
                scene.frame_set(frame[0], subframe=frame[1])
            script = Path(__file__).resolve().parent / "picture.py"
            command = [*python(), str(script), str(module_folder()), str(capture)]
            return jobs.Job(
                "Rendering the picture", [*command, *seen, "-o", str(given)]
            )
        except BaseException:
            self.tidying()()
            raise

    def take(self, scene: Any, job: jobs.Job) -> tuple[str, str]:
        self.tidying()()
        if not self.animation:
            image = bpy.data.images.load(str(self.file), check_existing=True)
            image.reload()
        return "INFO", f"Rendered {self.file}"

    def without_scene(self) -> Callable[[jobs.Job], str]:
        file, tidy = self.file, self.tidying()

        def after(_job: jobs.Job) -> str:
            tidy()
            return f"Rendered {file}"

        return after

    def tidying(self) -> Callable[[], None]:
        return functools.partial(shutil.rmtree, self.scratch, ignore_errors=True)


class STLFR_OT_cancel(bpy.types.Operator):
    """Cancel the running work. Filming can be resumed later."""

    bl_idname = "stlfr.cancel"
    bl_label = "Cancel"

    @classmethod
    def poll(cls, _context: Any) -> bool:
        return jobs.running() is not None

    def execute(self, _context: Any) -> Result:
        jobs.end_all()
        return {"FINISHED"}


class STLFR_OT_set_range(bpy.types.Operator):
    """Set the scene's start and end to the first and last frame that the capture covers."""

    bl_idname = "stlfr.set_range"
    bl_label = "Set Scene Range"
    bl_options = {"REGISTER", "UNDO"}

    @reported
    def execute(self, context: Any) -> Result:
        scene = context.scene
        capture = engine.capture_folder(scene)
        fields.must_be_capture(capture)
        frames = timing.scene_range(timing.covered(scene, capture))
        if frames is None:
            raise BadInputError(
                "no whole frame of the scene is covered: change the speed or the time offset"
            )
        first, last = frames
        scene.frame_start, scene.frame_end = first, last
        scene.frame_set(min(max(scene.frame_current, first), last))
        return {"FINISHED"}


class STLFR_OT_dismiss(bpy.types.Operator):
    """Remove the messages about ended work from this panel."""

    bl_idname = "stlfr.dismiss"
    bl_label = "Dismiss"

    def execute(self, _context: Any) -> Result:
        jobs.ended.clear()
        return {"FINISHED"}


def python() -> list[str]:
    """The command that runs this Python, which has numpy, isolated from the user's Python settings."""
    return [sys.executable, *(bpy.app.python_args or ("-I",))]


def module_folder() -> Path:
    """The folder that contains the module `stlfr`, for child processes, which don't have it on their module path."""
    return Path(stlfr.__file__).resolve().parent.parent


def prepare_film(scene: Any, capture: Path) -> None:
    """Check the scene's rig, and write what filming needs into the folder: copies of the rig and of the .blend file.

    On an error, the folder is removed again.
    """
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
        workers=0 if settings.film_all_cores else settings.film_workers,
        lead_s=filming.lead_s(content),
    )
    blend = filming.begin(capture, content, options)
    try:
        rig_objects.write(content, blend.with_name(filming.RIG_COPY))
        scene[scenes.LEAD] = options.lead_s  # only for the copy; deleted below
        bpy.ops.wm.save_as_mainfile(
            filepath=str(blend), copy=True, check_existing=False, relative_remap=True
        )
        del scene[scenes.LEAD]
    except BaseException:
        scene.pop(scenes.LEAD, None)
        filming.tidy(capture)
        raise


def show_offsets(shown: Any, found: list[dict[str, Any]]) -> tuple[str, str]:
    """Fill the panel's list `shown` with estimated offsets. Returns the kind of Blender report, and its sentence."""
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


CLASSES = (
    STLFR_OT_rig_create,
    STLFR_OT_rig_load,
    STLFR_OT_rig_save,
    STLFR_OT_rig_show,
    STLFR_OT_film,
    STLFR_OT_offsets,
    STLFR_OT_picture,
    STLFR_OT_cancel,
    STLFR_OT_set_range,
    STLFR_OT_dismiss,
)

register, unregister = bpy.utils.register_classes_factory(CLASSES)
