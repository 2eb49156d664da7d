"""The rigs of the folder `rigs`: exposure times measured in their pictures, and a run of the program on their films."""

from __future__ import annotations

import json
import subprocess
from pathlib import Path
from typing import Any

import filming
import numpy as np
import pytest
from filming import CORPUS, SHIPPED

# In pictures: where a moving disc is

VELOCITY_M_S = np.array([4.0, 2.0, 0.0])
CENTRAL_S = 0.09
"""World time at which the disc is in front of the rig's centre."""
DISTANCE_M = 1.8
RADIUS_M = 0.08


@pytest.fixture(scope="module")
def moving_disc() -> Any:
    """A scene with a disc in uniform motion to the right and up, about 7 px per frame at 80x60 and 30 Hz."""
    pytest.importorskip("bpy")
    scene = filming.black_scene()
    disc = filming.add_disc((0.0, 0.0, -DISTANCE_M), RADIUS_M, 0.5)
    for axis in (0, 1):
        driver = disc.driver_add("location", axis).driver
        driver.expression = f"{VELOCITY_M_S[axis]}*((frame-1)/30-{CENTRAL_S})"
    return scene


def time_errors_frames(capture: Path, zero_s: float) -> dict[str, list[float]]:
    """The errors of all exported frame times, measured by the disc's position, in frame intervals; by camera id."""
    content = json.loads((capture / "capture.json").read_text())
    truth = json.loads((capture / "truth" / "truth.json").read_text())
    errors_frames: dict[str, list[float]] = {}
    for entry, shutter in zip(content["cameras"], truth["shutter"], strict=True):
        assert entry["id"] == shutter["id"]

        def at(time_s: float, entry: dict[str, Any] = entry) -> Any:
            moved = VELOCITY_M_S * (time_s + zero_s - CENTRAL_S)
            return filming.disc_centroid(entry, moved - [0, 0, DISTANCE_M], RADIUS_M)

        frame_s = np.median(np.diff(shutter["times_s"]))
        for k, time_s in enumerate(shutter["times_s"]):
            expected, later = at(time_s), at(time_s + 1e-3)
            velocity_px_s = (later - expected) / 1e-3
            light = filming.read_light(capture / entry["id"] / f"{k:04d}.png")
            off_px = filming.centroid(light, expected, 12.0) - expected
            off_s = off_px @ velocity_px_s / (velocity_px_s @ velocity_px_s)
            errors_frames.setdefault(entry["id"], []).append(off_s / frame_s)
    return errors_frames


def reference_zero_s(filmed: Any) -> float:
    """World time at which the reference's clock shows 0, which isn't written in any file of the capture."""
    zero: float = next(
        s.zero_s for s in filmed.shutters if s.id == filmed.rig.reference
    )
    return zero


@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: path.stem)
def test_every_frame_was_taken_when_its_stamp_says(
    path: Path, moving_disc: Any, tmp_path: Path
) -> None:
    frames = 5 if path.stem == "lost-frames" else 3
    wanted = filming.options(path, samples=32, frames=frames)
    filmed = filming.film(moving_disc, wanted, tmp_path)
    found = time_errors_frames(tmp_path, reference_zero_s(filmed))
    assert len(found) == 8
    off_frames = np.abs(np.concatenate([*found.values()]))
    print(f"{path.stem}: {off_frames.max():.4f} frame at most of {off_frames.size}")
    assert off_frames.max() < 0.01
    if path.stem == "lost-frames":
        assert sum(len(s.lost_before) for s in filmed.shutters) >= 4


def test_hard_shutters_are_told_to_the_frame_too(
    moving_disc: Any, tmp_path: Path
) -> None:
    """Frame times are also exact for a rig with many imperfections.

    It has a clock with a drift of 1000 ppm, lost frames, long exposures, noise, gain, 16 bits, distortion, jitter
    without time stamps, and different image sizes.
    """
    rig_file = tmp_path / "hard.json"
    base = CORPUS["rig"]["cameras"][1]
    bent = {"k1": -0.3, "k2": 0.1, "p1": 0.005, "p2": -0.004}
    hidden = {"jitter_s": 0.002, "jitter_stamped": False}
    cameras = [
        {**CORPUS["rig"]["cameras"][0], "width": 80, "height": 60},
        {**base, "id": "drift", "rate_hz": 60.0, "drift_ppm": 1000.0},
        {**base, "id": "blur", "exposure_s": 0.015, **hidden},
        {**base, "id": "lost", "lost_frames": [1, 3], "lost_stamped": False},
        {**base, "id": "sensor", "gain": 1.5, "bit_depth": 16, "color": "gray"},
        {**base, "id": "noise", "noise": 0.003},
        {**base, "id": "bent", "width": 96, "height": 64, "distortion": bent},
    ]
    rig_file.write_text(json.dumps({**CORPUS["rig"], "cameras": cameras}))
    wanted = filming.options(rig_file, samples=128, frames=5, size_px=None)
    filmed = filming.film(moving_disc, wanted, tmp_path / "capture")
    found = time_errors_frames(tmp_path / "capture", reference_zero_s(filmed))
    assert [len(found[c["id"]]) for c in cameras] == [5, 10, 5, 3, 5, 5, 5]
    assert max(abs(e) for errors in found.values() for e in errors) < 0.01
    # The pictures show the drift: if it were ignored, errors would grow by 0.001 frame intervals per frame.
    growth = np.polyfit(range(10), found["drift"], 1)[0]
    assert abs(growth) < 0.0005
    times_s = next(s for s in filmed.shutters if s.id == "drift").world_times_s
    assert np.diff(times_s) == pytest.approx(1.001 / 60, abs=1e-12)

    content = json.loads((tmp_path / "capture" / "capture.json").read_text())
    clocks = {entry["id"]: entry["clock"] for entry in content["cameras"]}
    assert clocks["drift"]["drift"] is True and "lost" not in clocks["drift"]
    assert clocks["lost"] == {
        "rate_hz": 25.0,
        "first_s": 0.0,
        "shared": False,
        "lost": True,
    }
    truth = json.loads((tmp_path / "capture" / "truth" / "truth.json").read_text())
    offsets = {entry["id"]: entry for entry in truth["offsets"]}
    assert offsets["drift"]["rate_ppm"] == 1000.0
    assert offsets["lost"]["lost_before"] == [1, 2]
    # The blurred disc is longer than the sharp one, by its displacement during the exposure.
    lights = [
        filming.read_light(tmp_path / "capture" / name / "0002.png")
        for name in ("blur", "drift")
    ]
    lengths_px = [np.sum(light.max(axis=0) > 0.01 * light.max()) for light in lights]
    way_px = 0.015 * VELOCITY_M_S[0] * 64 / DISTANCE_M
    assert lengths_px[0] - lengths_px[1] == pytest.approx(way_px, abs=1.5)


# Filming, estimation of offsets and rendering with every rig


@pytest.fixture(scope="module")
def magazine() -> Any:
    """The scene `magazine`, which `stlfr demo` films."""
    pytest.importorskip("bpy")
    return filming.scenes.open_scene("magazine", None)


@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: path.stem)
def test_every_shipped_rig_is_filmed_and_reconstructed(
    path: Path, magazine: Any, program: Path, tmp_path: Path
) -> None:
    capture = tmp_path / "capture"
    wanted = filming.options(path, size_px=(160, 120), frames=4, samples=6)
    filmed = filming.film(magazine, wanted, capture)
    found = subprocess.run(
        [program, "offsets", capture, "--json"],
        check=True,
        capture_output=True,
        text=True,
    )
    offsets = json.loads(found.stdout)
    assert [c["id"] for c in offsets["cameras"]] == [c.id for c in filmed.rig.cameras]
    truth = json.loads((capture / "truth" / "truth.json").read_text())
    frame_s = 1 / filmed.rig.reference_camera.rate_hz
    known = [
        (found["offset_s"] - true["offset_s"]) / frame_s
        for found, true in zip(offsets["cameras"], truth["offsets"], strict=True)
        # Undetected lost frames shift a camera's times, so such cameras are excluded.
        if found["offset_s"] is not None and not true["lost_before"]
    ]
    # With so few and small frames, offsets are imprecise, but not wrong.
    assert max(map(abs, known)) < 0.1
    assert len(known) > 1 or path.stem == "lost-frames"
    # The offset of the reference is always known, so a view in the middle of its recording can be rendered.
    content = json.loads((capture / "capture.json").read_text())
    reference = next(c for c in content["cameras"] if c["id"] == content["reference"])
    times_s = reference["clock"].get("times_s") or [
        k / reference["clock"]["rate_hz"] for k in range(4)
    ]
    view = {
        field: reference[field]
        for field in ("width", "height", "model", "params", "cam_from_world")
    }
    (tmp_path / "view.json").write_text(json.dumps(view))
    command: list[str | Path] = [
        program,
        "render",
        capture,
        "--camera",
        tmp_path / "view.json",
    ]
    time_s = float(np.mean(times_s[1:3]))
    command += ["--time", str(time_s), "-o", tmp_path / "view.png"]
    subprocess.run(command, check=True)
    import cv2

    picture = cv2.imread(str(tmp_path / "view.png"), cv2.IMREAD_UNCHANGED)
    assert picture.shape[:2] == (120, 160) and picture[..., :3].std() > 20
