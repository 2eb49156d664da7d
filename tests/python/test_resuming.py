"""Filming that is stopped and resumed, that is complete already, or that is refused."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from filming import (
    CAPTURE_SCRIPT,
    by_script,
    rig_camera,
    right_of_centre,
    run,
    write_rig,
)


def small_film(folder: Path, rig_file: Path, *more: object) -> list[str]:
    options = [
        "--scene",
        "magazine",
        "--frames",
        "4",
        "--samples",
        "1",
        "--instants",
        "1",
    ]
    command = [
        sys.executable,
        "-I",
        str(CAPTURE_SCRIPT),
        str(rig_file),
        *options,
        "-o",
        str(folder),
    ]
    return [*command, *map(str, more)]


def contents(folder: Path) -> dict[str, bytes]:
    """The contents of all files of a folder that aren't hidden, by path."""
    files = (path for path in sorted(folder.rglob("*")) if path.is_file())
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in files
        if ".film" not in path.relative_to(folder).parts
    }


@pytest.fixture(scope="module")
def small_rig(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A rig file with two cameras, 6 cm apart, with an offset of 0.37 frame intervals."""
    return write_rig(
        tmp_path_factory.mktemp("rig") / "rig.json",
        rig_camera("left", delay_s=0.003),
        rig_camera(
            "right", delay_s=0.003 + 0.37 / 30, cam_from_rig=right_of_centre(0.06)
        ),
    )


@pytest.fixture(scope="module")
def uninterrupted(small_rig: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The capture filmed with `small_rig` without interruption."""
    folder = tmp_path_factory.mktemp("whole") / "capture"
    result = run(small_film(folder, small_rig))
    assert result.returncode == 0, result.stderr
    lines = [json.loads(line) for line in result.stdout.splitlines()]
    assert [line["done"] for line in lines] == list(range(13))
    assert "Filming 12 images may take" in lines[0].pop("note")
    assert all(
        set(line) == {"done", "total", "what"} and line["total"] == 12 for line in lines
    )
    return folder


@pytest.mark.parametrize("by", [signal.SIGTERM, signal.SIGKILL])
def test_an_interrupted_film_goes_on_where_it_was(
    uninterrupted: Path, small_rig: Path, tmp_path: Path, by: signal.Signals
) -> None:
    folder = tmp_path / "capture"
    with subprocess.Popen(
        small_film(folder, small_rig),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as process:
        assert process.stdout is not None and process.stderr is not None
        for line in process.stdout:
            if json.loads(line)["done"] >= 3:
                process.send_signal(by)
                break
        status = process.wait(timeout=30)
        complaint = process.stderr.read()
    if by == signal.SIGTERM:
        assert status == 1
        assert (
            complaint == "filming was stopped; the same command goes on where it was\n"
        )
    time.sleep(1.0)  # a worker without its parent finishes its image and ends
    assert not (folder / "capture.json").exists()
    finished = {
        path: path.stat().st_mtime_ns
        for path in folder.rglob("*.png")
        if ".film" not in path.parts
    }
    assert 3 <= len(finished) < 12
    cut_off = next(iter(finished))
    cut_off.write_bytes(cut_off.read_bytes()[:-20])
    del finished[cut_off]

    result = run(small_film(folder, small_rig))
    assert result.returncode == 0, result.stderr
    assert {path: path.stat().st_mtime_ns for path in finished} == finished
    assert contents(folder) == contents(uninterrupted)


def test_filming_again_does_nothing_and_at_once(
    uninterrupted: Path, small_rig: Path
) -> None:
    before = {path: path.stat().st_mtime_ns for path in uninterrupted.rglob("*")}
    start = os.times()
    result = run(small_film(uninterrupted, small_rig))
    end = os.times()
    worked_s = end.children_user - start.children_user
    assert worked_s < 1.5  # starting Blender would take longer; without, it takes 0.2 s
    assert result.returncode == 0, result.stderr
    assert json.loads(result.stdout) == {
        "done": 12,
        "total": 12,
        "what": "already filmed",
    }
    assert {
        path: path.stat().st_mtime_ns for path in uninterrupted.rglob("*")
    } == before


def test_a_film_is_the_same_on_one_process_or_two(
    uninterrupted: Path, small_rig: Path, tmp_path: Path
) -> None:
    folder = tmp_path / "capture"
    result = run(small_film(folder, small_rig, "--workers", 1))
    assert result.returncode == 0, result.stderr
    assert contents(folder) == contents(uninterrupted)


def test_another_plan_and_foreign_folders_are_refused(
    uninterrupted: Path, small_rig: Path, tmp_path: Path
) -> None:
    before = contents(uninterrupted)
    other = by_script(
        small_rig, "--scene", "magazine", "--frames", 5, "-o", uninterrupted
    )
    assert other.returncode == 2
    assert (
        "another rig, scene or options" in other.stderr
        and other.stderr.count("\n") == 1
    )
    assert contents(uninterrupted) == before

    (tmp_path / "notes.txt").write_text("mine")
    foreign = by_script(small_rig, "--scene", "magazine", "-o", tmp_path)
    assert foreign.returncode == 2
    assert (
        "files that stlfr did not write" in foreign.stderr
        and foreign.stderr.count("\n") == 1
    )
    assert [path.name for path in tmp_path.iterdir()] == ["notes.txt"]


def test_a_scene_that_is_refused_gives_its_folder_back(
    small_rig: Path, tmp_path: Path
) -> None:
    """A .blend file without a camera is refused; then one with a camera is filmed into the same folder."""
    blend, folder = tmp_path / "mine.blend", tmp_path / "capture"

    def film() -> subprocess.CompletedProcess[str]:
        small = ["--frames", 3, "--samples", 1, "--no-truth"]
        return by_script(small_rig, "--blend", blend, *small, "-o", folder)

    def save(with_camera: bool) -> None:
        lines = [
            "import bpy",
            "bpy.ops.wm.read_factory_settings(use_empty=True)",
            f"camera = bpy.data.objects.new('c', bpy.data.cameras.new('c')) if {with_camera} else None",
            "if camera: bpy.context.scene.collection.objects.link(camera)",
            "bpy.context.scene.camera = camera",
            f"bpy.ops.wm.save_as_mainfile(filepath={str(blend)!r})",
        ]
        command = [sys.executable, "-I", "-c", "\n".join(lines)]
        subprocess.run(command, check=True, capture_output=True)

    save(with_camera=False)
    refused = film()
    assert refused.returncode == 2
    assert "doesn't say where the rig stands" in refused.stderr
    save(with_camera=True)
    result = film()
    assert result.returncode == 0, result.stderr


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        (
            ["--scene", "nowhere"],
            "--scene nowhere: no such scene; there are: along, ball,",
        ),
        (["--blend", "nowhere.blend"], "nowhere.blend: no such file"),
        ([], "one of the arguments --scene --blend is required"),
        (
            ["--scene", "magazine", "--size", "64x64"],
            "--size 64x64 has another aspect than left of rig small",
        ),
        (
            ["--scene", "magazine", "--size", "64by48"],
            "64by48 isn't a size like 320x240",
        ),
        (["--scene", "magazine", "--frames", "0"], "0 isn't a whole number from 1"),
        (["--scene", "magazine", "--truth-video", "4"], "rig small has no views"),
    ],
)
def test_bad_options_are_one_sentence(
    small_rig: Path, tmp_path: Path, arguments: list[str], complaint: str
) -> None:
    result = by_script(small_rig, *arguments, "-o", tmp_path / "capture")
    assert result.returncode == 2
    assert complaint in result.stderr and result.stderr.count("\n") == 1
    assert result.stdout == ""
    assert not (tmp_path / "capture").exists()


def test_workbench_refuses_a_shutter_that_stays_open(tmp_path: Path) -> None:
    rig_file = write_rig(tmp_path / "rig.json", rig_camera("slow", exposure_s=0.01))
    scene = ("--scene", "magazine", "--engine", "workbench")
    result = by_script(rig_file, *scene, "-o", tmp_path / "capture")
    assert result.returncode == 2
    assert result.stderr == (
        "--engine workbench can't film slow of rig small: its exposure_s needs --engine cycles\n"
    )


def test_a_scene_without_a_place_for_the_rig_is_refused(
    small_rig: Path, tmp_path: Path
) -> None:
    bpy = pytest.importorskip("bpy")
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "empty.blend"))
    result = by_script(
        small_rig,
        "--blend",
        tmp_path / "empty.blend",
        "-o",
        tmp_path / "capture",
        "--no-truth",
    )
    assert result.returncode == 2
    assert (
        "doesn't say where the rig stands" in result.stderr
        and result.stderr.count("\n") == 1
    )
    assert not (tmp_path / "capture" / "capture.json").exists()


@pytest.mark.parametrize("name", [".film", "left", "colmap", "truth", "truth/views"])
def test_a_folder_that_is_a_link_is_refused(
    name: str, small_rig: Path, tmp_path: Path
) -> None:
    mine = tmp_path / "elsewhere" / "partial"
    mine.mkdir(parents=True)
    capture = tmp_path / "capture"
    (capture / name).parent.mkdir(parents=True)
    (capture / name).symlink_to(mine.parent)
    result = run(small_film(capture, small_rig))
    assert result.returncode == 2 and f"{name} is a link" in result.stderr
    assert mine.is_dir()
