"""A filming process inside Blender's own program. No `bpy` here.

Where `bpy` is a module, any Python films. In Blender, only its program has `bpy`, and writes notes of
its own to stdout, which is where a filming process answers. So the process starts as a plain Python,
keeps stdout under another number, and becomes Blender.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import NoReturn


def become(blender: str, script: Path) -> NoReturn:
    """Turn this process into a Blender that works as a filming process."""
    answers = os.dup(1)
    os.set_inheritable(answers, True)
    os.dup2(2, 1)
    arguments = ["--background", "--factory-startup", "--python-exit-code", "1"]
    arguments += ["--python", str(script), "--", "--worker-answers", str(answers)]
    os.execv(blender, [blender, *arguments])


def take_answers(number: str) -> None:
    """Inside Blender: give stdout back to the answers."""
    answers = int(number)
    os.dup2(answers, 1)
    os.close(answers)


def own_arguments() -> list[str]:
    """The script's arguments: in Blender, those after its own."""
    arguments = sys.argv[1:]
    return arguments[arguments.index("--") + 1 :] if "--" in arguments else arguments
