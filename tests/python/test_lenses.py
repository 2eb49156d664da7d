"""Lenses and sensors: Blender's cameras against closed form, and distortion and sensor faults in filmed images."""

from __future__ import annotations

import importlib
import itertools
import json
import math
from pathlib import Path
from typing import Any

import filming
import numpy as np
import pytest
from filming import CORPUS, camera, described, distortion, loaded, rig, sensor

# Camera conversion


@pytest.fixture
def empty_blender() -> Any:
    """An empty Blender file with one camera, 2 m behind the origin and slightly rotated."""
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
            ),  # integers, as world_to_camera_view doesn't round
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


# Lenses and sensors, in closed form


def test_distortion_and_its_inverse_agree() -> None:
    lens = camera.Pinhole(640, 480, 686.0, 680.0, 321.0, 239.0)
    bent = distortion.Distortion(-0.21, 0.07, 1e-3, -2e-3)
    pixels = np.random.default_rng(0).uniform((0, 0), (640, 480), (500, 2))
    ideal = distortion.ideal_from_pixels(lens, bent, pixels)
    back = distortion.pixels_from_ideal(lens, bent, ideal)
    assert back == pytest.approx(pixels, abs=1e-9)
    folded = distortion.Distortion(k1=-0.5)  # r (1 - r²/2) reaches 0.544 at most
    found = folded.undistorted(np.array([[0.5, 0.0], [0.6, 0.0]]))
    assert np.isfinite(found[0]).all() and np.isnan(found[1]).all()


def test_a_pixel_looks_where_it_projects_from() -> None:
    lens = camera.Pinhole(640, 480, 686.0, 680.0, 321.0, 239.0)
    pose = camera.RigidTransform((0.8, -0.2, 0.4, 0.4), (0.3, -1.1, 2.0))
    bent = distortion.Distortion(-0.21, 0.07, 1e-3, -2e-3)
    for entry in (described.describe(lens, pose, bent), described.describe(lens, pose)):
        for pixel in ((0.0, 0.0), (321.0, 239.0), (600.5, 30.25)):
            place = described.centre_of(entry) + 3.0 * described.direction_of(
                entry, pixel
            )
            (found,) = described.project(entry, place[None])
            assert found == pytest.approx(pixel, abs=1e-9)


def test_resampling_reproduces_ramps() -> None:
    lens = camera.Pinhole(64, 48, 60.0, 60.0, 33.0, 23.0)
    bent = distortion.Distortion(-0.2, 0.05, 1e-3, -2e-3)
    pinhole = sensor.wide_pinhole(lens, bent)
    wide = sensor.Wide(lens, bent, pinhole)
    y, x = np.mgrid[: pinhole.height_px, : pinhole.width_px] + 0.5
    ramps = wide.resample(np.stack([x, y, np.ones_like(x)], axis=2).astype(np.float32))
    grid = np.stack(np.meshgrid(np.arange(64) + 0.5, np.arange(48) + 0.5), axis=2)
    ideal = distortion.ideal_from_pixels(lens, bent, grid.reshape(-1, 2))
    expected = wide.of_image(ideal).reshape(48, 64, 2)
    assert ramps[..., :2] == pytest.approx(expected, abs=1e-4)
    assert ramps[..., 2] == pytest.approx(1.0, abs=1e-6)


def sensor_of(tmp_path: Path, **changes: Any) -> Any:
    fields = {f"cameras.1.{name}": value for name, value in changes.items()}
    return loaded(tmp_path, fields).cameras[1]


def test_noise_is_gaussian_of_its_own_for_every_image(tmp_path: Path) -> None:
    noisy = sensor_of(tmp_path, noise=0.02, bit_depth=16)
    light = np.full((200, 300, 3), 0.2, dtype=np.float32)
    clean = sensor.develop(light, noisy, None) / 65535
    one, other = (sensor.develop(light, noisy, seed) / 65535 - clean for seed in (1, 2))
    assert one.std() == pytest.approx(0.02, rel=0.02)
    assert abs(one.mean()) < 5 * 0.02 / math.sqrt(one.size)
    assert np.mean(one**4) / np.mean(one**2) ** 2 == pytest.approx(3.0, abs=0.1)
    assert abs(np.corrcoef(one.ravel(), other.ravel())[0, 1]) < 0.02
    assert (sensor.develop(light, noisy, 1) / 65535 - clean == one).all()


def test_gain_multiplies_light_before_it_is_encoded(tmp_path: Path) -> None:
    light = np.array([[[0.1, 0.2, 0.8]]], dtype=np.float32)
    doubled = sensor.develop(light, sensor_of(tmp_path, gain=2.0), None)
    assert (doubled == np.round(255 * sensor.encoded(2 * light))).all()
    assert doubled[0, 0, 2] == 255
    gray = sensor.develop(light, sensor_of(tmp_path, color="gray", bit_depth=16), None)
    luminance = light.astype(np.float64) @ [0.2126, 0.7152, 0.0722]
    expected = round(65535 * sensor.encoded(luminance).item())
    assert gray.shape == (1, 1) and gray[0, 0] == expected


def test_the_logarithm_of_the_gain_drifts_from_the_first_frame_on(
    tmp_path: Path,
) -> None:
    light = np.array([[[0.1, 0.2, 0.3]]], dtype=np.float32)
    drift = [0.5, 0.0, -1.0]
    drifting = sensor_of(tmp_path, gain=1.5, gain_drift_per_s=drift, bit_depth=16)
    assert not sensor.is_plain(sensor_of(tmp_path, gain_drift_per_s=drift))
    for since_s in (0.0, 0.4, -0.1):
        expected = sensor.encoded(1.5 * np.exp(np.array(drift) * since_s) * light)
        found = sensor.develop(light, drifting, None, since_s) / 65535
        assert found == pytest.approx(expected, abs=1e-5)
    steady = sensor_of(tmp_path, gain=1.5, bit_depth=16)
    first = sensor.develop(light, drifting, None)
    assert (first == sensor.develop(light, steady, None, 9.0)).all()
    # After any duration, the gains stay within the limits of a rig's gain.
    assert sensor.gains(drifting, 1e6) == pytest.approx([100.0, 1.5, 0.01])


@pytest.mark.parametrize(("engine", "samples"), [("cycles", 256), ("workbench", 32)])
def test_the_lens_is_distorted_as_told(
    tmp_path: Path, engine: str, samples: int
) -> None:
    """Discs all over the image are at the positions of COLMAP's model to 0.05 px, far from those without distortion."""
    pytest.importorskip("bpy")
    scene = filming.black_scene()
    bent = {"k1": -0.3, "k2": 0.1, "p1": 0.005, "p2": -0.004}
    camera_entry = {
        **CORPUS["rig"]["cameras"][0],
        "width": 160,
        "height": 120,
        "shift_x": 0.02,
        "distortion": bent,
    }
    rig_file = tmp_path / "bent.json"
    rig_file.write_text(json.dumps({**CORPUS["rig"], "cameras": [camera_entry]}))
    places = [
        (x, y, -1.0) for x in np.linspace(-0.5, 0.5, 7) for y in (-0.3, -0.1, 0.1, 0.3)
    ]
    for place in places:
        filming.add_disc(place, 0.02, 0.5)
    wanted = filming.options(
        rig_file, samples=samples, frames=1, size_px=None, engine=engine
    )
    filming.film(scene, wanted, tmp_path / "capture")
    (entry,) = json.loads((tmp_path / "capture" / "capture.json").read_text())[
        "cameras"
    ]
    assert entry["model"] == "OPENCV" and entry["params"][4:] == list(bent.values())
    light = filming.read_light(tmp_path / "capture" / "a" / "0000.png")
    straight = {**entry, "model": "PINHOLE", "params": entry["params"][:4]}
    off, moved_px = [], []
    for place in places:
        expected = filming.disc_centroid(entry, np.array(place), 0.02)
        if not (8 < expected[0] < 152 and 8 < expected[1] < 112):
            continue
        off_px = filming.centroid(light, expected, 7.0) - expected
        off.append(np.abs(off_px).max())
        moved_px.append(
            np.linalg.norm(
                filming.disc_centroid(straight, np.array(place), 0.02) - expected
            )
        )
    print(f"{engine}: {max(off):.4f} px at most, {np.median(off):.4f} px in the median")
    assert max(off) < 0.05
    assert len(off) >= 24 and max(moved_px) > 5.0


@pytest.mark.parametrize("engine", ["cycles", "workbench"])
def test_a_sensor_without_faults_records_blenders_picture(
    tmp_path: Path, engine: str
) -> None:
    """Blender's 8-bit image and our 16-bit image, in colour and grey, differ by at most one 8-bit level."""
    pytest.importorskip("bpy")
    scene = filming.scenes.open_scene("magazine", None)
    base = {**CORPUS["rig"]["cameras"][0], "width": 80, "height": 60}
    cameras = [
        {**base, "id": f"{color}{depth}", "color": color, "bit_depth": depth}
        for color in ("rgb", "gray")
        for depth in (8, 16)
    ]
    content = {**CORPUS["rig"], "reference": "rgb8", "cameras": cameras}
    rig_file = tmp_path / "rig.json"
    rig_file.write_text(json.dumps(content))
    loaded_rig = rig.load(rig_file)
    studios = importlib.import_module("stlfr_extension.film")
    studio = studios.Studio(scene, loaded_rig.cameras, 2, engine)
    import cv2

    pictures = {}
    for view in loaded_rig.cameras:
        image = studios.Image(view.id, 0.05, 4, 77)
        studio.render_image(image, tmp_path / f"{view.id}.png", tmp_path)
        picture = cv2.imread(str(tmp_path / f"{view.id}.png"), cv2.IMREAD_UNCHANGED)
        assert picture.dtype == (np.uint8 if view.bit_depth == 8 else np.uint16)
        assert picture.ndim == (3 if view.color == "rgb" else 2)
        pictures[view.id] = picture / (2.0**view.bit_depth - 1)
    for color in ("rgb", "gray"):
        difference = pictures[f"{color}8"] - pictures[f"{color}16"]
        assert np.abs(difference).max() < 1.01 / 255
    assert pictures["rgb16"].std() > 0.1
