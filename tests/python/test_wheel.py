"""The wheel, installed in an empty environment: the module and the command of the same name."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import zipfile
from pathlib import Path

import numpy as np
import pytest
import stlfr
from filming import pixels

RENDER = """
import sys, numpy, stlfr
capture = stlfr.open(sys.argv[1])
numpy.save(sys.argv[2], capture.render(float(sys.argv[3]), like="cam3", preset="draft"))
"""


def test_it_holds_the_licences_and_nothing_else_than_the_package(wheel: Path) -> None:
    with zipfile.ZipFile(wheel) as archive:
        names = archive.namelist()
    info = f"stlfr-{stlfr.__version__}.dist-info"
    assert {name.split("/")[0] for name in names} == {"stlfr", info}
    assert {f"{info}/licenses/LICENSE-{name}" for name in ("MIT", "APACHE")} <= {*names}
    files = {"__init__.py", "__init__.pyi", "command.py", "py.typed"}
    files |= {"_native.pyi", "_native.abi3.so"}
    assert {f"stlfr/{name}" for name in files} == {
        n for n in names if n.startswith("stlfr/")
    }


def test_the_module_renders_as_the_program_does(
    installed: Path, program: Path, capture_dir: Path, outside: Path
) -> None:
    capture = shutil.copytree(capture_dir, outside / "capture")
    time_s = str(np.mean(stlfr.open(capture).covered_s()))
    array, image = outside / "view.npy", outside / "view.png"
    python: list[str | Path] = [installed / "python", "-I", "-c", RENDER]
    subprocess.run([*python, capture, array, time_s], check=True)
    options = ["--like", "cam3", "--preset", "draft", "--time", time_s]
    subprocess.run(
        [program, "-q", "render", capture, *options, "-o", image], check=True
    )
    view = np.load(array)
    assert view.shape == (120, 160, 3) and view.std() > 10
    np.testing.assert_array_equal(view, pixels(image)[..., :3])


def test_the_command_prints_and_ends_as_the_program_does(
    installed: Path, program: Path, capture_dir: Path, outside: Path
) -> None:
    unreadable = os.fsencode(outside) + b"/\xff\xfe"
    for arguments in (
        ["info", os.fsencode(capture_dir)],
        ["--version"],
        ["options"],
        [],
        ["rendr"],
        ["info", unreadable],
        [
            "render",
            os.fsencode(capture_dir),
            "--like",
            "cam3",
            "--time",
            "1e9",
            "-o",
            "x.png",
        ],
    ):
        ours, theirs = (
            subprocess.run([command, *arguments], capture_output=True, check=False)
            for command in (installed / "stlfr", program)
        )
        assert (ours.returncode, ours.stdout) == (theirs.returncode, theirs.stdout)
        assert ours.stderr == theirs.stderr
    assert ours.returncode == 2 and b"cover" in ours.stderr


def test_a_job_starts_the_installed_command(
    installed: Path, capture_dir: Path, outside: Path
) -> None:
    command: list[str | Path] = [
        os.path.relpath(installed / "stlfr"),
        "farm",
        capture_dir,
        "-o",
        "job",
    ]
    subprocess.run(command, capture_output=True, check=True)
    job = json.loads((outside / "job/openjd.json").read_text())
    defaults = {p["name"]: p["default"] for p in job["parameterDefinitions"]}
    started = Path(defaults["Program"])
    assert started.is_absolute() and started.samefile(installed / "stlfr")


@pytest.mark.parametrize("stop", [signal.SIGINT, signal.SIGTERM])
def test_signals_end_the_command_as_they_end_the_program(
    installed: Path, capture_dir: Path, outside: Path, stop: signal.Signals
) -> None:
    # A command inherits that SIGINT is ignored, as when tests run in the background.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    capture = shutil.copytree(capture_dir, outside / "capture")
    command: list[str | Path] = [installed / "stlfr", "view", capture]
    command += ["--no-open", "--preset", "draft"]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE
    ) as run:
        assert run.stdout and run.stderr
        assert b"http://" in run.stdout.readline()
        run.send_signal(stop)
        assert run.wait(20) == -stop
        assert b"Traceback" not in run.stderr.read()
