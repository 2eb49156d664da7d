"""Adding a comparison's scenes to a .blend file: all scenes are added, or none. Runs Blender in this process."""

from __future__ import annotations

import importlib
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import bpy
import cv2
import numpy as np
import pytest
from filming import errors

comparison = importlib.import_module("stlfr_extension.comparison")
reels = importlib.import_module("stlfr_extension.reels")

Change = Callable[[Any], object]


def layout() -> dict[str, Any]:
    """The content of a review.json with two reels, each with one still picture."""
    shot = {
        "label": "first",
        "frames": 24,
        "is_movie": False,
        "truth": "truth.png",
        "traditional": None,
        "space_time": {"title": "ST-LFR", "file": "ours.png"},
    }
    return {
        "format": "stlfr-review",
        "version": 1,
        "title": "t",
        "difference_gain": 4.0,
        "reels": [
            {"name": name, "rate_hz": 12.0, "shots": [dict(shot)]}
            for name in ("Views", "Cameras")
        ],
    }


@pytest.fixture
def file(tmp_path: Path) -> Path:
    """The path of a review.json with its pictures; an empty file is open in Blender."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    for name in ("truth", "ours"):
        cv2.imwrite(str(tmp_path / f"{name}.png"), np.zeros((12, 16, 3), np.uint8))
    (tmp_path / "broken.png").write_text("mine")
    (tmp_path / "review.json").write_text(json.dumps(layout()))
    return tmp_path / "review.json"


def names() -> list[str]:
    return [scene.name for scene in bpy.data.scenes]


def show(file: Path) -> list[str]:
    return [scene.name for scene in comparison.show(bpy.context, file)]


def test_scenes_take_the_place_and_the_names_of_those_before(file: Path) -> None:
    for _ in range(3):
        assert show(file) == ["Views", "Cameras"]
        assert names() == ["Cameras", "Scene", "Views"]


def test_the_users_copy_of_a_scene_stays(file: Path) -> None:
    """A renamed scene, a scene of another review, and the window's active scene remain too."""
    show(file)
    bpy.data.scenes["Views"].copy()
    bpy.data.scenes["Cameras"].name = "mine"
    assert show(file) == ["Views", "Cameras"]
    assert names() == ["Cameras", "mine", "Scene", "Views", "Views.001"]


def drop_picture(found: dict[str, Any]) -> None:
    found["reels"][1]["shots"][0]["truth"] = "none.png"


def no_picture(found: dict[str, Any]) -> None:
    found["reels"][1]["shots"][0]["truth"] = "broken.png"


def no_movie(found: dict[str, Any]) -> None:
    found["reels"][1]["shots"][0].update(truth="review.json", is_movie=True)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (drop_picture, "none.png: can't be read as a picture"),
        (no_picture, "broken.png: can't be read as a picture"),
        (no_movie, "review.json: can't be read as a picture"),
        (lambda found: found.pop("reels"), "has no reels"),
        (lambda found: found["reels"][1].pop("rate_hz"), "has no rate_hz"),
        (lambda found: found["reels"][1].update(rate_hz=0.0), "rate_hz is 0.0"),
        (lambda found: found["reels"][1].update(shots=[]), "shots is empty"),
        (lambda found: found["reels"][1].update(shots=[7]), "is no such layout"),
        (lambda found: found["reels"][1]["shots"][0].update(frames=0), "frames is 0"),
        (
            lambda found: found["reels"][1]["shots"][0].update(frames=1 << 40),
            "more than Blender's scenes",
        ),
        (
            lambda found: found["reels"][1]["shots"][0].update(truth="../a.png"),
            "leads out of the folder",
        ),
        (lambda found: found.update(reels=7), "is no such layout"),
        (lambda found: found.update(difference_gain=None), "is no such layout"),
    ],
)
def test_what_cant_be_shown_leaves_the_file_as_it_was(
    file: Path, change: Change, words: str
) -> None:
    show(file)
    shown = [scene.as_pointer() for scene in bpy.data.scenes]
    wrong = layout()
    change(wrong)
    file.write_text(json.dumps(wrong))
    with pytest.raises(errors.BadInputError, match=words):
        show(file)
    assert [scene.as_pointer() for scene in bpy.data.scenes] == shown
    assert names() == ["Cameras", "Scene", "Views"]
    assert not bpy.data.images and not bpy.data.movieclips


def test_a_review_that_was_cut_off_is_one_sentence(file: Path) -> None:
    show(file)
    text = file.read_text()
    for end in (len(text) // 2, 0):
        file.write_text(text[:end])
        with pytest.raises(errors.BadInputError, match=r"review.json: can't be read"):
            show(file)
    file.write_text("[]")
    with pytest.raises(errors.BadInputError, match="is no stlfr-review"):
        show(file)
    assert names() == ["Cameras", "Scene", "Views"]
