"""Modules of the extension that don't need Blender: jobs, review layouts, pixel samples, folders for filming."""

from __future__ import annotations

import importlib
import json
import os
import stat
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from filming import (
    CAPTURE_SCRIPT,
    by_script,
    errors,
    pixels,
    rig_camera,
    rig_content,
    run,
    write_rig,
)

folders = importlib.import_module("stlfr_extension.filming")
jobs = importlib.import_module("stlfr_extension.jobs")
reading = importlib.import_module("stlfr_extension.reading")
view = importlib.import_module("stlfr_extension.view")

SMALL = rig_camera("cam0", width=32, height=24)
"""The entry of a rig's only camera."""


def test_only_regular_files_of_some_size_are_read(tmp_path: Path) -> None:
    """Reading a pipe must not wait for data, and reading an endless device must not run forever."""
    pipe, large, good = (tmp_path / name for name in ("pipe", "large", "good"))
    os.mkfifo(pipe)
    for path in (pipe, tmp_path, Path("/dev/zero")):
        with pytest.raises(ValueError, match="is no regular file"):
            reading.read_text(path)
    large.touch()
    os.truncate(large, 1 << 40)
    with pytest.raises(ValueError, match="is larger than 64 MiB"):
        reading.read_text(large)
    good.write_text("ü", encoding="utf-8")
    assert reading.read_text(good) == "ü"
    with pytest.raises(FileNotFoundError):
        reading.read_text(tmp_path / "none")


def test_a_folder_with_a_pipe_for_options_holds_no_film(tmp_path: Path) -> None:
    (tmp_path / ".film").mkdir()
    os.mkfifo(tmp_path / ".film" / "options.json")
    assert not folders.is_begun(tmp_path)


def talk(*lines: str) -> list[str]:
    """The command of a process that runs these lines of Python."""
    return [sys.executable, "-I", "-c", "import sys, time, json\n" + "\n".join(lines)]


def test_jobs_tell_progress_and_result() -> None:
    job = jobs.Job(
        "Work",
        talk(
            'print("notes"); print(json.dumps({"done": 1, "total": 4, "what": "a"}), flush=True)',
            "time.sleep(0.2)",
            'print(json.dumps({"done": 2, "total": 4, "what": "b"})); print(json.dumps({"result": [5]}))',
        ),
    )
    assert jobs.running() is job
    with pytest.raises(errors.FailureError, match="Work is under way"):
        jobs.must_be_free()
    job.wait()
    assert (job.progress.done, job.progress.what, job.result) == (2, "b", [5])
    assert job.error is None and 0 < job.time_left_s < 60
    assert jobs.running() is None


def test_a_jobs_error_is_its_sentence() -> None:
    job = jobs.Job("Work", talk('sys.exit("rig.json: has no cameras")'))
    job.wait()
    assert job.error == "rig.json: has no cameras"
    silent = jobs.Job("Work", talk("sys.exit(7)"))
    silent.wait()
    assert silent.error == "Work ended with status 7"
    with pytest.raises(errors.FailureError, match="Work can't start"):
        jobs.Job("Work", ["/no/such/program"])


def test_a_cancelled_job_ends() -> None:
    job = jobs.Job(
        "Work",
        talk(
            "print(json.dumps({'done': 0, 'total': 1}), flush=True)", "time.sleep(60)"
        ),
    )
    start_s = time.monotonic()
    jobs.end_all()
    assert time.monotonic() - start_s < 10
    assert job.cancelled and job.error is None and jobs.running() is None


@pytest.mark.parametrize("channels", [1, 2, 3, 4])
@pytest.mark.parametrize("kind", [np.uint8, np.uint16])
def test_samples_become_scene_linear(channels: int, kind: Any) -> None:
    """Samples become linear, premultiplied and bottom row first; grey becomes RGB, and missing alpha becomes 1."""
    top = np.iinfo(kind).max
    samples = np.full((2, 3, channels), top // 2, dtype=kind)
    samples[0] = top
    if channels in (2, 4):
        samples[1, :, -1] = 0
    linear = view.scene_linear(samples)
    assert linear.shape == (2, 3, 4) and linear.dtype == np.float32
    np.testing.assert_array_equal(linear[1], 1.0)
    if channels in (2, 4):
        assert not linear[0].any()
    else:
        np.testing.assert_allclose(linear[0, :, :3], 0.2126, atol=2e-3)
        np.testing.assert_array_equal(linear[0, :, 3], 1.0)


def test_filming_in_blenders_own_program(tmp_path: Path) -> None:
    """A fake Blender runs the worker script: it has `bpy`, lacks the module `stlfr`, and prints messages to stdout."""
    program = tmp_path / "blender"
    program.write_text(
        f"#!{sys.executable} -I\n"
        "import runpy, sys\n"
        "assert sys.argv[1:3] == ['--background', '--factory-startup'], sys.argv\n"
        "sys.modules['stlfr'] = None\n"
        "print('Blender 5.0.1 (hash of nothing)', flush=True)\n"
        "runpy.run_path(sys.argv[sys.argv.index('--python') + 1], run_name='__main__')\n"
    )
    program.chmod(program.stat().st_mode | stat.S_IXUSR)
    rig_file = write_rig(tmp_path / "rig.json", SMALL)
    command = [sys.executable, "-I", str(CAPTURE_SCRIPT), str(rig_file)]
    command += ["--scene", "magazine", "-o", str(tmp_path / "film"), "--frames", "1"]
    command += [
        "--samples",
        "1",
        "--no-truth",
        "--workers",
        "1",
        "--blender",
        str(program),
    ]
    ended = subprocess.run(
        command, capture_output=True, text=True, timeout=240, check=False
    )
    assert ended.returncode == 0, ended.stderr
    said = [json.loads(line) for line in ended.stdout.splitlines()]
    assert said[-1]["done"] == said[-1]["total"] == 1
    assert pixels(tmp_path / "film/cam0/0000.png").shape == (24, 32, 4)


def test_filming_asks_the_module_that_is_named(tmp_path: Path) -> None:
    """With `--module`, filming uses the module `stlfr` in the given folder, even if another one is installed."""
    (tmp_path / "stlfr.py").write_text(
        "def read_rig(path):\n    raise ValueError(f'{path}: asked here')\n"
    )
    film = ["--scene", "magazine", "-o", tmp_path / "film"]
    ended = by_script("mine.json", *film, "--module", tmp_path)
    assert ended.returncode == 2 and ended.stderr.endswith("mine.json: asked here\n")
    assert not (tmp_path / "film").exists()


def test_filming_without_the_module_is_one_sentence(tmp_path: Path) -> None:
    script = "import runpy, sys; sys.modules['stlfr'] = None; del sys.argv[0]; runpy.run_path(sys.argv[0], run_name='__main__')"
    command = [sys.executable, "-I", "-c", script, str(CAPTURE_SCRIPT)]
    command += ["mine.json", "--scene", "magazine", "-o", str(tmp_path / "film")]
    ended = run(command)
    assert ended.returncode == 1 and len(ended.stderr.splitlines()) == 1, ended.stderr
    assert ended.stderr.startswith("the module stlfr can't be loaded")


def test_filming_begins_in_an_empty_folder(tmp_path: Path) -> None:
    """Filming refuses a folder with files; preparations are undone if nothing was filmed."""
    options = folders.Options("mine", 1, 1, False, 0, 1)
    content = rig_content(SMALL)
    folder = tmp_path / "film"
    blend = folders.begin(folder, content, options)
    assert not folders.is_begun(folder)
    blend.write_bytes(b"")
    assert folders.is_begun(folder)
    with pytest.raises(errors.BadInputError, match="resume it"):
        folders.begin(folder, content, options)
    command = folders.command(folder, ["python"], tmp_path, "/opt/blender")
    assert command[-2:] == ["--blender", "/opt/blender"] and "--no-truth" in command
    assert command[command.index("--module") + 1] == str(tmp_path)
    folders.tidy(folder)
    assert not folder.exists()
    (tmp_path / "mine.txt").write_text("mine")
    with pytest.raises(errors.BadInputError, match="isn't empty"):
        folders.begin(tmp_path, content, options)
    with pytest.raises(errors.BadInputError, match="holds no film"):
        folders.command(tmp_path, ["python"], tmp_path, "")
