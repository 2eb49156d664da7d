"""What the Python tests share."""

from __future__ import annotations

import fcntl
import os
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="session")
def program() -> Path:
    """The `stlfr` program under test."""
    return Path(os.environ.get("STLFR_TEST_PROGRAM", ROOT / "target/release/stlfr"))


@pytest.fixture(scope="session")
def extension_zip(program: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The extension, built by the command line from this tree."""
    output = tmp_path_factory.mktemp("extension") / "stlfr.zip"
    subprocess.run([program, "-q", "setup", "--extension", output], check=True)
    return output


@pytest.fixture(scope="session")
def capture_dir(program: Path) -> Path:
    """The tiny capture, filmed once for all tests, Rust's and Python's; not to be written to."""
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
