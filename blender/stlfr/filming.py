"""What lies in a folder that is being filmed into, and the command that films. No `bpy` here.

Beside the plan, the hidden folder holds copies of the rig and of the .blend as they were when filming
began: a film that was stopped goes on from them, whatever has become of the scene since.
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
    """How to film. `workers` 0: a filming process for every core."""

    title: str
    """The scene's name for people; the copy of the .blend is called so."""
    frames: int
    samples: int
    truth: bool
    instants: int
    workers: int
    lead_s: float = 0.0
    """How long before the scene's first frame filming begins."""

    def blend_copy(self, capture: Path) -> Path:
        """Where the copy of the .blend lies."""
        return capture / HIDDEN_FOLDER / f"{self.title}.blend"


def begin(capture: Path, rig_content: dict[str, Any], options: Options) -> Path:
    """Make the folder a new film's; gives where the copy of the .blend belongs."""
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
"""What the lead has more than the last camera's delay: offsets are estimated, and Blender keeps single precision. Larger
films what nobody sees; smaller, and the scene's first frame may lie before a camera's first image."""


LEAD_FRAMES = 10
"""Among how many of its frames a camera's first is looked for: some may be lost. More takes longer to draw jitter for;
fewer, and a camera that loses its first ones is left out."""


def lead_s(rig_content: dict[str, Any]) -> float:
    """How long before the scene's first frame filming begins: every camera has a frame by then."""
    native.check_rig(rig_content)
    rig = rigs.from_content(rig_content)
    shutters = rigs.shutters(rig, LEAD_FRAMES)
    first_s = [times[0] for s in shutters if (times := s.world_times_s)]
    return max(0.0, max(first_s, default=0.0) + LEAD_MARGIN_S)


def tidy(capture: Path) -> None:
    """Undo `begin` where nothing was filmed after it: the rig or the options were refused."""
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
    """Whether a film was begun there, and can go on."""
    options = _options(capture)
    return (
        options is not None
        and (capture / HIDDEN_FOLDER / RIG_COPY).is_file()
        and options.blend_copy(capture).is_file()
        and not (capture / CAPTURE_FILE).is_file()
    )


def _options(capture: Path) -> Options | None:
    """What a film was begun with; None where none was."""
    try:
        text = reading.read_text(capture / HIDDEN_FOLDER / OPTIONS_COPY)
        return Options(**json.loads(text))
    except (OSError, ValueError, TypeError):
        return None


def command(
    capture: Path, python: list[str], module_folder: Path, blender: str
) -> list[str]:
    """What films into a folder that `begin` has made.

    `module_folder` holds the module `stlfr`. `blender` is Blender's program, or empty where `bpy` is a
    module.
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
    """After the film: remove the scene's copy; gives the time offset at which the light field shows it."""
    options = _options(capture)
    offset_s = time_offset_s(capture)
    if options is None or offset_s is None:
        raise BadInputError(f"{capture} holds no film that was begun here")
    options.blend_copy(capture).unlink(missing_ok=True)
    return offset_s


def time_offset_s(capture: Path) -> float | None:
    """The capture's time at the first frame of the scene that was filmed; None where it wasn't filmed from a panel.

    That is how long filming had gone on by then, less the world time at which the reference camera's
    clock reads 0.
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
    """`capture.py`: beside this folder in the sources, in it where the extension is installed."""
    here = Path(__file__).resolve().parent
    packed = here / "capture.py"
    return packed if packed.is_file() else here.parent / "capture.py"
