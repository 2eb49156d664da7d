"""The calibration check: it agrees with a right capture, and names the one camera that is wrong."""

from __future__ import annotations

import importlib.util
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

ROOT = Path(__file__).resolve().parents[2]
CHECK_SCRIPT = ROOT / "blender" / "check.py"

pycolmap = pytest.importorskip("pycolmap")
spec = importlib.util.spec_from_file_location("stlfr_check_script", CHECK_SCRIPT)
assert spec is not None and spec.loader is not None
check = importlib.util.module_from_spec(spec)
sys.modules["stlfr_check_script"] = check
spec.loader.exec_module(check)


def rotation_about(axis: int, angle_deg: float) -> np.ndarray[Any, Any]:
    """A turn about one axis."""
    vector = np.zeros(3)
    vector[axis] = np.radians(angle_deg)
    matrix: np.ndarray[Any, Any] = pycolmap.Rotation3d(vector).matrix()
    return matrix


def line_of_poses(count: int) -> dict[str, Any]:
    """Cameras 60 mm apart in a line, all looking along +z."""
    return {
        f"cam{i}": check.Pose(np.eye(3), np.array([-0.06 * i, 0.0, 0.0]))
        for i in range(count)
    }


def seen_elsewhere(poses: dict[str, Any]) -> dict[str, Any]:
    """The same cameras in another world: turned, moved, and 3 times as large."""
    world_turn = rotation_about(1, 40.0) @ rotation_about(0, -70.0)
    moved = {}
    for camera_id, pose in poses.items():
        rotation = pose.rotation @ world_turn
        centre = 3.0 * world_turn.T @ pose.centre_m + np.array([1.0, -2.0, 0.5])
        moved[camera_id] = check.Pose(rotation, -rotation @ centre)
    return moved


def test_right_poses_have_no_residual_whatever_the_estimate_calls_its_world() -> None:
    exported = line_of_poses(8)
    for residual in check.residuals(exported, seen_elsewhere(exported)):
        assert residual.rotation_deg < 1e-6
        assert residual.position_mm < 1e-6


@pytest.mark.parametrize("camera_id", ["cam0", "cam3", "cam7"])
def test_a_turned_camera_is_named_and_no_other(camera_id: str) -> None:
    estimated = seen_elsewhere(line_of_poses(8))
    exported = line_of_poses(8)
    right = exported[camera_id]
    turned = rotation_about(1, 0.2) @ right.rotation
    exported[camera_id] = check.Pose(turned, -turned @ right.centre_m)
    found = {r.id: r for r in check.residuals(exported, estimated)}
    assert [r.id for r in found.values() if r.exceeds(0.05, 1.0)] == [camera_id]
    assert found[camera_id].rotation_deg == pytest.approx(0.2, abs=1e-4)


@pytest.mark.parametrize("camera_id", ["cam0", "cam3", "cam7"])
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_moved_camera_is_named_and_no_other(camera_id: str, axis: int) -> None:
    estimated = seen_elsewhere(line_of_poses(8))
    exported = line_of_poses(8)
    centre = exported[camera_id].centre_m + 0.002 * np.eye(3)[axis]
    exported[camera_id] = check.Pose(np.eye(3), -centre)
    found = {r.id: r for r in check.residuals(exported, estimated)}
    assert [r.id for r in found.values() if r.exceeds(0.05, 1.0)] == [camera_id]
    assert found[camera_id].position_mm == pytest.approx(2.0, abs=0.1)


def test_a_tiny_angle_is_measured_as_well_as_a_large_one() -> None:
    for angle_deg in (1e-6, 0.2, 90.0, 179.0):
        assert check.angle_deg(rotation_about(2, angle_deg)) == pytest.approx(
            angle_deg, rel=1e-6
        )


def pinhole_projector(folder: Path) -> Any:
    """The formula, from capture.json."""
    cameras = {
        c["id"]: c for c in json.loads((folder / "capture.json").read_text())["cameras"]
    }

    def project(
        camera_id: str, points_world_m: np.ndarray[Any, Any]
    ) -> np.ndarray[Any, Any]:
        camera = cameras[camera_id]
        pose = check.pose_of(camera, pycolmap)
        x, y, z = (points_world_m @ pose.rotation.T + pose.translation_m).T
        fx, fy, cx, cy = camera["params"]
        pixels: np.ndarray[Any, Any] = np.stack(
            [fx * x / z + cx, fy * y / z + cy], axis=1
        )
        pixels[z <= 0] = np.nan
        return pixels

    return project


def test_the_exported_colmap_model_projects_as_the_formula_does(
    capture_dir: Path,
) -> None:
    cameras = json.loads((capture_dir / "capture.json").read_text())["cameras"]
    difference_px = check.model_difference_px(
        capture_dir, cameras, pinhole_projector(capture_dir), pycolmap
    )
    assert difference_px <= check.MODEL_TOLERANCE_PX


@pytest.mark.parametrize("error", ["half a pixel", "never behind"])
def test_another_convention_fails_the_model_check(
    capture_dir: Path, error: str
) -> None:
    """A projector with pixel centres at whole numbers, or one that sees what is behind it."""
    cameras = json.loads((capture_dir / "capture.json").read_text())["cameras"]
    right = pinhole_projector(capture_dir)

    def wrong(
        camera_id: str, points_world_m: np.ndarray[Any, Any]
    ) -> np.ndarray[Any, Any]:
        pixels: np.ndarray[Any, Any] = right(camera_id, points_world_m)
        return pixels - 0.5 if error == "half a pixel" else np.nan_to_num(pixels)

    difference_px = check.model_difference_px(capture_dir, cameras, wrong, pycolmap)
    expected = np.sqrt(0.5) if error == "half a pixel" else np.inf
    assert difference_px == pytest.approx(expected)


def test_our_module_projects_as_pycolmap_does(capture_dir: Path) -> None:
    stlfr = pytest.importorskip("stlfr")
    cameras = json.loads((capture_dir / "capture.json").read_text())["cameras"]
    project = stlfr.open(str(capture_dir)).project
    difference_px = check.model_difference_px(capture_dir, cameras, project, pycolmap)
    assert difference_px <= check.MODEL_TOLERANCE_PX


def test_pictures_come_from_truth_at_one_instant(capture_dir: Path) -> None:
    if not (capture_dir / "truth" / "truth.json").is_file():
        pytest.skip("the shared capture has no truth")
    cameras = json.loads((capture_dir / "capture.json").read_text())["cameras"]
    pictures, source = check.pictures_of_one_instant(capture_dir, cameras, pycolmap)
    assert set(pictures) == {c["id"] for c in cameras}
    assert all(
        picture.path.is_file() and picture.still is None
        for picture in pictures.values()
    )
    assert source.startswith("truth at ")


def test_without_truth_what_moves_is_masked(tmp_path: Path) -> None:
    """Three frames of a grey gradient over which a white square moves to the right."""
    background = np.tile(np.linspace(40, 90, 160, dtype=np.uint8), (120, 1))
    for k in range(3):
        image = background.copy()
        image[50:60, 60 + 8 * k : 70 + 8 * k] = 255
        pycolmap.Bitmap.from_array(image).write(tmp_path / f"{k}.png")
    picture = check.middle_frame(tmp_path, {"id": "a", "frames": "%d.png"}, pycolmap)
    assert picture.path == tmp_path / "1.png"
    assert not picture.still[50:60, 60:86].any()
    assert picture.still[:25].all() and picture.still[:, 110:].all()
    assert picture.still.mean() > 0.75


def test_a_box_mean_is_the_mean_over_the_window() -> None:
    image = np.random.default_rng(0).uniform(0, 1, (9, 12))
    mean = check.box_mean(image, 3)
    assert mean.shape == image.shape
    assert mean[4, 5] == pytest.approx(image[3:6, 4:7].mean())
    assert mean[0, 0] == pytest.approx(np.pad(image, 1, mode="edge")[:3, :3].mean())


def test_a_folder_that_is_no_capture_is_refused_in_one_sentence(tmp_path: Path) -> None:
    pytest.importorskip("stlfr")
    result = subprocess.run(
        [sys.executable, "-I", str(CHECK_SCRIPT), str(tmp_path)],
        check=False,
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert result.returncode == 2
    assert "capture.json" in result.stderr
    assert result.stderr.count("\n") == 1
    assert result.stdout == ""
