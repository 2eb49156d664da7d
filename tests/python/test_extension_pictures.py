"""Quilts and stereo pairs from Blender's render tab are byte-identical to the files of `stlfr render`."""

from __future__ import annotations

import json
import subprocess
from pathlib import Path
from typing import Any

from extension_user import one_sentence, step


def test_quilts_and_pairs_are_the_command_lines(
    blender_user: Path, own_capture: Path, program: Path, tmp_path: Path
) -> None:
    found = step(blender_user, "displays", own_capture, tmp_path)
    for name, words in {
        "no capture": "no capture is chosen",
        "a view": "choose a quilt",
        "cone": "--cone: the cameras cover a cone of",
        "suffix": "a.bmp must end in .png",
        "video": "a.mp4 is a video",
    }.items():
        assert words in one_sentence(found["sentences"][name]), name
    for text in ("F12 renders the view", "Display", "Set Cone", "Eye Distance"):
        assert f"Displays: {text}" in found["drawn"], text
    assert found["quilt"] == [3360, 3360] and not found["left"]

    camera, options = tmp_path / "view.json", tmp_path / "options.json"
    camera.write_text(json.dumps(found["camera"]))
    options.write_text(json.dumps(found["options"]))
    view: list[Any] = [
        "--camera",
        camera,
        "--time",
        repr(found["time_s"]),
        "--options",
        options,
    ]
    quilt = ["--quilt", "portrait", "--convergence", repr(1.6)]
    eyes = ["--stereo", "0.05", "--convergence", repr(1.6)]
    for arguments, name, file in (
        (quilt, "b.png", "a_qs8x6a0.75.png"),
        (eyes, "b-eyes.png", "eyes.png"),
    ):
        command = [program, "-q", "render", own_capture, *view, *arguments]
        subprocess.run([*command, "-o", tmp_path / name], check=True)
        (expected,) = tmp_path.glob(f"{Path(name).stem}*.png")
        assert expected.read_bytes() == (tmp_path / file).read_bytes(), file
        expected.unlink()

    # Time and camera don't change, so every frame of the animation equals the still picture.
    frames = sorted(path.name for path in tmp_path.glob("a-*.png"))
    assert frames == [f"a-{k:04}_qs8x6a0.75.png" for k in (0, 1)]
    still = (tmp_path / "a_qs8x6a0.75.png").read_bytes()
    assert all((tmp_path / name).read_bytes() == still for name in frames)
