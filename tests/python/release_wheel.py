"""Tests of a release's wheel in an empty environment, run by `.ci/release.py`; other wheels aren't portable."""

from __future__ import annotations

import os
import subprocess
import zipfile
from pathlib import Path

from filming import ROOT


def test_a_release_knows_no_folder_of_the_machine_that_built_it(
    wheel: Path, installed: Path, capture_dir: Path, outside: Path
) -> None:
    """It doesn't need such a folder: errors name what is missing. It contains the licences of linked libraries."""
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
