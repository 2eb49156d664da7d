"""The wheel, installed in an empty environment: the module and the command of the same name."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import venv
import zipfile
from pathlib import Path

import numpy as np
import pytest
import stlfr
from filming import ROOT, pixels

RENDER = """
import sys, numpy, stlfr
capture = stlfr.open(sys.argv[1])
numpy.save(sys.argv[2], capture.render(float(sys.argv[3]), like="cam3", preset="draft"))
"""


RELEASED = os.environ.get("STLFR_TEST_WHEEL")
"""The wheel of a release; without one, the tests take that of this tree's extension."""


@pytest.fixture(scope="session")
def wheel(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> Path:
    if RELEASED:
        return Path(RELEASED)
    extension: Path = request.getfixturevalue("extension_zip")
    folder = tmp_path_factory.mktemp("wheel")
    with zipfile.ZipFile(extension) as archive:
        (name,) = (name for name in archive.namelist() if name.endswith(".whl"))
        return Path(archive.extract(name, folder))


@pytest.fixture(scope="session")
def installed(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of programs of an environment that holds the wheel, and numpy as this one has it."""
    folder = tmp_path_factory.mktemp("empty")
    venv.create(folder, symlinks=True)
    programs = folder / "bin"
    packages = next(folder.glob("lib/python3.*/site-packages"))
    numpy = Path(np.__file__).parent
    for part in numpy.parent.glob("numpy*"):
        (packages / part.name).symlink_to(part)
    pip = [sys.executable, "-I", "-m", "pip", "--python", str(programs / "python")]
    install = ["install", "--quiet", "--disable-pip-version-check", "--no-index"]
    subprocess.run([*pip, *install, wheel], check=True)
    return programs


@pytest.fixture
def outside(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A working folder far from the sources."""
    monkeypatch.chdir(tmp_path)
    for name in ("PYTHONPATH", "STLFR_HOME", "VIRTUAL_ENV"):
        monkeypatch.delenv(name, raising=False)
    return tmp_path


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


@pytest.mark.skipif(not RELEASED, reason="of a release only")
def test_a_release_knows_no_folder_of_the_machine_that_built_it(
    wheel: Path, installed: Path, capture_dir: Path, outside: Path
) -> None:
    with zipfile.ZipFile(wheel) as archive:
        (notices,) = (
            n for n in archive.namelist() if n.endswith("LICENSE-THIRD-PARTY")
        )
        assert b"nalgebra" in archive.read(notices)
        module = archive.read("stlfr/_native.abi3.so")
    assert b"/registry/src/" in module  # messages of panics
    assert os.fsencode(Path.home()) + b"/" not in module
    assert os.fsencode(ROOT) + b"/" not in module
    check: list[str | Path] = [installed / "stlfr", "check", capture_dir]
    ended = subprocess.run(check, capture_output=True, text=True, check=False)
    assert ended.returncode == 1 and len(ended.stderr.splitlines()) == 1
    assert "set STLFR_HOME" in ended.stderr


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
