"""Camera paths of the module `stlfr` are those of `stlfr render --path`."""

from __future__ import annotations

import json
import subprocess
from pathlib import Path

import cv2
import numpy as np
import pytest
import stlfr


def test_a_paths_frames_are_the_command_lines(
    own_capture: Path, program: Path, tmp_path: Path
) -> None:
    """Tests a ready-made path with running time and with stopped time."""
    capture = stlfr.open(own_capture)
    time_s = float(np.mean(capture.times("cam3")))
    stopped: list[tuple[str, float | None]] = [("runs", None), ("stops", time_s)]
    for name, stop_s in stopped:
        frames = capture.path(
            "bullet-time", rate_hz=2, duration_s=1, preset="draft", time_s=stop_s
        )
        words = [] if stop_s is None else ["--time", repr(stop_s)]
        assert len(frames) == 3
        assert stop_s is None or frames[1]["time_s"] == pytest.approx(stop_s)
        command: list[str | Path] = [program, "-q", "render", own_capture]
        command += ["--path", "bullet-time", "--fps", "2", "--duration", "1"]
        out = tmp_path / f"{name}-%d.png"
        command += [*words, "--preset", "draft", "-o", out]
        subprocess.run(command, check=True)
        for index, frame in enumerate(frames):
            rendered = capture.render(
                frame["time_s"], camera=frame["camera"], preset="draft", alpha=False
            )
            written = cv2.imread(str(tmp_path / f"{name}-{index}.png"))
            assert written is not None
            np.testing.assert_array_equal(rendered, written[:, :, ::-1])


def test_a_path_is_given_by_its_keys(own_capture: Path, tmp_path: Path) -> None:
    """A path may be given as a dict or as a file; anything else raises a ValueError."""
    capture = stlfr.open(own_capture)
    keys = [
        {"at_s": at_s, "time_s": 0.05 + at_s / 10, "camera": capture.camera(name)}
        for at_s, name in ((0.0, "cam2"), (1.0, "cam3"))
    ]
    path = {"format": "stlfr-path", "version": 1, "rate_hz": 4, "keys": keys}
    file = tmp_path / "path.json"
    file.write_text(json.dumps(path))
    frames = capture.path(path)
    assert frames == capture.path(file)
    assert [frame["time_s"] for frame in frames] == pytest.approx(
        [0.05, 0.075, 0.1, 0.125, 0.15]
    )
    x_m = [frame["camera"]["cam_from_world"]["translation"][0] for frame in frames]
    assert x_m == sorted(x_m, reverse=x_m[0] > x_m[-1]) and len(set(x_m)) == 5
    stretched = capture.path(path, duration_s=0.5, time_s=0.1)
    assert [frame["time_s"] for frame in stretched] == [0.1] * 3
    for wrong, sentence in (
        ({**path, "keys": []}, "path: keys: there are none"),
        ({**path, "speed": 1}, "path: speed: unknown field"),
        ("circle", "path: 'circle' is no .json and none of sweep"),
    ):
        with pytest.raises(ValueError, match=sentence):
            capture.path(wrong)
    for rate_hz in (0.0, -1.0, float("nan"), 1e4):
        with pytest.raises(ValueError, match="rate_hz: must be from"):
            capture.path(path, rate_hz=rate_hz)
    with pytest.raises(ValueError, match="duration_s: must be positive"):
        capture.path("orbit", duration_s=0)
    with pytest.raises(TypeError, match=r"stlfr\.open\(path\)"):
        stlfr.Capture(own_capture)  # type: ignore[arg-type]
