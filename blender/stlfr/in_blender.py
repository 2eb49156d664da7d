"""Runs a worker process of filming in Blender's own program. Does not import `bpy`.

If `bpy` is installed as a Python module, any Python process can film. Otherwise, only Blender's program has `bpy`. But
this program writes its own messages to stdout, where a worker process must write its answers. So the worker starts as a
plain Python process, duplicates stdout to another file descriptor, and then replaces itself by Blender.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import NoReturn


def become(blender: str, script: Path) -> NoReturn:
    """Replace this process by Blender's program, which runs `script` as a worker process of filming."""
    answers = os.dup(1)
    os.set_inheritable(answers, True)
    os.dup2(2, 1)
    arguments = ["--background", "--factory-startup", "--python-exit-code", "1"]
    arguments += ["--python", str(script), "--", "--worker-answers", str(answers)]
    os.execv(blender, [blender, *arguments])


def take_answers(number: str) -> None:
    """In Blender: make stdout again the pipe for answers, whose file descriptor is `number`."""
    answers = int(number)
    os.dup2(answers, 1)
    os.close(answers)


def own_arguments() -> list[str]:
    """The script's arguments; in Blender, those that follow `--` on the command line."""
    arguments = sys.argv[1:]
    return arguments[arguments.index("--") + 1 :] if "--" in arguments else arguments
