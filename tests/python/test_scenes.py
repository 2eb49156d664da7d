"""The scenes: each can be filmed with the rig linear8, has the motion that it states, and is deterministic."""

from __future__ import annotations

import importlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from filming import ROOT, rig, scenes

WIDTH_PX, HEIGHT_PX = 80, 60

# The range of the 90th percentile of moving pixels' motion, pixels per frame at 640x480, at the instants below.
SPEEDS_PX = {
    "along": (14, 22),
    "ball": (10, 26),
    "book": (8, 36),
    "bounce": (15, 40),
    "dance": (14, 34),
    "fast": (36, 52),
    "hand": (8, 26),
    "head": (6, 20),
    "magazine": (8, 26),
    "mirror": (5, 20),
    "rush": (60, 125),
    "spin": (25, 45),
    "still": (0.1, 0.8),
    "swing": (20, 55),
    "template": (5, 18),
    "textureless": (6, 20),
    "thin": (6, 32),
    "tumble": (18, 42),
    "turning": (10, 20),
    "wave": (15, 45),
}
INSTANTS_S = (0.1, 0.3)


def studio_of(name: str) -> Any:
    """A scene with the cameras of the rig linear8, at a tiny image size."""
    pytest.importorskip("bpy")
    film = importlib.import_module("stlfr_extension.film")
    whole = rig.load(ROOT / "rigs" / "linear8.json")
    tiny = rig.resized(whole, WIDTH_PX, HEIGHT_PX)
    return film.Studio(scenes.open_scene(name, None), (*tiny.cameras, *tiny.views), 2)


def picture(studio: Any, view_id: str, time_s: float, folder: Path) -> Any:
    """Render a view at a time; returns the image (H, W, 3) in BGR."""
    cv2 = pytest.importorskip("cv2")
    film = importlib.import_module("stlfr_extension.film")
    target = folder / "picture.png"
    studio.render_image(film.Image(view_id, time_s, 4, 1), target, folder)
    return np.asarray(cv2.imread(str(target)), dtype=np.float64)


def motion(
    studio: Any, view_id: str, time_s: float, folder: Path
) -> tuple[np.ndarray[Any, Any], np.ndarray[Any, Any]]:
    """Render a view's depth in metres, and its motion in pixels per frame at 640x480."""
    film = importlib.import_module("stlfr_extension.film")
    files = folder / "depth.npy", folder / "motion.npy"
    image = film.Image(view_id, time_s, 1, 1)
    studio.render_geometry(image, *files, folder, 30.0)
    return np.load(files[0]), np.load(files[1]) * 640 / WIDTH_PX


def test_every_scene_is_known_here() -> None:
    assert set(scenes.names()) == set(SPEEDS_PX)


def test_a_scene_tunes_parameters_or_judges_them_and_never_both() -> None:
    pytest.importorskip("bpy")
    scenes.load("template")
    split = importlib.import_module(scenes.PACKAGE)
    listed = [*split.TUNED_ON, *split.JUDGED_ON]
    assert sorted([*listed, "mirror", "template"]) == scenes.names()


def test_what_a_scene_imports_from_another_counts_as_its_source() -> None:
    stems = [file.stem for file in scenes.sources("tumble")]
    assert stems == [*scenes.HELPERS, "tumble", "bounce"]


@pytest.mark.parametrize("name", sorted(SPEEDS_PX))
def test_a_scene_films_and_moves_as_it_should(name: str, tmp_path: Path) -> None:
    studio = studio_of(name)
    geometry = [motion(studio, "cam3", time_s, tmp_path) for time_s in INSTANTS_S]
    first, later = (
        picture(studio, camera_id, time_s, tmp_path)
        for camera_id, time_s in zip(("cam0", "cam7"), INSTANTS_S, strict=True)
    )
    for shown in (first, later):
        assert shown.std() > 12
        # Almost no pixel is overexposed. With so few samples, gaps between books are black.
        assert (shown.min(axis=2) >= 255).mean() < 0.05
        assert (shown.max(axis=2) <= 2).mean() < 0.12
    depth, speed = (np.array([entry[k] for entry in geometry]) for k in (0, 1))
    assert np.isfinite(depth).all()  # the wall covers the whole image
    assert depth.max() > 1.2 * depth.min() and depth.min() > 0.5
    moving = speed[speed > 0.05]
    assert 0.005 < moving.size / speed.size < 0.5
    slowest, fastest = SPEEDS_PX[name]
    assert slowest < np.percentile(moving, 90) < fastest


def displacement(name: str, from_s: float, to_s: float) -> np.ndarray[Any, Any]:
    """The displacements of the bodies' vertices between two instants, metres."""
    bpy = pytest.importorskip("bpy")
    scene = scenes.open_scene(name, None)

    def places(time_s: float) -> np.ndarray[Any, Any]:
        frame, subframe = scenes.frame_at(scene, time_s)
        scene.frame_set(frame, subframe=subframe)
        meshes = [o for o in bpy.data.objects if o.type == "MESH"]
        return np.array(
            [o.matrix_world @ v.co for o in meshes for v in o.data.vertices[:8]]
        )

    start = places(from_s)
    return np.asarray(places(to_s) - start)


def test_sideways_motion_is_along_the_epipolar_lines() -> None:
    """In the scene `along`, no vertex changes its height or its depth."""
    moved = displacement("along", 0.12, 0.31)
    assert np.abs(moved[:, 1:]).max() == 0.0
    assert np.abs(moved[:, 0]).max() > 0.05


def test_turning_motion_is_along_the_epipolar_lines_at_one_instant() -> None:
    """In the scene `turning`, all motion is sideways at 0.26 s, by 16 pixels per frame, but not before or after."""
    before, at_top, after = (
        displacement("turning", time_s - 1 / 60, time_s + 1 / 60)
        for time_s in (0.16, 0.26, 0.36)
    )
    assert np.abs(at_top[:, 1:]).max() < 1e-4
    assert np.abs(at_top[:, 0]).max() > 0.035
    for moved in (before, after):
        assert np.abs(moved[:, 2]).max() > 0.01


@pytest.mark.parametrize("name", ["head", "thin"])
def test_a_scene_is_the_same_every_time(name: str, tmp_path: Path) -> None:
    first, again = (picture(studio_of(name), "cam3", 0.2, tmp_path) for _ in range(2))
    assert (first == again).all()
