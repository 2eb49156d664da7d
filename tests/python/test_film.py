"""Filming: cameras, rigs and shutters in closed form; pictures against where things must be."""

from __future__ import annotations

import dataclasses
import importlib
import importlib.util
import itertools
import json
import math
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

ROOT = Path(__file__).resolve().parents[2]
CAPTURE_SCRIPT = ROOT / "blender" / "capture.py"

spec = importlib.util.spec_from_file_location("stlfr_capture_script", CAPTURE_SCRIPT)
assert spec is not None and spec.loader is not None
spec.loader.exec_module(importlib.util.module_from_spec(spec))  # loads stlfr_extension

camera = importlib.import_module("stlfr_extension.camera")
distortion = importlib.import_module("stlfr_extension.distortion")
errors = importlib.import_module("stlfr_extension.errors")
plan = importlib.import_module("stlfr_extension.plan")
rig = importlib.import_module("stlfr_extension.rig")
scenes = importlib.import_module("stlfr_extension.scenes")
truth = importlib.import_module("stlfr_extension.truth")

IDENTITY = {"rotation_wxyz": [1, 0, 0, 0], "translation": [0, 0, 0]}


def rig_camera(camera_id: str, **changes: Any) -> dict[str, Any]:
    """A camera of a rig file: 64x48, at the rig's centre, opening with the scene."""
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
    """A rig file."""
    content = {
        "format": "stlfr-rig",
        "version": 1,
        "name": "small",
        "seed": 3,
        "cameras": list(cameras),
    }
    return {**content, "reference": cameras[0]["id"], **changes}


def write_rig(path: Path, *cameras: dict[str, Any], **changes: Any) -> Path:
    """Save a rig file."""
    path.write_text(json.dumps(rig_content(*cameras, **changes)), encoding="utf-8")
    return path


def film(*arguments: object) -> subprocess.CompletedProcess[str]:
    """Run the headless script."""
    return run([sys.executable, "-I", str(CAPTURE_SCRIPT), *map(str, arguments)])


def run(command: list[str]) -> subprocess.CompletedProcess[str]:
    """Run a command to its end, whatever its exit code."""
    return subprocess.run(
        command, check=False, capture_output=True, text=True, timeout=240
    )


# Camera conversion


@pytest.fixture
def empty_blender() -> Any:
    """An empty Blender file with one camera, 2 m behind the origin and turned a little."""
    bpy = pytest.importorskip("bpy")
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    scene.camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
    scene.collection.objects.link(scene.camera)
    scene.camera.location = (0.3, -2.0, 0.4)
    scene.camera.rotation_euler = (1.45, 0.1, 0.05)
    return scene


LENSES = [
    {
        "size": size,
        "fit": fit,
        "shift": shift,
        "aspect": aspect,
        "percentage": percentage,
    }
    for size, fit, (shift, aspect, percentage) in itertools.product(
        [(640, 480), (480, 640), (500, 500)],
        ["AUTO", "HORIZONTAL", "VERTICAL"],
        [
            ((0.0, 0.0), (1.0, 1.0), 100),
            ((0.11, -0.07), (1.0, 1.0), 50),
            ((-0.2, 0.13), (1.0, 1.5), 100),
            (
                (0.05, 0.3),
                (2.0, 1.0),
                25,
            ),  # whole pixels: world_to_camera_view knows no rounding
        ],
    )
]


@pytest.mark.parametrize("lens", LENSES, ids=str)
def test_pinhole_projects_as_blender_does(
    empty_blender: Any, lens: dict[str, Any]
) -> None:
    from bpy_extras.object_utils import world_to_camera_view
    from mathutils import Vector

    scene, render, data = empty_blender, empty_blender.render, empty_blender.camera.data
    render.resolution_x, render.resolution_y = lens["size"]
    render.pixel_aspect_x, render.pixel_aspect_y = lens["aspect"]
    render.resolution_percentage = lens["percentage"]
    data.sensor_fit, data.lens, data.sensor_width, data.sensor_height = (
        lens["fit"],
        41.0,
        33.0,
        21.0,
    )
    data.shift_x, data.shift_y = lens["shift"]
    scene.frame_set(1)

    read_back = camera.lens_of(scene.camera, scene)
    assert (read_back.width_px, read_back.height_px) == tuple(
        side * lens["percentage"] // 100 for side in lens["size"]
    )
    points = np.random.default_rng(0).uniform(
        (-0.8, -0.5, -0.5), (0.8, 1.0, 1.0), (50, 3)
    )
    pinhole = camera.pinhole_from_lens(read_back)
    pixels = camera.project(pinhole, camera.cam_from_world_of(scene.camera), points)
    for point, pixel in zip(points, pixels, strict=True):
        view = world_to_camera_view(scene, scene.camera, Vector(point))
        # Blender's camera view runs from 0 to 1, bottom to top, in single precision.
        expected = (view.x * read_back.width_px, (1 - view.y) * read_back.height_px)
        assert pixel == pytest.approx(expected, abs=2e-3)


@pytest.mark.parametrize("lens", LENSES, ids=str)
def test_a_lens_made_from_a_pinhole_is_that_pinhole(lens: dict[str, Any]) -> None:
    pinhole = camera.pinhole_from_lens(
        camera.BlenderLens(
            *lens["size"],
            41.0,
            33.0,
            21.0,
            lens["fit"],
            *lens["shift"],
            *lens["aspect"],
        )
    )
    back = camera.lens_from_pinhole(pinhole)
    assert min(back.pixel_aspect_x, back.pixel_aspect_y) == 1.0
    assert camera.pinhole_from_lens(back).params == pytest.approx(
        pinhole.params, rel=1e-12
    )


def test_a_camera_matrix_survives_the_way_to_colmap_and_back(
    empty_blender: Any,
) -> None:
    empty_blender.camera.scale = (2.0, 2.0, 2.0)  # Blender ignores a camera's scale
    empty_blender.frame_set(1)
    cam_from_world = camera.cam_from_world_of(empty_blender.camera)
    assert math.hypot(*cam_from_world.rotation_wxyz) == pytest.approx(1.0, abs=1e-12)
    expected = np.array(empty_blender.camera.matrix_world)
    expected[:3, :3] /= 2.0
    assert camera.blender_matrix(cam_from_world) == pytest.approx(expected, abs=1e-6)


def test_points_behind_a_camera_have_no_pixel() -> None:
    pinhole = camera.Pinhole(64, 48, 60.0, 60.0, 32.0, 24.0)
    here = camera.RigidTransform((1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    pixels = camera.project(
        pinhole, here, np.array([[0.0, 0.0, 2.0], [0.0, 0.0, -2.0], [0.1, 0.0, 0.0]])
    )
    assert pixels[0].tolist() == [32.0, 24.0]
    assert np.isnan(pixels[1:]).all()


# Rig files


def without(content: dict[str, Any], field: str) -> dict[str, Any]:
    return {name: value for name, value in content.items() if name != field}


@pytest.mark.parametrize(
    ("content", "complaint"),
    [
        (
            rig_content(rig_camera("a"), format="rig"),
            'format must be "stlfr-rig", not "rig"',
        ),
        (rig_content(rig_camera("a"), version=2), "version must be 1, not 2"),
        (
            rig_content(rig_camera("a"), reference="b"),
            'reference names no camera of the rig: "b"',
        ),
        (
            rig_content(rig_camera("a"), colour="red"),
            "colour is not a field of this format",
        ),
        (without(rig_content(rig_camera("a")), "seed"), "seed is missing"),
        (
            rig_content(rig_camera("a"), cameras=[]),
            "cameras must hold at least one camera",
        ),
        (rig_content(rig_camera("a"), rig_camera("a")), 'have two entries with id "a"'),
        (rig_content(rig_camera("truth")), 'cameras[0].id can\'t be "truth"'),
        (rig_content(rig_camera("../a")), 'cameras[0].id can\'t be "../a"'),
        (
            rig_content(rig_camera("a", lens_mm=-1)),
            "cameras[0].lens_mm must be a number from 1 to 5000, not -1",
        ),
        (
            rig_content(rig_camera("a", width=64.5)),
            "cameras[0].width must be a whole number",
        ),
        (
            rig_content(rig_camera("a", jitter_s=0.01)),
            "cameras[0].jitter_s must be a number from 0 to",
        ),
        (
            rig_content(rig_camera("a", jitter_stamped=1)),
            "cameras[0].jitter_stamped must be true or false",
        ),
        (
            rig_content(rig_camera("a", color="blue")),
            'cameras[0].color must be "rgb" or "gray"',
        ),
        (
            rig_content(rig_camera("a", frames=3)),
            "cameras[0].frames is not a field of this format",
        ),
        (
            rig_content(
                rig_camera(
                    "a", cam_from_rig={**IDENTITY, "rotation_wxyz": [1, 1, 0, 0]}
                )
            ),
            "cameras[0].cam_from_rig.rotation_wxyz must have length 1, not 1.41421",
        ),
        (
            rig_content(
                rig_camera("a", cam_from_rig={**IDENTITY, "translation": [0, 0]})
            ),
            "cameras[0].cam_from_rig.translation must be 3 numbers",
        ),
        ([], "the file must be a JSON object"),
    ],
)
def test_a_bad_rig_is_refused_with_its_file_and_field(
    tmp_path: Path, content: Any, complaint: str
) -> None:
    path = tmp_path / "bad.json"
    path.write_text(json.dumps(content), encoding="utf-8")
    with pytest.raises(errors.BadInputError) as caught:
        rig.load(path)
    assert str(caught.value).startswith(f"{path}: ")
    assert complaint in str(caught.value)


@pytest.mark.parametrize("text", ['{"format": NaN', '{"seed": 1, "seed": 2}', "\x00"])
def test_a_file_that_is_not_json_is_refused(tmp_path: Path, text: str) -> None:
    path = tmp_path / "bad.json"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(errors.BadInputError, match="not valid JSON"):
        rig.load(path)


# Shutter times and truth


def loaded_rig(path: Path, *cameras: dict[str, Any], **changes: Any) -> Any:
    return rig.load(write_rig(path / "rig.json", *cameras, **changes))


def test_a_camera_opening_after_the_reference_has_a_positive_offset(
    tmp_path: Path,
) -> None:
    small = loaded_rig(
        tmp_path,
        rig_camera("ref", delay_s=0.010),
        rig_camera("late", delay_s=0.010 + 0.4 / 30),
    )
    shutters = rig.shutters(small, 5)
    assert truth.offsets_s(small, shutters) == {
        "ref": 0.0,
        "late": pytest.approx(+0.4 / 30),
    }
    assert shutters[1].world_times_s[2] == pytest.approx(0.010 + 2.4 / 30)
    assert shutters[1].clock_times_s[2] == pytest.approx(2 / 30)


def test_jitter_is_gaussian_and_does_not_depend_on_how_much_is_filmed(
    tmp_path: Path,
) -> None:
    small = loaded_rig(
        tmp_path, rig_camera("a", jitter_s=0.001), rig_camera("b", jitter_s=0.001)
    )
    long, other = rig.shutters(small, 4000)
    assert rig.shutter(small, 0, 7).world_times_s == long.world_times_s[:7]
    jitter = np.array(long.clock_times_s) - np.arange(4000) / 30
    assert abs(jitter.mean()) < 5e-5
    assert jitter.std() == pytest.approx(0.001, rel=0.05)
    assert abs(np.corrcoef(jitter, np.array(other.clock_times_s))[0, 1]) < 0.1


def test_hidden_jitter_moves_the_true_offset_by_its_mean(tmp_path: Path) -> None:
    hidden = {"jitter_s": 0.002, "jitter_stamped": False}
    small = loaded_rig(
        tmp_path, rig_camera("ref"), rig_camera("late", delay_s=0.01, **hidden)
    )
    shutters = rig.shutters(small, 9)
    nominal_s = np.arange(9) / 30
    expected = np.mean(np.array(shutters[1].world_times_s) - nominal_s)
    assert truth.offsets_s(small, shutters)["late"] == pytest.approx(expected)
    assert expected != pytest.approx(0.01, abs=1e-5)


def test_instants_lie_between_frames_of_all_cameras_with_another_frame_beyond() -> None:
    linear8 = rig.load(ROOT / "rigs" / "linear8.json")
    shutters = rig.shutters(linear8, 9)
    zero_s = truth.reference_zero_s(linear8, shutters)
    instants = truth.instants_s(linear8, shutters, 3)
    assert len(set(instants)) == 3
    for instant in instants:
        for shutter in shutters:
            times = np.array(shutter.world_times_s) - zero_s
            assert np.sum(times < instant) >= 2 and np.sum(times > instant) >= 2
            assert np.abs(times - instant).min() > 0.019 / 30


def test_too_short_a_film_for_truth_is_refused() -> None:
    linear8 = rig.load(ROOT / "rigs" / "linear8.json")
    with pytest.raises(
        errors.BadInputError, match=r"--instants 3: 2 frames .* film more --frames"
    ):
        truth.instants_s(linear8, rig.shutters(linear8, 2), 3)


def test_every_image_has_noise_of_its_own() -> None:
    whole = plan.make(
        plan.Options(
            ROOT / "rigs" / "linear8.json", "magazine", None, None, 9, 16, 3, 5, True
        )
    )
    seeds = [job.seed for job in whole.jobs]
    assert len(seeds) == len(set(seeds)) == 8 * 9 + 2 * 3 * 10 + 5


# Pictures

DISC_RADIUS_M = 0.12
DISC_SPEED_M_S = (0.9, 0.5)  # right and up, at 2 m: 0.96 and 0.53 pixels a frame


@pytest.fixture(scope="module")
def moving_disc(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A .blend: a white disc on black, 2 m before the scene's camera, at the centre at 0.1 s and in uniform motion."""
    bpy = pytest.importorskip("bpy")
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    scene.render.fps, scene.frame_start = 30, 5
    scene.camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
    scene.collection.objects.link(scene.camera)
    bpy.ops.mesh.primitive_circle_add(
        vertices=96, radius=DISC_RADIUS_M, fill_type="NGON"
    )
    disc = bpy.context.object
    disc.location.z = -2.0  # the camera looks along -z
    for axis, speed in enumerate(DISC_SPEED_M_S):
        driver = disc.driver_add("location", axis).driver
        driver.expression = f"{speed} * ((frame - 5) / 30 - 0.1)"
    material = bpy.data.materials.new("white")
    nodes = material.node_tree.nodes
    nodes.clear()
    emission, output = (
        nodes.new("ShaderNodeEmission"),
        nodes.new("ShaderNodeOutputMaterial"),
    )
    material.node_tree.links.new(emission.outputs[0], output.inputs[0])
    disc.data.materials.append(material)
    path = tmp_path_factory.mktemp("disc") / "disc.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(path))
    return path


def read_picture(path: Path) -> np.ndarray[Any, Any]:
    """A PNG as height x width, top row first, 0 to 255."""
    cv2 = pytest.importorskip("cv2")
    picture = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    return np.asarray(picture, dtype=np.float64)


def linear(encoded: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
    """Light from display-encoded sRGB."""
    s = encoded / 255
    return np.where(s <= 0.04045, s / 12.92, ((s + 0.055) / 1.055) ** 2.4)


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
    result = film(
        rig_file,
        "--blend",
        moving_disc,
        "-o",
        capture,
        "--frames",
        6,
        "--samples",
        64,
        "--instants",
        1,
    )
    assert result.returncode == 0, result.stderr

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
            world_s = true_s[k] + 0.004  # the reference's clock reads 0 at its delay
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

    for view in truth_content["views"]:
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


@pytest.mark.parametrize(
    "lens_error", [(0.0, 0.0, 0.0, 0.0), (-0.2, 0.05, 0.004, -0.003)], ids=str
)
def test_depth_and_motion_of_a_waved_magazine_match_its_matrices(
    tmp_path: Path, lens_error: tuple[float, ...]
) -> None:
    """Each pixel's point, carried by its object's matrices one frame back and on, moves as far as the truth says."""
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

    def matrices(time_s: float) -> dict[str, Any]:
        whole, subframe = scenes.frame_at(scene, time_s)
        scene.frame_set(whole, subframe=subframe)
        return {o.name: np.array(o.matrix_world) for o in scene.objects}

    before, after = matrices(world_time_s - 1 / 30), matrices(world_time_s + 1 / 30)
    now = matrices(world_time_s)
    graph = __import__("bpy").context.evaluated_depsgraph_get()
    moved = []
    for row, column in itertools.product(range(0, 48, 2), range(0, 64, 2)):
        ((ideal_x, ideal_y),) = distortion.ideal_from_pixels(
            pinhole, coefficients, np.array([[column + 0.5, row + 0.5]])
        )
        ray = np.array(
            [
                (ideal_x - pinhole.cx_px) / pinhole.fx_px,
                (ideal_y - pinhole.cy_px) / pinhole.fy_px,
                1.0,
            ]
        )
        direction = world_from_cam[:3, :3] @ ray
        hit, point, _normal, _face, hit_object, _matrix = scene.ray_cast(
            graph, centre, Vector(direction)
        )
        assert hit
        depth_m = np.linalg.norm(
            np.array(point) - world_from_cam[:3, 3]
        ) / np.linalg.norm(ray)
        if abs(depth_m - depth[row, column]) > 1e-3:
            continue  # the sample lies 0.01 px off the centre, so it can fall beside an edge
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
    # A distorted lens's sample lies up to 0.35 px off: more pixels have an edge that near.
    assert len(moved) > (0.94 if any(lens_error) else 0.98) * 24 * 32
    assert np.mean(np.array(moved) > 0.5) > 0.1


# Stopping, going on, refusing


def small_film(folder: Path, rig_file: Path, *more: object) -> list[str]:
    options = [
        "--scene",
        "magazine",
        "--frames",
        "4",
        "--samples",
        "1",
        "--instants",
        "1",
    ]
    command = [
        sys.executable,
        "-I",
        str(CAPTURE_SCRIPT),
        str(rig_file),
        *options,
        "-o",
        str(folder),
    ]
    return [*command, *map(str, more)]


def contents(folder: Path) -> dict[str, bytes]:
    """Every visible file."""
    files = (path for path in sorted(folder.rglob("*")) if path.is_file())
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in files
        if ".film" not in path.relative_to(folder).parts
    }


@pytest.fixture(scope="module")
def small_rig(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two cameras 6 cm apart, 0.37 frame apart in time."""
    beside = {**IDENTITY, "translation": [-0.06, 0, 0]}
    return write_rig(
        tmp_path_factory.mktemp("rig") / "rig.json",
        rig_camera("left", delay_s=0.003),
        rig_camera("right", delay_s=0.003 + 0.37 / 30, cam_from_rig=beside),
    )


@pytest.fixture(scope="module")
def uninterrupted(small_rig: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The film of `small_rig`, made in one go."""
    folder = tmp_path_factory.mktemp("whole") / "capture"
    result = run(small_film(folder, small_rig))
    assert result.returncode == 0, result.stderr
    lines = [json.loads(line) for line in result.stdout.splitlines()]
    assert [line["done"] for line in lines] == list(range(13))
    assert all(
        set(line) == {"done", "total", "what"} and line["total"] == 12 for line in lines
    )
    return folder


@pytest.mark.parametrize("by", [signal.SIGTERM, signal.SIGKILL])
def test_an_interrupted_film_goes_on_where_it_was(
    uninterrupted: Path, small_rig: Path, tmp_path: Path, by: signal.Signals
) -> None:
    folder = tmp_path / "capture"
    with subprocess.Popen(
        small_film(folder, small_rig),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as process:
        assert process.stdout is not None and process.stderr is not None
        for line in process.stdout:
            if json.loads(line)["done"] >= 3:
                process.send_signal(by)
                break
        status = process.wait(timeout=30)
        complaint = process.stderr.read()
    if by == signal.SIGTERM:
        assert status == 1
        assert (
            complaint == "filming was stopped; the same command goes on where it was\n"
        )
    time.sleep(1.0)  # an orphaned worker finishes its image and ends
    assert not (folder / "capture.json").exists()
    finished = {
        path: path.stat().st_mtime_ns
        for path in folder.rglob("*.png")
        if ".film" not in path.parts
    }
    assert 3 <= len(finished) < 12
    cut_off = next(iter(finished))
    cut_off.write_bytes(cut_off.read_bytes()[:-20])
    del finished[cut_off]

    result = run(small_film(folder, small_rig))
    assert result.returncode == 0, result.stderr
    assert {path: path.stat().st_mtime_ns for path in finished} == finished
    assert contents(folder) == contents(uninterrupted)


def test_filming_again_does_nothing_and_at_once(
    uninterrupted: Path, small_rig: Path
) -> None:
    before = {path: path.stat().st_mtime_ns for path in uninterrupted.rglob("*")}
    start = os.times()
    result = run(small_film(uninterrupted, small_rig))
    end = os.times()
    worked_s = end.children_user - start.children_user
    assert worked_s < 1.5  # a Blender started takes more, this takes 0.2
    assert result.returncode == 0, result.stderr
    assert json.loads(result.stdout) == {
        "done": 12,
        "total": 12,
        "what": "already filmed",
    }
    assert {
        path: path.stat().st_mtime_ns for path in uninterrupted.rglob("*")
    } == before


def test_a_film_is_the_same_on_one_process_or_two(
    uninterrupted: Path, small_rig: Path, tmp_path: Path
) -> None:
    folder = tmp_path / "capture"
    result = run(small_film(folder, small_rig, "--workers", 1))
    assert result.returncode == 0, result.stderr
    assert contents(folder) == contents(uninterrupted)


def test_another_plan_and_foreign_folders_are_refused(
    uninterrupted: Path, small_rig: Path, tmp_path: Path
) -> None:
    before = contents(uninterrupted)
    other = film(small_rig, "--scene", "magazine", "--frames", 5, "-o", uninterrupted)
    assert other.returncode == 2
    assert (
        "another rig, scene or options" in other.stderr
        and other.stderr.count("\n") == 1
    )
    assert contents(uninterrupted) == before

    (tmp_path / "notes.txt").write_text("mine")
    foreign = film(small_rig, "--scene", "magazine", "-o", tmp_path)
    assert foreign.returncode == 2
    assert "already holds files" in foreign.stderr and foreign.stderr.count("\n") == 1
    assert [path.name for path in tmp_path.iterdir()] == ["notes.txt"]


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        (
            ["--scene", "nowhere"],
            "--scene nowhere: no such scene; there are: along, ball,",
        ),
        (["--blend", "nowhere.blend"], "nowhere.blend: no such file"),
        ([], "one of the arguments --scene --blend is required"),
        (
            ["--scene", "magazine", "--size", "64x64"],
            "--size 64x64 has another aspect than left of rig small",
        ),
        (
            ["--scene", "magazine", "--size", "64by48"],
            "64by48 isn't a size like 320x240",
        ),
        (["--scene", "magazine", "--frames", "0"], "0 isn't a whole number from 1"),
        (["--scene", "magazine", "--truth-video", "4"], "rig small has no views"),
    ],
)
def test_bad_options_are_one_sentence(
    small_rig: Path, tmp_path: Path, arguments: list[str], complaint: str
) -> None:
    result = film(small_rig, *arguments, "-o", tmp_path / "capture")
    assert result.returncode == 2
    assert complaint in result.stderr and result.stderr.count("\n") == 1
    assert result.stdout == ""
    assert not (tmp_path / "capture").exists()


def test_a_scene_without_a_place_for_the_rig_is_refused(
    small_rig: Path, tmp_path: Path
) -> None:
    bpy = pytest.importorskip("bpy")
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "empty.blend"))
    result = film(
        small_rig,
        "--blend",
        tmp_path / "empty.blend",
        "-o",
        tmp_path / "capture",
        "--no-truth",
    )
    assert result.returncode == 2
    assert (
        "doesn't say where the rig stands" in result.stderr
        and result.stderr.count("\n") == 1
    )
    assert not (tmp_path / "capture" / "capture.json").exists()
