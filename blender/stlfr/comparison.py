"""Operators for the comparison with the ground truth: run it, show it in the video sequencer, open its report."""

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
"""Name of Blender's workspace with the video sequencer."""

MARK = "stlfr_comparison"
"""Name of a custom property of scenes that show a comparison. Its value is the comparison's folder and the scene's
name. If the name in it differs from the scene's name, the user has copied or renamed the scene, and it isn't
replaced."""


class STLFR_OT_compare(LongWork, bpy.types.Operator):
    """Render the views that have a ground truth, by the chosen methods, and compare them with the ground truth."""

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
    """Show the comparison in the Video Editing workspace: ground truth, results and difference as strips."""

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
    """Raises `BadInputError` if the folder holds no complete capture, or a capture without ground truth."""
    fields.must_be_capture(capture)
    if not (capture / "truth" / "truth.json").is_file():
        raise BadInputError(
            f"{capture} has no truth to compare with: film it with Truth switched on"
        )


def review_file(scene: Any, name: str) -> Path:
    """The path of a file of the chosen capture's comparison. Raises `BadInputError` if there is no comparison yet."""
    capture = engine.capture_folder(scene)
    fields.must_be_capture(capture)
    file = capture / "review" / name
    if not file.is_file():
        raise BadInputError(f"{capture} has no comparison yet: press Compare")
    return file


def show(context: Any, layout_file: Path) -> list[Any]:
    """Add the scenes of a comparison to the file, and show the first of them in the Video Editing workspace.

    They replace the scenes of an earlier comparison in the same folder, except those that the user has copied or
    renamed. On an error, the earlier scenes remain. The window's active scene doesn't change, because the workspace has
    its own scene for the sequencer.
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
    """The Video Editing workspace; if the file has none, it is added from Blender's template."""
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
