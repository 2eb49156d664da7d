"""The comparison with the truth: made, shown in the Video Editing workspace, or read as a report."""

from __future__ import annotations

import contextlib
import json
from pathlib import Path
from typing import Any

import bpy

from . import engine, fields, jobs, reels, view
from .errors import BadInputError
from .long_work import LongWork, Result, reported
from .operators import module_folder, python

WORKSPACE = "Video Editing"
"""Blender's own, in which strips are seen."""

MARK = "stlfr_comparison"
"""A property of the scenes that show a comparison: of which folder, and the scene's own name. Blender copies properties,
so a copy and a scene that was renamed have another's name there: they are the user's."""


class STLFR_OT_compare(LongWork, bpy.types.Operator):
    """Render what the capture has truth of, by the chosen methods, and set it beside the truth."""

    bl_idname = "stlfr.compare"
    bl_label = "Compare"

    def start(self, context: Any) -> jobs.Job:
        capture = engine.capture_folder(context.scene)
        must_have_truth(capture)
        options = view.options(context.scene.stlfr)
        options.pop("trail", None)
        script = Path(__file__).resolve().parent / "compare.py"
        command = [*python(), str(script), str(capture), str(module_folder())]
        return jobs.Job("Comparing", [*command, json.dumps(options)])

    def take(self, scene: Any, job: jobs.Job) -> tuple[str, str]:
        layout_file = Path(job.result["review"])
        show(bpy.context, layout_file)
        return "INFO", f"The comparison lies in {layout_file.parent}"


class STLFR_OT_open_review(bpy.types.Operator):
    """Show the comparison in the Video Editing workspace: truth, results and difference as strips."""

    bl_idname = "stlfr.open_review"
    bl_label = "Show Comparison"
    bl_options = {"REGISTER", "UNDO"}

    @reported
    def execute(self, context: Any) -> Result:
        scenes = show(context, review_file(context.scene, "review.json"))
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


def must_have_truth(capture: Path) -> None:
    """Refuse a capture that there is nothing to compare with."""
    fields.must_be_capture(capture)
    if not (capture / "truth" / "truth.json").is_file():
        raise BadInputError(
            f"{capture} has no truth to compare with: film it with Truth switched on"
        )


def review_file(scene: Any, name: str) -> Path:
    """A file of the chosen capture's comparison."""
    capture = engine.capture_folder(scene)
    fields.must_be_capture(capture)
    file = capture / "review" / name
    if not file.is_file():
        raise BadInputError(f"{capture} has no comparison yet: press Compare")
    return file


def show(context: Any, layout_file: Path) -> list[Any]:
    """Add a comparison's scenes in place of those of the same one before, and turn to them.

    Where that fails, those before stay. Copies that the user made of them, or has renamed, stay in any case.
    The window's own scene stays: the Video Editing workspace shows another one in its sequencer.
    """
    folder = str(layout_file.resolve().parent)
    before = [
        scene
        for scene in bpy.data.scenes
        if scene != context.scene and scene.get(MARK) == _mark(scene, folder)
    ]
    scenes = reels.add_all(layout_file, before)
    for scene in scenes:
        scene[MARK] = _mark(scene, folder)
    if context.window is not None and not bpy.app.background:
        workspace = _workspace(context)
        workspace.sequencer_scene = scenes[0]
        context.window.workspace = workspace
    return scenes


def _mark(scene: Any, folder: str) -> str:
    return f"{scene.name} of {folder}"


def _workspace(context: Any) -> Any:
    """The Video Editing workspace; taken from Blender's template where the file has none."""
    if WORKSPACE not in bpy.data.workspaces:
        for folder in bpy.utils.app_template_paths(path="Video_Editing"):
            with contextlib.suppress(RuntimeError):
                bpy.ops.workspace.append_activate(
                    idname=WORKSPACE, filepath=str(Path(folder) / "startup.blend")
                )
                break
    found = bpy.data.workspaces.get(WORKSPACE)
    if found is None:
        raise BadInputError(
            "the scenes are in this file, but Blender has no Video Editing workspace to show them in"
        )
    return found


CLASSES = (STLFR_OT_compare, STLFR_OT_open_review, STLFR_OT_open_report)

register, unregister = bpy.utils.register_classes_factory(CLASSES)
