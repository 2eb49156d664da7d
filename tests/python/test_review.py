"""review.blend: its scenes and strips, and that a rendered frame has exactly the pixels of the pictures."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
import pytest
from filming import ROOT, run_script

WIDTH, HEIGHT, SCALE = 160, 120, 3
GAIN = 4.0

LOOK = """
import bpy, json, sys
bpy.ops.wm.open_mainfile(filepath=sys.argv[1])
found = {"workspace": bpy.context.window_manager.windows[0].workspace.name, "scenes": {}}
for scene in bpy.data.scenes:
    render = scene.render
    render.filepath = f"{sys.argv[2]}/{scene.name}.png"
    render.image_settings.file_format, render.image_settings.color_mode = "PNG", "RGB"
    bpy.ops.render.render(write_still=True, scene=scene.name)
    found["scenes"][scene.name] = {
        "range": [scene.frame_start, scene.frame_end],
        "rate_hz": render.fps / render.fps_base,
        "size": [render.resolution_x, render.resolution_y],
        "view": scene.view_settings.view_transform,
        "markers": [[m.name, m.frame] for m in scene.timeline_markers],
        "strips": [[s.type, s.channel, s.frame_final_start, s.frame_final_end,
                    getattr(s, "filepath", getattr(s, "directory", ""))]
                   for s in scene.sequence_editor.strips_all],
        "text": [s.text for s in scene.sequence_editor.strips if s.type == "TEXT"],
    }
print("FOUND" + json.dumps(found))
"""


def panel(title: str, file: str) -> dict[str, str]:
    return {"title": title, "file": file}


def review(layout: Path) -> subprocess.CompletedProcess[str]:
    return run_script(ROOT / "blender/review.py", layout)


@pytest.fixture(scope="module")
def pictures(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A review's folder with two shots of noise pictures; one shot lacks traditional light field rendering."""
    folder = tmp_path_factory.mktemp("review")
    random = np.random.default_rng(1)
    for name in ("truth", "nearest", "ours"):
        noise = random.integers(0, 256, (HEIGHT, WIDTH, 3), dtype=np.uint8)
        cv2.imwrite(str(folder / f"{name}.png"), noise)
    shot: dict[str, Any] = {"frames": 24, "is_movie": False, "truth": "truth.png"}
    ours = panel("ST-LFR", "ours.png")
    shots = [
        {
            **shot,
            "label": "first",
            "traditional": panel("LFR", "nearest.png"),
            "space_time": ours,
        },
        {**shot, "label": "second", "traditional": None, "space_time": ours},
    ]
    layout = {
        "format": "stlfr-review",
        "version": 1,
        "title": "t",
        "difference_gain": GAIN,
        "reels": [{"name": "Views", "rate_hz": 12.0, "shots": shots}],
    }
    (folder / "review.json").write_text(json.dumps(layout))
    return folder


def test_strips_are_aligned_and_pixels_are_the_files(
    pictures: Path, tmp_path: Path
) -> None:
    done = review(pictures / "review.json")
    assert done.returncode == 0, done.stderr
    names = {path.name for path in pictures.iterdir()}
    pngs = {"truth.png", "nearest.png", "ours.png"}
    assert names == {"review.json", "review.blend", *pngs}
    look = subprocess.run(
        [sys.executable, "-I", "-c", LOOK, pictures / "review.blend", tmp_path],
        capture_output=True,
        text=True,
        check=True,
    )
    line = next(x for x in look.stdout.splitlines() if x.startswith("FOUND"))
    found = json.loads(line.removeprefix("FOUND"))
    assert found["workspace"] == "Video Editing"
    assert list(found["scenes"]) == ["Views"]
    scene = found["scenes"]["Views"]
    assert (scene["range"], scene["rate_hz"], scene["view"]) == (
        [1, 48],
        12,
        "Standard",
    )
    assert scene["markers"] == [["first", 1], ["second", 25]]
    images = [strip for strip in scene["strips"] if strip[0] == "IMAGE"]
    # Truth and our result appear twice, once in the difference. The other method is only in the first shot.
    assert sorted(strip[2] for strip in images) == [1] * 5 + [25] * 4
    assert all(end - start == 24 for _, _, start, end, _ in images)
    assert all(directory == "//" for *_, directory in images), "paths are relative"
    assert sum(strip[0] == "META" for strip in scene["strips"]) == 2
    assert any("first" in text for text in scene["text"])

    frame = cv2.imread(str(tmp_path / "Views.png"))
    assert frame is not None
    assert list(frame.shape[1::-1]) == scene["size"]
    truth, nearest, ours = (
        read(pictures / f"{name}.png") for name in ("truth", "nearest", "ours")
    )
    difference = np.minimum(255, GAIN * np.abs(truth - ours))
    for (column, row), expected in {
        (0, 0): truth,
        (1, 0): nearest,
        (0, 1): ours,
        (1, 1): difference,
    }.items():
        x, y = 8 + column * (WIDTH * SCALE + 8), 60 + row * (HEIGHT * SCALE + 28)
        large = np.kron(expected, np.ones((SCALE, SCALE, 1)))
        shown = frame[y : y + HEIGHT * SCALE, x : x + WIDTH * SCALE].astype(np.float64)
        assert np.abs(shown - large).max() <= 2, (column, row)


def test_six_at_once_write_whole_files(pictures: Path, tmp_path: Path) -> None:
    folder = tmp_path / "review"
    shutil.copytree(pictures, folder)
    target = folder / "review.blend"
    with ThreadPoolExecutor(6) as pool:
        runs = list(pool.map(review, 6 * [folder / "review.json"]))
    assert [run.returncode for run in runs] == 6 * [0]
    assert target.read_bytes()[:4] == b"\x28\xb5\x2f\xfd", "Zstandard's magic number"
    assert not list(folder.glob(".*")), "no partial file is left"


def read(path: Path) -> npt.NDArray[np.float64]:
    image = cv2.imread(str(path))
    assert image is not None
    return image.astype(np.float64)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("{}", "is no stlfr-review"),
        ("no json", "Expecting value"),
        (
            '{"format": "stlfr-review", "version": 1, "reels": [], "difference_gain": 1}',
            "reels is empty",
        ),
    ],
)
def test_what_is_no_review_is_one_sentence(
    tmp_path: Path, content: str, words: str
) -> None:
    layout = tmp_path / "review.json"
    layout.write_text(content)
    done = review(layout)
    assert done.returncode == 2
    assert words in done.stderr and len(done.stderr.strip().splitlines()) == 1
    assert not (tmp_path / "review.blend").exists()
