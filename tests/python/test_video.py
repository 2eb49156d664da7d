"""Filming into lossless videos."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import cv2
import imageio_ffmpeg
import numpy as np
import pytest

ROOT = Path(__file__).resolve().parents[2]
FRAMES = 3


def film(rig: Path, folder: Path, *more: str) -> list[dict[str, Any]]:
    """What the filming script reports."""
    options = ["--scene", "magazine", "--frames", str(FRAMES), "--samples", "1"]
    options += ["--no-truth", "--workers", "1", *more]
    script = str(ROOT / "blender/capture.py")
    command = [sys.executable, "-I", script, str(rig), "-o", str(folder), *options]
    done = subprocess.run(
        command, capture_output=True, text=True, check=True, timeout=240
    )
    return [json.loads(line) for line in done.stdout.splitlines()]


def camera(camera_id: str, delay_s: float, color: str) -> dict[str, Any]:
    return {
        "id": camera_id,
        "width": 64,
        "height": 48,
        "lens_mm": 36.0,
        "sensor_width_mm": 36.0,
        "cam_from_rig": {"rotation_wxyz": [1, 0, 0, 0], "translation": [0, 0, 0]},
        "rate_hz": 30.0,
        "delay_s": delay_s,
        "jitter_s": 0.0,
        "color": color,
    }


@pytest.fixture(scope="module")
def rig(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A colour camera and a grey one."""
    path = tmp_path_factory.mktemp("rig") / "two.json"
    content = {
        "format": "stlfr-rig",
        "version": 1,
        "name": "two",
        "seed": 3,
        "reference": "a",
        "cameras": [camera("a", 0.0, "rgb"), camera("b", 0.01, "gray")],
    }
    path.write_text(json.dumps(content))
    return path


@pytest.fixture(scope="module")
def images(rig: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The film as images."""
    folder = tmp_path_factory.mktemp("film") / "images"
    film(rig, folder)
    return folder


def decoded(video: Path) -> np.ndarray[Any, Any]:
    """All frames, blue first as OpenCV has them."""
    command = [imageio_ffmpeg.get_ffmpeg_exe(), "-v", "error", "-i", str(video)]
    command += ["-f", "rawvideo", "-pix_fmt", "bgr24", "-"]
    raw = subprocess.run(command, capture_output=True, check=True).stdout
    return np.frombuffer(raw, np.uint8).reshape(-1, 48, 64, 3)


def assert_packed(images: Path, folder: Path) -> None:
    names = {path.name for path in folder.iterdir()}
    assert names == {".film", "a.mkv", "b.mkv", "capture.json", "colmap"}
    described = json.loads((folder / "capture.json").read_text())["cameras"]
    assert [camera["frames"] for camera in described] == ["a.mkv", "b.mkv"]
    for camera_id in ("a", "b"):
        frames = [
            cv2.imread(str(images / camera_id / f"{k:04d}.png")) for k in range(FRAMES)
        ]
        assert np.array_equal(decoded(folder / f"{camera_id}.mkv"), np.stack(frames))


def test_videos_hold_the_very_pixels_of_the_images(
    rig: Path, images: Path, tmp_path: Path
) -> None:
    folder = tmp_path / "film"
    shutil.copytree(images, folder)
    reports = film(rig, folder, "--video")
    assert reports[0]["done"] == 2 * FRAMES, "nothing is filmed again"
    assert reports[-1]["done"] == reports[-1]["total"] == 2 * FRAMES + 2
    assert_packed(images, folder)
    for again in (film(rig, folder, "--video"), film(rig, folder)):
        assert [report["what"] for report in again] == ["already filmed"]
    assert_packed(images, folder)


def test_packing_goes_on_where_it_was(rig: Path, images: Path, tmp_path: Path) -> None:
    folder = tmp_path / "film"
    shutil.copytree(images, folder)
    film(rig, folder, "--video")
    before = (folder / "a.mkv").read_bytes()
    # As if stopped after the first video had its name: an image is left over, `b` isn't packed,
    # and a half-written video of it lies in the scratch folder.
    (folder / "a").mkdir()
    shutil.copy(images / "a/0001.png", folder / "a/0001.png")
    (folder / "b.mkv").unlink()
    shutil.copytree(images / "b", folder / "b")
    (folder / "b/0002.png").unlink()
    (folder / ".film/partial").mkdir()
    (folder / ".film/partial/b.mkv").write_bytes(b"half")
    (folder / "capture.json").unlink()
    reports = film(rig, folder, "--video")
    assert reports[0]["done"] == 2 * FRAMES - 1, "one image is filmed"
    assert_packed(images, folder)
    assert (folder / "a.mkv").read_bytes() == before
