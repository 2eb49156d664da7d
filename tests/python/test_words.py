"""Texts in the panels: times, frame ranges, and messages without terms of the command line."""

from __future__ import annotations

import importlib
import json
import re
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from filming import ROOT, errors, rig_camera, rig_content

fields = importlib.import_module("stlfr_extension.fields")
folders = importlib.import_module("stlfr_extension.filming")
timing = importlib.import_module("stlfr_extension.timing")
view = importlib.import_module("stlfr_extension.view")
words = importlib.import_module("stlfr_extension.words")


def scene(**settings: Any) -> Any:
    """A fake of a Blender scene with the settings that decide times; `settings` replaces values."""
    given = {"speed": 1.0, "time_offset_s": 0.0, "start_frame": 1, **settings}
    render = SimpleNamespace(fps=24, fps_base=1.0)
    return SimpleNamespace(
        frame_start=1,
        frame_current=1,
        frame_subframe=0.0,
        render=render,
        stlfr=SimpleNamespace(**given),
    )


@pytest.mark.parametrize(
    ("said", "meant"),
    [
        (
            "--instants 3: there is room for 0 between the frames of all cameras; film more --frames",
            "Instants is 3: there is room for 0 between the frames of all cameras; set Frames higher",
        ),
        (
            "no point before this view could be triangulated; the plane proxy with proxy.plane_depth_m focuses by hand",
            "no point before this view could be triangulated; choose the scene shape Plane in the render properties, "
            "and focus by hand",
        ),
        ("/a/b c/capture/.film/rig.json: cameras[0].id: is empty", None),
        ("filming was stopped; the same command goes on where it was", None),
        ("a sentence without any of it", "a sentence without any of it"),
    ],
)
def test_sentences_are_the_panels(said: str, meant: str | None) -> None:
    found = words.in_blender(said)
    assert meant is None or found == meant
    assert "--" not in found and ".film" not in found and "command" not in found


def test_no_flag_of_the_filming_script_is_left() -> None:
    """Messages of all modules that film for the panels contain no command line option after translation."""
    flag = re.compile(r"(?<![\w-])--[a-z][a-z-]*")
    for name in ("plan", "truth", "rig", "workers"):
        text = (ROOT / f"blender/stlfr/{name}.py").read_text()
        for line in re.findall(r'f?"([^"\n]*--[a-z][^"\n]*)"', text):
            said = re.sub(r"\{[^{}]*\}", "3", line)
            left = flag.findall(words.in_blender(said.replace("3x3", "32x24")))
            assert not left, (name, said, words.in_blender(said))


def test_lines_break_at_spaces_and_in_paths() -> None:
    text = "no capture in /home/somebody/films/a-very-long-name/capture there"
    lines = list(words.wrapped(text, 20))
    assert all(len(line) <= 20 for line in lines)
    assert "".join(lines).replace(" ", "") == text.replace(" ", "")
    assert list(words.wrapped("", 20)) == []


def test_ranges_are_rounded_inwards() -> None:
    assert words.frames(0.31, 8.99) == "0.4 to 8.9"
    assert words.frames(1.0, 12.0) == "1 to 12"
    assert words.frames(-3.26, -1.01) == "-3.2 to -1.1"
    assert words.duration(200.4) == "3 min 20 s" and words.duration(59) == "59 s"


def test_covered_frames_follow_speed_offset_and_start() -> None:
    span_s = (0.5, 1.5)
    assert view.covered_frames(scene(), span_s) == (13.0, 37.0)
    assert view.covered_frames(scene(time_offset_s=0.5), span_s) == (1.0, 25.0)
    assert view.covered_frames(scene(start_frame=10), span_s) == (22.0, 46.0)
    assert view.covered_frames(scene(speed=0.5), span_s) == (25.0, 73.0)
    backwards = scene(speed=-1.0, time_offset_s=2.0)
    assert view.covered_frames(backwards, span_s) == (13.0, 37.0)
    assert view.covered_frames(scene(speed=0.0), span_s) is None
    for frame in (13, 37):
        one = scene()
        one.frame_current = frame
        assert span_s[0] <= view.capture_time_s(one) <= span_s[1]


def test_whole_frames_forgive_rounding() -> None:
    assert timing.whole_frames((1.0 + 1e-7, 8.9)) == (1, 8)
    assert timing.whole_frames((0.2, 2.0 - 1e-7)) == (1, 2)
    assert timing.whole_frames((1.2, 1.8)) is None


def test_a_scene_has_no_frame_before_the_first() -> None:
    assert timing.scene_range((2.5, 8.9)) == (3, 8)
    assert timing.scene_range((-20.0, 5.2)) == (0, 5)
    assert timing.scene_range((-20.0, 0.0)) == (0, 0)
    for covered in ((-20.0, -5.0), (1.2, 1.8), None):
        assert timing.scene_range(covered) is None


def test_folders_without_a_capture_say_what_they_hold(tmp_path: Path) -> None:
    with pytest.raises(errors.BadInputError, match="there is no folder"):
        fields.must_be_capture(tmp_path / "none")
    with pytest.raises(errors.BadInputError, match="holds no capture: film one there"):
        fields.must_be_capture(tmp_path)
    options = folders.Options("mine", 9, 1, True, 3, 0)
    blend = folders.begin(tmp_path / "film", rig_content(rig_camera("cam0")), options)
    blend.write_bytes(b"")
    with pytest.raises(errors.BadInputError, match=r"isn't finished: .* press Resume"):
        fields.must_be_capture(tmp_path / "film")
    assert fields.span_s(tmp_path / "film") is None


def test_a_film_begins_before_the_scene(tmp_path: Path) -> None:
    """Filming begins earlier by the delay of the last camera; the time offset contains this lead."""
    content = rig_content(
        rig_camera("cam0", delay_s=0.004), rig_camera("cam1", delay_s=0.021)
    )
    lead_s = folders.lead_s(content)
    assert lead_s == pytest.approx(0.021 + folders.LEAD_MARGIN_S, abs=1e-9)
    options = folders.Options("mine", 9, 1, True, 3, 0, lead_s)
    folders.begin(tmp_path / "film", content, options)
    found = folders.time_offset_s(tmp_path / "film")
    reference = next(c for c in content["cameras"] if c["id"] == content["reference"])
    assert found == pytest.approx(lead_s - reference["delay_s"])
    assert folders.time_offset_s(tmp_path) is None


def test_options_of_films_that_were_begun_before_are_read(tmp_path: Path) -> None:
    """An options file without a lead, as earlier versions wrote it, is read with a lead of 0."""
    (tmp_path / ".film").mkdir()
    old = {"title": "a", "frames": 9, "samples": 1, "truth": True, "instants": 3}
    (tmp_path / ".film/options.json").write_text(json.dumps({**old, "workers": 0}))
    content = rig_content(rig_camera("cam0", delay_s=0.004))
    (tmp_path / ".film/rig.json").write_text(json.dumps(content))
    assert folders.time_offset_s(tmp_path) == pytest.approx(-0.004)
