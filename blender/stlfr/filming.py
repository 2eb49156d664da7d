"""Filming from Blender's panels: the files in a folder that is being filmed into, and the command that films.

Beside the plan, the hidden folder holds copies of the rig and of the .blend file from the start of filming. If filming
is stopped, it resumes with these copies, even if the scene has changed. Does not import `bpy`.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from . import folder, native, reading, truth
from . import rig as rigs
from .errors import BadInputError
from .plan import CAPTURE_FILE, HIDDEN_FOLDER, PLAN_FILE

RIG_COPY = "rig.json"
OPTIONS_COPY = "options.json"


@dataclass(frozen=True)
class Options:
    """Options of filming from the panel. If `workers` is 0, there is one worker process per core."""

    title: str
    """The scene's name for display, and the name of the copy of the .blend file."""
    frames: int
    samples: int
    truth: bool
    instants: int
    workers: int
    lead_s: float = 0.0
    """How many seconds before the scene's first frame filming begins."""

    def blend_copy(self, capture: Path) -> Path:
        """The path of the copy of the .blend file."""
        return capture / HIDDEN_FOLDER / f"{self.title}.blend"


def begin(capture: Path, rig_content: dict[str, Any], options: Options) -> Path:
    """Prepare an empty or new folder for filming. Raises `BadInputError` if the folder isn't empty.

    Returns the path to which the caller must save the copy of the .blend file.
    """
    if is_begun(capture):
        raise BadInputError(
            f"{capture} holds a film that was stopped: resume it, or choose another folder"
        )
    if capture.exists() and (not capture.is_dir() or any(capture.iterdir())):
        raise BadInputError(
            f"{capture} is there already and isn't empty: choose another folder for the film"
        )
    hidden = capture / HIDDEN_FOLDER
    folder.write_json(hidden / RIG_COPY, rig_content)
    folder.write_json(hidden / OPTIONS_COPY, vars(options))
    return options.blend_copy(capture)


LEAD_MARGIN_S = 0.001
"""Added to the latest first frame of all cameras to get the lead, as estimated offsets have errors and Blender stores
single precision. If larger, more is filmed that is never shown; if smaller, the scene's first frame may be before a
camera's first image."""


LEAD_FRAMES = 10
"""Number of frames among which a camera's first recorded frame is searched, as the first frames may be lost. If larger,
the search takes longer; if smaller, a camera that loses all these frames is ignored."""


def lead_s(rig_content: dict[str, Any]) -> float:
    """How many seconds before the scene's first frame filming must begin, so that every camera has a frame by then."""
    native.check_rig(rig_content)
    rig = rigs.from_content(rig_content)
    shutters = rigs.shutters(rig, LEAD_FRAMES)
    first_s = [times[0] for s in shutters if (times := s.world_times_s)]
    return max(0.0, max(first_s, default=0.0) + LEAD_MARGIN_S)


def tidy(capture: Path) -> None:
    """Undo `begin` if nothing was filmed afterwards, because the rig or the options were refused."""
    hidden = capture / HIDDEN_FOLDER
    options = _options(capture)
    if options is None or (hidden / PLAN_FILE).exists():
        return
    for file in (
        hidden / RIG_COPY,
        hidden / OPTIONS_COPY,
        options.blend_copy(capture),
    ):
        file.unlink(missing_ok=True)
    hidden.rmdir()
    capture.rmdir()


def is_begun(capture: Path) -> bool:
    """Whether filming into this folder was begun and isn't complete, and all files needed to resume it exist."""
    options = _options(capture)
    return (
        options is not None
        and (capture / HIDDEN_FOLDER / RIG_COPY).is_file()
        and options.blend_copy(capture).is_file()
        and not (capture / CAPTURE_FILE).is_file()
    )


def _options(capture: Path) -> Options | None:
    """The options with which filming into this folder was begun; None if it wasn't, or if they can't be read."""
    try:
        text = reading.read_text(capture / HIDDEN_FOLDER / OPTIONS_COPY)
        return Options(**json.loads(text))
    except (OSError, ValueError, TypeError):
        return None


def command(
    capture: Path, python: list[str], module_folder: Path, blender: str
) -> list[str]:
    """The command line that films into a folder that `begin` has prepared.

    `python` is the command that runs Python. `module_folder` contains the module `stlfr`. `blender` is the path of
    Blender's program, or empty if `bpy` is installed as a Python module.
    """
    options = _options(capture)
    if options is None or not is_begun(capture):
        raise BadInputError(f"{capture} holds no film that was begun here and stopped")
    rig_copy = capture / HIDDEN_FOLDER / RIG_COPY
    arguments = [*python, str(_script()), str(rig_copy)]
    arguments += ["--blend", str(options.blend_copy(capture)), "-o", str(capture)]
    arguments += ["--module", str(module_folder)]
    arguments += ["--frames", str(options.frames), "--samples", str(options.samples)]
    if options.workers:
        arguments += ["--workers", str(options.workers)]
    if options.truth:
        arguments += ["--instants", str(options.instants)]
    else:
        arguments.append("--no-truth")
    return [*arguments, "--blender", blender] if blender else arguments


def finish(capture: Path) -> float:
    """Called after filming: deletes the copy of the .blend file.

    Returns the time offset with which the light field shows the same instants as the scene, seconds.
    """
    options = _options(capture)
    offset_s = time_offset_s(capture)
    if options is None or offset_s is None:
        raise BadInputError(f"{capture} holds no film that was begun here")
    options.blend_copy(capture).unlink(missing_ok=True)
    return offset_s


def time_offset_s(capture: Path) -> float | None:
    """The capture's time at the filmed scene's first frame, seconds; None if it wasn't filmed from a panel.

    This is the lead (the time from the start of filming to this frame) minus the world time at which the reference
    camera's clock shows 0.
    """
    options = _options(capture)
    try:
        rig = rigs.load(capture / HIDDEN_FOLDER / RIG_COPY)
    except BadInputError:
        return None
    if options is None:
        return None
    zero_s = truth.reference_zero_s(rig, rigs.shutters(rig, options.frames))
    return options.lead_s - zero_s


def _script() -> Path:
    """The path of `capture.py`: inside this folder in an installed extension, beside this folder in the sources."""
    here = Path(__file__).resolve().parent
    packed = here / "capture.py"
    return packed if packed.is_file() else here.parent / "capture.py"
