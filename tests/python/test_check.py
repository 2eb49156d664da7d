"""The calibration check: it accepts a correct capture, and reports the one camera that is wrong."""

from __future__ import annotations

import dataclasses
import importlib
import importlib.util
import json
import os
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from filming import ROOT, run_script

CHECK_SCRIPT = ROOT / "blender" / "check.py"

pycolmap = pytest.importorskip("pycolmap")
stlfr = pytest.importorskip("stlfr")
spec = importlib.util.spec_from_file_location("stlfr_check_script", CHECK_SCRIPT)
assert spec is not None and spec.loader is not None
spec.loader.exec_module(importlib.util.module_from_spec(spec))  # loads the packages

calibration = importlib.import_module("stlfr_calibration.capture")
model = importlib.import_module("stlfr_calibration.model")
frames = importlib.import_module("stlfr_calibration.frames")
mapping = importlib.import_module("stlfr_calibration.mapping")
residuals = importlib.import_module("stlfr_calibration.residuals")
report = importlib.import_module("stlfr_calibration.report")
conversion = importlib.import_module("stlfr_extension.described")

Array = np.ndarray[Any, Any]


def rotation_about(axis: int, angle_deg: float) -> Array:
    """The matrix of a rotation about one axis (0 to 2), in degrees."""
    vector = np.zeros(3)
    vector[axis] = np.radians(angle_deg)
    matrix: Array = pycolmap.Rotation3d(vector).matrix()
    return matrix


def line_of_poses(count: int) -> dict[str, Any]:
    """The poses of cameras 60 mm apart in a line, which all look along +z, by id."""
    return {
        f"cam{i}": calibration.Pose(np.eye(3), np.array([-0.06 * i, 0.0, 0.0]))
        for i in range(count)
    }


def seen_elsewhere(poses: dict[str, Any]) -> dict[str, Any]:
    """The same cameras' poses after a similarity of the world: rotated, moved, and 3 times as large."""
    world_turn = rotation_about(1, 40.0) @ rotation_about(0, -70.0)
    moved = {}
    for camera_id, pose in poses.items():
        rotation = pose.rotation @ world_turn
        centre = 3.0 * world_turn.T @ pose.centre_m + np.array([1.0, -2.0, 0.5])
        moved[camera_id] = calibration.EstimatedPose(
            rotation, -rotation @ centre, points=1000
        )
    return moved


def test_right_poses_have_no_residual_whatever_the_estimate_calls_its_world() -> None:
    exported = line_of_poses(8)
    for residual in residuals.residuals(exported, seen_elsewhere(exported)):
        assert residual.rotation_deg < 1e-6
        assert residual.position_mm < 1e-6


@pytest.mark.parametrize("camera_id", ["cam0", "cam3", "cam7"])
def test_a_turned_camera_is_named_and_no_other(camera_id: str) -> None:
    estimated = seen_elsewhere(line_of_poses(8))
    exported = line_of_poses(8)
    right = exported[camera_id]
    turned = rotation_about(1, 0.2) @ right.rotation
    exported[camera_id] = calibration.Pose(turned, -turned @ right.centre_m)
    found = {r.id: r for r in residuals.residuals(exported, estimated)}
    assert [r.id for r in found.values() if r.is_off] == [camera_id]
    assert found[camera_id].rotation_deg == pytest.approx(0.2, abs=1e-4)


@pytest.mark.parametrize("camera_id", ["cam0", "cam3", "cam7"])
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_moved_camera_is_named_and_no_other(camera_id: str, axis: int) -> None:
    estimated = seen_elsewhere(line_of_poses(8))
    exported = line_of_poses(8)
    centre = exported[camera_id].centre_m + 0.002 * np.eye(3)[axis]
    exported[camera_id] = calibration.Pose(np.eye(3), -centre)
    found = {r.id: r for r in residuals.residuals(exported, estimated)}
    assert [r.id for r in found.values() if r.is_off] == [camera_id]
    assert found[camera_id].position_mm == pytest.approx(2.0, abs=0.1)


def judged(std_errs: float, points: int, **more: Any) -> tuple[str, str]:
    """The check's verdict for two cameras; one is displaced by `std_errs` standard errors, each of 1 mm."""
    found = [
        residuals.Residual("cam0", 0.0, 0.1, 0.001, 0.1, 500),
        residuals.Residual("cam1", 0.0, std_errs, 0.001, 1.0, points),
    ]
    return report.judged(**{"off": [], "own": [], "found": found, "missing": []} | more)


def test_the_verdict_is_right_off_or_that_the_images_cannot_tell() -> None:
    assert judged(3.0, 500) == ("right", "to 0.05 deg and 5.0 mm")
    assert judged(178.0, 500)[0] == "off" and "cam1" in judged(178.0, 500)[1]
    for std_errs in (3.0, 178.0):
        verdict, reason = judged(std_errs, 40)
        assert verdict == "unknown" and "cam1 sees 40 points" in reason
    verdict, reason = judged(3.0, 500, missing=["cam2"])
    assert verdict == "unknown" and "can't place cam2" in reason
    verdict, reason = judged(3.0, 500, found=[], missing=["cam0", "cam1"])
    assert verdict == "unknown" and "any camera" in reason


def test_what_is_wrong_with_the_program_is_no_verdict_on_a_capture() -> None:
    verdict, reason = judged(178.0, 500, own=["Blender projects points 2 px elsewhere"])
    assert (
        verdict == "inconsistent" and reason == "Blender projects points 2 px elsewhere"
    )
    result = {"verdict": verdict, "reason": reason}
    assert report.closing(result).startswith("the program itself is inconsistent")
    assert judged(0.0, 500, off=["its COLMAP model"]) == ("off", "its COLMAP model")


def test_a_tiny_angle_is_measured_as_well_as_a_large_one() -> None:
    for angle_deg in (1e-6, 0.2, 90.0, 179.0):
        assert residuals.angle_deg(rotation_about(2, angle_deg)) == pytest.approx(
            angle_deg, rel=1e-6
        )


# Model


@pytest.mark.parametrize("name", model.MODELS)
def test_every_lens_model_projects_as_pycolmaps(name: str) -> None:
    camera = {"width": 640, "height": 480, "model": name, "params": model.MODELS[name]}
    camera["cam_from_world"] = model.POSE
    lens = calibration.lens_of(camera, pycolmap)
    pose = calibration.pose_of(camera, pycolmap)
    difference_px = model.difference_px(camera, lens, pose, stlfr.project)
    assert difference_px <= model.TOLERANCE_PX


def test_every_blender_camera_projects_as_blender_and_pycolmap_do() -> None:
    pytest.importorskip("bpy")
    found = model.blender_differences_px(stlfr.project, pycolmap, conversion)
    assert len(found) == 3 * 3 * 6
    for difference in found:
        assert difference.blender_px <= model.BLENDER_TOLERANCE_PX, difference
        assert difference.pycolmap_px <= model.TOLERANCE_PX, difference


def off_by_half_a_pixel(camera: Any, points: Array) -> Array:
    """A wrong projection that puts pixel centres at integers."""
    pixels: Array = stlfr.project(camera, points) - 0.5
    return pixels


def never_behind(camera: Any, points: Array) -> Array:
    """A wrong projection that gives pixels to points behind the camera."""
    return np.nan_to_num(stlfr.project(camera, points))


def without_distortion(camera: Any, points: Array) -> Array:
    """A wrong projection that ignores distortion."""
    pinhole = {**camera, "model": "PINHOLE", "params": camera["params"][:4]}
    pixels: Array = stlfr.project(pinhole, points)
    return pixels


@pytest.mark.parametrize(
    ("wrong", "expected"),
    [
        (off_by_half_a_pixel, pytest.approx(np.sqrt(0.5))),
        (never_behind, np.inf),
        (without_distortion, pytest.approx(22.0, abs=8.0)),
    ],
)
def test_another_convention_fails_the_model_check(wrong: Any, expected: Any) -> None:
    name = "OPENCV"
    camera = {"width": 640, "height": 480, "model": name, "params": model.MODELS[name]}
    camera["cam_from_world"] = model.POSE
    lens = calibration.lens_of(camera, pycolmap)
    pose = calibration.pose_of(camera, pycolmap)
    assert model.difference_px(camera, lens, pose, wrong) == expected


def test_a_wrong_sensor_fit_fails_the_check_against_blender(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The wrong conversion uses the sensor's height for portrait formats, as one may expect from the fit `AUTO`."""
    pytest.importorskip("bpy")
    cameras = importlib.import_module("stlfr_extension.camera")
    right = cameras.pinhole_from_lens

    def by_height(lens: Any) -> Any:
        if lens.sensor_fit == "AUTO" and lens.height_px > lens.width_px:
            lens = dataclasses.replace(lens, sensor_fit="VERTICAL")
        return right(lens)

    monkeypatch.setattr(cameras, "pinhole_from_lens", by_height)
    found = model.blender_differences_px(stlfr.project, pycolmap, conversion)
    off = {
        (d.camera.format, d.camera.fit)
        for d in found
        if d.blender_px > model.BLENDER_TOLERANCE_PX
    }
    assert off == {("portrait", "AUTO")}


def test_points_beyond_the_fold_have_no_pixel() -> None:
    camera = {"width": 640, "height": 480, "model": "SIMPLE_RADIAL"}
    camera |= {"params": [686.0, 320.0, 240.0, -0.5]}
    camera["cam_from_world"] = {
        "rotation_wxyz": [1, 0, 0, 0],
        "translation": [0, 0, 0],
    }
    pixels = stlfr.project(camera, np.array([[0.8, 0.0, 1.0], [0.9, 0.0, 1.0]]))
    assert np.isfinite(pixels[0]).all() and np.isnan(pixels[1]).all()


@pytest.mark.parametrize("name", ["points3D.bin", "rigs.bin", "frames.txt"])
def test_a_pipe_in_the_exported_model_is_refused(tmp_path: Path, name: str) -> None:
    (tmp_path / "colmap").mkdir()
    os.mkfifo(tmp_path / "colmap" / name)
    with pytest.raises(calibration.CheckError, match="is no regular file"):
        calibration.exported_model(tmp_path, [], pycolmap)


def test_the_exported_colmap_model_is_the_captures(capture_dir: Path) -> None:
    cameras = json.loads((capture_dir / "capture.json").read_text())["cameras"]
    exported = calibration.exported_model(capture_dir, cameras, pycolmap)
    assert set(exported) == {c["id"] for c in cameras}
    for camera in cameras:
        lens, pose = exported[camera["id"]]
        assert lens.model.name == camera["model"]
        assert lens.params.tolist() == camera["params"]
        assert (lens.width, lens.height) == (camera["width"], camera["height"])
        right = calibration.pose_of(camera, pycolmap)
        np.testing.assert_allclose(pose.rotation, right.rotation, rtol=0, atol=1e-12)
        np.testing.assert_array_equal(pose.translation_m, right.translation_m)
        difference_px = model.difference_px(camera, lens, pose, stlfr.project)
        assert difference_px <= model.TOLERANCE_PX


@pytest.mark.parametrize(
    "lens_error",
    [
        (),
        (-0.21, 0.07, 1e-3, -2e-3),
        (-0.5, 0.0, 0.0, 0.0),
        (0.3, -0.4, 1e-3, -2e-3),
        (-1.4, 0.8, 0.0, 0.0),  # folds, and further out folds back
    ],
    ids=str,
)
def test_filming_projects_as_the_module(lens_error: tuple[float, ...]) -> None:
    """Checks points all around the camera, also behind it and beyond the radius where distortion folds back."""
    camera = {"width": 640, "height": 480, "cam_from_world": model.POSE}
    camera["model"] = "OPENCV" if lens_error else "PINHOLE"
    camera["params"] = [686.0, 680.0, 321.0, 239.0, *lens_error]
    points = np.random.default_rng(2).uniform(-4, 4, (2000, 3))
    ours, theirs = conversion.project(camera, points), stlfr.project(camera, points)
    np.testing.assert_allclose(ours, theirs, rtol=1e-12, atol=model.TOLERANCE_PX)
    assert 100 < np.isnan(ours[:, 0]).sum() < 1900


# Pixels


def test_pictures_come_from_truth_at_one_instant(capture_dir: Path) -> None:
    capture = stlfr.open(str(capture_dir))
    cameras = json.loads((capture_dir / "capture.json").read_text())["cameras"]
    pictures, source = frames.pictures_of_one_instant(
        capture_dir, capture, cameras, pycolmap
    )
    assert set(pictures) == {c["id"] for c in cameras}
    for camera in cameras:
        picture = pictures[camera["id"]]
        assert picture.still is None
        assert picture.pixels.shape == (camera["height"], camera["width"], 3)
    assert source.startswith("truth at ")


class Square:
    """A fake capture whose frames show a white square that moves to the right over a grey gradient."""

    def frame(self, _camera_id: str, index: int) -> Array:
        image = np.tile(np.linspace(40, 90, 160, dtype=np.uint8), (120, 1))
        image[50:60, 60 + 8 * index : 70 + 8 * index] = 255
        return image[:, :, None]


def test_without_truth_what_moves_is_masked() -> None:
    picture = frames.picture_at(Square(), "a", np.array([0.0, 0.1, 0.2]), 0.12)
    np.testing.assert_array_equal(picture.pixels, Square().frame("a", 1))
    assert not picture.still[50:60, 60:86].any()
    assert picture.still[:25].all() and picture.still[:, 110:].all()
    assert picture.still.mean() > 0.75


def test_at_a_captures_end_what_moves_is_masked_too() -> None:
    picture = frames.picture_at(Square(), "a", np.array([0.0, 0.1]), 0.3)
    np.testing.assert_array_equal(picture.pixels, Square().frame("a", 1))
    assert not picture.still[50:60, 60:78].any()
    assert frames.picture_at(Square(), "a", np.array([0.0]), 0.3).still is None


def test_frames_are_taken_at_one_instant_by_the_clocks(tmp_path: Path) -> None:
    """With cameras of 10 and 25 Hz, the middle is frame 2 of the first camera and frame 5 of the second."""

    class Two(Square):
        def times(self, camera_id: str) -> Array:
            return np.arange(5) / 10.0 if camera_id == "slow" else np.arange(11) / 25.0

    pictures, source = frames.pictures_of_one_instant(
        tmp_path, Two(), [{"id": "slow"}, {"id": "fast"}], pycolmap
    )
    for camera_id, index in (("slow", 2), ("fast", 5)):
        expected = Square().frame(camera_id, index)
        np.testing.assert_array_equal(pictures[camera_id].pixels, expected)
    assert source == "frames nearest to 0.2000 s, what moves masked"


def test_sixteen_bits_become_eight() -> None:
    deep = np.array([[[0], [257], [65535]]], dtype=np.uint16)
    assert frames.eight_bit(deep).ravel().tolist() == [0, 1, 255]


def placed(
    program: Path, folder: Path, rig_file: Path
) -> tuple[dict[str, Any], dict[str, Any]]:
    """Film with a rig; returns the exported poses, and the poses reconstructed from the images, by camera id."""
    pytest.importorskip("bpy")
    rig = json.loads(rig_file.read_text())
    for camera in rig["cameras"]:
        camera["delay_s"] = camera["jitter_s"] = 0.0
    (folder / "rig.json").write_text(json.dumps(rig))
    command: list[str | Path] = [program, "--quiet", "capture", folder / "rig.json"]
    command += ["--scene", "magazine", "--size", "320x240", "--frames", "1"]
    command += ["--no-truth", "-o", folder / "capture"]
    subprocess.run(command, cwd=ROOT, check=True)
    cameras = json.loads((folder / "capture/capture.json").read_text())["cameras"]
    pictures, _ = frames.pictures_of_one_instant(
        folder / "capture", stlfr.open(str(folder / "capture")), cameras, pycolmap
    )
    exported = {c["id"]: calibration.pose_of(c, pycolmap) for c in cameras}
    return exported, mapping.poses_from_pixels(pictures, cameras, pycolmap)


@pytest.fixture(scope="module")
def one_instant(
    program: Path, tmp_path_factory: pytest.TempPathFactory
) -> tuple[dict[str, Any], dict[str, Any]]:
    """The exported and the reconstructed poses of the rig `linear8`, from images of one instant."""
    folder = tmp_path_factory.mktemp("one-instant")
    return placed(program, folder, ROOT / "rigs/linear8.json")


def named(exported: Any, estimated: Any) -> list[str]:
    return [r.id for r in residuals.residuals(exported, estimated) if r.is_off]


def test_right_cameras_are_not_accused(one_instant: Any) -> None:
    exported, estimated = one_instant
    assert len(estimated) == len(exported) == 8
    assert named(exported, estimated) == []


def test_distorted_cameras_are_not_accused(program: Path, tmp_path: Path) -> None:
    exported, estimated = placed(program, tmp_path, ROOT / "rigs/distorted.json")
    assert len(estimated) == len(exported) == 8
    assert named(exported, estimated) == []


@pytest.mark.parametrize("camera_id", [f"cam{k}" for k in range(8)])
@pytest.mark.parametrize("sign", [-1, 1])
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_the_pixels_name_the_camera_that_is_turned_or_moved(
    one_instant: Any, camera_id: str, axis: int, sign: int
) -> None:
    """A camera rotated by 0.2 degrees about an axis, or moved by 2 mm along it, is the only one reported."""
    exported, estimated = one_instant
    right = exported[camera_id]
    turned = rotation_about(axis, sign * 0.2) @ right.rotation
    centre = right.centre_m + sign * 0.002 * np.eye(3)[axis]
    for wrong in (
        calibration.Pose(turned, -turned @ right.centre_m),
        calibration.Pose(right.rotation, -right.rotation @ centre),
    ):
        poses = {**exported, camera_id: wrong}
        assert named(poses, estimated) == [camera_id]


def test_a_box_mean_is_the_mean_over_the_window() -> None:
    image = np.random.default_rng(0).uniform(0, 1, (9, 12))
    mean = frames.box_mean(image, 3)
    assert mean.shape == image.shape
    assert mean[4, 5] == pytest.approx(image[3:6, 4:7].mean())
    assert mean[0, 0] == pytest.approx(np.pad(image, 1, mode="edge")[:3, :3].mean())


def test_a_folder_that_is_no_capture_is_refused_in_one_sentence(tmp_path: Path) -> None:
    result = run_script(CHECK_SCRIPT, tmp_path)
    assert result.returncode == 2
    assert "capture.json" in result.stderr
    assert result.stderr.count("\n") == 1
    assert result.stdout == ""
