"""Write a capture's text files: capture.json, truth.json and the COLMAP model. Does not import `bpy`."""

from __future__ import annotations

import json
import os
import re
from typing import TYPE_CHECKING, Any

from . import native, truth, video
from .plan import (
    CAPTURE_FILE,
    HIDDEN_FOLDER,
    TRACKS_FILE,
    Plan,
    frame_file,
    truth_files,
)

if TYPE_CHECKING:
    from pathlib import Path

    from .rig import RigCamera, Shutter

Camera = dict[str, Any]
"""A camera object as in capture.json, with the fields `width`, `height`, `model`, `params` and `cam_from_world`."""


def write_all(plan: Plan, cameras: dict[str, Camera], capture: Path) -> None:
    """Write all files but the images. capture.json is written last, because its existence marks a complete capture.

    `cameras` has the camera object of every view, by its id.
    """
    if plan.options.truth:
        write_json(capture / "truth" / "truth.json", _truth_json(plan, cameras))
    _write_colmap(plan, cameras, capture / "colmap")
    write_json(capture / CAPTURE_FILE, _capture_json(plan, cameras, capture))


def write_json(path: Path, content: dict[str, Any]) -> None:
    """Write a JSON file atomically (temporary file, then rename), with each list of numbers on one line."""
    text = json.dumps(content, indent=1)
    text = re.sub(
        r"\[[^\[\]{}\"]*\]", lambda numbers: " ".join(numbers[0].split()), text
    )
    _write_text(path, text.replace("[ ", "[").replace(" ]", "]") + "\n")


def _write_text(path: Path, text: str) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_name(f".{path.name}.partial")
    with partial.open("w", encoding="utf-8") as stream:
        stream.write(text)
        stream.flush()
        os.fsync(stream.fileno())
    partial.replace(path)


def _capture_json(
    plan: Plan, cameras: dict[str, Camera], capture: Path
) -> dict[str, Any]:
    entries = []
    for camera, shutter in zip(plan.rig.cameras, plan.shutters, strict=True):
        entries.append(
            {
                "id": camera.id,
                "frames": video.frames_of(camera.id, capture),
                **cameras[camera.id],
                "color": camera.color,
                "clock": _clock(camera, shutter),
            }
        )
    return {
        "format": "stlfr-capture",
        "version": 1,
        "name": f"{plan.options.title}-{plan.rig.name}",
        "reference": plan.rig.reference,
        "cameras": entries,
    }


def _clock(camera: RigCamera, shutter: Shutter) -> dict[str, Any]:
    """The field `clock` of a camera in capture.json: its stated frame times or its rate, and its clock's properties."""
    clock: dict[str, Any]
    if shutter.stated_times_s is not None:
        clock = {"times_s": list(shutter.stated_times_s)}
    else:
        first_s = camera.delay_s if camera.clock_shared else 0.0
        clock = {"rate_hz": camera.rate_hz, "first_s": first_s}
    clock["shared"] = camera.clock_shared
    if camera.drift_ppm != 0.0:
        clock["drift"] = True
    if not camera.lost_stamped:
        clock["lost"] = True
    if camera.readout_s > 0.0:
        clock["readout_s"] = camera.readout_s
    return clock


def _truth_json(plan: Plan, cameras: dict[str, Camera]) -> dict[str, Any]:
    rig_camera_ids = {camera.id for camera in plan.rig.cameras}
    views = [
        {
            "id": f"t{k}-{view.id}",
            "time_s": time_s,
            "like": view.id if view.id in rig_camera_ids else None,
            "camera": cameras[view.id],
            **truth_files(k, view.id),
        }
        for k, time_s in enumerate(plan.instants_s)
        for view in (*plan.rig.cameras, *plan.rig.views)
    ]
    content: dict[str, Any] = {
        "format": "stlfr-truth",
        "version": 1,
        "scene": plan.options.title,
        "rig": plan.rig.name,
        **truth.clocks_json(plan.rig, plan.shutters),
        "views": views,
    }
    if plan.video_times_s:
        view_id = plan.rig.views[0].id
        content["video"] = {
            "view": view_id,
            "times_s": plan.video_times_s,
            "camera": cameras[view_id],
            "images": "video/%04d.png",
        }
    if any(job.is_tracks for job in plan.jobs):
        content["tracks"] = TRACKS_FILE.removeprefix("truth/")
    return content


def _write_colmap(plan: Plan, cameras: dict[str, Camera], folder: Path) -> None:
    """Write COLMAP's text model: for every camera of the rig one camera and one image (its first frame); no points."""
    images = [
        (frame_file(camera.id, 0), cameras[camera.id]) for camera in plan.rig.cameras
    ]
    for name, text in native.colmap_text(images).items():
        _write_text(folder / name, text)


def scratch_folder(capture: Path) -> Path:
    """The folder of incomplete images. It is inside the capture, so that they can be renamed to their final paths."""
    return capture / HIDDEN_FOLDER / "partial"
