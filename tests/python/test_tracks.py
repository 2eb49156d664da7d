"""Point tracks against closed form, and against the depth and motion that Cycles renders; Workbench against Cycles."""

from __future__ import annotations

import dataclasses
import importlib
import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from filming import (
    add_disc,
    black_scene,
    errors,
    filmed_by_script,
    linear,
    plan,
    rig_camera,
    right_of_centre,
    write_rig,
)

FRAMES, POINTS = 4, 200

Array = np.ndarray[Any, Any]


@pytest.fixture(scope="module")
def rig_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A rig file with two cameras, 10 cm apart, with an offset of 0.37 frame intervals."""
    return write_rig(
        tmp_path_factory.mktemp("rig") / "rig.json",
        rig_camera("ref", delay_s=0.003),
        rig_camera(
            "late", delay_s=0.003 + 0.37 / 30, cam_from_rig=right_of_centre(0.1)
        ),
    )


PLACES_M = {"ref": 0.0, "late": 0.1, "bent": -0.08}
"""The distance of each camera to the right of the rig's centre, metres."""


@pytest.fixture(scope="module")
def rig_with_a_bent_lens(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A rig file with two cameras as in `rig_file`, and one whose distortion displaces the image's corners by 2 px."""
    lens_error = {"k1": -0.25, "k2": 0.05, "p1": 0.004, "p2": -0.003}
    cameras = [
        rig_camera(
            name,
            delay_s=0.003 + late / 30,
            cam_from_rig=right_of_centre(PLACES_M[name]),
        )
        for name, late in (("ref", 0.0), ("late", 0.37), ("bent", 0.7))
    ]
    cameras[2]["distortion"] = lens_error
    return write_rig(tmp_path_factory.mktemp("rig") / "rig.json", *cameras)


def wave_m(x: Array, time_s: float) -> Array:
    """The displacement towards the camera of the test scene's bending sheet, at horizontal positions `x`."""
    fraction = 0.5 + 0.5 * math.sin(9.0 * time_s)
    return fraction * 0.3 * x * x


@pytest.fixture(scope="module")
def tracked(
    rig_with_a_bent_lens: Path, tmp_path_factory: pytest.TempPathFactory
) -> Path:
    """A capture with tracks of a bending sheet 2 m away, and of a smaller plate that slides in front of it at 1.5 m."""
    bpy = pytest.importorskip("bpy")
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    scene.render.fps, scene.frame_start = 30, 1
    scene.camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
    scene.collection.objects.link(scene.camera)  # looks along -Z
    columns = 40
    xs = np.linspace(-1.5, 1.5, columns + 1)
    points = [(x, y, -2.0) for x in xs for y in (-1.2, 1.2)]
    faces = [(2 * i, 2 * i + 2, 2 * i + 3, 2 * i + 1) for i in range(columns)]
    mesh = bpy.data.meshes.new("sheet")
    mesh.from_pydata(points, [], faces)
    sheet = bpy.data.objects.new("sheet", mesh)
    scene.collection.objects.link(sheet)
    sheet.shape_key_add(name="rest")
    key = sheet.shape_key_add(name="bent")
    for i, (x, y, z) in enumerate(points):
        key.data[i].co = (x, y, z + 0.3 * x * x)
    seconds = "((frame - 1) / 30)"
    key.driver_add("value").driver.expression = f"0.5 + 0.5*sin(9.0*{seconds})"
    mesh = bpy.data.meshes.new("plate")
    mesh.from_pydata(
        [(x, y, 0) for x, y in ((-0.3, -0.2), (0.3, -0.2), (0.3, 0.2), (-0.3, 0.2))],
        [],
        [(0, 1, 2, 3)],
    )
    plate = bpy.data.objects.new("plate", mesh)
    scene.collection.objects.link(plate)
    plate.location.z = -1.5
    plate.driver_add("location", 0).driver.expression = f"2.0*{seconds} - 0.2"
    # An object that isn't rendered occludes nothing.
    hidden = bpy.data.objects.new("hidden", mesh)
    scene.collection.objects.link(hidden)
    hidden.location.z, hidden.hide_render = -0.5, True
    folder = tmp_path_factory.mktemp("tracks")
    bpy.ops.wm.save_as_mainfile(filepath=str(folder / "sheet.blend"))
    options = ["--frames", FRAMES, "--samples", 1, "--tracks", POINTS]
    # The instant of the reference's second frame.
    options += ["--instants-s", 1 / 30]
    filmed_by_script(
        rig_with_a_bent_lens,
        *("--blend", folder / "sheet.blend", "-o", folder / "film"),
        *options,
    )
    return folder / "film"


def read_tracks(capture: Path) -> tuple[dict[str, Any], dict[str, dict[str, Array]]]:
    """The content of tracks.json, and the arrays of each camera by name."""
    content = json.loads((capture / "truth/tracks/tracks.json").read_text())
    arrays = {
        camera["id"]: {
            name: np.load(capture / "truth/tracks" / camera[name])
            for name in ("world", "pixels", "visible")
        }
        for camera in content["cameras"]
    }
    return content, arrays


def test_tracks_follow_what_moves_and_bends(tracked: Path) -> None:
    content, arrays = read_tracks(tracked)
    truth = json.loads((tracked / "truth/truth.json").read_text())
    assert truth["tracks"] == "tracks/tracks.json"
    opened = importlib.import_module("stlfr").open(tracked)
    assert content["objects"] == ["plate", "sheet"]
    on_sheet = np.array(content["object"]) == 1
    assert len(on_sheet) == POINTS and 0.05 < on_sheet.mean() < 0.95
    for index, camera in enumerate(content["cameras"]):
        assert camera["times_s"] == truth["shutter"][index]["times_s"]
        world, pixels, visible = (
            arrays[camera["id"]][name] for name in ("world", "pixels", "visible")
        )
        assert world.shape == (FRAMES, POINTS, 3) and world.dtype == np.float64
        assert pixels.shape == (FRAMES, POINTS, 2) and pixels.dtype == np.float64
        assert visible.shape == (FRAMES, POINTS) and visible.dtype == np.uint8
        by_module = opened.project(camera["id"], world.reshape(-1, 3))
        assert pixels.reshape(-1, 2) == pytest.approx(by_module, abs=1e-9, nan_ok=True)
        for k, clock_s in enumerate(camera["times_s"]):
            time_s = clock_s + 0.003  # the reference's clock shows 0 at its delay
            plate, sheet = world[k][~on_sheet], world[k][on_sheet]
            assert plate[:, 2] == pytest.approx(-1.5, abs=1e-6)
            slid = plate[:, 0] - 2.0 * time_s
            assert slid == pytest.approx(
                world[0][~on_sheet][:, 0] - 2.0 * (camera["times_s"][0] + 0.003),
                abs=2e-6,
            )
            # Between the sheet's 40 columns, the chord is up to 0.3 * 0.0375^2 in front of the curve.
            assert sheet[:, 2] + 2.0 == pytest.approx(
                wave_m(sheet[:, 0], time_s), abs=0.3 * 0.0375**2 + 1e-6
            )
            assert sheet[:, :2] == pytest.approx(world[0][on_sheet][:, :2], abs=1e-6)


def test_visibility_is_what_stands_before_a_point(tracked: Path) -> None:
    content, arrays = read_tracks(tracked)
    on_sheet = np.array(content["object"]) == 1
    sides = set()
    for camera in content["cameras"]:
        world, pixels, visible = (
            arrays[camera["id"]][name] for name in ("world", "pixels", "visible")
        )
        centre = np.array([PLACES_M[camera["id"]], 0.0, 0.0])
        inside = ((pixels >= 0) & (pixels <= (64, 48))).all(axis=-1)
        for k, clock_s in enumerate(camera["times_s"]):
            # The intersection of the ray to the point with the plate's plane.
            fraction = (-1.5 - centre[2]) / (world[k][:, 2] - centre[2])
            crossing = centre + fraction[:, None] * (world[k] - centre)
            left = crossing[:, 0] - (2.0 * (clock_s + 0.003) - 0.2)
            covered = (np.abs(left) < 0.3) & (np.abs(crossing[:, 1]) < 0.2) & on_sheet
            margin = np.minimum(
                abs(np.abs(left) - 0.3), abs(np.abs(crossing[:, 1]) - 0.2)
            )
            sure = margin > 1e-4
            expected = inside[k] & ~covered
            assert (visible[k].astype(bool) == expected)[sure].all()
            sides |= {
                (bool(s), bool(v)) for s, v in zip(on_sheet, expected, strict=True)
            }
    assert sides >= {(True, True), (True, False), (False, True)}


def test_tracks_agree_with_the_rendered_depth_and_motion(tracked: Path) -> None:
    """At the instant of a reference frame, the depth map at the points and their motion agree with the tracks."""
    content, arrays = read_tracks(tracked)
    truth = json.loads((tracked / "truth/truth.json").read_text())
    view = next(v for v in truth["views"] if v["like"] == "ref")
    assert content["cameras"][0]["times_s"][1] == pytest.approx(
        view["time_s"], abs=1e-12
    )
    depth, motion = (
        np.load(tracked / "truth" / view[name]) for name in ("depth", "motion")
    )
    ref = arrays["ref"]
    pixels, visible = ref["pixels"][1], ref["visible"][1].astype(bool)
    column, row = (
        np.floor(pixels[:, i]).clip(0, side - 1).astype(int)
        for i, side in ((0, 64), (1, 48))
    )
    z_m = -ref["world"][1][:, 2]  # the camera is at the origin and looks along -Z
    # Away from the plate's edges, all points in a pixel have the pixel's depth and motion.
    window = np.stack(
        [
            depth[(row + dy).clip(0, 47), (column + dx).clip(0, 63)]
            for dy in (-1, 0, 1)
            for dx in (-1, 0, 1)
        ]
    )
    smooth = visible & (np.ptp(window, axis=0) < 0.05)
    assert smooth.sum() > 0.4 * POINTS
    slope_m = np.ptp(window, axis=0)
    assert (np.abs(depth[row, column] - z_m) <= slope_m / 2 + 1e-4)[smooth].all()
    plate = smooth & (np.array(content["object"]) == 0)
    assert plate.sum() > 10
    assert depth[row, column][plate] == pytest.approx(z_m[plate], abs=1e-5)
    steps = np.linalg.norm(np.diff(ref["pixels"][:3], axis=0), axis=2).max(axis=0)
    assert motion[row, column][plate] == pytest.approx(steps[plate], abs=0.01)


def test_workbench_sees_the_same_geometry_as_cycles(
    rig_file: Path, tmp_path: Path
) -> None:
    """The centroid of a moving black disc on white is at the same, correct position with both engines."""
    bpy = pytest.importorskip("bpy")
    cv2 = pytest.importorskip("cv2")
    black_scene()
    add_disc((0.0, 0.0, -3.0), 9.0, 0.8, vertices=96)
    disc = add_disc((0.0, 0.0, -2.0), 0.3, 0.0, vertices=96)
    for axis, speed in enumerate((1.8, -1.1)):
        driver = disc.driver_add("location", axis).driver
        driver.expression = f"{speed} * ((frame - 1) / 30 - 0.03)"
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "disc.blend"))
    grid = np.stack(np.meshgrid(np.arange(64) + 0.5, np.arange(48) + 0.5), axis=-1)
    found = {}
    for engine in ("cycles", "workbench"):
        folder = tmp_path / engine
        filmed_by_script(
            rig_file,
            *("--blend", tmp_path / "disc.blend", "-o", folder, "--frames", 2),
            *("--samples", 32, "--no-truth", "--engine", engine),
        )
        centroids = []
        for entry, offset_s, x0_m in zip(
            json.loads((folder / "capture.json").read_text())["cameras"],
            (0.003, 0.003 + 0.37 / 30),
            (0.0, 0.1),
            strict=True,
        ):
            for k in range(2):
                file = folder / entry["id"] / f"{k:04d}.png"
                s = np.asarray(cv2.imread(str(file), cv2.IMREAD_GRAYSCALE)) / 255
                light = linear(s)
                dark = np.clip(1 - light / light.max(), 0, 1)
                centroid = (dark[..., None] * grid).sum(axis=(0, 1)) / dark.sum()
                area_px = dark.sum()
                fx, fy, cx, cy = entry["params"]
                since_s = offset_s + k / 30 - 0.03
                expected = (
                    cx + fx * (1.8 * since_s - x0_m) / 2.0,
                    cy - fy * (-1.1 * since_s) / 2.0,
                )
                assert centroid == pytest.approx(expected, abs=0.04), engine
                centroids.append((*centroid, area_px))
        found[engine] = np.array(centroids)
    assert found["workbench"][:, :2] == pytest.approx(found["cycles"][:, :2], abs=0.03)
    assert found["workbench"][:, 2] == pytest.approx(found["cycles"][:, 2], rel=0.02)


def test_a_film_never_mixes_engines_or_instants(rig_file: Path, tmp_path: Path) -> None:
    options = plan.Options(rig_file, "template", None, None, 4, 1, 0, 0, True)
    plan.claim(plan.make(options), tmp_path / "film")
    plan.claim(plan.make(options), tmp_path / "film")
    for change in ({"engine": "workbench"}, {"tracks": 5}, {"instants_s": (0.05,)}):
        other = plan.make(dataclasses.replace(options, **change))
        with pytest.raises(errors.BadInputError, match="another rig, scene or options"):
            plan.claim(other, tmp_path / "film")


@pytest.mark.parametrize("instant_s", [0.01, 0.2])
def test_an_instant_that_not_all_cameras_film_is_refused(
    rig_file: Path, instant_s: float
) -> None:
    options = plan.Options(
        rig_file, "template", None, None, 4, 1, 0, 0, True, instants_s=(0.05, instant_s)
    )
    with pytest.raises(errors.BadInputError, match=r"film from 0\.0123 to 0\.1000 s"):
        plan.make(options)
