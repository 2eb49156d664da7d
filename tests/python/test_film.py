"""Filming: pictures, depth and motion agree with the known positions of objects."""

from __future__ import annotations

import dataclasses
import importlib
import itertools
import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from filming import (
    IDENTITY,
    ROOT,
    add_disc,
    black_scene,
    camera,
    distortion,
    filmed_by_script,
    linear,
    rig,
    rig_camera,
    scenes,
    write_rig,
)

DISC_RADIUS_M = 0.12
DISC_SPEED_M_S = (0.9, 0.5)  # right and up, at 2 m: 0.96 and 0.53 pixels a frame


@pytest.fixture(scope="module")
def moving_disc(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A .blend file with a white disc on black, 2 m from the camera, in uniform motion, at the centre at 0.1 s."""
    bpy = pytest.importorskip("bpy")
    black_scene().frame_start = 5
    disc = add_disc((0.0, 0.0, -2.0), DISC_RADIUS_M, 1.0, vertices=96)
    for axis, speed in enumerate(DISC_SPEED_M_S):
        driver = disc.driver_add("location", axis).driver
        driver.expression = f"{speed} * ((frame - 5) / 30 - 0.1)"
    path = tmp_path_factory.mktemp("disc") / "disc.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(path))
    return path


def read_picture(path: Path) -> np.ndarray[Any, Any]:
    """The grey values of a PNG (H, W), from 0 to 1."""
    cv2 = pytest.importorskip("cv2")
    picture = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    return np.asarray(picture, dtype=np.float64) / 255


def test_truth_by_workbench_is_antialiased_like_the_frames(tmp_path: Path) -> None:
    rig_file = write_rig(tmp_path / "rig.json", rig_camera("ref"), rig_camera("other"))
    capture = tmp_path / "capture"
    film = ("--scene", "still", "--engine", "workbench", "--frames", 4)
    filmed_by_script(rig_file, *film, "--instants", 1, "-o", capture)
    for camera_id in ("ref", "other"):
        frame = read_picture(capture / camera_id / "0000.png")
        true = read_picture(capture / "truth" / "views" / f"t0-{camera_id}.png")
        assert true.std() > 0.05 and np.mean(frame == true) > 0.9


def test_a_moving_disc_is_where_the_shutter_times_say(
    moving_disc: Path, tmp_path: Path
) -> None:
    shifted = {**IDENTITY, "translation": [-0.05, 0.02, 0.0]}
    rig_file = write_rig(
        tmp_path / "rig.json",
        rig_camera("ref", delay_s=0.004, jitter_s=0.002),
        rig_camera(
            "late",
            delay_s=0.004 + 0.4 / 30,
            cam_from_rig=shifted,
            jitter_s=0.002,
            jitter_stamped=False,
            color="gray",
        ),
    )
    capture = tmp_path / "capture"
    film = ("--blend", moving_disc, "-o", capture, "--frames", 6)
    filmed_by_script(rig_file, *film, "--samples", 64, "--instants", 1)
    content = json.loads((capture / "capture.json").read_text())
    truth_content = json.loads((capture / "truth" / "truth.json").read_text())
    offsets = {entry["id"]: entry["offset_s"] for entry in truth_content["offsets"]}
    shutters = rig.shutters(rig.load(rig_file), 6)
    assert content["cameras"][0]["clock"] == {
        "times_s": list(shutters[0].clock_times_s),
        "shared": False,
    }
    assert content["cameras"][1]["clock"] == {
        "rate_hz": 30.0,
        "first_s": 0.0,
        "shared": False,
    }
    hidden_s = np.array(shutters[1].clock_times_s) - np.arange(6) / 30
    assert offsets["late"] == pytest.approx(0.4 / 30 + hidden_s.mean())

    grid_x, grid_y = np.meshgrid(np.arange(64) + 0.5, np.arange(48) + 0.5)
    for index, entry in enumerate(content["cameras"]):
        true_s = truth_content["shutter"][index]["times_s"]
        for k in range(6):
            world_s = true_s[k] + 0.004  # the reference's clock shows 0 at its delay
            assert world_s == pytest.approx(shutters[index].world_times_s[k], abs=1e-12)
            x_m, y_m = (speed * (world_s - 0.1) for speed in DISC_SPEED_M_S)
            if index == 1:
                x_m, y_m = x_m - 0.05, y_m - 0.02
            fx, fy, cx, cy = entry["params"]
            expected = (cx + fx * x_m / 2.0, cy - fy * y_m / 2.0)
            light = linear(read_picture(capture / entry["id"] / f"{k:04d}.png"))
            found = (
                np.sum(light * grid_x) / light.sum(),
                np.sum(light * grid_y) / light.sum(),
            )
            # 45 lit pixels, 64 samples each: the centroid's noise is a few thousandths of a pixel.
            assert found == pytest.approx(expected, abs=0.02)
    assert_discs_depth_and_motion(capture, truth_content["views"])


def assert_discs_depth_and_motion(capture: Path, views: list[dict[str, Any]]) -> None:
    """Assert that depth and motion maps show the disc at 2 m with its true size and motion, and nothing else."""
    for view in views:
        depth = np.load(capture / "truth" / view["depth"])
        motion = np.load(capture / "truth" / view["motion"])
        assert (
            depth.dtype == motion.dtype == np.float32
            and depth.shape == motion.shape == (48, 64)
        )
        seen = np.isfinite(depth)
        area_px = math.pi * (view["camera"]["params"][0] * DISC_RADIUS_M / 2.0) ** 2
        assert seen.sum() == pytest.approx(area_px, rel=0.15)
        assert depth[seen] == pytest.approx(2.0, abs=1e-5)
        assert motion[seen] == pytest.approx(
            math.hypot(*DISC_SPEED_M_S) / 30 * 64 / 2.0, abs=1e-3
        )
        assert (motion[~seen] == 0).all()


def matrices_at(scene: Any, time_s: float) -> dict[str, Any]:
    """Every object's `matrix_world` at a time, by name; the scene remains at this time."""
    whole, subframe = scenes.frame_at(scene, time_s)
    scene.frame_set(whole, subframe=subframe)
    return {o.name: np.array(o.matrix_world) for o in scene.objects}


def ray_of(pinhole: Any, lens_error: Any, pixel: tuple[float, float]) -> Any:
    """The ray of a pixel in camera coordinates, scaled to depth 1."""
    ((x, y),) = distortion.ideal_from_pixels(pinhole, lens_error, np.array([pixel]))
    return np.array(
        [(x - pinhole.cx_px) / pinhole.fx_px, (y - pinhole.cy_px) / pinhole.fy_px, 1.0]
    )


@pytest.mark.parametrize(
    "lens_error", [(0.0, 0.0, 0.0, 0.0), (-0.2, 0.05, 0.004, -0.003)], ids=str
)
def test_depth_and_motion_of_a_waved_magazine_match_its_matrices(
    tmp_path: Path, lens_error: tuple[float, ...]
) -> None:
    """The surface point of a pixel is moved by its object's matrices one frame back and forth, as in the motion map."""
    pytest.importorskip("bpy")
    from mathutils import Vector

    film_module = importlib.import_module("stlfr_extension.film")
    scene = scenes.open_scene("magazine", None)
    coefficients = distortion.Distortion(*lens_error)
    view = rig.load(ROOT / "rigs" / "linear8.json").cameras[5]
    view = dataclasses.replace(view, width_px=64, height_px=48, distortion=coefficients)
    studio = film_module.Studio(scene, (view,), 2)
    image = film_module.Image(view.id, world_time_s := 0.1234, 1, 5)
    depth_file, motion_file = tmp_path / "depth.npy", tmp_path / "motion.npy"
    studio.render_geometry(image, depth_file, motion_file, tmp_path, 30.0)
    depth, motion = np.load(depth_file), np.load(motion_file)
    described = studio.describe(view.id)
    pinhole = camera.Pinhole(64, 48, *described["params"][:4])
    assert tuple(described["params"][4:]) == (lens_error if any(lens_error) else ())
    cam_from_world = camera.RigidTransform(
        tuple(described["cam_from_world"]["rotation_wxyz"]),
        tuple(described["cam_from_world"]["translation"]),
    )
    world_from_cam = np.linalg.inv(cam_from_world.matrix())
    centre = Vector(world_from_cam[:3, 3])

    before, after, now = (
        matrices_at(scene, world_time_s + frames / 30) for frames in (-1, 1, 0)
    )
    graph = __import__("bpy").context.evaluated_depsgraph_get()
    moved = []
    for row, column in itertools.product(range(0, 48, 2), range(0, 64, 2)):
        ray = ray_of(pinhole, coefficients, (column + 0.5, row + 0.5))
        direction = world_from_cam[:3, :3] @ ray
        hit, point, _normal, _face, hit_object, _matrix = scene.ray_cast(
            graph, centre, Vector(direction)
        )
        assert hit
        depth_m = np.linalg.norm(
            np.array(point) - world_from_cam[:3, 3]
        ) / np.linalg.norm(ray)
        if abs(depth_m - depth[row, column]) > 1e-3:
            continue  # the sample is 0.01 px off the centre, maybe beyond an edge
        assert depth_m == pytest.approx(depth[row, column], abs=1e-3)
        local = np.linalg.inv(now[hit_object.name]) @ np.array([*point, 1.0])
        pixels = camera.project(
            pinhole,
            cam_from_world,
            np.array([(m[hit_object.name] @ local)[:3] for m in (before, now, after)]),
        )
        pixels = distortion.pixels_from_ideal(pinhole, coefficients, pixels)
        steps = np.linalg.norm(pixels[[0, 2]] - pixels[1], axis=1)
        assert motion[row, column] == pytest.approx(steps.max(), abs=2e-3)
        moved.append(steps.max())
    # With a distorted lens, the sample is up to 0.35 px off, so edges affect more pixels.
    assert len(moved) > (0.94 if any(lens_error) else 0.98) * 24 * 32
    assert np.mean(np.array(moved) > 0.5) > 0.1
