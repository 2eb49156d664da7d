"""The live viewport without a window: its camera, the picture's place, and that the latest request is rendered."""

from __future__ import annotations

import importlib
import math
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from filming import camera as cameras
from filming import described, errors

fields = importlib.import_module("stlfr_extension.fields")
live = importlib.import_module("stlfr_extension.live")
view = importlib.import_module("stlfr_extension.view")
viewpoint = importlib.import_module("stlfr_extension.viewpoint")

RANDOM = np.random.default_rng(3)


def window_matrix(focal: float, aspect: float, shift: tuple[float, float]) -> Any:
    """A window matrix as Blender's for a perspective view, from view coordinates to clip coordinates."""
    matrix = np.zeros((4, 4))
    matrix[0, 0], matrix[1, 1] = focal, focal * aspect
    matrix[0, 2], matrix[1, 2] = shift
    matrix[2, 2], matrix[2, 3], matrix[3, 2] = -1.002, -0.2, -1.0
    return matrix


def view_matrix() -> Any:
    """A view matrix with an arbitrary position and orientation."""
    rotation = cameras.rotation_from_quaternion(tuple(RANDOM.normal(size=4)))
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = rotation, RANDOM.normal(size=3)
    return matrix


def test_a_views_camera_projects_as_its_matrices_do() -> None:
    """Points in front of the viewer are projected to the same pixels as by Blender's matrices."""
    size = (900, 500)
    for _ in range(20):
        seen_from = view_matrix()
        window = window_matrix(2.1, 1.8, tuple(RANDOM.normal(scale=0.2, size=2)))
        camera = viewpoint.camera_of_view(seen_from, window, size)
        before = np.c_[RANDOM.normal(size=(30, 2)), -RANDOM.uniform(1, 5, 30)]
        points = (np.linalg.inv(seen_from) @ np.c_[before, np.ones(30)].T).T
        clip = points @ (window @ seen_from).T
        device = clip[:, :2] / clip[:, 3:]
        expected = 0.5 * (1 + device * [1, -1]) * size
        found = described.project(camera, points[:, :3])
        np.testing.assert_allclose(found, expected, atol=1e-6)


def test_orthographic_views_are_refused_in_words() -> None:
    window = np.diag([0.1, 0.2, -0.01, 1.0])
    with pytest.raises(errors.BadInputError, match="no orthographic views"):
        viewpoint.camera_of_view(np.eye(4), window, (640, 480))


def test_a_cameras_frame_lies_where_its_corners_are_projected() -> None:
    seen_from, window = view_matrix(), window_matrix(2.0, 1.5, (0.1, -0.05))
    corners = np.array([[x, y, -2.0, 1.0] for x in (-0.3, 0.5) for y in (-0.2, 0.4)])
    world = (np.linalg.inv(seen_from) @ corners.T).T[:, :3]
    rect = viewpoint.frame_rect(window @ seen_from, world, (1000, 800))
    # x: 2 x / 2 - 0.1 in clip coordinates; y: 3 y / 2 + 0.05.
    assert rect.x == pytest.approx(500 * (1 - 0.3 - 0.1))
    assert rect.width == pytest.approx(500 * 0.8)
    assert rect.y == pytest.approx(400 * (1 - 0.3 + 0.05))
    assert rect.height == pytest.approx(400 * 0.9)


def test_a_picture_of_its_places_size_is_shown_pixel_by_pixel() -> None:
    place = viewpoint.Rect(10.3, 20.7, 640.4, 479.8)
    assert place.snapped(640, 480) == viewpoint.Rect(10, 21, 640, 480)
    assert place.snapped(320, 240) == place
    part = viewpoint.Rect(100.0, 50.0, 200.0, 100.0).part((0.25, 0.75, 0.5, 1.0))
    assert part == viewpoint.Rect(150.0, 100.0, 100.0, 50.0)


def test_a_cameras_picture_is_f12s_unless_it_is_far_larger() -> None:
    camera = {"width": 1920, "height": 1080, "params": [2000.0, 2000.0, 960.0, 540.0]}
    rect = viewpoint.Rect(0, 0, 1000.0, 562.5)
    assert viewpoint.factor_for(camera, rect) == 1.0
    small = viewpoint.Rect(0, 0, 480.0, 270.0)
    assert viewpoint.factor_for(camera, small) == 0.25
    scaled = viewpoint.scaled(camera, 0.25)
    assert (scaled["width"], scaled["height"]) == (480, 270)
    assert scaled["params"] == [500.0, 500.0, 240.0, 135.0]
    assert viewpoint.scaled(camera, 1.0) is camera
    assert viewpoint.scaled(camera, 1e-9)["height"] == viewpoint.MIN_SIDE_PX


class Module:
    """A fake of the module `stlfr`, which records requests, and waits where the test wants it to."""

    def __init__(self) -> None:
        self.asked: list[tuple[str, float, dict[str, Any]]] = []
        self.go_on = threading.Event()
        self.go_on.set()
        self.stopped = 0
        self.error: Exception | None = None
        self.is_prepared = False
        self.loading_s = 0.0

    def render(self, request: Any, proceed: Callable[[int, int], bool]) -> Any:
        self.asked.append(("render", request.time_s, request.options))
        self.go_on.wait(10)
        if self.error is not None:
            raise self.error
        if not proceed(0, 1):
            self.stopped += 1
            raise fields.StoppedError
        return np.full(
            (request.camera["height"], request.camera["width"], 3),
            int(request.time_s),
            np.uint8,
        )

    def load_preview(self, request: Any) -> bool:
        time.sleep(self.loading_s)
        return self.is_prepared

    def preview(self, request: Any) -> Any:
        self.asked.append(("preview", request.time_s, request.options))
        return np.zeros((16, 16, 3), np.uint8)

    def moment(self, request: Any) -> float:
        self.asked.append(("moment", request.time_s, request.options))
        return float(request.time_s)

    def seen(self, at: float, request: Any) -> Any:
        assert at == request.time_s
        self.asked.append(("seen", request.time_s, request.options))
        return np.zeros((16, 16, 3), np.uint8)


@pytest.fixture
def module(monkeypatch: pytest.MonkeyPatch) -> Module:
    fake = Module()
    for name in ("render", "load_preview", "preview", "moment", "seen"):
        monkeypatch.setattr(fields, name, getattr(fake, name))
    return fake


@pytest.fixture
def viewer(module: Module) -> Iterator[Any]:
    one = live.Live()
    yield one
    module.go_on.set()
    one.close(5.0)


CHOSEN = {"preset": "best"}


def request(time_s: float, x_px: float = 8.0, written: int = 1) -> Any:
    camera = {
        "width": 16,
        "height": 16,
        "model": "PINHOLE",
        "params": [10.0, 10.0, x_px, 8.0],
    }
    return view.Request(Path("film"), time_s, camera, CHOSEN, ((written, 9),))


def until(is_done: Callable[[], bool]) -> None:
    end_s = time.monotonic() + 5
    while not is_done():
        assert time.monotonic() < end_s, "it takes too long"
        time.sleep(0.005)


def test_at_once_by_the_fast_method_then_by_the_chosen_one(
    viewer: Any, module: Module
) -> None:
    assert viewer.want(request(1.0)) and not viewer.want(request(1.0))
    until(lambda: not viewer.is_busy)
    assert module.asked == [("render", 1.0, live.FAST), ("render", 1.0, CHOSEN)]
    assert viewer.picture.is_final and viewer.take_news() and not viewer.take_news()
    assert viewer.counts.fast == viewer.counts.final == 1


def test_the_latest_wish_wins(viewer: Any, module: Module) -> None:
    """Of several requests during the rendering of a fast picture, only the last one is rendered next.

    The fast picture itself is shown, because it is the latest one.
    """
    module.go_on.clear()
    viewer.want(request(1.0))
    until(lambda: len(module.asked) == 1)
    for time_s in range(2, 10):
        viewer.want(request(float(time_s)))
    module.go_on.set()
    until(lambda: not viewer.is_busy)
    assert module.stopped == 0 and viewer.counts.fast == 2
    assert [time_s for _, time_s, _ in module.asked] == [1.0, 9.0, 9.0]
    assert viewer.picture.request.time_s == 9.0 and viewer.picture.is_final


def test_pictures_come_while_changes_come_faster(viewer: Any, module: Module) -> None:
    """Pictures are shown although the request changes during the rendering of each one, as when the user scrubs."""
    for time_s in range(1, 40):
        viewer.want(request(float(time_s)))
        time.sleep(0.01)
    assert viewer.counts.fast > 5 and viewer.counts.final == 0
    assert viewer.picture is not None and not viewer.picture.is_final


def test_a_full_picture_is_given_up_when_something_changes(
    viewer: Any, module: Module
) -> None:
    viewer.want(request(1.0))
    until(lambda: viewer.picture is not None)
    module.go_on.clear()
    until(lambda: ("render", 1.0, CHOSEN) in module.asked)
    viewer.want(request(2.0))
    module.go_on.set()
    until(lambda: not viewer.is_busy)
    assert module.stopped == 1 and viewer.picture.request.time_s == 2.0


def test_views_of_one_instant_share_their_work(viewer: Any, module: Module) -> None:
    for x_px in (7.0, 8.0, 9.0):
        viewer.want(request(1.0, x_px))
        until(lambda: not viewer.is_busy)
    kinds = [kind for kind, _, options in module.asked if options == live.FAST]
    assert kinds == ["render", "moment", "seen", "seen"]


def test_scene_flow_is_shown_in_motion_once_it_is_there(
    viewer: Any, module: Module
) -> None:
    viewer.want(request(1.0))
    until(lambda: not viewer.is_busy)
    module.is_prepared = True
    viewer.want(request(2.0))
    until(lambda: not viewer.is_busy)
    assert module.asked == [
        ("render", 1.0, live.FAST),
        ("render", 1.0, CHOSEN),
        ("preview", 2.0, CHOSEN),
        ("render", 2.0, CHOSEN),
    ]
    assert viewer.counts.fast == viewer.counts.final == 2


def test_loading_does_not_lower_the_resolution(viewer: Any, module: Module) -> None:
    module.is_prepared, module.loading_s = True, 1.5 * live.SLOW_S
    viewer.want(request(1.0))
    until(lambda: not viewer.is_busy)
    assert viewer.counts.fast == 1
    assert viewer._preview_pace.factor == 1.0


def test_a_capture_that_is_written_anew_is_shown_anew(
    viewer: Any, module: Module
) -> None:
    """After filming again or new offsets, neither the old picture nor cached results of the instant are used."""
    for x_px in (7.0, 8.0):
        viewer.want(request(1.0, x_px))
        until(lambda: not viewer.is_busy)
    assert not viewer.want(request(1.0, 8.0))
    assert viewer.want(request(1.0, 8.0, written=2))
    until(lambda: not viewer.is_busy)
    viewer.want(request(1.0, 9.0, written=2))
    until(lambda: not viewer.is_busy)
    kinds = [kind for kind, _, options in module.asked if options == live.FAST]
    assert kinds == ["render", "moment", "seen", "render", "moment", "seen"]


def test_the_stamp_changes_with_the_files(tmp_path: Path) -> None:
    stamps = {fields.stamp_of(tmp_path)}
    for name in ("capture.json", "offsets.json"):
        for text in ("{}", "{ }"):
            (tmp_path / name).write_text(text)
            stamps.add(fields.stamp_of(tmp_path))
    assert len(stamps) == 5


def test_an_error_is_said_and_the_old_picture_dropped(
    viewer: Any, module: Module
) -> None:
    viewer.want(request(1.0))
    until(lambda: not viewer.is_busy)
    module.error = errors.BadInputError("no camera has frames around 5 s")
    viewer.want(request(5.0))
    until(lambda: viewer.error is not None)
    assert viewer.picture is None and viewer.error == "no camera has frames around 5 s"
    module.error = None
    viewer.want(request(2.0))
    until(lambda: viewer.picture is not None)
    assert viewer.error is None
    viewer.refuse()
    assert viewer.picture is None and not viewer.is_busy


def test_a_panic_of_the_module_is_a_sentence(viewer: Any, module: Module) -> None:
    module.error = ZeroDivisionError("mine")
    viewer.want(request(1.0))
    until(lambda: viewer.error is not None)
    assert viewer.error == "rendering failed: mine (ZeroDivisionError)"


def test_closed_it_ends_its_thread_and_shows_nothing(
    viewer: Any, module: Module
) -> None:
    viewer.want(request(1.0))
    until(lambda: viewer.picture is not None)
    viewer.close(5.0)
    assert viewer.is_closed and viewer.picture is None and not viewer.is_busy
    assert not any(t.name == "stlfr viewport" for t in threading.enumerate())
    assert not viewer.want(request(2.0))


def test_the_resolution_follows_what_pictures_take() -> None:
    pace = live.Pace()
    for _ in range(20):
        pace.took(1.0)
    assert pace.factor == live.SMALLEST
    pace.took(0.5 * (live.SLOW_S + live.QUICK_S))
    assert pace.factor == live.SMALLEST
    for _ in range(20):
        pace.took(0.001)
    assert pace.factor == 1.0


def test_pictures_a_second_are_of_the_last_ones() -> None:
    counts = live.Counts()
    assert counts.rate_hz == 0.0
    for k in range(50):
        counts.ready(100.0 + 0.05 * k)
    assert counts.rate_hz == pytest.approx(20.0) and counts.fast == 50
    counts.ready(200.0)
    assert counts.rate_hz == 0.0 and math.isfinite(counts.rate_hz)
