"""A user's Blender with the extension, in which the steps of `extension_steps.py` run."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

STEPS = Path(__file__).resolve().parent / "extension_steps.py"


def environment(user: Path) -> dict[str, str]:
    """Blender's folders of a user who has nothing else."""
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
    """A step in a Blender of its own, however it ends."""
    return subprocess.run(
        # Isolated, but for its own folder, where what the steps use lies.
        [sys.executable, "-E", "-s", "-B", str(STEPS), name, *map(str, arguments)],
        env=environment(user),
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )


def step(user: Path, name: str, *arguments: object) -> Any:
    """What a step finds."""
    ended = run_step(user, name, *arguments)
    assert ended.returncode == 0, ended.stdout + ended.stderr
    assert "Traceback" not in ended.stderr, ended.stderr
    return json.loads(ended.stdout.splitlines()[-1])


def one_sentence(text: str) -> str:
    """The sentence of an operator's error."""
    lines = [line.removeprefix("Error: ").strip() for line in text.splitlines()]
    assert len([line for line in lines if line]) == 1, text
    assert not text.startswith("Error: Python") and "Traceback" not in text, text
    return lines[0]
