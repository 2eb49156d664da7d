"""Steps of the extension's tests that run inside Blender: `python extension_steps.py STEP ARGUMENTS`.

Each step runs in a separate process with its own user configuration. Its last line on stdout is its result as JSON.
"""

from __future__ import annotations

import importlib
import json
import sys
import tempfile
import time
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import bpy
import numpy as np
from extension_tools import (
    MODULE,
    create_rig,
    described,
    drawn,
    enable,
    middle_s,
    moving_scene,
    part,
    picture,
    place,
    plain,
    refused,
)


def install(zip_file: str) -> dict[str, Any]:
    """Install the extension from its zip file by Blender's own operator."""
    bpy.ops.extensions.package_install_files(
        filepath=zip_file, repo="user_default", enable_on_install=True
    )
    return {
        "enabled": MODULE in bpy.context.preferences.addons.keys(),  # noqa: SIM118 - a collection of Blender's
        "engines": engine_items(),
    }


def traces() -> dict[str, Any]:
    """Everything in Blender that the extension may have registered."""
    names = {name for name in dir(bpy.types) if "stlfr" in name.lower()}
    return {
        "types": sorted(names),
        "operators": dir(bpy.ops.stlfr),
        "scene": hasattr(bpy.types.Scene, "stlfr"),
        "object": hasattr(bpy.types.Object, "stlfr"),
        "engine": "STLFR" in engine_items(),
        "panels": sum(
            panel.is_registered and "STLFR" in getattr(panel, "COMPAT_ENGINES", ())
            for panel in bpy.types.Panel.__subclasses__()
        ),
    }


def engine_items() -> list[str]:
    """The names of all render engines that can be chosen for a scene."""
    try:
        bpy.context.scene.render.engine = "NO SUCH ENGINE"
    except TypeError as error:
        return [word.strip("'(), ") for word in str(error).split("'")[1::2]]
    raise AssertionError("any engine is taken")


def come_and_go() -> dict[str, Any]:
    """Enable and disable the extension twice; returns what is registered at each stage."""
    addon_utils = importlib.import_module("addon_utils")
    found = {"before": traces()}
    for _ in range(2):
        assert enable()
        found["enabled"] = traces()
        addon_utils.disable(MODULE, default_set=True)
        found["after"] = traces()
    return found


def enable_only() -> dict[str, Any]:
    """Enable the extension; returns whether this succeeded, and what is registered then."""
    enabled = enable()
    stlfr = importlib.import_module("stlfr")
    return {
        "enabled": enabled,
        "module": stlfr.__file__,
        "version": stlfr.__version__,
        **traces(),
    }


def film(folder: str) -> dict[str, Any]:
    """Create a rig by operators, cancel and resume filming, estimate offsets, and render a picture."""
    assert enable()
    work = Path(folder)
    scene = moving_scene()
    sentences = {"unsaved": refused(bpy.ops.stlfr.film)}
    bpy.ops.wm.save_as_mainfile(filepath=str(work / "mine.blend"))
    sentences["no rig"] = refused(bpy.ops.stlfr.film)
    create_rig()
    settings = scene.stlfr
    settings.film_frames, settings.film_samples, settings.film_truth = 2, 1, False
    settings.film_folder = "//capture"
    settings.film_all_cores, settings.film_workers = False, 1
    before = described(scene)
    settings.film_folder, settings.film_truth = "//refused", True
    sentences["too few frames"] = refused(bpy.ops.stlfr.film)
    settings.film_folder, settings.film_truth = "//capture", False

    capture = work / "capture"
    operators, filming, jobs = part("operators"), part("filming"), part("jobs")
    operators.prepare_film(scene, capture)
    command = filming.command(
        capture, operators.python(), operators.module_folder(), ""
    )
    job = jobs.Job("Filming", command)
    while job.is_running and job.progress.done < 1:
        time.sleep(0.02)
    sentences["busy"] = refused(bpy.ops.stlfr.offsets)
    faked = drawn()  # with work under way
    bpy.ops.stlfr.cancel()
    stopped = sorted(capture.glob("cam*/*.png"))
    times = [file.stat().st_mtime_ns for file in stopped]
    sentences["stopped"] = refused(bpy.ops.stlfr.film)
    faked += drawn()  # with a film to resume
    bpy.ops.stlfr.film(resume=True)
    kept = times == [file.stat().st_mtime_ns for file in stopped]
    sentences["there"] = refused(bpy.ops.stlfr.film)
    sentences["nothing to resume"] = refused(bpy.ops.stlfr.film, resume=True)

    bpy.ops.stlfr.offsets()
    faked += drawn()
    return {
        "sentences": sentences,
        "cancelled": job.cancelled,
        "frames when stopped": len(stopped),
        "kept": kept,
        "capture": settings.capture,
        "start": [settings.start_frame, part("timing").sentence(scene, capture)],
        "time_offset_s": settings.time_offset_s,
        "offsets": [shown_offset(o) for o in settings.offsets],
        "report": operators.show_offsets(settings.offsets, job_result(capture)),
        "drawn": faked,
        "untouched": before == described(scene),
        "picture": picture(scene, work, 0.5 / 30.0),
        "rig": part("rig_objects").describe(scene),
    }


def shown_offset(offset: Any) -> dict[str, Any]:
    """The values of one entry in the panel's list of offsets."""
    return {
        "id": offset.camera_id,
        "known": offset.is_known,
        "offset_s": offset.offset_s,
        "reason": offset.reason,
    }


def job_result(capture: Path) -> Any:
    """Estimate the capture's offsets in this process, for comparison with the operator's result."""
    return importlib.import_module("stlfr").open(capture).offsets()["cameras"]


def film_again(folder: str) -> dict[str, Any]:
    """Film without interruption, with a rig that is loaded from a file."""
    assert enable()
    work = Path(folder)
    scene = moving_scene()
    bpy.ops.wm.save_as_mainfile(filepath=str(work / "again.blend"))
    create_rig()
    bpy.ops.stlfr.rig_save(filepath=str(work / "rig.json"))
    bpy.ops.stlfr.rig_load(filepath=str(work / "rig.json"))
    settings = scene.stlfr
    settings.film_frames, settings.film_samples, settings.film_truth = 1, 1, False
    settings.film_folder = str(work / "again")
    result = bpy.ops.stlfr.film()
    return {
        "result": sorted(result),
        "frames": len(list((work / "again").glob("cam*/*.png"))),
    }


def pictures(capture: str, folder: str) -> dict[str, Any]:
    """Render pictures from a filming camera's pose, and from a viewpoint where no camera sees some pixels."""
    assert enable()
    work, scene = Path(folder), bpy.context.scene
    scene.render.engine = "STLFR"
    plain(scene)
    scene.stlfr.capture = capture
    filmed = json.loads((Path(capture) / "capture.json").read_text())["cameras"]
    place(scene, filmed[3])
    time_s = middle_s(capture)
    found = {"like": picture(scene, work, time_s, "like")}
    scene.stlfr.preset = "none"
    scene.stlfr.sync = scene.stlfr.proxy = "auto"
    found["auto"] = picture(scene, work, time_s, "auto")
    scene.stlfr.preset = "draft"
    found["draft"] = picture(scene, work, time_s, "draft")
    scene.stlfr.preset = "none"
    scene.stlfr.sync, scene.stlfr.proxy = "refined", "plane"
    scene.stlfr.use_plane_depth, scene.stlfr.plane_depth_m = True, 1.8
    scene.camera.location.x += 0.5
    found["aside"] = picture(scene, work, time_s, "aside")
    scene.camera.location.x -= 0.5
    scene.stlfr.use_trail, scene.stlfr.trail_duration_s = True, 0.05
    scene.stlfr.trail_instants, scene.stlfr.trail_mode = 4, "lighten"
    found["trail"] = picture(scene, work, time_s, "trail")
    scene.stlfr.use_trail = False
    scene.render.use_border = scene.render.use_crop_to_border = True
    scene.render.border_min_x, scene.render.border_max_x = 0.25, 0.75
    scene.render.border_min_y, scene.render.border_max_y = 0.5, 1.0
    found["border"] = picture(scene, work, time_s, "border")
    scene.render.use_crop_to_border = False
    found["uncropped"] = picture(scene, work, time_s, "uncropped")
    return found


def displays(capture: str, folder: str) -> dict[str, Any]:
    """Render a quilt, a stereo pair and an animation of quilts by the render tab's operator.

    Returns the files, and the input with which `stlfr render` must give the same files.
    """
    assert enable()
    work, scene, settings = Path(folder), bpy.context.scene, bpy.context.scene.stlfr
    scene.render.engine = "STLFR"
    plain(scene)
    sentences = {"no capture": refused(bpy.ops.stlfr.picture)}
    settings.capture = capture
    filmed = json.loads((Path(capture) / "capture.json").read_text())["cameras"]
    place(scene, filmed[3])
    scene.frame_start, scene.frame_end = 1, 2
    settings.preset, settings.speed = "draft", 0.0
    settings.time_offset_s = middle_s(capture)
    sentences["a view"] = refused(bpy.ops.stlfr.picture)
    shown = drawn()
    settings.layout = "QUILT"
    shown += drawn()
    settings.quilt_display, settings.picture_file = "portrait", str(work / "a.png")
    settings.use_convergence, settings.convergence_m = True, 1.6
    bpy.ops.stlfr.picture()
    image = bpy.data.images["a_qs8x6a0.75.png"]
    bpy.ops.stlfr.picture(animation=True)
    settings.use_cone, settings.cone_deg = True, 90.0
    sentences["cone"] = refused(bpy.ops.stlfr.picture)
    settings.picture_file = str(work / "a.bmp")
    sentences["suffix"] = refused(bpy.ops.stlfr.picture)
    settings.picture_file = str(work / "a.mp4")
    sentences["video"] = refused(bpy.ops.stlfr.picture)
    settings.layout, settings.picture_file = "STEREO", str(work / "eyes.png")
    settings.eye_distance_m = 0.05
    shown += drawn()
    bpy.ops.stlfr.picture()
    view = part("view")
    request = view.request(scene, scene.camera, Path(capture))
    left = list(Path(tempfile.gettempdir()).glob("stlfr-picture-*"))
    return {
        "sentences": sentences,
        "drawn": shown,
        "quilt": list(image.size),
        "left": [str(path) for path in left],
        "time_s": request.time_s,
        "camera": request.camera,
        "options": request.options,
    }


def animation(capture: str, folder: str) -> dict[str, Any]:
    """Render an animation in slow motion, and one in which the camera moves while time stands still."""
    assert enable()
    scene = bpy.context.scene
    scene.render.engine = "STLFR"
    plain(scene)
    settings = scene.stlfr
    settings.capture = capture
    filmed = json.loads((Path(capture) / "capture.json").read_text())["cameras"]
    place(scene, filmed[3])
    scene.frame_start, scene.frame_end = 1, 3
    settings.preset = "none"
    settings.proxy, settings.use_plane_depth = "plane", True
    settings.time_offset_s = middle_s(capture) - 0.02
    settings.speed = 0.25
    scene.render.filepath = f"{folder}/slow-"
    bpy.ops.render.render(animation=True)
    times_s = []
    for frame in (1, 2, 3):
        scene.frame_set(frame)
        times_s.append(part("view").capture_time_s(scene))
    settings.speed = 0.0
    for frame, x in ((1, 0.0), (3, 0.08)):
        scene.camera.delta_location.x = x
        scene.camera.keyframe_insert("delta_location", index=0, frame=frame)
    scene.render.filepath = f"{folder}/bullet-"
    bpy.ops.render.render(animation=True)
    scene.frame_set(3)
    return {
        "times_s": times_s,
        "offset_s": settings.time_offset_s,
        "bullet_s": part("view").capture_time_s(scene),
    }


def errors(capture: str, folder: str) -> dict[str, Any]:
    """Make the engine and the operators fail with wrong input; returns their error messages."""
    assert enable()
    scene, settings = bpy.context.scene, bpy.context.scene.stlfr
    scene.render.engine = "STLFR"
    plain(scene)
    scene.render.resolution_x, scene.render.resolution_y = 32, 24
    found = {"no capture": refused(bpy.ops.render.render)}
    found["offsets without"] = refused(bpy.ops.stlfr.offsets)
    settings.capture = "//beside"
    found["beside nothing"] = refused(bpy.ops.render.render)
    settings.capture = folder
    found["no such"] = refused(bpy.ops.render.render)
    found["offsets of none"] = refused(bpy.ops.stlfr.offsets)
    found["no review"] = refused(bpy.ops.stlfr.open_review)
    found["no report"] = refused(bpy.ops.stlfr.open_report)
    settings.capture = capture
    settings.time_offset_s = 500.0
    found["outside"] = refused(bpy.ops.render.render)
    settings.time_offset_s = 0.0
    scene.camera.data.type = "ORTHO"
    found["orthographic"] = refused(bpy.ops.render.render)
    mine = bpy.data.objects.new("rig", None)
    scene.collection.objects.link(mine)
    found["my rig"] = refused(bpy.ops.stlfr.rig_create)
    bpy.data.objects.remove(mine)
    wrong = Path(folder) / "wrong.json"
    wrong.write_text("{}")
    found["wrong rig"] = refused(bpy.ops.stlfr.rig_load, filepath=str(wrong))
    create_rig()
    scene.objects["cam0"].stlfr.more = '{"noise": '
    found["more"] = refused(bpy.ops.stlfr.rig_save, filepath=str(wrong))
    scene.objects["cam0"].stlfr.more = ""
    scene.objects["cam0"].stlfr.jitter_s = 1.0
    found["jitter"] = refused(bpy.ops.stlfr.rig_save, filepath=str(wrong))
    return {"sentences": found, "written": wrong.read_text()}


def stop_rendering(capture: str) -> dict[str, Any]:
    """Press Escape while the engine renders a long trail."""
    assert enable()
    scene, settings = bpy.context.scene, bpy.context.scene.stlfr
    plain(scene)
    filmed = json.loads((Path(capture) / "capture.json").read_text())["cameras"]
    place(scene, filmed[3])
    settings.capture = capture
    settings.use_trail, settings.trail_instants = True, 10_000
    settings.preset = "balanced"
    settings.time_offset_s = middle_s(capture)
    engine = part("engine")
    seen: dict[str, Any] = {"progress": [], "results": 0, "errors": []}
    pressed = iter([False, False, True])
    fake = SimpleNamespace(
        camera_override=None,
        test_break=lambda: next(pressed),
        update_stats=lambda _, text: seen.update(text=text),
        update_progress=seen["progress"].append,
        report=lambda _, text: seen["errors"].append(text),
        begin_result=lambda *_, **__: seen.update(results=1),
    )
    fake._wait = lambda work: engine.StlfrEngine._wait(fake, work)
    start_s = time.monotonic()
    engine.StlfrEngine.render(fake, bpy.context.evaluated_depsgraph_get())
    return {**seen, "seconds": time.monotonic() - start_s}


def review(capture: str) -> dict[str, Any]:
    """Run the comparison twice, which adds its scenes to the file and must not change anything else in it."""
    assert enable()
    before = sorted(scene.name for scene in bpy.data.scenes)
    scene = bpy.context.scene
    scene.stlfr.capture = capture
    scene.stlfr.preset = "draft"
    bpy.ops.stlfr.compare()
    bpy.ops.stlfr.open_review()
    added = [s for s in bpy.data.scenes if s.name not in before]
    return {
        "added": [s.name for s in added],
        "strips": sorted(s.name for one in added for s in one.sequence_editor.strips),
        "selected": sum(s.select for a in added for s in a.sequence_editor.strips_all),
        "prefetch": [s.sequence_editor.use_prefetch for s in added],
        "there": all(name in bpy.data.scenes for name in before),
        "shown": bpy.context.scene.name == scene.name,
    }


def rigs(rig_file: str, folder: str) -> dict[str, Any]:
    """Load a rig file and save it: unchanged, after the rig was moved, and after a camera was edited."""
    assert enable()
    scene, out = bpy.context.scene, Path(folder)
    bpy.ops.stlfr.rig_load(filepath=rig_file)
    bpy.ops.stlfr.rig_save(filepath=str(out / "same.json"))
    scene.objects["rig"].location = (3.0, -2.0, 1.5)
    scene.objects["rig"].rotation_euler = (1.2, 0.3, -0.7)
    bpy.ops.stlfr.rig_save(filepath=str(out / "moved.json"))
    camera = scene.objects["cam1"]
    camera.stlfr.delay_s, camera.data.lens = 0.0125, 50.0
    camera.location.x += 0.01
    camera.stlfr.color, camera.stlfr.jitter_stamped = "gray", False
    bpy.ops.stlfr.rig_save(filepath=str(out / "edited.json"))
    moved = [list(row) for row in scene.objects["cam0"].matrix_world]
    bpy.ops.stlfr.rig_load(filepath=rig_file)
    back = [list(row) for row in scene.objects["cam0"].matrix_world]
    return {
        "stays": bool(np.allclose(moved, back, atol=1e-5)),
        "cameras": [o.name for o in part("rig_objects").members(scene, "CAMERA")],
        "data": len([c for c in bpy.data.cameras if c.name.startswith("cam")]),
    }


def new_rigs(folder: str, wanted: str) -> dict[str, Any]:
    """Create rigs with different properties by the operator *Create Rig*, and save each under its name."""
    assert enable()
    for name, properties in json.loads(wanted).items():
        bpy.ops.stlfr.rig_create(rig_name=name, **properties)
        bpy.ops.stlfr.rig_save(filepath=str(Path(folder) / f"{name}.json"))
    return {"objects": len(part("rig_objects").members(bpy.context.scene))}


def saved_again(folder: str, *rig_files: str) -> dict[str, Any]:
    """Load each of these rig files, and save it under the same name into `folder`."""
    assert enable()
    for file in rig_files:
        bpy.ops.stlfr.rig_load(filepath=file)
        bpy.ops.stlfr.rig_save(filepath=str(Path(folder) / Path(file).name))
    return {"saved": len(rig_files)}


def modal(capture: str) -> dict[str, Any]:
    """Run an operator's job with simulated window events, from its start to the take-over of its result."""
    assert enable()
    operators, jobs = part("operators"), part("jobs")
    scene, seen = bpy.context.scene, []
    scene.stlfr.capture = capture
    area = SimpleNamespace(type="VIEW_3D", tag_redraw=lambda: seen.append("redrawn"))
    window = SimpleNamespace(
        workspace=SimpleNamespace(status_text_set=lambda draw: seen.append("status")),
        screen=SimpleNamespace(areas=[area]),
    )
    windows = SimpleNamespace(
        event_timer_remove=lambda timer: seen.append(timer), windows=[window]
    )
    context = SimpleNamespace(scene=scene, window_manager=windows)
    operator = SimpleNamespace(
        job=operators.STLFR_OT_offsets.start(None, context),
        timer="timer",
        scene_name=scene.name,
        report=lambda kind, text: seen.append(f"{kind}: {text}"),
        take=lambda *arguments: operators.STLFR_OT_offsets.take(None, *arguments),
    )
    step = part("long_work").LongWork.modal
    first = step(operator, context, SimpleNamespace(type="MOUSEMOVE"))
    results: list[set[str]] = []
    while results[-1:] != [{"FINISHED"}]:
        results.append(step(operator, context, SimpleNamespace(type="TIMER")))
        time.sleep(0.05)
    return {
        "first": sorted(first),
        "passed": all(r == {"PASS_THROUGH"} for r in results[:-1]),
        "seen": seen,
        "offsets": len(scene.stlfr.offsets),
        "running": jobs.running() is not None,
    }


if __name__ == "__main__":
    step = globals()[sys.argv[1]]
    answer = json.dumps(step(*sys.argv[2:]))
    print(f"\n{answer}", flush=True)
