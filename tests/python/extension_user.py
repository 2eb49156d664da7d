"""Runs the steps of `extension_steps.py` in Blender processes with a given user configuration."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

STEPS = Path(__file__).resolve().parent / "extension_steps.py"


def environment(user: Path) -> dict[str, str]:
    """Environment variables that make Blender use only the folders of this user configuration."""
    folders = {
        f"BLENDER_USER_{name}": str(user / name.lower())
        for name in ("RESOURCES", "CONFIG", "SCRIPTS", "EXTENSIONS", "DATAFILES")
    }
    for folder in folders.values():
        Path(folder).mkdir(exist_ok=True)
    return {**os.environ, **folders, "HOME": str(user)}


def run_step(
    user: Path, name: str, *arguments: object
) -> subprocess.CompletedProcess[str]:
    """Run a step in a new Blender process, whether it succeeds or fails."""
    return subprocess.run(
        # Isolated except for the script's own folder, which holds the helper modules.
        [sys.executable, "-E", "-s", "-B", str(STEPS), name, *map(str, arguments)],
        env=environment(user),
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )


def step(user: Path, name: str, *arguments: object) -> Any:
    """Run a step, which must succeed; returns its result."""
    ended = run_step(user, name, *arguments)
    assert ended.returncode == 0, ended.stdout + ended.stderr
    assert "Traceback" not in ended.stderr, ended.stderr
    return json.loads(ended.stdout.splitlines()[-1])


def one_sentence(text: str) -> str:
    """The single sentence in the text of an operator's error."""
    lines = [line.removeprefix("Error: ").strip() for line in text.splitlines()]
    assert len([line for line in lines if line]) == 1, text
    assert not text.startswith("Error: Python") and "Traceback" not in text, text
    return lines[0]
