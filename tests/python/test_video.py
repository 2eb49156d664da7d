"""Filming into lossless videos."""

from __future__ import annotations

import json
import shutil
import subprocess
from pathlib import Path
from typing import Any

import cv2
import imageio_ffmpeg
import numpy as np
import pytest
from filming import filmed_by_script, rig_camera, write_rig

FRAMES = 3


def film(rig: Path, folder: Path, *more: str) -> list[dict[str, Any]]:
    """Film into `folder` with the filming script; returns its progress reports."""
    options = ["--scene", "magazine", "--frames", str(FRAMES), "--samples", "1"]
    options += ["--no-truth", "--workers", "1", *more]
    return filmed_by_script(rig, "-o", folder, *options)


@pytest.fixture(scope="module")
def rig(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A rig file with a colour camera and a grey camera."""
    return write_rig(
        tmp_path_factory.mktemp("rig") / "two.json",
        rig_camera("a"),
        rig_camera("b", delay_s=0.01, color="gray"),
    )


@pytest.fixture(scope="module")
def images(rig: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A capture whose frames are images, for comparison."""
    folder = tmp_path_factory.mktemp("film") / "images"
    film(rig, folder)
    return folder


def decoded(video: Path) -> np.ndarray[Any, Any]:
    """All frames of a video, in OpenCV's channel order BGR."""
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
    # The state if filming is stopped after the first video was renamed: an image remains, camera `b` isn't packed,
    # and an incomplete video of it is in the temporary folder.
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
