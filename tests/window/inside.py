"""Inside the Blender that walk.py drives: answers questions, so that it knows when a step is done.

`blender --python inside.py -- FOLDER`: an expression in FOLDER/ask is evaluated, and its value, as JSON, is
FOLDER/answer. It only reads, but for `prepare`: what is done, is done by clicks and keys.
"""

from __future__ import annotations

import importlib
import json
import sys
from pathlib import Path
from typing import Any

import bpy
import mathutils
import numpy as np

FOLDER = Path(sys.argv[sys.argv.index("--") + 1])
POLL_S = 0.05
SCREEN_PX = 1000
"""The screen's height."""


def part(name: str) -> Any:
    """A module of the installed extension."""
    return importlib.import_module(f"bl_ext.user_default.stlfr.{name}")


def regions(area_type: str) -> dict[str, list[int]]:
    """The regions of the newest window's area of a type, in pixels of the screen: left, top, width, height."""
    for window in reversed(bpy.context.window_manager.windows[:]):
        top = SCREEN_PX - window.y - window.height
        for area in window.screen.areas:
            if area.type == area_type:
                return {
                    region.type: [
                        window.x + region.x,
                        top + window.height - region.y - region.height,
                        region.width,
                        region.height,
                    ]
                    for region in area.regions
                }
    raise ValueError(f"no area is a {area_type}")


def all_areas() -> list[str]:
    """The types of all areas."""
    windows = bpy.context.window_manager.windows
    return [area.type for window in windows for area in window.screen.areas]


def counts() -> dict[str, float]:
    """What the viewports have shown, all together."""
    all_counts = [one.counts for one in part("viewport")._all]
    return {
        "fast": sum(c.fast_drawn for c in all_counts),
        "final": sum(c.final for c in all_counts),
        "rendered": sum(c.fast for c in all_counts),
        "took_s": sum(c.fast_took_s for c in all_counts),
        "asked_s": max((c.asked_s for c in all_counts), default=0.0),
        "final_drawn_s": max((c.final_drawn_s for c in all_counts), default=0.0),
        "busy": any(one.is_busy for one in part("viewport")._all),
    }


def job() -> str:
    """The work under way; empty where there is none."""
    running = part("jobs").running()
    return running.title if running else ""


def prepare(capture: str) -> str:
    """A light field's view from its reference camera's place, slowed down, as the files hold it: what is measured."""
    scene, camera = bpy.context.scene, part("camera")
    content = json.loads((Path(capture) / "capture.json").read_text())
    name = content.get("reference")
    filmed = next(c for c in content["cameras"] if c["id"] == name)
    lens = camera.lens_from_pinhole(
        camera.Pinhole(filmed["width"], filmed["height"], *filmed["params"])
    )
    pose = filmed["cam_from_world"]
    rigid = camera.RigidTransform(
        tuple(pose["rotation_wxyz"]), tuple(pose["translation"])
    )
    data = scene.camera.data
    data.sensor_fit, data.lens, data.sensor_width = "HORIZONTAL", lens.lens_mm, 36.0
    data.shift_x, data.shift_y = lens.shift_x, lens.shift_y
    scene.camera.matrix_world = mathutils.Matrix(camera.blender_matrix(rigid).tolist())
    scene.render.resolution_x, scene.render.resolution_y = lens.width_px, lens.height_px
    scene.render.resolution_percentage = 100
    scene.render.engine = "STLFR"
    scene.stlfr.capture, scene.stlfr.speed = capture, 0.1
    scene.stlfr.time_offset_s += 0.04
    bpy.ops.stlfr.set_range()
    scene.frame_set(scene.stlfr.start_frame)
    scene.view_settings.view_transform = "Standard"
    scene.render.dither_intensity = 0.0
    return filmed["id"]


def frame() -> list[int]:
    """The camera's frame in the 3D view, pixels of the screen: left, top, width, height."""
    scene, viewpoint = bpy.context.scene, part("viewpoint")
    left, top, width, height = regions("VIEW_3D")["WINDOW"]
    corners = np.array(scene.camera.data.view_frame(scene=scene))
    matrix = np.array(scene.camera.matrix_world.normalized())
    corners = corners @ matrix[:3, :3].T + matrix[:3, 3]
    shown, _ = view()
    place = viewpoint.frame_rect(
        np.array(shown.perspective_matrix), corners, (width, height)
    )
    render = scene.render
    snapped = place.snapped(render.resolution_x, render.resolution_y)
    below = top + height - snapped.y - snapped.height
    return [
        round(value)
        for value in (left + snapped.x, below, snapped.width, snapped.height)
    ]


def file_name() -> str:
    """What the file view's field holds; empty where there is no file view."""
    for window in bpy.context.window_manager.windows:
        for area in window.screen.areas:
            if area.type == "FILE_BROWSER":
                return area.spaces.active.params.filename or "nothing"
    return ""


def last_operator() -> str:
    """What was pressed last."""
    operators = bpy.context.window_manager.operators
    return operators[-1].bl_idname if operators else ""


def lose_a_clock() -> bool:
    """Show the first camera's clock as one that can't be known."""
    settings = bpy.context.scene.stlfr
    settings.offsets[0].is_known = False
    settings.offsets[
        0
    ].reason = "nothing that moves in its frames is seen by another camera whose clock is known"
    settings.offset_index = 0
    return True


def has_render() -> bool:
    """Whether F12 has made a picture."""
    image = bpy.data.images.get("Render Result")
    return image is not None and image.has_data


def one_to_one() -> bool:
    """A pixel of the camera's picture is a pixel of the 3D view, which shows nothing else."""
    for window in bpy.context.window_manager.windows:
        for area in window.screen.areas:
            if area.type == "VIEW_3D":
                region = next(r for r in area.regions if r.type == "WINDOW")
                with bpy.context.temp_override(window=window, area=area, region=region):
                    bpy.ops.view3d.zoom_camera_1_to_1()
                area.spaces.active.overlay.show_overlays = False
                return True
    return False


def view() -> Any:
    """The first 3D view's region data, and its space."""
    for window in bpy.context.window_manager.windows:
        for area in window.screen.areas:
            if area.type == "VIEW_3D":
                return area.spaces.active.region_3d, area.spaces.active
    return None, None


def answer() -> float:
    """Look whether something is asked."""
    ask = FOLDER / "ask"
    if ask.exists():
        question = ask.read_text()
        ask.unlink()
        try:
            reply = {"value": eval(question)}  # the tester's own
        except Exception as error:  # noqa: BLE001 - it is the answer
            reply = {"error": f"{type(error).__name__}: {error}"}
        partial = FOLDER / "answer.partial"
        partial.write_text(json.dumps(reply, default=str))
        partial.replace(FOLDER / "answer")
    return POLL_S


bpy.app.timers.register(answer, first_interval=POLL_S, persistent=True)
