"""Filming in this process: one Blender, one scene, many rigs, without the workers' start-up."""

from __future__ import annotations

import importlib
import importlib.util
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

ROOT = Path(__file__).resolve().parents[2]
Array = npt.NDArray[np.float64]

spec = importlib.util.spec_from_file_location(
    "stlfr_capture_script", ROOT / "blender" / "capture.py"
)
assert spec is not None and spec.loader is not None
spec.loader.exec_module(importlib.util.module_from_spec(spec))  # loads stlfr_extension

camera, distortion, errors, folder, plan, rig, scenes, sensor = (
    importlib.import_module(f"stlfr_extension.{name}")
    for name in (
        "camera",
        "distortion",
        "errors",
        "folder",
        "plan",
        "rig",
        "scenes",
        "sensor",
    )
)


def options(rig_file: Path, **changes: Any) -> Any:
    """What to film: a few tiny frames, and truth without views."""
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
    """Film a plan into a folder as the workers do; gives the plan."""
    studios = importlib.import_module("stlfr_extension.film")
    whole = plan.make(wanted)
    views = (*whole.rig.cameras, *whole.rig.views)
    studio = studios.Studio(scene, views, 2)
    with tempfile.TemporaryDirectory() as scratch:
        for job in whole.jobs:
            studio.do(job, capture, Path(scratch), whole.rig.reference_camera.rate_hz)
    described = {view.id: studio.describe(view.id) for view in views}
    folder.write_all(whole, described, capture)
    studio.strike()
    return whole


def project(entry: dict[str, Any], points_m: Array) -> Array:
    """World points (N, 3) in the pixels of a camera of capture.json."""
    lens = camera.Pinhole(entry["width"], entry["height"], *entry["params"][:4])
    pose = entry["cam_from_world"]
    cam_from_world = camera.RigidTransform(
        tuple(pose["rotation_wxyz"]), tuple(pose["translation"])
    )
    pixels: Array = camera.project(lens, cam_from_world, points_m)
    if entry["model"] == "OPENCV":
        lens_error = distortion.Distortion(*entry["params"][4:])
        pixels = distortion.pixels_from_ideal(lens, lens_error, pixels)
    return pixels


def read_light(path: Path) -> Array:
    """A PNG's scene-linear light, height x width (the mean of its colours)."""
    import cv2

    picture = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    assert picture is not None, path
    s = picture / (255 if picture.dtype == np.uint8 else 65535)
    light = np.where(s <= 0.04045, s / 12.92, ((s + 0.055) / 1.055) ** 2.4)
    return np.asarray(light.mean(axis=2) if light.ndim == 3 else light)


def black_scene(fps: int = 30) -> Any:
    """An empty, unlit scene whose camera, where the rig stands, looks along the world's -z."""
    import bpy

    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    scene.render.fps, scene.frame_start = fps, 1
    scene.camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
    scene.collection.objects.link(scene.camera)
    return scene


def add_disc(at_m: tuple[float, float, float], radius_m: float, light: float) -> Any:
    """A glowing disc that faces +z."""
    import bpy

    bpy.ops.mesh.primitive_circle_add(
        vertices=64, radius=radius_m, fill_type="NGON", location=at_m
    )
    disc = bpy.context.object
    material = bpy.data.materials.new("glow")
    nodes = material.node_tree.nodes
    nodes.clear()
    emission = nodes.new("ShaderNodeEmission")
    emission.inputs["Strength"].default_value = light
    output = nodes.new("ShaderNodeOutputMaterial")
    material.node_tree.links.new(emission.outputs[0], output.inputs[0])
    disc.data.materials.append(material)
    return disc


def disc_centroid(entry: dict[str, Any], at_m: Array, radius_m: float) -> Array:
    """Where the centroid of the disc's image is in a camera of capture.json: its outline's, which knows lens and perspective."""
    angle = 2 * np.pi * np.arange(64) / 64
    rim = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    here = project(entry, at_m + radius_m * rim)
    next_one = np.roll(here, -1, axis=0)
    twice_areas = here[:, 0] * next_one[:, 1] - here[:, 1] * next_one[:, 0]
    corners = (here + next_one) * twice_areas[:, None]
    return np.asarray(corners.sum(axis=0) / (3 * twice_areas.sum()))


def centroid(light: Array, near: Array, reach_px: float) -> Array:
    """The light's centroid within a square window about a position."""
    y, x = np.mgrid[: light.shape[0], : light.shape[1]] + 0.5
    weight = light * (np.abs(x - near[0]) < reach_px) * (np.abs(y - near[1]) < reach_px)
    return np.array([np.sum(weight * x), np.sum(weight * y)]) / np.sum(weight)
