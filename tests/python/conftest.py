"""Fixtures that several Python tests share."""

from __future__ import annotations

import fcntl
import json
import os
import shutil
import subprocess
import sys
import venv
import zipfile
from pathlib import Path

import numpy as np
import pytest
from extension_user import step

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="session")
def program() -> Path:
    """The `stlfr` program under test."""
    return Path(os.environ.get("STLFR_TEST_PROGRAM", ROOT / "target/release/stlfr"))


@pytest.fixture(scope="session")
def extension_zip(program: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The zip file of the Blender extension, built from this checkout by the command line."""
    output = tmp_path_factory.mktemp("extension") / "stlfr.zip"
    subprocess.run([program, "-q", "setup", "--extension", output], check=True)
    return output


@pytest.fixture(scope="session")
def blender_user(extension_zip: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a Blender user's configuration in which only the extension is installed."""
    user = tmp_path_factory.mktemp("user")
    (user / "found.json").write_text(json.dumps(step(user, "install", extension_zip)))
    return user


@pytest.fixture(scope="session")
def capture_dir(program: Path) -> Path:
    """A tiny capture that is filmed once for all Rust and Python tests; tests must not write into it."""
    filmed = os.environ.get("STLFR_TEST_CAPTURE")
    if filmed:
        return Path(filmed)
    folder = ROOT / "target/test-captures"
    folder.mkdir(parents=True, exist_ok=True)
    options = [
        "--scene",
        "magazine",
        "--size",
        "160x120",
        "--frames",
        "6",
        "--instants",
        "1",
    ]
    with (folder / "tiny.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        command: list[str | Path] = [program, "capture", "rigs/linear8.json", *options]
        command += ["-o", folder / "tiny"]
        subprocess.run(command, cwd=ROOT, check=True)
    return folder / "tiny"


@pytest.fixture
def own_capture(capture_dir: Path, tmp_path: Path) -> Path:
    """A copy of the tiny capture that a test may write into, with known offsets."""
    capture = Path(shutil.copytree(capture_dir, tmp_path / "own"))
    truth = json.loads((capture / "truth/truth.json").read_text())
    offset_s = {o["id"]: o["offset_s"] for o in truth["offsets"]}
    content = json.loads((capture / "capture.json").read_text())
    for camera in content["cameras"]:
        clock = camera["clock"]
        clock["times_s"] = [t + offset_s[camera["id"]] for t in clock["times_s"]]
        clock["shared"] = True
    (capture / "capture.json").write_text(json.dumps(content))
    return capture


@pytest.fixture(scope="session")
def wheel(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> Path:
    """The wheel that the environment variable STLFR_TEST_WHEEL names, else the wheel in this checkout's extension."""
    released = os.environ.get("STLFR_TEST_WHEEL")
    if released:
        return Path(released)
    extension: Path = request.getfixturevalue("extension_zip")
    folder = tmp_path_factory.mktemp("wheel")
    with zipfile.ZipFile(extension) as archive:
        (name,) = (name for name in archive.namelist() if name.endswith(".whl"))
        return Path(archive.extract(name, folder))


@pytest.fixture(scope="session")
def installed(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of executables of a new Python environment in which the wheel is installed, with numpy."""
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
    """A working folder outside of the source folder."""
    monkeypatch.chdir(tmp_path)
    for name in ("PYTHONPATH", "STLFR_HOME", "VIRTUAL_ENV"):
        monkeypatch.delenv(name, raising=False)
    return tmp_path
