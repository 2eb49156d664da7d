"""Helpers of tests for rig files and filming, by the script or (faster) in this process."""

from __future__ import annotations

import copy
import importlib
import importlib.util
import json
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

ROOT = Path(__file__).resolve().parents[2]
Array = npt.NDArray[np.float64]

CAPTURE_SCRIPT = ROOT / "blender" / "capture.py"

spec = importlib.util.spec_from_file_location("stlfr_capture_script", CAPTURE_SCRIPT)
assert spec is not None and spec.loader is not None
spec.loader.exec_module(importlib.util.module_from_spec(spec))  # loads stlfr_extension

(
    camera,
    described,
    distortion,
    errors,
    folder,
    native,
    plan,
    rig,
    scenes,
    sensor,
    truth,
) = (
    importlib.import_module(f"stlfr_extension.{name}")
    for name in (
        "camera",
        "described",
        "distortion",
        "errors",
        "folder",
        "native",
        "plan",
        "rig",
        "scenes",
        "sensor",
        "truth",
    )
)

SHIPPED = sorted((ROOT / "rigs").glob("*.json"))

CORPUS = json.loads((ROOT / "tests" / "golden" / "rigs.json").read_text())
"""A valid rig of two cameras, with lists of valid and invalid changes of it; the Rust tests read this file too."""

IDENTITY = {"rotation_wxyz": [1, 0, 0, 0], "translation": [0, 0, 0]}


def rig_camera(camera_id: str, **changes: Any) -> dict[str, Any]:
    """A camera's entry in a rig file: 64x48, at the rig's centre, starts at world time 0; `changes` replaces fields."""
    return {
        "id": camera_id,
        "width": 64,
        "height": 48,
        "lens_mm": 36.0,
        "sensor_width_mm": 36.0,
        "cam_from_rig": IDENTITY,
        "rate_hz": 30.0,
        "delay_s": 0.0,
        "jitter_s": 0.0,
        **changes,
    }


def rig_content(*cameras: dict[str, Any], **changes: Any) -> dict[str, Any]:
    """The content of a rig file with these cameras; `changes` replaces further fields."""
    content = {
        "format": "stlfr-rig",
        "version": 1,
        "name": "small",
        "seed": 3,
        "cameras": list(cameras),
    }
    return {**content, "reference": cameras[0]["id"], **changes}


def write_rig(path: Path, *cameras: dict[str, Any], **changes: Any) -> Path:
    """Write a rig file with these cameras; returns its path."""
    path.write_text(json.dumps(rig_content(*cameras, **changes)), encoding="utf-8")
    return path


def changed(changes: dict[str, Any]) -> dict[str, Any]:
    """The rig of `CORPUS` with fields changed; a key of `changes` is a field's path, with dots."""
    content: dict[str, Any] = copy.deepcopy(CORPUS["rig"])
    for path, value in changes.items():
        *parents, field = path.split(".")
        at: Any = content
        for step in parents:
            at = at[int(step) if step.isdecimal() else step]
        at[field] = value
    return content


def loaded(tmp_path: Path, changes: dict[str, Any]) -> Any:
    """The rig of `CORPUS` with fields changed, written to a file and loaded from it."""
    path = tmp_path / "rig.json"
    path.write_text(json.dumps(changed(changes)), encoding="utf-8")
    return rig.load(path)


def right_of_centre(x_m: float) -> dict[str, Any]:
    """The field `cam_from_rig` of a camera `x_m` metres to the right of the rig's centre, oriented as the rig."""
    return {**IDENTITY, "translation": [-x_m, 0, 0]}


def by_script(*arguments: object) -> subprocess.CompletedProcess[str]:
    """Film by the headless script, whether it succeeds or fails."""
    return run_script(CAPTURE_SCRIPT, *arguments)


def filmed_by_script(*arguments: object) -> list[dict[str, Any]]:
    """Film by the headless script, which must succeed; returns its progress reports."""
    ended = by_script(*arguments)
    assert ended.returncode == 0, ended.stderr
    return [json.loads(line) for line in ended.stdout.splitlines()]


def run_script(script: Path, *arguments: object) -> subprocess.CompletedProcess[str]:
    """Run a script of the folder `blender`, whether it succeeds or fails."""
    return run([sys.executable, "-I", str(script), *map(str, arguments)])


def run(command: list[str]) -> subprocess.CompletedProcess[str]:
    """Run a command to its end, whatever its exit code."""
    return subprocess.run(
        command, check=False, capture_output=True, text=True, timeout=240
    )


def options(rig_file: Path, **changes: Any) -> Any:
    """Options of filming for tests: a few tiny frames, and ground truth at no instant; `changes` replaces options."""
    wanted = {
        "rig_file": rig_file,
        "scene_name": "magazine",
        "blend_file": None,
        "size_px": (80, 60),
        "frames": 3,
        "samples": 4,
        "instants": 0,
        "truth_video": 0,
        "truth": True,
    }
    return plan.Options(**{**wanted, **changes})


def film(scene: Any, wanted: Any, capture: Path) -> Any:
    """Film with these options into a folder, in this process, as worker processes do; returns the plan."""
    studios = importlib.import_module("stlfr_extension.film")
    whole = plan.make(wanted)
    views = (*whole.rig.cameras, *whole.rig.views)
    studio = studios.Studio(scene, views, 2, wanted.engine)
    with tempfile.TemporaryDirectory() as scratch:
        for job in whole.jobs:
            studio.do(job, capture, Path(scratch), whole.rig.reference_camera.rate_hz)
    described = {view.id: studio.describe(view.id) for view in views}
    folder.write_all(whole, described, capture)
    studio.strike()
    return whole


def linear(encoded: Array) -> Array:
    """Linear light from display-encoded (sRGB) values from 0 to 1."""
    return np.where(
        encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4
    )


def read_light(path: Path) -> Array:
    """The linear light of a PNG, (H, W): the mean of its colour channels."""
    import cv2

    picture = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    assert picture is not None, path
    light = linear(picture / (255 if picture.dtype == np.uint8 else 65535))
    return np.asarray(light.mean(axis=2) if light.ndim == 3 else light)


def pixels(file: str | Path) -> npt.NDArray[np.int32]:
    """The samples of a PNG as RGBA (H, W, 4), also if the file is grey or has no alpha."""
    import cv2

    image = cv2.imread(str(file), cv2.IMREAD_UNCHANGED)
    assert image is not None and image.dtype == np.uint8, file
    if image.ndim == 2:
        image = np.repeat(image[:, :, None], 3, axis=2)
    if image.shape[2] == 3:
        image = np.concatenate([image, np.full_like(image[:, :, :1], 255)], axis=2)
    return np.asarray(image[:, :, [2, 1, 0, 3]], dtype=np.int32)


def black_scene(fps: int = 30) -> Any:
    """An empty scene without light; its camera, which is also the rig's pose, looks along the world's -z."""
    import bpy

    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    scene.render.fps, scene.frame_start = fps, 1
    scene.camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
    scene.collection.objects.link(scene.camera)
    return scene


def add_disc(
    at_m: tuple[float, float, float], radius_m: float, light: float, vertices: int = 64
) -> Any:
    """Add a disc that emits light and faces +z."""
    import bpy

    bpy.ops.mesh.primitive_circle_add(
        vertices=vertices, radius=radius_m, fill_type="NGON", location=at_m
    )
    disc = bpy.context.object
    material = bpy.data.materials.new("glow")
    material.diffuse_color = (light, light, light, 1.0)  # Workbench's
    nodes = material.node_tree.nodes
    nodes.clear()
    emission = nodes.new("ShaderNodeEmission")
    emission.inputs["Strength"].default_value = light
    output = nodes.new("ShaderNodeOutputMaterial")
    material.node_tree.links.new(emission.outputs[0], output.inputs[0])
    disc.data.materials.append(material)
    return disc


def disc_centroid(entry: dict[str, Any], at_m: Array, radius_m: float) -> Array:
    """The centroid of a disc's image in a camera of capture.json, from the projection of the disc's outline."""
    angle = 2 * np.pi * np.arange(64) / 64
    rim = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    here = described.project(entry, at_m + radius_m * rim)
    next_one = np.roll(here, -1, axis=0)
    twice_areas = here[:, 0] * next_one[:, 1] - here[:, 1] * next_one[:, 0]
    corners = (here + next_one) * twice_areas[:, None]
    return np.asarray(corners.sum(axis=0) / (3 * twice_areas.sum()))


def centroid(light: Array, near: Array, reach_px: float) -> Array:
    """The centroid of the light in a square window around the pixel position `near`."""
    y, x = np.mgrid[: light.shape[0], : light.shape[1]] + 0.5
    weight = light * (np.abs(x - near[0]) < reach_px) * (np.abs(y - near[1]) < reach_px)
    return np.array([np.sum(weight * x), np.sum(weight * y)]) / np.sum(weight)
