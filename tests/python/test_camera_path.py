"""The animated scene camera of a .blend file as a camera path, by the script `blender/path.py`."""

from __future__ import annotations

import importlib
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import bpy
import numpy as np
import pytest
from filming import errors

camera_path = importlib.import_module("stlfr_extension.camera_path")

ROOT = Path(__file__).resolve().parents[2]


def camera(name: str, x_m: float) -> Any:
    found = bpy.data.objects.new(name, bpy.data.cameras.new(name))
    bpy.context.scene.collection.objects.link(found)
    found.location = (x_m, 0.0, 1.0)
    return found


@pytest.fixture
def blend(tmp_path: Path) -> Path:
    """A .blend file with five frames at 10 Hz: a moving camera, and from the fourth frame on another camera."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    scene.frame_start, scene.frame_end = 2, 6
    scene.render.fps, scene.render.fps_base = 10, 1.0
    scene.render.resolution_x, scene.render.resolution_y = 64, 48
    scene.render.resolution_percentage = 100
    first, second = camera("first", 0.0), camera("second", 3.0)
    scene.camera = first
    for frame, x_m in ((2, 0.0), (7, 0.5)):
        first.location[0] = x_m
        first.keyframe_insert("location", index=0, frame=frame)
    for layer in first.animation_data.action.layers:
        for curve in layer.strips[0].channelbags[0].fcurves:
            for key in curve.keyframe_points:
                key.interpolation = "LINEAR"
    scene.timeline_markers.new("start", frame=1).camera = first
    scene.timeline_markers.new("cut", frame=5).camera = second
    file = tmp_path / "scene.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(file))
    return file


def written(blend: Path, out: Path) -> subprocess.CompletedProcess[str]:
    command = [
        sys.executable,
        "-I",
        str(ROOT / "blender/path.py"),
        str(blend),
        str(out),
    ]
    return subprocess.run(command, capture_output=True, text=True, check=False)


def test_every_frame_is_a_key_of_the_camera_that_it_is_cut_to(
    blend: Path, tmp_path: Path
) -> None:
    done = written(blend, tmp_path / "path.json")
    assert done.returncode == 0, done.stderr
    path = json.loads((tmp_path / "path.json").read_text())
    assert (path["format"], path["version"], path["rate_hz"]) == ("stlfr-path", 1, 10)
    keys = path["keys"]
    np.testing.assert_allclose([key["at_s"] for key in keys], [0, 0.1, 0.2, 0.3, 0.4])
    # The render tab's settings were never touched: frame 1 shows the capture's time 0.
    np.testing.assert_allclose(
        [key["time_s"] for key in keys], [0.1, 0.2, 0.3, 0.4, 0.5]
    )
    places = [key["camera"]["cam_from_world"]["translation"][0] for key in keys]
    np.testing.assert_allclose(places, [0, -0.1, -0.2, -3, -3], atol=1e-6)
    assert {(key["camera"]["width"], key["camera"]["height"]) for key in keys} == {
        (64, 48)
    }


def test_what_gives_no_path_is_one_sentence(blend: Path, tmp_path: Path) -> None:
    for camera in bpy.data.cameras:
        camera.type = "ORTHO"
    bpy.ops.wm.save_as_mainfile(filepath=str(blend))
    wrong = tmp_path / "wrong.blend"
    wrong.write_text("no blend")
    for file, words in (
        (blend, "isn't a perspective camera"),
        (wrong, "can't open it"),
    ):
        done = written(file, tmp_path / "path.json")
        assert done.returncode == 2, done.stderr
        last = done.stderr.strip().splitlines()[-1]
        assert words in last and file.name in last, done.stderr
    assert not (tmp_path / "path.json").exists()
    bpy.context.scene.camera = None
    bpy.context.scene.timeline_markers.clear()
    with pytest.raises(errors.BadInputError, match="no camera"):
        camera_path.path(bpy.context.scene)
