"""The Blender extension, built, installed into an empty Blender, and used without a window."""

from __future__ import annotations

import importlib
import json
import re
import shutil
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from extension_user import one_sentence, run_step, step
from filming import ROOT, SHIPPED, errors, pixels, rig

MANIFEST = ROOT / "blender/stlfr/blender_manifest.toml"

wheel = importlib.import_module("stlfr_extension.wheel")


def by_command_line(
    program: Path, capture: Path, wanted: dict[str, Any], tmp_path: Path
) -> npt.NDArray[np.int32]:
    """Render a view that a step has rendered in Blender by `stlfr render`; returns its RGBA samples."""
    camera, options, output = (
        tmp_path / name for name in ("view.json", "options.json", "by-command-line.png")
    )
    camera.write_text(json.dumps(wanted["camera"]))
    options.write_text(json.dumps(wanted["options"]))
    command: list[str | Path] = [program, "-q", "render", capture, "--camera", camera]
    command += ["--time", repr(wanted["time_s"]), "--options", options, "-o", output]
    subprocess.run(command, check=True)
    return pixels(output)


# The package


def test_the_zip_holds_what_it_needs(extension_zip: Path) -> None:
    """It holds the extension's modules, the filming script, the wheel of this version, and a manifest that lists it."""
    with zipfile.ZipFile(extension_zip) as archive:
        names = set(archive.namelist())
        manifest = tomllib.loads(archive.read("blender_manifest.toml").decode())
    for name in ("__init__.py", "engine.py", "rig.py", "capture.py"):
        assert name in names
    assert not any("__pycache__" in name for name in names)
    (listed,) = manifest["wheels"]
    assert listed.removeprefix("./") in names
    assert f"stlfr-{manifest['version']}-cp311-abi3-" in listed
    assert manifest["platforms"] and list(manifest["permissions"]) == ["files"]


def test_the_versions_are_the_same() -> None:
    """The version in the extension's manifest equals that of the library."""
    with (ROOT / "Cargo.toml").open("rb") as file:
        version = tomllib.load(file)["package"]["version"]
    assert wheel.manifest_version(MANIFEST) == version


def test_a_wheel_of_another_version_is_not_packed(tmp_path: Path) -> None:
    other = tmp_path / "stlfr-9.9.9-cp311-abi3-linux_x86_64.whl"
    other.write_bytes(b"")
    command = [sys.executable, "-I", str(ROOT / "blender/package.py"), str(other)]
    ended = subprocess.run(
        [*command, "-o", str(tmp_path / "x.zip")],
        capture_output=True,
        text=True,
        check=False,
    )
    assert ended.returncode == 1 and len(ended.stderr.splitlines()) == 1
    assert "stlfr-9.9.9" in ended.stderr and not (tmp_path / "x.zip").exists()


def test_an_output_that_is_no_zip_is_refused(program: Path) -> None:
    ended = subprocess.run(
        [program, "setup", "--extension", "stlfr.tar"],
        capture_output=True,
        text=True,
        check=False,
    )
    assert (ended.returncode, len(ended.stderr.splitlines())) == (2, 1)
    assert "must name a .zip" in ended.stderr


# In Blender


def test_it_installs_and_enables(blender_user: Path) -> None:
    """The extension imports the module `stlfr` that it contains, not another installed one."""
    found = json.loads((blender_user / "found.json").read_text())
    assert found["enabled"] and "STLFR" in found["engines"]
    found = step(blender_user, "enable_only")
    assert Path(found["module"]).is_relative_to(blender_user / "extensions")
    assert found["version"] == wheel.manifest_version(MANIFEST)


def test_disabled_it_leaves_nothing(blender_user: Path) -> None:
    found = step(blender_user, "come_and_go")
    assert found["enabled"]["scene"] and found["enabled"]["object"]
    assert found["enabled"]["engine"] and len(found["enabled"]["types"]) > 15
    assert found["enabled"]["panels"] > 10  # Blender's own panels suit the engine too
    assert found["before"] == found["after"]
    assert not found["after"]["types"] and not found["after"]["panels"]


def test_a_module_of_another_version_is_refused(
    blender_user: Path, tmp_path: Path
) -> None:
    user = Path(shutil.copytree(blender_user, tmp_path / "user"))
    (manifest,) = user.rglob("user_default/stlfr/blender_manifest.toml")
    text = manifest.read_text().replace('\nversion = "', '\nversion = "7')
    manifest.write_text(text)
    ended = run_step(user, "enable_only")
    found = json.loads(ended.stdout.splitlines()[-1])
    assert not found["enabled"] and not found["scene"] and not found["types"]
    said = [
        line
        for line in (ended.stdout + ended.stderr).splitlines()
        if "errors.FailureError: " in line
    ]
    (sentence,) = said
    assert (
        "can't be enabled: the module stlfr that is installed has version" in sentence
    )


def test_a_missing_module_is_one_sentence(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "stlfr", None)
    with pytest.raises(errors.FailureError, match="can't be loaded"):
        wheel.require(MANIFEST)


def must_be_offsets(found: dict[str, Any]) -> None:
    """Assert that there are offsets of three cameras, each of which is known or has a reason why not."""
    assert [o["id"] for o in found["offsets"]] == ["cam0", "cam1", "cam2"]
    for offset in found["offsets"]:
        assert offset["known"] != bool(offset["reason"])
    assert found["offsets"][1]["known"] and found["offsets"][1]["offset_s"] == 0
    unknown = [o["id"] for o in found["offsets"] if not o["known"]]
    kind, sentence = found["report"]
    assert kind == ("WARNING" if unknown else "INFO")
    assert all(camera in sentence for camera in unknown)


def test_from_rig_to_picture(blender_user: Path, program: Path, tmp_path: Path) -> None:
    """Create a rig, cancel and resume filming, estimate offsets, and render: F12 gives the image of `stlfr render`."""
    found = step(blender_user, "film", tmp_path)
    capture = tmp_path / "capture"
    assert found["capture"] == "//capture"  # as it was named

    # Filming
    sentences = {name: one_sentence(text) for name, text in found["sentences"].items()}
    for name, words in {
        "unsaved": "isn't saved yet",
        "no rig": "has no rig",
        "busy": "Filming is under way",
        "stopped": "resume it",
        "there": "isn't empty",
        "too few frames": "set Frames higher",
        "nothing to resume": "holds no film",
    }.items():
        assert words in sentences[name], (name, sentences[name])
    assert found["cancelled"] and found["kept"] and found["untouched"]
    assert 1 <= found["frames when stopped"] < 6
    assert len(list(capture.glob("cam*/*.png"))) == 6
    assert not list(capture.rglob("*.blend"))
    assert not (
        tmp_path / "refused"
    ).exists()  # filming that is refused leaves no folder
    cameras = found["rig"]["cameras"]
    reference = next(c for c in cameras if c["id"] == found["rig"]["reference"])
    # Filming begins before the scene's first frame, so that every camera has an image by then.
    lead_s = found["time_offset_s"] + reference["delay_s"]
    assert max(c["delay_s"] for c in cameras) - 0.01 < lead_s < 1 / 30 + 0.01
    start, (sentence, is_covered) = found["start"]
    assert (
        start == 1
        and is_covered
        and re.match(r"Covered: frames (0\.\d|1) to [1-9]", sentence)
    )

    must_be_offsets(found)

    # What is shown
    for text in (
        "of 6: cam",
        "Film: Resume",
        "Rig Camera: Delay",
        "Film: Cancel",
        "Trails: Mode",
    ):
        assert any(text in line for line in found["drawn"]), (text, found["drawn"])
    assert any("Offsets: cam1 +0.000 ± 0.000" in line for line in found["drawn"])

    # The picture
    picture = found["picture"]
    assert picture["time_s"] == pytest.approx(picture["wanted_s"], abs=1e-6)
    rendered = pixels(picture["file"])
    expected = by_command_line(program, capture, picture, tmp_path)
    assert np.abs(rendered - expected).max() <= 1
    assert rendered[..., :3].std() > 20  # shows the textured board


def test_a_film_in_one_go(blender_user: Path, tmp_path: Path) -> None:
    assert step(blender_user, "film_again", tmp_path) == {
        "result": ["FINISHED"],
        "frames": 3,
    }
    rig.load(tmp_path / "rig.json")


def test_pictures_are_the_command_lines(
    blender_user: Path, own_capture: Path, program: Path, tmp_path: Path
) -> None:
    """Pictures by the engine equal those of `stlfr render`.

    They use the default methods or automatic ones, or have unseen pixels, a trail, or a render border.
    """
    found = step(blender_user, "pictures", own_capture, tmp_path)
    rendered = {name: pixels(wanted["file"]) for name, wanted in found.items()}
    expected = {
        name: by_command_line(program, own_capture, wanted, tmp_path)
        for name, wanted in found.items()
    }
    assert found["like"]["options"] == {"preset": "best"}
    assert found["auto"]["options"]["auto"] == {
        "sync": True,
        "proxy": True,
        "blend": True,
    }
    assert found["draft"]["options"] == {"preset": "draft"}
    for name in ("like", "auto", "draft", "aside", "trail"):
        assert rendered[name].shape == expected[name].shape
        assert np.abs(rendered[name] - expected[name]).max() <= 1, name
    hidden = rendered["aside"][..., 3] == 0
    assert hidden.any() and not hidden.all() and not rendered["aside"][hidden].any()
    assert (rendered["like"][..., 3] == 255).all()
    brighter = rendered["trail"].mean() - expected["like"].mean()
    assert brighter > 0.5

    height, width = expected["border"].shape[:2]
    part = expected["border"][: height // 2, width // 4 : 3 * width // 4]
    assert rendered["border"].shape == part.shape
    assert np.abs(rendered["border"] - part).max() <= 1
    uncropped = rendered["uncropped"]
    assert uncropped.shape == expected["border"].shape
    assert (
        np.abs(uncropped[: height // 2, width // 4 : 3 * width // 4] - part).max() <= 1
    )
    assert not uncropped[height // 2 :].any()

    # From a filming camera's pose, the picture is this camera's image, so axes, lens and time are correct.
    like = tmp_path / "like-cam3.png"
    command: list[str | Path] = [program, "-q", "render", own_capture, "--like", "cam3"]
    command += ["--time", repr(found["like"]["time_s"]), "-o", like]
    subprocess.run(command, check=True)
    assert np.abs(rendered["like"] - pixels(like)).mean() < 1.0


def test_animations(
    blender_user: Path, own_capture: Path, program: Path, tmp_path: Path
) -> None:
    """In slow motion, frames differ and have the times given by speed and offset; in bullet time, all have one time."""
    found = step(blender_user, "animation", own_capture, tmp_path)
    seconds = [0.25 * frame / 24 for frame in range(3)]
    expected = [found["offset_s"] + s for s in seconds]
    np.testing.assert_allclose(found["times_s"], expected, rtol=0, atol=1e-9)
    assert found["bullet_s"] == found["offset_s"]
    for kind in ("slow", "bullet"):
        frames = [pixels(tmp_path / f"{kind}-{n:04d}.png") for n in (1, 2, 3)]
        for a, b in ((0, 1), (1, 2)):
            assert np.abs(frames[a] - frames[b]).max() > 10, kind
    slow, bullet = (
        pixels(tmp_path / f"{kind}-0001.png") for kind in ("slow", "bullet")
    )
    np.testing.assert_array_equal(slow, bullet)  # the same place and time


def test_what_is_wrong_is_one_sentence(
    blender_user: Path, own_capture: Path, tmp_path: Path
) -> None:
    folder = tmp_path / "empty"
    folder.mkdir()
    found = step(blender_user, "errors", own_capture, folder)
    for name, words in {
        "no capture": "no capture is chosen",
        "offsets without": "no capture is chosen",
        "beside nothing": "isn't saved yet",
        "no such": "holds no capture",
        "offsets of none": "holds no capture",
        "no review": "holds no capture",
        "no report": "holds no capture",
        "outside": "no camera has frames around",
        "orthographic": "isn't a perspective camera",
        "my rig": "give it another name",
        "wrong rig": "wrong.json",
        "more": "cam0's other fields aren't valid JSON",
        "jitter": "cameras[0].jitter_s",
    }.items():
        assert words in one_sentence(found["sentences"][name]), name
    assert found["written"] == "{}"


def test_rendering_stops_when_asked(blender_user: Path, own_capture: Path) -> None:
    found = step(blender_user, "stop_rendering", own_capture)
    assert not found["errors"] and not found["results"]
    assert found["seconds"] < 10 and "of 10000" in found["text"]
    assert all(0 <= share <= 1 for share in found["progress"])


def test_a_comparison_is_added_to_the_file(
    blender_user: Path, own_capture: Path
) -> None:
    """The user's own scene doesn't change; a second comparison replaces the first one's scenes."""
    shutil.rmtree(own_capture / "review", ignore_errors=True)
    found = step(blender_user, "review", own_capture)
    assert found["added"] and found["there"] and found["shown"], found
    assert any(name.startswith("Truth") for name in found["strips"])
    assert not found["selected"] and not any(found["prefetch"])
    for name in ("report.html", "review.json", "metrics.json"):
        assert (own_capture / "review" / name).is_file()


def test_rigs_go_there_and_back(blender_user: Path, tmp_path: Path) -> None:
    """A rig file is saved as it was loaded, wherever the rig is placed; an edit changes only the edited fields."""
    source = ROOT / "rigs/linear8.json"
    found = step(blender_user, "rigs", source, tmp_path)
    given = json.loads(source.read_text())
    same, moved, edited = (
        json.loads((tmp_path / f"{name}.json").read_text())
        for name in ("same", "moved", "edited")
    )
    assert same == given and moved == given
    changed = edited["cameras"][1]
    assert changed["delay_s"] == 0.0125 and changed["lens_mm"] == 50.0
    assert (changed["color"], changed["jitter_stamped"]) == ("gray", False)
    before, after = (
        c["cam_from_rig"]["translation"] for c in (given["cameras"][1], changed)
    )
    np.testing.assert_allclose(np.subtract(after, before), [-0.01, 0, 0], atol=1e-6)
    edited["cameras"][1] = given["cameras"][1]
    assert edited == given
    assert found["stays"] and found["data"] == 8
    assert found["cameras"] == [f"cam{n}" for n in range(8)]


def test_a_new_rig_is_the_command_lines(
    blender_user: Path, program: Path, tmp_path: Path
) -> None:
    """A rig by *Create Rig* is saved with the digits that `stlfr rig` writes for the same options and seed."""
    wanted = {
        "paper": ("line --seed 7", {}),
        "grid": (
            "grid --rows 2 --columns 3 --spacing 0.1 --rate 29.97 --seed 2147483647",
            {
                "rows": 2,
                "columns": 3,
                "spacing_m": 0.1,
                "rate_hz": 29.97,
                "seed": 2**31 - 1,
            },
        ),
        "still": (
            "line --count 3 --size 160x120 --lens 50 --jitter 0 --seed 0",
            {
                "columns": 3,
                "width_px": 160,
                "height_px": 120,
                "lens_mm": 50.0,
                "jitter_s": 0.0,
                "seed": 0,
            },
        ),
    }
    properties = {name: given for name, (_, given) in wanted.items()}
    found = step(blender_user, "new_rigs", tmp_path, json.dumps(properties))
    assert found["objects"] == 3 + 2  # the last one's cameras and views
    for name, (arguments, _) in wanted.items():
        written = tmp_path / f"{name}-by-command-line.json"
        command: list[str | Path] = [program, "rig", *arguments.split()]
        command += ["--name", name, "-o", written]
        subprocess.run(command, check=True)
        panels, programs = (
            json.dumps(json.loads(path.read_text()), sort_keys=True)
            for path in (tmp_path / f"{name}.json", written)
        )
        assert panels == programs


def test_every_shipped_rig_is_saved_as_it_was_loaded(
    blender_user: Path, tmp_path: Path
) -> None:
    """Loading and saving a rig file doesn't change it, not even if it omits fields with default values."""
    step(blender_user, "saved_again", tmp_path, *SHIPPED)
    for source in SHIPPED:
        saved = json.loads((tmp_path / source.name).read_text())
        assert saved == json.loads(source.read_text()), source


def test_work_beside_blender_is_followed(blender_user: Path, own_capture: Path) -> None:
    found = step(blender_user, "modal", own_capture)
    assert found["first"] == ["PASS_THROUGH"] and found["passed"]
    assert found["seen"][-2] == "timer" and found["seen"][-1].startswith(
        "{'INFO'}: The offsets of all 8"
    )
    assert found["offsets"] == 8 and not found["running"]
